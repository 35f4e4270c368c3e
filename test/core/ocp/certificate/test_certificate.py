# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Certificates hold for closed-form solutions and name the conditions that others violate."""

from dataclasses import replace
import math

import casadi as ca
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.ocp.certificate.certificate import certify, TOLERANCES
from obc_ros.core.ocp.solution import Certificate, Solution, Status
import problems
import pytest


def answer(problem, t, x, u, lam, objective, **more):
    """Return a solution with H evaluated along it."""
    columns = [np.array(np.broadcast_arrays(t, *part)[1:], dtype=float).T for part in (x, u, lam)]
    symbol = ca.SX.sym('lam', problem.n)
    H = ca.Function('H', [problem.x, problem.u, symbol, problem.p],
                    [problem.L + ca.dot(symbol, problem.f)])
    values = H.map(len(columns[0]))(*(column.T for column in columns),
                                    ca.repmat(problem.p_value, 1, len(columns[0])))
    return Solution(Status.SOLVED, '', objective=objective, t=np.asarray(t, dtype=float),
                    x=columns[0], u=columns[1], lam=columns[2],
                    hamiltonian=values.full().ravel(), **more)


def stay_at_rest(problem, u, count=21):
    """Return the solution x = 0 under u against a load of one, with the costates for u = 1."""
    t = np.linspace(0.0, 2.0, count)
    x, v = (np.float64(u) - 1) * t**2 / 2, (np.float64(u) - 1) * t
    return answer(problem, t, [x, v], [u], [0.0, -1.0], u**2, nu=np.array([0.0, -1.0]))


def failing(problem, solution):
    """Return the names of the conditions that are violated."""
    certificate = certify(problem, solution)
    return {key for key, value in certificate.residuals.items()
            if not value <= certificate.tolerances[key]}


# Closed-form solutions

def scalar(a=1.0, b=1.0, c=1.0, T=1.0, x0=1.0, count=2001):
    """Return Example 2.2 with the input of the book, (2.4) and (2.5)."""
    problem = problems.build('lq_scalar_unit', parameters={'a': a, 'b': b, 'c': c},
                     initial_state={'x': x0}, final_time={'free': False, 'value': T})
    t = np.linspace(0, T, count)
    U = -2*a*b*c*math.exp(2*a*T)*x0 / (2*a - b**2*c*(1 - math.exp(2*a*T)))
    u = U*np.exp(-a*t)
    x = x0*np.exp(a*t) + b*U*np.sinh(a*t)/a
    J = U**2*(1 - math.exp(-2*a*T))/(4*a) + c*x[-1]**2/2
    return problem, answer(problem, t, [x], [u], [-u/b], J)


def double_integrator():
    """Return Example 2.3 from rest at 1 to rest at 0: T = 2, switch at t = 1."""
    problem = problems.build('di_mintime_rest')
    s = np.linspace(0, 1, 11)
    t = np.append(s, 1 + s)
    u = np.repeat([-1.0, 1.0], 11)
    x = np.append(1 - s**2/2, (1 - s)**2/2)
    v = np.append(-s, s - 1)
    # 1 + lam_x v + lam_v u = 0 and lam_v(1) = 0
    return problem, answer(problem, t, [x, v], [u], [1, 1 - t], 2.0, nu=np.array([1.0, -1.0]))


def moon_lander():
    """Return free fall followed by full thrust (Meditch)."""
    problem = problems.build('moon_lander')
    # The parabolas h = 10 - 2 t - 0.75 t^2 and h = 0.75 (T - t)^2 are tangent at the switch.
    v_switch = -math.sqrt((2*1.5*10 + 4)/2)
    switch, T = (-2 - v_switch)/1.5, (-2 - 2*v_switch)/1.5
    t = np.concatenate([np.linspace(0, switch, 9), np.linspace(switch, T, 9)])
    fall = np.arange(18) < 9
    h = np.where(fall, 10 - 2*t - 0.75*t**2, 0.75*(T - t)**2)
    v = np.where(fall, -2 - 1.5*t, -1.5*(T - t))
    slope = 1/(T - switch)
    return problem, answer(problem, t, [h, v], [np.where(fall, 0.0, 3.0)],
                           [slope, -1 - slope*(t - switch)], 3*(T - switch))


