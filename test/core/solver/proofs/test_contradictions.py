# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Contradictions in a statement: detection, messages, no false positives."""

import math
import re

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.proofs.contradictions import explain_contradiction
from obc_ros.core.solver.proofs.invariants import find_changed_invariants
from obc_ros.core.solver.solve import solve
import problems
import pytest
from scipy.integrate import solve_ivp

BLOCK = problems.DOUBLE_INTEGRATOR | {
    'input_bounds': {'u': [-1, 1]}, 'final_time': {'free': False, 'value': 2}}
TIMED = BLOCK | {'final_time': {'free': True, 'lower': 0.1, 'upper': 5}}
# z is an uncontrollable mode at +1.
SPLIT = BLOCK | {
    'states': ['x', 'z'], 'dynamics': {'x': 'u', 'z': 'z'}, 'initial_state': {'x': 0, 'z': 1}}


def clash(base=BLOCK, **changes):
    """Return the message about a problem with some keys replaced."""
    return explain_contradiction(problems.build(base, **changes))


@pytest.mark.parametrize('name', problems.NAMES)
def test_problems_with_a_solution_have_no_contradiction(name):
    assert explain_contradiction(problems.build(name)) == ''


@pytest.mark.parametrize(('changes', 'sentence'), [
    ({'initial_state': {'x': 12, 'v': 0}, 'state_bounds': {'x': [None, 10]}},
     'initial state x = 12 and state bound x <= 10 exclude each other'),
    ({'state_bounds': {'v': [0.5, None]}},
     'initial state v = 0 and state bound v >= 0.5 exclude each other'),
    ({'path_constraints': [{'expr': 'x**2 + v', 'lower': 0.25, 'upper': None}]},
     'path_constraints[0] is 0 at the initial state but must be >= 0.25'),
    ({'path_constraints': [{'expr': '2*u + x', 'lower': None, 'upper': 9},
                           {'expr': '2*u + x', 'lower': 3, 'upper': None}]},
     'path_constraints[1] is at most 2 at the initial state but must be >= 3'),
    ({'path_constraints': [{'expr': '2*u + x', 'lower': None, 'upper': -3}]},
     'path_constraints[0] is at least -2 at the initial state but must be <= -3'),
])
def test_contradictions_at_the_initial_state(changes, sentence):
    assert clash(**changes) == sentence


@pytest.mark.parametrize(('changes', 'sentence'), [
    ({'terminal_constraints': ['x - 1', 'v - 2'], 'state_bounds': {'v': [None, 1]}},
     'state bound v <= 1 and terminal constraint v = 2 exclude each other'),
    ({'terminal_constraints': ['2*v + 3'], 'state_bounds': {'v': [-1, 1]}},
     'state bound v >= -1 and terminal constraint v = -1.5 exclude each other'),
    ({'terminal_constraints': ['x + 2*v - 9'], 'state_bounds': {'x': [0, 2], 'v': [0, 3]}},
     'state bounds x <= 2, v <= 3 and terminal constraint x + 2*v = 9 exclude each other'),
    ({'terminal_constraints': ['x - 1', 'x - 2']},
     'terminal constraints x = 1 and x = 2 exclude each other'),
    ({'terminal_constraints': ['x - 1', 'v', 'x + v - 3']},
     'terminal constraints x = 1, v = 0 and x + v = 3 exclude each other'),
    ({'terminal_constraints': ['x - v', 'x + v - 4'], 'state_bounds': {'v': [None, 1]}},
     'state bounds v <= 1 and terminal constraints x - v = 0, x + v = 4 exclude each other'),
    ({'path_constraints': [{'expr': 'x**2 + v**2', 'lower': None, 'upper': 0.5}]},
     'path_constraints[0] is 1 at the state that the terminal constraints demand but must be '
     '<= 0.5'),
])
def test_contradictions_of_the_terminal_constraints(changes, sentence):
    assert clash(**changes) == sentence


def test_redundant_terminal_constraints_are_no_contradiction():
    assert clash(terminal_constraints=['x - 1', 'v', 'x + v - 1', '2*x - 2']) == ''


