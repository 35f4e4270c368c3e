# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Components of proofs: enclosures of paths, separation by weak duality, exact arithmetic."""

from fractions import Fraction
import math

import casadi as ca
from hypothesis import given, settings
from hypothesis import strategies as st
import mpmath
import numpy as np
from obc_ros.core.numerics.enclosures.taylor_enclosure import Tube
from obc_ros.core.numerics.rational_polynomials import find_null_space, read_polynomials
from obc_ros.core.ocp.affine_constraints import find_affine_end
from obc_ros.core.solver.exact.reachable_set import compute_exponential, Reach
from obc_ros.core.solver.exact.weak_duality import is_excluded, is_never_met
from obc_ros.core.solver.proofs.contradictions import explain_contradiction
from obc_ros.core.solver.proofs.existence import explain_no_minimum
import problems
import pytest
from scipy.linalg import expm
from scipy.optimize import linprog

BOUNDED = problems.DOUBLE_INTEGRATOR | {'input_bounds': {'u': [-1, 1]}}


# ---------------------------------------------------------------- false proofs found at 2fa802b


@pytest.mark.slow
@pytest.mark.parametrize('changes', [
    # x is in units of 1e-10: the second constraint is independent of the first.
    {'dynamics': {'x': '1e10*v', 'v': 'u'}, 'input_bounds': {},
     'terminal_constraints': ['v - 1', '1e-10*x + v - 3']},
    # The factor of the input is tiny, but its bounds are wide.
    {'dynamics': {'x': 'v', 'v': '1e-12*u'}, 'input_bounds': {'u': [-1e13, 1e13]}},
    # Between samples of the final time the oscillator takes every value.
    {'states': ['x', 'v', 'z'], 'dynamics': {'x': '628.5*v', 'v': '-628.5*x', 'z': 'u'},
     'initial_state': {'x': 1, 'v': 0, 'z': 0}, 'terminal_constraints': ['x - 0.5'],
     'final_time': {'free': True, 'lower': 1, 'upper': 2}},
])
def test_feasible_problems_are_not_proved_infeasible(changes):
    assert explain_contradiction(problems.build(BOUNDED, **changes)) == ''


@pytest.mark.parametrize('cost', [
    '0.1*u**2 + 0.2*u**2 - 0.3*u**2 + x**2', '0.3*u**2 - 0.2*u**2 - 0.1*u**2 + x**2',
    '0.3*u - 0.2*u - 0.1*u', '0.1*u + 0.2*u - 0.3*u'])
def test_terms_that_cancel_in_decimals_leave_a_bounded_cost(cost):
    """No cost is below 0; in doubles the cancelling terms leave up to 6e-17 of either sign."""
    assert explain_no_minimum(problems.build(BOUNDED, running_cost=cost, input_bounds={})) == ''


# ---------------------------------------------------------------- enclosures of paths


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 4), st.floats(0.1, 5))
def test_a_tube_encloses_the_matrix_exponential(seed, n, T):
    rng = np.random.default_rng(seed)
    A, start = rng.normal(size=(n, n)), rng.normal(size=n)
    y = ca.SX.sym('y', n)
    none = np.zeros(0)
    *_, last = Tube(y, ca.SX(0, 1), ca.mtimes(ca.DM(A), y), (none, none)).steps(
        (start, start), np.array([T]))
    assert last.end == T
    exact = mpmath.expm(mpmath.matrix(A.tolist()) * mpmath.mpf(T)) * mpmath.matrix(start.tolist())
    for low, value, high in zip(*(last.after[0], exact, last.after[1]), strict=True):
        assert low <= value <= high
    assert np.max(last.after[1] - last.after[0]) < 1e-6 * np.exp(2 * np.linalg.norm(A) * T)


@pytest.mark.slow
def test_a_tube_follows_a_nonlinear_path_and_an_oscillation():
    y, none = ca.SX.sym('y', 2), np.zeros(0)
    system = ca.vertcat(1 + y[0]**2, 0)
    *_, last = Tube(y, ca.SX(0, 1), system, (none, none)).steps(
        (np.zeros(2), np.zeros(2)), np.array([1.0]))
    assert last.after[0][0] <= math.tan(1) <= last.after[1][0]
    assert last.after[1][0] - last.after[0][0] < 1e-7
    turn = ca.vertcat(40 * y[1], -40 * y[0])
    *_, last = Tube(y, ca.SX(0, 1), turn, (none, none)).steps(
        (np.array([1.0, 0.0]), np.array([1.0, 0.0])), np.array([2.0]))
    assert last.end == 2.0
    assert last.after[0][0] <= math.cos(80) <= last.after[1][0]
    assert last.after[1][0] - last.after[0][0] < 1e-6