def bryson_denham(count=401):
    """Return the solution on the bound in [3 l, 1 - 3 l]; the costate of the position jumps."""
    problem = problems.build('bryson_denham')
    s = np.linspace(0, 1, count)/3
    x1, v1, u1 = 1/9 - 3*(1/3 - s)**3, 9*(1/3 - s)**2, -18*(1/3 - s)
    t = np.concatenate([s, 1/3 + s, 2/3 + s])
    x = np.concatenate([x1, np.full(count, 1/9), x1[::-1]])
    v = np.concatenate([v1, np.zeros(count), -v1[::-1]])
    u = np.concatenate([u1, np.zeros(count), u1[::-1]])
    lam_x = np.repeat([18.0, 0.0, -18.0], count)
    return problem, answer(problem, t, [x, v], [u], [lam_x, -u], 4.0, nu=np.array([-18.0, 6.0]))


def straight_pass():
    """Return Example 2.6 from (0, 0, 0) to (2, 0, 0): singular in u2 (docs/errata.md)."""
    problem = problems.pose(
        {'x1': 'u1', 'x2': 'u2', 'x3': 'x2*u1'}, '1', (0, 0, 0),
        {'free': True, 'lower': 0.1, 'upper': 20}, inputs=['u1', 'u2'],
        input_bounds={'u1': [-1, 1], 'u2': [-1, 1]}, terminal_constraints=['x1 - 2', 'x2', 'x3'])
    t = np.linspace(0, 2, 5)
    return problem, answer(problem, t, [t, 0, 0], [1, 0], [-1, 0, 0], 2.0)


def turn_in_place():
    """Return Exercise 2.6 for a turn on the spot: v is singular (docs/errata.md)."""
    problem = problems.build('two_wheel_turn_in_place')
    t = np.linspace(0, math.pi/2, 5)
    return problem, answer(problem, t, [0, 0, t], [0, 1], [0, 0, -1], math.pi/2)


def brachistochrone():
    """Return the brachistochrone to x = 1, y free: on a cycloid the angle is linear in t."""
    g, problem = 9.81, problems.pose(
        {'x': 'v*sin(theta)', 'y': 'v*cos(theta)', 'v': '9.81*cos(theta)'}, '1', (0, 0, 0),
        {'free': True, 'lower': 0.1, 'upper': 5}, inputs=['theta'], terminal_constraints=['x - 1'])
    w = math.sqrt(math.pi*g/4)
    t = np.linspace(0, math.pi/(2*w), 21)
    x = g/(4*w**2)*(2*w*t - np.sin(2*w*t))
    y = g/(2*w**2)*np.sin(w*t)**2
    return problem, answer(problem, t, [x, y, g/w*np.sin(w*t)], [w*t],
                           [-w/g, 0, -np.cos(w*t)/g], t[-1])


def floor():
    """Minimise the integral of x over [0, 1]: x' = u, |u| <= 1, x >= 1/2, x(0) = 1."""
    problem = problems.pose(
        {'x': 'u'}, 'x', (1,), 1, input_bounds={'u': [-1, 1]}, state_bounds={'x': [0.5, None]})
    s = np.linspace(0, 0.5, 6)
    first = np.arange(12) < 6
    t = np.append(s, 0.5 + s)
    return problem, answer(
        problem, t, [np.where(first, 1 - t, 0.5)], [np.where(first, -1.0, 0.0)],
        [np.where(first, 0.5 - t, 0.0)], 0.625,
        state_multipliers=np.where(first, 0.0, -1.0)[:, None])


