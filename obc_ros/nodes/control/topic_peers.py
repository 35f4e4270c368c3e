# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The other nodes on the topics of a controller: whose states are used, and faults."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import auto, Enum

from rclpy.node import Node
from rclpy.qos import qos_check_compatible, QoSCompatibility
from rclpy.topic_endpoint_info import TopicEndpointInfo

FAR = 1000   # messages: more are not lost in a row before the source counts as silent


class Source(Enum):
    """What a message tells of its publisher."""

    SAME = auto()
    OTHER = auto()      # a second publisher, not to be used
    REPLACED = auto()   # the first one is silent


@dataclass
class SourceWatch:
    """
    Which of several publishers of the states is used: the first, until it is silent.

    They are told apart by the numbers that the middleware gives their messages. rclpy does not
    say who has sent a message, but every publisher counts its own messages. Two that began
    together cannot be told apart by their numbers; the graph shows both.
    """

    _last: int | None = None
    _heard: float = 0.0

    def is_next(self, number: int | None, now: float) -> bool:
        """Return whether a message surely is of the same publisher; if not, `judge` it."""
        last = self._last   # the same number again is that of a message delivered twice
        if number is None or last is None or not last <= number <= last + FAR:
            return False
        self._last, self._heard = number, now
        return True

    def identify(self, number: int | None, now: float, patience: float) -> Source:
        """
        Return whose message this is.

        :param number: number of the message by its publisher; None: the middleware gives none.
        :param now: steady clock [s].
        :param patience: silence [s] after which another publisher is used.
        """
        if number is None or self.is_next(number, now):
            return Source.SAME
        is_first = self._last is None
        if not is_first and now - self._heard < patience:
            return Source.OTHER
        self._last, self._heard = number, now
        return Source.SAME if is_first else Source.REPLACED


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
