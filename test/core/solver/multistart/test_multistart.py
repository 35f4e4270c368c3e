# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Problems with many local minima: solutions cost less than the best of random inputs.

The first two are among the tests of A. Yu. Gornov, T. S. Zarodnyuk, T. I. Madzhara, A. V.
Daneeva, I. A. Veyalko, A collection of test multiextremal optimal control problems, in
Optimization, Simulation, and Control, Springer (2013).
"""

import numpy as np
from obc_ros.core.solver.solve import solve
import problems
import pytest

DRAWN, PIECES, STEPS = 4000, 7, 8

WELLS = {
    'growing product': (
        (0.5, -0.2), 1.7, 2.0,
        ('1 - b**2 + 0.5*b', 'a*u'), lambda a, b, u: (1 - b**2 + 0.5*b, a*u),
        'a*b + a - b', lambda a, b: a*b + a - b),
    'soft spring': (
        (5.0, 0.0), 7.0, 1.0,
        ('b', 'u - a + a**3/6 - a**5/120'), lambda a, b, u: (b, u - a + a**3/6 - a**5/120),
        '(a + 1)**2 + (b - 9.5)**2', lambda a, b: (a + 1)**2 + (b - 9.5)**2),
    'two waves': (
        (-1.96, -0.69), 7.0, 2.0,
        ('u - 0.39*tanh(a)', '1.4*tanh(a) + u*cos(a)'),
        lambda a, b, u: (u - 0.39*np.tanh(a), 1.4*np.tanh(a) + u*np.cos(a)),
        '1.18*cos(2*a) + 1.21*b', lambda a, b: 1.18*np.cos(2*a) + 1.21*b)}


def minimum_over_random_inputs(x0, T, most, f, V):
    """Return the minimum final cost over random piecewise constant inputs within their bounds."""
    chance = np.random.default_rng(0)
    part = chance.choice([-1.0, 1.0], (DRAWN, PIECES))
    part[::2] = chance.uniform(-1, 1, part[::2].shape)
    h, x = T / (PIECES * STEPS), np.repeat(np.array(x0)[:, None], DRAWN, axis=1)
    for u in np.repeat(most * part.T, STEPS, axis=0):
        one = np.array(f(*x, u))
        two = np.array(f(*(x + h / 2 * one), u))
        three = np.array(f(*(x + h / 2 * two), u))
        x = x + h / 6 * (one + 2 * two + 2 * three + np.array(f(*(x + h * three), u)))
    return float(np.nanmin(V(*x)))


@pytest.mark.slow
@pytest.mark.parametrize('name', WELLS)
def test_no_random_input_costs_less(name):
    x0, T, most, dynamics, f, terminal_cost, V = WELLS[name]
    answer = solve(problems.build({
        'states': ['a', 'b'], 'inputs': ['u'], 'dynamics': dict(zip('ab', dynamics, strict=True)),
        'running_cost': 0, 'terminal_cost': terminal_cost,
        'initial_state': dict(zip('ab', x0, strict=True)), 'input_bounds': {'u': [-most, most]},
        'final_time': {'free': False, 'value': T}}))
    assert answer.certified, answer.message
    with np.errstate(over='ignore', invalid='ignore'):
        assert answer.objective < minimum_over_random_inputs(x0, T, most, f, V)