def mixed(count=2001):
    """Minimise the integral of u^2/2, less 2 x(1): x' = u, x + u <= 1 active throughout."""
    problem = problems.pose(
        {'x': 'u'}, 'u**2/2', (0,), 1, terminal_cost='-2*x',
        path_constraints=[{'expr': 'x + u', 'lower': None, 'upper': 1}])
    t = np.linspace(0, 1, count)
    u, C = np.exp(-t), (math.exp(-1)/2 - 2)/math.e
    lam = C*np.exp(t) - u/2
    J = (1 - math.exp(-2))/4 - 2*(1 - math.exp(-1))
    return problem, answer(problem, t, [1 - u], [u], [lam], J,
                           path_multipliers=-(u + lam)[:, None])


def wall(depth=0.0):
    """Minimise the integral of u^2: x' = u - 0.3 x, x(0) = 1, x - 1 >= 0 active throughout."""
    problem = problems.pose(
        {'x': 'u - 0.3*x'}, 'u**2', (1 - depth,), 4,
        path_constraints=[{'expr': 'x - 1', 'lower': 0, 'upper': None}])
    t, x = np.linspace(0, 4, 5), 1 - depth
    return problem, answer(problem, t, [x], [0.3*x], [-0.6*x], 0.36*x**2,
                           path_multipliers=np.full((5, 1), -0.18*x))


EXACT = [scalar, double_integrator, moon_lander, bryson_denham, straight_pass, turn_in_place,
         brachistochrone, floor, mixed, wall]


@pytest.mark.parametrize('case', EXACT, ids=lambda case: case.__name__)
def test_closed_form_solutions_are_certified(case):
    problem, solution = case()
    certificate = certify(problem, solution)
    assert certificate.holds, (certificate.worst, certificate.residuals)
    assert set(certificate.residuals) == set(certificate.tolerances)
    assert ('final_time' in certificate.residuals) == problem.final_time.free
    free = {'final_time'} if not problem.final_time.free else set()
    assert set(certificate.residuals) == set(TOLERANCES) - free


@pytest.mark.parametrize('case', [double_integrator, moon_lander, straight_pass, turn_in_place],
                         ids=lambda case: case.__name__)
def test_constant_inputs_are_certified_as_zoh(case):
    problem, solution = case()
    assert not failing(problem, replace(solution, interpolation='zoh'))


def test_missing_multipliers_of_state_bounds_are_computed():
    problem, solution = floor()
    assert not failing(problem, replace(solution, state_multipliers=None))


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(st.floats(0.2, 2), st.floats(0.3, 3), st.floats(0.1, 10), st.floats(0.2, 2),
       st.sampled_from([-3.0, 0.01, 1.0, 1e4]))
def test_example_2_2_is_certified_for_random_parameters(a, b, c, T, x0):
    assert not failing(*scalar(a, b, c, T, x0, count=6001))


@pytest.mark.parametrize('unit', [1e-4, 1e3])
@pytest.mark.parametrize('money', [1e-3, 1e4])
def test_residuals_do_not_depend_on_units(unit, money):
    problem, solution = bryson_denham(51)
    names = problems.read('bryson_denham')
    scaled = problems.build(
        names, running_cost=f'{money/unit**2}*0.5*u**2', parameters={'l': unit/9},
        initial_state={'x': 0, 'v': unit}, terminal_constraints=['x', f'v + {unit}'])
    other = replace(solution, x=solution.x*unit, u=solution.u*unit, lam=solution.lam*money/unit,
                    nu=solution.nu*money/unit, hamiltonian=solution.hamiltonian*money,
                    objective=solution.objective*money)
    before, after = certify(problem, solution), certify(scaled, other)
    for key, value in before.residuals.items():
        assert after.residuals[key] == pytest.approx(value, rel=0.1, abs=1e-8)


# One violated condition at a time

def test_a_wrong_cost_violates_the_cost():
    problem, solution = scalar()
    assert failing(problem, replace(solution, objective=solution.objective + 1e-4)) == {'cost'}


