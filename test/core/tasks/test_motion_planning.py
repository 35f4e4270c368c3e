# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Motion planning for registered systems: the stated problem and known solutions."""

from dataclasses import replace
import math

from casadi import Function
from hypothesis import given, settings, strategies
import numpy as np
from obc_ros.core.ocp.solution import Status
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.systems import registry
from obc_ros.core.systems.reeds_shepp import find_shortest_path
from obc_ros.core.tasks.motion_planning import Motion, solve_motion, state_motion
from obc_ros.core.text.errors import ObcError
from obc_ros.workers import requests
from obc_ros.workers.wire import Packet
import pytest

PLANAR = Motion('double_integrator', [1.0, 0.0], [0.0, 0.0], 'effort')


def plan(motion, **plain):
    """Return the response of a worker to a motion request."""
    arrays = {'start': motion.start, 'goal': motion.goal, 'qx': motion.Qx, 'qu': motion.Qu}
    request = Packet(
        {'system': motion.system, 'objective': motion.objective, 'parameters': motion.parameters,
         'input_bounds': motion.input_bounds, 'state_bounds': motion.state_bounds,
         'path_constraints': motion.path_constraints, 'final_time': motion.final_time,
         'cache_size': 8, **plain},
        {name: np.array(values, float) for name, values in arrays.items()})
    return requests.answer('plan', request, 20.0, lambda *_: False)


def test_minimum_effort_of_a_double_integrator_is_a_cubic():
    T = 3.0  # x = 1 - 3 (t/T)^2 + 2 (t/T)^3
    response = plan(replace(PLANAR, final_time=T))
    assert response.plain['status'] == 'solved'
    assert response.plain['objective'] == pytest.approx(12 / T**3, rel=1e-9)
    s = response.arrays['t'] / T
    assert np.allclose(response.arrays['x'][:, 0], 1 - 3 * s**2 + 2 * s**3, atol=1e-6)
    assert np.allclose(response.arrays['u'][:, 0], (12 * s - 6) / T**2, atol=1e-6)


def test_minimum_time_of_a_double_integrator_is_two():
    # Full thrust for 1 s over half of the way, then full brake for 1 s.
    response = plan(replace(PLANAR, objective='time', input_bounds={'u': ['-1', '1']}))
    assert response.plain['status'] == 'solved'
    assert response.plain['objective'] == pytest.approx(2.0, abs=1e-6)
    assert response.arrays['t'][-1] == pytest.approx(2.0, abs=1e-6)


def test_minimum_time_of_the_robot_is_the_shortest_path():
    response = plan(Motion('two_wheeled', [0, 0, 0], [1, 1, 1.0], 'time'))
    assert response.plain['status'] == 'solved'
    assert response.plain['objective'] == pytest.approx(
        find_shortest_path((0, 0, 0), (1, 1, 1.0), 1.0).length, rel=1e-5)


def test_the_default_final_time_is_twice_the_minimum():
    bounds = {'u': ['-1', '1']}
    response = plan(replace(PLANAR, input_bounds=bounds))
    assert response.plain['status'] == 'solved'
    assert response.arrays['t'][-1] == pytest.approx(4.0, rel=1e-5)
    assert response.plain['objective'] == pytest.approx(12 / 4**3, rel=1e-5)


def test_weights_apply_to_deviations_from_goal_and_hover_input():
    goal = [1.0, 2.0, 0.0, 0.0, 0.0, 0.0]
    Qx, Qu = np.diag(np.arange(1.0, 7.0)), np.array([[2.0, 0.5], [0.5, 3.0]])
    Qx[0, 3] = Qx[3, 0] = 0.25
    problem = build_problem(state_motion(Motion(
        'aircraft', [0.0] * 6, goal, 'quadratic', Qx=Qx.ravel(), Qu=Qu.ravel(), final_time=5.0)))
    L = Function('L', [problem.x, problem.u, problem.p], [problem.L])
    rng = np.random.default_rng(3)
    hover = np.array([0.0, 4 * 9.8])
    for _ in range(5):
        x, u = rng.normal(size=6), rng.normal(size=2)
        dx, du = x - goal, u - hover
        assert float(L(x, u, problem.p_value)) == pytest.approx(dx @ Qx @ dx + du @ Qu @ du)


def test_numerical_values_do_not_change_the_structure():
    def structure(**changes):
        return build_problem(state_motion(replace(
            Motion('aircraft', [0] * 6, [1, 1, 0, 0, 0, 0], 'quadratic', final_time=3.0),
            **changes))).structure
    assert structure() == structure(goal=[2, 3, 0.5, 0, 0, 0], start=[1] * 6, final_time=4.0,
                                    parameters={'m': 5}, Qu=[0.1, 7])


