# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Regulators of the public interface against closed forms and python-control."""

from fractions import Fraction
import inspect
from typing import get_overloads

import control
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import obc_ros as obc
from obc_ros.core.lqr.lqr import lqr
from obc_ros.core.text.errors import DynamicsError, RefusedDesignError, StatementError
import pytest

A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
SPACE = control.ss(A, B, np.eye(2), 0, states=['p', 'v'], inputs=['F'], outputs=['p', 'v'])


def test_the_double_integrator_has_the_gain_of_its_closed_form():
    """With Qx = I and Qu = 1: K = (1, sqrt 3), P = ((sqrt 3, 1), (1, sqrt 3))."""
    design = obc.lqr(A, B, [1, 1], [1])
    s = np.sqrt(3)
    np.testing.assert_allclose(design.K, [[1, s]], rtol=1e-12)
    np.testing.assert_allclose(design.P, [[s, 1], [1, s]], rtol=1e-12)
    np.testing.assert_allclose(np.poly(design.E), [1, s, 1], rtol=1e-12)
    assert (design.states, design.inputs, design.period) == (('x1', 'x2'), ('u1',), 0.0)
    assert design(0.0, [1, 0]) == pytest.approx([-1])
    assert str(design).splitlines()[-1].split() == ['u1', '1', '1.73205']


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 4), st.integers(1, 2), st.integers(0, 10_000))
def test_the_gain_is_that_of_python_control(n, m, seed):
    random = np.random.default_rng(seed)
    A, B = random.normal(size=(n, n)), random.normal(size=(n, m))
    Qx, Qu = np.diag(random.uniform(0.5, 2, n)), np.diag(random.uniform(0.5, 2, m))
    K, P, E = control.lqr(A, B, Qx, Qu)
    design = obc.lqr(control.ss(A, B, np.eye(n), 0), np.diag(Qx), Qu)
    np.testing.assert_allclose(design.K, K, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(design.P, P, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(np.sort_complex(design.E), np.sort_complex(E), rtol=1e-6, atol=1e-8)
    for loop in ('setpoint', 'disturbance'):
        np.testing.assert_allclose(np.sort_complex(design.to_control(loop).poles()),
                                   np.sort_complex(E), rtol=1e-6, atol=1e-8)


def test_a_sampled_gain_is_that_of_python_control():
    Ad, Bd = np.array([[1, 0.1], [0, 1]]), np.array([[0.005], [0.1]])
    K, P, _ = control.dlqr(Ad, Bd, np.eye(2), np.eye(1))
    for design in (obc.dlqr(Ad, Bd, np.eye(2), [1], period=0.1),
                   obc.dlqr(control.ss(Ad, Bd, np.eye(2), 0, 0.1), [1, 1], [1])):
        np.testing.assert_allclose(design.K, K, rtol=1e-9)
        np.testing.assert_allclose(design.P, P, rtol=1e-9)
        assert design.to_control().dt == design.period == 0.1


def test_a_sampled_design_of_a_continuous_plant_tends_to_that_in_continuous_time():
    design = obc.dlqr(SPACE, [1, 1], [1], period=1e-3)
    np.testing.assert_allclose(design.A, [[1, 1e-3], [0, 1]], atol=1e-15)
    np.testing.assert_allclose(design.K, [[1, np.sqrt(3)]], rtol=2e-3)


def test_names_of_a_state_space_are_those_of_the_loop():
    loop = obc.lqr(SPACE, [1, 1], [1]).to_control()
    assert loop.input_labels == ['p_set', 'v_set']
    assert (loop.state_labels, loop.output_labels) == (['p', 'v'], ['p', 'v', 'F'])


def test_a_step_of_the_set_point_is_the_closed_form():
    """P after a unit step of its set point: 1 - exp(M t) e1 with M of the closed loop."""
    design = obc.lqr(SPACE, [1, 1], [1])
    t = np.linspace(0, 8, 50)
    response = control.forced_response(design.to_control(), t, np.vstack([0*t + 1, 0*t]))
    w = 0.5   # poles -sqrt(3)/2 +- w i
    decay = np.exp(-np.sqrt(3)/2 * t)
    p = 1 - decay * (np.cos(w*t) + np.sqrt(3) * np.sin(w*t))
    np.testing.assert_allclose(response.outputs[0], p, atol=1e-9)


def test_the_open_loop_has_the_margins_of_the_design():
    design = obc.lqr(SPACE, [1, 1], [1])
    _, phase, _, _ = control.margin(design.to_control('loop'))
    assert phase == pytest.approx(np.rad2deg(design.margins.phase_margin[0]), abs=1e-3)
    assert phase > 60   # of every such regulator
    plant = design.to_control('plant')
    np.testing.assert_allclose(plant.A, A)
    np.testing.assert_allclose(plant.B, B)


def test_a_sampled_design_has_the_margins_of_its_held_input():
    """K2 h g < 2 and, from theta^2 = w^2 h^2, a delay margin of phase / crossover for small h."""
    design = obc.dlqr(SPACE, [1, 1], [1], period=0.01)
    assert design.margins.gain_margin[0] == pytest.approx(
        2 / (0.01 * design.K[0, 1]), rel=1e-9)
    assert design.margins.delay_margin[0] == pytest.approx(
        design.margins.phase_margin[0] / design.margins.bandwidth[0], rel=1e-3)
    found = obc.lqr(SPACE, [1, 1], [1]).margins
    assert found.delay_margin[0] == found.phase_margin[0] / found.bandwidth[0]


def test_a_system_is_linearised_at_a_set_point():
    """The aircraft hovers at any position with f2 = m g."""
    design = obc.lqr(obc.systems['aircraft'], np.ones(6), np.ones(2), at=[1, 2, 0, 0, 0, 0])
    np.testing.assert_allclose(design.xe, [1, 2, 0, 0, 0, 0])
    np.testing.assert_allclose(design.ue, [0, 4 * 9.8], atol=1e-9)
    assert design.inputs == ('f1', 'f2')
    np.testing.assert_allclose(design(0.0, design.xe), design.ue)


def test_a_finite_horizon_of_the_scalar_system_is_the_closed_form():
    """dx/dt = u, Qx = Qu = 1, P1 = 0: P = tanh(T - t) = K."""
    found = obc.finite_horizon([[0]], [[1]], [1], [1], [0], 2.0)
    np.testing.assert_allclose(found.P[:, 0, 0], np.tanh(2 - found.t), atol=1e-12)
    np.testing.assert_allclose(found.K[:, 0, 0], np.tanh(2 - found.t), atol=1e-12)
    assert (len(found.t), found.t[-1]) == (201, 2.0)
    few = obc.finite_horizon(control.ss(0, 1, 1, 0), [1], [1], [0], 2, t=[0, 0.5])
    np.testing.assert_allclose(few.P[:, 0, 0], np.tanh([2, 1.5]), atol=1e-12)


def test_every_way_to_call_a_design_gives_the_same_gain():
    ways = [
        lambda f, **more: f(A, B, [1, 2], [3], **more),
        lambda f, **more: f(A, B, Qx=[1, 2], Qu=3, **more),
        lambda f, **more: f(A=A, B=B, Qu=[[3]], Qx=np.diag([1, 2]), **more),
        lambda f, **more: f(SPACE, [1, 2], [3], **more),
        lambda f, **more: f(SPACE, [1, 2], Qu=[3], **more),
        lambda f, **more: f(SPACE, Qx={'v': 2, 'p': 1}, Qu={'F': 3}, **more),
        lambda f, **more: f(system=SPACE, Qx=[1, 2], Qu=[3], **more)]
    for function, more in ((obc.lqr, {}), (obc.finite_horizon, {'P1': [4, 5], 'T': 1.0})):
        for way in ways[1:]:
            np.testing.assert_array_equal(way(function, **more).K, ways[0](function, **more).K)
    for way in ways[4:]:
        np.testing.assert_array_equal(way(obc.dlqr, period=0.1).K,
                                      ways[3](obc.dlqr, period=0.1).K)
    for arguments in ((A, B, [1, 2], [3], [4, 5], 1.0), (SPACE, [1, 2], [3], [4, 5], 1.0)):
        np.testing.assert_array_equal(obc.finite_horizon(*arguments).K,
                                      ways[0](obc.finite_horizon, P1=[4, 5], T=1.0).K)


@pytest.mark.parametrize('call', [
    lambda: obc.lqr(SPACE, 2, Qu=5), lambda: obc.lqr(SPACE, Qu=5, Qx=2),
    lambda: obc.lqr(system=SPACE, Qu=5, Qx=2, B=None), lambda: obc.lqr(A, B, 2, Qu=5),
    lambda: obc.lqr(A, Qu=5, Qx=2, B=B), lambda: obc.lqr(plant_or_A=A, B=B, Qx=2, Qu=5)])
def test_a_named_weight_stays_with_its_name(call):
    np.testing.assert_array_equal(call().K, lqr(A, B, 2*np.eye(2), 5*np.eye(1)).K)


def test_named_arguments_of_a_finite_horizon_stay_with_their_names():
    """dx/dt = u: P = sqrt(Qx Qu) tanh((T - t) sqrt(Qx/Qu)) from P1 = 0, K = P/Qu."""
    line = control.ss(0, 1, 1, 0)
    for found in (obc.finite_horizon(line, 4, T=2, Qu=9, P1=0),
                  obc.finite_horizon(line, 4, 9, P1=0, T=2),
                  obc.finite_horizon([[0]], [[1]], 4, 9, T=2, P1=0)):
        np.testing.assert_allclose(found.P[:, 0, 0], 6 * np.tanh((2 - found.t) * 2/3), atol=1e-12)
        np.testing.assert_allclose(found.K, found.P / 9, atol=1e-12)


@pytest.mark.parametrize(('call', 'said'), [
    (lambda: obc.lqr(SPACE, 1, Qx=100), '^lqr: Qx is given twice, by position and by name'),
    (lambda: obc.lqr(SPACE, 1, 1, Qu=100), '^lqr: Qu is given twice'),
    (lambda: obc.lqr(A, B, 1, 1, Qx=100), '^lqr: Qx is given twice'),
    (lambda: obc.lqr(A, B, 1, 1, B=B), '^lqr: B is given twice'),
    (lambda: obc.lqr(A, B, 1, 1, plant_or_A=A), '^lqr: plant_or_A is given twice'),
    (lambda: obc.lqr(system=SPACE, B=1, Qx=100), '^lqr: B is given beside a plant; wanted A, B'),
    (lambda: obc.dlqr(SPACE, B=1, Qx=100, Qu=1, period=1), '^dlqr: B is given beside a plant'),
    (lambda: obc.lqr(SPACE, 1, 2, 3, 4), '^lqr: found 2 more arguments than wanted A, B'),
    (lambda: obc.finite_horizon(SPACE, 1, Qx=4, P1=3, T=2), '^finite_horizon: Qx is given twice'),
    (lambda: obc.finite_horizon(SPACE, 1, 1, 3, P1=2), '^finite_horizon: P1 is given twice'),
    (lambda: obc.finite_horizon(SPACE, 1, Qu=1, T=2), '^finite_horizon: P1 is missing'),
])
def test_an_argument_is_not_taken_for_another(call, said):
    with pytest.raises(StatementError, match=said):
        call()


def test_an_unknown_name_is_an_error_of_python():
    with pytest.raises(TypeError, match=r'lqr\(\).* unexpected keyword argument .Q.'):
        obc.lqr(SPACE, 1, Q=1)


def test_the_signature_of_a_design_fits_on_a_screen():
    for function in (obc.lqr, obc.dlqr, obc.finite_horizon, obc.simulate, obc.equilibrium):
        assert len(str(inspect.signature(function))) < 400, function
    for function in (obc.lqr, obc.dlqr, obc.finite_horizon):
        assert list(inspect.signature(function).parameters)[:4] == ['plant_or_A', 'B', 'Qx', 'Qu']
        assert len(get_overloads(function)) == 2


def test_a_finite_horizon_is_a_law():
    """dx/dt = u, Qx = Qu = 1, P1 = 0: K = tanh(T - t), x = cosh(T - t)/cosh(T)."""
    plant = obc.System(states=['y'], inputs=['u'], dynamics={'y': 'u'})
    law = obc.finite_horizon(plant, 1, 1, 0, 2.0, at=[3])
    for t in (0.0, 0.1234, 1.0, 1.99999, 2.0):
        assert law(t, [4]) == pytest.approx([-np.tanh(2 - t)], abs=1e-12)
        assert law.gain(t) == pytest.approx(np.tanh(2 - t), abs=1e-12)
    few = obc.finite_horizon(plant, 1, 1, 0, 2.0, t=[0.5, 1])
    assert few(1.7, {'y': 1}) == pytest.approx([-np.tanh(0.3)], abs=1e-12)
    t = np.linspace(0, 2, 9)
    found = obc.simulate(plant, law, {'y': 4}, t)
    np.testing.assert_allclose(found.x['y'], 3 + np.cosh(2 - t)/np.cosh(2), atol=1e-8)
    for outside in (-0.1, 2.1, np.nan):
        with pytest.raises(ValueError, match='wanted a time from 0 to T = 2 s'):
            law(outside, [0])
    assert repr(law).startswith('FiniteHorizonDesign: 1 states, 1 inputs; T = 2 s\n')
    assert len(repr(law).splitlines()) < 10
    with pytest.raises(StatementError, match='^law: of 1 states and 1 inputs'):
        obc.simulate(obc.System(states=['p', 'v'], inputs=['u'], dynamics={'p': 'v', 'v': 'u'}),
                     law, [0, 0], t)
    with pytest.raises(StatementError, match='^t: wanted times of the law, from 0 s to 2 s'):
        obc.simulate(plant, law, [0], [0, 3])


@pytest.mark.slow
def test_a_finite_horizon_is_drawn():
    figure = obc.finite_horizon(SPACE, [1, 1], 1, 0, 2.0).plot(show=False)
    assert {axes.get_ylabel() for axes in figure.axes} == {'K', 'P'}


def test_long_horizons_reach_the_stationary_gain():
    found = obc.finite_horizon(SPACE, [1, 1], [1], [1, 1], 40, t=[0])
    np.testing.assert_allclose(found.K[0], obc.lqr(SPACE, [1, 1], [1]).K, rtol=1e-9)


@pytest.mark.parametrize(('call', 'error', 'said'), [
    (lambda: obc.lqr(A, B, [1, 1]), StatementError,
     '^lqr: Qu is missing; wanted A, B, Qx, Qu or a plant, Qx, Qu'),
    (lambda: obc.lqr(A, B), StatementError, '^lqr: Qx is missing; wanted A, B, Qx, Qu'),
    (lambda: obc.lqr(), StatementError, '^lqr: wanted A, B, Qx, Qu or a plant, Qx, Qu'),
    (lambda: obc.lqr(A, A=A, B=B, Qx=1, Qu=1), StatementError, '^lqr: wanted A, B'),
    (lambda: obc.lqr(SPACE, B, [1, 1], [1]), StatementError, '^lqr: found one more argument than'),
    (lambda: obc.lqr(SPACE, {'p': 1}, [1]), StatementError, '^Qx: wanted numbers for p, v'),
    (lambda: obc.lqr(SPACE, {'p': '1', 'v': 1}, [1]), StatementError, '^Qx: wanted numbers for p'),
    *[(lambda Qx=Qx: obc.lqr(SPACE, Qx, [1]), StatementError, '^Qx: wanted a matrix, its diagonal')
      for Qx in ('1', ['1', 2], [['1', 0], [0, 1]], np.array(['1', None], dtype=object))],
    (lambda: obc.lqr(A, B, [1, 1], [0]), RefusedDesignError, '^Qu'),
    (lambda: obc.lqr(A, 0*B, [1, 1], [1]), RefusedDesignError,
     r'^\(A, B\) is not stabilisable: the mode s = 0 is uncontrollable'),
    (lambda: obc.lqr(A, B, [1, np.nan], [1]), StatementError, '^Qx'),
    (lambda: obc.lqr(A, B, np.eye(3), [1]), StatementError, '^Qx'),
    (lambda: obc.lqr(A, B, 'heavy', [1]), StatementError, '^Qx'),
    (lambda: obc.lqr(control.ss(A, B, np.eye(2), 0, True), [1, 1], [1]), StatementError,
     'in discrete time; use dlqr'),
    (lambda: obc.lqr(control.tf([1], [1, 1]), [1], [1]), DynamicsError,
     '^from_control: wanted a StateSpace or .*, found a TransferFunction'),
    (lambda: obc.lqr(A, B, [1, 1], [1], at=[0, 0]), StatementError, 'set point of a plant'),
    (lambda: obc.lqr(obc.systems['aircraft'], np.ones(6), np.ones(2), at=[0, 0, 1, 0, 0, 0]),
     DynamicsError, 'found no equilibrium'),
    (lambda: obc.dlqr(SPACE, [1, 1], [1]), StatementError, '^period = 0: wanted a positive'),
    (lambda: obc.dlqr(control.ss(A, B, np.eye(2), 0, 0.1), [1, 1], [1], period=0.2),
     StatementError, 'period 0.2 s, but that of the plant is 0.1 s'),
    (lambda: obc.finite_horizon(A, B, [1, 1], [1], [1, 1]), StatementError,
     '^finite_horizon: T is missing; wanted A, B, Qx, Qu, P1, T or a plant'),
    (lambda: obc.finite_horizon(A, B, [1, 1], [1], [1, 1], -1), StatementError, '^T: wanted'),
    (lambda: obc.finite_horizon(A, B, [1, 1], [1], [1, 1], 1, t=[1, 0]), StatementError, '^t: '),
    (lambda: obc.lqr(A, B, [1, 1], [1]).to_control('opened'), StatementError,
     "^loop: wanted one of setpoint, disturbance, loop, plant, found str 'opened'"),
])
def test_a_design_is_refused_in_words(call, error, said):
    with pytest.raises(error, match=said):
        call()


@pytest.mark.parametrize(('call', 'said'), [
    *[(lambda t=t: obc.finite_horizon(A, B, 1, 1, 1, 1, t=t),
       '^t: wanted increasing times from 0 s to T = 1 s')
      for t in ([-1, .5], [0.5, 1.5], 'abc', '1', ['0', '1'], 0.5, [], [[0, 1]], [0, [1]], [0, 0],
                [0, np.nan], [True], {'t': 1})],
    *[(lambda T=T: obc.finite_horizon(A, B, 1, 1, 1, T), '^T: wanted a positive number of seconds')
      for T in (True, np.True_, '1', [1], 0, np.nan, np.inf, 10**400, 1j)],
    *[(lambda f=f: f(A, B, 1, 1, stability='1'), "^stability: wanted a number, found str '1'")
      for f in (obc.lqr, obc.dlqr)],
    (lambda: obc.lqr(A, B, 1, 1, stability=None), '^stability: wanted a number, found nothing'),
    (lambda: obc.dlqr(A, B, 1, 1, period='1'), "^period: wanted a number, found str '1'"),
    (lambda: obc.dlqr(SPACE, 1, 1, period='1'), "^period: wanted a number, found str '1'"),
    *[(lambda f=f, c=c, m=m: f(SPACE, 1, 1, **m, cross=c), '^cross: ')
      for f, m in ((obc.lqr, {}), (obc.dlqr, {'period': 0.1}),
                   (obc.finite_horizon, {'P1': 1, 'T': 1}))
      for c in ('a', [[1], ['a']], [[1], [1, 2]], [1, 2])],
])
def test_a_number_of_a_design_is_refused_in_words(call, said):
    with pytest.raises(StatementError, match=said):
        call()


@pytest.mark.parametrize('t', [None, '1', [1, 2], True])
def test_the_time_of_a_law_is_refused_in_words(t):
    """Also if a time and a state are exchanged."""
    law = obc.finite_horizon(A, B, 1, 1, 1, 2)
    for call in (law.gain, lambda t: law(t, 1.0)):
        with pytest.raises(StatementError, match='^t: wanted a number, found'):
            call(t)
    with pytest.raises(StatementError, match='^x: wanted numbers for x1, x2'):
        obc.lqr(A, B, 1, 1)([1, 2], 1.0)


@pytest.mark.parametrize('number', [np.int64, np.float32, np.array, Fraction])
def test_numbers_of_numpy_are_taken(number):
    """dx/dt = u, Qx = Qu = 1, P1 = 0: K = tanh(T - t)."""
    law = obc.finite_horizon([[0]], [[1]], 1, 1, 0, number(3), t=[number(0), number(3)])
    assert (type(law.T), law.T) == (float, 3.0)
    np.testing.assert_allclose(law.K[:, 0, 0], [np.tanh(3), 0], atol=1e-12)
    assert law.gain(number(2)) == pytest.approx(np.tanh(1), abs=1e-12)
    design = obc.dlqr(SPACE, 1, 1, period=number(1), stability=number(0))
    np.testing.assert_array_equal(design.K, obc.dlqr(SPACE, 1, 1, period=1.0).K)
    assert type(design.period) is float


def test_the_html_of_a_design_is_escaped():
    space = control.ss(A, B, np.eye(2), 0, inputs=['<b>'], states=['p', 'v'], outputs=2)
    design = obc.lqr(space, [1, 1], [1])
    assert '<b>' not in design._repr_html_()
    assert design.inputs == ('u1',)   # '<b>' is not a name
    assert design._repr_html_().startswith('<table><caption>RegulatorDesign: 2 states')