@pytest.mark.slow
def test_a_tube_ends_before_a_pole():
    y, none = ca.SX.sym('y'), np.zeros(0)
    steps = list(Tube(y, ca.SX(0, 1), 1 + y**2, (none, none)).steps(
        (np.zeros(1), np.zeros(1)), np.array([2.0])))
    assert steps[-1].end < math.pi / 2


# ---------------------------------------------------------------- separation


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 4), st.floats(0.2, 3))
def test_reachable_states_are_never_called_unreachable(seed, n, T):
    rng = np.random.default_rng(seed)
    A, B, c, x0 = (rng.normal(size=shape) for shape in ((n, n), (n, 1), n, n))
    x, parts = x0, 8
    Z = np.zeros((n + 2, n + 2))
    Z[:n, :n], Z[:n, n:n + 1], Z[:n, -1] = A, B, c
    step = expm(Z * T / parts)
    for v in rng.choice([-1.0, 1.0, rng.uniform(-1, 1)], parts):
        x = step[:n, :n] @ x + step[:n, n] * v + step[:n, -1]
    reach = Reach(A, B, c, x0, np.eye(n), x)
    assert not is_never_met(reach, T, T)
    assert not is_never_met(reach, 0.0, 1.1 * T)
    far = reach.reached(T, np.eye(n)[0])   # of the first state alone
    free = expm(Z * T)[0] @ np.concatenate([x0, [0.0, 1.0]])
    alone = Reach(A, B, c, x0, np.eye(n)[:1], np.array([free + far * 1.001 + 1e-3]))
    assert is_never_met(alone, T, T)


@pytest.mark.parametrize(('T', 'bounds', 'proved'), [
    (1.99, {}, True), (2.01, {}, False), (4.5, {'v': [-0.2, 0.2]}, True),
    (5.3, {'v': [-0.2, 0.2]}, False), (3.0, {'x': [None, 0.9]}, True)])
def test_only_infeasible_double_integrators_are_excluded(T, bounds, proved):
    # Rest to rest over 1 takes 2 at least, and 1/0.2 + 0.2 = 5.2 with |v| <= 0.2.
    assert is_excluded(problems.build(BOUNDED, final_time={'free': False, 'value': T},
                              state_bounds=bounds)) is proved


def test_weak_duality_ends_at_the_time_limit(monkeypatch):
    """The linear programme, which takes nearly all of the time, gets the time that is left."""
    problem = problems.build(BOUNDED, final_time={'free': False, 'value': 1.9})
    limits = []

    def note(*args, options, **kwargs):
        limits.append(options['time_limit'])
        return linprog(*args, options=options, **kwargs)

    monkeypatch.setattr('scipy.optimize.linprog', note)
    assert is_excluded(problem, 60.0)
    assert not is_excluded(problem, 0.0)
    [limit] = limits
    assert 50.0 < limit < 60.0


def test_the_matrix_exponential_is_accurate_for_poor_scaling():
    """Two equal modes drive a state by entries of 5e17; every entry has a small relative error."""
    rate, T, far = 8.478e-3, 152.0, (5.45e17, -7.65e17)
    found = compute_exponential(T * np.array([[rate, 0, 0], [0, rate, 0], [*far, 0]]))
    grown, driven = math.exp(rate * T), math.expm1(rate * T) / rate
    exact = np.array([[grown, 0, 0], [0, grown, 0], [far[0] * driven, far[1] * driven, 1]])
    assert found == pytest.approx(exact, rel=1e-13)


@pytest.mark.parametrize('h', [22.4, 5743.0])
def test_the_matrix_exponential_is_accurate_without_cycles(h):
    """The entries of 6e17 lie on no cycle, so that LAPACK does not balance them."""
    rate = -1.43769127e-04
    Z = h * np.array([
        [rate, 0, 0, 0.3145737, -54.4], [0, rate, 0, 0.39842967, -68.9],
        [6.38458705e17, -5.04084738e17, 0, 0, 0], [0, 0, 0, 0, 0], [0, 0, 0, 0, 0]])
    with mpmath.workdps(80):
        exact, terms = (np.array(mpmath.expm(mpmath.matrix(each.tolist())).tolist(), dtype=float)
                        for each in (Z, np.abs(Z)))
    assert np.all(np.abs(compute_exponential(Z) - exact) <= 1e-13 * terms)


