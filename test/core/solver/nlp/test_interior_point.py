# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The interior-point method, from guesses and from neighbouring problems."""

from dataclasses import dataclass, replace

import casadi as ca
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.initial_guess import estimate_scales, Guesser
from obc_ros.core.solver.nlp.interior_point import (
    Interior,
    Pattern,
    ProgramValues,
    solve_program,
    StoppingRule,
)
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh
from obc_ros.core.solver.transcription.program import (
    Nearby,
    TightenedLimits,
    Transcription,
    TranscriptionOutcome,
)
import problems
import pytest


@dataclass
class DenseProgram:
    """A small dense program in CasADi expressions of w, with the interface of the method."""

    f: ca.SX
    g: ca.SX
    w: ca.SX

    def __post_init__(self) -> None:
        n, r = self.w.numel(), self.g.numel()
        lam = ca.SX.sym('lam', r)
        L = self.f + ca.dot(lam, self.g)
        H, slope = ca.hessian(L, self.w)
        J = ca.jacobian(self.g, self.w)
        self._all = ca.Function('all', [ca.vertcat(self.w, lam)], [
            self.f, self.g, slope, ca.gradient(self.f, self.w), ca.densify(H), ca.densify(J)])
        self.n, self.size = n, n + r
        self.is_row = np.arange(self.size) >= n
        rows, columns = np.indices((self.size, self.size)).reshape(2, -1)
        self.pattern = Pattern(rows, columns, self.size, 0)

    def values(self, y: np.ndarray) -> ProgramValues:
        f, g, slope, cost, H, J = (value.full() for value in self._all(y))
        none, c = np.zeros(self.size - self.n), np.zeros(self.size)
        c[self.n:] = g.ravel()
        K = np.block([[H, J.T], [J, np.zeros((len(J), len(J)))]])
        return ProgramValues(float(f[0, 0]), c, np.append(slope.ravel(), none),
                             np.append(cost.ravel(), none), K.ravel(), ((J, H),))

    def merit(self, y: np.ndarray) -> tuple[float, np.ndarray]:
        there = self.values(y)
        return there.f, there.c

    def convex(self, values: ProgramValues, fixed: np.ndarray, diagonal: np.ndarray) -> bool:
        (J, H), = values.parts
        free = ~fixed[:self.n]
        full = H + np.diag(diagonal[:self.n])
        _, s, basis = np.linalg.svd(J[:, free])
        null = basis[int((s > 1e-12).sum()):].T
        return bool(np.all(np.linalg.eigvalsh(null.T @ full[np.ix_(free, free)] @ null) > 0))


def bounds(program: DenseProgram, lower: list[float], upper: list[float]
           ) -> tuple[np.ndarray, ...]:
    none = np.full(program.size - program.n, np.inf)
    return np.append(lower, -none), np.append(upper, none)


def solve_dense(program: DenseProgram, lower: list[float], upper: list[float], start: list[float],
                goal: StoppingRule | None = None) -> tuple[np.ndarray, bool, str]:
    work = Interior(program, *bounds(program, lower, upper))
    y = np.append(np.array(start, dtype=float), np.zeros(program.size - program.n))
    end = solve_program(work, work.begin(y, 0.1, 1e-2), goal or StoppingRule(), lambda f,
                        worst: False)
    return end.y, end.converged, end.status


def hs71() -> DenseProgram:
    """Return problem 71 of W. Hock, K. Schittkowski, Test Examples for Nonlinear Programming."""
    w = ca.SX.sym('w', 5)
    return DenseProgram(w[0] * w[3] * (w[0] + w[1] + w[2]) + w[2],
                 ca.vertcat(w[0] * w[1] * w[2] * w[3] - 25 - w[4],
                            ca.sumsqr(w[:4]) - 40), w)


def test_hock_and_schittkowski_71_has_its_published_minimum():
    y, converged, _ = solve_dense(hs71(), [1, 1, 1, 1, 0], [5, 5, 5, 5, np.inf], [1, 5, 5, 1, 1])
    assert converged
    np.testing.assert_allclose(y[:4], [1.0, 4.7429994, 3.8211503, 1.3794082], atol=1e-6)


