# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Phases of unknown durations, obtained from coarse paths, and long horizons."""

from dataclasses import replace

import numpy as np
from obc_ros.core.numerics.collocation import build_collocation
from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.arcs.bang_arcs import close_ends, cut_at_bounds, cut_at_ends
from obc_ros.core.solver.arcs.input_arcs import Arc
from obc_ros.core.solver.arcs.phase_program import PhasedProgram
from obc_ros.core.solver.arcs.phases import (
    DEGREE,
    Phased,
    spread_as_wanted,
    spread_by_error,
    spread_like,
)
from obc_ros.core.solver.bench import build_bench, Task
from obc_ros.core.solver.improve.phase_samples import sample_phases
from obc_ros.core.solver.improve.state_arcs import settle_arcs
from obc_ros.core.solver.initial_guess import estimate_scales
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.program_cache import ProgramCache
from obc_ros.core.solver.solve import solve
from obc_ros.core.solver.starts.horizon_continuation import lengthen_horizon
from obc_ros.core.solver.transcription.mesh import Path
import problems
import pytest
from scipy.optimize import brentq

FIXED = {'free': False, 'value': 3}


def test_a_state_bound_with_held_inputs_is_imposed_at_the_end():
    """
    The level V of a tank is maximised over 3 s: it fills for 1 s, J = -(1/2 + 2).

    While u = 0 the bound on V is satisfied by itself. If it were imposed at every point, its
    multipliers would not be unique. The path that gives the phases has no point in the second.
    """
    problem = problems.pose(
        {'V': 'u'}, '-V', (0,), FIXED, input_bounds={'u': [0, 1]}, state_bounds={'V': [None, 1]})
    t, V = np.array([0, 0.6, 1.2, 3]), np.array([[0], [0.6], [1], [1]])
    u = np.array([[1], [1], [0]])
    guess = Path(t, V, np.zeros((3, 0, 1)), u, u, np.array([3.0]))
    arcs = [Arc(0.0, 1.3, (1.0,), (0,)), Arc(1.3, 3.0, (0.0,), (0,))]
    found = PhasedProgram(problem, (True,)).solve(
        problem, arcs, [np.full(3, 1 / 3)] * 2, guess, estimate_scales(problem, guess),
        np.zeros(1, dtype=bool), Meter())
    assert found.converged
    assert found.cost == pytest.approx(-2.5, abs=1e-7)
    assert found.durations == pytest.approx([1, 2], abs=1e-6)
    inside = found.pushed[3:].reshape(-1)[:-1]
    assert np.abs(inside).max() < 1e-9
    # dlam/dt = 1, and u switches from 1 to 0 where lam vanishes.
    assert found.lam[3:, 0, 0] == pytest.approx([0, 2 / 3, 4 / 3], abs=1e-5)


def test_intervals_are_added_where_the_error_is():
    """Of four steps along exp(-40 t) only the first has a large error."""
    edges = np.linspace(0, 1, 5)
    tau = np.append(0.0, build_collocation(DEGREE, 'radau')[0])
    x = np.exp(-40 * (edges[:-1, None] + 0.25 * tau))[:, :, None]
    u = np.zeros((4, DEGREE, 1))
    found = Phased(
        arcs=[Arc(0.0, 1.0, (np.nan,), (0,))], meshes=[np.full(4, 0.25)], durations=np.ones(1),
        x=x, u=u, lam=x, eta=np.zeros((4, DEGREE, 1)), nu=np.zeros(0), cost=0.0, converged=True,
        outwards={}, pushed=u, astray=[])
    t, share = spread_by_error(found)
    assert t == pytest.approx(edges)
    assert share[[0, -1]] == pytest.approx([0, 1])
    assert share[1] > 0.45
    assert np.all(np.diff(share) > 0.1)
    (t, share), count = spread_as_wanted(found)
    assert t == pytest.approx(edges)
    assert count * np.diff(share) == pytest.approx([4, 1, 1, 1])


