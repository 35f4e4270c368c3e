# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Time, free parameters, free and constrained initial states, periodic states: closed forms."""

from dataclasses import replace
import math

import numpy as np
from obc_ros.core.ocp.augmentation import hide_added_states, restore_added_states
from obc_ros.core.ocp.certificate.certificate import certify
from obc_ros.core.ocp.solution import Condition
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.solver.solve import solve
from obc_ros.core.text.errors import StatementError
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq


def lasting(T):
    """Return a given final time."""
    return {'free': False, 'value': T}


INTEGRATOR = {'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u'}}
TRACKING = INTEGRATOR | {'running_cost': '(x - t)**2/2 + u**2/2', 'initial_state': {'x': None},
                         'final_time': lasting(1)}
GAIN = {'states': ['x'], 'inputs': ['u'], 'free_parameters': {'m': [0.1, 5]},
        'dynamics': {'x': 'm*u'}, 'running_cost': 'u**2/2', 'terminal_cost': 'm',
        'terminal_constraints': ['x - 1'], 'initial_state': {'x': 0}, 'final_time': lasting(1)}


def solved(statement):
    """Return a problem and its certified solution."""
    problem = build_problem(statement)
    found = solve(problem)
    assert found.certified, found.message
    return problem, found


def test_the_costate_of_a_free_initial_state_vanishes():
    _, found = solved(TRACKING)
    a = (math.cosh(1) - 1) / math.sinh(1)

    def x(t):
        return t + a * math.cosh(t) - math.sinh(t)

    def u(t):
        return 1 + a * math.sinh(t) - math.cosh(t)

    assert found.x[0, 0] == pytest.approx(a, abs=1e-6)
    assert abs(found.lam[0, 0]) < 1e-6
    assert found.objective == pytest.approx(
        quad(lambda t: (x(t) - t)**2 / 2 + u(t)**2 / 2, 0, 1)[0], rel=1e-6)
    assert found.optimality.kind == 'global'


def test_an_initial_cost_balances_the_costate():
    # With x(0) = a and u = b, (a - 1)^2 + b^2 + (a + b - 3)^2 is least at a = 5/3, b = 2/3.
    _, found = solved(INTEGRATOR | {
        'running_cost': 'u**2', 'initial_cost': '(x - 1)**2', 'terminal_cost': '(x - 3)**2',
        'initial_state': {'x': None}, 'final_time': lasting(1)})
    assert found.objective == pytest.approx(4/3, rel=1e-9)
    assert found.x[0, 0] == pytest.approx(5/3, rel=1e-7)
    assert found.lam[0, 0] == pytest.approx(-2 * (5/3 - 1), rel=1e-6)


@pytest.mark.parametrize(('bounds', 'start'), [
    ([None, 0.2], 0.2), ([0.6, None], 0.6), ([-1, 1], (math.cosh(1) - 1) / math.sinh(1))])
def test_an_initial_state_keeps_to_its_bounds(bounds, start):
    problem, found = solved(TRACKING | {'initial_state': {'x': bounds}})
    assert found.x[0, 0] == pytest.approx(start, abs=1e-6)
    # lam(0) is the derivative of the optimal cost by x(0).
    steps = [solved(TRACKING | {'initial_state': {'x': float(start + h)}})[1].objective
             for h in (-1e-3, 1e-3)]
    assert found.lam[0, 0] == pytest.approx((steps[1] - steps[0]) / 2e-3, abs=1e-5)
    assert problem.given_at_start.tolist() == [False, True]


def test_initial_constraints_give_the_nearest_point():
    _, found = solved({
        'states': ['x', 'y'], 'inputs': ['u', 'w'], 'dynamics': {'x': 'u', 'y': 'w'},
        'running_cost': 'u**2 + w**2', 'initial_constraints': ['x**2 + y**2 - 1'],
        'terminal_constraints': ['x - 2', 'y - 2'], 'final_time': lasting(1),
        'initial_state': {'x': [0.1, 1], 'y': [0.1, 1]}})
    assert found.objective == pytest.approx((2 * math.sqrt(2) - 1)**2, rel=1e-8)
    # lam(0) = -nu0 dpsi0/dx, behind the multipliers of the terminal constraints.
    assert found.lam[0, :2] == pytest.approx(-found.nu[2] * 2 * found.x[0, :2], rel=1e-6)