def test_an_uncontrolled_state_misses_its_terminal_value():
    e = f'{math.exp(2):.6g}'
    assert clash(SPLIT, terminal_constraints=['z']) == (
        f'no input acts on z: at T = 2 it is {e}, and the terminal constraint z = 0 cannot be met')
    assert clash(SPLIT, terminal_constraints=['x - 1', f'z - {math.exp(2)!r}']) == ''
    assert clash(SPLIT, terminal_constraints=['z**2 - 1']) == (
        f'no input acts on z: at T = 2 it is {e}, and the terminal constraint '
        'terminal_constraints[0] cannot be met')
    assert clash(SPLIT, terminal_constraints=['x'], state_bounds={'z': [None, 2]}).startswith(
        'no input acts on z: it violates state bound z <= 2 by t = ')


def test_an_uncontrolled_state_with_a_free_final_time():
    free = {'final_time': TIMED['final_time']}
    assert clash(SPLIT, terminal_constraints=['z - 0.5'], **free) == (
        'no input acts on z: z = 0.5 holds at no T from 0.1 to 5')
    assert clash(SPLIT, terminal_constraints=['z - 7'], **free) == ''
    assert clash(SPLIT, terminal_constraints=['x'], state_bounds={'z': [None, 2]}, **free) == ''


def test_an_uncontrolled_nonlinear_state():
    # x = tan(t) solves x' = 1 + x^2.
    curved = BLOCK | {'dynamics': {'x': '1 + x**2', 'v': 'u*x'},
                      'final_time': {'free': False, 'value': 1}}
    assert clash(curved, terminal_constraints=['x - 2']) == (
        f'no input acts on x: at T = 1 it is {math.tan(1):.6g}, and the terminal constraint '
        'x = 2 cannot be met')


def test_an_uncontrollable_mode_misses_its_terminal_value():
    # x - y grows as e^t for every u; u acts on x + y.
    twins = BLOCK | {'states': ['x', 'y'], 'dynamics': {'x': 'x + u', 'y': 'y + u'},
                     'initial_state': {'x': 1, 'y': 0}}
    assert clash(twins, terminal_constraints=['x', 'y']) == (
        'no input acts on the mode at +1 of A: at T = 2 the terminal constraint '
        f'x = 0 with y = 0 is missed by {math.exp(2)/math.sqrt(2):.6g}')
    assert clash(twins, terminal_constraints=['x - 2']) == ''
    assert clash(twins, terminal_constraints=['x']) == (
        'x cannot fall below 1 but must be 0 at T: the unstable mode of eigenvalue 1 grows '
        'faster than the inputs can counteract')
    assert clash(twins, terminal_constraints=['x', 'y'],
                 initial_state={'x': 0.5, 'y': 0.5}) == ''
    assert clash(twins, terminal_constraints=['x', 'y'], final_time=TIMED['final_time']) == (
        'no input acts on the mode at +1 of A: x = 0 with y = 0 holds at no T from 0.1 '
        'to 5')


def test_inputs_fixed_by_their_bounds_are_known():
    assert clash(BLOCK, input_bounds={'u': [0, 0]}, terminal_constraints=['x - 1']) == (
        'no input that can vary acts on x: at T = 2 it is 0, and the terminal constraint x = 1 '
        'cannot be met')
    assert clash(BLOCK, input_bounds={'u': [1, 1]}, terminal_constraints=['x - 2']) == ''


def test_a_nonlinear_constraint_that_the_others_contradict():
    assert clash(BLOCK, terminal_constraints=['x**2 - 1', 'x - 3']) == (
        'terminal_constraints[0] is 8 and not 0 where the other terminal constraints hold '
        '(x = 3)')
    assert clash(BLOCK, terminal_constraints=['x**2 - 1', 'x - 1']) == ''


@pytest.mark.parametrize('path, sentence', [
    ({'expr': 'abs(x - 0.5)', 'lower': 0.2},
     'path_constraints[0] is 0 at x = 0.5 but must be >= 0.2, and x must pass this value on its '
     'way from 0 to 1'),
    ({'expr': 'abs(x - 0.5) + v', 'lower': 0.2}, ''),
    ({'expr': 'abs(x - 2)', 'lower': 0.2}, '')])
def test_a_path_constraint_that_blocks_every_path(path, sentence):
    assert clash(BLOCK, terminal_constraints=['x - 1'], path_constraints=[path]) == sentence


