# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Transcriptions: multi-block programs, Gauss and Runge-Kutta steps, against closed forms."""

from itertools import combinations, islice
import math

import casadi as ca
import numpy as np
from obc_ros.core.ocp.structure import Uneven
from obc_ros.core.solver.adjoint.costates import CostateIntegrator
from obc_ros.core.solver.adjoint.mesh_refinement import Error, refine_mesh
from obc_ros.core.solver.initial_guess import estimate_scales, Guesser
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.solve import solve
from obc_ros.core.solver.starts.cross_entropy import search_rollouts
from obc_ros.core.solver.transcription.block_program import assemble, Block, Piece
from obc_ros.core.solver.transcription.intervals import Pieces
from obc_ros.core.solver.transcription.local_minima import LocalMinima
from obc_ros.core.solver.transcription.mesh import (
    build_uniform_mesh,
    choose_cuts,
    HELD,
    Layout,
    LINEAR,
    Mesh,
    Path,
    Phase,
    split,
)
from obc_ros.core.solver.transcription.program import TightenedLimits, Transcription
import problems
import pytest

LQ = {
    'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'x + u'}, 'running_cost': '0.5*u**2',
    'terminal_cost': '0.5*x**2', 'initial_state': {'x': 1},
    'final_time': {'free': False, 'value': 1}}
# J = P(0)/2 with dP/dt = -2 P + P^2, P(1) = 1: P(0) = 2 / (1 + e^-2).
LQ_COST, LQ_COSTATE = 1 / (1 + np.exp(-2)), 2 / (1 + np.exp(-2))

LANE_CHANGE = {
    'states': ['px', 'py', 'theta'], 'inputs': ['v', 'phi'],
    'dynamics': {'px': 'v*cos(theta)', 'py': 'v*sin(theta)', 'theta': 'v/3*tan(phi)'},
    'running_cost': '(v - 10)**2 + phi**2', 'initial_state': {'px': 0, 'py': -2, 'theta': 0},
    'terminal_constraints': ['px - 100', 'py - 2', 'theta'],
    'input_bounds': {'v': [8, 12], 'phi': [-0.1, 0.1]},
    'final_time': {'free': False, 'value': 10}}


def solve_program_on(mapping, mesh, **limits):
    """Return the problem and the outcome of one program, started from the straight line."""
    problem = problems.build(mapping)
    mesh = mesh(problem)
    guess = Guesser(problem).line(problem, 1.0 if np.isnan(problem.final_time.value)
                                  else problem.final_time.value)
    program = Transcription(problem, mesh.layout)
    sizes = estimate_scales(problem, guess)
    count = len(mesh.layout.phases)
    durations = np.full(count, guess.t[-1] / count)
    bounds = TightenedLimits(limits.get('shortest', np.zeros(count)),
                             limits.get('longest', np.full(count, 1e3)), np.zeros(problem.n),
                             np.zeros(problem.n, dtype=bool), np.full(problem.n, np.nan))
    start = program.start(mesh, guess, durations, sizes)
    return problem, program.solve(problem, mesh, start, sizes, bounds, Meter())


