# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Linear quadratic problems: recognition, solutions to rounding accuracy, error messages."""

import math

from hypothesis import example, given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.ocp.certificate.certificate import certify
from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.linear_quadratic import solve_lq
import problems
import pytest
from scipy.integrate import solve_ivp


def statement(**changes):
    mapping = {
        'name': 'case', 'states': ['x'], 'inputs': ['u'],
        'parameters': {'a': 2, 'b': 0.5, 'c': 0.1}, 'dynamics': {'x': 'a*x + b*u'},
        'running_cost': '0.5*u**2', 'terminal_cost': '0.5*c*x**2', 'initial_state': {'x': 4},
        'final_time': {'free': False, 'value': 1}}
    return problems.build(mapping, **changes)


def chain(**changes):
    return statement(**{
        'states': ['x', 'y'], 'dynamics': {'x': 'y', 'y': 'u'}, 'terminal_cost': '0',
        'initial_state': {'x': 1, 'y': 0}, **changes})


def horizon(T):
    return {'free': False, 'value': T}


def replay(problem, solution):
    """Return x(T) and the cost of the input, linear between samples, integrated from x(0)."""
    import casadi as ca

    f = ca.Function('f', [problem.x, problem.u, problem.p], [ca.vertcat(problem.f, problem.L)])
    V = ca.Function('V', [problem.x, problem.p], [problem.V])
    p = problem.p_value

    def rate(t, z):
        u = [np.interp(t, solution.t, column) for column in solution.u.T]
        return f(z[:-1], u, p).full().ravel()

    z, t = np.append(problem.x0, 0.0), solution.t
    pieces = np.linspace(0, len(t) - 1, 33).astype(int)
    for low, high in zip(pieces[:-1], pieces[1:], strict=True):
        z = solve_ivp(rate, (t[low], t[high]), z, rtol=1e-9, atol=1e-12,
                      max_step=(t[high] - t[low]) / 8).y[:, -1]
    return z[:-1], z[-1] + float(V(z[:-1], p))


# ---------------------------------------------------------------- closed forms


@pytest.mark.parametrize('T', [0.5, 1.0, 10.0, 50.0])
@pytest.mark.parametrize('c', [0.1, 10.0])
def test_example_2_2_and_exercise_2_9_agree_with_closed_forms(c, T):
    """Equation (2.5), rearranged: as printed it loses all digits of x(T) at T = 10."""
    a, b, x0 = 2.0, 0.5, 4.0
    problem = statement(parameters={'a': a, 'b': b, 'c': c}, final_time=horizon(T))
    solution = solve_lq(problem)
    t = solution.t
    D = 2 * a * math.exp(-2 * a * T) + b * b * c * (1 - math.exp(-2 * a * T))
    decay = np.exp(-2 * a * (T - t))
    P = 2 * a * c / (2 * a * decay + b * b * c * (1 - decay))
    x = x0 * np.exp(-a * t) * (2 * a * decay + b * b * c * (1 - decay)) / D
    lam = P * x
    assert solution.x[:, 0] == pytest.approx(x, rel=1e-11)
    assert solution.lam[:, 0] == pytest.approx(lam, rel=1e-11)
    assert solution.u[:, 0] == pytest.approx(-b * lam, rel=1e-11)
    assert solution.objective == pytest.approx(0.5 * P[0] * x0**2, rel=1e-12)
    assert certify(problem, solution).holds


@pytest.mark.parametrize('T', [1.0, 10.0, 50.0])
def test_terminal_constraint_keeps_all_digits_over_long_horizons(T):
    """The minimum energy from x = 4 to x = 1, with lam(t) = mu exp(-a t)."""
    a, b = 2.0, 0.5
    problem = statement(terminal_cost='0', terminal_constraints=['x - 1'], final_time=horizon(T))
    solution = solve_lq(problem)
    e = math.exp(-a * T)
    mu = 2 * a * (4 - e) / (b * b * (1 - e * e))
    assert solution.lam[0, 0] == pytest.approx(mu, rel=1e-12)
    assert solution.x[-1, 0] == pytest.approx(1.0, rel=1e-11)
    assert solution.nu[0] == pytest.approx(mu * e, rel=1e-9, abs=1e-14 * mu)
    assert solution.objective == pytest.approx(b * b * mu * mu * (1 - e * e) / (4 * a), rel=1e-12)
    assert certify(problem, solution).holds


@pytest.mark.parametrize(('a', 'b', 'offset', 'T'), [
    (0.57, -5.5e-4, 2.6e-6, 0.57), (0.99, -0.13, 6e-4, 2.3), (-3.0, 1e-3, 1e-4, 4.0)])