@settings(deadline=None, max_examples=30)
@given(strategies.floats(-50, 50), strategies.floats(-50, 50))
def test_the_nearest_equivalent_goal_angle_is_chosen(start, goal):
    mapping = state_motion(Motion('two_wheeled', [0, 0, start], [1, 1, goal], 'time'))
    chosen = mapping['parameters']['goal_theta']
    assert abs(chosen - start) <= math.pi + 1e-9
    assert math.remainder(chosen - goal, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize('changes, words', [
    ({'system': 'zeppelin'}, 'zeppelin'), ({'system': '/etc/plant.yaml'}, 'unknown system'),
    ({'objective': 'beauty'}, "objective = 'beauty'"), ({'objective': ''}, 'objective'),
    ({'start': [1.0]}, 'start: wanted 2 numbers'), ({'goal': [1.0, math.inf]}, 'goal: x2 = inf'),
    ({'parameters': {'mass': 3}}, 'mass'), ({'parameters': {'m': 'x'}}, 'm'),
    ({'input_bounds': {'w': ['0', '1']}}, "'w' is not an input"),
    ({'input_bounds': {'u': ['2', '1']}}, 'cross'), ({'Qu': [1, 2, 3]}, 'qu'),
    ({'objective': 'quadratic', 'Qx': [math.nan, 1]}, 'qx'), ({'final_time': -1.0}, 'final_time'),
    ({'objective': 'time', 'input_bounds': {'u': ['0', None]}}, 'no upper bound'),
])
def test_malformed_motions_are_rejected(changes, words):
    with pytest.raises(ObcError, match='.') as error:
        build_problem(state_motion(replace(PLANAR, **changes)))
    assert words in str(error.value)


def test_the_tighter_bounds_apply():
    def bounds(**given):
        problem = build_problem(state_motion(Motion(
            'two_wheeled', [0, 0, 0], [1, 1, 1], 'time', input_bounds=given)))
        return [*problem.u_lower, *problem.u_upper]
    assert bounds() == [-1, -1, 1, 1]
    assert bounds(v=['-0.5', '7'], omega=[None, '1/2']) == [-0.5, -1, 1, 0.5]
    assert registry.get_registered('two_wheeled').input_names == ('v', 'omega')


DISC = '0.25 - (px - 1)**2 - (py - 0.05)**2'


@pytest.mark.slow
def test_a_plan_keeps_off_an_obstacle_and_within_state_bounds():
    """The constraint and the bounds are evaluated along the answer; the plan touches both."""
    motion = Motion('two_wheeled', [0.0, 0.0, 0.0], [2.0, 0.0, 0.0], 'time',
                    path_constraints=[DISC], state_bounds={'py': ['-0.6', '1']})
    response = plan(motion)
    assert response.plain['status'] == 'solved', response.plain['message']
    px, py, _ = response.arrays['x'].T
    assert (0.25 - (px - 1)**2 - (py - 0.05)**2).max() == pytest.approx(0.0, abs=1e-3)
    assert py.min() >= -0.6 - 1e-6
    free = plan(replace(motion, path_constraints=()))
    assert free.plain['objective'] == pytest.approx(2.0, abs=1e-6)   # straight through
    assert response.plain['objective'] > 2.05


CART = {'name': 'cart', 'states': ['p', 'v'], 'inputs': ['a'], 'parameters': {'m': 2.0},
        'dynamics': {'p': 'v', 'v': 'a/m'}, 'input_bounds': {'a': ['-m', 'm']},
        'state_bounds': {'v': [-0.5, 0.5]}}


def test_a_plant_of_a_file_keeps_to_its_own_bounds():
    """Full thrust for 0.5 s, then the speed limit 0.5, then the brake: T = d/v + v/a."""
    motion = Motion('cart', [0.0, 0.0], [1.0, 0.0], 'time')
    response = plan(motion, plant=CART)
    assert response.plain['status'] == 'solved', response.plain['message']
    assert response.plain['objective'] == pytest.approx(1.0 / 0.5 + 0.5 / 1.0, abs=1e-5)
    assert response.plain['system'] == 'cart'
    # the limits follow the parameter: a = m still gives 1 m/s^2
    heavier = plan(replace(motion, parameters={'m': '4'}), plant=CART)
    assert heavier.plain['objective'] == pytest.approx(2.5, abs=1e-5)
    wider = plan(replace(motion, state_bounds={'v': ['-1', '1']}), plant=CART)
    assert wider.plain['objective'] == pytest.approx(2.5, abs=1e-5)   # the tighter one holds


@pytest.mark.parametrize(('changes', 'plain', 'words'), [
    ({'path_constraints': ['px +']}, {}, 'path_constraints[0]'),
    ({'path_constraints': ['1.0']}, {}, 'depends on no state and no input'),
    ({'path_constraints': ['__import__("os")']}, {}, 'path_constraints[0]'),
    ({'path_constraints': ['boat - 1']}, {}, "'boat'"),
    ({'state_bounds': {'v': ['0', '1']}}, {}, "'v' is not a state of two_wheeled"),
    ({'state_bounds': {'py': ['1', '0']}}, {}, 'py'),
    ({'state_bounds': {'py': ['nan', '0']}}, {}, 'py'),
    ({}, {'start_names': ['px', 'py', 'phi']}, 'has px, py, phi; wanted px, py, theta'),
    ({'parameters': {'boat': '1'}}, {'plant': CART}, "no parameter 'boat'"),
    ({}, {'plant': {**CART, 'parameters': {'goal_p': 1.0, 'm': 1.0}}}, 'rename it'),
])
def test_bad_constraints_names_and_plants_are_refused_in_words(changes, plain, words):
    start = [0.0] * (2 if 'plant' in plain else 3)
    response = plan(replace(Motion('two_wheeled', start, start, 'time'), **changes), **plain)
    assert response.plain['status'] == 'malformed'
    assert words in response.plain['message']


def test_a_time_that_is_up_at_once_is_not_negative():
    """To state the motion takes longer than its time limit."""
    motion = replace(PLANAR, final_time=1.0, path_constraints=['x2 - 2'])
    _, found = solve_motion(motion, 1e-9)
    assert found.status is Status.TIMED_OUT
    assert found.message.startswith('no certified solution within 0 s')
