# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of problems without a solution: the known reason, in words and numbers."""

from dataclasses import replace
from itertools import count
import math
import re
from types import SimpleNamespace

import numpy as np
from obc_ros.core.ocp.certificate.certificate import certify
from obc_ros.core.ocp.solution import Solution, Status
from obc_ros.core.solver.diagnosis.explanation import explain
from obc_ros.core.solver.nlp import meter
from obc_ros.core.solver.proofs.interval_bounds import find_lower_bounds
from obc_ros.core.solver.solve import solve
import problems
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

BLOCK = problems.DOUBLE_INTEGRATOR | {
    'input_bounds': {'u': [-1, 1]}, 'final_time': {'free': False, 'value': 1.5}}
LONGER = {'final_time': {'free': False, 'value': 3}}
LAG = {
    'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': '-x + u'}, 'running_cost': 'u**2',
    'initial_state': {'x': 0}, 'terminal_constraints': ['x - 2'], 'input_bounds': {'u': [-1, 1]},
    'final_time': {'free': False, 'value': 5}}

# Found by solving with larger and larger input bounds, which is no proof.
FALLS = 'no minimum was found: the cost decreases ever faster as the input bounds increase: '


def solve_quickly(problem):
    """Solve a problem within the time that a diagnosis may spend on one problem."""
    return solve(problem, time_limit=3.0)


def reason(mapping, **changes):
    """Return the explanation why a problem has no solution."""
    found = explain(problems.build(mapping, **changes), solve_quickly)
    assert found is not None
    return found


def assert_only_searched(found):
    """Check that the message reports the result of a search and claims no proof."""
    assert found.status is Status.NOT_CONVERGED
    assert 'no path was found' in found.message
    assert 'infeasibility has not been proved' in found.message


def numbers(text):
    """Return the numbers in a sentence."""
    return [float(part) for part in re.findall(r'-?\d+\.?\d*(?:e[+-]?\d+)?', text)]


def test_a_contradiction_needs_no_solver():
    problem = problems.build(BLOCK, terminal_constraints=['v - 2'], state_bounds={'v': [None, 1]})
    found = explain(problem)
    assert found is not None
    assert found.infeasible
    assert found.sentence == 'state bound v <= 1 and terminal constraint v = 2 exclude each other'
    assert explain(problems.build(BLOCK, **LONGER)) is None


@pytest.mark.slow
def test_a_failed_search_leaves_time_for_the_diagnosis():
    """
    The quadrotor has no path in half of its published minimum time (0.8987 s).

    The search stops after its part of the work; the rest suffices to find the minimum time.
    """
    T = problems.read('quad_2d_mintime')['expected']['objective']
    found = solve(problems.build(
        'quad_2d_mintime', final_time={'free': False, 'value': T / 2}))
    assert_only_searched(found)
    assert numbers(found.message)[-1] == pytest.approx(T, abs=1e-4)


@pytest.mark.slow
def test_a_weak_motor_raises_a_pendulum_only_partly():
    """The energy of the pendulum grows at a rate of |u| |w| <= 0.01 * 2, for 40 s at most."""
    found = solve(problems.build('pendulum_mintime', input_bounds={'u': [-0.01, 0.01]}))
    assert found.status in (Status.NOT_CONVERGED, Status.INFEASIBLE)
    text = re.search(r'path found ends with th = (\S+) instead of 3.14159', found.message)
    assert text is not None
    assert 1 - math.cos(float(text.group(1))) < 40 * 0.01 * 2


@pytest.mark.parametrize('changes', [
    {}, {'running_cost': '1', 'final_time': {'free': True, 'lower': 0.1, 'upper': 1.5}}])
def test_too_short_a_time_for_a_linear_system(changes):
    found = reason(BLOCK, **changes)
    assert found.infeasible
    assert found.sentence == (
        'the terminal constraints cannot be met by T = 1.5: the minimum time is 2')


