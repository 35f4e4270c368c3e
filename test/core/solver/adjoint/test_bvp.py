# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Pontryagin's boundary value problem: costates compared with closed forms and by shooting."""

import casadi as ca
import numpy as np
from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.adjoint import bvp
from obc_ros.core.solver.program_cache import Cache
from obc_ros.core.solver.solve import solve
import problems
import pytest
from scipy.integrate import solve_bvp, solve_ivp


def solve_indirectly(name, **changes):
    """Return the problem of a file and its solution by the indirect method."""
    problem = problems.build(name, **changes)
    solution = solve(problem, method='indirect')
    assert solution.status is Status.SOLVED, solution.message
    return problem, solution


def shoot(problem, lam, T, inputs):
    """Integrate (x, lam) from x0 and lam to T with u = inputs(x, lam); return its end."""
    costate = ca.SX.sym('lam', problem.n)
    H = problem.L + ca.dot(costate, problem.f)
    rate = ca.Function('rate', [problem.x, problem.u, costate, problem.p], [
        ca.vertcat(problem.f, -ca.gradient(H, problem.x))])
    n = problem.n
    return solve_ivp(
        lambda t, z: rate(z[:n], inputs(z[:n], z[n:]), z[n:], problem.p_value).full().ravel(),
        (0, T), np.append(problem.x0, lam), 'DOP853', rtol=1e-11, atol=1e-12, max_step=T / 500
    ).y[:, -1]


def test_the_costate_of_example_2_2_has_its_closed_form():
    """lam(0) = P(0) x0 = 2 / (1 + e^-2)."""
    _, solution = solve_indirectly('lq_scalar_unit')
    assert solution.lam[0, 0] == pytest.approx(2 / (1 + np.exp(-2)), abs=1e-10)


@pytest.mark.slow
def test_shooting_van_der_pol_satisfies_transversality():
    """With u = clip(-lam1/2) and a free end, lam(T) = 0, through four arcs."""
    problem, solution = solve_indirectly('vanderpol_bounded')
    end = shoot(problem, solution.lam[0], 5.0, lambda x, lam: np.clip(-lam[:1] / 2, -0.3, 1))
    np.testing.assert_allclose(end[2:], 0.0, atol=1e-6)
    assert len(solution.switching_times) == 3


@pytest.mark.slow
def test_shooting_the_reactor_satisfies_transversality():
    """With u from dH/du = 0, which is linear in u, and a free end, lam(T) = 0."""
    problem, solution = solve_indirectly('cstr_luus')
    costate = ca.SX.sym('lam', 2)
    Hu = ca.gradient(problem.L + ca.dot(costate, problem.f), problem.u)
    curvature = ca.jacobian(Hu, problem.u)
    step = ca.Function('step', [problem.x, problem.u, costate, problem.p], [Hu, curvature])

    def inputs(x, lam):
        slope, bend = (float(v) for v in step(x, 0, lam, problem.p_value))
        return np.array([-slope / bend])   # H is quadratic in u

    end = shoot(problem, solution.lam[0], 0.78, inputs)
    np.testing.assert_allclose(end[2:], 0.0, atol=1e-6)


def test_bang_bang_switching_times_have_closed_forms():
    T = 32 ** (1 / 3)
    _, solution = solve_indirectly('triple_integrator_mintime')
    np.testing.assert_allclose(solution.switching_times, [T / 4, 3 * T / 4], atol=1e-10)
    # lam(0) follows from lam_a = 0 at both switches, lam_a(0) = -1 and H = 0.
    np.testing.assert_allclose(solution.lam[0], [-T / 3, -T**2 / 6, -1.0], atol=1e-8)


@pytest.mark.slow
def test_unsupported_features_are_reported():
    _, solution = solve_indirectly('bryson_denham')
    assert 'state bounds' in solution.message
    _, solution = solve_indirectly('catalyst_mixing')
    assert 'no extremal' in solution.message


