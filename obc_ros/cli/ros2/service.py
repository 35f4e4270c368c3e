# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc service`: call and list services."""

import argparse
from functools import partial
import sys

from obc_ros.cli.ros2.verbs import add_list, add_verbs, list_names, parse_seconds, run_verb
from obc_ros.cli.ros2.yaml_messages import FieldError, fill, find_type, parse_values
from obc_ros.cli.ros_graph import join_graph, LOOK
from obc_ros.cli.terminal import Parser
from obc_ros.core.text.errors import ObcError

run = run_verb


def add_arguments(parser: Parser) -> None:
    """Declare the verbs."""
    add_verbs(parser, {
        'call': ('call a service and print the response',
                 '/lqr_node/stop std_srvs/srv/Trigger', _call_arguments, call),
        'list': ('list the services', '--show-types', partial(add_list, what='services'),
                 partial(list_names, look=lambda node: node.get_service_names_and_types()))})


def _call_arguments(parser: Parser) -> None:
    parser.add_argument('service_name', help='name of the service: /lqr_node/stop')
    parser.add_argument('service_type', help='service type: std_srvs/srv/Trigger')
    given = parser.add_mutually_exclusive_group()
    given.add_argument('values', nargs='?', default='{}',
                       help="fields of the request in YAML: '{a: 1, b: [1, 2]}' (default: none)")
    given.add_argument('--stdin', action='store_true', help='read the fields from standard input')
    parser.add_argument('--timeout', type=parse_seconds, default=LOOK, metavar='N',
                        help='wait for the service for N seconds (default: %(default)g)')


def call(args: argparse.Namespace) -> int:
    """Send a request, and print request and response as Python does."""
    kind = find_type(args.service_type, 'srv')
    try:
        request = fill(kind.Request(),
                       parse_values(sys.stdin.read() if args.stdin else args.values))
    except FieldError as error:
        raise ObcError(f'Failed to populate field: {error}') from error
    name = args.service_name if args.service_name.startswith('/') else f'/{args.service_name}'
    wanted = f'{args.service_type.split("/")[0]}/srv/{kind.__name__}'
    with join_graph() as graph:
        client = graph.node.create_client(kind, name)
        if not client.service_is_ready():
            print('waiting for service to become available...', flush=True)
        if not graph.until(client.service_is_ready, args.timeout):
            types = dict(graph.node.get_service_names_and_types()).get(name, [])
            if others := [each for each in types if each != wanted]:  # not the client's
                raise ObcError(f'{name} is of the type {", ".join(others)}, not {wanted}')
            raise ObcError(f'no service {name} within {args.timeout:g} s; '
                           'see obc service list')
        print(f'requester: making request: {request!r}\n', flush=True)
        response = graph.call(kind, name, request)
    print(f'response:\n{response!r}\n')
    return 0
