# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""LQR designs substituted into their equations, published examples, and rejected data."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.lqr.lqr import lqr, LqrDesign
from obc_ros.core.text.errors import ObcError, RefusedDesignError, StatementError
from plants import aircraft, CHAIN, FORCE
import pytest
from regulator_problems import cost_of, is_hard, problems
from scipy.linalg import solve_continuous_lyapunov


def residual(design: LqrDesign) -> float:
    """Return the Riccati residual relative to its terms, in extended precision."""
    A, B, P, Qx, Qu = (M.astype(np.longdouble) for M in (
        design.A, design.B, design.P, design.Qx, design.Qu))
    N = 0 * B if design.cross is None else design.cross
    A = A + design.stability * np.eye(len(A))
    K = design.K.astype(np.longdouble)
    terms = [A.T @ P, P @ A, -(P @ B + N) @ K, Qx]
    return float(abs(sum(terms)).max() / max(abs(term).max() for term in terms))


# ---------------------------------------------------------------- closed forms


@pytest.mark.parametrize('q', [1e-3, 0.5, 1.0, 2.0, 37.0, 1e4])
def test_example_2_4_as_corrected_has_its_gain_and_poles(q):
    design = lqr(CHAIN, FORCE, [[q * q, 0], [0, 0]], [[1]])
    assert pytest.approx(np.array([[q, math.sqrt(2 * q)]]), rel=1e-10) == design.K
    P = [[math.sqrt(2 * q**3), q], [q, math.sqrt(2 * q)]]
    assert pytest.approx(np.array(P), rel=1e-10) == design.P
    # omega0 = sqrt(q), zeta = 1 / sqrt(2)
    assert abs(design.E) == pytest.approx([math.sqrt(q)] * 2, rel=1e-10)
    assert -design.E.real / abs(design.E) == pytest.approx([math.sqrt(0.5)] * 2, rel=1e-10)


@pytest.mark.parametrize('a', [0.0, 0.3, 1.0, 5.0, 100.0])
def test_exercise_2_8_has_its_closed_form(a):
    design = lqr([[0, 1], [0, -a]], FORCE, [[1, 0], [0, 0]], [[1]])
    k2 = 2.0 / (math.sqrt(a * a + 2.0) + a)  # = sqrt(a^2 + 2) - a without cancellation
    assert pytest.approx(np.array([[1.0, k2]]), rel=1e-10) == design.K
    s1, s2 = design.E
    assert (s1 * s2).real == pytest.approx(1.0, rel=1e-10)
    assert -(s1 + s2).real == pytest.approx(math.sqrt(a * a + 2.0), rel=1e-10)


@pytest.mark.parametrize('Qx, Qu', [
    (np.eye(6), np.eye(2)),
    (np.eye(6), 100 * np.eye(2)),
    (np.diag([100, 1, 2 * np.pi / 9, 0, 0, 0]), 0.1 * np.eye(2)),
    (np.diag([100, 1, 1.3131, 0, 0, 0]), np.diag([0.1, 10])),
])
def test_example_2_5_agrees_with_python_control(Qx, Qu):
    import control

    A, B = aircraft()
    design = lqr(A, B, Qx, Qu)
    K, P, E = control.lqr(A, B, Qx, Qu, method='scipy')
    assert abs(design.K - K).max() <= 1e-10 * abs(K).max()
    assert abs(design.P - P).max() <= 1e-10 * abs(P).max()
    assert pytest.approx(np.sort_complex(E), rel=1e-7) == design.E
    assert residual(design) <= 1e-14


def test_exercise_2_9_comes_to_rest_only_on_request():
    a, b = 2.0, 0.5
    with pytest.raises(RefusedDesignError, match=r'not detectable: the mode s = \+2 does not'):
        lqr([[a]], [[b]], [[0]], [[1]])
    design = lqr([[a]], [[b]], [[0]], [[1]], to_rest=True)
    assert design.P[0, 0] == pytest.approx(2 * a / b**2, rel=1e-14)
    assert design.E[0].real == pytest.approx(-a, rel=1e-14)


