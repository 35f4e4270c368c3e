# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""One flight of a demonstration: nodes, recording, timed events and figures of merit."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
import sys
import time
from typing import Any

import matplotlib as mpl
import numpy as np
from obc_ros.api.figures.files import save_figure
from obc_ros.api.figures.style import STYLE
from obc_ros.cli.flight_client import Pilot
from obc_ros.cli.processes import Children
from obc_ros.cli.recording import Recorder
from obc_ros.cli.share_folders import share_directory
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import ObcError
from obc_ros.ros.parameters.files import has_section

BACKLOG = 1000  # depth of the queue of commands (default 1): the recorder may fall behind


@dataclass(frozen=True)
class FlightEvent:
    """An action at a simulated time [s]."""

    at: float
    what: str
    act: Callable[[Pilot], str]


@dataclass(frozen=True)
class Flight:
    """
    One run of the loop.

    :ivar config: file of config/ with the parameters of the nodes.
    :ivar plant: ROS arguments of the plant in addition.
    :ivar sensors: file of config/sensors/: estimator_node provides the state. Empty: the plant
        does.
    :ivar rest: with sensors: input until the first estimate, shape (m,).
    """

    name: str
    config: str
    duration: float
    events: Sequence[FlightEvent]
    controller: str = 'lqr_node'
    plant: tuple[str, ...] = ()
    sensors: str = ''
    rest: tuple[float, ...] = ()


def fly(flight: Flight, out: Path, real_time: bool,
        conclude: Callable[[Pilot, float], int]) -> int:
    """Run and record one flight; return the exit status. `conclude(pilot, wall)` reports it."""
    pace = ['-p', 'speed:=1.0', '-p', 'lockstep:=false'] if real_time else []
    hidden = ['-r', 'state:=true_state', '-r', 'odom:=true_odom'] if flight.sensors else []
    # In lockstep two flights are identical bit for bit: nothing depends on the wall clock.
    simulated = ['-p', 'use_sim_time:=true']
    timeless = simulated + ([] if real_time else ['-p', 'state_timeout:=0.0'])
    recorded = ['-p', f'qos_overrides./command.publisher.depth:={BACKLOG}']
    with (Children(out / 'log') as children, Recorder(out / 'log' / flight.name) as journal,
          Recorder(out / flight.name, ordered=not real_time) as recorder):

        def start(node: str, *words: str) -> None:
            children.start(node, *_find_parameters(flight, node), *words)

        start('plant_simulator', *pace, *hidden, *flight.plant)
        start('trajectory_server')
        with closing(Pilot(children, recorder, journal, flight.controller, flight.rest)) as pilot:
            pilot.wait(lambda: bool(pilot.states.stamp), 'the first state')
            # The simulated time is paused until all nodes have discovered each other.
            pilot.pause(True)
            if flight.sensors:
                start('estimator_node', *simulated)
            start(flight.controller, *timeless, *recorded)
            pilot.wait(lambda: bool(pilot.designs) and pilot.hears('command')
                       and pilot.hears('state'), flight.controller)
            wall = time.monotonic()
            pilot.begin(real_time)
            progress = FlightProgress(pilot, flight, exact=not real_time)
            for event in flight.events:
                progress.until(event.at)
                progress.say(event.what, event.act(pilot))
            progress.until(flight.duration)
            progress.done()
            status = conclude(pilot, time.monotonic() - wall)
    return 1 if recorder.fault else status


def _find_parameters(flight: Flight, node: str) -> list[str]:
    """Return the ROS arguments with the parameter files of a flight for a node."""
    config = share_directory('obc_ros') / 'config'
    files = [config / flight.config, *([config / 'sensors' / flight.sensors]
                                       if flight.sensors else ())]
    return [word for file in files if has_section(file, f'/{node}')
            for word in ('--params-file', str(file))]


