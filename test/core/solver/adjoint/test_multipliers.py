# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The fit of costates and multipliers along a path."""

import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.ocp.certificate.certificate import certify
from obc_ros.core.solver.adjoint.multipliers import solve_signed_least_squares
from obc_ros.core.solver.bench import build_bench, Task
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.options import DEFAULTS
from obc_ros.core.solver.program_cache import ProgramCache
from obc_ros.core.solver.solve import solve
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh
import problems
import pytest


@pytest.mark.parametrize('intervals', [24, 30, 45])
def test_densities_bend_at_mesh_points_where_these_are_the_samples(intervals):
    """Otherwise the samples have another integral of the density than the fit."""
    problem = problems.build('around_a_disc')
    bench = build_bench(Task(problem, ProgramCache(problem, DEFAULTS), Meter()))
    guess = bench.programs.guesser.line(problem, problem.final_time.value)
    guess.x[:, 1] += 0.5 * np.sin(np.pi * guess.t / guess.t[-1])   # above the disc
    outcome = bench.collocate(build_uniform_mesh(problem, intervals, 3), guess)
    assert outcome.converged
    course = bench.course(outcome)
    density = course.density_path.reshape(intervals, course.parts, 2, -1)
    assert np.abs(density).max() > 0
    first, last = density[:, 0, 0], density[:, -1, 1]
    for k in range(course.parts):
        for side in (0, 1):
            part = (k + side) / course.parts
            np.testing.assert_allclose(density[:, k, side], (1 - part) * first + part * last,
                                       atol=1e-9 * np.abs(density).max())
    samples = bench.programs.stated_integrator.samples(problem, course)
    assert certify(problem, samples).residuals['costate'] < 1e-3


@given(seed=st.integers(0, 10_000), equations=st.integers(1, 9), inequalities=st.integers(1, 30),
       unknowns=st.integers(1, 8), size=st.sampled_from((1e-6, 1.0, 1e6)))
def test_a_signed_least_squares_solution_satisfies_its_conditions(
        seed, equations, inequalities, unknowns, size):
    """The gradient vanishes; for v_i = 0 with v_i >= 0 it is not negative."""
    rng = np.random.default_rng(seed)
    A, G = (rng.normal(size=(rows, unknowns)) for rows in (equations, inequalities))
    b, g = size * rng.normal(size=equations), size * rng.normal(size=inequalities)
    positive = rng.random(unknowns) < 0.5
    v = solve_signed_least_squares(A, b, G, g, positive)
    slope = A.T @ (A @ v - b) + G.T @ np.minimum(G @ v - g, 0)
    near = 1e-6 * size * np.linalg.norm(np.vstack((A, G)))**2
    assert np.all(v[positive] >= -1e-7 * size)
    assert np.all(np.abs(slope[~positive]) <= near)
    assert np.all(slope[positive] >= -near)
    assert np.all(slope[positive] * v[positive] <= near * size)


def test_inequalities_that_can_hold_do_not_disturb_equations():
    """With rank 1, v = (3, .) minimises |A v - b|, and the inequality determines v_2."""
    A, G = np.array([[1.0, 0.0]]), np.array([[0.0, 1.0], [1.0, 0.0]])
    v = solve_signed_least_squares(A, np.array([3.0]), G, np.array([2.0, -9.0]),
                                   np.array([False, True]))
    assert v[0] == pytest.approx(3, abs=1e-6)
    assert v[1] >= 2 - 1e-6


def trade(fee):
    """
    Return the times at which a trader with a store begins or stops, and the least cost.

    The price (t - 2)^2 falls and rises; b is bought and s sold at rates up to 1, each for a fee.
    The stock of 0.5 is sold at once. What is bought around t = 2, for 2 a, is sold before t = 3,
    where price less fee is the price plus fee at 2 - a: a^2 + fee = (1 - 2 a)^2 - fee.
    """
    a = (2 - math.sqrt(1 + 6 * fee)) / 3

    def spend(first, last, sign):
        return ((last - 2)**3 - (first - 2)**3) / 3 + sign * fee * (last - first)

    return (0.5, 2 - a, 2 + a, 3 - 2 * a), (
        spend(2 - a, 2 + a, 1) - spend(0, 0.5, -1) - spend(3 - 2 * a, 3, -1))


