# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Hamiltonians with several minima: the input is at the global one and jumps between them."""

import numpy as np
from obc_ros.core.ocp.structure import find_branching_inputs
from obc_ros.core.solver.solve import solve
import problems
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import minimize_scalar

WELLS = {
    'states': ['t'], 'inputs': ['u'], 'dynamics': {'t': '1'},
    'running_cost': '4*(u**2 - 1)**2 - (t - 1)*u', 'initial_state': {'t': 0},
    'input_bounds': {'u': [-2, 2]}, 'final_time': {'free': False, 'value': 2}}


def hump(u, at):
    """Return the pull of a gear centred at `at`, as a number or as text."""
    return f'exp(-8*({u} - {at})**2)' if isinstance(u, str) else np.exp(-8 * (u - at)**2)


def global_minimum(function, wells):
    """Return the minimum of a function with one local minimum near each of the given points."""
    return min(minimize_scalar(function, bounds=(at - 0.9, at + 0.9), method='bounded',
                               options={'xatol': 1e-12}).fun for at in wells)


@pytest.mark.slow
@pytest.mark.parametrize('as_state', [False, True])
def test_the_input_switches_to_the_lower_of_two_minima(as_state):
    """The minimum at each time is the minimum over the path; quadrature gives its value."""
    known, _ = quad(lambda t: global_minimum(
        lambda u: 4 * (u**2 - 1)**2 - (t - 1) * u, (-1, 1)), 0, 2, points=[1], epsabs=1e-12)
    mapping = WELLS if not as_state else WELLS | {
        'states': ['x', 't'], 'dynamics': {'x': WELLS['running_cost'], 't': '1'},
        'running_cost': '0', 'terminal_cost': 'x', 'initial_state': {'x': 0, 't': 0}}
    found = solve(problems.build(mapping))
    assert found.certified, found.message
    assert found.objective == pytest.approx(known, rel=1e-7)
    assert found.switching_times == pytest.approx([1], abs=1e-6)


def two_gears(v):
    """Return (input, full pull) of each of two gears at speed v."""
    return (1, 1 - v), (3, 0.4)


def three_gears(v):
    """Return (input, full pull) of each of three gears at speed v."""
    return (1, 1 - v), (3, 0.5 - 0.2 * v), (5, 0.2)


@pytest.mark.slow
@pytest.mark.parametrize(('gears', 'text', 'T', 'shifts'), [
    (two_gears, ('1 - v', '0.4'), 5, 1),
    (three_gears, ('1 - v', '0.5 - 0.2*v', '0.2'), 15, 2)])
def test_the_gear_of_the_largest_pull_is_chosen(gears, text, T, shifts):
    """A larger speed is never worse later, so the largest pull is optimal at each time."""
    def most(v):
        return -0.02 * v - global_minimum(
            lambda u: -sum(full * hump(u, at) for at, full in gears(v)), (1, 3, 5)[:len(text)])

    path = solve_ivp(lambda t, z: [z[1], most(z[1])], (0, T), [0, 0], rtol=1e-10, atol=1e-10)
    found = solve(problems.pose(
        {'x': 'v', 'v': ' + '.join((
            *(f'({full})*{hump("u", 2 * k + 1)}' for k, full in enumerate(text)), '-0.02*v'))},
        '0', (0, 0), T, terminal_cost='-x', input_bounds={'u': [0, 2 * len(text)]}))
    assert found.certified, found.message
    assert -found.objective == pytest.approx(path.y[0, -1], rel=1e-6)
    assert len(found.switching_times) == shifts


def test_inputs_with_several_minima_of_h_are_identified():
    def of(running_cost, dynamics='u', **more):
        return find_branching_inputs(problems.pose(
            {'x': dynamics}, running_cost, (0,), 1, inputs=['u', 'w'], input_bounds={'u': [-1, 1]},
            **more))

    assert of('u**2 + w**4').tolist() == [False, False]   # w has no bounds
    assert of('u**2 + w**2', 'u*w').tolist() == [False, False]
    assert of('u**2 + w**2', 'sin(u) + w').tolist() == [True, False]
    assert of('u**4 + w**2').tolist() == [True, False]
    assert of('u**4 + w**2', path_constraints=[
        {'expr': 'u + w', 'lower': None, 'upper': 1}]).tolist() == [False, False]
