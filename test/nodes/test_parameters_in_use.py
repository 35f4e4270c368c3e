# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Every parameter of the nodes has an effect or is refused."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from obc_ros.core.lqr.design.reference_tracking import read_course
from obc_ros.core.systems import registry
from obc_ros.core.text.errors import ObcError
from obc_ros.nodes import plant_simulator, trajectory_server
from obc_ros.nodes.lqr import settings as lqr_settings
from obc_ros.nodes.mpc import settings as mpc_settings
from obc_ros.ros.parameters.node_parameters import Parameters
from obc_ros.workers.wire import pack
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter

Values = Mapping[str, Any]


class ControlEffect:
    """
    What the settings of lqr_node change.

    The control and the settings read at each message are compared first. Only if they are equal
    is the law of a reference computed, which takes half a second.
    """

    def __init__(self, settings: Any) -> None:
        self.settings = settings
        control = lqr_settings.judge_lqr_settings(settings).control
        self.first = repr(control), settings.frame_id, settings.hardware_id

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ControlEffect) and (
            self.first == other.first and self.follow() == other.follow())

    def follow(self) -> Any:
        """Return what is allowed along a reference, and its law in the middle."""
        system = registry.get_system(self.settings.system)
        t, x = np.linspace(0.0, 1.0, 5), np.tile(system.setpoint, (5, 1))
        u = np.tile(system.setpoint_input, (5, 1))
        leg = lqr_settings.judge_lqr_settings(self.settings, (read_course(
            system, (system.state_names, system.input_names), t, x.ravel(), u.ravel(), '', 1),)
        ).control.legs[0]
        return leg.allowed, leg.along.at(0.5)


def plan_effect(settings: Any) -> Any:
    """Return the control and the problem of mpc_node, and the settings read at each message."""
    found = mpc_settings.judge_mpc_settings(settings)
    return (repr(found.control), pack(found.problem), settings.frame_id, settings.hardware_id,
            settings.plan_rate)


def server_effect(settings: Any) -> Any:
    """Return the settings, all of which the server reads at each request."""
    return repr(settings)


NODES: dict[str, tuple[Any, Callable[[Any], Any], Callable[[Any], Any]]] = {
    'lqr_node': (lqr_settings.Settings, lqr_settings.judge_lqr_settings, ControlEffect),
    'mpc_node': (mpc_settings.Settings, mpc_settings.judge_mpc_settings, plan_effect),
    'plant_simulator': (plant_simulator.Settings, plant_simulator.judge_plant_settings,
                        lambda settings: (
                            repr(plant_simulator.judge_plant_settings(settings)),
                            settings.hardware_id)),
    'trajectory_server': (trajectory_server.Settings, lambda settings: settings, server_effect)}

# For each parameter that can be changed: a new value, and the values that must be set before.
# Without these the new value is refused.
LQR: dict[str, tuple[Any, Values]] = {
    'system_parameters.m': (5.0, {}), 'system_parameters.J': (0.05, {}),
    'system_parameters.r': (0.3, {}), 'system_parameters.g': (9.81, {}),
    'system_parameters.c': (0.1, {}),
    'setpoint': ([1.0] + 5 * [0.0], {}), 'setpoint_input': ([0.0, 30.0], {}),
    'weights': ('matrices', {'weights': 'bryson', 'x_max': [2.0] * 6}),
    'Qx': ([2.0] * 6, {}), 'Qu': ([2.0, 1.0], {}), 'cross': ([0.1] + 11 * [0.0], {}),
    'x_max': ([2.0] * 6, {'weights': 'bryson'}), 'u_max': ([2.0, 3.0], {'weights': 'bryson'}),
    'H': ([2.0] + 6 * [0.0] + [2.0] + 4 * [0.0], {'weights': 'output'}),
    'rho': (2.0, {'weights': 'output'}),
    'stability': (0.5, {}), 'integral': (['px'], {}), 'Qi': ([2.0], {'integral': ['px']}),
    'design': ('sampled', {'rate': 50.0}), 'rate': (50.0, {}),
    'sample_time': (0.05, {'rate': 50.0, 'design': 'sampled'}), 'delay': (0.02, {'rate': 50.0}),
    'horizon': (2.0, {}), 'P1': ([3.0] * 6, {}),
    'schedule': ('', {'system': 'vehicle', 'setpoint_input': [2.0, 0.0], 'unlimited': True,
                      'schedule': 'v', 'schedule_range': [1.0, 3.0]}),
    'schedule_range': ([1.0, 4.0], {'system': 'vehicle', 'setpoint_input': [2.0, 0.0],
                                    'unlimited': True, 'schedule': 'v'}),
    'state_timeout': (0.1, {}), 'on_stale': ('hold', {}), 'stamp_timeout': (0.1, {}),
    'u_limits': ([9.0, 60.0], {}),
    'unlimited': (False, {'u_limits': [9.0, 60.0]}),
    'x_limits': ([1.0] * 6, {}), 'on_envelope': ('hold', {'x_limits': [1.0] * 6}),
    'start_tolerance': ([0.5] * 6, {}), 'hardware_id': ('h1', {}),
    'transition_time': (0.5, {}), 'frame_id': ('map', {})}
