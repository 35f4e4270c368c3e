# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The record of a solve: the tree of attempts, sums of work, and progress messages."""

import math

from hypothesis import given
from hypothesis import strategies as st
from obc_ros.core.ocp.solution import Certificate, Condition, MOST_ATTEMPTS, Status, Verdict
from obc_ros.core.solver.solve import solve
from obc_ros.core.solver.trace import DESCENT, describe_fault, GUESS, MESH, Trace
import problems
import pytest

TREES = st.recursive(st.integers(0, 5), lambda inner: st.lists(inner, max_size=4), max_leaves=40)


def record(trace, tree):
    """Record a nested list: each list is an attempt, each number is work."""
    if isinstance(tree, int):
        trace.spend(tree)
        return
    with trace.attempt('step'):
        for each in tree:
            record(trace, each)


def count(tree):
    return 0 if isinstance(tree, int) else 1 + sum(map(count, tree))


def add_up(tree):
    return tree if isinstance(tree, int) else sum(map(add_up, tree))


@given(TREES)
def test_the_tree_has_every_attempt_and_its_work(tree):
    trace = Trace()
    record(trace, tree)
    found = trace.attempts()
    assert len(found) == count(tree)
    assert [each.number for each in found] == list(range(1, len(found) + 1))
    assert all(each.parent < each.number for each in found)
    assert trace.work == add_up(tree)
    for each in found:
        inner = [other for other in found if other.parent == each.number]
        assert sum(other.work for other in inner) <= each.work
        assert all(each.begun <= other.begun <= each.begun + each.work for other in inner)


@given(TREES, st.integers(1, 20))
def test_the_most_detailed_attempts_are_left_out(tree, most):
    trace = Trace()
    record(trace, tree)
    every, found = trace.attempts(), trace.attempts(most)
    assert len(found) <= most
    numbers = {each.number for each in found}
    assert set(found) <= set(every)
    assert all(not each.parent or each.parent in numbers for each in found)


def test_an_attempt_counts_its_own_work_only():
    trace = Trace()
    with trace.attempt('beside'):
        trace.spend(10)
    with trace.attempt('descent'):
        trace.spend(3)
        with trace.attempt('mesh') as mesh:
            trace.spend(4)
            mesh.end(Verdict.CERTIFIED, cost=1.5, loss=1e-9)
    beside, descent, inner = trace.attempts()
    assert (beside.work, descent.work, inner.work) == (10, 7, 4)
    assert (inner.parent, inner.begun, inner.cost, inner.verdict) == (2, 13, 1.5, 'certified')
    assert descent.verdict is Verdict.STOPPED
    assert math.isnan(descent.cost)


def test_progress_names_what_is_tried_and_the_best_cost():
    trace = Trace()
    assert trace.describe() == 'solving'
    with trace.attempt('exact method'):
        assert trace.describe() == 'exact method'
    with trace.attempt('multistart'), trace.attempt(GUESS, 'bent line'):
        assert trace.describe() == 'start 1'
        trace.found(2.0, certified=False)
        assert trace.describe() == 'start 1: best 2 (not certified)'
        trace.found(2.5, certified=True)
        trace.found(3.0, certified=True)
        assert trace.describe() == 'start 1: best 2.5 (certified)'
    with trace.attempt(DESCENT):
        with trace.attempt(MESH):
            pass
        with trace.attempt(MESH), trace.attempt('bang arcs'):
            assert trace.describe() == 'start 1, mesh 2, bang arcs: best 2.5 (certified)'
    with trace.attempt('multistart'), trace.attempt(GUESS):
        pass
    with trace.attempt('explanation', aside=True), trace.attempt('related problem'):
        trace.found(-7.0, certified=True)
        assert trace.describe() == 'start 2, related problem: best 2.5 (certified)'


def test_an_attempt_that_raises_is_recorded():
    trace = Trace()
    with pytest.raises(ZeroDivisionError), trace.attempt('step'):
        trace.spend(2)
        raise ZeroDivisionError
    [attempt] = trace.attempts()
    assert (attempt.work, attempt.verdict) == (2, Verdict.STOPPED)


