# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Simulations, motions, paths and minima of the public interface against closed forms."""


import math

import control
import numpy as np
import obc_ros as obc
from obc_ros.core.text.errors import ObcError, StatementError
import pytest

MASS = obc.System(states=['p', 'v'], inputs=['F'], dynamics={'p': 'v', 'v': 'F'},
                  input_bounds={'F': [-2, 2]})
T = np.linspace(0, 3, 31)
LEAST_TIME = {
    'states': ['p', 'v'], 'inputs': ['u'], 'dynamics': {'p': 'v', 'v': 'u'}, 'running_cost': 1,
    'initial_state': {'p': 1, 'v': 0}, 'terminal_constraints': ['p', 'v'],
    'input_bounds': {'u': [-1, 1]}, 'final_time': {'free': True, 'lower': 0.1, 'upper': 20}}


@pytest.mark.parametrize('law', [[1.0], np.ones((31, 1)), lambda t, x: 1.0, lambda t, x: [1],
                                 lambda t, x: {'F': 1}, {'F': 1},
                                 {'F': np.ones(31)}],
                         ids=['constant', 'samples', 'number', 'list', 'mapping', 'name',
                              'named samples'])
def test_a_constant_force_gives_a_parabola(law):
    found = obc.simulate(MASS, law, [1, -1], T)
    np.testing.assert_allclose(found.x['p'], 1 - T + T**2/2, atol=1e-8)
    np.testing.assert_allclose(found.x['v'], T - 1, atol=1e-8)
    np.testing.assert_array_equal(found.u['F'], 1.0)
    assert repr(found) == '<Simulation of system: 31 times to 3 s>'


def test_inputs_are_linear_between_samples_and_within_their_limits():
    t = np.array([0.0, 1.0, 3.0])
    found = obc.simulate(MASS, [[0], [1], [5]], [0, 0], t)
    assert found.u['F'].tolist() == [0, 1, 2]
    # F = t until 1, then 1 + 2 (t - 1), cut at 2 from t = 1.5 on.
    assert found.x['v'] == pytest.approx([0, 0.5, 0.5 + 0.75 + 3], abs=1e-7)


def test_the_inputs_of_an_answer_lead_to_its_end():
    answer = obc.solve(LEAST_TIME)
    mass = obc.System(states=['p', 'v'], inputs=['u'], dynamics={'p': 'v', 'v': 'u'})
    t = np.linspace(0, 2, 9)
    found = obc.simulate(mass, answer, [1, 0], t)
    np.testing.assert_allclose(found.x['p'], answer.at(t).x['p'], atol=1e-8)
    np.testing.assert_array_equal(found.u['u'][:-1], [-1, -1, -1, -1, 1, 1, 1, 1])


def test_a_regulator_follows_the_closed_loop_of_python_control():
    design = obc.lqr(MASS, [1, 1], [1])
    found = obc.simulate(MASS, design, [1, 0], T)
    free = control.initial_response(design.to_control(), T, [1, 0])
    np.testing.assert_allclose(found.state_rows.T, free.states, atol=1e-7)
    np.testing.assert_allclose(found.u['F'], free.outputs[2], atol=1e-7)


def test_a_sampled_regulator_holds_its_input():
    design = obc.dlqr(MASS, [1, 1], [1], period=0.25)
    t = np.linspace(0, 3, 25)   # two for each period
    found = obc.simulate(MASS, design, [1, 0], t)
    np.testing.assert_array_equal(found.u['F'][:-1:2], found.u['F'][1::2])
    expected = [np.array([1.0, 0.0])]
    for _ in range(12):
        expected.append((design.A - design.B @ design.K) @ expected[-1])
    np.testing.assert_allclose(found.state_rows[::2], expected, atol=1e-8)


def test_a_nonlinear_system_of_python_control_is_simulated_as_there():
    other = control.NonlinearIOSystem(
        lambda t, x, u, p: np.array([x[1], -math.sin(x[0]) + u[0]]), None, states=['q', 'w'],
        inputs=['tau'], outputs=2)
    found = obc.simulate(obc.System.from_control(other), [0.1], [1, 0], T)
    theirs = control.input_output_response(other, T, 0.1 + 0*T, [1, 0],
                                           solve_ivp_kwargs={'rtol': 1e-9, 'atol': 1e-12})
    np.testing.assert_allclose(found.state_rows.T, theirs.states, atol=1e-6)


@pytest.mark.slow
def test_a_simulation_is_drawn():
    figure = obc.simulate(MASS, [1.0], [0, 0], T).plot()
    assert [axes.get_ylabel() for axes in figure.axes] == ['states', 'inputs']