class FlightProgress:
    """The progress of a flight: one line that is updated, and one for each event."""

    def __init__(self, pilot: Pilot, flight: Flight, exact: bool) -> None:
        self._pilot = pilot
        self._exact = exact
        self._duration = flight.duration
        self._live = sys.stdout.isatty()

    def until(self, moment: float) -> None:
        """Wait until a simulated time [s] and show the progress; in lockstep, pause there."""
        # A simulated second takes less than 5 s, even on a busy machine.
        timeout = 30.0 + 5.0 * self._duration
        show = self._show if self._live else lambda: None
        if self._exact:
            self._pilot.reach(moment, timeout, show)
        else:
            self._pilot.wait(lambda: self._pilot.now >= moment, f't = {moment:g} s', timeout, show)

    def _show(self) -> None:
        pilot = self._pilot
        if pilot.states.stamp:
            position = ', '.join(f'{value:6.2f}' for value in pilot.x[:2])
            revision = pilot.designs[-1].revision if pilot.designs else 0
            print(f'\r  t = {pilot.now:5.1f} of {self._duration:g} s   position ({position}) m'
                  f'   K revision {revision}', end='', flush=True)

    def say(self, what: str, outcome: str) -> None:
        """Print an event and its outcome."""
        clear = '\r\033[K' if self._live else ''
        print(f'{clear}  t = {self._pilot.now:5.1f} s  {what}{": " if outcome else ""}{outcome}',
              flush=True)

    def done(self) -> None:
        """Clear the line."""
        if self._live:
            print('\r\033[K', end='')


def save_drawing(draw: Callable[[], Any], path: Path, formats: Sequence[str]) -> str:
    """Draw a figure into files; return which, in words."""
    with mpl.rc_context(STYLE):
        return f'figure {", ".join(map(str, save_figure(draw(), path, formats)))}'


def make_gust(start: float) -> tuple[str, ...]:
    """Return the ROS arguments for a gust on the aircraft from a time [s] on: 4 N for 1 s."""
    values = {'gust.vx': 1.0, 'gust_start': start, 'gust_duration': 1.0}   # 1 m/s^2, of 4 kg
    return tuple(word for name, value in values.items()
                 for word in ('-p', f'disturbance.{name}:={value}'))


def set_parameters(node: str, values: Mapping[str, object], *, refused: bool = False
                   ) -> Callable[[Pilot], str]:
    """Return an action that sets parameters, and raises unless the outcome is as expected."""
    def act(pilot: Pilot) -> str:
        done, reason = pilot.set_parameters(node, values)
        if done == refused:
            raise ObcError(f'{node} {"accepted" if done else "rejected"} {values}: {reason}')
        return f'rejected: {reason}' if refused else ''
    return act


@dataclass(frozen=True)
class StepFigures:
    """A step response: rise and settling time [s], overshoot as a fraction of the step."""

    rise_time: float
    overshoot: float
    settling_time: float


def measure_step(t: Array, y: Array, start: float, target: float) -> StepFigures:
    """Return rise time (10 % to 90 %), overshoot and settling time (2 %) of a step at t[0]."""
    share = (y - start) / (target - start)
    above = [np.flatnonzero(share >= level) for level in (0.1, 0.9)]
    rise = t[above[1][0]] - t[above[0][0]] if above[1].size else np.nan
    outside = np.flatnonzero(np.abs(share - 1.0) > 0.02)
    settled = outside.size == 0 or outside[-1] + 1 < t.size
    settling = (t[outside[-1] + 1] - t[0] if outside.size else 0.0) if settled else np.nan
    return StepFigures(float(rise), float(max(0.0, share.max() - 1.0)), float(settling))


def report_loop(pilot: Pilot, wall: float) -> list[tuple[str, str]]:
    """Return message counts and latencies of the loop, as names and values."""
    late = pilot.latencies() * 1e3
    simulated = pilot.now
    return [
        ('states, commands', f'{len(pilot.heard.stamp)}, {len(pilot.commands.stamp)}'),
        ('missed states', f'{pilot.missed()}'),
        ('state to command, p50 / p99',
         f'{np.percentile(late, 50):.2f} / {np.percentile(late, 99):.2f} ms'),
        ('designs adopted', f'{pilot.designs[-1].revision if pilot.designs else 0}'),
        ('simulated in', f'{simulated:.1f} s in {wall:.1f} s of wall time '
                         f'({simulated / wall:.1f} x real time)'),
    ]
