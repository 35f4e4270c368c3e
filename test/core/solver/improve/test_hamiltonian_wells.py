# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Where H has several least points: the input is at the lowest, and jumps where that changes."""

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
    """Return what a gear adds, a number or its text."""
    return f'exp(-8*({u} - {at})**2)' if isinstance(u, str) else np.exp(-8 * (u - at)**2)


def least(function, wells):
    """Return the least value of a function with one least point near each of some places."""
    return min(minimize_scalar(function, bounds=(at - 0.9, at + 0.9), method='bounded',
                               options={'xatol': 1e-12}).fun for at in wells)


@pytest.mark.slow
@pytest.mark.parametrize('as_state', [False, True])
def test_two_wells_of_which_the_deeper_one_changes(as_state):
    """What is least at each moment is least on the whole: a quadrature says how much."""
    known, _ = quad(lambda t: least(
        lambda u: 4 * (u**2 - 1)**2 - (t - 1) * u, (-1, 1)), 0, 2, points=[1], epsabs=1e-12)
    mapping = WELLS if not as_state else WELLS | {
        'states': ['x', 't'], 'dynamics': {'x': WELLS['running_cost'], 't': '1'},
        'running_cost': '0', 'terminal_cost': 'x', 'initial_state': {'x': 0, 't': 0}}
    found = solve(problems.build(mapping))
    assert found.certified, found.message
    assert found.objective == pytest.approx(known, rel=1e-7)
    assert found.switching_times == pytest.approx([1], abs=1e-6)


def two_gears(v):
    """Return how much each of two gears pulls at full."""
    return (1, 1 - v), (3, 0.4)


def three_gears(v):
    """Likewise of three."""
    return (1, 1 - v), (3, 0.5 - 0.2 * v), (5, 0.2)


@pytest.mark.slow
@pytest.mark.parametrize(('gears', 'text', 'T', 'shifts'), [
    (two_gears, ('1 - v', '0.4'), 5, 1),
    (three_gears, ('1 - v', '0.5 - 0.2*v', '0.2'), 15, 2)])
def test_gears(gears, text, T, shifts):
    """More speed at once leaves more later: the best gear is the one that pulls most."""
    def most(v):
        return -0.02 * v - least(
            lambda u: -sum(full * hump(u, at) for at, full in gears(v)), (1, 3, 5)[:len(text)])

    path = solve_ivp(lambda t, z: [z[1], most(z[1])], (0, T), [0, 0], rtol=1e-10, atol=1e-10)
    found = solve(problems.pose(
        {'x': 'v', 'v': ' + '.join((
            *(f'({full})*{hump("u", 2 * k + 1)}' for k, full in enumerate(text)), '-0.02*v'))},
        '0', (0, 0), T, terminal_cost='-x', input_bounds={'u': [0, 2 * len(text)]}))
    assert found.certified, found.message
    assert -found.objective == pytest.approx(path.y[0, -1], rel=1e-6)
    assert len(found.switching_times) == shifts


def test_where_branches_may_be():
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
