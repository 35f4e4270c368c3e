# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc node`: list the running nodes."""

import argparse
import sys

from obc_ros.cli.ros2.verbs import add_direct, add_verbs, run_verb
from obc_ros.cli.ros_graph import join_graph
from obc_ros.cli.terminal import Parser

run = run_verb


def add_arguments(parser: Parser) -> None:
    """Declare the verbs."""
    add_verbs(parser, {'list': ('list the running nodes', '', _arguments, list_nodes)})


def _arguments(parser: Parser) -> None:
    parser.add_argument('-a', '--all', action='store_true',
                        help='include nodes whose names begin with _')
    parser.add_argument('-c', '--count-nodes', action='store_true', help='print their number')
    add_direct(parser)


def list_nodes(args: argparse.Namespace) -> int:
    """Print the full names of the nodes."""
    with join_graph() as graph:
        found = graph.settle(lambda: graph.nodes(hidden=args.all), args.spin_time)
    if args.count_nodes:
        print(len(found))
        return 0
    if len(set(found)) < len(found):
        print('WARNING: Be aware that there are nodes in the graph that share an exact name, '
              'which can have unintended side effects.', file=sys.stderr)
    for name in found:
        print(name)
    return 0