def test_intervals_are_added_where_inputs_turn():
    """The input turns in the second of four intervals; x = t^4 has equal coefficients in all."""
    tau = build_collocation(DEGREE, 'radau')[0]
    t = 0.25 * (np.arange(4)[:, None] + np.append(0.0, tau))
    u = np.zeros((4, DEGREE, 1))
    u[1, :, 0] = np.tanh(40 * (tau - 0.5))
    found = Phased(
        arcs=[Arc(0.0, 1.0, (np.nan,), (0,))], meshes=[np.full(4, 0.25)], durations=np.ones(1),
        x=t[:, :, None]**4, u=u, lam=np.zeros((4, DEGREE + 1, 1)), eta=np.zeros((4, DEGREE, 1)),
        nu=np.zeros(0), cost=0.0, converged=True, outwards={}, pushed=u, astray=[])
    _, share = spread_by_error(found)
    parts = np.diff(share)
    assert parts[1] > 1.4 * np.delete(parts, 1).max()


def test_a_bound_that_a_held_circle_implies_is_found_on_its_arc():
    """On a^2 + w^2 = 64 the bound a >= -8 follows; where the circle is not held, it does not."""
    problem = problems.pose(
        {'v': 'a', 'h': 'w'}, 1, (1, 0), FIXED, inputs=['a', 'w'],
        input_bounds={'a': [-8, 4], 'w': [-8, 8]},
        path_constraints=[{'expr': 'a**2 + w**2', 'upper': 64}])
    program, t = PhasedProgram(problem, (False, False)), np.array([0.0, 3])
    u = np.array([[-8.0, 0.0]])
    path = Path(t, np.ones((2, 2)), np.zeros((1, 0, 2)), u, u, np.array([3.0]))
    held = Arc(0.0, 3.0, (-8.0, np.nan), (0, 0, 1))
    assert program.implied(problem, held, path).tolist() == [[True, True], [False, True]]
    free = replace(held, on=(0, 0, 0))
    assert not program.implied(problem, free, path).any()


def test_phases_are_split_where_inputs_reach_their_bounds():
    """The input is 1 until t = 1, decreases to -1 at t = 2 and stays there until t = 3."""
    problem = problems.pose(
        {'x': 'v', 'v': 'u + w'}, 'u**2 + w**2', (0, 0), FIXED, inputs=['u', 'w'],
        input_bounds={'u': [-1, 1], 'w': [-1, 1]})
    count, tau = 12, np.append(0.0, build_collocation(DEGREE, 'radau')[0])
    t = (np.arange(count)[:, None] + tau) * 3 / count
    x = np.zeros((*t.shape, 2))
    u = np.stack([np.clip(3 - 2 * t[:, 1:], -1, 1), np.ones_like(t[:, 1:])], axis=2)
    nothing = np.zeros((count, DEGREE, 2))
    free = (np.nan, np.nan)
    found = Phased(
        arcs=[Arc(0.0, 3.0, free)], meshes=[np.full(count, 1 / count)],
        durations=np.full(1, 3.0), x=x, u=u, lam=x, eta=nothing, nu=np.zeros(0), cost=0.0,
        converged=True, outwards={}, pushed=nothing, astray=[])
    parts = cut_at_bounds(problem, found, np.array([True, False]), np.zeros((2, 2), dtype=bool))
    # w may not be held: it stays free although it is at its bound throughout.
    assert [part.end for part in parts] == pytest.approx([1, 2, 3])
    assert [part.start for part in parts] == pytest.approx([0, 1, 2])
    assert np.array([part.levels for part in parts])[:, 0] == pytest.approx(
        [1, np.nan, -1], nan_ok=True)
    assert np.all(np.isnan([part.levels[1] for part in parts]))


def test_costates_with_fast_modes_need_few_intervals():
    """
    V = x(T) behind a lag of 1/40: dlam_x/dt = 40 lam_x, dlam_y/dt = -40 lam_x, u = -lam_y.

    lam_x = exp(-40 (T - t)) and lam_y = 1 - lam_x. Polynomials through the collocation points
    alone would need ten times as many intervals for this accuracy.
    """
    problem = problems.pose(
        {'x': '40*(y - x)', 'y': 'u'}, 'u**2/2', (0, 0), 1, terminal_cost='x',
        input_bounds={'u': [-9, 9]})
    programs = ProgramCache(problem)
    line = programs.guesser.line(problem, 1.0)
    found = programs.phased.solve(
        problem, [Arc(0.0, 1.0, (np.nan,))], [np.full(24, 1 / 24)], line,
        estimate_scales(problem, line),
        np.zeros(2, dtype=bool), Meter())
    answer = sample_phases(problem, programs.phased, programs.stated_integrator, found, 300)
    lam_x = np.exp(-40 * (1 - answer.t))
    assert answer.lam == pytest.approx(np.column_stack([lam_x, 1 - lam_x]), abs=2e-5)