def test_theorem_2_2_cost_is_the_integral():
    """Integrate the cost of the closed loop from x0 independently; it is x0'P x0."""
    from scipy.integrate import solve_ivp

    A, B = aircraft()
    design = lqr(A, B, np.eye(6), np.eye(2))
    x0 = np.array([1.0, -0.5, 0.2, 0.0, 0.3, -0.1])
    M, Q = A - B @ design.K, np.eye(6) + design.K.T @ design.K

    def f(t, z):
        return np.append(M @ z[:6], z[:6] @ Q @ z[:6])

    z = solve_ivp(f, (0, 80), np.append(x0, 0.0), rtol=1e-11, atol=1e-13, method='DOP853').y[:, -1]
    assert z[6] == pytest.approx(x0 @ design.P @ x0, rel=1e-9)


def test_perturbed_gains_cost_more():
    rng = np.random.default_rng(1)
    A, B = aircraft()
    design = lqr(A, B, np.eye(6), np.eye(2))
    for _ in range(100):
        K = design.K + 0.1 * rng.standard_normal((2, 6))
        M = A - B @ K
        if np.linalg.eigvals(M).real.max() < 0:
            P = solve_continuous_lyapunov(M.T, -(np.eye(6) + K.T @ K))
            assert np.linalg.eigvalsh(P - design.P)[0] > -1e-9 * abs(P).max()


# ---------------------------------------------------------------- cross terms, degree of stability


def test_cross_term_completes_the_square():
    A, B = aircraft()
    rng = np.random.default_rng(2)
    N = 0.2 * rng.standard_normal((6, 2))
    Qx, Qu = 3 * np.eye(6), np.diag([1.0, 2.0])
    design = lqr(A, B, Qx, Qu, cross=N)
    S = np.linalg.solve(Qu, N.T)
    plain = lqr(A - B @ S, B, Qx - N @ S, Qu)
    assert pytest.approx(plain.K + S, rel=1e-10) == design.K
    assert residual(design) <= 1e-13


def test_an_indefinite_cost_with_a_cross_term_is_rejected():
    with pytest.raises(RefusedDesignError, match="Qx - cross Qu.-1 cross' must be positive"):
        lqr(CHAIN, FORCE, np.eye(2), [[1]], cross=[[2], [0]])


@pytest.mark.parametrize('alpha', [0.1, 1.0, 5.0])
def test_the_degree_of_stability_bounds_the_poles(alpha):
    A, B = aircraft()
    design = lqr(A, B, np.eye(6), np.eye(2), stability=alpha)
    assert design.E.real.max() < -alpha
    assert residual(design) <= 1e-12


def test_an_unattainable_degree_of_stability_is_rejected():
    with pytest.raises(RefusedDesignError, match=r'not stabilisable with the degree of stability '
                       r'2 1/s: the mode s = -1 is uncontrollable'):
        lqr(np.diag([1.0, -1.0]), [[1], [0]], np.eye(2), [[1]], stability=2.0)


# ---------------------------------------------------------------- rejected data


def test_errors_name_shapes_numbers_and_symmetry():
    for arguments, words in [
        ((np.zeros((3, 2)), FORCE, np.eye(2), [[1]]), 'A: expected (3, 3) but found (3, 2)'),
        ((CHAIN, np.zeros((3, 2)), np.eye(2), np.eye(2)), 'B: expected (2, 2) but found (3, 2)'),
        ((CHAIN, FORCE, np.eye(3), [[1]]), 'Qx: expected (2, 2) but found (3, 3)'),
        ((CHAIN, FORCE, np.eye(2), np.eye(2)), 'Qu: expected (1, 1) but found (2, 2)'),
        ((CHAIN, [0, 1], np.eye(2), [[1]]), 'B: expected a matrix (rows, columns) but found (2,)'),
        ((CHAIN, FORCE, [[1, math.nan], [0, 1]], [[1]]), 'Qx[0, 1] = nan: wanted a finite number'),
        ((CHAIN, FORCE, np.eye(2), [[math.inf]]), 'Qu[0, 0] = inf: wanted a finite number'),
        ((CHAIN, FORCE, [[1, 2], [3, 1]], [[1]]),
         'Qx[0, 1] = 2 but Qx[1, 0] = 3: Qx must be symmetric'),
        ((CHAIN, FORCE, [[1], [2, 3]], [[1]]), 'Qx: wanted rows of equal length'),
        ((CHAIN, FORCE, [['1', '0'], ['0', '1']], [[1]]), 'Qx: wanted a matrix of real numbers'),
        ((CHAIN, FORCE, np.eye(2), [[1j]]), 'Qu: wanted a matrix of real numbers'),
        ((np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((0, 0)), [[1]]),
         'A and B: wanted at least one state and one input'),
    ]:
        with pytest.raises(StatementError) as error:
            lqr(*arguments)
        assert str(error.value).startswith(words)
    with pytest.raises(StatementError, match='stability = nan'):
        lqr(CHAIN, FORCE, np.eye(2), [[1]], stability=math.nan)