MPC: dict[str, tuple[Any, Values]] = {
    **{name: LQR[name] for name in LQR if name not in (
        'stability', 'integral', 'Qi', 'design', 'rate', 'sample_time', 'delay', 'P1',
        'horizon', 'schedule', 'schedule_range', 'start_tolerance')},
    'horizon': (2.0, {}), 'x_bounds': ([-1.0, 1.0] * 6, {}),
    'path_constraints': (['px - 3'], {}), 'deadline': (0.01, {}), 'plan_rate': (1.0, {}),
    'on_unplanned': ('hold', {})}
STATES = ('px', 'py', 'theta', 'vx', 'vy', 'omega')
OUTPUTS = ('gps_x', 'gps_y', 'attitude', 'gyro')
MEASURED = ('noise', 'bias', 'dropout', 'delay')
PLANT: dict[str, tuple[Any, Values]] = {
    **{f'system_parameters.{name}': (value, {}) for name, value in (
        ('m', 5.0), ('J', 0.05), ('r', 0.3), ('g', 9.81), ('c', 0.1))},
    'x0': ([1.0] + 5 * [0.0], {}), 'speed': (2.0, {}), 'integrator': ('adaptive', {}),
    'tolerance': (1e-6, {'integrator': 'adaptive'}), 'actuator_lag': ([0.1, 0.1], {}),
    'input_delay': (0.1, {}), 'hardware_id': ('h1', {}), 'command_timeout': (0.5, {}),
    'markers': (False, {}), 'marker_rate': (10.0, {}), 'trail_length': (50, {}),
    'hold_until_command': (False, {}), 'pause_at': (3.0, {}), 'seed': (3, {'noise.px': 0.1}),
    **{f'noise.{name}': (0.1, {}) for name in STATES},
    **{f'disturbance.constant.{name}': (0.1, {}) for name in STATES},
    **{f'disturbance.gust.{name}': (0.1, {}) for name in STATES},
    'disturbance.gust_start': (1.0, {'disturbance.gust.vx': 0.1}),
    'disturbance.gust_duration': (2.0, {'disturbance.gust.vx': 0.1}),
    **{f'measurement.{name}.rate': (10.0, {}) for name in OUTPUTS},
    **{f'measurement.{name}.{each}': (0.1, {f'measurement.{name}.rate': 10.0})
       for name in OUTPUTS for each in MEASURED}}
SERVER: dict[str, tuple[Any, Values]] = {
    'workers': (3, {}), 'time_limit': (5.0, {}), 'max_intervals': (100, {}),
    'cache_size': (3, {}), 'queue_length': (3, {}), 'hardware_id': ('h1', {}),
    'markers': (False, {}), 'state_timeout': (0.2, {}), 'plan_lead': (2.0, {}),
    'execute_feasible': (True, {})}
TABLES = {'lqr_node': LQR, 'mpc_node': MPC, 'plant_simulator': PLANT, 'trajectory_server': SERVER}
CASES = [(node, name) for node, table in TABLES.items() for name in table]
# The parameters that have an effect only under a condition, and start values under which they have
# none (empty where the defaults suffice).
CONDITIONAL: dict[tuple[str, str], Values] = {
    **{('lqr_node', name): {} for name in (
        'x_max', 'u_max', 'H', 'rho', 'Qi', 'sample_time', 'schedule_range')},
    **{('mpc_node', name): {} for name in (
        'x_max', 'u_max', 'H', 'rho')},
    **{(node, name): {'weights': 'bryson'}
       for node in ('lqr_node', 'mpc_node') for name in ('Qx', 'Qu')},
    **{(node, 'on_stale'): {'state_timeout': 0.0} for node in ('lqr_node', 'mpc_node')},
    **{('plant_simulator', name): {} for name in (
        'tolerance', 'seed', 'disturbance.gust_start', 'disturbance.gust_duration',
        *(f'measurement.{output}.{each}' for output in OUTPUTS for each in MEASURED))},
    **{('plant_simulator', name): {'lockstep': True}
       for name in ('command_timeout', 'hold_until_command')},
    **{('plant_simulator', name): {'markers': False} for name in ('marker_rate', 'trail_length')}}


