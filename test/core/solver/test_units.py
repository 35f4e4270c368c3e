# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""An answer does not depend on the units and origins of a statement, nor on small changes."""

from dataclasses import replace
import math

import casadi as ca
import numpy as np
from obc_ros.core.ocp.guess import Guess
from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.solve import Cache, solve
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
    # Saddles of a symmetric problem are told from minima whatever the cost is counted in,
    ('nearest_of_a_parabola', {'cost': 1e-3}),
    ('nearest_of_a_parabola', {'scale': (1000, 0.1)}),
    ('nearest_of_a_parabola', {'shift': (-1.524, 3.297)}),
    # what inputs reach, whatever states are,
    ('floating_oscillator', {'scale': (0.1, 1, 1000, 10)}),
    ('floating_oscillator', {'scale': (1e-4, 1, 1e6, 10), 'time': 1e3}),
    # and the best of many minima is found, whatever a search thinks is far.
    ('f8_aircraft', {'scale': (1e-3, 1, 10)}),
    ('f8_aircraft', {'shift': (-0.7, -2.1, 3.3)}),
    ('reorientation', {'scale': (100, 0.01, 0.01, 1, 1000, 1e-3, 1000)}),
    ('aircraft_5', {'scale': (1e3, 1, 1e-2, 1, 10, 1), 'cost': 1e-4}),
    ('terminal_wells_plane', {'scale': (1e-3, 1e3), 'shift': (4, -5)}),
    ('brachistochrone', {'time': 1e-3, 'cost': 1e4, 'shift': (10, -20, 0)})])
def test_units(name, units):
    problem, expected = problems.build(name), problems.read(name)['expected']
    found = solve(in_units(problem, **units))
    assert found.status is Status.SOLVED, found.message
    assert found.objective / units.get('cost', 1) == pytest.approx(
        expected['objective'], rel=expected['tolerance'], abs=expected['tolerance'])


def least_among_wells(x0):
    """From x0 a straight line to x(T) costs (x(T) - x0)^2/2: the least over a grid of x(T)."""
    def cost(end):
        return (end - x0)**2 / 2 + 3 * (1 - math.cos(4 * end)) + (end - 2)**2

    return min(minimize_scalar(cost, bounds=(a, a + 0.1), options={'xatol': 1e-10}).fun
               for a in np.arange(-6, 6, 0.1))


@pytest.mark.parametrize('x0', [-0.01, 1e-3, 0.01, 0.3])
def test_an_origin_nearby_does_not_hide_the_wells_further_off(x0):
    problem = problems.build('terminal_wells')
    found = solve(replace(problem, x0=np.array([x0])))
    assert found.status is Status.SOLVED
    assert found.objective == pytest.approx(least_among_wells(x0), rel=1e-6)


def test_a_neighbour_of_which_another_minimum_is_the_best():
    """From -1.5 the best well is the one near 1.56, from -1.8 that near 0.08."""
    problem = problems.build('terminal_wells')
    cache = Cache()
    for x0, end in ((-1.5, 1.5), (-1.51, 1.5), (-1.8, 0), (-1.79, 0), (-1.5, 1.5)):
        found = solve(replace(problem, x0=np.array([x0])), cache=cache)
        assert found.status is Status.SOLVED
        assert found.x[-1, 0] == pytest.approx(end, abs=0.1)
        assert found.objective == pytest.approx(least_among_wells(x0), rel=1e-6)


def test_asked_again_it_starts_from_its_own_answer():
    """In the units in which that was found: in others it would be another path."""
    problem = problems.build('terminal_wells')
    cache = Cache()
    first, again = solve(problem, cache=cache), solve(problem, cache=cache)
    assert again.iterations < first.iterations / 10
    for x0 in (0.0, 0.1, -0.1, 0.2):
        found = solve(replace(problem, x0=np.array([x0])), cache=cache)
        assert found.objective == pytest.approx(least_among_wells(x0), rel=1e-6)


def shortest_to_a_point(x0, goal):
    """
    Return the length of a car's shortest path to a point, any heading, unit turning radius.

    An arc and a line, or two arcs: L. E. Dubins, Amer. J. Math. 79, 1957.
    """
    turn = np.array([[math.cos(x0[2]), math.sin(x0[2])], [-math.sin(x0[2]), math.cos(x0[2])]])
    x, y = turn @ (goal - x0[:2])
    lengths = []
    for side in (1, -1):   # about (0, side) first; mirrored, so that it is to the left
        away, way = math.hypot(x, side * y - 1), math.atan2(side * y - 1, x)
        if away >= 1:
            angle = way - math.acos(1 / away) + math.pi / 2
            lengths.append(angle % (2 * math.pi) + math.sqrt(away**2 - 1))
        if 1 <= away <= 3:
            for way_2 in (way + math.acos((3 + away**2) / (4 * away)),
                          way - math.acos((3 + away**2) / (4 * away))):
                centre = 2 * math.cos(way_2), 1 + 2 * math.sin(way_2)
                end = math.atan2(side * y - centre[1], x - centre[0])
                lengths.append((way_2 + math.pi / 2) % (2 * math.pi)
                               + (way_2 + math.pi - end) % (2 * math.pi))
    return min(lengths)


@pytest.mark.slow
@pytest.mark.parametrize('x0', [
    (0, 0, 0), (2e-3, -4e-4, 3e-3), (-0.026, 0.19, 0.239), (0.079, -0.021, 0.179)])
def test_a_car_finds_the_shorter_way_to_a_point_inside_of_its_turning_circle(x0):
    problem = problems.build('dubins_point_inside')
    found = solve(replace(problem, x0=np.array(x0, dtype=float)))
    assert found.status is Status.SOLVED
    best = shortest_to_a_point(np.array(x0), np.array([0, 0.5]))
    assert found.objective == pytest.approx(best, rel=1e-6)


@pytest.mark.slow
def test_cars_from_further_away_are_not_led_along_the_first_ones_path():
    problem = problems.build('dubins_point_inside')
    cache = Cache()
    for x0 in ((0, 0, 0), (0.32, -0.97, -0.29), (-1, 0.59, 0.11), (-0.4, -0.44, 0.94)):
        start = np.array(x0, dtype=float)
        found = solve(replace(problem, x0=start), cache=cache)
        assert found.status is Status.SOLVED
        assert found.objective == pytest.approx(
            shortest_to_a_point(start, np.array([0, 0.5])), rel=1e-6)


def test_a_neighbour_that_has_to_wind_takes_the_shorter_of_two_ways():
    """Begun 1.57 further on it must take a longer way, 13 times as dear, to either side."""
    problem = problems.build('lane_change')
    change = {'x0': np.array([1.57, -2.19, -9.7e-4]), 'p_value': np.array([2.96, 99.64, 2.0])}
    cache = Cache()
    solve(problem, cache=cache)
    again, alone = (solve(replace(problem, **change), cache=kept) for kept in (cache, None))
    assert again.status is Status.SOLVED
    assert again.objective == pytest.approx(alone.objective, rel=1e-5)


@pytest.mark.slow
def test_a_bound_of_order_three_that_holds_at_the_end_needs_no_luck():
    """To within what the cost changes with x(0), to first order: dJ/dx0 = lam(0)."""
    problem = problems.build('robbins')
    step = np.array([-7e-4, -4e-4, -1.4e-3])
    there, here = solve(replace(problem, x0=problem.x0 + step)), solve(problem)
    assert there.status is Status.SOLVED, there.message
    assert there.objective - here.objective == pytest.approx(
        (there.lam[0] + here.lam[0]) / 2 @ step, rel=1e-2)
