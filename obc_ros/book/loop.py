# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Requests and parameters as `ros2` commands, recorded nodes, and a loop in lockstep."""

from array import array
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from obc_ros.cli.flight_client import Pilot, Samples
from obc_ros.cli.processes import Children
from obc_ros.cli.recording import Recorder
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import Command, LqrDesign, State, Trajectory
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger
import yaml

RESET = 'ros2 service call /plant_simulator/reset std_srvs/srv/Trigger'
DESIGN = 'ros2 topic echo --once /lqr_node/design obc_ros/msg/LqrDesign'
ATTEMPTS = 8
PACE = {'lockstep': True, 'speed': 1e6, 'dt': 0.005}  # speed 0 would publish a /clock
# A subscriber may fall behind for a moment: commands are queued. No state comes while the time is
# paused: this is no outage, after which a horizon would begin anew. In lockstep the stamps are
# those of the simulation.
PATIENT = {'qos_overrides./command.publisher.depth': 1000, 'state_timeout': 0.0,
           'stamp_timeout': 0.0}
SIMULATED = {'unlimited': True, 'transition_time': 0.0}   # no protections of a robot


def write_service_call(name: str, kind: Any, request: Any, node: str = 'trajectory_server'
                       ) -> str:
    """Return the command that sends a request to a node."""
    text = _quoted(_flow(drop_defaults(request)))
    return f'ros2 service call /{node}/{name} obc_ros/srv/{kind.__name__} {text}'


def run_node(node: str, parameters: Mapping[str, Any], renamed: Mapping[str, str] | None = None
             ) -> str:
    """Return the command that starts a node, with other names for topics."""
    given = ' '.join([*(f'-p {_argument(name, value)}' for name, value in parameters.items()),
                      *(f'-r {topic}:={name}' for topic, name in (renamed or {}).items())])
    return f'ros2 run obc_ros {node} --ros-args {given}'


def publish(topic: str, message: Any, file: Path) -> str:
    """Write a message without its stamp to a file; return the command that publishes it."""
    fields = {name: value for name, value in drop_defaults(message).items() if name != 'header'}
    for name, value in fields.items():
        if not isinstance(value, str):
            fields[name] = np.round(value, 9).tolist()
    file.write_text(_flow(fields) + '\n', encoding='utf-8')
    kind = type(message)
    place = Path(*file.parts[-3:])
    return (f'ros2 topic pub --once --keep-alive 2 --qos-durability transient_local /{topic} '
            f'obc_ros/msg/{kind.__name__} "$(cat {place})"')


def set_parameter(node: str, name: str, value: Any) -> str:
    """Return the command that sets a parameter."""
    return f'ros2 param set /{node} {name} {_quoted(_flow(_value(value)))}'


def write_argument(name: str, value: Any) -> str:
    """Return ``name:=value`` as an argument of a node."""
    return f'{name}:={_flow(_value(value))}'


def drop_defaults(message: Any) -> Any:
    """Return a message as plain values for YAML, without fields at their defaults."""
    if hasattr(message, 'get_fields_and_field_types'):
        fields = {name: drop_defaults(getattr(message, name))
                  for name in message.get_fields_and_field_types()}
        return {name: value for name, value in fields.items()
                if value not in ('', [], {}, 0.0, False)}
    if isinstance(message, (array, list)):
        return [drop_defaults(each) for each in message]
    return message


def _argument(name: str, value: Any) -> str:
    text = write_argument(name, value)
    return _quoted(text) if ' ' in text or '[' in text else text


def _value(value: Any) -> Any:
    if isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, list) and value and isinstance(value[0], str):
        return value
    numbers = np.asarray(value, dtype=float)
    return numbers.ravel().tolist() if numbers.ndim else float(numbers)


def _flow(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=10**9, sort_keys=False)
    return text.removesuffix('\n').removesuffix('\n...').strip()


def _quoted(text: str) -> str:
    for character in '\\"$`':
        text = text.replace(character, f'\\{character}')
    return f'"{text}"'


class UnansweredError(ObcError):
    """The nodes have no result that an entry needs."""


@dataclass(frozen=True, eq=False)
class Run:
    """States x (N, n) at t (N,) [s] since the reset, and the inputs u (N, m) for them."""

    t: Array
    x: Array
    u: Array


@dataclass(frozen=True, eq=False)
class RecordedNodes:
    """Nodes as processes, and the client that records their topics."""

    children: Children
    recorder: Recorder
    pilot: Pilot

    def start(self, node: str, parameters: Mapping[str, Any],
              renamed: Mapping[str, str] | None = None) -> None:
        """Start a node with parameters, and with other names for topics."""
        self.children.start(
            node, *(word for name, value in parameters.items()
                    for word in ('-p', write_argument(name, value))),
            *(word for topic, name in (renamed or {}).items()
              for word in ('-r', f'{topic}:={name}')))


@contextmanager
def record_nodes(folder: Path, controller: str) -> Iterator[RecordedNodes]:
    """Yield a client of `controller` that starts nodes; all of them end with the block."""
    with (Children(folder / 'log') as children, Recorder(folder) as recorder,
          closing(Pilot(children, recorder, controller=controller)) as pilot):
        yield RecordedNodes(children, recorder, pilot)