def test_a_solution_reports_its_attempts():
    found = solve(problems.build('goddard'))
    tree = {each.number: each for each in found.attempts}
    top = [each for each in found.attempts if not each.parent]
    assert [each.method for each in top][:5] == [
        'exact method', 'proof', 'coarse mesh', 'descent', 'multistart']
    descent = top[3]
    assert descent.verdict is Verdict.CERTIFIED
    assert descent.cost == found.objective
    starts = [each for each in found.attempts if each.method == GUESS]
    assert starts[0].what == 'straight line'
    assert tree[starts[0].parent].method == 'coarse mesh'
    assert len(starts) == found.optimality.starts
    assert 'starts' in top[4].why


@pytest.mark.slow
def test_the_minima_of_the_search_are_reported():
    """The published minimum of the cart-pole is 58.81; the search also finds a lower one."""
    found = solve(problems.build('cart_pole'))
    assert found.optimality.starts > 1
    assert found.optimality.starts == sum(
        each.method == GUESS for each in found.attempts)
    assert found.optimality.minima[0] == found.objective
    assert found.optimality.minima[1] == pytest.approx(58.81, abs=0.01)


def test_a_closed_form_needs_one_attempt():
    found = solve(problems.build('lq_scalar_unit'))
    [attempt] = found.attempts
    assert (attempt.method, attempt.what, attempt.work) == ('exact method', 'riccati', 0)
    assert (attempt.verdict, attempt.cost) == (Verdict.CERTIFIED, found.objective)


def test_an_infeasible_solution_reports_its_proof():
    found = solve(problems.pose({'x': 'v', 'v': 'u'}, 'u**2', (0, 0), 1, terminal_constraints=[
        'x - 1', 'v'], input_bounds={'u': [-3.9, 3.9]}))   # 4 is needed for T = 1
    assert found.status is Status.INFEASIBLE, found.message
    proofs = [each for each in found.attempts if each.verdict is Verdict.PROVED]
    assert proofs
    assert found.message in {each.why for each in proofs}


@pytest.mark.slow
def test_the_attempts_of_a_long_search_are_bounded():
    found = solve(problems.build('terminal_wells_plane'))
    assert 1 < len(found.attempts) <= MOST_ATTEMPTS


def test_the_effort_says_what_was_tried_when_the_time_was_up():
    """The first note counts, with the outermost attempts; what ends the work comes after it."""
    trace = Trace()
    with trace.attempt('coarse mesh'), trace.attempt(GUESS), trace.attempt('collocation'):
        trace.note_time_up()
    with trace.attempt('multistart'):
        trace.note_time_up()
    assert trace.describe_effort() == (
        '1 initial guess was tried, 0 led to a path on a coarse mesh; the time was up during '
        'coarse mesh, initial guess')


def test_the_effort_counts_guesses_of_the_problem_itself():
    trace = Trace()
    assert trace.describe_effort() == ''
    with trace.attempt(GUESS) as attempt:
        attempt.end(Verdict.CONVERGED)
    assert trace.describe_effort() == (
        '1 initial guess was tried, 1 led to a path on a coarse mesh')
    with trace.attempt('related problem', aside=True), trace.attempt(GUESS) as attempt:
        attempt.end(Verdict.CONVERGED)
    with trace.attempt(GUESS) as attempt:
        attempt.end(Verdict.NOT_CONVERGED)
    assert trace.describe_effort() == (
        '2 initial guesses were tried, 1 led to a path on a coarse mesh')


def test_each_condition_that_fails_has_words_of_its_own():
    tolerances = dict.fromkeys(Condition, 1e-4)
    words = [describe_fault(Certificate(dict.fromkeys(Condition, 0.0) | {each: 0.2}, tolerances))
             for each in Condition]
    assert all(each.endswith(': residual 2.0e-01, allowed 1e-04') for each in words)
    assert len({each.partition(':')[0] for each in words}) == len(Condition)


def test_a_residual_that_cannot_be_computed_is_said_in_words():
    certificate = Certificate({Condition.DYNAMICS: float('inf')}, {Condition.DYNAMICS: 1e-6})
    assert describe_fault(certificate).startswith(
        'the residual of dynamics could not be computed: ')
    assert certificate.sentence == (
        'dynamics is not shown to hold: its residual could not be computed')
