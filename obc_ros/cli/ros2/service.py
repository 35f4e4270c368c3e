# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc service`: call services, and list those that there are."""

import argparse
import sys

from obc_ros.cli.graph import joined, LOOK
from obc_ros.cli.ros2.verbs import add_direct, add_verbs, run_verb, seconds
from obc_ros.cli.yaml_messages import FieldError, fill, find_type, parse
from obc_ros.core.errors import ObcError
from rclpy.topic_or_service_is_hidden import topic_or_service_is_hidden

run = run_verb


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verbs."""
    add_verbs(parser, {
        'call': ('call a service and print its answer', _call_arguments, call),
        'list': ('list the services', _list_arguments, list_services)})


def _call_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('service_name', help='name of the service: /lqr_node/stop')
    parser.add_argument('service_type', help='its type: std_srvs/srv/Trigger')
    given = parser.add_mutually_exclusive_group()
    given.add_argument('values', nargs='?', default='{}',
                       help="fields of the request in YAML: '{a: 1, b: [1, 2]}' (default: none)")
    given.add_argument('--stdin', action='store_true', help='read them from the standard input')
    parser.add_argument('--timeout', type=seconds, default=LOOK, metavar='N',
                        help='wait for the service for N seconds (default: %(default)g)')


def _list_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('-t', '--show-types', action='store_true', help='print the types as well')
    parser.add_argument('-c', '--count-services', action='store_true', help='print how many')
    parser.add_argument('--include-hidden-services', action='store_true',
                        help='services with a part that begins with _ as well')
    add_direct(parser)


def call(args: argparse.Namespace) -> int:
    """Make a request and print the response, both as Python does."""
    kind = find_type(args.service_type, 'srv')
    try:
        request = fill(kind.Request(), parse(sys.stdin.read() if args.stdin else args.values))
    except FieldError as error:
        raise ObcError(f'Failed to populate field: {error}') from error
    name = args.service_name if args.service_name.startswith('/') else f'/{args.service_name}'
    wanted = f'{args.service_type.split("/")[0]}/srv/{kind.__name__}'
    with joined() as graph:
        client = graph.node.create_client(kind, name)
        if not client.service_is_ready():
            print('waiting for service to become available...', flush=True)
        if not graph.until(client.service_is_ready, args.timeout):
            types = dict(graph.node.get_service_names_and_types()).get(name, [])
            if others := [each for each in types if each != wanted]:  # the client's own counts
                raise ObcError(f'{name} is of the type {", ".join(others)}, not {wanted}')
            raise ObcError(f'no service {name} within {args.timeout:g} s; '
                           'see obc service list')
        print(f'requester: making request: {request!r}\n', flush=True)
        response = graph.call(kind, name, request)
    print(f'response:\n{response!r}\n')
    return 0


def list_services(args: argparse.Namespace) -> int:
    """Print the names of the services."""
    with joined() as graph:
        found = graph.settle(lambda: [
            (name, types) for name, types in sorted(graph.node.get_service_names_and_types())
            if args.include_hidden_services or not topic_or_service_is_hidden(name)],
            args.spin_time)
    if args.count_services:
        print(len(found))
        return 0
    for name, types in found:
        print(f'{name} [{", ".join(types)}]' if args.show_types else name)
    return 0