def test_too_short_a_time_for_a_linear_system():
    short = {'final_time': {'free': False, 'value': 1.5}, 'terminal_constraints': ['x - 1', 'v']}
    words = 'the terminal constraints cannot be met by T = 1.5: the minimum time is 2'
    assert clash(BLOCK, **short) == words
    # State bounds and a further constraint can only increase the minimum time.
    qualified = f'{words}, without regard to the other constraints'
    assert clash(BLOCK, **short, state_bounds={'v': [-2, 2]}) == qualified
    assert clash(BLOCK, **short | {
        'terminal_constraints': ['x - 1', 'v', 'x**2 + v - 1']}) == qualified


VEHICLE = {
    'system': 'vehicle', 'initial_state': {'px': 0, 'py': 0, 'theta': 0}, 'running_cost': 'phi**2',
    'terminal_constraints': ['px - 20', 'py'], 'input_bounds': {'v': [0, 5], 'phi': [-0.5, 0.5]},
    'final_time': {'free': False, 'value': 3}}


def test_a_goal_too_far_for_a_vehicle():
    assert clash(VEHICLE) == (
        'the terminal constraint px = 20 cannot be met by T = 3 (px stays between -15 and '
        '15): it is missed by at least 5')
    assert clash(VEHICLE, final_time={'free': False, 'value': 4.001}) == ''


def test_a_terminal_constraint_that_holds_nowhere():
    assert 'missed by at least 1' in clash(BLOCK, terminal_constraints=['x**2 + v**2 + 1'])
    assert clash(BLOCK, terminal_constraints=['x**2 + v**2 - 1']) == ''


def test_time_as_a_state_is_no_contradiction():
    clock = BLOCK | {'states': ['x', 't'], 'dynamics': {'x': 'u', 't': '1'},
                     'initial_state': {'x': 0, 't': 0}, 'terminal_constraints': ['x - 1']}
    assert clash(clock) == ''
    assert clash(clock, terminal_constraints=['t - 2']) == ''
    assert clash(clock, terminal_constraints=['t - 3']).startswith('no input acts on t: at T = 2')


def simulated(kind, chance):
    """Return a problem that a random input solves, with state bounds close to its path."""
    T, waves = float(chance.uniform(0.5, 6)), chance.normal(size=(2, 4))

    def u(t):
        return np.clip(waves @ np.cos(np.arange(4) * math.pi * t / T), -1, 1)

    n = 3 if kind == 'vehicle' else int(chance.integers(2, 5)) if kind == 'linear' else 2
    A, b, x0 = chance.normal(size=(n, n)), chance.normal(size=n), chance.normal(size=n)
    names = [f'x{i}' for i in range(n)]
    f, dynamics = {
        'linear': (lambda t, x: A @ x + b * u(t)[0], [
            '+'.join(f'({float(a)!r})*x{j}' for j, a in enumerate(row)) + f'+({float(c)!r})*u'
            for row, c in zip(A, b, strict=True)]),
        'vehicle': (lambda t, x: np.array([abs(u(t)[0]) * np.cos(x[2]),
                                           abs(u(t)[0]) * np.sin(x[2]), u(t)[1]]),
                    ['u*cos(x2)', 'u*sin(x2)', 'w']),
        'pendulum': (lambda t, x: np.array([x[1], -np.sin(x[0]) + u(t)[0]]), ['x1', '-sin(x0)+u']),
    }[kind]
    path = solve_ivp(f, (0, T), x0, rtol=1e-10, atol=1e-12, max_step=T / 100).y
    width = 1e-6 + 0.01 * (path.max(axis=1) - path.min(axis=1))
    limits = np.column_stack([path.min(axis=1) - width, path.max(axis=1) + width])
    bounds = {name: each.tolist() for name, each in zip(names, limits, strict=True)}
    vehicle = kind == 'vehicle'
    return {
        'states': names, 'inputs': ['u', 'w'] if vehicle else ['u'],
        'dynamics': dict(zip(names, dynamics, strict=True)), 'running_cost': 'u**2',
        'initial_state': dict(zip(names, x0.tolist(), strict=True)),
        'terminal_constraints': [f'{name} - ({value!r})' for name, value in zip(
            names, path[:, -1].tolist(), strict=True)],
        'input_bounds': {'u': [0 if vehicle else -1, 1]} | ({'w': [-1, 1]} if vehicle else {}),
        'state_bounds': {name: bounds[name] for name in names if chance.random() < 0.5},
        'final_time': {'free': False, 'value': T}}


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['linear', 'vehicle', 'pendulum'])
def test_problems_with_a_simulated_path_have_no_contradiction(kind):
    chance = np.random.default_rng(5)
    for _ in range(12):
        stated = simulated(kind, chance)
        assert clash(stated) == ''
        assert clash(stated, final_time={
            'free': True, 'lower': 0, 'upper': 1.01 * stated['final_time']['value']}) == ''


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 4), st.floats(1.01, 3))
def test_a_terminal_value_that_changes_an_invariant(seed, n, stretch):
    # x' = (S0 + u S1) x with skew S0, S1 preserves |x|; with a diagonal part it does not.
    rng = np.random.default_rng(seed)
    names = [f'x{i}' for i in range(n)]
    skew = [M - M.T for M in rng.normal(size=(2, n, n))]
    x0, end = rng.normal(size=(2, n))
    end *= np.linalg.norm(x0) / np.linalg.norm(end)

    def sentence(end, growth=0.0):
        rate = {name: ' + '.join(
            f'({float(skew[0][i, j] + growth * (i == j == 0))} + ({skew[1][i, j]})*u)*{other}'
            for j, other in enumerate(names)) for i, name in enumerate(names)}
        return clash(states=names, dynamics=rate, initial_state=dict(zip(
            names, x0.tolist(), strict=True)), terminal_constraints=[
                f'{name} - ({value!r})' for name, value in zip(
                    names, end.tolist(), strict=True)], input_bounds={})

    assert sentence(end) == ''
    assert sentence(stretch * end, growth=1.0) == ''
    text, = re.findall(r'constant for all inputs: it is (\S+) at the initial state and '
                       r'(\S+) where', sentence(stretch * end))
    assert float(text[1]) == pytest.approx(stretch**2 * float(text[0]), rel=1e-6)


