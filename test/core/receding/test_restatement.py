# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What a receding horizon takes of a problem: weights, set point, limits; refusals by key."""

from collections.abc import Mapping
import math
from typing import Any

import casadi as ca
from hypothesis import given, strategies
import numpy as np
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.receding.restatement import check_restatable, restate_problem, Restatement
from obc_ros.core.systems.file import build_system
from obc_ros.core.systems.registry import get_system
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import StatementError
from obc_ros.core.text.expressions import parse_expression
import pytest

CART: dict[str, Any] = {
    'states': ['p', 'v'], 'inputs': ['a'], 'parameters': {'c': 0.1},
    'dynamics': {'p': 'v', 'v': 'a - c*v'}, 'running_cost': '(p - 1)**2 + 0.1*v**2 + 0.5*a**2',
    'initial_state': {'p': 0, 'v': 0}, 'final_time': {'free': False, 'value': '20*c'}}
AIRCRAFT: dict[str, Any] = {
    'system': 'aircraft', 'running_cost': 'px**2 + theta**2 + f1**2 + (f2 - m*g)**2',
    'initial_state': dict.fromkeys(('px', 'py', 'theta', 'vx', 'vy', 'omega'), 0),
    'final_time': {'free': False, 'value': 1}}


def restate(statement: Mapping[str, Any], system: System | None = None) -> Restatement:
    """Return the restatement of a statement, whose own plant is the default."""
    problem = build_problem(statement)
    check_restatable(problem, statement)
    return restate_problem(problem, statement, system or build_system(statement))


def test_a_cart_is_restated() -> None:
    """Each number is that of the statement; the set point needs no input."""
    taken = restate({**CART, 'state_bounds': {'v': [-2, None]}, 'input_bounds': {'a': [-1, 3]}})
    assert taken == Restatement(
        setpoint=(1.0, 0.0), setpoint_input=(), Qx=(1.0, 0.1), Qu=(0.5,), cross=(),
        x_bounds=(-math.inf, math.inf, -2.0, math.inf), u_limits=(), path_constraints=(),
        horizon=2.0, replaced='')


numbers = strategies.floats(-3.0, 3.0)


@pytest.mark.slow
@given(strategies.lists(numbers, min_size=9, max_size=9), numbers, strategies.floats(-1e3, 1e3))
def test_the_weights_and_the_set_point_are_those_of_the_cost(entries: list[float], place: float,
                                                             offset: float) -> None:
    """A cost that is written out from W = R'R + I about a place gives W and the place back."""
    R = np.array(entries).reshape(3, 3)
    W = R.T @ R + np.eye(3)
    z = (f'(p - ({place!r}))', 'v', 'a')
    cost = ' + '.join(f'({W[i, j]!r})*{z[i]}*{z[j]}'.replace('np.float64', '')
                      for i in range(3) for j in range(3))
    taken = restate({**CART, 'running_cost': f'{cost} + ({offset!r})'})
    Qx = np.diag(taken.Qx) if len(taken.Qx) == 2 else np.reshape(taken.Qx, (2, 2))
    N = np.reshape(taken.cross or (0.0, 0.0), (2, 1))
    np.testing.assert_allclose(np.block([[Qx, N], [N.T, np.array([taken.Qu])]]), W, rtol=1e-12,
                               atol=1e-14)
    np.testing.assert_allclose(taken.setpoint, (place, 0.0), rtol=1e-12, atol=1e-12)


def test_without_a_weight_of_a_state_the_set_point_is_that_of_the_system() -> None:
    """Of all minima the one nearest to it."""
    setpoint = {'p': 2.0}
    taken = restate({**CART, 'running_cost': 'v**2 + a**2', 'setpoint': setpoint})
    assert taken.setpoint == (2.0, 0.0) and taken.Qx == (0.0, 1.0)


def test_parameters_of_a_registered_system_stay_in_the_constraints() -> None:
    """They follow a change of the system; numbers replace the other parameters."""
    statement = {**AIRCRAFT, 'parameters': {'m': 5, 'r0': '-m/10', 'e5': 7}, 'path_constraints': [
        {'expr': '(px - 2)**2 +\n py**2', 'lower': 'r0**2', 'upper': '9*m'},
        {'expr': 'f1 + 2.e5*px', 'upper': 'e5'}]}
    system = get_system('aircraft', {'m': 5.0})
    taken = restate(statement, system)
    assert taken.setpoint == (0.0,) * 6 and taken.setpoint_input == ()
    symbols = {name: ca.SX.sym(name) for name in ('px', 'py', 'f1', 'm')}
    rows = ca.Function('rows', [ca.vertcat(*symbols.values())], [ca.vertcat(*(
        parse_expression(text, symbols, 'row') for text in taken.path_constraints))])
    for px, py, f1, m in np.random.default_rng(0).uniform(-3.0, 3.0, (20, 4)):
        about = (px - 2)**2 + py**2
        np.testing.assert_allclose(rows([px, py, f1, m]).full().ravel(), [
            about - 9 * m, 0.25 - about, f1 + 2e5 * px - 7], rtol=1e-12, atol=1e-9)


