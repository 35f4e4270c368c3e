# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A closed loop: `plant_simulator` and `lqr_node` in processes of their own, in lockstep."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from obc_ros.cli.flight_client import Pilot
from obc_ros.cli.gallery.ros2_commands import publish, run_node, set_parameter, write_argument
from obc_ros.cli.processes import Children
from obc_ros.cli.recording import Recorder
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import Command, LqrDesign, State, Trajectory
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

RESET = 'ros2 service call /plant_simulator/reset std_srvs/srv/Trigger'
DESIGN = 'ros2 topic echo --once /lqr_node/design obc_ros/msg/LqrDesign'
ATTEMPTS = 4
PACE = {'lockstep': True, 'speed': 1e6, 'dt': 0.005}  # not 0, which goes with a /clock to record
# What listens falls behind for a moment: commands wait for it.
PATIENT = {'qos_overrides./command.publisher.depth': 1000}


class UnansweredError(ObcError):
    """The nodes did not answer what an entry needs an answer to."""


@dataclass(frozen=True, eq=False)
class Run:
    """
    All states of one run and the commands that answer them.

    Attributes
    ----------
    t : ndarray, shape (N,)
        [s] from the reset on.
    x : ndarray, shape (N, n)
    u : ndarray, shape (N, m)

    """

    t: Array
    x: Array
    u: Array


class NodeLoop:
    """A running loop that stands still between runs."""

    def __init__(self, pilot: Pilot, recorder: Recorder, note: Callable[[str], None]) -> None:
        self._pilot = pilot
        self._folder = recorder.folder
        self._note = note
        self._before = 0  # [ns] of the runs before: what is recorded goes on in time
        recorder.now = lambda: self._before + (pilot.states.stamp or [0])[-1]

    @property
    def design(self) -> LqrDesign:
        """Return the design in use."""
        return self._pilot.designs[-1]

    def set(self, node: str = 'lqr_node', **values: Any) -> None:
        """
        Set parameters of a node as one; for `lqr_node` wait until its new design is there.

        Raises
        ------
        UnansweredError
            If they are refused.

        """
        pilot = self._pilot
        revision = self.design.revision
        done, reason = pilot.set_parameters(node, values)
        if not done:
            raise UnansweredError(f'{node} refuses {values}: {reason}')
        for name, value in values.items():
            self._note(set_parameter(node, name, value))
        if node == 'lqr_node':
            pilot.wait(lambda: self.design.revision > revision, 'the new design')

    def run(self, duration: float, reference: Trajectory | None = None, name: str = 'reference'
            ) -> Run:
        """
        Return what happens from a reset on, for `duration` [s], along a reference if given.

        The reference is kept as a file of the name, for those who publish it themselves.

        Raises
        ------
        UnansweredError
            If this process is too slow to hear all of them, several times.

        """
        self._note(RESET)
        if reference:
            self._note(publish('reference', reference, self._folder / f'{name}.yaml'))
        for _ in range(ATTEMPTS):
            found = self._run(round(duration * 1e9), reference)
            if found:
                return found
        raise UnansweredError('states or commands of the loop were lost on their way')

    def _run(self, end: int, reference: Trajectory | None) -> Run | None:
        pilot = self._pilot
        begin, answered = len(pilot.states.stamp), len(pilot.commands.stamp)
        self._before += pilot.states.stamp[-1]
        pilot.call(Trigger, 'plant_simulator/reset', Trigger.Request())
        pilot.wait(lambda: 0 in pilot.states.stamp[begin:], 'the state after the reset')
        if reference:
            said = len(pilot.said)
            pilot.publisher.publish(reference)
            pilot.wait(lambda: any('reference' in each.msg for each in pilot.said[said:]),
                       'the reference to be taken')
        pilot.pause(False)
        pilot.wait(lambda: pilot.states.stamp[-1] >= end and pilot.commands.stamp[-1] >= end,
                   f't = {end * 1e-9:g} s', 60.0)
        pilot.pause(True)
        return self._recorded(begin, answered, end)

    def _recorded(self, begin: int, answered: int, end: int) -> Run | None:
        """Return the run that began last; None if something of it is missing."""
        states, commands = self._pilot.states, self._pilot.commands
        begin += states.stamp[begin:].index(0)
        # What is sent again counts once; an answer from before the reset may come late.
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
    """Yield a loop that stands still; its topics are recorded into `folder`."""
    note(run_node('plant_simulator', plant))  # at the speed of the clock on the wall
    note(run_node('lqr_node', regulator))
    note(DESIGN)
    plant, regulator = {**PACE, **plant}, {**PATIENT, **regulator}
    with Children(folder / 'log') as children, Recorder(folder) as recorder:
        children.start('plant_simulator', *_arguments(plant))
        children.start('lqr_node', *_arguments(regulator))
        with closing(Pilot(children, recorder)) as pilot:
            pilot.wait(lambda: bool(pilot.designs) and pilot.hears('command')
                       and bool(pilot.states.stamp), 'the loop', 60.0)
            pilot.pause(True)
            yield NodeLoop(pilot, recorder, note)


def _arguments(parameters: Mapping[str, Any]) -> list[str]:
    return [word for name,
            value in parameters.items() for word in ('-p', write_argument(name, value))]


def reshape_rows(values: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """Return row-major numbers as an array (N, width)."""
    return np.asarray(values, dtype=float).reshape(-1, width)