def test_iterations_leave_a_saddle_for_a_minimum():
    """The first step leads to the saddle of x^4 - x^2 + y^2 at 0; the minima have x^2 = 1/2."""
    w = ca.SX.sym('w', 2)
    program = DenseProgram(w[0]**4 - w[0]**2 + w[1]**2, ca.SX(0, 1), w)
    y, converged, _ = solve_dense(program, [-9, -9], [9, 9], [0.05, 1.0])
    assert converged
    assert abs(y[0]) == pytest.approx(np.sqrt(0.5), abs=1e-6)


@pytest.mark.parametrize('start', [[1, 5, 5, 1, 1], [2, 2, 2, 2, 9], [4.9, 1.1, 3, 4, 0.1]])
def test_a_step_satisfies_the_equations_of_newtons_method(start):
    """(W + Sigma + shift) d + J' dlam = -slope + mu / gap, and J d = -c."""
    program = hs71()
    work = Interior(program, *bounds(program, [1, 1, 1, 1, 0], [5, 5, 5, 5, np.inf]))
    now = work.begin(np.append(np.array(start, dtype=float), [0.3, -0.2]), 0.1, 1e-2)
    found = work.direction(now)
    assert found is not None
    n, (J, H), step = program.n, now.values.parts[0], found[0]
    lower, upper = np.array([1, 1, 1, 1, 0.0]), np.array([5, 5, 5, 5, np.inf])
    below, above = 1 / (now.y[:n] - lower), 1 / (upper - now.y[:n])
    pull, sigma = 0.1 * (below - above), 0.1 * (below**2 + above**2)
    W = H + np.diag(sigma + work.shift)
    np.testing.assert_allclose(W @ step[:n] + J.T @ step[n:], pull - now.values.slope[:n],
                               rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(J @ step[:n], -now.values.c[n:], rtol=1e-6, atol=1e-6)


def test_an_infeasible_program_does_not_converge():
    w = ca.SX.sym('w', 2)
    program = DenseProgram(ca.sumsqr(w), ca.vertcat(w[0]**2 + w[1]**2 + 1), w)
    _, converged, status = solve_dense(program, [-9, -9], [9, 9], [1, 1])
    assert not converged
    assert status in ('no step', 'stopped')


def test_a_rough_tolerance_takes_fewer_iterations():
    steps: dict[float, int] = {}
    for rough in (0.0, 1e-2):
        program = hs71()
        work = Interior(program, *bounds(program, [1, 1, 1, 1, 0], [5, 5, 5, 5, np.inf]))
        start = work.begin(np.append([1.0, 5, 5, 1, 1], [0, 0]), 0.1, 1e-2)
        end = solve_program(work, start, StoppingRule(rough=rough), lambda f, worst: False)
        assert end.values.f == pytest.approx(17.0140173, rel=max(rough, 1e-6))
        steps[rough] = end.iterations
    assert steps[1e-2] < steps[0.0]


@given(st.integers(1, 30), st.integers(0, 6), st.integers(0, 3), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_random_bordered_bands_are_solved_and_singular_ones_refused(inner, width, border, seed):
    """A row and column of zeros makes the matrix singular, in the band or in the border."""
    chance, size = np.random.default_rng(seed), inner + border
    band = np.abs(np.subtract.outer(np.arange(size), np.arange(size))) <= width
    edge = np.arange(size) >= inner
    A = np.where(band | edge | edge[:, None], chance.normal(size=(size, size)), 0.0)
    A = A + A.T
    rows, columns = np.nonzero(np.ones_like(A) * (band | edge | edge[:, None]))
    pattern = Pattern(rows, columns, size, border)
    right, shift = chance.normal(size=size), np.full(size, 8.0 * np.sqrt(size))
    factor = pattern.factor(A[rows, columns], pattern.place, shift)
    assert factor is not None
    y = factor.solve(right)
    scale = np.abs(A + np.diag(shift)) @ np.abs(y) + np.abs(right)
    assert np.all(np.abs((A + np.diag(shift)) @ y - right) <= 1e-12 * scale)
    fixed = np.arange(size) == chance.integers(size)
    gone = pattern.without(fixed)
    assert pattern.factor(A[rows, columns], gone, np.where(fixed, 0.0, shift)) is None
    held = pattern.factor(A[rows, columns], gone, np.where(fixed, 1.0, shift))
    assert held is not None
    assert held.solve(right)[fixed] == pytest.approx(right[fixed], rel=1e-12)


@pytest.mark.parametrize('border', [0, 2])
def test_factors_of_a_banded_matrix_solve_its_equations(border):
    chance = np.random.default_rng(3)
    size, width = 12, 3
    A = chance.normal(size=(size, size))
    A = A + A.T
    band = np.abs(np.subtract.outer(np.arange(size), np.arange(size))) <= width
    edge = np.arange(size) >= size - border
    A = np.where(band | edge | edge[:, None], A, 0.0)
    rows, columns = np.nonzero(A)
    pattern = Pattern(rows, columns, size, border)
    right, shift = chance.normal(size=size), chance.normal(size=size)
    factor = pattern.factor(A[rows, columns], pattern.place, shift)
    whole = A + np.diag(shift)
    np.testing.assert_allclose(whole @ factor.solve(right), right, atol=1e-9)
    negative = int((np.linalg.eigvalsh(whole) < 0).sum())
    assert factor.odd() == (negative % 2 == 1)
    half = (rows >= columns) | (rows >= size - border) | (columns >= size - border)
    lower = Pattern(rows[half], columns[half], size, border, triangle=True)
    for add in (-20.0, 20.0):
        positive = bool(np.all(np.linalg.eigvalsh(A + add * np.eye(size)) > 0))
        for each, entries in ((pattern, A[rows, columns]), (lower, A[rows, columns][half])):
            assert each.definite(entries, each.place, np.full(size, add)) == positive


PENDULUM = {
    'states': ['q', 'w'], 'inputs': ['u'], 'dynamics': {'q': 'w', 'w': 'u - sin(q)'},
    'running_cost': 'u**2 + 0.1*q**2', 'initial_state': {'q': 1, 'w': 0},
    'terminal_constraints': ['q', 'w'], 'input_bounds': {'u': [-0.4, 0.4]},
    'final_time': {'free': False, 'value': 5}}


def solve_transcription(problem: Problem, *, own: bool,
                        near: TranscriptionOutcome | None = None) -> TranscriptionOutcome:
    mesh = build_uniform_mesh(problem, 20, 0)
    program = Transcription(problem, mesh.layout)
    if not own:
        program.__dict__['_staged'] = None
    guesser = Guesser(problem)
    guess = guesser.line(problem, problem.final_time.value if not problem.final_time.free else 3.0)
    sizes = estimate_scales(problem, guess)
    final = problem.final_time
    limits = TightenedLimits(np.array([final.lower]), np.array([final.upper]), np.zeros(problem.n),
                             guesser.final_state(problem)[1], np.full(problem.n, np.nan))
    start = program.start(mesh, guess, guess.durations, sizes) if near is None else near.w
    return program.solve(problem, mesh, start, sizes, limits, Meter(),
                         near=near and Nearby(warm=near))


@pytest.mark.parametrize('changes', [
    {}, {'final_time': {'free': True, 'lower': 1, 'upper': 9}, 'running_cost': 'u**2 + 1',
         'input_bounds': {'u': [-1, 1]}},
    {'terminal_constraints': [], 'terminal_cost': '3*q**2 + w**2'}])
def test_a_transcription_has_the_same_solution_as_by_ipopt(changes):
    problem = problems.build(PENDULUM, **changes)
    ours, theirs = (solve_transcription(problem, own=own) for own in (True, False))
    assert ours.converged
    assert theirs.converged
    assert ours.objective == pytest.approx(theirs.objective, rel=1e-6)
    np.testing.assert_allclose(ours.path.x, theirs.path.x, atol=1e-4)
    np.testing.assert_allclose(ours.nu, theirs.nu, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(ours.costates[1:], theirs.costates[1:], rtol=1e-3, atol=1e-5)
    size = np.abs(theirs.lam_w).max()
    assert np.all(ours.lam_w[np.abs(theirs.lam_w) > 1e-2 * size] * theirs.lam_w[
        np.abs(theirs.lam_w) > 1e-2 * size] >= 0)


def test_a_neighbouring_problem_takes_fewer_iterations():
    problem = problems.build(PENDULUM)
    first = solve_transcription(problem, own=True)
    neighbour = replace(problem, x0=problem.x0 + [1e-3, 0])
    followed, anew = (
        solve_transcription(neighbour, own=True, near=near) for near in (first, None))
    assert followed.converged
    assert followed.iterations < anew.iterations
    assert followed.objective == pytest.approx(anew.objective, rel=1e-7)
