# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Who else is on a node's topics, and whether they can be heard."""

from collections.abc import Iterable, Iterator

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import qos_check_compatible, QoSCompatibility, QoSProfile
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo


def faults(node: Node, single: Iterable[Subscription], others: Iterable[Subscription],
           publishers: Iterable[Publisher]) -> dict[str, str]:
    """
    Return a sentence for each thing that is wrong around a node's topics.

    Parameters
    ----------
    node : rclpy.node.Node
        The node.
    single, others : iterable of Subscription
        Its subscriptions: those that only one publisher should feed, and the others.
    publishers : iterable of Publisher
        Those whose topics only this node should publish on.

    """
    single, found = tuple(single), {}
    for subscription in (*single, *others):
        topic = subscription.topic_name
        sources = node.get_publishers_info_by_topic(topic)
        if subscription in single and len(sources) > 1:
            found[topic] = f'{len(sources)} publishers on {topic}: {_names(sources)}'
        for source in sources:
            reason = _mismatch(source.qos_profile, subscription.qos_profile)
            if reason:
                found[f'{topic} QoS'] = (f'nothing is heard from {_names([source])} on {topic}: '
                                         f'incompatible QoS ({reason})')
    for publisher in publishers:
        topic = publisher.topic_name
        sources = node.get_publishers_info_by_topic(topic)
        if len(sources) > 1:
            found[topic] = f'{len(sources)} publishers on {topic}: {_names(sources)}'
        for sink in node.get_subscriptions_info_by_topic(topic):
            reason = _mismatch(publisher.qos_profile, sink.qos_profile)
            if reason:
                found[f'{topic} QoS'] = (f'{_names([sink])} hears nothing of {topic}: '
                                         f'incompatible QoS ({reason})')
    return found


def _names(ends: Iterable[TopicEndpointInfo]) -> str:
    return ', '.join(sorted(_full_names(ends)))


def _full_names(ends: Iterable[TopicEndpointInfo]) -> Iterator[str]:
    for end in ends:
        yield f'{end.node_namespace.rstrip("/")}/{end.node_name}'


def _mismatch(offered: QoSProfile, requested: QoSProfile) -> str:
    compatibility, reason = qos_check_compatible(offered, requested)
    if compatibility != QoSCompatibility.ERROR:
        return ''
    return reason.replace('ERROR: ', '').rstrip(';').replace(';', '; ').lower()
