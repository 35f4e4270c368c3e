# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fits of parameters, whose sums of squares have several local minima."""

from itertools import product

import numpy as np
from obc_ros.core.solver.solve import solve
import problems
import pytest
from scipy.optimize import minimize
from scipy.special import exprel

RATES = np.array([1, 2, 4, 7]), np.array([0.43, 0.44, 0.31, 0.10])
TIMES = 0.4 * np.arange(1, 11)
SWING = TIMES, np.cos(5 * TIMES) + 0.02 * np.sin(37 * TIMES)


def second_substance(t, rates):
    """Return B of A to B to C from A = 1."""
    k1, k2 = rates
    return k1 * np.exp(-k2 * t) * t * exprel((k2 - k1) * t)


@pytest.mark.slow
@pytest.mark.parametrize(('data', 'model', 'statement', 'measured', 'bounds'), [
    (RATES, second_substance, {
        'states': ['A', 'B'], 'dynamics': {'A': '-k1*A + d', 'B': 'k1*A - k2*B'},
        'initial_state': {'A': 1, 'B': 0}}, 'B', {'k1': [0.01, 5], 'k2': [0.01, 5]}),
    (SWING, lambda t, w: np.cos(w * t), {
        'states': ['x', 'v'], 'dynamics': {'x': 'v', 'v': '-w**2*x + d'},
        'initial_state': {'x': 1, 'v': 0}}, 'x', {'w': [0.5, 8]})])
def test_a_fit_finds_the_least_of_several_minima(data, model, statement, measured, bounds):
    """The least sum of squares on a grid of parameters, polished, is found."""
    times, values = data

    def squares(p):
        return np.sum((model(times, p) - values)**2)

    grid = product(*(np.linspace(low, high, 60) for low, high in bounds.values()))
    near = min(grid, key=squares)
    least = minimize(squares, near, method='Nelder-Mead',
                     options={'xatol': 1e-10, 'fatol': 1e-15, 'maxiter': 2000}).fun
    found = solve(problems.build({
        **statement, 'inputs': ['d'], 'input_bounds': {'d': [0, 0]}, 'free_parameters': bounds,
        'phases': [{'duration': float(h), 'terminal_cost': f'({measured} - {y})**2'}
                   for h, y in zip(np.diff(times, prepend=0.0), values, strict=True)]}))
    assert found.certified, found.message
    assert found.objective == pytest.approx(least, rel=1e-5)