def test_a_small_cost_of_a_fixed_end_keeps_its_digits(a, b, offset, T):
    """Without an input x(T) misses the end by `miss`: J = miss^2 / (2 W), W the Gramian."""
    free_end = 4 * math.exp(a * T)
    gramian = b * b * math.expm1(2 * a * T) / (2 * a)
    solution = solve_lq(statement(
        parameters={'a': a, 'b': b, 'c': 0}, final_time={'free': False, 'value': T},
        terminal_constraints=[f'x - ({free_end + offset!r})']))
    miss = (free_end + offset) - free_end
    assert solution.objective == pytest.approx(0.5 * miss**2 / gramian, rel=1e-6)


def test_double_integrator_to_rest_at_the_origin():
    """The path is the cubic from 1 to 0 at rest, u its second derivative."""
    problem = chain(terminal_constraints=['x', 'y'])
    solution = solve_lq(problem)
    t = solution.t
    assert solution.objective == pytest.approx(6.0, rel=1e-12)
    assert solution.u[:, 0] == pytest.approx(12 * t - 6, abs=1e-11)
    assert solution.x[:, 0] == pytest.approx(1 - 3 * t**2 + 2 * t**3, abs=1e-11)
    assert solution.lam == pytest.approx(np.column_stack([12 + 0 * t, 6 - 12 * t]), abs=1e-10)
    assert solution.nu == pytest.approx([12, -6], rel=1e-12)
    assert certify(problem, solution).holds


def test_consistent_redundant_constraints_are_met():
    problem = chain(terminal_constraints=['x', 'y', 'x + y'])
    solution = solve_lq(problem)
    assert solution.objective == pytest.approx(6.0, rel=1e-10)
    assert solution.nu[:2] + solution.nu[2] == pytest.approx([12, -6], rel=1e-9)
    assert certify(problem, solution).holds


def test_affine_terms_shift_the_input():
    """With gravity g, u = g + v, where v solves the problem without it; J = 6 + 3."""
    gravity = chain(dynamics={'x': 'y', 'y': 'u - 9.8'},
                    running_cost='0.5*(u - 9.8)**2 + 3', terminal_constraints=['x', 'y'])
    solution = solve_lq(gravity)
    assert solution.objective == pytest.approx(9.0, rel=1e-11)
    assert solution.u[:, 0] == pytest.approx(9.8 + 12 * solution.t - 6, abs=1e-10)
    assert certify(gravity, solution).holds


def test_all_terms_together_are_certified_and_replayed():
    problem = chain(
        dynamics={'x': 'y + 0.3', 'y': 'u - 0.2*y + 1'}, final_time=horizon(4),
        running_cost='(x - 2)**2 + 0.1*(u - y)**2 + 0.1*x*u + 3*u + 7',
        terminal_cost='(y - 1)**2 + x', terminal_constraints=['x + y - 2'])
    solution = solve_lq(problem)
    assert certify(problem, solution).holds
    xT, cost = replay(problem, solution)
    assert xT == pytest.approx(solution.x[-1], abs=1e-6 * abs(solution.x).max())
    assert cost == pytest.approx(solution.objective, rel=1e-6)


# ---------------------------------------------------------------- conjugate points


def focal(T, **changes):
    return statement(dynamics={'x': 'u'}, running_cost='0.5*u**2 - 0.5*x**2', terminal_cost='0',
                     initial_state={'x': 1}, final_time=horizon(T), **changes)


def test_a_free_end_has_a_minimum_until_the_focal_point():
    """With x'' = -x and x'(T) = 0, J = -tan(T) / 2 for T < pi / 2."""
    solution = solve_lq(focal(1.5))
    assert solution.objective == pytest.approx(-math.tan(1.5) / 2, rel=1e-11)
    rejected = solve_lq(focal(1.6))
    assert rejected.status is Status.NOT_CONVERGED
    assert 'the cost has no minimum' in rejected.message


def test_a_fixed_end_has_a_minimum_until_the_conjugate_point():
    """With x'' = -x from 1 to 1, J is the change of x x' / 2 for T < pi."""
    solution = solve_lq(focal(3.0, terminal_constraints=['x - 1']))
    slope = (1 - math.cos(3.0)) / math.sin(3.0)
    end = -math.sin(3.0) + slope * math.cos(3.0)
    assert solution.objective == pytest.approx((end - slope) / 2, rel=1e-9)
    assert solve_lq(focal(3.2, terminal_constraints=['x - 1'])).status is Status.NOT_CONVERGED


def test_indefinite_weights_with_a_minimum_are_solved():
    problem = chain(running_cost='0.5*u**2 + x**2 - 0.05*y**2', terminal_cost='-0.01*x**2',
                    final_time=horizon(2))
    solution = solve_lq(problem)
    assert solution.status is Status.SOLVED
    assert certify(problem, solution).holds