def test_an_inactive_state_bound_leaves_horizon_continuation():
    """A bound that is never active changes the method but not the cost."""
    pendulum = {
        'states': ['x', 'v'], 'inputs': ['u'], 'dynamics': {'x': 'v', 'v': 'u - 9*sin(x)'},
        'running_cost': 'x**2 + v**2 + u**2', 'initial_state': {'x': 3, 'v': 0},
        'final_time': {'free': False, 'value': 40}}
    costs = []
    for more in ({}, {'state_bounds': {'v': [-6, None]}}):
        problem = problems.build(pendulum, **more)
        bench = build_bench(Task(problem, ProgramCache(problem), Meter(60.0)))
        outcome = lengthen_horizon(replace(bench, stages=3), 4)
        assert outcome is not None
        assert outcome.converged
        costs.append(outcome.objective)
    assert costs[1] == pytest.approx(costs[0], rel=5e-3)


@pytest.mark.slow
def test_a_path_touches_an_obstacle_tangentially():
    """A path through the disc would be cheaper; at the contact the path must be tangent."""
    found = solve(problems.pose(
        {'x': 'cos(th)', 'y': 'sin(th)', 'th': 'w'}, '1 + w**2/5', (-2, -0.156, 0),
        {'free': True, 'lower': 1, 'upper': 20, 'guess': 4}, inputs=['w'],
        terminal_constraints=['x - 2', 'y + 0.277'],
        path_constraints=[{'expr': 'x**2 + y**2', 'lower': 0.49}]))
    assert found.status is Status.SOLVED
    assert found.certificate.residuals['costate'] < 1e-5
    touched, = found.switching_times
    x, y, th = (np.interp(touched, found.t, column) for column in found.x.T)
    assert x**2 + y**2 == pytest.approx(0.49, abs=1e-8)
    assert x * np.cos(th) + y * np.sin(th) == pytest.approx(0, abs=1e-6)


@pytest.mark.slow
def test_samples_satisfy_the_dynamics_with_linear_inputs():
    """A pendulum turns by 2 rad in 3 s at bounded rate; all samples satisfy the dynamics."""
    problem = problems.pose(
        {'x': 'v', 'v': 'u - sin(x)'}, 'u**2', (0, 0), FIXED, terminal_constraints=['x - 2', 'v'],
        state_bounds={'v': [None, 0.85]})
    found = solve(problem)
    assert found.certified
    assert np.any(found.state_multipliers > 0)
    assert found.certificate.residuals['dynamics'] < 1e-9


def test_phases_without_an_input_jump_are_merged():
    """
    A thrust in a disc jumps on a coarse path, but is continuous on the optimal one.

    (ux, uy) is parallel to (T - t, k). Integration gives vy(T) = k asinh(T/k) = 1 and
    x(T) = (T sqrt(T^2 + k^2) - k^2 asinh(T/k)) / 2 = 1, hence one equation for k.
    """
    k = brentq(lambda k: k**2 * np.sinh(1 / k) * np.cosh(1 / k) / 2 - k / 2 - 1, 0.2, 5)
    minimum = k * np.sinh(1 / k)
    problem = problems.pose(
        {'x': 'vx', 'vx': 'ux', 'vy': 'uy'}, 1, (0, 0, 0),
        {'free': True, 'lower': 0.1, 'upper': 10, 'guess': 2}, inputs=['ux', 'uy'],
        terminal_constraints=['x - 1', 'vy - 1'],
        path_constraints=[{'expr': 'ux**2 + uy**2', 'upper': 1}])
    t = np.linspace(0, 2, 9)
    u = np.where(t[:-1, None] < 1, [0.9, 0.4], [0.4, 0.9])
    guess = Path(t, np.column_stack([t**2 / 4, t / 2, t / 2]), np.zeros((8, 0, 3)), u, u,
                 np.array([2.0]))
    free, on = (np.nan, np.nan), (0, 0, 0, 1)
    arcs = [Arc(0.0, 1.0, free, on), Arc(1.0, 2.0, free, on, jump=True)]
    bench = build_bench(Task(problem, ProgramCache(problem), Meter()))
    found = settle_arcs(replace(bench, pinned=np.zeros(3, dtype=bool)), bench.programs.phased,
                        arcs, guess, estimate_scales(problem, guess), 1, spread_like(guess))
    assert len(found.arcs) == 1
    assert found.cost == pytest.approx(minimum, abs=1e-8)


