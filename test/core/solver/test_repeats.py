# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Repeated problems with other numbers: results with and without a cache agree."""

from dataclasses import replace

import numpy as np
from obc_ros.core.ocp.certificate.replay import LEAST_COST
from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.solve import Cache, solve
import problems
import pytest

# Largest relative excess of a certified cost that the minimum condition of H permits.
SAME_COST = 1e-5
# Solved within 0.3 s: problems for every method, with and without absolute values, bounds, free T.
# `python benchmarks/repeats.py` solves all files.
QUICK = [
    'abs_off_centre', 'aircraft_5', 'di_energy', 'di_energy_speed_limit', 'di_free_time_energy',
    'di_fuel_abs', 'di_min_fuel', 'di_mintime_moving', 'di_mintime_rest', 'hager_hou_rao',
    'jerk_limited', 'lane_change', 'lateral_min_effort', 'linear_tangent',
    'lq_cubic_free', 'lq_scalar_unit', 'reinvestment', 'soap_film', 'straight_line_energy',
    'two_wheel_straight', 'unstable_mintime', 'zermelo_constant']


def minimum_fuel(start, dynamics):
    return problems.pose(
        {'x': 'v', 'v': dynamics}, 'abs(u)', (start, 0), 6, terminal_constraints=['x', 'v'],
        input_bounds={'u': [-1, 1]})


def test_repeated_minimum_fuel_has_the_known_cost():
    """Double integrator: J = 2 v, where v is the coasting speed and v (T - v) = x(0)."""
    cache = Cache()
    for start in (2.0, 1.9, 2.0):
        solution = solve(minimum_fuel(start, 'u'), cache=cache)
        assert solution.status is Status.SOLVED
        assert solution.objective == pytest.approx(6 - np.sqrt(36 - 4 * start), rel=1e-5)


def test_repeated_fuel_of_an_oscillator_agrees_without_cache():
    cache = Cache()
    for start in (2.0, 1.9, 2.0):
        shared, alone = (solve(minimum_fuel(start, 'u - x'), cache=kept) for kept in (cache, None))
        assert shared.status is alone.status is Status.SOLVED
        assert shared.objective == pytest.approx(alone.objective, rel=SAME_COST)


@pytest.mark.slow
@pytest.mark.parametrize('start', [0.1, 0.6])
def test_another_minimum_is_found_where_it_is_the_best(start):
    """With constant u from x(0) = s to x(1) = x the cost is (x - s)^2 / 2 + 5 (x^2 - 1)^2."""
    cache = Cache()
    for s in (start, -start):
        x = np.roots([20, 0, -19, -s])   # its derivative vanishes
        solution = solve(problems.pose({'x': 'u'}, 'u**2/2', (s,), 1,
                                       terminal_cost='5*(x**2 - 1)**2'), cache=cache)
        assert solution.status is Status.SOLVED
        assert solution.objective == pytest.approx(
            np.min((x - s)**2 / 2 + 5 * (x**2 - 1)**2), rel=SAME_COST)


@pytest.mark.slow
def test_solutions_of_several_set_points_are_kept():
    """A problem is solved from its own solution although seven others were solved since."""
    cache = Cache()
    first, again = ([solve(problems.pose(
        {'x': 'u - p*x**3'}, 'x**2 + u**2', (1.0,), 1, parameters={'p': 2.0**k}), cache=cache)
        for k in range(8)] for _ in range(2))
    for one, other in zip(first, again, strict=True):
        assert one.status is other.status is Status.SOLVED
        assert other.objective == pytest.approx(one.objective, rel=SAME_COST)
        assert 2 * other.iterations < one.iterations


@pytest.mark.slow
def test_a_contradiction_after_a_feasible_problem_is_found():
    """The terminal speed 310.2 exceeds the bound 310; the first problem ends at the bound."""
    mapping, cache = problems.read('missile'), Cache()
    assert solve(problems.build(mapping), cache=cache).status is Status.SOLVED
    beyond = {**mapping, 'terminal_constraints': [
        row.replace('310', '310.2') for row in mapping['terminal_constraints']]}
    found = solve(problems.build(beyond), cache=cache)
    assert found.status is Status.INFEASIBLE
    assert 'exclude each other' in found.message


def variants(name):
    """Yield a problem and three copies with random relative changes up to 1e-3 of its numbers."""
    mapping, chance = problems.read(name), np.random.default_rng(0)
    yield problems.build(mapping)
    for _ in range(3):
        problem = problems.build(mapping)
        x0, p = (value * (1 + 1e-3 * chance.uniform(-1, 1, len(value)))
                 for value in (problem.x0, problem.p_value))
        yield replace(problem, x0=np.clip(x0, problem.x_lower, problem.x_upper), p_value=p)


@pytest.mark.slow
@pytest.mark.parametrize('name', QUICK)
def test_results_agree_with_and_without_a_cache(name):
    cache = Cache()
    for one, other in zip(variants(name), variants(name), strict=True):
        shared, alone = solve(one, cache=cache), solve(other)
        assert shared.status is alone.status, (shared.message, alone.message)
        if alone.status is Status.SOLVED:
            assert shared.objective == pytest.approx(
                alone.objective, rel=SAME_COST, abs=SAME_COST * LEAST_COST)
