# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Minimum time of linear systems: switching times, Pontryagin's conditions, minimality."""

from math import acos, factorial, log, pi, sqrt

import casadi as ca
from hypothesis import assume, given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.ocp.certificate.certificate import certify
from obc_ros.core.ocp.problem import FinalTime, Problem
from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.exact.least_time import find_first_time
from obc_ros.core.solver.exact.reachable_set import Reach
from obc_ros.core.solver.exact.time_optimal import solve_time_optimal
import pytest
from scipy.linalg import expm
from scipy.optimize import linprog

DOUBLE = [[0, 1], [0, 0]]
OSCILLATOR = [[0, 1], [-1, 0]]
small = st.floats(-3, 3).filter(lambda value: value == 0 or abs(value) > 1e-3)


def problem(A, B, x0, xf=None, *, c=None, C=None, u=(-1.0, 1.0), T=(0.0, 50.0), rate=1.0):
    """Return the minimum-time problem from x0 to C x = C xf for x' = A x + B u + c."""
    A = np.array(A, dtype=float)
    n = len(A)
    B = np.array(B, dtype=float).reshape(n, -1)
    m = B.shape[1]
    xf = np.zeros(n) if xf is None else np.array(xf, dtype=float)
    C = np.eye(n) if C is None else np.array(C, dtype=float)
    x, u_, p = ca.SX.sym('x', n), ca.SX.sym('u', m), ca.SX.sym('p', 1)
    f = p * (ca.mtimes(ca.DM(A), x) + ca.mtimes(ca.DM(B), u_)) + (
        ca.DM.zeros(n) if c is None else ca.DM(c))
    none = np.full(n, np.inf)
    lower, upper = (np.broadcast_to(limit, m).astype(float) for limit in u)
    return Problem(
        name='linear', states=tuple(f'x{i}' for i in range(n)),
        inputs=tuple(f'u{j}' for j in range(m)), parameters=('p',), x=x, u=u_, p=p, f=f,
        L=ca.SX(rate), V=ca.SX(0), psi=ca.mtimes(ca.DM(C), x - xf), path=ca.SX(0, 1),
        p_value=np.ones(1), x0=np.array(x0, dtype=float), x_lower=-none, x_upper=none,
        u_lower=lower, u_upper=upper, path_lower=np.zeros(0), path_upper=np.zeros(0),
        final_time=FinalTime(True, lower=T[0], upper=T[1]))


def chain(n):
    return np.diag(np.ones(n - 1), 1), np.eye(n)[:, -1]


def solved(*args, **kwargs):
    stated = problem(*args, **kwargs)
    found = solve_time_optimal(stated)
    assert found is not None
    assert found.status is Status.SOLVED, found.message
    certificate = certify(stated, found)
    assert certificate.holds, certificate
    return found


def reachable(A, B, x0, xf, T, cells=400):
    """Return the largest multiple of the gap that piecewise constant inputs close (an LP)."""
    A, B = np.array(A, dtype=float), np.array(B, dtype=float).reshape(len(A), -1)
    n, m = B.shape
    Z = np.zeros((n + m, n + m))
    Z[:n, :n], Z[:n, n:] = A, B
    step = expm(Z * T / cells)
    blocks, power = [], np.eye(n)
    for _ in range(cells):
        blocks.append(power @ step[:n, n:])
        power = power @ step[:n, :n]
    gap = np.array(xf, dtype=float) - expm(A * T) @ x0
    left = np.column_stack((np.hstack(blocks), -gap))
    found = linprog(np.append(np.zeros(left.shape[1] - 1), -1), A_eq=left, b_eq=np.zeros(n),
                    bounds=[(-1, 1)] * (left.shape[1] - 1) + [(0, None)])
    return found.x[-1]


@pytest.mark.parametrize(('x0', 'T'), [((1, 0), 2.0), ((1, 0.5), 0.5 + 2 * sqrt(1.125))])
def test_double_integrator_has_the_known_switching_time(x0, T):
    found = solved(DOUBLE, [0, 1], x0)
    assert abs(found.objective - T) <= 1e-12
    np.testing.assert_allclose(found.switching_times, [x0[1] + sqrt(x0[0] + x0[1]**2 / 2)])
    assert found.lam[0] @ [x0[1], -1] == pytest.approx(-1)