def test_too_short_a_time_for_a_nonlinear_system():
    # At unit speed the distance from (0, 0) to (3, 4) takes 5.
    found = reason({
        'states': ['x', 'y'], 'inputs': ['heading'],
        'dynamics': {'x': 'cos(heading)', 'y': 'sin(heading)'}, 'running_cost': 'heading**2',
        'initial_state': {'x': 0, 'y': 0}, 'terminal_constraints': ['x - 3', 'y - 4'],
        'final_time': {'free': False, 'value': 4}})
    assert not found.infeasible
    assert found.sentence.startswith('no path was found that meets the terminal constraints by T')
    assert found.sentence.endswith('infeasibility has not been proved')
    assert numbers(found.sentence)[-1] == pytest.approx(5, rel=1e-3)


def test_inputs_too_weak_at_any_time():
    # x' = -x + u stays below 1 for u <= 1 and reaches 1 - exp(-5) by T = 5.
    sentence = reason(LAG).sentence
    assert 'x' in sentence
    assert any(value == pytest.approx(limit, rel=1e-3) for value in numbers(sentence)
               for limit in (1.0, 1 - math.exp(-5)))


@pytest.mark.slow
def test_a_bound_that_cannot_be_held():
    # From x = 1 with v = -3 and |u| <= 1: x = 1 - 3 t + t^2/2 crosses 0 at 3 - sqrt(7).
    found = reason(BLOCK, initial_state={'x': 1, 'v': -3}, terminal_constraints=[],
                   state_bounds={'x': [0, None]}, final_time={'free': False, 'value': 2})
    assert found.infeasible
    assert found.sentence.startswith('state bound x >= 0 cannot be satisfied')
    bound, left, depth, at = numbers(found.sentence)
    assert (bound, depth, at) == (0, pytest.approx(-3, abs=0.05), pytest.approx(2, abs=0.01))
    assert left == pytest.approx(3 - math.sqrt(7), abs=0.1)


def test_a_terminal_constraint_that_holds_nowhere():
    found = reason(LAG, terminal_constraints=['x**2 + 1'], input_bounds={})
    assert found.infeasible
    assert found.sentence == ('the terminal constraint terminal_constraints[0] cannot be met: it '
                              'is missed by at least 1')


def test_a_wall_between_start_and_goal():
    wall = {
        'states': ['x', 'y'], 'inputs': ['a', 'b'], 'dynamics': {'x': 'a', 'y': 'b'},
        'running_cost': 'a**2 + b**2', 'initial_state': {'x': -2, 'y': 0},
        'terminal_constraints': ['x - 2', 'y'],
        'path_constraints': [{'expr': 'x', 'lower': None, 'upper': 3},
                             {'expr': 'x', 'lower': None, 'upper': -1}],
        'final_time': {'free': False, 'value': 4}}
    found = reason(wall)
    assert found.infeasible
    assert 'path_constraints[1]' in found.sentence
    assert '-1' in found.sentence


def test_a_cost_without_lower_bound():
    found = reason(LAG, running_cost='x', terminal_constraints=[], input_bounds={},
                   state_bounds={'x': [-1e9, None]})
    assert not found.infeasible
    # The integral of x over [0, 5] under u = -r is -r (4 + exp(-5)).
    assert found.sentence.startswith(FALLS)
    assert numbers(found.sentence)[::2] == pytest.approx(
        [-r*(4 + math.exp(-5)) for r in (10, 100, 1000)], rel=1e-3)


@pytest.mark.slow
def test_a_feasible_problem_gets_no_explanation():
    feasible = problems.build(BLOCK, final_time={'free': False, 'value': 3})
    assert explain(feasible, solve_quickly) is None
    assert explain(problems.build(LAG, terminal_constraints=[]), solve_quickly) is None


def test_a_failing_solver_gives_no_explanation():
    def failing(_):
        return Solution(Status.TIMED_OUT, 'no time')
    assert explain(problems.build(BLOCK, **LONGER), failing) is None


@pytest.mark.slow
def test_an_infimum_of_chattering_inputs_is_reported():
    """Bolza's example: the cost tends to 0 as u alternates ever faster between 1 and -1."""
    found = solve(problems.pose(
        {'x': 'u'}, 'x**2 + (u**2 - 1)**2', (0,), 1, terminal_constraints=['x']))
    assert found.status is Status.NOT_CONVERGED
    assert found.message.startswith('the infimum ')
    infimum = float(found.message.split()[2])
    assert infimum == pytest.approx(0, abs=1e-6)
    u = sorted(numbers(found.message.split('between u = ')[1])[:2])
    assert u == pytest.approx([-1, 1], rel=1e-3)


