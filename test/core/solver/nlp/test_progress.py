# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What stops a solver, and what stops a part of the work only."""

from obc_ros.core.solver.nlp.progress import ProgressMonitor
import pytest


@pytest.mark.parametrize('each', [1, 7, 16])
def test_a_part_ends_after_its_work_and_not_the_whole(each: int) -> None:
    """However the work is spread over solvers; what comes after it has none left."""
    whole = ProgressMonitor()
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


def test_a_part_of_a_part_takes_from_both() -> None:
    """And ends with either."""
    part = ProgressMonitor().part(100)
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


def test_iterations_end_a_solver_and_not_a_part() -> None:
    """As they end one of the whole work."""
    part = ProgressMonitor().part(1000)
    part.limit(5, 10)
    assert [part.step(0.0, 0.0) for _ in range(5)] == [False] * 4 + [True]
    assert part.spent
    assert not part.stopped
    part.limit(5, 10)
    assert not part.step(0.0, 0.0)


def test_what_cancels_the_whole_cancels_a_part() -> None:
    """At the next iteration, and for good."""
    wishes = iter([False, False, True, False])
    whole = ProgressMonitor(report=lambda *_: next(wishes))
    part = whole.part(1000)
    assert [part.step(0.0, 0.0) for _ in range(4)] == [False, False, True, True]
    assert part.stopped == whole.stopped == 'cancelled'
    assert whole.part(1000).stopped == 'cancelled'


def test_a_part_has_no_more_time_than_the_whole() -> None:
    """Nor more than its own."""
    assert ProgressMonitor(0.0).part(1000).step(0.0, 0.0)
    whole = ProgressMonitor(60.0)
    part = whole.part(1000, 0.0)
    assert part.step(0.0, 0.0)
    assert part.stopped == 'timed_out'
    assert not whole.stopped
