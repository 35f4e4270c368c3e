# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Closed forms of chapter 2, substituted into the equations that they solve."""

from decimal import Decimal, localcontext
from itertools import pairwise
from math import inf, pi, sqrt

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.book import closed_forms
from obc_ros.core.text.errors import StatementError
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.linalg import solve_continuous_are

positive = st.floats(0.1, 3)


def book(a, b, c, x0, tf, t):
    """Return (2.4) and (2.5) as printed with t0 = 0, with 60 digits."""
    with localcontext() as context:
        context.prec = 60
        a, b, c, x0, tf, t = (Decimal(float(v)) for v in (a, b, c, x0, tf, t))
        below = 2 * a - b * b * c * (1 - (2 * a * tf).exp())
        u = -2 * a * b * c * (a * (2 * tf - t)).exp() * x0 / below
        x = x0 * (a * t).exp() + b * b * c * (a * tf).exp() * x0 / below * (
            (a * (tf - t)).exp() - (a * (t + tf)).exp())
        return float(u), float(x)


@pytest.mark.parametrize(('a', 'T'), [(2, 10), (2, 50), (1, 1), (0.01, 3)])
def test_example_2_2_to_the_last_digits(a, T):
    t = T * np.array([0, 0.1, 0.5, 0.9, 0.999, 1])
    found = closed_forms.solve_scalar_finite_horizon(a, 0.5, 10, 4, t, tf=T)
    for k, time in enumerate(t):
        u, x = book(a, 0.5, 10, 4, T, time)
        assert found.u[k] == pytest.approx(u, rel=1e-12)
        assert found.x[k] == pytest.approx(x, rel=1e-12)


@settings(max_examples=60, deadline=None)
@given(st.floats(-2, 2), positive, st.floats(0, 20), st.floats(-3, 3), positive)
def test_the_finite_horizon_satisfies_pontryagin(a, b, c, x0, T):
    t = np.linspace(0, T, 41)
    found = closed_forms.solve_scalar_finite_horizon(a, b, c, x0, t, tf=T)
    scale = 1 + abs(found.x).max() + abs(found.lam).max() * b * b
    np.testing.assert_allclose(found.u, -b * found.lam)
    np.testing.assert_allclose(found.lam, found.lam[-1] * np.exp(a * (t[-1] - t)), atol=1e-12)
    assert found.lam[-1] == pytest.approx(c * found.x[-1], abs=1e-9 * scale)
    assert found.x[0] == pytest.approx(x0)
    end = solve_ivp(lambda s, x: a * x - b * b * found.lam[-1] * np.exp(a * (t[-1] - s)),
                    (t[0], t[-1]), [x0], rtol=1e-10, atol=1e-12, t_eval=t).y[0]
    np.testing.assert_allclose(found.x, end, atol=1e-7 * scale)
    cost = quad(lambda s: (b * found.lam[-1] * np.exp(a * (t[-1] - s)))**2 / 2, t[0], t[-1])[0]
    assert pytest.approx(cost + c * found.x[-1]**2 / 2, rel=1e-7, abs=1e-12) == found.J
    assert found.u[0] == pytest.approx(-b * found.P * x0)


def test_unit_parameters_have_the_known_cost_and_end():
    # J = 1/(1 + exp(-2)) and x(1) = 1/cosh(1)
    found = closed_forms.solve_scalar_finite_horizon(1, 1, 1, 1, [0, 1], tf=1)
    assert pytest.approx(0.8807970779778824, rel=1e-14) == found.J
    assert found.x[-1] == pytest.approx(0.6480542736638853, rel=1e-14)


