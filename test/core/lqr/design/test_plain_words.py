# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A design in plain words, for loops whose figures are known in closed form."""

import math

import numpy as np
from obc_ros.core.lqr.design.report import describe_plainly
from obc_ros.core.lqr.lqr import lqr
from obc_ros.core.lqr.margins import compute_margins
import pytest


def describe(A, B, Q, R):
    """Return the words for the regulator of a plant and weights."""
    found = lqr(A, B, Q, R)
    seen = compute_margins(A, B, found.K)
    return describe_plainly(seen.poles, seen.damping, seen.phase_margin, seen.delay_margin)


def test_an_integrator_does_not_swing():
    """K = 1: the loop gain 1/s has a phase margin of 90 deg at 1 rad/s, pi/2 s of delay."""
    assert describe(np.zeros((1, 1)), np.eye(1), np.eye(1), np.eye(1)) == (
        'slowest mode 1 s; no oscillation; tolerates 90 deg of phase or 1.5 s of delay')


def test_a_double_integrator_is_well_damped():
    """The poles of s^2 + sqrt(3) s + 1: 2 / sqrt(3) = 1.15 s, damping ratio sqrt(3) / 2."""
    A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    words = describe(A, B, np.eye(2), np.eye(1)).split('; ')
    crossing = math.sqrt((3.0 + math.sqrt(13.0)) / 2.0)   # |1 + sqrt(3) i w| = w^2
    phase = math.atan(math.sqrt(3.0) * crossing)
    assert words == ['slowest mode 1.2 s', 'well damped',
                     f'tolerates {math.floor(math.degrees(phase))} deg of phase or '
                     f'{math.floor(100 * phase / crossing) / 100:g} s of delay']


@pytest.mark.parametrize(('damping', 'words'), [
    (0.7, 'well damped'), (0.3, 'moderately damped'), (0.05, 'poorly damped')])
def test_the_mode_that_swings_most_is_described(damping, words):
    """A real pole beside it, whose ratio is 1, changes nothing."""
    angle = math.acos(damping)
    poles = np.array([-2.0, *10.0 * np.exp(1j * np.array([math.pi - angle, math.pi + angle]))])
    assert f'; {words}; ' in describe_plainly(
        poles, -poles.real / abs(poles), np.array([1.0]), np.array([1.0]))


@pytest.mark.parametrize(('phase', 'delay', 'words'), [
    (math.inf, math.inf, 'tolerates any delay'),
    (1.0, math.inf, 'tolerates 57 deg of phase in one input'),
    (math.inf, 0.5, 'tolerates 0.5 s of delay in one input'),
    (2.0 * math.pi / 3.0, 123.4, 'tolerates 120 deg of phase or 120 s of delay in one input')])
def test_a_margin_without_a_limit_is_left_out(phase, delay, words):
    """The smallest one of the inputs counts; with a delay in both the loop tolerates less."""
    assert describe_plainly(np.array([-1.0 + 0.0j]), np.ones(1), np.array([math.inf, phase]),
                            np.array([delay, math.inf])).endswith(f'; {words}')


@pytest.mark.parametrize(('slowest', 'words'), [
    (math.log(2.0) / 3.0, 'not stable: doubles in 3 s'),
    (0.0, 'not stable: a deviation does not decay'),
    (math.nan, 'not known')])
def test_an_unstable_loop_is_called_so(slowest, words):
    poles = np.array([-1.0, slowest], dtype=complex)
    assert describe_plainly(poles, np.ones(2), np.ones(1), np.ones(1)) == words


@pytest.mark.parametrize('margins', [([math.nan], [1.0]), ([1.0], [math.nan])])
def test_margins_that_are_no_numbers_are_not_known(margins):
    """A message of another program, or of a recording, may contain them."""
    assert describe_plainly(np.array([-1.0 + 0.0j]), np.ones(1), *map(np.array, margins)) == (
        'not known')