@settings(max_examples=100, deadline=None)
@given(small, small)
def test_double_integrator_has_the_known_minimum_time(x, v):
    assume(x or v)
    # Bryson and Ho: above the switching curve x + v |v| / 2 = 0 decelerate first.
    side = x + v * abs(v) / 2
    s = np.sign(side) or np.sign(-v)
    found = solve_time_optimal(problem(DOUBLE, [0, 1], (x, v)))
    assert found.objective == pytest.approx(s * v + 2 * sqrt(max(s * x + v * v / 2, 0)), abs=1e-9)
    np.testing.assert_allclose(found.x[-1], 0, atol=1e-12)


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(small, small, small, small, st.floats(-3, -0.1), st.floats(0.1, 3), st.floats(0.1, 4))
def test_double_integrator_between_any_states_is_an_extremal(x0, v0, xf, vf, low, high, rate):
    assume((x0, v0) != (xf, vf))
    stated = problem([[0, 2.0], [0, 0]], [0, -0.5], (x0, v0), (xf, vf), u=(low, high),
                       rate=rate, T=(0, 1e4))
    found = solve_time_optimal(stated)
    t, x, u, lam = found.t, found.x, found.u[:, 0], found.lam
    assert set(u) <= {low, high}
    dt = np.diff(t)
    np.testing.assert_allclose(np.diff(x[:, 1]), -0.5 * u[:-1] * dt, atol=1e-9)
    np.testing.assert_allclose(
        np.diff(x[:, 0]), 2 * dt * (x[:-1, 1] + x[1:, 1]) / 2, atol=1e-9)
    scale = 1 + np.abs(lam).max() * (1 + np.abs(x).max())
    hamiltonian = rate + lam[:, 0] * 2 * x[:, 1] + lam[:, 1] * -0.5 * u
    assert np.abs(hamiltonian).max() <= 1e-9 * scale
    best = rate + lam[:, 0] * 2 * x[:, 1] + np.minimum(
        lam[:, 1] * -0.5 * low, lam[:, 1] * -0.5 * high)
    assert (hamiltonian <= best + 1e-9 * scale).all()
    assert np.ptp(lam[:, 0]) <= 1e-12 * scale
    np.testing.assert_allclose(np.diff(lam[:, 1]), -2 * lam[0, 0] * dt, atol=1e-9 * scale)


@pytest.mark.parametrize('n', [2, 3, 4, 5])
def test_chains_of_integrators_have_known_switching_times(n):
    # The switches of n integrators are the zeros of a Chebyshev polynomial of the second kind:
    # t_k = T (1 - cos(k pi / n)) / 2, and the distance is T^n / (4^(n-1) (n-1)!).
    found = solved(*chain(n), [1, *np.zeros(n - 1)])
    T = (4**(n - 1) * factorial(n - 1))**(1 / n)
    assert found.objective == pytest.approx(T, abs=1e-9)
    k = np.arange(1, n)
    np.testing.assert_allclose(found.switching_times, T * (1 - np.cos(k * pi / n)) / 2, atol=1e-7)


def test_triple_integrator_between_moving_states_ends_right():
    A, B = chain(3)
    found = solved(A, B, [1, 0.3, -0.4], [0.2, 0, 1])
    T, (t1, t2) = found.objective, found.switching_times
    # The three arcs are integrated in closed form.
    a, v, x, u = -0.4, 0.3, 1.0, found.u[0, 0]
    for duration in (t1, t2 - t1, T - t2):
        x += v * duration + a * duration**2 / 2 + u * duration**3 / 6
        v += a * duration + u * duration**2 / 2
        a, u = a + u * duration, -u
    np.testing.assert_allclose([x, v, a], [0.2, 0, 1], atol=1e-12)