def test_derivatives_of_a_program_equal_those_of_casadi():
    """Entries of the index are shared, repeated and constant."""
    v, own, shared = ca.SX.sym('v', 3), ca.SX.sym('own'), ca.SX.sym('shared', 2)
    g = ca.vertcat(v[0] * v[1] ** 2 + own, ca.sin(v[2]) * shared[0])
    cost = shared[1] * v[0] ** 2 * v[2] + own * ca.exp(v[1])
    block = Block(Piece(v, own, shared, g, cost), np.array([[0, 1, 2], [2, 3, 3], [3, 4, 6]]),
                  np.array([[2], [3], [2]]))
    program = assemble([block], 5, 2, 4)
    w, c = ca.MX.sym('w', 5), ca.MX.sym('c', 4)
    both, f, g_all = ca.vertcat(w, c), ca.MX(0), []
    part = ca.Function('part', [v, own, shared], [g, cost])
    for index, where in zip(block.index, block.own_index, strict=True):
        row, more = part(both[index.tolist()], c[where.tolist()], c[:2])
        f, g_all = f + more, [*g_all, row]
    g = ca.vertcat(*g_all)
    lam_f, lam = ca.MX.sym('lam_f'), ca.MX.sym('lam', 6)
    hessian = ca.triu(ca.hessian(lam_f * f + ca.dot(lam, g), w)[0])
    point = np.random.default_rng(0).normal(size=16)
    values = point[:5], point[5:9], point[9], point[10:]
    for found, wanted, count in (
            (program.derivatives['grad_f'], [f, ca.gradient(f, w)], 2),
            (program.derivatives['jac_g'], [g, ca.jacobian(g, w)], 2),
            (program.derivatives['hess_lag'], [hessian], 4)):
        expected = ca.Function('expected', [w, c, lam_f, lam][:count], wanted)
        for a, b in zip(found.call(list(values[:count])), expected.call(list(values[:count])),
                        strict=True):
            np.testing.assert_allclose(ca.densify(a).full(), ca.densify(b).full(), atol=1e-13)


@pytest.mark.parametrize('free', [False, True])
@pytest.mark.parametrize(('f', 'cost'), [
    (('y', 'u'), '1'), (('0*x', '3'), 'x + u'), (('k*x*y*sin(w)', 'u*x - cos(y)'), 'k*abs(u*y)'),
    (('sin(x*y) + u**2', 'u*w*exp(-x)'), '(x - y*u)**2 + w**2')])
