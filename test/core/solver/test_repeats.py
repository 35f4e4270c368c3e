# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Repeated problems with other numbers: results with and without a cache agree."""

from dataclasses import replace

import numpy as np
from obc_ros.core.ocp.certificate.replay import LEAST_COST
from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.program_cache import Cache
from obc_ros.core.solver.solve import solve
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
    """Yield a problem and a copy with random relative changes up to 1e-3 of its numbers."""
    mapping, chance = problems.read(name), np.random.default_rng(0)
    yield problems.build(mapping)
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


def wall(room, limit=5.0):
    return problems.pose({'x': '-0.3*x + u'}, 'u**2', [1 + room], 4,
                         input_bounds={'u': [0, limit]},
                         path_constraints=[{'expr': 'x - 1', 'lower': 0}])


def drift(speed):
    return problems.pose({'x': 'a - u'}, '(u - a)**2 + 100*(x + 1)**4', [1], 2,
                         parameters={'a': speed}, terminal_constraints=['x - 1'])


def bounded_ascent(limit):
    return problems.pose({'x': 'v', 'v': 'u'}, 'u**2', [0, 1], 1,
                         terminal_constraints=['x', 'v + 1'], state_bounds={'x': [None, limit]})


def effort(weight):
    return problems.pose({'x': 'sin(x) + u'}, 'a*u**2 + x**4', [1], 1, parameters={'a': weight})


def two_wells(start):
    return problems.pose({'x': 'u'}, 'u**2/2', (start,), 1, terminal_cost='5*(x**2 - 1)**2')


def swing_up(T, limit=1.0):
    return problems.pose({'th': 'w', 'w': 'u - sin(th)'}, 'u**2', [0, 0], T,
                         input_bounds={'u': [-limit, limit]},
                         terminal_constraints=['th - 3.141592653589793', 'w'])


NEIGHBOURS = {
    'wall 0.1': lambda: wall(0.1), 'wall 0.2': lambda: wall(0.2), 'drift 20': lambda: drift(20),
    'drift 18': lambda: drift(18), 'drift 0': lambda: drift(0),
    'ascent 0.1': lambda: bounded_ascent(0.1), 'ascent 0.12': lambda: bounded_ascent(0.12),
    'ascent -0.1': lambda: bounded_ascent(-0.1),
    'wells 0.1': lambda: two_wells(0.1), 'wells -0.1': lambda: two_wells(-0.1),
    'swing 6': lambda: swing_up(6), 'swing 5.5': lambda: swing_up(5.5),
    'swing 6 weak': lambda: swing_up(6, 0.9), 'fuel 2': lambda: minimum_fuel(2.0, 'u'),
    'fuel 1.9': lambda: minimum_fuel(1.9, 'u'), 'fuel 9.5': lambda: minimum_fuel(9.5, 'u'),
    'effort 1': lambda: effort(1), 'effort 0.9': lambda: effort(0.9),
    'effort -1': lambda: effort(-1)}


def test_an_answer_to_a_distant_problem_hides_no_proof():
    """The weight of the effort becomes negative: there is no lower bound."""
    cache = Cache()
    assert solve(effort(1), cache=cache).status is Status.SOLVED
    found = solve(effort(-1), cache=cache)
    assert found.status is Status.NOT_CONVERGED
    assert 'no lower bound' in found.message


@pytest.mark.slow
def test_an_answer_does_not_depend_on_what_was_asked_before():
    """Each problem is also asked twice; the minimum fuel from 9.5 cannot be had within 6 s."""
    answers = {name: solve(pose(), cache=Cache()) for name, pose in NEIGHBOURS.items()}
    cache, order = Cache(), list(NEIGHBOURS) * 2
    np.random.default_rng(0).shuffle(order)
    for name in order:
        alone, found = answers[name], solve(NEIGHBOURS[name](), cache=cache)
        assert found.status is alone.status, (name, order)
        if alone.status is Status.SOLVED:
            assert found.objective == pytest.approx(alone.objective, rel=SAME_COST), (name, order)