def test_oscillator_has_the_known_switching_time():
    # The path is a circular arc about (-1, 0), then one of radius 1 about (1, 0).
    found = solved(OSCILLATOR, [0, 1], (1, 0))
    assert found.switching_times == pytest.approx([acos(7 / 8)], abs=1e-9)
    assert found.objective == pytest.approx(acos(7 / 8) + acos(1 / 4), abs=1e-9)


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(st.floats(-12, 12), st.floats(-12, 12))
def test_oscillator_switches_every_half_turn(x, v):
    assume(np.hypot(x, v) > 0.1)
    found = solved(OSCILLATOR, [0, 1], (x, v))
    np.testing.assert_allclose(np.diff(found.switching_times), pi, atol=1e-7)
    if len(found.switching_times):
        assert found.switching_times[0] <= pi + 1e-7
        assert found.objective - found.switching_times[-1] <= pi + 1e-7


@pytest.mark.parametrize('k', [1, 2, 5])
def test_oscillator_where_no_normal_costate_exists(k):
    # From (2 k, 0), k semicircles about (+-1, 0) lead to the origin. The switching function
    # vanishes at both ends of each, so H = 1 at T: the extremal is abnormal.
    found = solved(OSCILLATOR, [0, 1], (2 * k, 0))
    assert found.objective == pytest.approx(k * pi, abs=1e-9)
    np.testing.assert_allclose(found.switching_times, pi * np.arange(1, k), atol=1e-7)
    assert 'abnormal' in found.message


def test_large_oscillations_end_at_the_origin():
    found = solved(OSCILLATOR, [0, 1], (30.3, 7), T=(0.01, 200))
    assert len(found.switching_times) == 16
    np.testing.assert_allclose(found.x[-1], 0, atol=1e-9)


def test_unstable_mode_has_the_known_time():
    found = solved([[1]], [1], [0.5])   # x = 1 - exp(t)/2
    assert found.objective == pytest.approx(log(2), abs=1e-12)


@pytest.mark.parametrize('x0', [(0.5, -1.0), (-0.5, 1.0)])
def test_a_start_on_the_switching_curve_needs_no_switch(x0):
    found = solved(DOUBLE, [0, 1], x0)
    assert found.objective == pytest.approx(1, abs=1e-12)
    assert len(found.switching_times) == 0


def test_triple_integrator_without_a_switch():
    found = solved(*chain(3), [1 / 6, -1 / 2, 1])
    assert found.objective == pytest.approx(1, abs=1e-9)
    assert len(found.switching_times) == 0


def test_a_free_final_velocity_has_zero_costate():
    found = solved(DOUBLE, [0, 1], (1, 0), C=[[1, 0]])
    assert found.objective == pytest.approx(sqrt(2), abs=1e-12)   # T^2/2 = 1
    assert found.lam[-1, 1] == pytest.approx(0, abs=1e-12)


def test_an_input_with_slack_is_singular():
    A = np.kron(np.eye(2), DOUBLE)
    B = np.kron(np.eye(2), [[0], [1]])
    # The first axis takes T = 2; within 2 the second axis needs only |u1| = 0.3.
    found = solved(A, B, (1, 0, 0.3, 0))
    assert found.objective == pytest.approx(2, abs=1e-12)
    assert set(np.abs(found.u[:, 0])) == {1.0}
    np.testing.assert_allclose(np.abs(found.u[:, 1]), 0.3, atol=1e-12)
    assert 'singular: u1' in found.message


def test_inputs_with_equal_minimum_times_are_solved():
    A = np.kron(np.eye(3), DOUBLE)
    B = np.kron(np.eye(3), [[0], [1]])
    found = solved(A, B, (1, 0, -1, 0, 0.2, -0.1))
    assert found.objective == pytest.approx(2, abs=1e-12)


def test_no_shorter_time_for_a_coupled_system():
    A = [[0, 1, 0], [-2, -0.3, 1], [0, 0, -0.5]]
    B = [[0, 0.2], [1, 0], [0, 1]]
    found = solved(A, B, (2, -1, 3), u=([-1, -0.5], [1, 0.5]))
    scaled = np.array(B) * [1, 0.5]
    T = found.objective
    assert reachable(A, scaled, (2, -1, 3), np.zeros(3), 0.999 * T) < 1
    assert reachable(A, scaled, (2, -1, 3), np.zeros(3), 1.001 * T) > 1


