# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc topic`: list topics and their endpoints; print, time and publish messages."""

import argparse
from collections import deque
from collections.abc import Mapping, Sequence
from functools import partial
import statistics
import sys
import time
from typing import Any

from obc_ros.cli.ros2.verbs import (
    add_direct,
    add_list,
    add_verbs,
    list_names,
    parse_seconds,
    run_verb,
)
from obc_ros.cli.ros2.yaml_messages import (
    convert_to_yaml,
    FieldError,
    fill,
    find_type,
    parse_values,
)
from obc_ros.cli.ros_graph import Graph, join_graph, LOOK
from obc_ros.cli.terminal import Parser
from obc_ros.core.text.errors import ObcError, quote
from rclpy.qos import (
    DurabilityPolicy,
    QoSDurabilityPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
    ReliabilityPolicy,
)

TRUNCATED = 128  # entries of sequences and characters of texts that are printed by default
DEPTH = 10       # queue of messages to be printed
WINDOW = 10000   # messages of which a rate is the average
run = run_verb


def add_arguments(parser: Parser) -> None:
    """Declare the verbs."""
    add_verbs(parser, {
        'list': ('list the topics', '--show-types', partial(add_list, what='topics'),
                 partial(list_names, look=lambda node: node.get_topic_names_and_types())),
        'info': ('show publishers and subscribers', '/command --verbose',
                 _info_arguments, print_info),
        'echo': ('print messages', '/state --once', _echo_arguments, echo),
        'hz': ('print the rate of messages', '/command', _hz_arguments, print_rate),
        'pub': ('publish a message',
                '--once /reference obc_ros/msg/Trajectory "$(cat reference.yaml)"',
                _pub_arguments, publish_message)})


def _info_arguments(parser: Parser) -> None:
    _add_topic(parser)
    parser.add_argument('-v', '--verbose', action='store_true', help='show nodes and QoS too')
    add_direct(parser)


def _echo_arguments(parser: Parser) -> None:
    _add_topic(parser)
    parser.add_argument('message_type', nargs='?', help='message type (default: looked up)')
    _add_qos(parser)
    parser.add_argument('--once', action='store_true', help='print one message and end')
    parser.add_argument('--timeout', type=parse_seconds, metavar='N', help='end after N seconds')
    parser.add_argument('--field', metavar='A.B', help='print one field')
    parser.add_argument('-f', '--full-length', action='store_true',
                        help='print long sequences and texts in full')
    parser.add_argument('-l', '--truncate-length', type=int, default=TRUNCATED, metavar='N',
                        help='print N entries of long ones (default: %(default)d)')
    parser.add_argument('--no-arr', action='store_true', help='omit sequences')
    parser.add_argument('--no-str', action='store_true', help='omit texts')
    add_direct(parser, lists=False)


def _hz_arguments(parser: Parser) -> None:
    _add_topic(parser)
    parser.add_argument('-w', '--window', type=int, default=WINDOW, metavar='N',
                        help='average over the last N messages (default: %(default)d)')
    add_direct(parser, lists=False)


def _pub_arguments(parser: Parser) -> None:
    _add_topic(parser)
    parser.add_argument('message_type', help='message type: obc_ros/msg/Trajectory')
    given = parser.add_mutually_exclusive_group()
    given.add_argument('values', nargs='?', default='{}',
                       help="fields in YAML: '{a: 1, b: [1, 2]}' (default: none)")
    given.add_argument('--stdin', action='store_true', help='read the fields from standard input')
    often = parser.add_mutually_exclusive_group()
    often.add_argument('-1', '--once', action='store_true', help='one message')
    often.add_argument('-t', '--times', type=int, default=0, metavar='N', help='N messages')
    parser.add_argument('-r', '--rate', type=parse_seconds, default=1.0, metavar='N',
                        help='N messages per second (default: %(default)g)')
    parser.add_argument('-w', '--wait-matching-subscriptions', type=int, metavar='N',
                        help='wait for N subscriptions (default: 1 where messages are counted, '
                             'else 0)')
    parser.add_argument('--max-wait-time-secs', type=parse_seconds, metavar='N',
                        help='wait at most N seconds for them')
    parser.add_argument('--keep-alive', type=parse_seconds, default=0.1, metavar='N',
                        help='stay for N seconds after the last message (default: %(default)g)')
    _add_qos(parser)


