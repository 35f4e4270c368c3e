# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The stagewise form of a transcription, in which benchmarks/backends.py passes it to fatrop."""

import _backends  # of benchmarks/
import _stagewise  # of benchmarks/
import casadi as ca
import numpy as np
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.starts.initial_guess import estimate_scales, Guesser
from obc_ros.core.solver.transcription.mesh import HELD, Layout, LINEAR, Mesh, Phase
from obc_ros.core.solver.transcription.program import Transcription
from obc_ros.core.solver.transcription.tightening import TightenedLimits
import problems
import pytest

PENDULUM = {
    'states': ['q', 'w'], 'inputs': ['u'], 'dynamics': {'q': 'w', 'w': 'u - sin(q)'},
    'running_cost': 'u**2 + 0.1*q**2 + 1', 'initial_state': {'q': 1, 'w': 0},
    'terminal_constraints': ['q', 'w'], 'input_bounds': {'u': [-1, 1]},
    'final_time': {'free': True, 'lower': 1, 'upper': 9, 'guess': 3}}
FIXED = {'final_time': {'free': False, 'value': 5}}
LIMITED = {'path_constraints': [{'expr': 'w + 0.1*u', 'lower': -0.5}]}
CASES = {   # changes of the statement; modes of the input in each phase; Gauss points
    'Runge-Kutta, fixed T': (FIXED, (LINEAR,), 0), 'Runge-Kutta, free T': ({}, (LINEAR,), 0),
    'Gauss, free T': (LIMITED, (LINEAR,), 3), 'two phases': (LIMITED, (LINEAR, HELD), 2),
    'three phases': ({}, (HELD, LINEAR, HELD), 0)}


def build(name, **changes):
    more, modes, stages = CASES[name]
    problem = problems.build(PENDULUM, **{**more, **changes})
    phases = tuple(Phase(4, (mode,)) for mode in modes)
    return problem, Transcription(problem, Layout(phases, stages, problem.final_time.free))


@pytest.fixture(params=CASES)
def forms(request):
    """Return a transcription, its stagewise form, and random values of its symbols."""
    _, program = build(request.param)
    chance = np.random.default_rng(5)
    values = (chance.uniform(0.5, 1.5, program.unknowns), chance.uniform(
        0.5, 1.5, program.constants))
    return program, _stagewise.order_by_stages(program), values


def test_both_forms_have_the_same_cost_rows_and_derivatives(forms):
    program, stagewise, (w, c) = forms
    theirs = program._program.derivatives
    f, slope = (each.full().ravel() for each in theirs['grad_f'](w, c))
    g, J = (each.full() for each in theirs['jac_g'](w, c))
    rows, size = len(g), len(stagewise.source)
    lam = np.random.default_rng(6).normal(size=rows)
    H = ca.triu2symm(theirs['hess_lag'](w, c, 0.7, lam)).full()
    # Variables are copies of unknowns: v = lift w.
    lift = np.zeros((size, program.unknowns))
    lift[np.arange(size), stagewise.source] = 1.0
    v, position = lift @ w, np.argsort(stagewise.order)
    np.testing.assert_array_equal(v[stagewise.place], w)
    ours = stagewise.derivatives
    assert float(ca.Function('f', [stagewise.nlp['x'], stagewise.nlp['p']], [
        stagewise.nlp['f']])(v, c)) == pytest.approx(f[0], rel=1e-13)
    np.testing.assert_allclose(lift.T @ ours['nlp_grad_f'](v, c).full().ravel(), slope, atol=1e-12)
    g_new, J_new = (each.full() for each in ours['nlp_jac_g'](v, c))
    np.testing.assert_allclose(g_new[position[:rows]], g, atol=1e-12)
    np.testing.assert_array_equal(g_new[position[rows:]], 0.0)
    np.testing.assert_allclose(J_new[position[:rows]] @ lift, J, atol=1e-12)
    np.testing.assert_array_equal(J_new[position[rows:]] @ lift, 0.0)
    lam_new = np.append(lam, np.zeros(size - program.unknowns))[stagewise.order]
    both, H_new = (each.full() for each in ours['nlp_hess_l'](v, c, 0.7, lam_new))
    np.testing.assert_allclose(lift.T @ H_new @ lift, H, atol=1e-11)
    np.testing.assert_allclose(lift.T @ both.ravel(), 0.7 * slope + J.T @ lam, atol=1e-11)


