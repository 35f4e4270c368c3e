# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Meters: what ends a solver, and what ends only a part of the work."""

from obc_ros.core.solver.nlp.meter import Meter
import pytest


@pytest.mark.parametrize('each', [1, 7, 16])
def test_a_part_ends_after_its_budget_and_the_whole_continues(each: int) -> None:
    """All solvers of a part share its budget; later solvers of the part have none left."""
    whole = Meter()
    part = whole.part(100)
    steps = 0
    for _ in range(3):
        part.limit(1000, each)
        while not part.step(0.0, 0.0):
            steps += 1
    assert steps == 100 // each
    assert part.stopped == 'spent'
    assert not whole.stopped
    assert whole.iterations == part.iterations == steps + 3


def test_nested_parts_use_the_budgets_of_both() -> None:
    """The inner part ends with its own budget or with that of the outer part."""
    part = Meter().part(100)
    for wanted in ('spent', '', 'spent'):
        inner = part.part(60)
        inner.limit(1000, 10)
        for _ in range(3):
            inner.step(0.0, 0.0)
        if wanted:
            while not inner.step(0.0, 0.0):
                pass
        assert inner.stopped == wanted
    assert part.stopped == 'spent'


def test_a_limit_of_iterations_ends_a_solver_not_its_part() -> None:
    """The next solver of the part starts with a new limit."""
    part = Meter().part(1000)
    part.limit(5, 10)
    assert [part.step(0.0, 0.0) for _ in range(5)] == [False] * 4 + [True]
    assert part.spent
    assert not part.stopped
    part.limit(5, 10)
    assert not part.step(0.0, 0.0)


def test_cancelling_the_whole_cancels_its_parts() -> None:
    """A part is cancelled at the next iteration, and later parts at once."""
    cancelled = iter([False, False, True, False])
    whole = Meter(report=lambda *_: next(cancelled))
    part = whole.part(1000)
    assert [part.step(0.0, 0.0) for _ in range(4)] == [False, False, True, True]
    assert part.stopped == whole.stopped == 'cancelled'
    assert whole.part(1000).stopped == 'cancelled'


def test_a_part_ends_at_the_time_limit_of_the_whole() -> None:
    """It also ends at its own time limit, which leaves the whole running."""
    assert Meter(0.0).part(1000).step(0.0, 0.0)
    whole = Meter(60.0)
    part = whole.part(1000, 0.0)
    assert part.step(0.0, 0.0)
    assert part.stopped == 'timed_out'
    assert not whole.stopped
    with whole.trace.attempt('initial guess'):   # of the part, not of the whole
        assert 'the time was up' not in whole.trace.describe_effort()


def test_a_part_counts_its_own_effort() -> None:
    """The iterations of all parts add up in the whole; effort is that of one part."""
    whole = Meter()
    for number, each in ((3, 5), (2, 7)):
        part = whole.part()
        part.limit(1000, each)
        for _ in range(number):
            part.step(0.0, 0.0)
        part.credit(number * each)
        assert part.effort == number * each
        assert part.stopped == ''
    assert whole.trace.work == 3 * 5 + 2 * 7


def test_a_part_stops_at_once_when_another_part_is_cancelled() -> None:
    """Both belong to the whole, which is cancelled by the report of the other one."""
    whole = Meter(report=lambda *_: True)
    first, second = whole.part(), whole.part()
    assert second.step(0.0, 0.0)
    assert first.stopped == 'cancelled'