def _add_topic(parser: Parser) -> None:
    parser.add_argument('topic_name', help='name of the topic: /command')


def _add_qos(parser: Parser) -> None:
    parser.add_argument('--qos-depth', type=int, metavar='N', help='queue depth')
    parser.add_argument('--qos-reliability', choices=QoSReliabilityPolicy.short_keys(),
                        help='whether lost messages are sent again')
    parser.add_argument('--qos-durability', choices=QoSDurabilityPolicy.short_keys(),
                        help='whether late subscribers receive earlier messages')


def print_info(args: argparse.Namespace) -> int:
    """Print type, publishers and subscriptions of a topic."""
    topic = _full(args.topic_name)
    end = '\n\n' if args.verbose else '\n'
    with join_graph() as graph:
        _type_name(graph, topic)
        node = graph.node
        graph.settle(lambda: [str(each) for each in (
            *node.get_publishers_info_by_topic(topic),
            *node.get_subscriptions_info_by_topic(topic))], args.spin_time)
        print(f'Type: {_type_name(graph, topic)}', end=end)
        for what, ends in (('Publisher', node.get_publishers_info_by_topic(topic)),
                           ('Subscription', node.get_subscriptions_info_by_topic(topic))):
            print(f'{what} count: {len(ends)}', end=end)
            for each in ends if args.verbose else ():
                print(each, end=end)
    return 0


def echo(args: argparse.Namespace) -> int:
    """Print the messages of a topic, or one of their fields."""
    topic = _full(args.topic_name)
    path = _path(args.field)
    options = {'truncate': None if args.full_length else max(args.truncate_length, 0),
               'no_arr': args.no_arr, 'no_str': args.no_str}
    wrong: list[ObcError] = []
    count = 0

    def tell(message: Any) -> None:
        nonlocal count
        if wrong or (args.once and count):
            return
        try:
            value = _field(message, path)
        except ObcError as error:
            wrong.append(error)
            return
        count += 1
        if hasattr(value, 'get_fields_and_field_types'):
            print(convert_to_yaml(value, **options), end='---\n', flush=True)
        else:
            print(value, end='\n---\n', flush=True)

    with join_graph() as graph:
        kind = find_type(args.message_type or _type_name(graph, topic), 'msg')
        _field(kind(), path)
        graph.node.create_subscription(kind, topic, tell, _fitting(graph, topic, args))
        graph.until(lambda: wrong or (args.once and count), args.timeout or float('inf'))
    if wrong:
        raise wrong[0]
    return 0


def print_rate(args: argparse.Namespace) -> int:
    """Print the rate of the messages of a topic once a second."""
    topic = _full(args.topic_name)
    times: deque[int] = deque(maxlen=max(args.window, 1) + 1)  # [ns]
    with join_graph() as graph:
        kind = find_type(_type_name(graph, topic, float('inf')), 'msg')
        profile = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        graph.node.create_subscription(
            kind, topic, lambda _: times.append(time.monotonic_ns()), profile, raw=True)
        told = 0
        while True:
            graph.until(lambda due=told + 10**9: len(times) > 1 and times[-1] >= due,
                        float('inf'))
            if told:
                _tell_rate(times)
            told = times[-1]


def _tell_rate(times: Sequence[int]) -> None:
    steps = [(after - before) * 1e-9 for before, after
             in zip(list(times)[:-1], list(times)[1:], strict=True)]
    print(f'average rate: {1.0 / statistics.fmean(steps):.3f}\n'
          f'\tmin: {min(steps):.3f}s max: {max(steps):.3f}s '
          f'std dev: {statistics.pstdev(steps):.5f}s window: {len(steps)}', flush=True)