class Bench:
    """The parameters of a node, without the rest of the node."""

    def __init__(self, context: Any, name: str, given: Values) -> None:
        self.table, judge, self._effect = NODES[name]
        self.node = Node(name, context=context, allow_undeclared_parameters=True,
                         parameter_overrides=[Parameter(key, value=value)
                                              for key, value in given.items()])
        try:
            self.parameters: Any = Parameters(self.node, self.table, judge, lambda _: None)
        except ObcError:
            self.node.destroy_node()
            raise

    @property
    def effect(self) -> Any:
        return self._effect(self.parameters.settings)

    def set(self, **values: Any) -> Any:
        return self.node.set_parameters_atomically(
            [Parameter(key, value=value) for key, value in values.items()])

    def names(self) -> Iterator[str]:
        """Yield the parameters of the table that can be changed."""
        yield from (each for each in self.parameters._entries
                    if not self.node.describe_parameter(each).read_only)


@pytest.fixture
def start(probe: Any) -> Iterator[Callable[..., Bench]]:
    """Yield a function that makes a bench for a node and its start values."""
    made: list[Bench] = []

    def begin(name: str, given: Values) -> Bench:
        made.append(Bench(probe.context, name, given))
        return made[-1]

    yield begin
    for bench in made:
        bench.node.destroy_node()


@pytest.mark.parametrize('name', NODES)
def test_the_tables_of_this_file_have_every_parameter(start: Any, name: str) -> None:
    """A new parameter needs a line in the tables above."""
    bench = start(name, {})
    assert set(bench.names()) == set(TABLES[name])
    assert {each for each in bench.names() if bench.parameters._entries[each].used_when} == {
        each for node, each in CONDITIONAL if node == name}


@pytest.mark.parametrize(('node', 'name'), CASES)
def test_a_parameter_has_an_effect_or_is_refused(start: Any, node: str, name: str) -> None:
    """Check with the defaults of the node, and with the values that the parameter needs."""
    value, needed = TABLES[node][name]
    plain = start(node, {key: each for key, each in needed.items()
                         if key in ('system', 'setpoint_input', 'unlimited')})
    before = plain.effect
    result = plain.set(**{name: value})
    if not result.successful:
        assert result.reason
        assert plain.effect == before
    elif not needed:
        assert plain.effect != before
    if not needed:
        assert result.successful or name == 'setpoint_input'  # determined by the set point
        return
    bench = start(node, needed)
    before = bench.effect
    result = bench.set(**{name: value})
    assert result.successful, result.reason
    assert bench.effect != before or name == 'unlimited'  # tested in test_robot_start.py


@pytest.mark.parametrize(('node', 'name'), CONDITIONAL)
def test_an_unused_parameter_is_refused_with_its_condition(start: Any, node: str, name: str
                                                           ) -> None:
    """Also at the start, with the values to write; the default value is always accepted."""
    without, value = CONDITIONAL[node, name], TABLES[node][name][0]
    bench = start(node, without)
    entry = bench.parameters._entries[name]
    before = bench.effect
    reason = bench.set(**{name: value}).reason
    assert reason.startswith(f'{name} is not used with ')
    assert reason.endswith(' first, or both with set_parameters_atomically') or (
        '; start the node with ' in reason)
    assert bench.effect == before
    default = entry.ros(entry.default).value
    assert bench.set(**{name: default}).successful
    with pytest.raises(ObcError, match=f'^{name} is not used with .*; write .*, or leave {name} '):
        start(node, {**without, name: value})
    start(node, {**without, name: default})


def test_a_parameter_that_becomes_unused_is_reset(start: Any) -> None:
    """A parameter with a value other than its default is therefore in use."""
    bench = start('lqr_node', {'weights': 'bryson', 'x_max': [2.0] * 6, 'u_max': [1.0, 2.0]})
    assert bench.set(weights='matrices').successful
    assert bench.parameters.settings.x_max == () == bench.parameters.settings.u_max
    assert bench.node.get_parameter('x_max').value == []
    assert bench.set(Qx=[2.0] * 6).successful
    assert not bench.set(weights='bryson', Qx=[3.0] * 6).successful  # checked together
    assert bench.parameters.settings.Qx == (2.0,) * 6
    assert bench.set(weights='bryson', x_max=[3.0] * 6).successful
    assert bench.parameters.settings.Qx == ()
    assert bench.set(weights='bryson', Qx=[], x_max=[3.0] * 6).successful  # the present value
