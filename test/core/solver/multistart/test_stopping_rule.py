# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Which of two solutions is better, and whether multistart may stop: two pure functions."""

from dataclasses import replace
from itertools import product

from hypothesis import given
from hypothesis import strategies as st
from obc_ros.core.ocp.solution import Certificate, Condition, Solution, Status
from obc_ros.core.solver.multistart.multistart import better, Effort, explain_enough
from obc_ros.core.solver.options import MultistartOptions
import pytest

CERTIFIED, FEASIBLE, BROKEN = 'certified', 'feasible', 'not feasible'
FAILS = {CERTIFIED: (), FEASIBLE: (Condition.MINIMUM,), BROKEN: (Condition.DYNAMICS,)}
QUALITIES = (*FAILS, 'without a certificate')
OPTIONS = MultistartOptions(
    hard=1000, share=0.5, least_hard=12, least_bent=8, many_work=5000, lavish=50_000)


def give(cost, quality):
    """Return a solution with a cost; the certificate fails as the quality says."""
    certificate = None if quality not in FAILS else Certificate(
        {key: 2.0 if key in FAILS[quality] else 0.5 for key in Condition},
        dict.fromkeys(Condition, 1.0))
    return Solution(Status.NOT_CONVERGED, '', objective=cost, certificate=certificate)


@pytest.mark.parametrize(('one', 'other'), list(product(QUALITIES, QUALITIES)))
def test_a_clearly_cheaper_path_is_better_if_it_is_one(one, other):
    """A cost of 1 is no evidence without a path: dynamics may be violated."""
    best, new = give(2.0, one), give(1.0, other)
    wins = other in (CERTIFIED, FEASIBLE)
    assert (better(best, new) is new) == wins


@pytest.mark.parametrize(('one', 'other'), list(product(QUALITIES, QUALITIES)))
def test_a_dearer_path_is_better_only_if_the_other_is_no_path(one, other):
    """A cheaper feasible path shows that the certified one is no global minimum."""
    best, new = give(1.0, one), give(2.0, other)
    wins = other in (CERTIFIED, FEASIBLE) and one not in (CERTIFIED, FEASIBLE)
    assert (better(best, new) is new) == wins


@given(st.sampled_from(QUALITIES), st.sampled_from(QUALITIES), st.floats(-1e6, 1e6))
def test_of_equal_costs_the_first_is_kept_unless_the_other_shows_more(one, other, cost):
    best, new = give(cost, one), give(cost, other)
    shown = {FEASIBLE: 1, CERTIFIED: 2}
    assert (better(best, new) is new) == (shown.get(other, 0) > shown.get(one, 0))


def test_certified_costs_are_compared_more_closely_than_others():
    """Coarse costs differ by rounding and discretisation, certified ones by 1e-6 or less."""
    best = give(1.0, CERTIFIED)
    assert better(best, give(1 - 1e-4, FEASIBLE)) is best
    assert better(best, give(1 - 1e-4, CERTIFIED)) is not best
    assert better(best, give(1 - 1e-7, CERTIFIED)) is best


# A problem without any difficulty: one start, which led to the known minimum.
EASY = Effort(starts=1, wanted=1, before=500, spent=20, total=520, certified=True, complete=True)
BENT, ROUGH = {'bent': True}, {'rough': True}
HARD = {'before': 2000, 'total': 2100}


def test_the_reason_is_given_in_words():
    assert explain_enough(EASY, OPTIONS) == '1 start led to known minima only'
    assert explain_enough(replace(EASY, starts=3), OPTIONS).startswith('3 starts led to')


@pytest.mark.parametrize(('changes', 'least'), [
    ({}, 1), ({'wanted': 5}, 5), (BENT, 8), (BENT | {'wanted': 10}, 10), (ROUGH, 12),
    (BENT | ROUGH, 12), (HARD | {'stages': 3}, 12),
    (HARD | {'spent': 5000, 'total': 20_000}, 24),
    ({'uneven': True, 'spent': 5000, 'total': 20_000}, 24)])
def test_a_minimum_number_of_starts_is_tried(changes, least):
    effort = replace(EASY, **changes)
    for starts in range(30):
        stops = explain_enough(replace(effort, starts=starts), OPTIONS) != ''
        assert stops == (starts >= least), starts


@pytest.mark.parametrize('changes', [{'complete': False}, {'starts': 0}])
def test_another_start_is_tried_while_minima_may_be_missing(changes):
    assert explain_enough(replace(EASY, **changes), OPTIONS) == ''


@pytest.mark.parametrize(('spent', 'stops'), [(500, False), (502, True)])
def test_starts_may_take_their_part_of_the_work(spent, stops):
    """Half of all work: as much as the solution took."""
    effort = replace(EASY, spent=spent, total=500 + 501, complete=False)
    assert ('part of the work' in explain_enough(effort, OPTIONS)) == stops


def test_hard_problems_need_a_minimum_of_work():
    effort = replace(EASY, starts=60, before=2000, spent=4999, total=20_000)
    assert explain_enough(effort, OPTIONS) == ''
    assert explain_enough(replace(effort, spent=5000), OPTIONS) != ''


@pytest.mark.parametrize('changes', [BENT, ROUGH])
def test_starts_of_an_easy_problem_take_less_work_than_makes_it_hard(changes):
    effort = replace(EASY, **changes, spent=1001, total=20_000)
    assert 'more work than the solution' in explain_enough(effort, OPTIONS)
    for other in ({'spent': 999}, {'certified': False}, {'uneven': True}, {'before': 2000}):
        assert explain_enough(replace(effort, **other), OPTIONS) == '', other


@pytest.mark.parametrize('certified', [True, False])
@pytest.mark.parametrize(('spent', 'stops'), [(50_001, True), (49_999, False)])
def test_work_for_starts_is_limited(certified, spent, stops):
    effort = replace(EASY, starts=3, wanted=5, certified=certified, spent=spent, total=900_000)
    assert ('that further starts may take' in explain_enough(effort, OPTIONS)) == stops