def test_a_wrong_hamiltonian_violates_the_hamiltonian():
    problem, solution = moon_lander()
    wrong = replace(solution, hamiltonian=solution.hamiltonian + 0.01)
    assert failing(problem, wrong) == {'hamiltonian'}


def test_another_initial_state_violates_start_and_cost():
    problem, solution = scalar()
    far = replace(problem, x0=problem.x0 + 1e-4)   # the cost changes by 1e-4 lam(0)
    assert (failing(far, solution), certify(far, solution).fault) == ({'start', 'cost'}, 'start')


def test_a_missed_terminal_constraint_violates_the_end():
    problem, solution = moon_lander()
    far = problems.build('moon_lander', terminal_constraints=['h - 0.001', 'v'])
    assert failing(problem, solution) == set()
    assert (failing(far, solution), certify(far, solution).fault) == ({'end', 'cost'}, 'end')


@pytest.mark.parametrize(('missed', 'found'), [(0.0, set()), (4e-10, {'cost'})])
def test_an_end_that_is_nearly_met_may_cost_too_little(missed, found):
    """From 1 to 1 + 1e-5 with u = 1e-5: an end that is 4e-10 off changes the cost by 8e-5."""
    move = 1e-5
    problem = problems.pose({'x': 'u'}, 'u**2', (1,), 1,
                            terminal_constraints=[f'x - {1 + move!r}'])
    u, t = move - missed, np.linspace(0.0, 1.0, 11)
    near = answer(problem, t, [1 + u*t], [u], [-2*u], u**2, nu=np.array([-2*u]))
    assert failing(problem, near) == found


def test_an_end_met_only_asymptotically_violates_the_end():
    """For dx/dt = -u x, x never reaches 0: x(T) = exp(-T) is the only fault (lam = 1/x)."""
    problem = problems.pose(
        {'x': '-u*x'}, '1', (1,), {'free': True, 'lower': 0.1, 'upper': 100},
        terminal_constraints=['x'], input_bounds={'u': [-1, 1]})
    T = 30.0
    t = np.linspace(0, T, 301)
    late = answer(problem, t, [np.exp(-t)], [1.0], [np.exp(t)], T, nu=np.array([math.exp(T)]))
    assert failing(problem, late) == {'end'}


def test_a_solution_for_another_final_time_violates_the_end():
    problem, _ = scalar()
    _, longer = scalar(T=1.01)
    assert failing(problem, longer) == {'end'}


def test_a_suboptimal_final_time_violates_the_final_time():
    # The minimum of the integral of (u^2 + 1)/2 from 0 to 1 has T = 1; for T = 2, u = 1/2.
    problem = problems.pose(
        {'x': 'u'}, '(u**2 + 1)/2', (0,), {'free': True, 'lower': 0.1, 'upper': 9},
        terminal_constraints=['x - 1'])
    t = np.linspace(0, 1, 5)
    assert failing(problem, answer(problem, t, [t], [1], [-1], 1.0)) == set()
    slow = answer(problem, 2*t, [t], [0.5], [-0.5], 1.25)
    assert failing(problem, slow) == {'final_time'}
    # At the upper bound of T only H <= 0 is optimal, at the lower bound only H >= 0.
    def within(lower, upper):
        return replace(problem, final_time=replace(problem.final_time, lower=lower, upper=upper))
    assert failing(within(0.1, 2), slow) == {'final_time'}
    assert failing(within(2, 9), slow) == set()
    assert failing(within(0.1, 1.9), slow) == {'final_time'}
    fast = answer(problem, t/2, [t], [2], [-2], 1.25)
    assert failing(within(0.1, 0.5), fast) == set()
    assert failing(within(0.5, 9), fast) == {'final_time'}


