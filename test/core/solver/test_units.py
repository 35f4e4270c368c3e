# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Solutions do not depend on units and origins, nor on small changes of a statement."""

from dataclasses import replace
import math

import casadi as ca
import numpy as np
from obc_ros.core.ocp.guess import Guess
from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.program_cache import Cache
from obc_ros.core.solver.solve import solve
import problems
import pytest
from scipy.optimize import minimize_scalar


def in_units(problem, *, scale=1.0, shift=0.0, cost=1.0, time=1.0):
    """Return a problem in y = scale x + shift, with its cost and its time multiplied."""
    k, c = np.full(problem.n, scale), np.full(problem.n, shift)
    final = problem.final_time
    times = {name: value * time for name, value in vars(final).items()
             if name != 'free' and value is not None}

    def of_y(value):
        return ca.substitute(value, problem.x, (problem.x - c) / k)

    return replace(
        problem, f=of_y(problem.f * k / time), L=of_y(problem.L * cost / time),
        V=of_y(problem.V * cost), psi=of_y(problem.psi), path=of_y(problem.path),
        x0=k * problem.x0 + c, x_lower=k * problem.x_lower + c, x_upper=k * problem.x_upper + c,
        final_time=replace(final, **times),
        guess=Guess(), structure='')


@pytest.mark.slow
@pytest.mark.parametrize('name, units', [
    # Saddles of a symmetric problem are distinguished from minima in any unit of the cost.
    ('nearest_of_a_parabola', {'cost': 1e-3}),
    ('nearest_of_a_parabola', {'scale': (1000, 0.1)}),
    ('nearest_of_a_parabola', {'shift': (-1.524, 3.297)}),
    # The reach of the inputs does not depend on the units of the states.
    ('floating_oscillator', {'scale': (0.1, 1, 1000, 10)}),
    ('floating_oscillator', {'scale': (1e-4, 1, 1e6, 10), 'time': 1e3}),
    # The best of many minima is found, whatever the scale of the search.
    ('f8_aircraft', {'scale': (1e-3, 1, 10)}),
    ('f8_aircraft', {'shift': (-0.7, -2.1, 3.3)}),
    ('reorientation', {'scale': (100, 0.01, 0.01, 1, 1000, 1e-3, 1000)}),
    ('aircraft_5', {'scale': (1e3, 1, 1e-2, 1, 10, 1), 'cost': 1e-4}),
    ('terminal_wells_plane', {'scale': (1e-3, 1e3), 'shift': (4, -5)}),
    ('brachistochrone', {'time': 1e-3, 'cost': 1e4, 'shift': (10, -20, 0)})])
def test_solutions_do_not_depend_on_units(name, units):
    problem, expected = problems.build(name), problems.read(name)['expected']
    found = solve(in_units(problem, **units))
    assert found.status is Status.SOLVED, found.message
    assert found.objective / units.get('cost', 1) == pytest.approx(
        expected['objective'], rel=expected['tolerance'], abs=expected['tolerance'])


def minimum_over_wells(x0):
    """Return the minimum over a grid of x(T); a line from x0 to x(T) costs (x(T) - x0)^2/2."""
    def cost(end):
        return (end - x0)**2 / 2 + 3 * (1 - math.cos(4 * end)) + (end - 2)**2

    return min(minimize_scalar(cost, bounds=(a, a + 0.1), options={'xatol': 1e-10}).fun
               for a in np.arange(-6, 6, 0.1))


@pytest.mark.parametrize('x0', [-0.01, 1e-3, 0.01, 0.3])
def test_a_nearby_origin_does_not_hide_distant_minima(x0):
    problem = problems.build('terminal_wells')
    found = solve(replace(problem, x0=np.array([x0])))
    assert found.status is Status.SOLVED
    assert found.objective == pytest.approx(minimum_over_wells(x0), rel=1e-6)


def test_a_similar_problem_with_another_best_minimum_is_solved():
    """From x0 = -1.5 the best minimum is near 1.56, from -1.8 near 0.08."""
    problem = problems.build('terminal_wells')
    cache = Cache()
    for x0, end in ((-1.5, 1.5), (-1.51, 1.5), (-1.8, 0), (-1.79, 0), (-1.5, 1.5)):
        found = solve(replace(problem, x0=np.array([x0])), cache=cache)
        assert found.status is Status.SOLVED
        assert found.x[-1, 0] == pytest.approx(end, abs=0.1)
        assert found.objective == pytest.approx(minimum_over_wells(x0), rel=1e-6)