def test_errors_name_indefinite_weights():
    A, B = aircraft()
    for Qx, Qu, words in [
        (np.eye(6), np.diag([1, -0.1]), 'Qu[1] = -0.1: Qu must be positive definite'),
        (np.eye(6), np.diag([0, 1]), 'Qu[0] = 0: Qu must be positive definite'),
        (np.eye(6), [[1, 2], [2, 1]], 'Qu must be positive definite: scaled to a unit '
         'diagonal, its minimum eigenvalue is -1'),
        (np.eye(6), [[1, 1], [1, 1]], 'Qu must be positive definite: scaled to a unit '),
        (np.diag([1, 1, -2, 1, 1, 1]), np.eye(2), 'Qx[2] = -2: Qx must be positive semidefinite'),
        (np.fliplr(np.eye(6)), np.eye(2), 'Qx[0, 5] = 1 but Qx[0, 0] = 0: Qx must be positive'),
    ]:
        with pytest.raises(RefusedDesignError) as error:
            lqr(A, B, Qx, Qu)
        assert str(error.value).startswith(words)
    with pytest.raises(RefusedDesignError, match='Qu.0. = -1: Qu must be positive definite'):
        lqr(CHAIN, FORCE, np.eye(2), [[-1]])


def test_errors_name_uncontrollable_modes():
    with pytest.raises(RefusedDesignError, match=r'^.A, B. is not stabilisable: the mode s = \+1'):
        lqr(np.diag([1.0, -2.0]), FORCE, np.eye(2), [[1]])
    with pytest.raises(RefusedDesignError, match=r'the mode s = 0 is uncontrollable'):
        lqr(np.diag([0.0, -2.0]), FORCE, np.eye(2), [[1]])
    A = np.zeros((3, 3))
    A[:2, :2] = [[0.5, 2], [-2, 0.5]]
    with pytest.raises(RefusedDesignError, match=r'the mode s = \+0.5 \+- 2j is uncontrollable'):
        lqr(A, [[0], [0], [1]], np.eye(3), [[1]])
    with pytest.raises(RefusedDesignError, match=r'the modes s = \+1 and s = \+2 are unc'):
        lqr(np.diag([1.0, 2.0]), np.zeros((2, 1)), np.eye(2), [[1]])


@pytest.mark.parametrize('seed', range(20))
def test_errors_name_uncontrollable_modes_in_other_coordinates(seed):
    """In other coordinates rounding makes the mode controllable by 1e-16; it is still named."""
    rng = np.random.default_rng(seed)
    T = rng.standard_normal((4, 4)) + 3 * np.eye(4)
    A = T @ np.diag([1.5, -1.0, 0.3, -2.0]) @ np.linalg.inv(T)
    B = T @ np.array([[0.0], [1.0], [1.0], [1.0]])
    with pytest.raises(RefusedDesignError, match=r'the mode s = \+1.5 is uncontrollable'):
        lqr(A, B, np.eye(4), [[1]])


def test_errors_name_modes_that_are_absent_from_the_cost():
    with pytest.raises(RefusedDesignError, match=r'not detectable: the mode s = 0 does not'):
        lqr(CHAIN, FORCE, np.diag([0.0, 1.0]), [[1]])
    with pytest.raises(RefusedDesignError, match=r'not detectable: the mode s = \+1 does not'):
        lqr(np.diag([1.0, 2.0]), np.eye(2), np.diag([0.0, 1.0]), np.eye(2))
    # A stable mode needs no weight.
    assert lqr(np.diag([-1.0, 2.0]), np.eye(2), np.diag([0.0, 1.0]), np.eye(2)).P[0, 0] == 0.0


