# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Scales of states from the reach of the inputs, and stiffness of linear dynamics."""

import numpy as np
from obc_ros.core.solver.exact.reachable_set import bound_reach
from obc_ros.core.solver.program_cache import ProgramCache
from obc_ros.core.solver.transcription.intervals import compute_amplification
import problems
import pytest


def test_the_reach_of_linear_systems_is_exact():
    T = 3.0
    double = bound_reach(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [2.0]]), T)
    np.testing.assert_allclose(double, [T**2, 2 * T], rtol=1e-12)
    # Fast lags in a row: each follows the input.
    lags = bound_reach(1e4 * (np.eye(3, k=-1) - np.eye(3)), 1e4 * np.eye(3)[:, :1], T)
    np.testing.assert_allclose(lags, 1.0, rtol=1e-9)


@pytest.mark.parametrize('fast', [1.0, 10.0, 1e3])
def test_the_scales_of_a_chain_of_lags_are_those_of_its_states(fast):
    problem = problems.pose(
        {'a': f'{fast}*(u - a)', 'b': f'{fast}*(a - b)', 'c': f'{fast}*(b - c)'},
        '(c - 1)**2 + u**2', (0, 0, 0), 10)
    guesser = ProgramCache(problem).guesser
    scales = guesser.sizes(problem, guesser.line(problem, 10.0))
    np.testing.assert_allclose(scales.x, 1.0)


@pytest.mark.parametrize('rate, stiff', [('-x', False), ('-100*x', True), ('100*x', False),
                                         ('-100*x**3', False)])
def test_explicit_steps_are_avoided_where_they_amplify_what_decays(rate, stiff):
    problem = problems.pose({'x': f'{rate} + u'}, 'x**2 + u**2', (1,), 10)
    assert ProgramCache(problem).guesser.is_stiff(problem, 16) is stiff


def test_the_amplification_of_a_step_is_that_of_an_exponential_if_it_is_short():
    z = np.array([-0.1, 0.1j, -0.1 + 0.2j, 0.3])
    np.testing.assert_allclose(compute_amplification(z), np.exp(z.real), rtol=1e-6)
    assert compute_amplification(np.array([-10.0 + 0j])) > 1