def test_a_phase_at_a_bound_keeps_a_minimum_duration():
    """A free phase may start at that bound at equal cost; a phase after a switch may not."""
    problem = problems.pose(
        {'x': 'u + s'}, 'x**2 + u**2', (1,), FIXED, inputs=['u', 's'],
        input_bounds={'u': [-1, 1], 's': [-1, 1]})
    program = PhasedProgram(problem, (False, True))
    arcs = [Arc(0.0, 2.0, (1.0, -1.0), (0,)), Arc(2.0, 2.4, (np.nan, -1.0), (0,)),
            Arc(2.4, 3.0, (np.nan, 1.0), (0,))]
    assert program.shortest(arcs) == pytest.approx([1.8, 0, 0])


def test_inputs_without_effect_at_the_end_stay_continuous():
    """
    Maximise x + y at T = 1 by a thrust in a disc: (1, 1) / sqrt(2) throughout, J = -1 / sqrt(2).

    At T the costates of the speeds vanish, so any thrust in the disc minimises H there. The
    path that gives the phases has the opposite thrust at T.
    """
    problem = problems.build({
        'states': ['x', 'y', 'vx', 'vy'], 'inputs': ['a', 'b'],
        'dynamics': {'x': 'vx', 'y': 'vy', 'vx': 'a', 'vy': 'b'}, 'running_cost': '0',
        'terminal_cost': '-x - y', 'initial_state': dict.fromkeys(('x', 'y', 'vx', 'vy'), 0),
        'input_bounds': {'a': [-2, 2], 'b': [-2, 2]},
        'path_constraints': [{'expr': 'a**2 + b**2', 'upper': 1}],
        'final_time': {'free': False, 'value': 1}})
    t = np.array([0, 0.5, 0.999, 1])
    x = np.column_stack([t**2 / 2, t**2 / 2, t, t]) / np.sqrt(2)
    u = np.full((3, 2), np.sqrt(0.5))
    last = u.copy()
    last[-1] *= -1
    guess = Path(t, x, np.zeros((3, 0, 4)), u, last, np.ones(1))
    programs = ProgramCache(problem)
    found = programs.phased.solve(
        problem, [Arc(0.0, 1.0, (np.nan, np.nan), (0, 0, 0, 0, 1))], [np.full(4, 0.25)], guess,
        estimate_scales(problem, guess), np.zeros(4, dtype=bool), Meter())
    assert found.converged
    assert found.cost == pytest.approx(-np.sqrt(0.5), abs=1e-9)
    assert found.u == pytest.approx(np.full((4, DEGREE, 2), np.sqrt(0.5)), abs=1e-5)
    # dH/da = lam_vx + 2 eta a = 0 with lam_vx = -(1 - t)
    assert found.eta[:, :, 4] == pytest.approx(
        (1 - (np.arange(4)[:, None] + build_collocation(DEGREE, 'radau')[0]) / 4) * np.sqrt(0.5),
        abs=1e-5)


