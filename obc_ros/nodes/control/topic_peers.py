# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Checks of the other nodes on the topics of a node: publishers and compatible QoS."""

from collections.abc import Iterable

from rclpy.node import Node
from rclpy.qos import qos_check_compatible, QoSCompatibility
from rclpy.topic_endpoint_info import TopicEndpointInfo


def find_faults(node: Node, topics: Iterable[str], shared: Iterable[str] = ()) -> dict[str, str]:
    """
    Return a message for each fault on the topics of a node.

    :param topics, shared: its resolved topics: those with at most one publisher, and the others.
    :return: messages by kind of fault.
    """
    own, topics, found = node.get_fully_qualified_name(), tuple(topics), {}
    for topic in (*topics, *shared):
        sources = node.get_publishers_info_by_topic(topic)
        if topic in topics and len(sources) > 1:
            names = ', '.join(sorted(map(_name, sources)))
            found[topic] = f'{len(sources)} publishers on {topic}: {names}'
        for sink in node.get_subscriptions_info_by_topic(topic):
            for source in sources:
                reason = own in (_name(source), _name(sink)) and _mismatch(source, sink)
                if reason:
                    found[f'{topic} QoS'] = (f'{_name(sink)} receives nothing from '
                                             f'{_name(source)} on {topic}: incompatible QoS '
                                             f'({reason})')
    return found


def _name(end: TopicEndpointInfo) -> str:
    return f'{end.node_namespace.rstrip("/")}/{end.node_name}'


def _mismatch(source: TopicEndpointInfo, sink: TopicEndpointInfo) -> str:
    # These are the profiles in use; a requested profile may leave policies to the middleware.
    compatibility, reason = qos_check_compatible(source.qos_profile, sink.qos_profile)
    if compatibility != QoSCompatibility.ERROR:
        return ''
    return str(reason).replace('ERROR: ', '').rstrip(';').replace(';', '; ').lower()