@pytest.mark.slow
@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 4), st.integers(1, 2))
def test_no_shorter_time_for_random_systems(seed, n, m):
    rng = np.random.default_rng(seed)
    A, B, x0 = rng.normal(size=(n, n)), rng.normal(size=(n, m)), rng.normal(size=n)
    A -= max(np.linalg.eigvals(A).real.max(), 0) * np.eye(n)
    stated = problem(A, B, x0)
    found = solve_time_optimal(stated)
    assert found is not None
    assert found.status is Status.SOLVED
    assert certify(stated, found).holds
    T = found.objective
    assert reachable(A, B, x0, np.zeros(n), (1 - 2e-3) * T) < 1
    assert reachable(A, B, x0, np.zeros(n), (1 + 2e-2) * T) > 1


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6))
def test_extremals_of_unstable_systems_are_recovered(seed):
    # n - 1 switching times fix lam(T); the bang-bang input is integrated back from the origin.
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 4))
    A, B, T = rng.normal(size=(n, n)), rng.normal(size=n), float(rng.uniform(0.5, 2))
    tau = T * (np.arange(1, n) + rng.uniform(-0.3, 0.3, n - 1)) / n
    lam = np.linalg.svd([expm(A * s) @ B for s in tau])[2][-1]
    Z = np.zeros((n + 1, n + 1))
    Z[:n, :n], Z[:n, n] = -A, -B
    edges = np.unique(np.concatenate(([0, T], tau, np.linspace(0, T, 400))))
    values = [lam @ expm(A * s) @ B for s in (edges[1:] + edges[:-1]) / 2]
    x = np.zeros(n)
    for h, s in zip(np.diff(edges), values, strict=True):
        back = expm(Z * h)
        x = back[:n, :n] @ x - back[:n, n] * np.sign(s)
    # The grid may have missed two more switches.
    assume(np.count_nonzero(np.diff(np.sign(values))) == n - 1)
    stated = problem(A, B, x)
    found = solve_time_optimal(stated)
    assert found is not None
    assert found.objective == pytest.approx(T, abs=1e-8)
    np.testing.assert_allclose(found.switching_times, np.sort(T - tau), atol=1e-7)
    assert certify(stated, found).holds


def test_the_tail_of_an_optimal_path_is_optimal():
    A, B = chain(3)
    whole = solved(A, B, [1, 0.3, -0.4])
    for k in (10, 25, 40):
        rest = solved(A, B, whole.x[k])
        assert rest.objective == pytest.approx(whole.objective - whole.t[k], abs=1e-9)


def test_minimum_time_scales_with_the_units():
    once = solved(OSCILLATOR, [0, 1], (3, 1))
    fast = solved(3 * np.array(OSCILLATOR), [0, 3], (3, 1))
    expensive = solved(OSCILLATOR, [0, 1], (3, 1), rate=5.0)
    large = solved(OSCILLATOR, [0, 1], (300, 100), u=(-100, 100))
    assert fast.objective == pytest.approx(once.objective / 3, abs=1e-9)
    assert expensive.objective == pytest.approx(5 * once.objective, abs=1e-8)
    np.testing.assert_allclose(expensive.lam, 5 * once.lam, atol=1e-8)
    assert large.objective == pytest.approx(once.objective, abs=1e-9)


def test_asymmetric_bounds_only_shift_the_input():
    plain = solved(DOUBLE, [0, 1], (10, -2), u=(-1.5, 1.5))
    lander = solved(DOUBLE, [0, 1], (10, -2), u=(0, 3), c=[0, -1.5])
    np.testing.assert_allclose(lander.x, plain.x, atol=1e-12)
    assert set(lander.u.ravel()) == {0.0, 3.0}


def test_dependent_terminal_constraints_are_solved():
    found = solved(DOUBLE, [0, 1], (1, 0), C=[[1, 0], [0, 1], [1, 1]])
    assert found.objective == pytest.approx(2, abs=1e-9)
    np.testing.assert_allclose(
        np.array([[1, 0], [0, 1], [1, 1]]).T @ found.nu, found.lam[-1], atol=1e-9)