def publish_message(args: argparse.Namespace) -> int:
    """Publish a message, once or at a rate."""
    topic = _full(args.topic_name)
    kind = find_type(args.message_type, 'msg')
    given = sys.stdin.read() if args.stdin else args.values
    times = 1 if args.once else args.times
    wanted = args.wait_matching_subscriptions
    wanted = int(times > 0) if wanted is None else wanted
    with join_graph() as graph:
        message = _filled(kind, given, graph)
        publisher = graph.node.create_publisher(
            kind, topic, _override(QoSProfile(depth=args.qos_depth or DEPTH), args))
        if publisher.get_subscription_count() < wanted:
            print(f'Waiting for at least {wanted} matching subscription(s)...', flush=True)
        if not graph.until(lambda: publisher.get_subscription_count() >= wanted,
                           args.max_wait_time_secs or float('inf')):
            raise ObcError(f'Timed out waiting for subscribers: {topic} has '
                           f'{publisher.get_subscription_count()} of {wanted}')
        print('publisher: beginning loop', flush=True)
        count = 0
        while True:
            count += 1
            print(f'publishing #{count}: {message!r}\n', flush=True)
            publisher.publish(message)
            if count == times:
                break
            graph.until(lambda: False, 1.0 / args.rate)
            message = _filled(kind, given, graph)
        graph.until(lambda: False, args.keep_alive)
    return 0


def _filled(kind: Any, given: str, graph: Graph) -> Any:
    try:
        return fill(kind(), parse_values(given), now=graph.node.get_clock().now().to_msg())
    except FieldError as error:
        raise ObcError(f'Failed to populate field: {error}') from error


def _full(topic: str) -> str:
    return topic if topic.startswith('/') else f'/{topic}'


def _type_name(graph: Graph, topic: str, timeout: float = LOOK) -> str:
    """Return the type of a topic, waiting at most `timeout` [s] for it."""
    def look() -> Any:
        return dict(graph.node.get_topic_names_and_types()).get(topic)

    types = look() or graph.until(look, min(timeout, 1.0))
    if not types and timeout > 1.0:
        print(f'WARNING: topic [{topic}] does not appear to be published yet', file=sys.stderr,
              flush=True)
        types = graph.until(look, timeout - 1.0)
    if not types:
        there = [name for name, _ in graph.node.get_topic_names_and_types()]
        raise ObcError(f'Could not determine the type for the passed topic: no {topic} within '
                       f'{timeout:g} s; there is {", ".join(sorted(there)) or "none"}')
    if len(types) > 1:
        raise ObcError(f"{topic} has more than one type: {', '.join(types)}; name one of them")
    return str(types[0])


def _fitting(graph: Graph, topic: str, args: argparse.Namespace) -> QoSProfile:
    """Return a profile that all publishers of a topic offer, unless arguments set another."""
    ends = graph.until(partial(graph.node.get_publishers_info_by_topic, topic), LOOK)
    offers = [each.qos_profile for each in ends]
    profile = QoSProfile(depth=args.qos_depth or DEPTH)
    profile.reliability = ReliabilityPolicy.BEST_EFFORT
    if offers and all(each.reliability == ReliabilityPolicy.RELIABLE for each in offers):
        profile.reliability = ReliabilityPolicy.RELIABLE
    if offers and all(each.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in offers):
        profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
    return _override(profile, args)


def _override(profile: QoSProfile, args: argparse.Namespace) -> QoSProfile:
    if args.qos_reliability:
        profile.reliability = QoSReliabilityPolicy.get_from_short_key(args.qos_reliability)
    if args.qos_durability:
        profile.durability = QoSDurabilityPolicy.get_from_short_key(args.qos_durability)
    return profile


def _path(field: str | None) -> list[str]:
    if field is None:
        return []
    path = [each for each in field.split('.') if each]
    if not path:
        raise ObcError(f"Invalid field value '{quote(field)}'")
    return path


def _field(message: Any, path: list[str]) -> Any:
    for name in path:
        fields: Mapping[str, str] = getattr(message, 'get_fields_and_field_types', dict)()
        if name not in fields:
            raise ObcError(f"Invalid field '{'.'.join(map(quote, path))}': no '{quote(name)}'"
                           + (f'; wanted {", ".join(fields)}' if fields else ''))
        message = getattr(message, name)
    return message