@pytest.mark.parametrize(('bounds', 'm'), [([0.1, 5], 1.0), ([2, 5], 2.0), ([0.1, 0.5], 0.5)])
def test_a_free_parameter_balances_its_costs_or_is_at_a_bound(bounds, m):
    # u = 1/m, so that the cost is 1/(2 m^2) + m, which is least at m = 1.
    problem, found = solved(GAIN | {'free_parameters': {'m': bounds}})
    assert hide_added_states(problem, found).free_parameters['m'] == pytest.approx(m, rel=1e-5)
    assert found.objective == pytest.approx(1 / (2 * m**2) + m, rel=1e-6)
    assert found.lam[0, 1] == pytest.approx(1 - m**-3, abs=1e-4)


def test_a_periodic_state_has_a_periodic_costate():
    w = 3.0
    _, found = solved(INTEGRATOR | {
        'parameters': {'w': w}, 'running_cost': '(x - cos(w*t))**2 + u**2', 'periodic': ['x'],
        'initial_state': {'x': None}, 'final_time': lasting(f'{2 * math.pi}/w')})
    assert found.objective == pytest.approx(math.pi / w * w**2 / (1 + w**2), rel=1e-6)
    assert found.x[[0, -1], 0] == pytest.approx(1 / (1 + w**2), rel=1e-5)
    assert found.lam[0, 0] == pytest.approx(found.lam[-1, 0], abs=1e-5)


def test_a_periodic_state_with_a_given_initial_value_returns():
    _, found = solved(INTEGRATOR | {
        'running_cost': 'u**2/2 + t*u', 'periodic': ['x'], 'initial_state': {'x': 2},
        'final_time': lasting(1)})
    # u = 1/2 - t: the mean of u vanishes, and u + t is constant.
    assert found.objective == pytest.approx(-1/24, rel=1e-8)


def test_a_forcing_in_resonance_is_cancelled():
    _, found = solved({
        'states': ['x', 'v'], 'inputs': ['u'], 'dynamics': {'x': 'v', 'v': '-x + u + sin(t)'},
        'running_cost': 'u**2/2', 'terminal_constraints': ['x', 'v'],
        'initial_state': {'x': 0, 'v': 0}, 'final_time': lasting('2*pi')})
    assert found.objective == pytest.approx(math.pi / 2, rel=1e-6)
    assert found.u[:, 0] == pytest.approx(-np.sin(found.t), abs=1e-3)


def test_inputs_switch_where_the_time_says_so():
    # lam = -sin t, so that u = sgn(sin t) and J = -integral of |sin t|.
    _, found = solved(INTEGRATOR | {
        'running_cost': 'x*cos(t)', 'input_bounds': {'u': [-1, 1]}, 'initial_state': {'x': 0},
        'final_time': lasting('2*pi')})
    assert found.objective == pytest.approx(-4, rel=1e-8)
    assert found.switching_times == pytest.approx([math.pi], abs=1e-5)


def test_a_moving_target_is_met_and_the_hamiltonian_balances_its_speed():
    problem, found = solved(INTEGRATOR | {
        'running_cost': '1', 'input_bounds': {'u': [-1, 1]}, 'initial_state': {'x': 0},
        'terminal_constraints': ['x - 2 - sin(t)/2'],
        'final_time': {'free': True, 'lower': 0.01, 'upper': 10}})
    T = brentq(lambda t: t - 2 - math.sin(t) / 2, 1, 4)
    assert found.objective == pytest.approx(T, rel=1e-9)
    shown = hide_added_states(problem, found)
    assert shown.x.shape[1] == shown.lam.shape[1] == 1
    # H(T) = -dV/dt - nu dpsi/dt in the terms of the statement.
    assert shown.hamiltonian[-1] == pytest.approx(found.nu[0] * math.cos(T) / 2, rel=1e-6)


def test_a_moving_obstacle_is_followed():
    # Straight to the parabola 1/2 - 4 (t - 1/2)^2, along it, and straight back.
    _, found = solved(INTEGRATOR | {
        'running_cost': 'u**2/2', 'initial_state': {'x': 0}, 'terminal_constraints': ['x'],
        'path_constraints': [{'expr': 'x - 0.5 + 4*(t - 0.5)**2', 'lower': 0}],
        'final_time': lasting(1)})
    t = math.sqrt(1/8)   # where the tangent passes through the start
    assert found.objective == pytest.approx(
        64 * t * (t - 0.5)**2 + 64/3 * (0.5 - t)**3, rel=1e-6)