def test_a_bound_of_an_input_of_a_registered_system_is_a_limit() -> None:
    """Without bounds the limits are those of the system."""
    assert restate(AIRCRAFT, get_system('aircraft')).u_limits == ()
    taken = restate({**AIRCRAFT, 'input_bounds': {'f1': [-3, None]}}, get_system('aircraft'))
    assert taken.u_limits == (-3.0, math.inf, -math.inf, math.inf)


def test_a_set_point_that_moves_keeps_its_input() -> None:
    """The speed is no consequence of the state."""
    statement = {
        'system': 'vehicle', 'running_cost': 'px**2 + py**2 + theta**2 + (v - 10)**2 + phi**2',
        'initial_state': {'px': 0, 'py': 1, 'theta': 0}, 'final_time': {'free': False, 'value': 1}}
    taken = restate(statement, get_system('vehicle'))
    assert taken.setpoint == (0.0, 0.0, 0.0) and taken.setpoint_input == (10.0, 0.0)


def test_a_terminal_cost_is_said_to_be_replaced() -> None:
    """The regulator has a cost-to-go of its own."""
    assert 'terminal_cost' in restate({**CART, 'terminal_cost': '3*p**2'}).replaced
    assert restate({**CART, 'terminal_cost': '0'}).replaced == ''


@pytest.mark.parametrize(('change', 'words'), [
    ({'final_time': None, 'phases': [{'duration': 1}, {'duration': 1}]}, '^phases: '),
    ({'free_parameters': {'k': [1, 2]}, 'running_cost': 'p**2 + a**2 + k**2'},
     '^free_parameters: '),
    ({'final_time': {'free': True, 'lower': 0.1, 'upper': 2}}, '^final_time: '),
    ({'running_cost': '(p - t)**2 + a**2'}, '^t: '),
    ({'path_constraints': [{'expr': 'p - t', 'upper': 1}]}, '^t: '),
    ({'terminal_constraints': ['p - 1']}, '^terminal_constraints: .*remove'),
    ({'initial_cost': 'p**2'}, '^initial_cost: .*remove'),
    ({'initial_state': {'p': None, 'v': 0}, 'initial_constraints': ['p - 1']},
     '^initial_constraints: .*remove'),
    ({'boundary_constraints': ['p - p_0']}, '^boundary_constraints: .*remove'),
    ({'periodic': ['p']}, '^periodic: .*remove'),
    ({'initial_state': {'p': [0, 1], 'v': 0}}, '^initial_state: .*wanted a number'),
    ({'running_cost': 'p**4 + a**2'}, '^running_cost: wanted a quadratic'),
    ({'running_cost': 'p**2 + a**2 + abs(p - 1e6)'}, '^running_cost: wanted a quadratic'),
    ({'running_cost': 'p**2 + abs(v) + a**2'}, '^running_cost: wanted a quadratic'),
    ({'running_cost': 'p**2 + v + a**2'}, '^running_cost: it has no minimum in v;'),
    ({'running_cost': 'p**2 + v**2'}, r'^running_cost: wanted a weight of each input.*a\*\*2'),
    ({'running_cost': 'p**2 - a**2'}, '^running_cost: wanted a weight of each input'),
    ({'running_cost': '0'}, '^running_cost: wanted a weight of each input'),
    ({'running_cost': 'p**2 + (a - 2)**2'}, r'^running_cost: .* a = 2, but .* a = 0;'),
    ({'running_cost': 'p**2 + (v - 2)**2 + a**2', 'dynamics': {'p': 'v - p', 'v': 'a - v'}},
     '^running_cost: the plant cannot stay at its minimum: '),
])
def test_what_a_receding_horizon_cannot_take_is_refused_by_its_key(change: dict[str, Any],
                                                                   words: str) -> None:
    """The sentence says what to do."""
    statement = {key: value for key, value in {**CART, **change}.items() if value is not None}
    with pytest.raises(StatementError, match=words):
        restate(statement)


@pytest.mark.parametrize('scale', [1e-8, 1.0, 1e8])
def test_weights_of_any_size_are_kept(scale: float) -> None:
    """Neither a small nor a large weight is lost beside another one."""
    taken = restate({**CART, 'running_cost': f'{scale!r}*(p - 3)**2 + v**2 + {1 / scale!r}*a**2'})
    assert taken.Qx == pytest.approx((scale, 1.0), rel=1e-12)
    assert taken.Qu == pytest.approx((1 / scale,), rel=1e-12)
    assert taken.setpoint == pytest.approx((3.0, 0.0), rel=1e-12)
