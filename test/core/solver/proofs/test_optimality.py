# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Optimality of solutions: convexity, and called global only where proved."""

import casadi as ca
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.ocp.solution import MOST_MINIMA, Solution, Status
from obc_ros.core.solver.program_cache import Cache
from obc_ros.core.solver.proofs.convexity import is_convex_problem
from obc_ros.core.solver.proofs.optimality import add_optimality, describe_local
from obc_ros.core.solver.solve import solve
import problems
import pytest

BLOCK = {
    'states': ['x', 'v'], 'inputs': ['u'], 'dynamics': {'x': 'v', 'v': 'u'},
    'running_cost': 'x**2 + u**2', 'initial_state': {'x': 1, 'v': 0},
    'input_bounds': {'u': [-0.5, 0.5]}, 'final_time': {'free': False, 'value': 2}}
FREE = {'final_time': {'free': True, 'lower': 0.1, 'upper': 30}, 'running_cost': 1,
        'input_bounds': {'u': [-1, 1]}, 'terminal_constraints': ['x', 'v']}
ROBOT = {
    'states': ['px', 'py', 'theta'], 'inputs': ['v', 'omega'],
    'dynamics': {'px': 'v*cos(theta)', 'py': 'sin(theta)*v', 'theta': 'omega'},
    'running_cost': 1, 'initial_state': {'px': 0, 'py': 0, 'theta': 0},
    'terminal_constraints': ['px - 3', 'py - 1', 'theta - 1'],
    'input_bounds': {'v': [-1, 1], 'omega': [-1, 1]},
    'final_time': {'free': True, 'lower': 0.1, 'upper': 20}}


@pytest.mark.parametrize('changes', [
    {}, {'running_cost': '2*x**4 + x**2 - x*v + v**2 + 3*u**2'}, {'running_cost': 'abs(u)'},
    {'running_cost': 'exp(x - v) + u**2', 'terminal_cost': 'cosh(v)/2 - 3*x'},
    {'running_cost': 'sqrt(1 + u**2) + abs(x - v)'}, {'running_cost': '(abs(x) + x**2)**2 + u**2'},
    {'running_cost': 'x**3 + 1/(1 + x) + u**2', 'state_bounds': {'x': [0, None]}},
    {'running_cost': 'u**2 - log(3 + x) - sqrt(4 + v)'},
    {'path_constraints': [{'expr': 'x**2 + v**2', 'upper': 4}, {'expr': 'u**2', 'upper': 0.2},
                          {'expr': '5 - x**4', 'lower': 0}, {'expr': 'x + v', 'lower': -9}]},
])
def test_convex_problems_are_recognised(changes):
    assert is_convex_problem(problems.build(BLOCK, **changes))


@pytest.mark.parametrize('changes', [
    {'running_cost': 'u**2 - 1e-6*x**2'}, {'running_cost': 'u**2 + x**3'},
    {'running_cost': 'u**2 + 1/(1 + x)'}, {'running_cost': 'u**2 + sin(x)'},
    {'running_cost': 'u**2 + x**2*v**2'}, {'running_cost': 'u**2 + (x**2 - 1)**2'},
    {'running_cost': 'u**2', 'terminal_cost': '-abs(x)'},
    {'running_cost': 'abs(x - u)'},   # its subgradients in x and u depend on each other
    {'running_cost': 'u**2 + sqrt(1 - x**2)'}, {'running_cost': '-exp(u)'},
    {'dynamics': {'x': 'v', 'v': 'u - sin(x)'}}, {'dynamics': {'x': 'v', 'v': 'u*v'}},
    {'path_constraints': [{'expr': 'x**2 + v**2', 'lower': 0.1}]},
    {'path_constraints': [{'expr': 'x + u', 'upper': 3}]},
    {'terminal_constraints': ['x**2 + v']},
    {'final_time': {'free': True, 'lower': 1, 'upper': 3}},
])
def test_convexity_is_not_claimed_without_proof(changes):
    assert not is_convex_problem(problems.build(BLOCK, **changes))


CLOCK = BLOCK | {'states': ['x', 'v', 't'], 'dynamics': {'x': 'v', 'v': 'u - sin(t)', 't': '1'},
                 'initial_state': {'x': 1, 'v': 0, 't': 1}}


