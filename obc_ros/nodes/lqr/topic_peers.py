# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Who else is on a node's topics, and whether they can be heard."""

from collections.abc import Iterable

from rclpy.node import Node
from rclpy.qos import qos_check_compatible, QoSCompatibility
from rclpy.topic_endpoint_info import TopicEndpointInfo


def find_faults(node: Node, topics: Iterable[str], shared: Iterable[str] = ()) -> dict[str, str]:
    """
    Return a sentence for each thing that is wrong around a node's topics.

    Parameters
    ----------
    node : rclpy.node.Node
        The node.
    topics, shared : iterable of str
        Its topics, resolved: those that only one node should publish on, and the others.

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
                    found[f'{topic} QoS'] = (f'{_name(sink)} hears nothing of {_name(source)} on '
                                             f'{topic}: incompatible QoS ({reason})')
    return found


def _name(end: TopicEndpointInfo) -> str:
    return f'{end.node_namespace.rstrip("/")}/{end.node_name}'


def _mismatch(source: TopicEndpointInfo, sink: TopicEndpointInfo) -> str:
    # what the middleware tells of both ends: a profile that was asked for may leave things open
    compatibility, reason = qos_check_compatible(source.qos_profile, sink.qos_profile)
    if compatibility != QoSCompatibility.ERROR:
        return ''
    return str(reason).replace('ERROR: ', '').rstrip(';').replace(';', '; ').lower()
