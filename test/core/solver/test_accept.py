# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Answers before the certificate: paths that meet all constraints, and the estimated excess."""

from dataclasses import replace
import math
import time

import numpy as np
from obc_ros.core.ocp.certificate.certificate import certify
from obc_ros.core.ocp.solution import Solution, Status
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.solver.bench import Task
from obc_ros.core.solver.solve import METHODS, solve
from obc_ros.core.text.errors import StatementError
import pytest

# x' = u from 0 to 1 in 1 s: u* = 1, J* = 1. With u = 1 + e cos(2 pi t), J = 1 + e^2/2.
EFFORT = {
    'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u'}, 'running_cost': 'u**2',
    'initial_state': {'x': 0}, 'terminal_constraints': ['x - 1'],
    'final_time': {'free': False, 'value': 1}}
# u = -1 or 1 in turn, ever faster: J approaches 0, which no input reaches.
CHATTERING = {
    'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u'}, 'running_cost': 'x**2 - u**2',
    'input_bounds': {'u': [-1, 1]}, 'initial_state': {'x': 0},
    'final_time': {'free': False, 'value': 1}}
# Not linear quadratic, not convex: no exact method solves it.
CUBIC = {
    'states': ['x', 'v'], 'inputs': ['u'], 'dynamics': {'x': 'v', 'v': 'u - v**3'},
    'running_cost': 'u**2 + x**2', 'initial_state': {'x': 1, 'v': 0},
    'terminal_constraints': ['x', 'v'], 'final_time': {'free': False, 'value': 2}}
# x'' = u from (1, 0), without an end: the Riccati equation has the minimum.
REGULATOR = {
    'states': ['x', 'v'], 'inputs': ['u'], 'dynamics': {'x': 'v', 'v': 'u'},
    'running_cost': 'x**2 + u**2', 'initial_state': {'x': 1, 'v': 0},
    'final_time': {'free': False, 'value': 6}}


def wave(size: float) -> Solution:
    """Return a path of EFFORT with u = 1 + size cos(2 pi t), with the costates of the minimum."""
    t = np.linspace(0.0, 1.0, 401)
    u = 1 + size * np.cos(2 * np.pi * t)
    # The integral of the line through samples of u, and of its square.
    h = np.diff(t)
    x = np.append(0.0, np.cumsum(h * (u[:-1] + u[1:]) / 2))
    cost = float(h @ (u[:-1]**2 + u[:-1]*u[1:] + u[1:]**2)) / 3
    lam = np.full((401, 1), -2.0)
    return Solution(Status.NOT_CONVERGED, '', cost, t, x[:, None], u[:, None], lam,
                    u**2 - 2*u, np.array([-2.0]))


@pytest.mark.parametrize('size', [0.01, 0.1, 1.0])
def test_estimated_excess_is_the_excess_where_the_states_cost_nothing(size):
    path = wave(size)
    certificate = certify(build_problem(EFFORT), path)
    assert certificate.feasible and not certificate.holds
    assert certificate.excess == pytest.approx(path.objective - 1.0, rel=1e-6)


@pytest.mark.parametrize('wrong', [0.05, -0.05])
def test_estimated_excess_counts_wrong_costates(wrong):
    path = wave(0.1)
    path = replace(path, lam=path.lam * (1 + wrong), nu=path.nu)   # they miss those at T
    certificate = certify(build_problem(EFFORT), path)
    assert certificate.excess > path.objective - 1.0


def test_estimated_excess_counts_losses_between_samples():
    """With u = t, J = 1/4; u = 0, far from it, minimises |u| - u/2 and costs nothing."""
    problem = build_problem({
        'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u'}, 'running_cost': 'abs(u)',
        'terminal_cost': '-x/2', 'input_bounds': {'u': [-1, 1]}, 'initial_state': {'x': 0},
        'final_time': {'free': False, 'value': 1}})
    t = np.linspace(0.0, 1.0, 6)
    path = Solution(Status.NOT_CONVERGED, '', 0.25, t, t[:, None]**2 / 2, t[:, None],
                    np.full((6, 1), -0.5), t / 2)
    certificate = certify(problem, path)
    assert certificate.feasible and not certificate.holds
    assert certificate.excess == pytest.approx(0.25, rel=1e-6)


def test_no_estimate_without_costates():
    path = wave(0.1)
    assert math.isnan(certify(build_problem(EFFORT), replace(path, lam=path.lam * np.nan)).excess)


