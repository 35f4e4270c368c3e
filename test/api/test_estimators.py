# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Kalman filters of the public interface against closed forms and python-control."""

import control
import numpy as np
import obc_ros as obc
from obc_ros.core.text.errors import StatementError
import pytest

A, C = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[1.0, 0.0]])
SPACE = control.ss(A, [[0], [1]], C, 0, states=['p', 'v'], inputs=['F'], outputs=['y'])
MASS = obc.System(states=['p', 'v'], inputs=['F'], dynamics={'p': 'v', 'v': 'F'},
                  outputs={'y': 'p'})
QW, RV = np.diag([2.0, 3.0]), np.array([[0.5]])


def test_a_random_walk_has_the_gain_of_its_closed_form():
    """dx/dt = w, y = x + v: P = sqrt(Qw Rv), L = sqrt(Qw/Rv)."""
    found = obc.lqe(0*np.eye(1), [[1]], 4, 9)
    assert (found.P[0, 0], found.L[0, 0]) == (pytest.approx(6), pytest.approx(2/3))


@pytest.mark.parametrize('call', [
    lambda f, **more: f(A, C, [2, 3], [0.5], **more),
    lambda f, **more: f(A, C, Qw=[2, 3], Rv=0.5, **more),
    lambda f, **more: f(A=A, C=C, Qw=QW, Rv=RV, **more),
    lambda f, **more: f(A, C, QW, Rv=RV, **more),
    lambda f, **more: f(A, Rv=RV, Qw=QW, C=C, **more),
    lambda f, **more: f(A, np.eye(2), C, QW, RV, **more),
    lambda f, **more: f(A, np.eye(2), C, QW, RN=RV, **more),
    lambda f, **more: f(A, C, QW, {'height': 0.5}, outputs=('height',), **more)])
def test_every_way_to_state_matrices_gives_the_same_filter(call):
    for function, more in ((obc.lqe, {}), (obc.dlqe, {'period': 0.1})):
        np.testing.assert_array_equal(call(function, **more).L, function(A, C, QW, RV, **more).L)


@pytest.mark.parametrize('plant', [SPACE, MASS, MASS.model], ids=['space', 'system', 'core'])
def test_a_plant_is_measured_by_its_outputs(plant):
    expected = obc.lqe(A, C, QW, RV).L
    for found in (obc.lqe(plant, [2, 3], 0.5), obc.lqe(system=plant, Qw=QW, Rv={'y': 0.5}),
                  obc.lqe(plant, {'v': 3, 'p': 2}, Rv=[0.5])):
        np.testing.assert_allclose(found.L, expected, rtol=1e-12)
    sampled = obc.dlqe(plant, QW, 0.5/1e-3, period=1e-3)   # a measurement in each period
    np.testing.assert_allclose(sampled.L/1e-3, expected, rtol=1e-2)


def test_five_arguments_are_those_of_python_control():
    G = np.array([[0.0], [1.0]])
    L, P, _ = control.lqe(A, G, C, [[3]], [[0.5]])
    for found in (obc.lqe(A, G, C, [[3]], [[0.5]]), obc.lqe(A, C, 3, 0.5, G=G),
                  obc.lqe(SPACE, 3, 0.5, G=SPACE.B)):
        np.testing.assert_allclose(found.L, L, rtol=1e-9)
        np.testing.assert_allclose(found.P, P, rtol=1e-9)
    Ad = np.array([[1, 0.1], [0, 1]])
    L, P, _ = control.dlqe(Ad, G, C, [[3]], [[0.5]])
    np.testing.assert_allclose(obc.dlqe(Ad, G, C, [[3]], [[0.5]]).P, P, rtol=1e-9)
    space = control.ss(Ad, G, C, 0, 0.1)
    np.testing.assert_allclose(obc.dlqe(space, 3, 0.5, G=G).P, P, rtol=1e-9)


@pytest.mark.parametrize(('call', 'said'), [
    (lambda: obc.lqe(A, C, QW), '^lqe: wanted A, C, Qw, Rv'),
    (lambda: obc.lqe(MASS, C, QW, RV), '^lqe: found one more argument than wanted A, C, Qw, Rv'),
    (lambda: obc.lqe(MASS, 1, Qw=100), '^lqe: Qw is given twice, by position and by name'),
    (lambda: obc.lqe(A, C, 1, 1, C=C), '^lqe: C is given twice'),
    (lambda: obc.lqe(A, np.eye(2), C, 1, 1, G=np.eye(2)), '^lqe: G is given twice'),
    (lambda: obc.lqe(system=MASS, C=1, Qw=100), '^lqe: C is given beside a plant; wanted A, C'),
    (lambda: obc.dlqe(MASS, C=C, Qw=1, Rv=1, period=1), '^dlqe: C is given beside a plant'),
    (lambda: obc.lqe(A, np.eye(2), C, 1, 1, RN=1), '^lqe: wanted A, C, Qw, Rv'),
    (lambda: obc.lqe(A, C, QW, RV, at=[0, 0]), '^lqe: at is the set point of a plant'),
    (lambda: obc.lqe(MASS, {'q': 1}, 1), "^Qw: wanted numbers for p, v.*found 'q'"),
    (lambda: obc.lqe(control.ss(A, [[0], [1]], C, 0, 0.1), 1, 1), 'discrete time; use dlqe'),
    (lambda: obc.dlqe(control.ss(A, [[0], [1]], C, 0, 0.1), 1, 1, period=0.2), '^dlqe: period'),
    (lambda: obc.dlqe(MASS, 1, 1, period='1'), "^period: wanted a number, found str '1'"),
    (lambda: obc.dlqe(MASS, 1, 1), '^period = 0'),
])
def test_a_filter_is_refused_in_words(call, said):
    with pytest.raises(StatementError, match=said):
        call()