@pytest.mark.parametrize(('change', 'said'), [
    ({'law': 'full speed'}, '^law: wanted a function'), ({'law': [1, 2]}, '^law: wanted a func'),
    ({'law': [np.nan]}, '^law: wanted a func'), ({'law': lambda t, x: [1, 2]}, '^law: wanted 1 n'),
    ({'law': lambda t, x: 'a'}, "^law: wanted 1 numbers .* at t = 0 s, found str 'a'"),
    ({'law': lambda t, x: None}, '^law: wanted 1 numbers .* found nothing'),
    ({'law': lambda t, x: {'u': 1}}, "^law at t = 0 s: wanted numbers for F, .* found 'u'"),
    ({'law': lambda t, x: {'F': 'full'}}, '^law at t = 0 s: wanted numbers for F'),
    ({'law': lambda x: 0.0}, r'^law: wanted a function of \(t, x\)'),
    ({'law': lambda t, x, p: 0.0}, r'^law: wanted a function of \(t, x\)'),
    ({'t': ['a', 'b']}, '^t: wanted at least two'), ({'t': 'ab'}, '^t: wanted at least two'),
    ({'t': [[0], [1, 2]]}, '^t: wanted at least two'), ({'t': ['0', '1']}, '^t: wanted at least'),
    ({'law': lambda t, x: np.nan}, '^law: wanted 1 numbers for the inputs at t = 0 s'),
    ({'x0': [1]}, '^x0: wanted numbers for p, v'), ({'x0': [1, np.inf]}, '^x0: v = inf'),
    ({'t': [0]}, '^t: wanted at least two'), ({'t': [1, 0]}, '^t: wanted'),
    ({'t': 3}, '^t: wanted'), ({'system': 3}, '^system: wanted a System'),
    ({'law': obc.lqr([[0]], [[1]], [1], [1])}, '^law: of 1 states and 1 inputs'),
    ({'law': {'G': 1}}, '^law: wanted values of F, found G'),
    ({'law': {'F': 'full'}}, '^law: wanted numbers'),
    ({'law': obc.lqr(obc.System(states=['v', 'p'], inputs=['F'], dynamics={'v': 'F', 'p': 'v'}),
                     1, 1)}, '^law: its states are v, p, in another order than p, v'),
    ({'law': obc.lqr([[0]], [[1]], [1], [1]), 'system': 'mass'}, "^unknown system 'mass'"),
])
def test_a_malformed_simulation_is_an_error_in_words(change, said):
    arguments = {'system': MASS, 'law': [0.0], 'x0': [0, 0], 't': T} | change
    with pytest.raises(ObcError, match=said):
        obc.simulate(**arguments)


def test_an_error_of_a_law_is_raised_as_it_is():
    def law(t, x):
        return x + 'v'
    with pytest.raises(TypeError, match=r'^(?!law)'):
        obc.simulate(MASS, law, [0, 0], T)


def test_a_state_that_grows_without_bound_is_an_error():
    blow = obc.System(states=['x'], inputs=['u'], dynamics={'x': 'x**2 + u'})
    with pytest.raises(ObcError, match='the simulation ends at t = .*without bound'):
        obc.simulate(blow, [0.0], [1], [0, 2])   # x = 1 / (1 - t)


def test_a_motion_is_planned_in_least_time():
    """The double integrator from rest to rest over a distance 1 with |u| <= 1 takes 2 s."""
    answer = obc.plan('double_integrator', [0, 0], [1, 0], input_bounds={
        obc.systems['double_integrator'].inputs[0]: [-1, 1]})
    assert (answer.status, answer.objective) == ('solved', pytest.approx(2, abs=1e-8))
    with pytest.raises(StatementError, match="^time_limit: wanted a number, found str '1'"):
        obc.plan('double_integrator', [0, 0], [1, 0], time_limit='1')
    for key, value in (('final_time', '1'), ('Qx', ['1', '1']), ('Qu', '1'), ('start', ['0', 0])):
        with pytest.raises(StatementError, match=f'^{key}: wanted '):
            obc.plan('double_integrator', **{'start': [0, 0], 'goal': [1, 0], key: value})
    with pytest.raises(StatementError, match='^start: wanted'):
        obc.plan('double_integrator', [0], [1, 0])


def test_the_shortest_path_straight_ahead_is_a_line():
    path = obc.reeds_shepp((0, 0, 0), (3, 0, 0), 1)
    assert path.length == pytest.approx(3)
    with pytest.raises(StatementError, match='radius'):
        obc.reeds_shepp((0, 0, 0), (3, 0, 0), -1)


def test_a_constrained_minimum_has_its_multiplier():
    """x^2 + y^2 on x + y = 2: (1, 1) with lam = -2."""
    found = obc.minimize(variables=['x', 'y'], cost='x**2 + y**2', equalities=['x + y - 2'])
    assert found.x == pytest.approx([1, 1], abs=1e-9)
    assert found.lam == pytest.approx([-2], abs=1e-9)
    with pytest.raises(StatementError, match="^time_limit: wanted a number, found str '1'"):
        obc.minimize(variables=['x'], cost='x**2', time_limit='1')
    with pytest.raises(StatementError, match='^statement: wanted a mapping'):
        obc.minimize('x**2')
