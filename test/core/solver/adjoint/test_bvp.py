# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Pontryagin's boundary value problem: costates against closed forms and by shooting with them."""

import casadi as ca
import numpy as np
from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.adjoint import bvp_equations
from obc_ros.core.solver.solve import Cache, solve
import problems
import pytest
from scipy.integrate import solve_bvp, solve_ivp


def answered(name, **changes):
    """Return a problem of a file and its answer by the indirect method."""
    problem = problems.build(name, **changes)
    solution = solve(problem, method='indirect')
    assert solution.status is Status.SOLVED, solution.message
    return problem, solution


def shot(problem, lam, T, inputs):
    """Return (x, lam) at T from x0 and lam, with u = inputs(x, lam)."""
    costate = ca.SX.sym('lam', problem.n)
    H = problem.L + ca.dot(costate, problem.f)
    rate = ca.Function('rate', [problem.x, problem.u, costate, problem.p], [
        ca.vertcat(problem.f, -ca.gradient(H, problem.x))])
    n = problem.n
    return solve_ivp(
        lambda t, z: rate(z[:n], inputs(z[:n], z[n:]), z[n:], problem.p_value).full().ravel(),
        (0, T), np.append(problem.x0, lam), 'DOP853', rtol=1e-11, atol=1e-12, max_step=T / 500
    ).y[:, -1]


def test_costate_of_example_2_2():
    """lam(0) = P(0) x0 = 2 / (1 + e^-2)."""
    _, solution = answered('lq_scalar_unit')
    assert solution.lam[0, 0] == pytest.approx(2 / (1 + np.exp(-2)), abs=1e-10)


@pytest.mark.slow
def test_shooting_with_the_costates_of_van_der_pol_ends_at_zero():
    """With u = clip(-lam1/2) the free end asks for lam(T) = 0, through four arcs."""
    problem, solution = answered('vanderpol_bounded')
    end = shot(problem, solution.lam[0], 5.0, lambda x, lam: np.clip(-lam[:1] / 2, -0.3, 1))
    np.testing.assert_allclose(end[2:], 0.0, atol=1e-6)
    assert len(solution.switching_times) == 3


@pytest.mark.slow
def test_shooting_with_the_costates_of_the_reactor_ends_at_zero():
    """With u from dH/du = 0, which is linear in u, the free end asks for lam(T) = 0."""
    problem, solution = answered('cstr_luus')
    costate = ca.SX.sym('lam', 2)
    Hu = ca.gradient(problem.L + ca.dot(costate, problem.f), problem.u)
    curvature = ca.jacobian(Hu, problem.u)
    step = ca.Function('step', [problem.x, problem.u, costate, problem.p], [Hu, curvature])

    def inputs(x, lam):
        slope, bend = (float(v) for v in step(x, 0, lam, problem.p_value))
        return np.array([-slope / bend])   # H is quadratic in u

    end = shot(problem, solution.lam[0], 0.78, inputs)
    np.testing.assert_allclose(end[2:], 0.0, atol=1e-6)


def test_switching_times_of_bang_bang_arcs():
    T = 32 ** (1 / 3)
    _, solution = answered('triple_integrator_mintime')
    np.testing.assert_allclose(solution.switching_times, [T / 4, 3 * T / 4], atol=1e-10)
    # lam(0) from S = lam_a = 0 at both switches, S(0) = -1 and H = 0.
    np.testing.assert_allclose(solution.lam[0], [-T / 3, -T**2 / 6, -1.0], atol=1e-8)


@pytest.mark.slow
def test_what_it_does_without_is_said():
    _, solution = answered('bryson_denham')
    assert 'state bounds' in solution.message
    _, solution = answered('catalyst_mixing')
    assert 'no extremal' in solution.message


def test_the_aircraft_costs_what_scipy_finds():
    """
    The better of two minima of the transfer in 5 s, by scipy's solve_bvp from a guess.

    H is quadratic in u, so that dH/du = 0 gives u. The aircraft swings back before it flies to
    its goal; the guess tilts it accordingly. A tolerance of 1e-7 leaves 1e-10 of the cost.
    """
    problem, solution = answered('aircraft_5')
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


def test_samples_are_those_of_the_extremal():
    """Of dx/dt = -x + u, x(0) = 0 and x(1) = 1: x = sinh t / sinh 1, u = e^t / sinh 1 = -lam."""
    problem = problems.pose({'x': '-x + u'}, 'u**2/2', (0,), 1, terminal_constraints=['x - 1'])
    solution = solve(problem, method='indirect')
    u = np.exp(solution.t)[:, None] / np.sinh(1)
    np.testing.assert_allclose(solution.x, np.sinh(solution.t)[:, None] / np.sinh(1), atol=1e-9)
    np.testing.assert_allclose(solution.lam, -u, atol=1e-9)
    np.testing.assert_allclose(solution.u, u, atol=5e-6)
    assert solution.objective == pytest.approx(1 / (1 - np.exp(-2)), abs=1e-10)


@pytest.mark.parametrize('name', ['brockett_3', 'orbit_transfer', 'rayleigh_bounded'])
def test_auto_returns_the_input_that_minimises_h(name):
    """Where dH/du says what u is, the samples are off it by less than 1e-4 of its size."""
    problem = problems.build(name)
    solution = solve(problem)
    assert solution.certificate.holds
    costate = ca.SX.sym('lam', problem.n)
    Hu = ca.gradient(problem.L + ca.dot(costate, problem.f), problem.u)
    newton = ca.Function('newton', [problem.x, problem.u, costate, problem.p], [
        -ca.solve(ca.jacobian(Hu, problem.u), Hu)])
    step = np.array([newton(x, u, lam, problem.p_value).full().ravel() for x, u, lam in zip(
        solution.x, solution.u, solution.lam, strict=True)])
    best = np.clip(solution.u + step, problem.u_lower, problem.u_upper)
    assert np.abs(best - solution.u).max() < 1e-4 * np.abs(solution.u).max()


def test_asked_twice_the_answer_is_as_good():
    problem = problems.build('vanderpol_bounded')
    cache = Cache()
    once, again = (solve(problem, method='indirect', cache=cache) for _ in range(2))
    assert again.iterations < once.iterations
    assert len(again.t) == len(once.t)
    np.testing.assert_allclose(again.lam, once.lam, atol=1e-9)
    np.testing.assert_allclose(again.u, once.u, atol=1e-9)


def test_intervals_that_fit_into_memory_at_once_do_not_matter(monkeypatch):
    """Matrices of many states are made for some intervals at a time: what comes of it is equal."""
    _, whole = answered('vanderpol_bounded')
    monkeypatch.setattr(bvp_equations, '_AT_ONCE', 1)
    _, alone = answered('vanderpol_bounded')
    np.testing.assert_array_equal(alone.t, whole.t)
    np.testing.assert_allclose(alone.lam, whole.lam, rtol=1e-12, atol=1e-14)
