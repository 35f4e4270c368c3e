# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Values of an answer between its samples, against closed forms."""

import dataclasses

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import obc_ros as obc
from obc_ros.api.answer import Answer
from obc_ros.core.ocp.solution import Solution, Status
from obc_ros.core.text.errors import ObcError
from problems import pose
import pytest

REST = {'terminal_constraints': ['p', 'v'], 'input_bounds': {'u': [-1, 1]}}
FREE = {'free': True, 'lower': 0.1, 'upper': 20}
LEAST_TIME = pose({'p': 'v', 'v': 'u'}, 1, [1, 0], FREE, **REST)
COARSE = np.array([0.0, 0.3, 1.0, 1.0, 2.0])   # the jump at 1 is a time that stands twice
times = st.lists(st.floats(0, 2), max_size=8)


def least_time(t, late):
    """Return the optimal path from p = 1 to rest at 0: u = -1 until t = 1, then u = 1."""
    p = np.where(late, (2 - t)**2 / 2, 1 - t**2 / 2)
    v = np.where(late, t - 2, -t)
    return (np.column_stack([p, v]), np.where(late, 1.0, -1.0)[:, None],
            np.column_stack([0*t + 1, 1 - t]))


PATH = least_time(COARSE, np.arange(5) > 2)


def wrap(problem, t, x, u, lam, **more):
    """Return the answer with a path."""
    return Answer('', problem.states, problem.inputs, Solution(
        Status.SOLVED, '', 2.0, t, x, u, lam, 0 * t, **more), problem)


@given(times)
@settings(deadline=None)
def test_between_samples_are_the_values_of_the_closed_form(t):
    found = wrap(LEAST_TIME, COARSE, *PATH, interpolation='zoh').at(t)
    x, u, lam = least_time(np.array(t), np.array(t) >= 1)
    np.testing.assert_array_equal(found.u['u'], u[:, 0])
    for k, name in enumerate(('p', 'v')):
        np.testing.assert_allclose(found.x[name], x[:, k], atol=1e-14)
        np.testing.assert_allclose(found.costates[name], lam[:, k], atol=1e-14)


def test_samples_have_their_values_and_jumps_those_after_them():
    x, u, lam = PATH
    answer = wrap(LEAST_TIME, COARSE, x + 1e-3, u, lam, interpolation='zoh')
    found = answer.at(COARSE)
    np.testing.assert_array_equal(found.x['p'], answer.x['p'])
    np.testing.assert_array_equal(found.u['u'], [-1, -1, 1, 1, 1])
    one = answer.at(1)
    assert (one.t, one.u['u'], one.costates['v']) == (1.0, 1.0, 0.0)
    assert np.shape(one.x['p']) == ()
    assert answer.at([[0.5], [1.5]]).x['v'].shape == (2, 1)
    assert answer.at([]).x['p'].shape == (0,)


@pytest.mark.parametrize('k, rtol', [(1.0, 1e-8), (40.0, 1e-6)])
def test_costates_of_a_decaying_state_do_not_grow(k, rtol):
    """With u = 0 and lam(T) = 1, x = exp(-k t) and lam = exp(-k (1 - t))."""
    problem = pose({'x': '-k*x + u'}, 'u**2', [1], 1, parameters={'k': k})
    t = np.array([0.0, 1.0])
    answer = wrap(problem, t, np.exp(-k*t)[:, None], 0*t[:, None], np.exp(-k*(1 - t))[:, None])
    at = np.linspace(0, 1, 7)
    found = answer.at(at)
    np.testing.assert_allclose(found.x['x'], np.exp(-k*at), rtol=rtol, atol=1e-9)
    np.testing.assert_allclose(found.costates['x'], np.exp(-k*(1 - at)), rtol=rtol, atol=1e-9)


def test_an_input_is_linear_between_samples():
    """With u = t, v = t^2/2 and p = t^3/6."""
    problem = pose({'p': 'v', 'v': 'u'}, 'u**2', [0, 0], 2)
    t = np.array([0.0, 2.0])
    found = wrap(problem, t, np.column_stack([t**3/6, t**2/2]), t[:, None],
                 np.zeros((0, 2))).at(1.2)
    assert (found.u['u'], found.x['p'], found.x['v']) == pytest.approx((1.2, 0.288, 0.72))
    assert found.costates == {}


def test_multipliers_act_on_costates_between_samples():
    """dlam_v/dt = -lam_p - s with lam_p = 0 and s = 1: lam_v falls by 1 each second."""
    problem = pose({'p': 'v', 'v': 'u'}, 'u**2', [0, 1], 1, state_bounds={'v': [None, 1]})
    t = np.array([0.0, 1.0])
    found = wrap(problem, t, np.column_stack([t, 0*t + 1]), 0*t[:, None],
                 np.column_stack([0*t, 2 - t]),
                 state_multipliers=np.column_stack([0*t, 0*t + 1])).at(0.25)
    assert found.costates['v'] == pytest.approx(1.75, abs=1e-14)


@pytest.mark.parametrize('t, words', [
    (-0.1, r'-0.1 s is not a time of the path; wanted times from 0 s to 2 s'),
    ([0.5, 2.5], r'2.5 s is not'), (np.nan, r'nan s is not'), (np.inf, r'inf s is not'),
    ('soon', 'wanted a time or a list of times, found str'), ([[1], [1, 2]], 'wanted a time')])
def test_a_time_that_is_not_on_the_path_is_refused(t, words):
    with pytest.raises(ObcError, match=words):
        wrap(LEAST_TIME, COARSE, *PATH).at(t)


def test_an_answer_without_its_problem_says_so():
    answer = dataclasses.replace(wrap(LEAST_TIME, COARSE, *PATH), problem=None)
    with pytest.raises(ObcError, match='does not have its problem'):
        answer.at(0.5)


@pytest.mark.parametrize('method', ['riccati', 'transcription', 'indirect', 'auto'])
@pytest.mark.parametrize('T', [0.3, 0.7, 1.7, 2.9])
def test_the_stated_final_time_is_a_time_of_the_path(method, T):
    """The sum of rounded intervals is not T."""
    limits = {'input_bounds': {'u': [-1, 1]}} if method == 'auto' else {}
    answer = obc.solve({
        'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u - x'}, 'initial_state': {'x': 1},
        'running_cost': 'x**2 + u**2', 'final_time': {'free': False, 'value': T}, **limits,
        'method': method})
    assert answer.status == 'solved'
    assert answer.t[-1] == T
    assert answer.at(T).x['x'] == answer.x['x'][-1]