@pytest.mark.parametrize(('u', 'lam', 'tilt'), [(0.0, 0.0, 0.0), (0.98719, 0.0, 0.1)])
def test_a_stationary_point_of_h_can_violate_the_minimum(u, lam, tilt):
    # dH/du = 0 at the local maximum u = 0 and, with the tilt, at the local minimum near 1.
    # The roots of 4 u (u^2 - 1) + 0.1 = 0 are 0.98726 and -1.01227; the values used are close.
    problem = problems.pose(
        {'x': 'u'}, f'(u**2 - 1)**2 + {tilt}*u', (0,), 1, input_bounds={'u': [-2, 2]})
    L = (u**2 - 1)**2 + tilt*u
    t = np.linspace(0, 1, 5)
    assert failing(problem, answer(problem, t, [u*t], [u], [lam], L)) == {'minimum'}
    lowest = -1.0 if tilt == 0 else -1.01225
    L = (lowest**2 - 1)**2 + tilt*lowest
    assert failing(problem, answer(problem, t, [lowest*t], [lowest], [lam], L)) == set()


def test_a_maximum_of_h_violates_minimum_and_final_time():
    problem, solution = brachistochrone()
    # On the same path the negated costates satisfy dH/du = 0 but maximise H.
    wrong = answer(problem, solution.t, solution.x.T, solution.u.T, -solution.lam.T,
                   solution.objective)
    assert 'minimum' in failing(problem, wrong)
    assert 'final_time' in failing(problem, wrong)


def test_costates_of_the_wrong_sign_violate_three_conditions():
    problem, solution = scalar()
    wrong = answer(problem, solution.t, solution.x.T, solution.u.T, -solution.lam.T,
                   solution.objective)
    assert failing(problem, wrong) == {'minimum', 'transversality', 'hamiltonian'}


def test_a_wrong_costate_violates_its_equation():
    problem, solution = straight_pass()
    # lam_x2 enters dH/du2 at the sample; u2 = 0 is then not the minimiser.
    lam = solution.lam.copy()
    lam[:, 1] = 0.1*np.sin(np.pi*solution.t/2)
    assert failing(problem, replace(solution, lam=lam)) == {'costate', 'minimum'}
    # With u2 fixed at zero only the costate equation contains lam_x2.
    held = replace(problem, u_lower=np.array([-1.0, 0]), u_upper=np.array([1.0, 0]))
    assert failing(held, replace(solution, lam=lam)) == {'costate'}


@pytest.mark.parametrize('error, found', [(0.0, set()), (1e-8, set()), (0.1, {'costate'})])
def test_costates_of_fast_decaying_states_are_certified(error, found):
    """The error of lam and its rounding errors grow by e^15 in each interval."""
    k, t = 60.0, np.linspace(0, 1, 5)
    problem = problems.pose(
        {'fast': f'-{k}*fast', 'slow': 'u'}, 'fast + u**2', (1, 0), 1,
        terminal_constraints=['slow - 1'])
    lam = -np.expm1(-k * (1 - t)) / k * (1 + error * np.array([0, 1, -1, 1, 0]))
    solution = answer(problem, t, [np.exp(-k*t), t], [1.0], [lam, -2.0],
                      1 - math.expm1(-k) / k, nu=np.array([-2.0]))
    assert failing(problem, solution) == found


def test_a_wrong_terminal_costate_violates_transversality():
    problem, solution = scalar()
    heavier = problems.build('lq_scalar_unit', parameters={'a': 1, 'b': 1, 'c': 1.001})
    assert failing(problem, solution) == set()
    assert failing(heavier, solution) == {'transversality', 'cost'}


def test_wrong_terminal_multipliers_violate_transversality():
    problem, solution = double_integrator()
    assert failing(problem, replace(solution, nu=np.array([1.0, 1.0]))) == {'transversality'}
    assert failing(problem, replace(solution, nu=np.zeros(0))) == set()


def test_a_coarse_mesh_violates_dynamics_and_cost():
    problem, solution = scalar(count=9)
    assert failing(problem, solution) - {'hamiltonian'} == {'dynamics', 'cost'}