@pytest.mark.parametrize(('arguments', 'text'), [
    ((DOUBLE, [0, 1], (1, 0)),
     'the terminal constraints cannot be met by T = 1.5: the minimum time is 2'),
    ((*chain(3), (1, 0, 0)),
     # 32^(1/3)
     'the terminal constraints cannot be met by T = 1.5: the minimum time is 3.174802104'),
    (([[1]], [1], [1.5]), 'x0 cannot fall below 1.5 but must be 0 at T: the unstable mode of '
                          'eigenvalue 1 grows faster than the inputs can counteract'),
    (([[-1]], [1], [0.5], [2]),
     'x0 cannot rise above 1 but must be 2 at T: the inputs are too weak'),
    (([[-1, 0], [0, 0]], [1, 0], (0.5, 1), (0, 2)),
     'x1 cannot rise above 1 but must be 2 at T: no input acts on it'),
    (([[0, 0], [0, 0]], [1, 1], (1, 0)),
     'x0 - x1 cannot fall below 1 but must be 0 at T: no input acts on it'),
    (([[1, 1], [-2, 1]], [1, 0], (3, 0)), 'do not reach that far'),
])
def test_infeasible_problems_report_the_reason(arguments, text):
    found = solve_time_optimal(problem(*arguments, T=(0.01, 1.5)))
    assert found.status is Status.INFEASIBLE
    assert text in found.message


def test_contradictory_constraints_are_infeasible():
    stated = problem(DOUBLE, [0, 1], (1, 0), C=[[1, 0], [1, 0]])
    shifted = Problem(**{**stated.__dict__, 'psi': stated.psi + ca.DM([0, 1])})
    found = solve_time_optimal(shifted)
    assert found.status is Status.INFEASIBLE
    assert found.message == 'the terminal constraints contradict each other'


def changed(**fields):
    return Problem(**{**problem(DOUBLE, [0, 1], (1, 0)).__dict__, **fields})


@pytest.mark.parametrize('fields', [
    {'L': ca.SX(0)},
    {'L': ca.SX(-1)},
    {'final_time': FinalTime(False, value=3.0)},
    {'final_time': FinalTime(True, lower=2.5, upper=9.0)},   # the lower bound of T is active
    {'u_upper': np.array([np.inf])},
    {'x_upper': np.array([np.inf, 1.0])},
    {'psi': ca.SX(0, 1)},
    {'x0': np.zeros(2)},
])
def test_other_problems_are_not_accepted(fields):
    assert solve_time_optimal(changed(**fields)) is None


def test_nonlinear_problems_are_not_accepted():
    x, u = ca.SX.sym('x', 2), ca.SX.sym('u', 1)
    base = {'x': x, 'u': u, 'psi': x}
    assert solve_time_optimal(changed(**base, f=ca.vertcat(ca.sin(x[1]), u))) is None
    assert solve_time_optimal(changed(**base, f=ca.vertcat(x[1], u * x[0]))) is None
    assert solve_time_optimal(
        changed(**{**base, 'psi': x**2}, f=ca.vertcat(x[1], u))) is None
    assert solve_time_optimal(
        changed(**base, f=ca.vertcat(x[1], u), V=x[0])) is None


@pytest.mark.parametrize(('late', 'proved'), [(4e-7, False), (1e-3, True)])
def test_a_time_in_which_a_certificate_sees_no_miss_is_not_too_short(late, proved):
    """Within (1 - late) of 2 s, x(T) is 2 late short of 1: a certificate counts 8e-7 as met."""
    found = solve_time_optimal(problem(DOUBLE, [0, 1], (1, 0), T=(0.01, 2 - 2 * late)))
    assert (found.status is Status.INFEASIBLE) == proved


@pytest.mark.parametrize(('late', 'proved'), [(4e-7, False), (1e-4, True)])
def test_the_bound_of_the_least_time_leaves_the_margin_of_a_certificate(late, proved):
    upper = 2 - 2 * late
    reach = Reach(np.array(DOUBLE, dtype=float), np.array([[0.0], [1.0]]), np.zeros(2),
                  np.array([1.0, 0.0]), np.eye(2), np.zeros(2))
    assert (find_first_time(reach, 0.0, upper).too_short >= upper) == proved
