# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Problem files that give mpc_node and plant_simulator their parameters; a flight with one."""

from collections.abc import Callable, Iterator, Mapping
import math
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.text.errors import ObcError
from obc_ros.core.text.expressions import parse_expression
from obc_ros.msg import State
from obc_ros.nodes import plant_simulator
from obc_ros.nodes.mpc import settings as mpc_settings
from obc_ros.ros.parameters.node_parameters import Parameters
from obc_ros.workers.wire import Packet
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from support import DEMO
import yaml

LONG = 90.0   # [s] reached only by a failing test
INF = math.inf
NAMES = ('px', 'py', 'theta', 'vx', 'vy', 'omega')
# The aircraft with a limit of each kind, and parameters that state the same.
AIRCRAFT: dict[str, Any] = {
    'system': 'aircraft', 'parameters': {'m': 5, 'r0': 0.5},
    'running_cost': '10*(px - 1)**2 + 2*py**2 + theta**2 + vx**2 + vy**2 + omega**2 + (px - 1)*py '
                    '+ 0.1*f1**2 + 0.2*(f2 - m*g)**2 + 0.02*theta*f1',
    'initial_state': dict.fromkeys(NAMES, 0), 'final_time': {'free': False, 'value': 0.4},
    'input_bounds': {'f1': [-6, 6], 'f2': [20, 70]}, 'state_bounds': {'theta': [-0.2, 0.2]},
    'path_constraints': [{'expr': '(px + 2)**2 + py**2', 'lower': 'r0**2', 'upper': '10*m'},
                         {'expr': 'f1 + px', 'upper': 9}]}
