# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc action`: send a goal, print its feedback and result; Ctrl-C cancels it."""

import argparse
import sys
from typing import Any

from action_msgs.msg import GoalStatus
from obc_ros.cli.ros2.verbs import add_verbs, parse_seconds, run_verb
from obc_ros.cli.ros2.yaml_messages import (
    convert_to_yaml,
    FieldError,
    fill,
    find_type,
    parse_values,
)
from obc_ros.cli.ros_graph import Graph, join_graph, LOOK
from obc_ros.cli.terminal import Parser
from obc_ros.core.text.errors import ObcError
from rclpy.action import ActionClient, get_action_names_and_types

run = run_verb


def add_arguments(parser: Parser) -> None:
    """Declare the verbs."""
    add_verbs(parser, {'send_goal': (
        'send a goal and print the result', '/trajectory_server/solve_optimal_control '
        'obc_ros/action/SolveOptimalControl "$(cat goal.yaml)" --feedback', _arguments,
        send_goal)})


def _arguments(parser: Parser) -> None:
    parser.add_argument('action_name', help='/trajectory_server/solve_optimal_control')
    parser.add_argument('action_type', help='obc_ros/action/SolveOptimalControl')
    given = parser.add_mutually_exclusive_group()
    given.add_argument('goal', nargs='?', default='{}',
                       help='fields of the goal in YAML (default: none)')
    given.add_argument('--stdin', action='store_true', help='read the fields from standard input')
    parser.add_argument('-f', '--feedback', action='store_true', help='print the feedback')
    parser.add_argument('--timeout', type=parse_seconds, default=LOOK, metavar='N',
                        help='wait for the server for N seconds (default: %(default)g)')


def send_goal(args: argparse.Namespace) -> int:
    """Send a goal, print feedback and result; return 0 if it has succeeded, else 1."""
    kind = find_type(args.action_type, 'action')
    try:
        goal = fill(kind.Goal(), parse_values(sys.stdin.read() if args.stdin else args.goal))
    except FieldError as error:
        raise ObcError(f'Failed to populate message fields: {error}') from error
    name = args.action_name if args.action_name.startswith('/') else f'/{args.action_name}'

    def tell(feedback: Any) -> None:
        print(f'Feedback:\n    {convert_to_yaml(feedback.feedback)}', flush=True)

    with join_graph() as graph:
        client = ActionClient(graph.node, kind, name)
        try:
            print('Waiting for an action server to become available...', flush=True)
            if not graph.until(client.server_is_ready, args.timeout):
                there = [each for each, _ in get_action_names_and_types(graph.node)]
                raise ObcError(f'no action {name} of that type within {args.timeout:g} s; '
                               f'there is {", ".join(there) or "none"}')
            print(f'Sending goal:\n     {convert_to_yaml(goal)}', flush=True)
            return _follow(graph, client, name, goal, tell if args.feedback else None)
        finally:
            client.destroy()


def _follow(graph: Graph, client: ActionClient, name: str, goal: Any, tell: Any) -> int:
    """Wait for the result of a goal; Ctrl-C cancels it."""
    def wait(future: Any) -> Any:
        graph.wait(future.done, client.server_is_ready, f'action {name}')
        return future.result()

    handle = wait(client.send_goal_async(goal, tell))
    if not handle.accepted:
        print('Goal was rejected.')
        return 1
    result = handle.get_result_async()
    try:
        print(f'Goal accepted with ID: {bytes(handle.goal_id.uuid).hex()}\n', flush=True)
        answer = wait(result)
    except KeyboardInterrupt:
        print('Canceling goal...', flush=True)
        if wait(handle.cancel_goal_async()).goals_canceling:
            wait(result)
            print('Goal canceled.')
        raise
    print(f'Result:\n    {convert_to_yaml(answer.result)}')
    names = {getattr(GoalStatus, f'STATUS_{each}'): each
             for each in ('SUCCEEDED', 'CANCELED', 'ABORTED')}
    print(f'Goal finished with status: {names.get(answer.status, "UNKNOWN")}')
    return 0 if answer.status == GoalStatus.STATUS_SUCCEEDED else 1
