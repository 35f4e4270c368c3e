# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Resources that |u| uses up, with bounds that are touched."""

from obc_ros.core.solver.solve import solve
import problems
import pytest

SLEW = {'states': ['th', 'w', 'fuel'], 'inputs': ['u'], 'running_cost': '1',
        'dynamics': {'th': 'w', 'w': 'u', 'fuel': '-abs(u)'},
        'terminal_constraints': ['th - 2', 'w'], 'input_bounds': {'u': [-1, 1]},
        'final_time': {'free': True, 'lower': 0.1, 'upper': 30, 'guess': 5}}
STORE = {'states': ['E'], 'initial_state': {'E': 1}, 'terminal_constraints': ['E - 1'],
         'state_bounds': {'E': [0, 2]}, 'final_time': {'free': False, 'value': 12}}


@pytest.mark.slow
@pytest.mark.parametrize('fuel', [1.2, 0.8])
@pytest.mark.parametrize('bounds', [
    {'state_bounds': {'fuel': [0, None]}},
    {'path_constraints': [{'expr': 'fuel', 'lower': 0, 'upper': None}]}])
def test_a_slew_that_uses_up_its_fuel_is_certified(fuel, bounds):
    """Half of the fuel accelerates to w = fuel / 2, the other half brakes: T = w + 2 / w."""
    found = solve(problems.build({
        **SLEW, **bounds, 'initial_state': {'th': 0, 'w': 0, 'fuel': fuel}}))
    assert found.certified, found.message
    assert found.objective == pytest.approx(fuel / 2 + 4 / fuel, rel=1e-6)
    assert found.lam[-1, 2] < -0.1   # more fuel would save time


@pytest.mark.slow
@pytest.mark.parametrize('effort', ['0', '0.05*{}**2'])
def test_a_store_with_losses_is_that_of_two_inputs(effort):
    """A store that loses 0.1 |u|, and the same with charge and discharge as two inputs."""
    price, bound = '(1 + 0.5*sin(t))', {'u': [-1, 1], 'p': [0, 1], 'm': [0, 1]}
    costs = []
    for power, rate in (('u', 'u - 0.1*abs(u)'), ('(p - m)', '0.9*p - 1.1*m')):
        inputs = [name for name in bound if name in power]
        found = solve(problems.build({
            **STORE, 'inputs': inputs, 'dynamics': {'E': rate},
            'running_cost': f'{price}*{power} + {effort.format(power)}',
            'input_bounds': {name: bound[name] for name in inputs}}))
        assert found.certified, found.message
        costs.append(found.objective)
    assert costs[0] == pytest.approx(costs[1], rel=1e-7)
