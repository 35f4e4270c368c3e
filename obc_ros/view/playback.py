# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A recording as a source of frames: play, pause, scrub, speed. It waits for the first play."""

from bisect import bisect_right
from pathlib import Path
import struct
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from mcap.exceptions import McapError
from mcap.reader import make_reader
from obc_ros.cli.recording import type_name
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import Command, Estimate, LqrDesign, State, Trajectory
from obc_ros.view.recorded_events import list_events
from obc_ros.view.telemetry import (
    describe_plant,
    describe_uncertainty,
    fits_names,
    FollowedPath,
    Frame,
    Plant,
    SetPoint,
)
from rcl_interfaces.msg import Log
from rclpy.serialization import deserialize_message
from zstandard import ZstdError

KINDS = {'state': State, 'command': Command, 'design': LqrDesign, 'reference': Trajectory,
         'plan': Trajectory, 'estimate': Estimate, 'diagnostics': DiagnosticArray, 'rosout': Log}
# What mcap and the decoders of chunks and messages raise for bytes that are not theirs.
FAULTS = (McapError, RuntimeError, ValueError, LookupError, ArithmeticError, MemoryError, OSError,
          struct.error, ZstdError)
SAMPLES = 60         # of a prediction
LARGEST = 2 * 10**9  # bytes of a file


class Playback:
    """
    The states, commands and designs of a recording, an MCAP file or its folder.

    :ivar events: what happened in it, in order.
    """

    def __init__(self, file: Path) -> None:
        self.design: LqrDesign | None = None
        self._held: SetPoint | None = None
        self.reference: FollowedPath | None = None
        self._predicted: tuple[Any, list[list[float | None]]] = None, []
        self.playing, self.speed, self.position = False, 1.0, 0.0
        self._rows: dict[str, list[Any]] = {name: [] for name in KINDS}
        self._times: dict[str, list[float]] = {name: [] for name in KINDS}
        self._read(_find_file(file))
        if not self._times['state']:
            raise ObcError(f'{file} has no messages of the topic state')
        self._begin = self._times['state'][0]
        self.duration = self._times['state'][-1] - self._begin
        self.plant = self._describe()
        self.events = list_events(self._times, self._rows)
        self._then, self._shown = time.monotonic(), -1.0

    def _read(self, file: Path) -> None:
        try:
            with file.open('rb') as opened:
                for schema, channel, message in make_reader(opened).iter_messages():
                    name = channel.topic.rpartition('/')[2]
                    if name in KINDS and schema and schema.name == type_name(KINDS[name]):
                        found = deserialize_message(message.data, KINDS[name])
                        if name != 'design' or fits_names(found):
                            self._rows[name].append(found)
                            self._times[name].append(1e-9 * message.log_time)
        except FAULTS as error:
            raise ObcError(f'{file} is not a recording of a loop: {error}') from error

    def _describe(self) -> Plant:
        if self._rows['design']:
            return describe_plant(self._rows['design'][0])
        n, commands = len(self._rows['state'][0].x), self._rows['command']
        m = len(commands[0].u) if commands else 0
        return describe_plant(LqrDesign(
            state_names=[f'x{i + 1}' for i in range(n)],
            input_names=[f'u{i + 1}' for i in range(m)]))

    def take_frame(self) -> Frame | None:
        """Return the frame of the present time; None if it has been shown."""
        now = time.monotonic()
        if self.playing:
            self.position = min(self.position + self.speed * (now - self._then), self.duration)
            self.playing = self.position < self.duration
        self._then = now
        if self.position == self._shown:
            return None
        self._shown = self.position
        moment = self._begin + self.position
        state, command = self._at('state', moment), self._at('command', moment)
        design = self._at('design', moment)
        if design is not self.design:
            self.design, self._held = design, SetPoint(design) if design else None
        held = self._held
        self._refer(self._at('reference', moment), state)
        return Frame(self.position, state.x, command.u if command else (),
                     held.locate(state.x) if held else (),
                     held.measure_cost(state.x) if held else float('nan'),
                     prediction=self._predict(self._at('plan', moment), state),
                     uncertainty=describe_uncertainty(self.plant, estimate)
                     if (estimate := self._at('estimate', moment)) else None)

    def _predict(self, path: Trajectory | None, state: State) -> list[list[float | None]]:
        """Return the rows of a plan, by the clock of the frames."""
        if path is not self._predicted[0]:
            begin = self.position + _read_time(path) - _read_time(state) if path else 0.0
            self._predicted = path, FollowedPath(begin, path).pack(
                self.plant, SAMPLES, inputs=True) if path else []
        return self._predicted[1]

    def _refer(self, path: Trajectory | None, state: State) -> None:
        """Show a reference from its stamp on, by the clock of the states."""
        if path is None or not len(path.t):
            self.reference = None
        elif self.reference is None or self.reference.path is not path:
            stamp = _read_time(path)
            begin = self.position + (stamp - _read_time(state) if stamp else 0.0)
            self.reference = FollowedPath(begin, path)

    def _at(self, name: str, moment: float) -> Any:
        index = bisect_right(self._times[name], moment + 1e-9)
        return self._rows[name][index - 1] if index else None

    def seek(self, position: float) -> None:
        """Go to a time from the beginning [s]."""
        self.position = min(max(float(position), 0.0), self.duration)


def _read_time(message: Any) -> float:
    stamp = message.header.stamp
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def _find_file(file: Path) -> Path:
    files = sorted(file.glob('*.mcap')) if file.is_dir() else [file]
    if not files or not files[0].is_file():
        raise ObcError(f'{file}: no such recording; `obc demo` writes one to out/aircraft')
    if files[0].stat().st_size > LARGEST:
        raise ObcError(f'{files[0]} is larger than {LARGEST:.0e} bytes')
    return files[0]