def test_poorly_scaled_states_are_not_called_unreachable():
    """x0 and x1 have nearly the same mode; a singular value decomposition did not converge."""
    mode = '-0.41810843788713326*(x{0}/{1}) + u/0.022893317148108366'
    first, second = (mode.format(0, 0.00032100385267042254), mode.format(1, 3.176358687772462e-06))
    assert explain_contradiction(problems.build(
        BOUNDED, states=['x0', 'x1', 'x2'], inputs=['u'],
        initial_state={'x0': -0.00041186977757868404, 'x1': -2.169992478800012e-06,
                       'x2': 0.08101934088632733},
        dynamics={'x0': f'({first})*1.1037912520704776e-07',
                  'x1': f'({second})*1.092210234810167e-09',
                  'x2': '(x0/0.00032100385267042254 - x1/3.176358687772462e-06)'
                        '*2.2220474594140145e-05'},
        running_cost='1', input_bounds={'u': [-5.412961054535154, -5.350739010050496]},
        terminal_constraints=['x0 + 0.10986753176982986', 'x1 + 0.0010864063871911976',
                              'x2 - 0.024385690441982525'],
        state_bounds={'x0': [-0.11008700762415555, -0.00019239392325299013],
                      'x1': [-0.001088580448230516, 4.068560518601825e-09]},
        final_time={'free': False, 'value': 6563.990097281992})) == ''


def test_no_proof_rests_on_a_direction_lost_to_rounding():
    """The input moves x and y alike; z, their difference in other units, stays close to 0."""
    assert explain_contradiction(problems.build(
        BOUNDED, states=['x', 'y', 'z'], inputs=['w'],
        initial_state={'x': 7.368741154814138e-08, 'y': 1.0667385307101855,
                       'z': -6.748415067481089e-05},
        dynamics={'x': '(1.0303889408765128*(x/8.248645745477532e-08) + w/4917.713094482863)'
                       '*6.787167092229201e-10',
                  'y': '(1.0303889408765128*(y/7.88562374950086) + w/4917.713094482863)'
                       '*0.06488464611740316',
                  'z': '(x/8.248645745477532e-08 - y/7.88562374950086)*4.991845257597999e-06'},
        running_cost='1', input_bounds={'w': [-5597.160302843634, 5597.160302843634]},
        terminal_constraints=['x - 1.6831674194289802e-07', 'y - 1.5010902056524371',
                              'z - 0.0005755410490978527'],
        state_bounds={'y': [0.9617255131441544, None], 'z': [-9.53390203493168e-05, None]},
        final_time={'free': True, 'lower': 26.078324663777007, 'upper': 152.54426893917073}
    )) == ''


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 4), st.floats(0.2, 5))
def test_reach_sizes_bound_the_terms_of_the_states(seed, n, T):
    rng = np.random.default_rng(seed)
    A, B, c, x0 = (rng.normal(size=shape) for shape in ((n, n), (n, 1), n, n))
    reach = Reach(A, B, c, x0, np.eye(n), x0)
    for t in np.linspace(0, T, 7):
        flow = compute_exponential(reach.Z * t)[:n]
        assert np.all(np.abs(flow) @ np.append(np.abs(x0), [1, 1]) <= reach.sizes(T) * (1 + 1e-9))


# ---------------------------------------------------------------- exact arithmetic


def test_equal_expressions_reduce_to_zero():
    x = ca.SX.sym('x', 2)
    a, b = x[0], x[1]
    zero = (
        (a + b)**3 - a**3 - 3*a*b*(a + b) - b**3, ca.sin(a*b)**2 + ca.cos(b*a)**2 - 1,
        a/(1 + b**2) + a*b**2/(1 + b**2) - a, ca.sqrt(1 + a)**2 - 1 - a,
        ca.tan(a)*ca.cos(a) - ca.sin(a), ca.sin(a - b) + ca.sin(b - a), a/b*b - a)
    algebra, found = read_polynomials(ca.Function('f', [x], [ca.vertcat(*zero)]), [[None, None]])
    assert all(each == {} for one in found for each in algebra.cleared([one]))
    other = (a + b, ca.sin(a)**2 - ca.cos(a)**2, 1/(1 + a) - 1/(2 + a), ca.sqrt(a) - a)
    algebra, found = read_polynomials(ca.Function('f', [x], [ca.vertcat(*other)]), [[None, None]])
    assert all(each for one in found for each in algebra.cleared([one]))


def test_null_space_is_exact():
    rows = [{0: Fraction(1), 1: Fraction(1, 3)}, {1: Fraction(2), 2: Fraction(-1, 7)}]
    [vector] = find_null_space(rows, 3)
    for row in rows:
        assert sum(value * vector.get(k, 0) for k, value in row.items()) == 0


def test_dependent_and_contradictory_constraints_differ():
    end = find_affine_end(problems.build(
        BOUNDED, terminal_constraints=['0.1*x + 0.2*v - 0.3', 'x + 2*v - 3']))
    assert end.clash is None
    assert end.is_clear
    assert len(end.directions) == 1
    end = find_affine_end(problems.build(
        BOUNDED, terminal_constraints=['0.1*x + 0.2*v - 0.3', 'x + 2*v - 4']))
    assert end.clash is not None
    near = find_affine_end(problems.build(
        BOUNDED, terminal_constraints=['x + v - 1', 'x + 1.0000000001*v - 2']))
    assert near.clash is None
    assert not near.is_clear