def test_terminal_state_tends_to_zero_as_its_weight_grows():
    weights = [1, 1e2, 1e4, 1e8, 1e16]
    finals = [closed_forms.solve_scalar_finite_horizon(2, 0.5, c, 4, [1], tf=1).x[0]
              for c in weights]
    assert all(late < early for early, late in pairwise(finals))
    t = np.linspace(0, 1, 11)
    limit = closed_forms.solve_scalar_finite_horizon(2, 0.5, inf, 4, t, tf=1)
    large = closed_forms.solve_scalar_finite_horizon(2, 0.5, 1e14, 4, t, tf=1)
    assert limit.x[-1] == 0
    np.testing.assert_allclose(large.u, limit.u, rtol=1e-12)
    np.testing.assert_allclose(large.x, limit.x, atol=1e-12)


def test_exercise_2_9_is_the_limit_of_long_horizons():
    errors = [abs(closed_forms.solve_scalar_finite_horizon(2, 0.5, c, 4, [0.25], tf=tf).x
                  - 4 * np.exp(-0.5))[0] for tf in (0.5, 1, 10) for c in (0.1, 10)]
    # The last two have tf = 10; one of them is the closest of the six.
    assert np.argmin(errors) >= 4
    assert errors[-1] < 1e-6


@pytest.mark.parametrize('q', [0.1, 1, 2, 30])
def test_example_2_4_as_corrected_solves_the_riccati_equation(q):
    A, B = np.array([[0, 1], [0, 0]]), np.array([[0], [1]])
    found = closed_forms.solve_double_integrator_regulator(q)
    np.testing.assert_allclose(
        found.P, solve_continuous_are(A, B, np.diag([q * q, 0]), np.eye(1)), rtol=1e-9)
    np.testing.assert_allclose(found.K, B.T @ found.P)
    check_poles(A - B @ found.K, found)


@pytest.mark.parametrize('a', [0.1, 1, 1e3])
def test_exercise_2_8_solves_the_riccati_equation(a):
    A, B = np.array([[0, 1], [0, -a]]), np.array([[0], [1]])
    found = closed_forms.solve_lag_regulator(a)
    residual = A.T @ found.P + found.P @ A - found.P @ B @ B.T @ found.P + np.diag([1, 0])
    np.testing.assert_allclose(residual, 0, atol=1e-12 * max(a, 1))
    np.testing.assert_allclose(found.K, B.T @ found.P)
    assert found.K[0, 1] == pytest.approx(sqrt(a * a + 2) - a, rel=1e-9)
    check_poles(A - B @ found.K, found)


def check_poles(closed, found):
    wanted = np.array([1, 2 * found.zeta * found.omega0, found.omega0**2])
    np.testing.assert_allclose(np.poly(closed), wanted, rtol=1e-9)


def areas(path):
    """Return Y(1), q(1) and J by the trapezoidal rule, exact for sinusoids over whole periods."""
    u, q = path.u[:-1], path.q[:-1]
    Y = np.einsum('ki,kj->ij', q, u) - np.einsum('ki,kj->ij', u, q)
    return Y / len(u), path.q[-1], np.sum(u**2) / 2 / len(u)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 7), st.integers(0, 10**6))
