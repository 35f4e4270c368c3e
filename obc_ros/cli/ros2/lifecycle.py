# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc lifecycle`: print and change the states of lifecycle nodes."""

import argparse
from functools import partial
import sys

from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from obc_ros.cli.ros2.verbs import add_node, add_verbs, run_verb
from obc_ros.cli.ros_graph import Graph, join_graph, LOOK
from obc_ros.cli.terminal import Parser
from obc_ros.core.text.errors import ObcError, quote

run = run_verb


def add_arguments(parser: Parser) -> None:
    """Declare the verbs."""
    add_verbs(parser, {
        'get': ('print the state of a node, or of all', '/lqr_node',
                partial(add_node, optional=True), get_state),
        'set': ('change the state of a node', '/lqr_node deactivate', _set_arguments, set_state)})


def _set_arguments(parser: Parser) -> None:
    add_node(parser)
    parser.add_argument('transition', help='activate, deactivate, ..., or its number')


def get_state(args: argparse.Namespace) -> int:
    """Print the state of a node, or of all lifecycle nodes."""
    with join_graph() as graph:
        if args.node_name:
            nodes = [_find(graph, args.node_name, args.timeout)]
        else:
            nodes = graph.settle(lambda: [
                each for each in graph.nodes(args.include_hidden_nodes)
                if f'{each}/get_state' in dict(graph.node.get_service_names_and_types())],
                args.spin_time)
        for node in nodes:
            state = graph.call(GetState, f'{node}/get_state', GetState.Request()).current_state
            print(f'{"" if args.node_name else f"{node}: "}{state.label} [{state.id}]')
    return 0


def set_state(args: argparse.Namespace) -> int:
    """Request a transition by its label or its number."""
    with join_graph() as graph:
        node = _find(graph, args.node_name, args.timeout)
        there = [each.transition for each in graph.call(
            GetAvailableTransitions, f'{node}/get_available_transitions',
            GetAvailableTransitions.Request()).available_transitions]
        wanted = [each for each in there if args.transition in (each.label, str(each.id))]
        if not wanted:
            raise ObcError('Unknown transition requested, available ones are: '
                           + ', '.join(f'{each.label} [{each.id}]' for each in there)
                           + f"; not '{quote(args.transition)}'")
        done = graph.call(ChangeState, f'{node}/change_state',
                          ChangeState.Request(transition=wanted[0])).success
    print('Transitioning successful' if done else 'Transitioning failed',
          file=sys.stdout if done else sys.stderr)
    return 0 if done else 1


def _find(graph: Graph, name: str, timeout: float = LOOK) -> str:
    """Return the full name of a lifecycle node."""
    node = graph.find_node(name, timeout)
    if not graph.has_service(f'{node}/get_state', timeout):
        raise ObcError(f'{node} has no states: it is no lifecycle node')
    return node