@pytest.mark.parametrize(('ends', 'sentence'), [
    (['S - 0.5', 'I - 0.02', 'R - 0.48'], ''),
    (['S - 0.5', 'R - 0.6'], ''),   # not detected here: I takes the difference
    (['S + R - 1.2', 'I - 0.02'],
     'S + I + R is constant for all inputs: it is 1 at the initial state and 1.22 where '
     'the terminal constraints hold'),
])
def test_a_closed_population_is_conserved(ends, sentence):
    assert clash(
        states=['S', 'I', 'R'], initial_state={'S': 0.9, 'I': 0.1, 'R': 0},
        dynamics={'S': '-S*I/2 - u*S', 'I': 'S*I/2 - I/5', 'R': 'I/5 + u*S'},
        terminal_constraints=ends) == sentence


DESCENT = {
    'states': ['z', 'v'], 'inputs': ['a'], 'dynamics': {'z': 'v', 'v': 'a - 10'},
    'running_cost': 'a**2', 'initial_state': {'z': 4, 'v': -1},
    'terminal_constraints': ['z', 'v'], 'input_bounds': {'a': [5, 15]},
    'final_time': {'free': True, 'lower': 0.1, 'upper': 10}}


def test_offset_input_bounds_give_no_false_invariant():
    """10 z + v^2 is constant for a = 5 but not for other inputs."""
    assert clash(DESCENT) == ''
    found = solve(problems.build(DESCENT))
    assert found.status is Status.SOLVED, found.message


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(st.floats(1, 1e4), st.floats(1e-3, 10), st.sampled_from((-1.0, 1.0)), st.floats(0.1, 20))
def test_one_sided_input_bounds_give_no_false_invariant(near, width, side, drift):
    bounds = sorted([side * near, side * (near + width)])
    problem = problems.build(
        DESCENT, dynamics={'z': 'v', 'v': f'a + {drift!r}'}, input_bounds={'a': bounds})
    assert list(find_changed_invariants(problem)) == []
    problem = problems.build(
        DESCENT, dynamics={'z': 'a*v', 'v': f'a*v + {drift!r}'}, input_bounds={'a': bounds})
    assert list(find_changed_invariants(problem)) == []