# ---------------------------------------------------------------- messages of failures


def test_an_unreachable_end_is_infeasible():
    problem = chain(dynamics={'x': '2*x + u', 'y': '-y'}, initial_state={'x': 4, 'y': 1},
                    terminal_constraints=['x', 'y'], final_time=horizon(2))
    solution = solve_lq(problem)
    assert solution.status is Status.INFEASIBLE
    # y(2) = exp(-2)
    assert 'the input does not affect y; at T = 2 it is 0.135335 for' in solution.message
    assert solution.message.endswith('for every input, but 0 is required')


def test_an_unreachable_combination_of_states_is_named():
    """Both states have the rate u, so that their difference is uncontrollable."""
    problem = chain(dynamics={'x': 'u', 'y': 'u'}, terminal_constraints=['x - 3', 'y - 1'])
    solution = solve_lq(problem)
    assert solution.status is Status.INFEASIBLE
    assert 'not affect x - y; at T = 1 it is 1 for every input, but 2 is required' in (
        solution.message)
    reachable = solve_lq(chain(
        dynamics={'x': 'u', 'y': 'u'}, terminal_constraints=['x - 3', 'y - 2']))
    assert reachable.objective == pytest.approx(2.0, rel=1e-10)  # u = 2


def test_an_input_effect_below_rounding_is_not_called_infeasible():
    """From rest to (1, 0) in 1e-6: possible, but the effect of u is below the rounding error."""
    solution = solve_lq(chain(initial_state={'x': 0, 'y': 0}, final_time=horizon(1e-6),
                              terminal_constraints=['x - 1', 'y']))
    assert solution.status is Status.NOT_CONVERGED
    assert 'the rounding error' in solution.message


@pytest.mark.parametrize('T', [1e3, 1e4, 1e5])
def test_long_horizons_cost_as_much_as_the_infinite_one(T):
    """For x' = -x + u with x^2 + u^2, P = sqrt(2) - 1; the transient lasts a few seconds."""
    problem = statement(dynamics={'x': '-x + u'}, running_cost='x**2 + u**2', terminal_cost='0',
                        initial_state={'x': 1}, final_time=horizon(T))
    solution = solve_lq(problem)
    assert solution.objective == pytest.approx(math.sqrt(2) - 1, abs=1e-12)
    assert certify(problem, solution).holds


def test_a_singular_input_weight_is_not_accepted():
    assert solve_lq(statement(inputs=['u', 'w'], dynamics={'x': 'u + w'},
                              running_cost='(u + w)**2')) is None


def test_contradictory_constraints_are_infeasible():
    solution = solve_lq(chain(terminal_constraints=['x', 'x - 1']))
    assert solution.status is Status.INFEASIBLE


# ---------------------------------------------------------------- recognition


@pytest.mark.parametrize('changes, recognised', [
    ({}, True),
    ({'running_cost': '0.5*u**2 + x*u + 3*x + 2*u + 7'}, True),
    ({'running_cost': '(u - 3*x)*(u - 3*x) + x'}, True),
    ({'running_cost': 'a*u**b', 'parameters': {'a': 1, 'b': 2, 'c': 1}}, True),
    ({'dynamics': {'x': 'a*(x + 1) + b*u/3 - 1'}}, True),
    ({'dynamics': {'x': 'sin(a)*x + u'}}, True),
    ({'dynamics': {'x': 'x*u'}}, False),
    ({'dynamics': {'x': 'sin(x) + u'}}, False),
    ({'dynamics': {'x': 'x**a + u'}}, False),
    ({'running_cost': 'u**4'}, False),
    ({'running_cost': 'x**2'}, False),
    ({'running_cost': '-u**2'}, False),
    ({'running_cost': 'abs(u)'}, False),
    ({'terminal_cost': 'x**3'}, False),
    ({'terminal_constraints': ['x**2 - 1']}, False),
    ({'input_bounds': {'u': [-1, 1]}}, False),
    ({'state_bounds': {'x': [None, 10]}}, False),
    ({'path_constraints': [{'expr': 'x + u', 'lower': -1, 'upper': 9}]}, False),
    ({'final_time': {'free': True, 'lower': 0.1, 'upper': 2, 'guess': 1}}, False),
])
def test_linear_quadratic_problems_are_recognised(changes, recognised):
    problem = statement(**changes)
    solution = solve_lq(problem)
    assert (solution is not None) is recognised
    if recognised:
        assert certify(problem, solution).holds


def test_inactive_bounds_change_nothing():
    free = solve_lq(statement())
    wide = statement(input_bounds={'u': [-1000, 1000]}, state_bounds={'x': [-1000, 1000]})
    assert solve_lq(wide).objective == free.objective
    tight = statement(input_bounds={'u': [free.u.min() * 0.9, 1000]})
    assert solve_lq(tight) is None


