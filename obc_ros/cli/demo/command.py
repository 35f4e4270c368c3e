# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
`obc demo`: a closed loop of node processes over DDS, recorded and plotted.

aircraft: hover, a step with Qx = I, the weights of Example 2.5 set in flight, a second step, a
gust, and a change that must be rejected.
vehicle: a lane change that trajectory_server plans and lqr_node follows, then the slalom of
Exercise 2.10.
mpc: the aircraft with limits of its speed and tilt. lqr_node exceeds that of the speed, mpc_node
keeps both.
lqg: the aircraft with sensors that are late and lost. estimator_node provides the state.
"""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
import os
from pathlib import Path
import sys

from obc_ros.cli import results
from obc_ros.cli.client import is_own_domain_used
from obc_ros.cli.processes import isolate, lock_folder, reserve_domain
from obc_ros.cli.ros_graph import Graph, join_graph, keep_to_this_machine, LOOK
from obc_ros.cli.terminal import Parser
from obc_ros.core.text.errors import ObcError, quote

LAST_DOMAIN = 232  # the last one whose ports exist
# For the hints: number of nodes, the controller, and the arguments of the launch file for the same
# loop.
LOOPS = {'aircraft': ('three', 'lqr_node', 'scenario:=aircraft'),
         'vehicle': ('three', 'lqr_node', 'scenario:=vehicle'),
         'mpc': ('three', 'mpc_node', 'controller:=mpc scenario:=aircraft_limits'),
         'lqg': ('four', 'lqr_node', 'scenario:=aircraft estimator:=true')}


def add_arguments(parser: Parser) -> None:
    """Declare the arguments of `obc demo`."""
    parser.add_argument('scenario', choices=tuple(LOOPS), help='what is flown')
    parser.add_argument('--out', type=Path, default=Path('out'), metavar='DIR',
                        help='directory of figures and recordings (default: out)')
    results.add_format(parser)
    parser.add_argument('--real-time', action='store_true',
                        help='run in real time, not in lockstep')


def run(args: argparse.Namespace) -> int:
    """Run a demonstration; return the exit status."""
    from obc_ros.cli.demo import aircraft, flight_estimates, flight_limits, vehicle
    scenario = {'aircraft': aircraft, 'vehicle': vehicle, 'mpc': flight_limits,
                'lqg': flight_estimates}[args.scenario]
    count, controller, arguments = LOOPS[args.scenario]
    with lock_folder(args.out), _own_domain() as domain:
        isolate(domain)
        obc = sys.argv[0] if Path(sys.argv[0]).name == 'obc' else 'obc'
        print(f'{args.scenario}: {count} nodes over DDS, domain {domain}, this machine only; '
              'while it runs, in another terminal:\n'
              f'  ROS_DOMAIN_ID={domain} {obc} param get /{controller} Qx', flush=True)
        status: int = scenario.run(args.out, args.real_time, args.format)
    print('to start a loop and tune it by hand:\n'
          f'  {obc} launch obc_ros loop.launch.py {arguments}    '
          '# until Ctrl-C; in another terminal:\n'
          f'  {obc} param get /{controller} Qx')
    return status


@contextmanager
def _own_domain() -> Iterator[int]:
    """
    Yield the domain that the environment names, or else an unused one.

    :raises ObcError: if the name is no domain, or if the domain has a loop already: its plant
        would receive the commands of this one.
    """
    named = os.environ.get('ROS_DOMAIN_ID', '')
    if not named:
        with reserve_domain() as domain:
            yield domain
        return
    if not named.isdecimal() or int(named) > LAST_DOMAIN:
        raise ObcError(f'ROS_DOMAIN_ID={quote(named)}: wanted a number from 0 to {LAST_DOMAIN}')
    if is_own_domain_used():
        keep_to_this_machine()
        with join_graph() as graph:
            if graph.until(partial(_ends, graph), LOOK):
                raise ObcError(
                    f'ROS_DOMAIN_ID={named} has a loop already ({", ".join(_ends(graph))}), which '
                    'would receive these commands; unset ROS_DOMAIN_ID, or choose another')
    yield int(named)


def _ends(graph: Graph) -> list[str]:
    """Return the topics of a loop that have a publisher or a subscriber."""
    return [topic for topic in ('/state', '/command')
            if graph.node.count_publishers(topic) or graph.node.count_subscribers(topic)]