def test_the_cost_of_the_aircraft_equals_that_of_solve_bvp():
    """
    The transfer in 5 s has two extremals; scipy's solve_bvp finds the better one.

    H is quadratic in u, so dH/du = 0 gives u. The aircraft first swings back; the guess of the
    angle follows that. A tolerance of 1e-7 leaves an error of 1e-10 in the cost.
    """
    problem, solution = solve_indirectly('aircraft_5')
    lam = ca.SX.sym('lam', problem.n)
    H = problem.L + ca.dot(lam, problem.f)
    best = ca.substitute(
        -ca.solve(ca.hessian(H, problem.u)[0], ca.gradient(H, problem.u)), problem.u, 0)
    slopes = ca.vertcat(problem.f, -ca.gradient(H, problem.x), problem.L)
    rate = ca.Function('rate', [ca.vertcat(problem.x, lam, ca.SX.sym('J'))], [ca.substitute(
        ca.substitute(slopes, problem.u, best), problem.p, problem.p_value)])
    t = np.linspace(0, 5, 51)
    z = np.zeros((13, 51))
    z[:2], z[2] = t / 5, -0.2 * np.sin(2 * np.pi * t / 5)
    found = solve_bvp(
        lambda t, z: rate(z).full(),
        lambda a, b: np.concatenate([a[:6], a[12:], b[:6] - [1, 1, 0, 0, 0, 0]]),
        t, z, tol=1e-7, max_nodes=5000)
    assert found.success, found.message
    assert solution.objective == pytest.approx(found.y[12, -1], abs=5e-9)
    np.testing.assert_allclose(solution.lam[0], found.y[6:12, 0], atol=1e-6)


def test_samples_lie_on_the_closed_form_extremal():
    """For dx/dt = -x + u from 0 to 1, x = sinh t / sinh 1 and u = e^t / sinh 1 = -lam."""
    problem = problems.pose({'x': '-x + u'}, 'u**2/2', (0,), 1, terminal_constraints=['x - 1'])
    solution = solve(problem, method='indirect')
    u = np.exp(solution.t)[:, None] / np.sinh(1)
    np.testing.assert_allclose(solution.x, np.sinh(solution.t)[:, None] / np.sinh(1), atol=1e-9)
    np.testing.assert_allclose(solution.lam, -u, atol=1e-9)
    np.testing.assert_allclose(solution.u, u, atol=5e-6)
    assert solution.objective == pytest.approx(1 / (1 - np.exp(-2)), abs=1e-10)


@pytest.mark.parametrize('name', ['brockett_3', 'orbit_transfer', 'rayleigh_bounded'])
def test_the_input_minimises_h(name):
    """A Newton step on dH/du = 0 changes the samples by less than 1e-4 of their maximum."""
    problem, solution = solve_indirectly(name)
    assert solution.certificate.holds
    costate = ca.SX.sym('lam', problem.n)
    Hu = ca.gradient(problem.L + ca.dot(costate, problem.f), problem.u)
    newton = ca.Function('newton', [problem.x, problem.u, costate, problem.p], [
        -ca.solve(ca.jacobian(Hu, problem.u), Hu)])
    step = np.array([newton(x, u, lam, problem.p_value).full().ravel() for x, u, lam in zip(
        solution.x, solution.u, solution.lam, strict=True)])
    best = np.clip(solution.u + step, problem.u_lower, problem.u_upper)
    assert np.abs(best - solution.u).max() < 1e-4 * np.abs(solution.u).max()


def test_a_cached_solution_is_reused_with_equal_accuracy():
    problem = problems.build('vanderpol_bounded')
    cache = Cache()
    once, again = (solve(problem, method='indirect', cache=cache) for _ in range(2))
    assert again.iterations < once.iterations
    assert len(again.t) == len(once.t)
    np.testing.assert_allclose(again.lam, once.lam, atol=1e-9)
    np.testing.assert_allclose(again.u, once.u, atol=1e-9)


def test_batches_of_intervals_do_not_change_the_solution(monkeypatch):
    """Matrices are built for a limited number of intervals at a time."""
    _, whole = solve_indirectly('vanderpol_bounded')
    monkeypatch.setattr(bvp, '_AT_ONCE', 1)
    _, alone = solve_indirectly('vanderpol_bounded')
    np.testing.assert_array_equal(alone.t, whole.t)
    np.testing.assert_allclose(alone.lam, whole.lam, rtol=1e-12, atol=1e-14)
