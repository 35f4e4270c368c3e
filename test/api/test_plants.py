# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Systems of the public interface, and their way to python-control and back."""

import math

import casadi as ca
import control
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import obc_ros as obc
from obc_ros.api.plants import SystemNames
from obc_ros.core.text.errors import DynamicsError, StatementError
import pytest

PENDULUM = {'name': 'pendulum', 'states': ['q', 'w'], 'inputs': ['tau'],
            'parameters': {'g': 9.81, 'l': 2}, 'dynamics': {'q': 'w', 'w': '-g/l*sin(q) + tau'},
            'input_bounds': {'tau': [-6, 6]}}
WAYS = [
    lambda: obc.System(**PENDULUM), lambda: obc.System.from_dict(PENDULUM),
    lambda: obc.System(**PENDULUM | {'dynamics': lambda x, u, p: {
        'q': x.w, 'w': -p.g / p.l * ca.sin(x.q) + u.tau}}),
    lambda: obc.System.from_control(obc.System(**PENDULUM).to_control()),
    lambda: obc.System.from_control(control.NonlinearIOSystem(
        lambda t, x, u, p: [x[1], -9.81/2*np.sin(x[0]) + u[0]], None, name='pendulum',
        states=['q', 'w'], inputs=['tau'], outputs=2)),
    lambda: obc.System.from_control(control.NonlinearIOSystem(
        lambda t, x, u, p: np.array([x[1], -9.81/2*math.sin(x[0]) + u[0]]), None, name='pendulum',
        states=['q', 'w'], inputs=['tau'], outputs=2))]


@pytest.mark.parametrize('way', WAYS, ids=['keywords', 'mapping', 'function', 'ours', 'symbols',
                                           'numbers'])
@settings(max_examples=10, deadline=None)
@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-5, 5))
def test_every_way_states_the_same_system(way, q, w, tau):
    system = way()
    assert (system.name, system.states, system.inputs) == ('pendulum', ('q', 'w'), ('tau',))
    np.testing.assert_allclose(system.f([q, w], [tau]), [w, -9.81/2*math.sin(q) + tau], rtol=1e-12,
                               atol=1e-12)


@pytest.mark.filterwarnings('error')
def test_a_function_of_numpy_becomes_symbolic():
    system = WAYS[4]()
    A, B = system.linearize([0, 0])
    np.testing.assert_allclose(A, [[0, 1], [-9.81/2, 0]])
    np.testing.assert_allclose(B, [[0], [1]])


def test_a_function_of_numbers_can_only_be_simulated():
    system = WAYS[5]()
    with pytest.raises(DynamicsError, match='does not accept CasADi symbols'):
        system.linearize()
    assert system.parameters == {}


def test_parameters_go_to_python_control():
    system = obc.System(**PENDULUM).with_parameters(l=1)
    assert system.parameters == {'g': 9.81, 'l': 1}
    other = system.to_control()
    assert (other.state_labels, other.input_labels) == (['q', 'w'], ['tau'])
    assert other.params == {'g': 9.81, 'l': 1}
    np.testing.assert_allclose(other.dynamics(0, [1, 0], [0]), [0, -9.81*math.sin(1)])
    other.params['l'] = 2
    np.testing.assert_allclose(other.dynamics(0, [1, 0], [0]), [0, -9.81/2*math.sin(1)])
    linear = other.linearize([0, 0], [0])
    np.testing.assert_allclose(linear.A, [[0, 1], [-9.81/2, 0]], atol=1e-5)


def test_a_state_space_goes_there_and_back():
    space = control.ss([[0, 1], [-2, -3]], [[0], [1]], np.eye(2), 0)
    system = obc.System.from_control(space)
    assert (system.states, system.inputs) == (('x1', 'x2'), ('u1',))
    for matrix, expected in zip(system.linearize(), (space.A, space.B), strict=True):
        np.testing.assert_allclose(matrix, expected)


def test_registered_systems_are_found_by_name():
    assert isinstance(obc.systems, SystemNames)
    assert {'aircraft', 'vehicle', 'linear'} <= set(obc.systems)
    assert obc.systems()['aircraft'] == obc.systems['aircraft'].model.description != ''
    assert 'aircraft' in repr(obc.systems)
    assert 'nonsense' not in obc.systems
    assert obc.System.from_name('vehicle', l=3).parameters == {'l': 3}
    assert obc.System.from_name('linear', A=np.eye(2), B=[[0], [1]]).states == ('x1', 'x2')
    with pytest.raises(KeyError, match='there are aircraft'):
        obc.systems['nonsense']


def test_an_equilibrium_holds_the_system():
    at = obc.equilibrium(obc.System(**PENDULUM), [math.pi / 2, 0])
    np.testing.assert_allclose(at.u, [9.81 / 2])
    with pytest.raises(DynamicsError, match='tau is limited'):
        obc.equilibrium(obc.System(**PENDULUM | {'input_bounds': {'tau': [-1, 1]}}), [1.5, 0])


def test_a_system_is_read_from_a_file(tmp_path):
    file = tmp_path / 'lag.yaml'
    file.write_text('{states: [y], inputs: [u], dynamics: {y: u - y}}')
    system = obc.System.from_file(file)
    assert repr(system) == '<System lag: states y; inputs u>'


@pytest.mark.parametrize(('call', 'said'), [
    (lambda: obc.System(**PENDULUM | {'states': ['q']}), "^dynamics: 'w' is not one of q"),
    (lambda: obc.System(**PENDULUM | {'dynamics': lambda x, u: [x.w]}),
     '^dynamics: the function returned 1 expressions for 2 states'),
    (lambda: obc.System(**PENDULUM | {'dynamic': {}}), '^dynamic: unknown key'),
    (lambda: obc.System(**PENDULUM | {'dynamics': {'q': 'w'}}), '^dynamics: no equation'),
    (lambda: obc.System.from_dict(3), '^system: wanted a mapping'),
    (lambda: obc.System.from_control(3), '^from_control: wanted a StateSpace'),
    (lambda: obc.System.from_control(control.ss(0, 1, 1, 0, True)), 'is in discrete time'),
    (lambda: obc.System.from_control(control.ss([], [], [], 1)), 'has no'),
    (lambda: obc.System.from_control(control.NonlinearIOSystem(
        lambda t, x, u, p: [u[0] + math.sin(t)], None, inputs=1, states=1, name='tide')),
     '^from_control: dx/dt of tide depends on the time'),
    (lambda: obc.System.from_name('aircrft'), "unknown system 'aircrft'"),
    (lambda: obc.System(**PENDULUM).with_parameters(x=1), "no parameter 'x'"),
    (lambda: obc.equilibrium('aircrft'), "unknown system 'aircrft'"),
    (lambda: obc.equilibrium(['aircraft']), '^system: wanted a System, a name, a file'),
])
def test_a_malformed_system_is_an_error_in_words(call, said):
    with pytest.raises((StatementError, DynamicsError), match=said):
        call()