def test_rows_of_a_stage_are_its_step_and_its_constraints(forms):
    """Of the next stage, those of a step have one state each; constraints have nothing."""
    _, stagewise, (w, c) = forms
    of, v = stagewise.structure, w[stagewise.source]
    _, J = stagewise.derivatives['nlp_jac_g'](v, c)
    J = J.full()
    widths = np.add(of['nx'], of['nu'])
    heights = np.append(of['nx'][1:], 0) + of['ng']
    assert widths.sum() == J.shape[1]
    assert heights.sum() == J.shape[0]
    first, top = 0, 0
    for k, (width, height) in enumerate(zip(widths, heights, strict=True)):
        block = J[top:top + height]
        states = of['nx'][k + 1] if k < of['N'] else 0
        block[:, first:first + width] = 0.0
        step = block[:states, first + width:first + width + states].copy()
        np.testing.assert_array_equal(np.abs(step), np.eye(states))
        block[:states, first + width:first + width + states] = 0.0
        assert not block.any()
        first, top = first + width, top + height


def solve_on(name, monkeypatch, meter=None, **changes):
    """Return the problem, its program by fatrop, the mesh, scales, limits and the outcome."""
    problem, program = build(name, **changes)
    phases, m = program.layout.phases, problem.m
    count, T = len(phases), 3.0 if problem.final_time.free else problem.final_time.value
    mesh = Mesh(program.layout, np.full(program.layout.intervals, 0.25), np.full((count, m), -0.9))
    guess, durations = Guesser(problem).line(problem, T), np.full(count, T / count)
    scales = estimate_scales(problem, guess)
    limits = TightenedLimits(np.full(count, 0.1), np.full(count, 9.0), np.zeros(
        problem.n + program.l), np.zeros(problem.n, dtype=bool), np.full(problem.n, np.nan))
    monkeypatch.setattr(Transcription, '_solver', _backends._solve_by_fatrop)
    program.__dict__['_staged'] = None
    outcome = program.solve(problem, mesh, program.start(mesh, guess, durations, scales), scales,
                            limits, meter or Meter())
    monkeypatch.undo()
    return problem, program, mesh, scales, limits, outcome


@pytest.mark.parametrize('name', CASES)
def test_solutions_of_fatrop_satisfy_the_first_order_conditions(name, monkeypatch):
    problem, program, mesh, scales, limits, found = solve_on(name, monkeypatch)
    assert found.converged
    c = program._constants(problem, mesh, scales, problem.final_time.value)
    bounds = program._bounds(problem, mesh, scales, limits)
    rows = program._row_bounds(problem, mesh, scales, limits)
    _, slope = program._program.derivatives['grad_f'](found.w, c)
    g, J = (each.full() for each in program._program.derivatives['jac_g'](found.w, c))
    fixed = bounds[0] == bounds[1]
    rest = slope.full().ravel() + J.T @ found.lam_g + found.lam_w
    np.testing.assert_allclose(rest[~fixed], 0.0, atol=1e-6)
    for value, multiplier, (lower, upper) in (
            (found.w, found.lam_w, bounds), (g.ravel(), found.lam_g, rows)):
        assert np.all((value >= lower - 1e-7) & (value <= upper + 1e-7))
        pressed = (lower < upper) & (np.abs(multiplier) > 1e-6)
        room = np.where(multiplier > 0, upper - value, value - lower)[pressed]
        np.testing.assert_allclose(multiplier[pressed] * room, 0.0, atol=1e-6)
    other = program.solve(problem, mesh, found.w, scales, limits, Meter(), near=True)
    assert other.converged
    assert found.objective == pytest.approx(other.objective, rel=1e-6)


def test_a_program_without_a_solution_is_not_solved(monkeypatch):
    *_, found = solve_on('Runge-Kutta, fixed T', monkeypatch,
                         input_bounds={'u': [-0.01, 0.01]})
    assert not found.converged


def test_iterations_beyond_those_of_the_meter_count_as_a_stop(monkeypatch):
    meter = Meter()
    meter.limit(3)
    *_, found = solve_on('Runge-Kutta, fixed T', monkeypatch, meter)
    assert not found.converged
    assert found.judge()[1].startswith('iterations used up')