@pytest.mark.parametrize(('cost', 'wheelbase'), [('l', 1), ('-l', 3)])
@pytest.mark.slow
def test_a_parameter_of_a_system_can_be_free(cost, wheelbase):
    # At full speed and steering the angle is reached with a wheelbase of 3, at less with 1.
    problem, found = solved({
        'system': 'vehicle', 'free_parameters': {'l': [1, 5]}, 'running_cost': '0',
        'terminal_cost': cost, 'initial_state': {'px': 0, 'py': 0, 'theta': 0},
        'input_bounds': {'v': [0, 1], 'phi': [0, 0.1]}, 'final_time': lasting(1),
        'terminal_constraints': [f'theta - {math.tan(0.1) / 3!r}']})
    assert problem.shown_states == ('px', 'py', 'theta')
    assert 'l' not in problem.parameters
    shown = hide_added_states(problem, found)
    assert shown.free_parameters == pytest.approx({'l': wheelbase}, rel=1e-5)


@pytest.mark.parametrize('pinned', [0.3, 0.6])
def test_another_initial_state_is_not_certified(pinned):
    problem = build_problem(TRACKING)
    found = solved(TRACKING | {'initial_state': {'x': pinned}})[1]
    certificate = certify(problem, found)
    assert [key for key, value in certificate.residuals.items()
            if value > certificate.tolerances[key]] == [Condition.TRANSVERSALITY]


def test_a_parameter_at_the_wrong_bound_is_not_certified():
    problem = build_problem(GAIN | {'free_parameters': {'m': [0.5, 5]}})
    found = solved(GAIN | {'free_parameters': {'m': [0.1, 0.5]}})[1]   # the cost falls with m
    certificate = certify(problem, found)
    assert certificate.residuals[Condition.TRANSVERSALITY] > 0.1


def test_a_state_outside_its_initial_bounds_is_not_certified():
    problem, found = solved(TRACKING | {'initial_state': {'x': [None, 0.2]}})
    start = replace(problem.start, upper=problem.start.upper - 1e-3)
    assert certify(replace(problem, start=start), found).fault == Condition.START


def test_a_state_that_does_not_return_is_not_certified():
    statement = INTEGRATOR | {'running_cost': '(x - t)**2 + u**2', 'periodic': ['x'],
                              'initial_state': {'x': None}, 'final_time': lasting(1)}
    problem, found = solved(statement)
    x = found.x.copy()
    x[:, 0] += 1e-3
    assert certify(problem, replace(found, x=x)).residuals[Condition.START] > 1e-4


def test_added_states_are_restored_from_what_a_user_sees():
    problem, found = solved({
        'states': ['x'], 'inputs': ['u'], 'free_parameters': {'m': [0.1, 5]},
        'dynamics': {'x': 'm*u + t'}, 'running_cost': 'u**2', 'terminal_cost': 'm**2',
        'initial_cost': '(x - 1)**2', 'initial_state': {'x': None}, 'final_time': lasting(1)})
    assert problem.states == ('x', 't', 'm', 'x(0)')
    shown = hide_added_states(problem, found)
    whole = restore_added_states(problem, shown)
    assert whole.x == pytest.approx(found.x, abs=1e-9)
    assert whole.lam[:, 0] == pytest.approx(found.lam[:, 0], abs=0)
    assert hide_added_states(problem, shown) is shown
    assert restore_added_states(problem, found) is found


def test_a_statement_that_has_its_own_t_keeps_it():
    own = {'states': ['t', 'x'], 'inputs': ['u'], 'dynamics': {'t': '2', 'x': 'u*t'},
           'initial_state': {'t': 1, 'x': 0}, 'final_time': lasting(1)}
    problem = build_problem(own)
    assert (problem.states, problem.added, problem.has_clock) == (('t', 'x'), 0, False)
    named = build_problem(INTEGRATOR | {'parameters': {'t': 3}, 'dynamics': {'x': 't*u'},
                                        'initial_state': {'x': 0}, 'final_time': lasting(1)})
    assert (named.n, named.parameters) == (1, ('t',))


def test_a_statement_without_additions_has_no_added_states():
    problem = build_problem(INTEGRATOR | {'initial_state': {'x': 0}, 'final_time': lasting(1)})
    assert (problem.start, problem.added, problem.n) == (None, 0, 1)