def slopes_of(sign: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times and values of dH/du that vanish in [0.1, 2.8] of [0, 3]."""
    t = np.linspace(0, 3, 301)
    return t, sign * (np.maximum(0.1 - t, 0) - np.minimum(2.8 - t, 0) - 1e-9)


@pytest.mark.parametrize(('sign', 'limit', 'level', 'on'), [
    (1, 5, -2, 0), (-1, 5, 2, 0), (-1, 1, np.nan, 1), (1, 1, np.nan, -1)])
def test_bang_arcs_around_a_singular_arc_are_found(
        sign: float, limit: float, level: float, on: int) -> None:
    """The bang arcs are at the input bound or at a path constraint that is tighter."""
    problem = problems.pose(
        {'x': 'u'}, 'x**2', (0,), FIXED, input_bounds={'u': [-2, 2]},
        path_constraints=[{'expr': 'u + x', 'lower': -limit, 'upper': limit}])
    x = np.zeros((4, DEGREE + 1, 1))
    u = np.zeros((4, DEGREE, 1))
    eta = np.zeros((4, DEGREE, 2))
    found = Phased(
        arcs=[Arc(0.0, 3.0, (np.nan,))], meshes=[np.full(4, 0.25)], durations=np.full(1, 3.0),
        x=x, u=u, lam=x, eta=eta, nu=np.zeros(0), cost=0.0, converged=True, outwards={},
        pushed=eta, astray=[])
    t, Hu = slopes_of(sign)
    arcs = cut_at_ends(problem, PhasedProgram(problem, (True,)), found, t, np.zeros((301, 1)),
                       np.full((301, 1), 0.1), Hu[:, None])
    assert [arc.end for arc in arcs] == pytest.approx([0.1, 2.8, 3], abs=0.02)
    assert np.array([arc.levels for arc in arcs])[:, 0] == pytest.approx(
        [level, np.nan, level], nan_ok=True)
    assert [arc.on[1] if arc.on else 0 for arc in arcs] == [on, 0, on]


@pytest.mark.parametrize(('levels', 'ends', 'shown'), [
    ((), (0.005, 2.995, 3), (-2, np.nan, -2)),
    ((-2,), (1.005, 2.995, 3), (-2, np.nan, -2)),
    ((2,), (1.0, 1.005, 2.995, 3), (2, -2, np.nan, -2))])
def test_bangs_shorter_than_an_interval_are_inserted(
        levels: tuple[float, ...], ends: tuple[float, ...], shown: tuple[float, ...]) -> None:
    """They end at the outermost samples. An arc with the same level before only moves its end."""
    problem = problems.pose({'x': 'u'}, 'x**2', (0,), FIXED, input_bounds={'u': [-2, 2]})
    first = 1.0 if levels else 0.0
    arcs = [*(Arc(0.0, first, (level,)) for level in levels), Arc(first, 3.0, (np.nan,))]
    t = np.arange(0.005, 3, 0.01)
    Hu = np.maximum(first + 0.1 - t, 0) - np.minimum(2.8 - t, 0) - 1e-9
    found = close_ends(problem, arcs, np.array([True]), np.zeros((1, 1), dtype=bool),
                       (t, np.full((300, 1), 0.1), Hu[:, None]))
    assert [arc.end for arc in found] == pytest.approx(ends, abs=1e-9)
    assert np.array([arc.levels for arc in found])[:, 0] == pytest.approx(shown, nan_ok=True)


@pytest.mark.slow
def test_an_arc_shorter_than_the_mesh_is_found():
    """
    Minimum time along a winding road: v**2 k is bounded, and k enters H linearly.

    The path begins with a turn over 0.26 m of 150 m, after which the car goes straight.
    """
    road = '0.03*sin(s/20)'
    pace = f'(1 - n*{road})/(v*cos(a))'
    answer = solve(problems.pose(
        {'n': f'v*sin(a)*{pace}', 'a': f'k*v*{pace} - {road}', 'v': f'c*{pace}', 's': '1'}, pace,
        (0, 0, 10, 0), 150, inputs=['k', 'c'], input_bounds={'k': [-0.2, 0.2], 'c': [-8, 4]},
        state_bounds={'n': [-3, 3], 'v': [3, 40], 'a': [-1, 1]},
        path_constraints=[{'expr': 'v**2*k', 'lower': -8, 'upper': 8}]), time_limit=600.0)
    assert answer.certified, answer.message
    turned = answer.u[:, 0] * answer.x[:, 2]**2
    assert turned[answer.t < 0.2] == pytest.approx(8, abs=1e-5)
    assert np.abs(turned[(answer.t > 0.4) & (answer.t < 9)]).max() < 0.1