# ---------------------------------------------------------------- properties


@pytest.mark.slow
@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(1, 2), st.integers(0, 2),
       st.floats(0.1, 5))
@example(0, 3, 1, 2, 4.0)  # was not certified at the largest number of samples
def test_random_problems_are_certified(seed, n, m, q, T):
    rng = np.random.default_rng(seed)
    names, inputs = [f'x{i}' for i in range(n)], [f'u{i}' for i in range(m)]
    A, B, a = rng.standard_normal((n, n)), rng.standard_normal((n, m)), rng.standard_normal(n)
    H, C = rng.standard_normal((n, n)), rng.standard_normal((min(q, n), n))

    def line(row, symbols):
        return ' + '.join(f'({value!r})*{name}' for value, name in zip(
            row.tolist(), symbols, strict=True))

    problem = problems.build({
        'name': 'random', 'states': names, 'inputs': inputs,
        'dynamics': {name: f'{line(np.append(A[i], B[i]), names + inputs)} + ({a[i]!r})'.replace(
            'np.float64', '') for i, name in enumerate(names)},
        'running_cost': ' + '.join([f'({line(row, names)} - 1)**2' for row in H]
                                   + [f'0.5*{name}**2' for name in inputs]),
        'terminal_cost': f'({line(H[0], names)})**2',
        'terminal_constraints': [f'{line(row, names)} - 1' for row in C],
        'initial_state': {name: float(rng.standard_normal()) for name in names},
        'final_time': horizon(T)})
    solution = solve_lq(problem)
    assert solution.status is Status.SOLVED
    certificate = certify(problem, solution)
    assert certificate.holds, certificate.worst


def test_the_tail_of_an_optimal_path_is_optimal():
    """Bellman: the problem solved again from the middle has the same path and costate."""
    whole = chain(running_cost='x**2 + 0.5*u**2', terminal_cost='y**2', final_time=horizon(3))
    solution = solve_lq(whole)
    k = len(solution.t) // 2
    tail = solve_lq(chain(
        running_cost='x**2 + 0.5*u**2', terminal_cost='y**2',
        final_time=horizon(3 - solution.t[k]),
        initial_state={'x': float(solution.x[k, 0]), 'y': float(solution.x[k, 1])}))
    for i in range(2):
        assert np.interp(tail.t[-1] / 2, tail.t, tail.x[:, i]) == pytest.approx(
            np.interp(solution.t[k] + tail.t[-1] / 2, solution.t, solution.x[:, i]), abs=1e-5)
    assert tail.lam[0] == pytest.approx(solution.lam[k], rel=1e-9)


def test_perturbed_inputs_cost_more():
    problem = chain(running_cost='x**2 + 0.5*u**2', terminal_cost='y**2', final_time=horizon(2))
    best = solve_lq(problem)
    rng = np.random.default_rng(3)

    def cost(u):
        def rate(s, z):
            now = np.interp(s, best.t, u)
            return [z[1], now, z[0]**2 + 0.5 * now**2]

        x, y, spent = solve_ivp(rate, (0, 2), [1, 0, 0], rtol=1e-8, max_step=0.05).y[:, -1]
        return spent + y**2

    for _ in range(20):
        walk = np.cumsum(rng.standard_normal(len(best.t))) / math.sqrt(len(best.t))
        assert cost(best.u[:, 0] + 0.1 * walk) > best.objective


@pytest.mark.parametrize('T', [1e-3, 1.0, 1e4])
@pytest.mark.parametrize('gain', [1e-9, 1.0, 1e9])
@pytest.mark.parametrize('drift', [0.0, 1e-9, 1e12])
def test_an_integrator_with_drift_has_a_constant_input(gain, drift, T):
    """An integrator has no time constant. u = ((x(T) - x(0))/T - drift)/gain for any units."""
    answer = solve_lq(problems.pose(
        {'x': f'{gain!r}*u + {drift!r}'}, 'u**2', (1,), T, terminal_constraints=['x - 3']))
    u = (2 / T - drift) / gain
    assert answer.status is Status.SOLVED, answer.message
    assert answer.u == pytest.approx(u, rel=1e-9)
    assert answer.objective == pytest.approx(u**2 * T, rel=1e-9)


def test_numbers_that_overflow_are_said():
    """Squares of the gain are beyond the largest double."""
    answer = solve_lq(problems.pose(
        {'x': '1e200*u + 1e200'}, 'u**2', (1,), 1, terminal_constraints=['x - 3']))
    assert answer.status is Status.NOT_CONVERGED
    assert 'units' in answer.message