@pytest.mark.parametrize('changes', [
    {}, {'running_cost': '(2 + sin(9*t))*(x - cos(t))**2 + u**2'},
    {'running_cost': 'sin(t)*u + exp(-t)*abs(x) + t**3*sin(t)'},
    {'running_cost': '(x - t)**2/t + u**2*t', 'terminal_cost': 't*x**2'},
    {'running_cost': 'x**2 - (0.9 - t)*u**2'},
    {'dynamics': {'x': 't*v', 'v': 'u/t - x*sin(t)', 't': '1'}},
    {'path_constraints': [{'expr': 't*u', 'upper': 1}, {'expr': 'x**2 - sin(t)', 'upper': 9}]},
    {'parameters': {'w': 3}, 'dynamics': {'x': 'v', 'v': 'u', 't': 'w'}},
])
def test_a_function_of_time_is_a_constant_at_each_time(changes):
    assert is_convex_problem(problems.build(CLOCK, **changes))


@pytest.mark.parametrize('changes', [
    {'running_cost': 'sin(2*t)*x**2 + u**2'},                  # negative from t = pi/2
    {'running_cost': '(t - 2)*abs(u)'}, {'running_cost': 'x**2/(t - 2) + u**2'},
    {'running_cost': 't*x*v + u**2'},
    {'running_cost': 't*x**2 + u**2', 'initial_state': {'x': 1, 'v': 0, 't': -1}},
    {'running_cost': 'u**2 - sqrt(t)*x**2'},
    {'running_cost': 't*x**2 + u**2', 'dynamics': {'x': 'v', 'v': 'u', 't': '-1'}},
    {'running_cost': 't*x**2 + u**2', 'dynamics': {'x': 'v', 'v': 'u', 't': '1 + u'}},
    {'dynamics': {'x': 'v', 'v': 't*u*x', 't': '1'}},
    {'path_constraints': [{'expr': 't*u**2', 'lower': 0.1}]},
    {'path_constraints': [{'expr': 't*x + u', 'upper': 3}]},
])
def test_a_function_of_time_may_be_negative(changes):
    assert not is_convex_problem(problems.build(CLOCK, **changes))


@pytest.mark.parametrize('states', [['t'], ['t', 's']])
def test_a_problem_whose_states_are_all_times_is_judged_by_its_inputs(states):
    given = problems.build({
        'states': states, 'inputs': ['u'], 'dynamics': dict.fromkeys(states, '1'),
        'running_cost': '(u - sin(t))**2', 'initial_state': dict.fromkeys(states, 0),
        'final_time': {'free': False, 'value': 2}})
    assert is_convex_problem(given)
    assert not is_convex_problem(problems.build({
        'states': states, 'inputs': ['u'], 'dynamics': dict.fromkeys(states, '1'),
        'running_cost': '(u**2 - 1)**2', 'initial_state': dict.fromkeys(states, 0),
        'final_time': {'free': False, 'value': 2}}))


@st.composite
def expressions(draw):
    """Draw an expression of x, v and u."""
    leaf = st.sampled_from(['x', 'v', 'u', '1', '2', '0.5', '-3'])
    one = st.sampled_from(['({})**2', '({})**3', '({})**4', 'exp({}/4)', 'abs({})', 'cosh({}/4)',
                           '-({})', 'sqrt(9 + ({}))', 'log(9 + ({}))', '1/(9 + ({}))',
                           'sqrt(1 + ({})**2)', '({})**1.5'])
    two = st.sampled_from(['({}) + ({})', '({}) - ({})', '({})*({})', '({})/({})'])
    return draw(st.recursive(leaf, lambda part: st.one_of(
        st.builds(lambda form, a: form.format(a), one, part),
        st.builds(lambda form, a, b: form.format(a, b), two, part, part)), max_leaves=6))


@pytest.mark.slow
@settings(max_examples=100)
@given(text=expressions(), lower=st.sampled_from([None, 0]))
def test_convex_costs_lie_below_their_chords(text, lower):
    """Random expressions at random pairs of points; the check uses no rules of convexity."""
    bounds = {name: [lower, None] for name in ('x', 'v')}
    try:
        stated = problems.build(BLOCK, running_cost=f'{text} + 0*x', state_bounds=bounds)
    except Exception as error:   # undefined at the initial state
        assert 'running_cost' in str(error) or 'value' in str(error) or 'start' in str(error)
        return
    if not is_convex_problem(stated):
        return
    L = ca.Function('L', [ca.vertcat(stated.x, stated.u)], [stated.L])
    chance = np.random.default_rng(0)
    low = np.array([-1.0 if lower is None else 0.0] * 2 + [-1.0])
    a, b = (low + (1 - low) * chance.uniform(size=(40, 3)) for _ in range(2))
    ends, middle = (L(a.T) + L(b.T)) / 2, L((a.T + b.T) / 2)
    good = np.isfinite(ends.full()) & np.isfinite(middle.full())
    gap = (middle - ends).full()[good]
    assert (gap <= 1e-9 * (1 + np.abs(ends.full()[good]))).all()


