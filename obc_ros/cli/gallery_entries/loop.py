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
from obc_ros.cli.gallery_entries.entry import UnansweredError
from obc_ros.cli.gallery_entries.ros2 import argument, run_node, set_parameter
from obc_ros.cli.pilot import Pilot
from obc_ros.cli.processes import Children
from obc_ros.cli.recording import Recorder
from obc_ros.msg import LqrDesign, Trajectory
from std_srvs.srv import Trigger

Array = NDArray[np.float64]

PACE = {'lockstep': True, 'speed': 0.0, 'dt': 0.001}


@dataclass(frozen=True, eq=False)
class Run:
    """
    States of one run and the commands that answered them.

    Attributes
    ----------
    t : ndarray, shape (N,)
        [s] from the reset on.
    x, u : ndarray, shape (N, n) and (N, m)

    """

    t: Array
    x: Array
    u: Array


class Loop:
    """A running loop that stands still between runs."""

    def __init__(self, pilot: Pilot, note: Callable[[str], None]) -> None:
        self._pilot = pilot
        self._note = note

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

    def run(self, duration: float, reference: Trajectory | None = None) -> Run:
        """Return what happens from a reset on, for `duration` [s], along a reference if given."""
        pilot = self._pilot
        pilot.wait(lambda: True, '')
        begin, answered = len(pilot.states.stamp), len(pilot.commands.stamp)
        pilot.call(Trigger, 'plant_simulator/reset', Trigger.Request())
        pilot.wait(lambda: 0 in pilot.states.stamp[begin:], 'the state after the reset')
        if reference:
            pilot.publisher.publish(reference)
            pilot.wait(lambda: pilot.follows, 'the reference to be taken')
        pilot.pause(False)
        end = round(duration * 1e9)
        pilot.wait(lambda: pilot.states.stamp[-1] >= end and pilot.commands.stamp[-1] >= end,
                   f't = {duration:g} s', 60.0)
        pilot.pause(True)
        return self._recorded(begin, answered, end)

    def _recorded(self, begin: int, answered: int, end: int) -> Run:
        pilot = self._pilot
        t, x, tu, u = pilot.history()
        begin += pilot.states.stamp[begin:].index(0)
        origin = t[begin]
        t, x, tu, u = t[begin:] - origin, x[begin:], tu[answered:] - origin, u[answered:]
        # A state that is sent again, and its second answer, count once.
        ticks, first = np.unique(np.round(t * 1e9).astype(np.int64), return_index=True)
        answers, place = np.unique(np.round(tu * 1e9).astype(np.int64), return_index=True)
        wanted = ticks <= end
        if not np.isin(ticks[wanted], answers).all():
            raise UnansweredError('states of the loop were not answered')
        of = np.searchsorted(answers, ticks[wanted])
        return Run(ticks[wanted] * 1e-9, x[first[wanted]], u[place[of]])


@contextmanager
def run_loop(folder: Path, plant: Mapping[str, Any], regulator: Mapping[str, Any],
             note: Callable[[str], None]) -> Iterator[Loop]:
    """Yield a loop that stands still; its topics are recorded into `folder`."""
    plant = {**PACE, **plant}
    note(run_node('plant_simulator', plant))
    note(run_node('lqr_node', regulator))
    with Children(folder / 'log') as children, Recorder(folder) as recorder:
        children.start('plant_simulator', *_arguments(plant))
        children.start('lqr_node', *_arguments(regulator))
        with closing(Pilot(children, recorder)) as pilot:
            pilot.wait(lambda: bool(pilot.designs) and pilot.hears('command')
                       and bool(pilot.states.stamp), 'the loop')
            pilot.pause(True)
            yield Loop(pilot, note)


def _arguments(parameters: Mapping[str, Any]) -> list[str]:
    return [word for name, value in parameters.items() for word in ('-p', argument(name, value))]