def test_weights_on_which_python_control_fails_are_handled():
    """control.lqr returns an unstable gain for the first and accepts the second."""
    design = lqr(CHAIN, FORCE, np.diag([1e16, 1e-16]), [[1e-16]])
    assert pytest.approx(np.array([[1e16, math.sqrt(2e16)]]), rel=1e-12) == design.K
    with pytest.raises(RefusedDesignError, match='positive definite'):
        lqr(CHAIN, FORCE, np.eye(2), [[-1.0]])


@pytest.mark.parametrize('bad', [None, 'Qx', {}, [[None]], object(), [[10**400]], [], [[[1.0]]]])
def test_hostile_arguments_are_rejected_with_a_message(bad):
    for position in range(4):
        arguments = [CHAIN, FORCE, np.eye(2), np.eye(1)]
        arguments[position] = bad
        with pytest.raises(ObcError):
            lqr(*arguments)


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('a', [1e100, 1e-200, 5e-324, -1e90])
def test_extreme_numbers_are_verified_or_rejected(a):
    for b in (1e100, 1e-200, 5e-324, 1.0):
        for q in (1e100, 1e-200, 1.0):
            for A, B in (([[a]], [[b]]), ([[0, a], [0, 0]], [[0], [b]])):
                for r in (1e100, 1e-200, 5e-324, 1.0):
                    try:
                        design = lqr(A, B, q * np.eye(len(A)), [[r]])
                    except ObcError:
                        continue
                    assert np.isfinite(design.K).all()
                    assert design.E.real.max() < 0


# ---------------------------------------------------------------- properties


@pytest.mark.slow
@settings(max_examples=400, deadline=None)
@given(problems())
def test_accepted_gains_stabilise_and_easy_problems_pass(problem):
    A, B, Qx, Qu = problem
    try:
        design = lqr(A, B, Qx, Qu)
    except RefusedDesignError:
        assert is_hard(A, B, Qx, Qu)
        return
    assert np.linalg.eigvals(A - B @ design.K).real.max() < 0
    assert design.residual <= 1e-8
    assert np.linalg.eigvalsh(design.P)[0] >= -1e-6 * abs(design.P).max()
    # The Lyapunov equation of the closed loop reproduces P.
    again = cost_of(design.K, A, B, Qx, Qu)
    assert abs(again - design.P).max() <= 1e-2 * abs(design.P).max()


@settings(max_examples=100, deadline=None)
@given(problems(largest_spread=2.0), st.floats(-8, 8), st.floats(-8, 8))
def test_units_change_neither_poles_nor_acceptance(problem, state_decades, cost_decades):
    """Scaling the units of the states and of the cost changes neither poles nor acceptance."""
    A, B, Qx, Qu = problem
    try:
        design = lqr(A, B, Qx, Qu)
    except RefusedDesignError:
        return
    n = len(A)
    T = np.exp2(np.rint(np.linspace(0, state_decades * 3.3, n)))
    size = 2.0 ** round(cost_decades * 3.3)
    near_the_border = design.error > 1e-12 or design.robustness < 1e6
    try:
        other = lqr(A * (T[:, None] / T), B * T[:, None], Qx * size / (T * T[:, None]), Qu * size)
    except RefusedDesignError:
        assert near_the_border  # near the limit of verification units may decide
        return
    scale = abs(design.K).max(axis=0, initial=1e-300)
    assert near_the_border or (abs(other.K * T - design.K) / scale).max() <= 1e-6


def test_poles_scale_with_time():
    A, B = aircraft()
    design = lqr(A, B, np.eye(6), np.eye(2))
    fast = lqr(16 * A, 16 * B, np.eye(6), np.eye(2))
    assert pytest.approx(16 * design.E, rel=1e-10) == fast.E
    assert pytest.approx(design.K, rel=1e-10) == fast.K


def test_larger_weights_give_larger_costs():
    A, B = aircraft()
    small, large = lqr(A, B, np.eye(6), np.eye(2)), lqr(A, B, 2 * np.eye(6), np.eye(2))
    assert np.linalg.eigvalsh(large.P - small.P)[0] > 0