@pytest.mark.parametrize('mapping, reason', [
    (BLOCK | {'input_bounds': {}}, 'linear quadratic'),
    (BLOCK, 'convex'),
    (BLOCK | {'running_cost': 'x**4 + u**2', 'state_bounds': {'v': [-0.3, None]}}, 'convex'),
    (BLOCK | FREE, 'closed form of the double integrator'),
    (BLOCK | FREE | {'dynamics': {'x': 'v', 'v': 'u - x'}}, 'minimum time of a linear system'),
    (ROBOT, 'shortest path (Reeds-Shepp)'),
    (BLOCK | FREE | {'running_cost': 0}, 'every path costs the same'),
], ids=lambda each: each if isinstance(each, str) else '')
def test_a_proved_global_minimum_is_called_global(mapping, reason):
    found = solve(problems.build(mapping))
    assert found.status is Status.SOLVED
    assert (found.optimality.kind, found.optimality.reason) == ('global', reason)
    assert found.optimality.minima == ()


@pytest.mark.parametrize('mapping', [
    BLOCK | {'dynamics': {'x': 'v', 'v': 'u - sin(3*x)'}},
    BLOCK | {'running_cost': 'u**2 + cos(x)'},
    BLOCK | FREE | {'running_cost': '1 + u**2'},
    # The target is no equilibrium: a path that meets it earlier cannot wait there.
    BLOCK | FREE | {'dynamics': {'x': 'v', 'v': 'u - x'}, 'terminal_constraints': ['x', 'v - 0.9'],
                    'initial_state': {'x': 0.5, 'v': 0.2}},
])
def test_an_unproved_minimum_is_called_local(mapping):
    found = solve(problems.build(mapping))
    assert found.status is Status.SOLVED
    assert found.optimality.kind == 'local'
    assert found.optimality.starts >= 1
    assert found.optimality.minima[0] == found.objective


def test_a_similar_robot_is_not_taken_for_the_two_wheeled():
    """A term that vanishes at some points counts; a parameter with the value 1 does not."""
    zero = '(theta - 0.7)*(theta + 1.9)*(theta - 2.6)'
    other = problems.build(
        ROBOT, dynamics=ROBOT['dynamics'] | {'py': f'sin(theta)*v + 0.1*{zero}'})
    assert solve(other, method='reeds_shepp').status is Status.NOT_CONVERGED
    same = problems.build(
        ROBOT, parameters={'k': 1}, dynamics=ROBOT['dynamics'] | {'theta': 'k*omega'})
    assert solve(same, method='reeds_shepp').status is Status.SOLVED


def test_the_lower_of_two_aircraft_minima_is_returned():
    """Example 2.5 in 5 s: both 1.0832 and 1.2271 are costs of extremals."""
    cache = Cache()
    first, again = (solve(problems.build('aircraft_5'), cache=cache) for _ in range(2))
    for found in (first, again):
        known = found.optimality
        assert known.kind == 'local'
        assert known.starts >= 2
        assert known.minima[0] == pytest.approx(found.objective, rel=1e-6)
        assert known.minima[:2] == pytest.approx((1.0832, 1.2271), rel=5e-3)
        assert f'{len(known.minima)} local minima' in known.reason


def test_minima_are_listed_in_order_without_duplicates():
    # Distinct: 1, 2, 5 and 10 to 39; 1 is the cost of the solution, so that 0.5 does not count.
    costs = [5.0, 2.0, 1.0004, 2.0004, *np.arange(10.0, 40.0), 0.5]
    found = describe_local(50, 1.0, costs)
    assert found.minima[:3] == (1.0, 2.0, 5.0)
    assert len(found.minima) == MOST_MINIMA
    assert found.reason == 'the cheapest of 33 local minima found from 50 initial guesses'
    assert describe_local(
        1, -3.0, []).reason == 'the only local minimum found from 1 initial guess'


def test_an_uncertified_solution_has_no_optimality():
    assert add_optimality(problems.build(BLOCK), Solution(
        Status.NOT_CONVERGED, '', 1.0, optimality=describe_local(3, 1.0, []))).optimality is None