@pytest.mark.parametrize(('dynamics', 'end', 'quantity'), [
    # The bounds fix the input, so that a constant for this input is an invariant.
    ({'x': 'v', 'v': 'u - 10'}, ['x', 'v'], '10*x + v**2'),
    ({'x': '-0.3*x*u + 0.1*v', 'v': '0.3*u*x - 0.1*v'}, ['x', 'v - 3'], 'x + v'),
    ({'x': 'u*sin(v)**2', 'v': '-u*(1 - cos(v)**2)'}, ['x', 'v - 3'], 'x + v'),
    ({'x': 'u*v/(1 + x**2)', 'v': '-x*u/(1 + x**2)'}, ['x', 'v - 3'], 'x**2 + v**2'),
    ({'x': 'u', 'v': 'u/x*(1 - v)'}, ['x - 2', 'v - 3'], 'x*v'),
    # Undefined at the bound u = 0, and at no input inside.
    ({'x': 'v/u', 'v': '-x/u'}, ['x - 5', 'v'], 'x**2 + v**2'),
    ({'x': 'u*sqrt(1 + v)', 'v': '-2*u*sqrt(1 + v)*(1 + v)/(1 + v)'}, ['x', 'v - 3'], 'x + v'),
])
def test_invariants_are_proved_by_identities(dynamics, end, quantity):
    bounds = {'u': [5, 5] if quantity.startswith('10') else [0, 1]}
    found = list(find_changed_invariants(problems.build(
        BLOCK, dynamics=dynamics, initial_state={'x': 1, 'v': 0.5}, terminal_constraints=end,
        input_bounds=bounds)))
    assert found
    assert all('is constant for all inputs' in each for each in found)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.floats(1e-9, 1e-3))
def test_nearly_constant_quantities_are_not_called_constant(seed, drift):
    rng = np.random.default_rng(seed)
    s, r, d = rng.normal(size=3).tolist()
    assert list(find_changed_invariants(problems.build(
        BLOCK, dynamics={'x': f'({s!r})*v*u + ({drift!r})*u*x', 'v': f'-({s!r})*x*u'},
        initial_state={'x': r, 'v': d}, terminal_constraints=[f'x - {2*abs(r) + 1}', 'v']))) == []


def test_an_invariant_excludes_a_point_but_no_crossing_line():
    """Lines that cross the circle x^2 + v^2 = 1 have a feasible end; x = v = 1 is none."""
    turn = {'dynamics': {'x': 'u*v', 'v': '-u*x'}, 'initial_state': {'x': 1, 'v': 0}}
    for end in (['x - v'], ['x + v - 1'], ['0.1*x + 0.2*v - 0.1', 'x + 2*v - 1'], ['x**2 - v']):
        assert list(find_changed_invariants(problems.build(
            BLOCK | turn, terminal_constraints=end))) == []
    [found] = find_changed_invariants(problems.build(
        BLOCK | turn, terminal_constraints=['x - v', 'x + v - 2', 'x**3 - 1']))
    assert found.startswith('x**2 + v**2 is constant for all inputs: it is 1 at the '
                            'initial state and 2 where')


@pytest.mark.parametrize('missed, proved', [(1e-9, False), (4e-7, False), (4e-6, True)])
@pytest.mark.parametrize('key', ['state_bounds', 'path_constraints'])
def test_what_a_certificate_counts_as_met_is_no_contradiction(key, missed, proved):
    """The margin is relative to 1 + |x(0)| = 2: a miss of 4e-7 is below it, of 4e-6 above."""
    bound = 1 - missed
    changed = {'x': [None, bound]} if key == 'state_bounds' else [{'expr': 'x', 'upper': bound}]
    problem = problems.pose({'x': 'u'}, 'u**2 + x', [1], 1, **{key: changed})
    assert bool(explain_contradiction(problem)) == proved


@pytest.mark.parametrize('missed, proved', [(3e-7, False), (1e-5, True)])
def test_terminal_constraints_that_a_certificate_counts_as_met_do_not_clash(missed, proved):
    """Half of the gap is within 1e-6 of x, whose size is x(0) = 2."""
    assert bool(explain_contradiction(problems.pose(
        {'x': 'u'}, 'u**2', [2], 1, terminal_constraints=['2*x', f'x - {missed}']))) == proved
