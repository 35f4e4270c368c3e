# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Which of several publishers of states is used, from the numbers of their messages."""

from hypothesis import given, strategies
from obc_ros.nodes.control.topic_peers import FAR, Source, SourceWatch


@given(strategies.integers(0, 10**6), strategies.lists(strategies.integers(1, FAR), max_size=50))
def test_messages_of_one_publisher_are_used_whatever_is_lost(first: int, gaps: list[int]) -> None:
    """Its numbers grow; some are lost on the way."""
    watch, number = SourceWatch(), first
    assert watch.identify(first, 0.0, 0.5) is Source.SAME
    for k, gap in enumerate(gaps):
        number += gap
        assert watch.identify(number, 0.01 * k, 0.5) is Source.SAME


def test_a_second_publisher_is_not_used_until_the_first_is_silent() -> None:
    """One that began later has smaller numbers, one that began long before larger ones."""
    for other in (3, 10**6):
        watch = SourceWatch()
        for k in range(100):
            assert watch.identify(5000 + k, 0.01 * k, 0.5) is Source.SAME
            assert watch.identify(other + k, 0.01 * k, 0.5) is Source.OTHER
        assert watch.identify(other + 100, 1.4, 0.5) is Source.OTHER   # the first spoke at 0.99 s
        assert watch.identify(other + 101, 1.5, 0.5) is Source.REPLACED
        assert watch.identify(other + 102, 1.51, 0.5) is Source.SAME
        assert watch.identify(5100, 1.52, 0.5) is Source.OTHER


def test_without_numbers_every_message_is_used() -> None:
    """Not every middleware counts messages."""
    watch = SourceWatch()
    assert {watch.identify(None, 0.1 * k, 0.5) for k in range(3)} == {Source.SAME}