class NodeLoop:
    """A running loop whose time is paused between runs."""

    def __init__(self, pilot: Pilot, recorder: Recorder, note: Callable[[str], None]) -> None:
        self._pilot = pilot
        self._folder = recorder.folder
        self._note = note
        self._before = 0  # [ns] of earlier runs: the times of the recording increase
        recorder.now = lambda: self._before + (pilot.states.stamp or [0])[-1]

    @property
    def design(self) -> LqrDesign:
        """Return the design in use."""
        return self._pilot.designs[-1]

    def set(self, node: str = 'lqr_node', **values: Any) -> None:
        """Set parameters of a node as one and wait for the design; UnansweredError if rejected."""
        pilot = self._pilot
        revision = self.design.revision
        done, reason = pilot.set_parameters(node, values)
        if not done:
            raise UnansweredError(f'{node} rejects {values}: {reason}')
        for name, value in values.items():
            self._note(set_parameter(node, name, value))
        if node == 'lqr_node':
            pilot.wait(lambda: self.design.revision > revision, 'the new design')

    def run(self, duration: float, reference: Trajectory | None = None, name: str = 'reference'
            ) -> Run:
        """
        Reset the plant, run the loop for `duration` [s], along a reference if given.

        The reference is written to a file called `name`, for the command that publishes it.
        """
        self._note(RESET)
        if reference:
            self._note(publish('reference', reference, self._folder / f'{name}.yaml'))
        for _ in range(ATTEMPTS):
            found = self._run(round(duration * 1e9), reference)
            if found:
                return found
        raise UnansweredError('states or commands of the loop were lost in transit')

    def _run(self, end: int, reference: Trajectory | None) -> Run | None:
        pilot = self._pilot
        begin, answered = len(pilot.states.stamp), len(pilot.commands.stamp)
        self._before += pilot.states.stamp[-1]
        pilot.call(Trigger, 'plant_simulator/reset', Trigger.Request())
        pilot.wait(lambda: 0 in pilot.states.stamp[begin:], 'the state after the reset')
        if reference:
            said = len(pilot.said)
            pilot.publisher.publish(reference)
            # Not the end of an earlier one, or that it is given up: such a line may come late.
            pilot.wait(lambda: any(each.msg.startswith('a reference of ')
                                   for each in pilot.said[said:]), 'the reference to be taken')
        pilot.pause(False)
        # The last command of an earlier run is not one of this run.
        pilot.wait(lambda: pilot.states.stamp[-1] >= end
                   and max(pilot.commands.stamp[answered:], default=-1) >= end,
                   f't = {end * 1e-9:g} s', 60.0)
        pilot.pause(True)
        return read_run(pilot.states, pilot.commands, end, begin, answered)


def read_run(states: Samples, commands: Samples, end: int, begin: int = 0, answered: int = 0
             ) -> Run | None:
    """
    Return the states of a run and the commands computed from them; None if messages are missing.

    :param end: stamp of the last state [ns]; the first one is 0.
    :param begin, answered: numbers of states and commands of earlier runs.
    """
    begin += states.stamp[begin:].index(0)
    # A repeated state counts once; a command from before the reset may arrive late.
    ticks, first = np.unique(states.stamp[begin:], return_index=True)
    place = {stamp: answered + k for k, stamp in enumerate(commands.stamp[answered:])}
    count = np.searchsorted(ticks, end, 'right')
    steps = np.diff(ticks[:count + 1])
    if not steps.size or np.ptp(steps) > 1 or not place.keys() >= {*ticks[:count].tolist()}:
        return None
    x = [deserialize_message(states.data[begin + k], State).x for k in first[:count]]
    u = [deserialize_message(commands.data[place[tick]], Command).u
         for tick in ticks[:count].tolist()]
    return Run(ticks[:count] * 1e-9, np.array(x), np.array(u))


@contextmanager
def run_loop(folder: Path, plant: Mapping[str, Any], regulator: Mapping[str, Any],
             note: Callable[[str], None]) -> Iterator[NodeLoop]:
    """Start a loop whose time is paused, and yield it; its topics are recorded in `folder`."""
    regulator = {**regulator, **SIMULATED}
    note(run_node('plant_simulator', plant))  # in real time
    note(run_node('lqr_node', regulator))
    note(DESIGN)
    plant, regulator = {**PACE, **plant}, {**PATIENT, **regulator}
    with record_nodes(folder, 'lqr_node') as nodes:
        nodes.start('plant_simulator', plant)
        nodes.start('lqr_node', regulator)
        pilot = nodes.pilot
        pilot.wait(lambda: bool(pilot.designs) and pilot.hears('command')
                   and bool(pilot.states.stamp), 'the loop', 60.0)
        pilot.pause(True)
        yield NodeLoop(pilot, nodes.recorder, note)


def reshape_rows(values: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """Return row-major numbers as an array (N, width)."""
    return np.asarray(values, dtype=float).reshape(-1, width)