@pytest.mark.slow
def test_time_is_left_for_the_explanation(monkeypatch):
    """A slow machine: its clock advances by 10 ms each time that the search reads it."""
    ticks = count()
    monkeypatch.setattr(meter, 'time', SimpleNamespace(monotonic=lambda: 0.01 * next(ticks)))
    found = solve(problems.pose(
        {'x': 'u'}, 'x**2 + (u**2 - 1)**2', (0,), 1, input_bounds={'u': [-1.5, 1.5]}),
        time_limit=8.0)
    assert found.status is Status.NOT_CONVERGED
    assert found.message.startswith('the infimum 0 is not attained')


@pytest.mark.slow
def test_an_unbounded_cost_with_small_residuals():
    """The cost is x(1)^2 / 2 plus the integral of y, which has no lower bound."""
    found = solve(problems.pose({'x': 'u', 'y': 'x'}, 'x*u + y', (0, 0), 1))
    assert found.status is Status.NOT_CONVERGED
    assert FALLS in found.message or 'the cost has no lower bound' in found.message


@pytest.mark.slow
def test_an_unbounded_cost_with_a_local_minimum():
    """The integral of u^2 - x^4 has a local minimum at x = 0; x = r t makes it r^2 - r^4/5."""
    found = solve(problems.pose({'x': 'u'}, 'u**2 - x**4', (0,), 1))
    assert found.status is Status.NOT_CONVERGED
    assert found.message.startswith(FALLS)
    reason, _, path = found.message.partition('; cost ')
    assert not path or found.t.size
    for cost, r in zip(numbers(reason)[::2], (10, 100, 1000), strict=True):
        assert 1.1 * (r**2 - r**4/5) <= cost <= r**2 - r**4/5


@pytest.mark.slow
def test_an_approximate_equality_of_inputs_is_not_infeasible():
    block = {'states': ['x', 'y'], 'inputs': ['a', 'b'], 'dynamics': {'x': 'a', 'y': 'b'},
             'running_cost': 'x**2 + y**2 + a**2 + b**2', 'initial_state': {'x': 1, 'y': 2},
             'path_constraints': [{'expr': 'a + b + x', 'lower': 0, 'upper': 0}],
             'final_time': {'free': False, 'value': 2}}
    found = explain(problems.build(block), solve_quickly)
    assert found is None or not found.infeasible


def test_a_path_that_leaps_over_an_obstacle_is_not_accepted():
    """Every path from x = 0 to 3 crosses the ring about radius 2; its mesh points may avoid it."""
    ring = problems.pose(
        {'x': 'a', 'y': 'b'}, 'a**2 + b**2', (0, 0), 1, inputs=['a', 'b'],
        terminal_constraints=['x - 3', 'y'],
        path_constraints=[{'expr': '(x**2 + y**2 - 4)**2', 'lower': 0.25, 'upper': None}])
    t = np.array([0.0, 0.5, 1.0])   # a straight path with mesh points on both sides of the ring
    leap = Solution(
        Status.NOT_CONVERGED, '', objective=9.0, t=t, x=np.column_stack([3*t, 0*t]),
        u=np.tile([3.0, 0.0], (3, 1)), lam=np.tile([-6.0, 0.0], (3, 1)),
        hamiltonian=np.full(3, -9.0))
    found = explain(ring, lambda other: replace(leap, certificate=certify(ring, leap)))
    assert not found.infeasible
    assert 'satisfies path_constraints[0] at all times' in found.sentence


@pytest.mark.slow
def test_an_infimum_that_is_not_attained_by_weierstrass():
    """From x = -1 to 1 the integral of t^2 u^2 has the infimum 0, which no path attains."""
    found = reason({
        'states': ['x', 't'], 'inputs': ['u'], 'dynamics': {'x': 'u', 't': '1'},
        'running_cost': 't**2*u**2', 'initial_state': {'x': -1, 't': 0},
        'terminal_constraints': ['x - 1'], 'final_time': {'free': False, 'value': 1}})
    assert not found.infeasible
    assert 'keeps decreasing as the input bounds increase' in found.sentence