@pytest.mark.parametrize(('change', 'said'), [
    ({'free_parameters': {'t': [0, 1]}}, "^free_parameters: 't' is the time"),
    ({'free_parameters': {'x': [0, 1]}}, "^free_parameters: 'x' is a state or an input"),
    ({'free_parameters': {'a': [0, 1]}, 'parameters': {'a': 1}}, "'a' has a value in parameters"),
    ({'free_parameters': {'a': [1, 0]}}, r'^free_parameters\.a: the bounds cross'),
    ({'free_parameters': {'a': 3}}, r'^free_parameters\.a: wanted \[lower, upper\]'),
    ({'free_parameters': [1]}, '^free_parameters: wanted a mapping'),
    ({'initial_state': {'x': [1, 0]}}, r'^initial_state\.x: the bounds cross'),
    ({'initial_state': {'x': [0, math.nan]}}, r'^initial_state\.x \(upper\): nan'),
    ({'initial_cost': 't'}, "^initial_cost: unknown name 't'"),
    ({'initial_cost': 'u'}, "^initial_cost: 'u' is an input"),
    ({'initial_constraints': ['3']}, r"^initial_constraints\[0\]: '3' does not depend"),
    ({'periodic': ['z']}, "^periodic: 'z' is not a state"),
    ({'periodic': ['x', 'x']}, "^periodic: 'x' occurs twice"),
    ({'periodic': 'x'}, '^periodic: wanted a list'),
    ({'parameters': {'b': 't'}}, "^parameters.b: unknown name 't'; the time is known in"),
    ({'initial_state': {'x': None}, 'running_cost': 'log(x)'}, '^running_cost: .* initial_guess'),
    ({'initial_guess': {'parameters': {'x': 1}}}, r'^initial_guess\.parameters\.x'),
])
def test_errors_name_the_key_and_what_to_do(change, said):
    with pytest.raises(StatementError, match=said):
        build_problem(INTEGRATOR | {'initial_state': {'x': 0}, 'final_time': lasting(1)} | change)


@pytest.mark.parametrize(('change', 'said'), [
    ({'initial_state': {'x': [2, None]}, 'state_bounds': {'x': [None, 1]}}, 'x >= 2'),
    ({'initial_state': {'x': [None, 0]}, 'state_bounds': {'x': [1, None]}}, 'x <= 0'),
    ({'initial_state': {'x': [0, 1]}, 'terminal_constraints': ['sin(x) - 3'],
      'input_bounds': {'u': [-1, 1]}}, 'terminal constraint'),
])
def test_what_no_initial_state_allows_is_infeasible(change, said):
    found = solve(build_problem(INTEGRATOR | {
        'running_cost': 'u**2', 'final_time': lasting(1)} | change))
    assert found.status == 'infeasible' and said in found.message


@pytest.mark.slow
def test_a_drift_is_not_hidden_by_a_huge_initial_state():
    # x(T) - x(0) is at least 1/2; at x = 1e16 it is below the rounding error.
    problem = build_problem(INTEGRATOR | {
        'dynamics': {'x': '1 + u'}, 'running_cost': 'u**2', 'input_bounds': {'u': [-0.5, 0.5]},
        'periodic': ['x'], 'initial_state': {'x': None}, 'final_time': lasting(1)})
    found = solve(problem)
    assert found.status == 'not_converged' and 'missed by 0.5' in found.message
    for size in (1e3, 1e6, 1e16):
        x = np.full((2, 2), size)
        made_up = replace(found, t=np.array([0.0, 1.0]), x=x, u=np.full((2, 1), -0.5),
                          lam=np.zeros((2, 2)), hamiltonian=np.full(2, 0.25), objective=0.25,
                          nu=np.zeros(1), switching_times=np.zeros(0))
        assert not certify(problem, made_up).feasible


@pytest.mark.parametrize('change', [
    {'initial_state': {'x': None}, 'terminal_cost': 'x'},
    {'free_parameters': {'k': None}, 'terminal_cost': 'k + x**2', 'initial_state': {'x': 0}}])
@pytest.mark.slow
def test_a_cost_without_a_lower_bound_is_not_solved(change):
    assert solve(build_problem(INTEGRATOR | {
        'running_cost': 'u**2', 'final_time': lasting(1)} | change)).status != 'solved'


def test_what_one_initial_state_allows_is_not_infeasible():
    # From x(0) = 0 the target is out of reach; from x(0) = 2 it is not.
    _, found = solved(INTEGRATOR | {
        'running_cost': 'u**2', 'input_bounds': {'u': [-1, 1]}, 'initial_state': {'x': [-2, 2]},
        'terminal_constraints': ['x - 2.5'], 'final_time': lasting(1)})
    assert found.objective == pytest.approx(0.25, rel=1e-6)