def test_a_repeated_problem_starts_from_its_own_solution():
    """The guess is in the units of the first solution; in others it would be another path."""
    problem = problems.build('terminal_wells')
    cache = Cache()
    first, again = solve(problem, cache=cache), solve(problem, cache=cache)
    assert again.iterations < first.iterations / 10
    for x0 in (0.0, 0.1, -0.1, 0.2):
        found = solve(replace(problem, x0=np.array([x0])), cache=cache)
        assert found.objective == pytest.approx(minimum_over_wells(x0), rel=1e-6)


def shortest_to_a_point(x0, goal):
    """
    Return the length of a car's shortest path to a point: free heading, unit turning radius.

    An arc and a line, or two arcs: L. E. Dubins, Amer. J. Math. 79, 1957.
    """
    turn = np.array([[math.cos(x0[2]), math.sin(x0[2])], [-math.sin(x0[2]), math.cos(x0[2])]])
    x, y = turn @ (goal - x0[:2])
    lengths = []
    for side in (1, -1):   # the first arc is about (0, side); mirrored to the left
        distance, bearing = math.hypot(x, side * y - 1), math.atan2(side * y - 1, x)
        if distance >= 1:
            angle = bearing - math.acos(1 / distance) + math.pi / 2
            lengths.append(angle % (2 * math.pi) + math.sqrt(distance**2 - 1))
        if 1 <= distance <= 3:
            half = math.acos((3 + distance**2) / (4 * distance))
            for second in (bearing + half, bearing - half):
                centre = 2 * math.cos(second), 1 + 2 * math.sin(second)
                end = math.atan2(side * y - centre[1], x - centre[0])
                lengths.append((second + math.pi / 2) % (2 * math.pi)
                               + (second + math.pi - end) % (2 * math.pi))
    return min(lengths)


@pytest.mark.slow
@pytest.mark.parametrize('x0', [
    (0, 0, 0), (2e-3, -4e-4, 3e-3), (-0.026, 0.19, 0.239), (0.079, -0.021, 0.179)])
def test_a_car_finds_the_shortest_path_inside_its_turning_circle(x0):
    problem = problems.build('dubins_point_inside')
    found = solve(replace(problem, x0=np.array(x0, dtype=float)))
    assert found.status is Status.SOLVED
    best = shortest_to_a_point(np.array(x0), np.array([0, 0.5]))
    assert found.objective == pytest.approx(best, rel=1e-6)


@pytest.mark.slow
def test_distant_starts_do_not_follow_the_cached_path():
    problem = problems.build('dubins_point_inside')
    cache = Cache()
    for x0 in ((0, 0, 0), (0.32, -0.97, -0.29), (-1, 0.59, 0.11), (-0.4, -0.44, 0.94)):
        start = np.array(x0, dtype=float)
        found = solve(replace(problem, x0=start), cache=cache)
        assert found.status is Status.SOLVED
        assert found.objective == pytest.approx(
            shortest_to_a_point(start, np.array([0, 0.5])), rel=1e-6)


def test_a_similar_problem_takes_the_shorter_of_two_detours():
    """A start 1.57 further on forces a detour to either side, 13 times as expensive."""
    problem = problems.build('lane_change')
    change = {'x0': np.array([1.57, -2.19, -9.7e-4]), 'p_value': np.array([2.96, 99.64, 2.0])}
    cache = Cache()
    solve(problem, cache=cache)
    again, alone = (solve(replace(problem, **change), cache=kept) for kept in (cache, None))
    assert again.status is Status.SOLVED
    assert again.objective == pytest.approx(alone.objective, rel=1e-5)


@pytest.mark.slow
def test_an_order_three_bound_active_at_the_end_is_solved():
    """The cost changes with x(0) as dJ/dx0 = lam(0) predicts to first order."""
    problem = problems.build('robbins')
    step = np.array([-7e-4, -4e-4, -1.4e-3])
    there, here = solve(replace(problem, x0=problem.x0 + step)), solve(problem)
    assert there.status is Status.SOLVED, there.message
    assert there.objective - here.objective == pytest.approx(
        (there.lam[0] + here.lam[0]) / 2 @ step, rel=1e-2)