@pytest.mark.slow
def test_a_rocket_that_chatters_along_its_speed_limit():
    """
    ACADO's rocket in minimum time: less mass is faster, and braking also burns 0.01 u^2.

    Along its speed limit it would switch infinitely fast between full thrust and full brake, so
    that m = 1 - 0.0121 t throughout. An independent integration of full thrust, the speed limit
    and full brake yields the expected infimum.
    """
    def fly(start, begin, u, stop):
        stop.terminal = True
        path = solve_ivp(
            lambda t, z: [z[1], (u - 0.2 * z[1]**2) / (1 - 0.0121 * t)], (begin, 20), start,
            events=stop, rtol=1e-12, atol=1e-12)
        return path.t[-1], path.y[0, -1]

    reached, distance = fly([0, 0], 0, 1.1, lambda t, z: z[1] - 1.7)

    def braked(t):
        return fly([distance + 1.7 * (t - reached), 1.7], t, -1.1, lambda t, z: z[1])

    minimum = braked(brentq(lambda t: braked(t)[1] - 10, reached, 8, xtol=1e-12))[0]
    found = solve(problems.pose(
        {'s': 'v', 'v': '(u - 0.2*v**2)/m', 'm': '-0.01*u**2'}, '1', (0, 0, 1),
        {'free': True, 'lower': 5, 'upper': 15}, terminal_constraints=['s - 10', 'v'],
        input_bounds={'u': [-1.1, 1.1]}, state_bounds={'v': [-0.1, 1.7]}))
    assert found.status is Status.NOT_CONVERGED
    assert found.message.startswith(
        f'the infimum {minimum:.6g} may not be attained: minimising sequences chatter, at t = ')
    assert 'between u = 1.1 and -1.1' in found.message


CELL = {
    'states': ['x', 'v', 'E'], 'inputs': ['a'],
    'dynamics': {'x': 'v', 'v': 'a', 'E': '-a**2 - 0.1'},
    'running_cost': '1', 'initial_state': {'x': 0, 'v': 0, 'E': 1},
    'terminal_constraints': ['x - 10', 'v'], 'input_bounds': {'a': [-3, 3]},
    'state_bounds': {'E': [0, None]}, 'final_time': {'free': False, 'value': 10}}


@pytest.mark.slow
def test_too_little_charge():
    """The integral of a^2 is at least 12 d^2 / T^3 = 1.2, so that E(T) <= 1 - 1.2 - 0.1 T."""
    found = solve(problems.build(CELL))
    assert_only_searched(found)
    sentence, left = found.message.split(', is ', 1)
    assert sentence == (
        'no path was found that satisfies all constraints: E never increases, and the largest '
        'final value found for it, with the terminal constraints met at T = 10')
    assert ', which violates state bound E >= 0' in left
    assert numbers(left)[0] == pytest.approx(-1.2, rel=1e-5)
    assert solve(problems.build(CELL, initial_state={'x': 0, 'v': 0, 'E': 2.21})).certified


@pytest.mark.slow
def test_too_little_fuel():
    """A rocket without gravity: m(T) = m(0) exp(-v(T) / 30)."""
    found = explain(problems.pose(
        {'v': 'F/m', 'm': '-F/30'}, 'F**2', (0, 10), {'free': True, 'lower': 1, 'upper': 9},
        inputs=['F'], terminal_constraints=['v - 20'], input_bounds={'F': [0, 40]},
        state_bounds={'m': [6, None]}), solve_quickly)
    assert found is not None
    assert not found.infeasible
    assert ('m never increases, and the largest final value found for it, with the terminal '
            'constraints met by T = 9, is ') in found.sentence
    assert numbers(found.sentence)[-2] == pytest.approx(10 * math.exp(-2 / 3), rel=1e-5)


@pytest.mark.slow
def test_too_short_a_time_with_speed_and_acceleration_limits():
    """Starting and braking take 6 s each, so that x(T) <= 5 (T - 6): 100 takes T = 26."""
    found = solve(problems.pose(
        {'x': 'v', 'v': 'a', 'a': 'j'}, 'j**2', (0, 0, 0), 25.5, inputs=['j'],
        terminal_constraints=['x - 100', 'v', 'a'], input_bounds={'j': [-1, 1]},
        state_bounds={'v': [-5, 5], 'a': [-1, 1]}))
    assert found.status is Status.INFEASIBLE
    sentence = 'the terminal constraints cannot be met by T = 25.5: the minimum time is '
    assert found.message.startswith(sentence)
    assert numbers(found.message[len(sentence):])[0] == pytest.approx(26, rel=1e-4)