def test_paths_of_a_regulator_cost_at_most_the_estimate_more():
    least = solve(build_problem(REGULATOR), method='riccati').objective
    kept: list[Solution] = []
    solve(build_problem(REGULATOR), method='transcription', accept='best', keep=kept.append)
    assert not kept[0].certified
    for path in kept:
        assert path.status is Status.FEASIBLE and path.feasible
        excess = path.objective - least
        assert -1e-9 <= excess <= path.certificate.excess + 1e-9
    assert kept[0].certificate.excess < 2 * (kept[0].objective - least)


@pytest.mark.parametrize(('accept', 'status'), [
    ('best', Status.FEASIBLE), ('certified', Status.TIMED_OUT)])
def test_when_the_time_is_up_the_path_is_the_answer_or_is_told(monkeypatch, accept, status):
    """The clock jumps over the time limit as soon as there is a path."""
    clock, late = time.monotonic, [0.0]
    monkeypatch.setattr(time, 'monotonic', lambda: clock() + late[0])
    found = solve(build_problem(REGULATOR), method='transcription', accept=accept,
                  keep=lambda path: late.append(late.pop() + 1e4))
    assert found.status is status
    assert found.feasible and not found.certified
    assert 'the path meets all constraints (nearest to its tolerance: ' in found.message
    assert (f'above that of the nearest local minimum by about {found.certificate.excess:.2g} '
            '(estimate)') in found.message
    assert found.first_path_time < 60.0


def test_first_path_ends_the_search():
    first = solve(build_problem(CUBIC), accept='path')
    assert first.status in (Status.FEASIBLE, Status.SOLVED)
    assert first.feasible
    assert 0.0 < first.first_path_time <= first.build_time + first.solve_time


@pytest.mark.parametrize('end', [0.5, 1.0])
def test_best_path_is_the_answer_of_a_search_that_ends_with_a_worse_one(monkeypatch, end):
    """The last path does not reach x = 1, or costs more: J = 1 + e^2/2."""
    def search(task: Task) -> Solution:
        for size in (0.2, 0.1, 0.3):
            task.best.take(task.problem, replace(path := wave(size), certificate=certify(
                task.problem, path)))
        last = wave(0.3)
        return replace(last, x=last.x * end)
    monkeypatch.setitem(METHODS, 'transcription', search)
    found = solve(build_problem(EFFORT), method='transcription', accept='best')
    assert found.status is Status.FEASIBLE
    assert found.objective == pytest.approx(1 + 0.1**2 / 2, rel=1e-4)


def test_time_of_the_first_path_is_told_of_every_answer():
    found = solve(build_problem(CUBIC))
    assert found.status is Status.SOLVED
    assert 0.0 < found.first_path_time <= found.build_time + found.solve_time
    found = solve(build_problem({**EFFORT, 'input_bounds': {'u': [-1, 0.5]}}))
    assert found.status is Status.INFEASIBLE
    assert math.isnan(found.first_path_time)


@pytest.mark.parametrize('accept', ['path', 'best'])
@pytest.mark.parametrize('change', [
    {'input_bounds': {'u': [-1, 0.999]}}, {'state_bounds': {'x': [None, 0.5]}},
    pytest.param({'path_constraints': [{'expr': 'u', 'upper': 0.9}]}, marks=pytest.mark.slow)])
@pytest.mark.parametrize('method', ['auto', 'transcription'])
def test_without_a_path_nothing_is_accepted(accept, change, method):
    found = solve(build_problem({**EFFORT, **change}), accept=accept, method=method)
    assert found.status not in (Status.SOLVED, Status.FEASIBLE)
    assert not found.feasible


@pytest.mark.parametrize('accept', ['path', pytest.param('best', marks=pytest.mark.slow)])
def test_path_of_a_problem_without_minimum_is_accepted(accept):
    found = solve(build_problem(CHATTERING), accept=accept)
    assert found.status is Status.FEASIBLE
    assert found.feasible and not found.certified and found.optimality is None
    assert 'no certificate of optimality' in found.message
    assert 0.0 <= found.objective + 1.0 <= found.certificate.excess   # the infimum is -1


def test_wrong_name_is_told():
    with pytest.raises(StatementError, match="^accept: 'paths' is unknown"):
        build_problem({**EFFORT, 'accept': 'paths'})
    with pytest.raises(StatementError, match='^accept: wanted a name'):
        build_problem({**EFFORT, 'accept': 1})
    assert build_problem({**EFFORT, 'accept': 'path'}).accept == 'path'