@pytest.mark.slow
@pytest.mark.parametrize('fee', [0.01, 0.05])
def test_multipliers_where_all_inputs_are_at_bounds_have_the_right_signs(fee):
    """
    The store is empty in (0.5, 2 - a) with both inputs zero.

    No equation determines the multiplier of the empty store there, but the costate of the stock
    must stay between price less fee and price plus fee.
    """
    times, cost = trade(fee)
    found = solve(problems.pose(
        {'w': 'b - s', 't': '1'}, f'(t - 2)**2*(b - s) + {fee}*(b + s)', (0.5, 0),
        {'free': False, 'value': 3}, inputs=['b', 's'], input_bounds={'b': [0, 1], 's': [0, 1]},
        state_bounds={'w': [0, None]}))
    assert found.certified
    assert found.objective == pytest.approx(cost, abs=1e-7)
    assert found.switching_times == pytest.approx(times, abs=1e-5)


@pytest.mark.parametrize(('constraint', 'start', 'cost'), [
    ('x - 1', 1.0, 0.36), ('2*(x - 1)', 1.0, 0.36), ('x - 1000', 1000.0, 3.6e5)])
def test_a_wall_that_is_touched_throughout_is_certified_however_it_is_written(
        constraint, start, cost):
    """X' = u - 0.3 x along x = x(0) takes u = 0.3 x(0); the constraint is 0 but for rounding."""
    problem = problems.pose(
        {'x': 'u - 0.3*x'}, 'u**2', (start,), 4, input_bounds={'u': [0, 5 * start]},
        path_constraints=[{'expr': constraint, 'lower': 0, 'upper': None}])
    found = solve(problem)
    assert found.certified, found.message
    assert found.objective == pytest.approx(cost, rel=1e-6)


def test_a_wall_that_moves_is_certified():
    """X' = u along x = t takes u = 1."""
    found = solve(problems.pose(
        {'x': 'u'}, 'u**2', (0,), 4, input_bounds={'u': [0, 5]},
        path_constraints=[{'expr': 'x - t', 'lower': 0, 'upper': None}]))
    assert found.certified, found.message
    assert found.objective == pytest.approx(4.0, rel=1e-6)


@pytest.mark.slow
def test_a_bound_that_is_active_across_the_period_is_certified():
    """A heated house over a day: when the day begins does not change its cost."""
    def state(begin):
        t = f'(t - {begin})'
        outside = f'(5 + 6*sin(pi/12*({t} - 9)))'
        return problems.build({
            'states': ['Ta', 'Tw'], 'inputs': ['P'], 'initial_state': {'Ta': None, 'Tw': None},
            'dynamics': {'Ta': f'0.5*(Tw - Ta) + 0.15*({outside} - Ta) '
                               f'+ 0.6*(3 + 0.05*{outside})*P', 'Tw': '0.04*(Ta - Tw)'},
            'running_cost': f'(0.3 + 0.1*cos(pi/6*{t}))*P + 0.02*P**2', 'periodic': ['Ta', 'Tw'],
            'input_bounds': {'P': [0, 3]}, 'state_bounds': {'Ta': [20, 23]},
            'final_time': {'free': False, 'value': 24},
            'initial_guess': {'states': {'Ta': 20, 'Tw': 20}, 'inputs': {'P': 1}}})

    at_bound, inside = solve(state(0)), solve(state(7.5))
    assert at_bound.certified, at_bound.message
    assert inside.certified, inside.message
    assert at_bound.x[0, 0] == pytest.approx(20, abs=1e-4)
    assert inside.x[0, 0] > 20.1
    assert at_bound.objective == pytest.approx(inside.objective, rel=1e-5)