QX = np.diag([10.0, 2.0, 1.0, 1.0, 1.0, 1.0])
QX[0, 1] = QX[1, 0] = 0.5
GIVEN: dict[str, Any] = {
    'system': 'aircraft', 'system_parameters.m': 5.0, 'setpoint': [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    'Qx': QX.ravel().tolist(), 'Qu': [0.1, 0.2], 'cross': [0.0] * 4 + [0.01] + [0.0] * 7,
    'u_limits': [-6.0, 6.0, 20.0, 70.0],
    'x_bounds': [-INF, INF] * 2 + [-0.2, 0.2] + [-INF, INF] * 3,
    'path_constraints': ['(px + 2)**2 + py**2 - 10*m', '0.25 - (px + 2)**2 - py**2',
                         'f1 + px - 9'], 'horizon': 0.4}
CART: dict[str, Any] = {
    'name': 'cart', 'states': ['x', 'y', 'vx', 'vy'], 'inputs': ['ax', 'ay'],
    'parameters': {'c': 0.1, 'r': 0.5},
    'dynamics': {'x': 'vx', 'y': 'vy', 'vx': 'ax - c*vx', 'vy': 'ay - c*vy'},
    'running_cost': '(x - 1)**2 + y**2 + vx**2 + vy**2 + ax**2 + ay**2',
    'initial_state': {'x': -1, 'y': 0.1, 'vx': 0, 'vy': 0},
    'final_time': {'free': False, 'value': 2}, 'input_bounds': {'ax': [-2, 2], 'ay': [-2, 2]},
    'state_bounds': {'vx': [-0.8, 0.8]},
    'path_constraints': [{'expr': 'x**2 + y**2', 'lower': 'r**2'}]}
Start = Callable[..., Parameters]


@pytest.fixture
def write(tmp_path: Path) -> Callable[[object], str]:
    """Return a function that writes a problem file and returns its path."""
    def write_yaml(content: object) -> str:
        path = tmp_path / 'problem.yaml'
        path.write_text(yaml.safe_dump(content, sort_keys=False), encoding='utf-8')
        return str(path)

    return write_yaml


@pytest.fixture
def start(probe: Any) -> Iterator[Start]:
    """Yield a function that returns the parameters of a node, without the rest of it."""
    made: list[Node] = []

    def begin(module: Any, judge: Callable[[Any], Any], **given: Any) -> Parameters:
        made.append(Node('it', context=probe.context, allow_undeclared_parameters=True,
                         parameter_overrides=[Parameter(name, value=value)
                                              for name, value in given.items()]))
        return Parameters(made[-1], module.Settings, judge, lambda _: None)

    yield begin
    for node in made:
        node.destroy_node()


def begin_mpc(start: Start, **given: Any) -> Parameters:
    """Return the parameters of mpc_node."""
    return start(mpc_settings, mpc_settings.judge_mpc_settings, **given)


def evaluate_rows(problem: Packet, points: np.ndarray) -> np.ndarray:
    """Return the path constraints of a problem of the aircraft at points (px, py, f1)."""
    symbols = {name: ca.SX.sym(name) for name in ('px', 'py', 'f1')}
    rows = ca.vertcat(*(parse_expression(text, {**symbols, 'm': ca.SX(5.0)}, 'row')
                        for text in problem.plain['path_constraints']))
    return ca.Function('rows', [ca.vertcat(*symbols.values())], [rows]).map(len(points))(
        points.T).full()


def test_the_problem_of_a_file_is_that_of_its_parameters(start: Start,
                                                         write: Callable[[object], str]) -> None:
    """The solver process gets the same numbers, to rounding errors."""
    found = begin_mpc(start, problem=write(AIRCRAFT)).candidate.problem
    wanted = begin_mpc(start, **GIVEN).candidate.problem
    points = np.random.default_rng(0).uniform(-3.0, 3.0, (20, 3))
    np.testing.assert_allclose(evaluate_rows(found, points), evaluate_rows(wanted, points),
                               rtol=1e-12, atol=1e-12)
    plain, given = ({name: value for name, value in each.plain.items()
                     if name not in ('path_constraints', 'setpoint')} for each in (found, wanted))
    assert plain == given
    np.testing.assert_allclose(found.plain['setpoint'], wanted.plain['setpoint'], atol=1e-12)
    assert found.arrays.keys() == wanted.arrays.keys()
    for name, array in wanted.arrays.items():
        np.testing.assert_allclose(found.arrays[name], array, rtol=1e-12, atol=1e-12,
                                   err_msg=name)


def test_the_plant_of_a_file_is_the_system(start: Start, write: Callable[[object], str]) -> None:
    """Its parameters can be changed, and its constraints follow them."""
    path = write(CART)
    parameters = begin_mpc(start, problem=path)
    settings = parameters.settings
    assert (settings.system, settings.system_parameters) == (path, {'c': 0.1, 'r': 0.5})
    assert (settings.setpoint, settings.horizon) == ((1.0, 0.0, 0.0, 0.0), 2.0)
    assert settings.path_constraints == ('(r**2) - (x**2 + y**2)',)
    assert parameters.candidate.control.limits.upper == (2.0, 2.0)


def test_given_values_override_those_of_the_file(start: Start, write: Callable[[object], str]
                                                 ) -> None:
    """The others stay; values can be changed and reset as always."""
    path = write(CART)
    settings = begin_mpc(start, problem=path, Qu=[3.0, 3.0], horizon=1.0,
                         **{'system_parameters.r': 0.4}).settings
    assert (settings.Qu, settings.horizon, settings.Qx) == ((3.0, 3.0), 1.0, (1.0,) * 4)
    assert settings.system_parameters == {'c': 0.1, 'r': 0.4}
    cost = CART['running_cost'].replace('ax**2', '2*ax**2')
    parameters = begin_mpc(start, problem=write({**CART, 'running_cost': cost}), weights='bryson')
    node = parameters._node
    assert node.set_parameters([Parameter('weights', value='matrices')])[0].successful
    assert parameters.settings.Qu == (2.0, 1.0)
    assert node.set_parameters([Parameter('Qu', value=[7.0, 7.0])])[0].successful
    assert parameters.settings.Qu == (7.0, 7.0)


@pytest.mark.parametrize(('row', 'words'), [
    ('0.25 - (pxx - 2)**2 - py**2', "unknown name 'pxx'"), ('px -', 'syntax error'),
    ('t - px', 't: a receding horizon'), ('1 - px', 'at the set point')])
def test_path_constraints_are_judged_without_the_solver_process(start: Start, row: str, words: str
                                                                ) -> None:
    """An inactive node does not wait for its process, and refuses what cannot be read."""
    parameters = begin_mpc(start, system='aircraft', unlimited=True)
    change = Parameter('path_constraints', value=[row])
    result = parameters._node.set_parameters([change])[0]
    assert not result.successful
    assert words in result.reason
    assert parameters.settings.path_constraints == ()


@pytest.mark.parametrize(('change', 'words'), [
    ({'running_cost': 'x**4 + ax**2 + ay**2'}, 'running_cost: wanted a quadratic'),
    ({'running_cost': 'x**2 - y**2 + ax**2 + ay**2'}, 'Qx'),
    ({'final_time': {'free': True, 'lower': 1, 'upper': 2}}, 'final_time: '),
    ({'final_time': {'free': False, 'value': 2000}}, 'horizon = 2000: wanted'),
    ({'final_time': {'free': False, 'value': 200}}, 'horizon = 200 s: 10000 periods'),
    ({'dynamics': {'x': 'vx', 'y': 'vy', 'vx': 'ax*t', 'vy': 'ay'}}, 't: a receding horizon'),
    ({'state_bounds': {'vx': [0, 0]}}, 'x_bounds of vx: '),
    ({'no_such_key': 1}, 'no_such_key: unknown key')])
def test_a_problem_that_the_node_cannot_take_is_refused(
        start: Start, write: Callable[[object], str], change: Mapping[str, Any], words: str
        ) -> None:
    """The sentence has the key, or the parameter that it gives."""
    with pytest.raises(ObcError, match=words):
        begin_mpc(start, problem=write({**CART, **change}))


def test_a_name_that_is_no_problem_is_refused(start: Start, write: Callable[[object], str],
                                              tmp_path: Path) -> None:
    """A missing file, several problems, and hostile content."""
    with pytest.raises(ObcError, match='cannot be read: No such file'):
        begin_mpc(start, problem=str(tmp_path / 'none.yaml'))
    with pytest.raises(ObcError, match="'hover_hol' is neither a YAML file nor an example.*"
                                       "'hover_hold'"):
        begin_mpc(start, problem='hover_hol')
    with pytest.raises(ObcError, match='2 problems; wanted a file with one'):
        begin_mpc(start, problem=write([CART, CART]))
    for content in (None, 7, 'text', [], {'states': 5}, {'a': {'b': 'c'}}, '\0' * 9):
        with pytest.raises(ObcError, match='^problem = '):
            begin_mpc(start, problem=write(content))


def test_an_example_has_a_name(start: Start) -> None:
    """As for `obc solve`."""
    settings = begin_mpc(start, problem='lq_cubic_free', unlimited=True).settings
    assert Path(settings.system).name == 'lq_cubic_free.yaml'
    assert (settings.Qx, settings.Qu, settings.horizon) == ((0.5,), (0.5,), 15.0)


def test_another_system_beside_a_problem_is_refused(start: Start, write: Callable[[object], str]
                                                    ) -> None:
    """The values of the file do not fit it."""
    with pytest.raises(ObcError, match='gives system_parameters.m, but there is no such'):
        begin_mpc(start, problem=write(AIRCRAFT), system='vehicle')


@pytest.mark.parametrize('statement', [AIRCRAFT, CART])
def test_the_plant_begins_at_the_initial_state(start: Start, write: Callable[[object], str],
                                               statement: Mapping[str, Any]) -> None:
    """One file serves both nodes."""
    path = write(statement)
    plant = start(plant_simulator, plant_simulator.judge_plant_settings, problem=path).settings
    assert plant.x0 == tuple(statement['initial_state'].values())
    control = begin_mpc(start, problem=path).settings
    assert (plant.system, plant.system_parameters) == (control.system, control.system_parameters)


def test_the_construction_of_a_system_is_that_of_the_file(start: Start,
                                                          write: Callable[[object], str]) -> None:
    """The matrices of a linear system are rows in a file and one list in a parameter."""
    parameters = begin_mpc(start, problem=write({
        'system': 'linear', 'parameters': {'A': [[0, 1], [0, 0]], 'B': [[0], [1]]},
        'running_cost': 'x1**2 + x2**2 + u1**2', 'initial_state': {'x1': 1, 'x2': 0},
        'final_time': {'free': False, 'value': 1}}), unlimited=True)
    given = parameters.settings.system_parameters
    assert (given['A'], given['B']) == ((0.0, 1.0, 0.0, 0.0), (0.0, 1.0))


@pytest.mark.slow
@pytest.mark.nodes
def test_plant_and_controller_of_one_file_go_around_its_obstacle(
        spawn: Any, probe: Any, write: Callable[[object], str]) -> None:
    """The straight way leads through the obstacle; a live change of weights is adopted."""
    path = write(CART)
    states = probe.listen(State, 'state', QoSProfile(depth=1000))
    spawn('plant_simulator', {'problem': path, 'publish_rate': 20.0, 'lockstep': True})
    # The plant repeats its first state until a command comes: it is heard before that.
    probe.wait_for(lambda: states, what='the first state')
    node = spawn('mpc_node', {**DEMO, 'problem': path, 'rate': 20.0, 'stamp_timeout': 0.0})
    goal = np.array([1.0, 0.0, 0.0, 0.0])
    probe.wait_for(lambda: states and np.abs(states[-1].x - goal).max() < 0.02, LONG, 'the goal')
    x = np.array([each.x for each in states])
    np.testing.assert_allclose(x[0], list(CART['initial_state'].values()))
    assert np.hypot(x[:, 0], x[:, 1]).min() >= 0.5 * 0.98
    assert np.abs(x[:, 2]).max() <= 0.8 * 1.02
    assert 'it gives system, setpoint, Qx' in node.output()
    assert probe.set_parameters('/mpc_node', Qx=[4.0, 4.0, 1.0, 1.0])[0].successful
    refused = probe.set_parameters('/mpc_node', problem='other.yaml')[0]
    assert not refused.successful