@pytest.mark.parametrize(('e', 'samples', 'found'), [
    (0.05, 11, {'minimum'}), (0.05, 2, {'minimum'}), (0.001, 2, set())])
def test_a_smeared_switch_violates_the_minimum(e, samples, found):
    # u is a ramp from -1 to 1 over 2 e, and T exceeds 2 by e^2/3.
    problem, _ = double_integrator()
    half = math.sqrt(1 + e**2/3)
    first, s, last = np.linspace(0, half - e, 5), np.linspace(-e, e, samples), np.linspace(
        half + e, 2*half, 5)
    t = np.concatenate([first, half + s, last])
    u = np.concatenate([np.full(5, -1.0), s/e, np.full(5, 1.0)])
    v = np.concatenate([-first, e - half + (s**2 - e**2)/(2*e), last - 2*half])
    middle = (1 - (half - e)**2/2 - (half - e)*(s + e)
              + ((s**3 + e**3)/3 - e**2*(s + e))/(2*e))
    x = np.concatenate([1 - first**2/2, middle, (2*half - last)**2/2])
    smeared = answer(problem, t, [x, v], [u], [1/half, 1 - t/half], 2*half)
    assert failing(problem, smeared) - {'hamiltonian'} == found


def test_bounds_exceeded_between_samples_are_violated():
    # x = t - t^2 has its maximum 1/4 at t = 1/2; at the samples 0, 1/3, 2/3, 1 it is at most 2/9.
    problem = problems.pose(
        {'x': 'v', 'v': 'u'}, 'u**2/2', (0, 1), 1, terminal_constraints=['x', 'v + 1'],
        state_bounds={'x': [None, 0.26]})
    t = np.linspace(0, 1, 4)
    found = answer(problem, t, [t - t**2, 1 - 2*t], [-2], [0, 2], 2.0)
    assert failing(problem, found) == set()
    lower = replace(problem, x_upper=np.array([0.25 - 1e-5, np.inf]))
    assert certify(lower, found).residuals['bounds'] == pytest.approx(1e-5/0.25, rel=0.2)
    assert failing(lower, found) == {'bounds'}
    path = problems.pose(
        {'x': 'v', 'v': 'u'}, 'u**2/2', (0, 1), 1, terminal_constraints=['x', 'v + 1'],
        path_constraints=[{'expr': '4*x', 'lower': None, 'upper': 0.999}])
    assert failing(path, found) == {'bounds'}


@pytest.mark.parametrize('depth', [1e-7, 1e-3, 0.5])
def test_a_path_beyond_a_constraint_that_is_always_active_violates_bounds(depth):
    """The constraint has 1 % of the size of its terms, and not that of its values."""
    assert failing(*wall(1e-9)) == set()
    assert failing(*wall(depth)) == {'bounds'}


def test_an_input_outside_its_bounds_violates_bounds():
    problem, solution = double_integrator()
    tight = replace(problem, u_upper=np.array([0.999]))
    assert failing(tight, solution) == {'bounds'}


def test_costate_jumps_need_the_sign_of_an_active_bound():
    # Minimum of the integral of u^2/2 from 0 to 0 through 1 at t = 1/2.
    # The costate jumps as for an upper bound; a lower bound would push x up.
    problem = problems.pose({'x': 'u'}, 'u**2/2', (0,), 1, terminal_constraints=['x'])
    t = np.array([0, 0.25, 0.5, 0.5, 0.75, 1])
    u = np.repeat([2.0, -2.0], 3)
    found = answer(problem, t, [1 - np.abs(1 - 2*t)], [u], [-u], 2.0)
    assert failing(problem, found) == {'costate'}
    assert failing(replace(problem, x_upper=np.array([1.0])), found) == {'costate'}
    assert failing(replace(problem, x_lower=np.array([1.0])), found) == {'bounds'}
    downward = replace(found, x=-found.x, u=-found.u, lam=-found.lam)
    assert failing(replace(problem, x_lower=np.array([-1.0])), downward) == {'costate'}
    assert failing(replace(problem, x_upper=np.array([-1.0])), downward) == {'bounds'}
    path = problems.pose(
        {'x': 'u'}, 'u**2/2', (0,), 1, terminal_constraints=['x'],
        path_constraints=[{'expr': '-2*x', 'lower': None, 'upper': -2}])
    assert failing(path, found) == {'bounds'}