def test_a_goal_inside_an_obstacle_with_a_free_heading():
    found = explain(problems.pose(
        {'x': 'v*cos(heading)', 'y': 'v*sin(heading)', 'heading': 'w'}, 'v**2 + w**2', (0, 0, 0),
        10, inputs=['v', 'w'], terminal_constraints=['x - 4', 'y - 1'],
        path_constraints=[{'expr': '(x - 4)**2 + (y - 1.2)**2', 'lower': 1}]))
    assert found is not None
    assert found.infeasible
    assert found.sentence == ('path_constraints[0] is 0.04 at the state that the terminal '
                              'constraints demand but must be >= 1')


def test_a_path_constraint_that_holds_nowhere():
    found = explain(problems.build(
        LAG, terminal_constraints=[],
        path_constraints=[{'expr': 'sin(x) + u**2', 'lower': None, 'upper': -2}]))
    assert found is not None
    assert found.infeasible
    assert found.sentence == ('path_constraints[0] is at least -1 for all admissible states and '
                              'inputs but must be <= -2')


@pytest.mark.slow
def test_too_little_vaccine():
    """
    No state bound states S >= 0: it follows from the dynamics.

    S falls from 1 to 1/2 for c = 1/2, whatever the schedule, because S + c is constant.
    """
    found = explain(problems.pose(
        {'S': '-u*S', 'c': 'u*S'}, 'u**2', (1, 0), 5, terminal_constraints=['S - 0.5'],
        input_bounds={'u': [0, 1]}, state_bounds={'c': [None, 0.4]}), solve_quickly)
    assert found is not None
    assert not found.infeasible
    assert 'c never decreases' in found.sentence
    assert numbers(found.sentence)[-2] == pytest.approx(0.5, rel=1e-5)


def test_lower_bounds_of_nonnegative_states_are_found():
    def lower(dynamics, x0):
        return find_lower_bounds(problems.pose(
            dynamics, 'u', x0, 1, input_bounds={'u': [0, 1]})).tolist()

    epidemic = {'S': '-0.3*S*I - u*S', 'I': '0.3*S*I - 0.1*I'}
    assert lower(epidemic, (1, 0)) == [0, 0]
    assert lower(epidemic, (-1, 1)) == [-math.inf, 0]
    assert lower({'x': 'v', 'v': 'u'}, (1, 0)) == [0, 0]
    # With a rate of -sqrt(|x|), -(t - 2)^2 / 4 also continues the path after t = 2.
    for root in ('sqrt(abs(x))', 'exp(log(abs(x))/2)', 'acos(1 - abs(x))', 'abs(x)**(0.5 + 0*u)'):
        assert lower({'x': f'-{root} + 0*u'}, (1,)) == [-math.inf]
    assert lower({'x': 'v', 'v': 'u - 0.1'}, (1, 0)) == [-math.inf, -math.inf]


def test_an_end_below_a_proved_lower_bound_is_infeasible():
    # Harvested logistic growth comes within 1e-9 of x = 0 but never falls below it.
    found = explain(problems.build(
        LAG, dynamics={'x': 'x*(1 - x) - u*x'}, initial_state={'x': 0.5},
        terminal_constraints=['x + 0.2']))
    assert found is not None
    assert found.infeasible
    assert found.sentence == ('the terminal constraint x = -0.2 cannot be met because no input '
                              'takes x below 0: it is missed by at least 0.2')


def test_a_proof_counts_though_no_constraint_can_be_blamed():
    """A mass on a spring starts at 1 and must pass -0.5 m/s; no related problem is solved."""
    problem = problems.pose(
        {'q': 'v', 'v': 'u - 2*q'}, 'q**2 + u**2', (1, 0), 10,
        input_bounds={'u': [-0.3, 0.3]}, state_bounds={'v': [-0.5, 0.5]})
    reason = explain(problem, lambda other: Solution(Status.NOT_CONVERGED, ''))
    assert reason.infeasible
    assert 'weak duality' in reason.sentence