def test_derivatives_of_many_intervals_equal_those_of_casadi(f, cost, free):
    """The rows, evaluated together, have the derivatives of each interval in their places."""
    problem = problems.build({
        'states': ['x', 'y'], 'inputs': ['u', 'w'], 'parameters': {'k': 2},
        'dynamics': dict(zip('xy', f, strict=True)), 'running_cost': cost,
        'initial_state': {'x': 1, 'y': 2}, 'final_time': {'free': False, 'value': 1}})
    piece = Pieces(problem, 0, free).interval
    nv, rows = 9 if free else 8, 40
    v, own, shared = (ca.MX.sym(name, size) for name, size in (
        ('v', nv), ('own', 1 if free else 2), ('shared', 7)))
    factor, lam = ca.MX.sym('factor'), ca.MX.sym('lam', 2)
    g, J = piece.functions[0](v, own, shared)
    both = factor * J + ca.dot(lam, g)
    given = [v, own, shared, factor, lam]
    wanted = ca.Function('wanted', given, [
        g, J, ca.gradient(J, v), ca.gradient(both, v), ca.jacobian(g, v), ca.hessian(both, v)[0]])
    chance = np.random.default_rng(1)
    points = [chance.uniform(0.5, 1.5, (rows, symbol.numel())) for symbol in given]
    points[2][:] = points[2][0]   # shared by all intervals
    result = np.empty((rows, piece.batch.outputs[-1].stop))
    piece.batch.of_joined(np.hstack(points), result)
    for k in range(rows):
        g, J, slope, both, jacobian, curvature = (result[k, part] for part in piece.batch.outputs)
        dense = np.zeros(nv), np.zeros((2, nv)), np.zeros((nv, nv))
        for matrix, place, entries in zip(
                dense, ((piece.places[0][0],), *piece.places[1:]),
                (slope, jacobian, curvature), strict=True):
            matrix[place] = entries
        expected = wanted(*(part[k] for part in points))
        for found, right in zip((g, J, dense[0], both, dense[1], dense[2]), expected, strict=True):
            np.testing.assert_allclose(found, ca.densify(right).full().reshape(found.shape),
                                       rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize('stages', [0, 3])
def test_the_excess_cost_has_order_four(stages):
    above = []
    for intervals in (4, 8, 16):
        _, outcome = solve_program_on(LQ, lambda p, n=intervals: build_uniform_mesh(p, n, stages))
        assert outcome.converged
        above.append(outcome.objective - LQ_COST)
    assert all(value > 0 for value in above)
    assert all(3.5 < np.log2(a / b) < 4.5 for a, b in zip(above, above[1:], strict=False))


@pytest.mark.parametrize('stages', [0, 3])
def test_costates_equal_the_gradient_of_the_cost(stages):
    """lam(0) = dJ/dx0 = P(0) x0, from the adjoint sweep and from the multipliers."""
    problem, outcome = solve_program_on(LQ, lambda p: build_uniform_mesh(p, 32, stages))
    course = CostateIntegrator(problem).extremal(problem, outcome, 2)
    assert course.lam[0, 0] == pytest.approx(LQ_COSTATE, abs=1e-6)
    np.testing.assert_allclose(course.lam_end[1::2], outcome.costates[1:], atol=1e-7)
    if stages:
        assert outcome.costates[0, 0] == pytest.approx(LQ_COSTATE, abs=1e-6)


@pytest.mark.parametrize('stages', [0, 3])
def test_integrating_the_input_meets_the_terminal_constraints(stages):
    """Integrate the returned input with solve_ivp; it ends at the required state."""
    from scipy.integrate import solve_ivp
    problem, outcome = solve_program_on(LANE_CHANGE, lambda p: build_uniform_mesh(p, 40, stages))
    path = outcome.path
    f = ca.Function('f', [problem.x, problem.u, problem.p], [problem.f, problem.L])

    def rate(t, z):
        u = path.inputs_at(np.array([t]), after=True)[0]
        return np.concatenate([value.full().ravel() for value in f(z[:3], u, problem.p_value)])

    z = np.append(problem.x0, 0.0)
    for a, b in zip(path.t[:-1], path.t[1:], strict=True):
        z = solve_ivp(rate, (a, b), z, 'DOP853', rtol=1e-11, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(z[:3], [100, 2, 0], atol=1e-6)
    assert z[3] == pytest.approx(outcome.objective, rel=1e-6)
    assert np.all(path.ua[:, 1] >= -0.1)
    assert np.all(path.ua[:, 1] <= 0.1)


def test_phases_of_free_duration_find_the_switching_time():
    """Minimum time of the double integrator from (1, 0.5): T = 0.5 + 2 sqrt(1.125)."""
    mapping = {
        'states': ['x', 'v'], 'inputs': ['u'], 'dynamics': {'x': 'v', 'v': 'u'},
        'running_cost': '1', 'initial_state': {'x': 1, 'v': 0.5},
        'terminal_constraints': ['x', 'v'], 'input_bounds': {'u': [-1, 1]},
        'final_time': {'free': True, 'lower': 0.1, 'upper': 10}}

    def mesh(problem):
        phases = (Phase(2, (HELD,)),) * 2
        return Mesh(Layout(phases, 0, True), np.full(4, 0.5), np.array([[-1.0], [1.0]]))

    _, outcome = solve_program_on(mapping, mesh)
    assert outcome.objective == pytest.approx(0.5 + 2 * np.sqrt(1.125), abs=1e-9)
    assert outcome.path.durations[0] == pytest.approx(0.5 + np.sqrt(1.125), abs=1e-9)


def test_splitting_a_mesh_keeps_its_points():
    problem = problems.build(LQ)
    mesh = build_uniform_mesh(problem, 3, 0)
    finer = split(mesh, np.array([1, 3, 2]))
    assert finer.layout.intervals == 6
    np.testing.assert_allclose(np.cumsum(finer.fractions)[[0, 3, 5]], np.cumsum(mesh.fractions))
    assert finer.layout.phases[0].modes == (LINEAR,)


def test_an_undefined_error_is_cut_as_an_infinite_one():
    """It is that of an interval in which f is undefined."""
    assert choose_cuts(np.array([math.nan, math.inf, 0.0, 64.0]), 1.0, 6.0, 4).tolist() == [
        4, 4, 1, 2]


def test_an_arc_of_zero_duration_is_not_refined():
    phase = Phase(2, (LINEAR,))
    mesh = Mesh(Layout((phase, phase), 0, False), np.full(4, 0.5), np.zeros((2, 1)))
    u = np.array([[0.0], [1.0], [5.0], [6.0]])
    path = Path(np.array([0.0, 0.5, 1.0, 1.0, 1.0]), np.zeros((5, 1)), np.zeros((4, 0, 1)),
                u, u + [[1.0], [-1.0], [1.0], [-1.0]], np.array([1.0, 0.0]))
    for share, counts in ((1e-3, [8, 2]), (10.0, [4, 4])):
        new = refine_mesh(mesh, path, np.zeros(0), [Error(np.ones(4), share, 1.0)], 1.0, 100)
        assert [each.intervals for each in new.layout.phases][1] <= counts[1]
        assert np.all(new.fractions > 0)
        assert new.fractions.sum() == pytest.approx(2)


def test_a_monitor_ends_a_solver_after_one_iteration():
    seen = []

    def report(phase, iteration, cost, infeasibility):
        seen.append(iteration)
        return iteration >= 3

    problem = problems.build(LANE_CHANGE)
    mesh = build_uniform_mesh(problem, 10, 3)
    guess = Guesser(problem).line(problem, 10.0)
    sizes = estimate_scales(problem, guess)
    program = Transcription(problem, mesh.layout)
    meter = Meter(10.0, report)
    outcome = program.solve(
        problem, mesh, program.start(mesh, guess, guess.durations, sizes), sizes,
        TightenedLimits(np.zeros(1), np.ones(1), np.zeros(3), np.zeros(3, dtype=bool),
                        np.full(3, np.nan)), meter)
    assert not outcome.converged
    assert meter.stopped == 'cancelled'
    assert seen == [1, 2, 3]


def test_initial_guesses_are_distinct():
    problem = problems.build(LANE_CHANGE)
    starts = Guesser(problem).starts(problem, CostateIntegrator(problem))
    seen = [np.hstack([start.x[:-1], start.ua]) for start in islice(starts, 20)]
    assert all(np.abs(a - b).max() > 1e-6 for a, b in combinations(seen, 2))


def build_path():
    """Return a path with one state and one input."""
    t = np.array([0.0, 1.0])
    return Path(t, t[:, None], np.zeros((1, 0, 1)), np.ones((1, 1)), np.ones((1, 1)), t[1:])


@pytest.mark.parametrize(('minima', 'searches'), [(1, 7), (2, 16), (3, 29)])
def test_multistart_ends_when_no_other_minimum_is_expected(minima, searches):
    """For w minima, w (n - 1) / (n - w - 2) = w + 1/2 at n = 2 ((w + 1/2) (w + 2) - w)."""
    known_minima = LocalMinima()
    for k in range(searches):
        assert not known_minima.enough()
        cost = (1.0 + k % minima) * (1 + 1e-5 * k)   # costs as rough as those of the searches
        known_minima.record_end(cost, 0.0, build_path())
    assert searches == math.ceil(2 * ((minima + 0.5) * (minima + 2) - minima))
    assert known_minima.enough()


def test_a_search_that_repeats_an_earlier_one_is_recognised():
    known_minima = LocalMinima()
    path = [(5.0, 0.3), (3.0, 0.1), (2.0, 1e-9)]
    assert not any(known_minima.record_iterate(*iterate) for iterate in path)
    known_minima.record_end(*path[-1], build_path())
    assert not known_minima.record_iterate(5.1, 0.3)     # starts elsewhere
    assert known_minima.record_iterate(3.0, 0.1)         # reaches the path of an earlier search
    assert known_minima.record_iterate(2.0001, 1e-7)     # reaches an earlier minimum
    assert not known_minima.record_iterate(2.01, 1e-7)   # reaches another minimum
    assert not known_minima.record_iterate(2.0001, 0.2)  # is not feasible


@pytest.mark.parametrize('running_cost, terminal_cost, uneven', [
    ('u**2', 'x**2', False), ('u**2 - x**2', '0', False), ('u**2 + x**4', 'exp(x)', False),
    ('u**2', 'sin(x)', True), ('u**2 + x**4 - x**2', '0', True), ('u**4 - u**2', '0', True)])
def test_costs_with_several_local_minima_are_recognised(running_cost, terminal_cost, uneven):
    problem = problems.build(LQ, running_cost=running_cost, terminal_cost=terminal_cost)
    assert Uneven(problem)(problem, np.full(1, 3.0), np.full(1, 3.0)) is uneven


def test_guesses_cover_the_free_final_states():
    problem = problems.build(
        LQ, states=['x', 'y'], dynamics={'x': 'u', 'y': 'x + u'}, initial_state={'x': 1, 'y': 1},
        terminal_constraints=['y - 2'])
    guesser = Guesser(problem)
    starts = guesser.starts(problem, CostateIntegrator(problem))
    paths = list(islice(guesser.scattered(problem, CostateIntegrator(problem), starts, 1.0), 12))
    ends = np.sort([path.x[-1, 0] for k, path in enumerate(paths, 1) if k % 3])
    assert np.ptp(ends) > 3
    assert np.diff(ends).max() < 2
    assert all(path.x[-1, 1] == 2 for k, path in enumerate(paths, 1) if k % 3)
    assert np.all(paths[0].x[0] == problem.x0)


def test_random_inputs_reach_a_point_that_no_line_reaches():
    """The point lies inside the turning circle of a car; a straight line to it is infeasible."""
    problem = problems.pose(
        {'x': 'cos(a)', 'y': 'sin(a)', 'a': 'w'}, '1', (0, 0, 0),
        {'free': True, 'lower': 0.1, 'upper': 30}, inputs=['w'], input_bounds={'w': [-1, 1]},
        terminal_constraints=['x', 'y - 0.5'])
    integrator = CostateIntegrator(problem)
    paths = search_rollouts(problem, integrator, 4.0)
    assert np.abs(paths[0].x[-1, :2] - [0, 0.5]).max() < 0.15
    for path in paths[:6]:
        x, _ = integrator.forward(problem, path.t, path.ua, path.ub)
        assert np.allclose(x, path.x, atol=1e-4)


def test_a_constraint_that_rounding_breaks_at_a_given_start_leaves_paths():
    """
    The constraint is violated by 1e-12 at x(0), where no unknown can change that.

    J = x(1) - 1 is least where x(1) is on its bound: J = 0.1 (1 - cos 1).
    """
    found = solve(problems.pose(
        {'x': 'u'}, 'u', [1], 1, input_bounds={'u': [-1, 1]},
        path_constraints=[{'expr': 'x - 1 - 0.1*(1 - cos(t))', 'lower': 1e-12}]))
    assert found.feasible
    assert found.objective == pytest.approx(0.1 * (1 - np.cos(1.0)), abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize('off', [0.0, 1e-12])
def test_a_constraint_that_a_given_end_decides_leaves_paths(off):
    """
    The path ends at rest on its wall, which rounding may break there: no unknown can change that.

    One side of the problem of Bryson and Denham: the wall at l is met at t = 3 l, J = 4 / (9 l).
    """
    found = solve(problems.pose(
        {'x': 'v', 'v': 'u'}, 'u**2', [0, 1], 1, terminal_constraints=['x - 0.1', 'v'],
        path_constraints=[{'expr': 'x', 'upper': 0.1 - off}]))
    assert found.certified
    assert found.objective == pytest.approx(4 / 0.9, rel=1e-5)


def test_an_absolute_value_within_another_one_is_smoothed():
    """With w = -u one value vanishes; u = 1 reaches x(1) = 1 at the least u^2 + |u|."""
    found = solve(problems.pose(
        {'x': 'u'}, 'u**2 + abs(u) + abs(w + abs(u))', (0,), 1, inputs=['u', 'w'],
        terminal_constraints=['x - 1'], input_bounds={'w': [-2, 2]}))
    assert found.feasible
    assert found.objective == pytest.approx(2.0, abs=1e-5)