def test_a_multiplier_without_its_bound_violates_the_costate():
    problem, solution = floor()
    free = replace(problem, x_lower=np.array([-np.inf]))
    assert failing(free, solution) == {'costate'}
    wrong = replace(solution, state_multipliers=-solution.state_multipliers)
    assert failing(problem, wrong) == {'costate'}


def test_a_missing_path_multiplier_violates_the_minimum():
    problem, solution = mixed()
    assert failing(problem, replace(solution, path_multipliers=None)) == {'minimum'}


@pytest.mark.parametrize('change', [
    {'t': np.zeros(0)}, {'x': np.zeros((5, 2))}, {'u': np.full((22, 1), np.nan)},
    {'lam': np.zeros((22, 3))}, {'t': np.linspace(2, 0, 22)}, {'interpolation': 'cubic'},
    {'nu': np.zeros(3)}, {'hamiltonian': np.zeros(3)}, {'t': np.zeros(22)},
    {'state_multipliers': np.zeros((2, 2))}], ids=lambda change: next(iter(change)))
def test_arrays_of_wrong_shape_give_infinite_residuals(change):
    problem, solution = double_integrator()
    certificate = certify(problem, replace(solution, **change))
    assert not certificate.holds
    assert set(certificate.residuals.values()) == {math.inf}


def test_a_path_that_diverges_gives_infinite_residuals():
    problem = problems.pose({'x': 'x**2 + u'}, 'u**2', (1,), 2)
    t = np.linspace(0, 2, 3)
    certificate = certify(problem, answer(problem, t, [1 + t], [0], [0], 0.0))
    assert certificate.residuals['dynamics'] == math.inf
    assert not certificate.holds


def test_a_cost_that_is_not_a_number_gives_infinite_residuals():
    problem = problems.pose({'x': 'u'}, '0', (0,), 1, terminal_cost='sin(x)/x')
    certificate = certify(problem, answer(problem, np.linspace(0, 1, 3), [0], [0], [0], 0.0))
    assert set(certificate.residuals.values()) == {math.inf}


def test_an_empty_solution_is_not_certified():
    problem, _ = scalar()
    assert not certify(problem, Solution(Status.NOT_CONVERGED, '')).holds


def test_faults_of_the_path_come_before_those_of_costates():
    tolerances = dict.fromkeys(TOLERANCES, 1e-6)
    missed = Certificate(
        dict.fromkeys(TOLERANCES, 0.0) | {'end': 2e-6, 'costate': 1.0}, tolerances)
    assert (missed.worst, missed.fault, missed.feasible) == ('costate', 'end', False)
    reached = Certificate(dict.fromkeys(TOLERANCES, 9e-7) | {'costate': 2e-6}, tolerances)
    assert (reached.worst, reached.fault, reached.feasible) == ('costate', '', True)


@pytest.mark.parametrize('off, faults', [
    (0.0, set()), (2.0**-50, set()), (-2.0**-40, set()), (1e-4, {'end'})])
def test_rounding_at_an_equilibrium_is_tolerated(off, faults):
    # v' = a - 1 from rest to rest in the same place: a = 1 has the minimum mean square.
    problem = problems.pose(
        {'x': 'v', 'v': 'a - 1'}, '0.5*a**2', (0, 0), 2, inputs=['a'],
        terminal_constraints=['x', 'v'])
    assert failing(problem, stay_at_rest(problem, 1 + off)) >= faults
    assert bool(failing(problem, stay_at_rest(problem, 1 + off))) is bool(faults)


