# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Orders of state constraints, and paths that slide along bounds."""

import math

import casadi as ca
import numpy as np
from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.arcs.constraint_orders import BoundRates, find_sliding
from obc_ros.core.solver.arcs.state_contacts import StateContact
from obc_ros.core.solver.solve import solve
from obc_ros.core.solver.transcription.mesh import build_path
import problems
import pytest

# A robot on two wheels at a distance of 0.4 passes a disc of radius 1. From its start it points
# along a tangent.
WHEELS = {
    'states': ['px', 'py', 'th'], 'inputs': ['vl', 'vr'], 'parameters': {'b': 0.4},
    'dynamics': {'px': '(vl + vr)/2*cos(th)', 'py': '(vl + vr)/2*sin(th)', 'th': '(vr - vl)/b'},
    'running_cost': '1', 'initial_state': {'px': -2, 'py': 0, 'th': math.pi / 6},
    'terminal_constraints': ['px - 2', 'py'],
    'input_bounds': {'vl': [-1, 1], 'vr': [-1, 1]},
    'path_constraints': [{'expr': 'px**2 + py**2', 'lower': 1}],
    'final_time': {'free': True, 'lower': 2, 'upper': 10, 'guess': 5}}
DISC = 3   # the row of the disc among (x, c)


@pytest.mark.parametrize(('dynamics', 'order', 'slides'), [
    ({'x': 'u*cos(y)', 'y': 'w'}, 1, True), ({'x': '(u - k*w)*sin(y)', 'y': 'w'}, 1, True),
    ({'x': 'u', 'y': 'w'}, 1, False), ({'x': 'u*cos(y)', 'y': '0'}, 1, False),
    ({'x': 'u*cos(y) + 1', 'y': 'w'}, 1, False), ({'x': 'u**2*cos(y)', 'y': 'w'}, 1, False),
    ({'x': 'u*cos(y) + w*sin(y)', 'y': 'w'}, 1, False), ({'x': 'cos(y)', 'y': 'w'}, 2, False)])
def test_a_product_of_speed_and_direction_is_found(dynamics, order, slides):
    bounds = BoundRates(problems.pose(
        dynamics, 'u**2 + w**2', (1, 2), 1, inputs=['u', 'w'], parameters={'k': 2}))
    assert bounds.orders[0] == order
    assert (0 in bounds.slides) == slides


def test_derivatives_of_a_sliding_constraint_are_those_of_its_factor():
    """d(px^2 + py^2)/dt = s g, s = vl + vr and g = px cos th + py sin th."""
    problem = problems.build(WHEELS)
    bounds = BoundRates(problem, {DISC: 1.5})
    assert bounds.orders[DISC] == 2
    assert bounds.following.tolist() == [False] * 3 + [True]
    x, u = np.array([0.3, -0.8, 1.1]), np.array([0.9, 0.4])
    values = ca.Function('chain', [problem.x, problem.u, problem.p], bounds.chains[DISC])
    c, g, rate = (float(each) for each in values(x, u, problem.p_value))
    cos, sin, v, w = np.cos(x[2]), np.sin(x[2]), 0.65, -0.5 / 0.4
    assert c == pytest.approx(0.3**2 + 0.8**2)
    assert g == pytest.approx(1.5 * (x[0] * cos + x[1] * sin))
    assert rate == pytest.approx(1.5 * (v + w * (x[1] * cos - x[0] * sin)))
    s, other = bounds.factors[DISC](x, u, problem.p_value)
    assert float(s) == pytest.approx(1.3 / 1.5)
    assert float(other) == pytest.approx(g)


@pytest.mark.parametrize(('inputs', 'speed'), [
    ((1, 0.8), 1.8), ((-1, -0.8), -1.8), ((1, -1), None), ((1e-3, 1e-3), None)])
def test_a_path_slides_if_it_moves_along_the_bound(inputs, speed):
    """It does not if it turns on the spot, or is slower than its direction is tangential."""
    problem, turn = problems.build(WHEELS), np.linspace(-1, 1, 9)
    far = np.maximum(np.abs(turn) - 0.5, 0)   # the middle points are at the bound
    x = np.column_stack([np.sin(turn) * (1 + far), np.cos(turn) * (1 + far), 1e-3 - turn])
    u = np.where(far[:, None] > 0, [1.0, 1.0], inputs)
    path = build_path(turn + 1, x, u[:-1], u[1:], np.array([2.0]))
    contact = StateContact(DISC, -1, 0.6, 1.2, 0.0)
    wanted = {} if speed is None else {DISC: pytest.approx(speed)}
    assert find_sliding(problem, BoundRates(problem), path, [contact]) == wanted
    assert find_sliding(problem, BoundRates(problem), path, []) == {}


@pytest.mark.slow
def test_the_fastest_path_along_a_disc_is_found():
    """
    Two tangents of length sqrt(3), and the arc of pi/3 between them.

    The left wheel, outside of it, has full speed on a radius of 1.2.
    """
    solution = solve(problems.build(WHEELS))
    assert solution.status is Status.SOLVED
    assert solution.objective == pytest.approx(2 * math.sqrt(3) + 1.2 * math.pi / 3, rel=1e-6)
    assert solution.path_multipliers.min() < 0