def test_brockett_paths_enclose_the_required_area(m, seed):
    random = np.random.default_rng(seed).normal(size=(m, m))
    wanted = random - random.T
    path = closed_forms.solve_brockett(wanted, np.linspace(0, 1, 65))
    Y, end, J = areas(path)
    np.testing.assert_allclose(Y, wanted, atol=1e-12)
    np.testing.assert_allclose(end, 0, atol=1e-12)
    np.testing.assert_allclose(path.q[0], 0, atol=1e-15)
    assert pytest.approx(J, abs=1e-12) == path.J
    sigma = np.linalg.svd(wanted, compute_uv=False)[0:2 * (m // 2):2]
    assert pytest.approx(pi * np.sum(np.arange(1, len(sigma) + 1) * sigma)) == path.J


def test_brockett_with_equal_singular_values():
    wanted = np.kron(np.eye(2), [[0, 1], [-1, 0]])
    Y, _, J = areas(closed_forms.solve_brockett(wanted, np.linspace(0, 1, 65)))
    np.testing.assert_allclose(Y, wanted, atol=1e-12)
    assert pytest.approx(3 * pi) == J   # pi (1 sigma_1 + 2 sigma_2)


@settings(max_examples=30, deadline=None)
@given(st.tuples(*[st.floats(-5, 5)] * 3))
def test_brockett_in_three_dimensions(y):
    path = closed_forms.solve_brockett(np.cross(y, np.eye(3)).T, np.linspace(0, 1, 33))
    Y, _, J = areas(path)
    for z in np.eye(3):
        np.testing.assert_allclose(Y @ z, np.cross(y, z), atol=1e-12)
    assert pytest.approx(pi * np.linalg.norm(y), abs=1e-12) == J
    np.testing.assert_allclose(path.u @ y, 0, atol=1e-10)


def test_no_random_neighbour_of_brocketts_path_is_cheaper():
    # h is a sinusoid that vanishes at both ends; q + h is scaled to the same area.
    t = np.linspace(0, 1, 129)
    path = closed_forms.solve_brockett([[0, 2.0], [-2.0, 0]], t)
    rng = np.random.default_rng(1)
    for _ in range(100):
        k, size = rng.integers(1, 6, 2), 0.2 * rng.normal(size=2)
        q = path.q + size * np.sin(2 * pi * np.outer(t, k))
        u = path.u + size * 2 * pi * k * np.cos(2 * pi * np.outer(t, k))
        Y, _, J = areas(closed_forms.BrockettPath(t, q, u, 0.0))
        assert abs(2.0 / Y[0, 1]) * J >= path.J * (1 - 1e-12)


def test_straight_line_has_the_known_length_and_costate():
    path = closed_forms.solve_straight_line([1, 2], [4, 6], np.linspace(0, 1, 5))
    assert path.length == 5
    np.testing.assert_allclose(path.x[[0, -1]], [[1, 2], [4, 6]])
    np.testing.assert_allclose(path.lam, [-0.6, -0.8])
    H = np.linalg.norm(path.u, axis=1) + path.u @ path.lam
    np.testing.assert_allclose(H, 0, atol=1e-15)
    assert closed_forms.solve_straight_line([1, 2], [1, 2], [0.5]).length == 0


@pytest.mark.parametrize(('call', 'text'), [
    (lambda: closed_forms.solve_scalar_finite_horizon(inf, 1, 1, 1, [0], tf=1), 'a = inf'),
    (lambda: closed_forms.solve_scalar_finite_horizon(1, 0, 1, 1, [0], tf=1), 'b = 0'),
    (lambda: closed_forms.solve_scalar_finite_horizon(1, 1, -1, 1, [0], tf=1), 'c = -1'),
    (lambda: closed_forms.solve_scalar_finite_horizon(1, 1, float('nan'), 1, [0], tf=1),
     'c = nan'),
    (lambda: closed_forms.solve_scalar_finite_horizon(1, 1, 1, 1, [0], tf=0),
     'tf = 0: wanted a number > 0'),
    (lambda: closed_forms.solve_scalar_finite_horizon(1, 1, 1, 1, [2], tf=1),
     'times must lie within'),
    (lambda: closed_forms.solve_double_integrator_regulator(0), 'q = 0'),
    (lambda: closed_forms.solve_lag_regulator(-1), 'a = -1'),
    (lambda: closed_forms.solve_brockett([[0, 1], [1, 0]], [0]), 'must be skew'),
    (lambda: closed_forms.solve_brockett([[0, 1, 2], [1, 0, 1]], [0]), 'square matrix'),
    (lambda: closed_forms.solve_brockett([[0, inf], [-inf, 0]], [0]), 'finite'),
    (lambda: closed_forms.solve_brockett([[0, 1], [-1, 0]], [2]), 'within \\[0, 1\\]'),
    (lambda: closed_forms.solve_straight_line([1], [1, 2], [0]), 'equal dimension'),
    (lambda: closed_forms.solve_straight_line([1, inf], [1, 2], [0]), 'finite'),
])
def test_bad_input_is_rejected(call, text):
    with pytest.raises(StatementError, match=text):
        call()