def test_small_states_driven_by_inputs_are_not_rounding():
    # a = 1e-11 moves x by 5e-12 within T = 1; a path of half that size is wrong.
    problem = problems.pose(
        {'x': 'v', 'v': 'a'}, 'a', (0, 0), 1, inputs=['a'], input_bounds={'a': [-1e-11, 1e-11]},
        terminal_cost='2*v')
    t = np.linspace(0.0, 1.0, 21)
    wrong = answer(problem, t, [-t**2 * 2.5e-12, -t * 5e-12], [-1e-11], [0.0, 2.0], -3e-11)
    assert 'dynamics' in failing(problem, wrong)


def decay_and_return(sign, rate=0.7, T=60.0, count=241):
    """Return x' = x u from 1 under u = -rate, then +rate, to `sign`; for 0.7, x(T/2) is 8e-10."""
    problem = problems.pose(
        {'x': 'x*u'}, '0', (1,), T, terminal_constraints=[f'x - ({sign})'],
        input_bounds={'u': [-1, 1]})
    s = np.linspace(0.0, T / 2, count)
    t, x = np.append(s, T/2 + s), np.append(np.exp(-rate*s), sign * np.exp(rate*(s - T/2)))
    u = np.repeat([-rate, rate], count)
    return problem, answer(problem, t, [x], [u], [0.0], 0.0, nu=np.zeros(1))


def test_an_impossible_change_of_sign_violates_the_dynamics():
    assert failing(*decay_and_return(1)) == set()
    assert failing(*decay_and_return(-1)) == {'dynamics'}


def test_paths_along_unstable_dynamics_are_certified():
    # x' = x + u with u = -2 x gives x = exp(-t); a defect grows by exp(30) until the end.
    problem = problems.pose(
        {'x': 'x + u'}, '0', (1,), 30, terminal_constraints=['x'], input_bounds={'u': [-3, 3]})
    t = 30 * np.linspace(0.0, 1.0, 10001)**2
    x = np.exp(-t)
    assert failing(problem, answer(problem, t, [x], [-2*x], [0.0], 0.0, nu=np.zeros(1))) == set()


# Costs of 0

def follow(off=0.0, *, length=1.0, cost=1.0, adjoint=True, count=101, start=0.0):
    """
    Return x' = u with the cost (x - r)^2 + (u - 2t)^2 of r = `start` + t^2, along x = r + off t^2.

    The costates are those of this path, or 0 unless `adjoint`. x is in units of 1/`length`, and
    the cost is multiplied by `cost`.
    """
    problem = problems.pose(
        {'x': f'{length}*u'}, f'{cost}*((x/{length} - {start} - t**2)**2 + (u - 2*t)**2)',
        (start*length,), 1)
    t = np.linspace(0.0, 1.0, count)
    lam = 2*off*cost*(1 - t**3)/3/length, -off*cost*(5 - t**4 - 4*t**2)
    return problem, answer(problem, t, [length*(start + (1 + off)*t**2), t], [2*(1 + off)*t],
                           lam if adjoint else [0.0, 0.0], cost*off**2*(1/5 + 4/3))


UNITS = [{}, {'cost': 1e6}, {'cost': 1e-6}, {'length': 1e3}, {'length': 1e-3, 'cost': 1e-6}]


@pytest.mark.parametrize('units', UNITS)
def test_a_cost_of_zero_is_certified_in_any_units(units):
    assert failing(*follow(**units)) == set()


@pytest.mark.parametrize('units', UNITS)
@pytest.mark.parametrize('off', [1e-2, 1e-3, 1e-4])
def test_a_path_beside_a_reachable_reference_is_refused(off, units):
    assert failing(*follow(off, **units)) == {'minimum', 'hamiltonian'}
    assert 'costate' in failing(*follow(off, adjoint=False, **units))


def test_rounding_errors_of_a_distant_reference_do_not_end_the_replay():
    """The costates are 1e-11, their derivative is 2 (x - r), and x is 300."""
    assert failing(*follow(1e-11, start=300.0, count=2001)) == set()
