# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Verbs, and the arguments that several commands share."""

import argparse
from collections.abc import Callable, Mapping, Sequence

from obc_ros.cli.ros_graph import join_graph, keep_to_this_machine, LOOK, QUIET
from obc_ros.cli.terminal import Parser
from rclpy.node import Node
from rclpy.topic_or_service_is_hidden import topic_or_service_is_hidden

COMPATIBLE = 'accepted as by `ros2`'   # in the help of what has no effect here
# A line of help, an example of the arguments, `add_arguments(parser)` and `run(args)`.
Verb = tuple[str, str, Callable[[Parser], None], Callable[[argparse.Namespace], int]]


def add_verbs(parser: Parser, verbs: Mapping[str, Verb]) -> None:
    """Declare verbs."""
    found = parser.add_subparsers(title='verbs', metavar='VERB', required=True)
    for name, (text, example, add_arguments, run) in verbs.items():
        verb = found.add_parser(name, help=text, description=f'{text[:1].upper()}{text[1:]}.')
        verb.example = f'{verb.prog} {example}'.rstrip()
        add_arguments(verb)
        verb.set_defaults(verb=run)


def run_verb(args: argparse.Namespace) -> int:
    """Run the verb of a command; return the exit status."""
    keep_to_this_machine()
    run: Callable[[argparse.Namespace], int] = args.verb
    return run(args)


def add_direct(parser: Parser, *, lists: bool = True) -> None:
    """Declare the arguments of `ros2` for commands that search the graph; `lists`: all of it."""
    parser.add_argument('--spin-time', type=parse_seconds, default=QUIET, metavar='S',
                        help='look until there has been no news for S seconds '
                             '(default: %(default)g)' if lists else
                             f'{COMPATIBLE}; has no effect here')
    parser.add_argument('--no-daemon', action='store_true',
                        help=f'{COMPATIBLE}; there is no daemon here')


def add_list(parser: Parser, what: str) -> None:
    """Declare the arguments of a list of names; `what`: topics or services."""
    parser.add_argument('-t', '--show-types', action='store_true', help='print the types too')
    parser.add_argument('-c', f'--count-{what}', dest='count', action='store_true',
                        help='print their number')
    parser.add_argument(f'--include-hidden-{what}', dest='include_hidden', action='store_true',
                        help=f'include {what} with a part that begins with _')
    add_direct(parser)


def list_names(args: argparse.Namespace,
               look: Callable[[Node], Sequence[tuple[str, Sequence[str]]]]) -> int:
    """Print the names that a node sees, once they no longer change; see `add_list`."""
    with join_graph() as graph:
        found = graph.settle(lambda: [
            (name, types) for name, types in sorted(look(graph.node))
            if args.include_hidden or not topic_or_service_is_hidden(name)], args.spin_time)
    if args.count:
        print(len(found))
        return 0
    for name, types in found:
        print(f'{name} [{", ".join(types)}]' if args.show_types else name)
    return 0


def add_node(parser: Parser, *, optional: bool = False) -> None:
    """Declare the name of a node, and the time to wait for it."""
    if optional:
        parser.add_argument('node_name', nargs='?', help='name of the node (default: all)')
    else:
        parser.add_argument('node_name', help='name of the node: /lqr_node')
    parser.add_argument('--timeout', type=parse_seconds, default=LOOK, metavar='N',
                        help='wait for the node for N seconds (default: %(default)g)')
    parser.add_argument('--include-hidden-nodes', action='store_true',
                        help='include nodes whose names begin with _' if optional else
                        f'{COMPATIBLE}; such a node is found by its name')
    add_direct(parser, lists=optional)


def parse_seconds(text: str) -> float:
    """Return a positive number of seconds."""
    value = float(text)
    if not 0.0 < value < float('inf'):
        raise argparse.ArgumentTypeError(f"'{text}' is no number of seconds above 0")
    return value
