# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A recording as a source of frames: play, pause, scrub, speed. It waits for the first play."""

from bisect import bisect_right
from collections.abc import Sequence
from pathlib import Path
import struct
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from mcap.exceptions import McapError
from mcap.reader import make_reader
from obc_ros.cli.recording import type_name
from obc_ros.core.text.errors import ObcError, quote
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

    `namespace`: of the loop that is shown; None: the only one.

    :ivar events: what happened in it, in order.
    """

    def __init__(self, file: Path, namespace: str | None = None) -> None:
        self.design: LqrDesign | None = None
        self._held: SetPoint | None = None
        self.reference: FollowedPath | None = None
        self._predicted: tuple[Any, list[list[float | None]]] = None, []
        self.playing, self.speed, self.position = False, 1.0, 0.0
        self._rows: dict[str, list[Any]] = {name: [] for name in KINDS}
        self._times: dict[str, list[float]] = {name: [] for name in KINDS}
        self._take(_read_messages(_find_file(file)), file, namespace)
        self._begin = self._times['state'][0]
        self.duration = self._times['state'][-1] - self._begin
        self.plant = self._describe()
        self.events = list_events(self._times, self._rows)
        self._then, self._shown = time.monotonic(), -1.0

    def _take(self, read: Sequence[tuple[str, float, Any]], file: Path, namespace: str | None
              ) -> None:
        """Keep the messages of one loop: its topics begin as that of its state does."""
        loops = sorted({topic.removesuffix('state') for topic, _, message in read
                        if isinstance(message, State)})
        if not loops:
            raise ObcError(f'{file} has no messages of the topic state')
        wanted = loops[0] if namespace is None else f'/{namespace.strip("/")}/'.replace('//', '/')
        if wanted not in loops or namespace is None and len(loops) > 1:
            raise ObcError(f'{file}: choose a loop with --namespace: '
                           + ', '.join(quote(each.rstrip('/') or '/') for each in loops))

        def is_own(topic: str) -> bool:
            return max((each for each in loops if topic.startswith(each)), key=len,
                       default=wanted) == wanted

        for topic, moment, message in read:
            if isinstance(message, DiagnosticArray):   # of all loops
                message.status = [each for each in message.status if is_own(f'/{each.name}')]
            elif not is_own('/' + message.name.replace('.', '/') if isinstance(message, Log)
                            else topic):
                continue
            name = topic.rpartition('/')[2]
            self._rows[name].append(message)
            self._times[name].append(moment)

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


def _read_messages(file: Path) -> list[tuple[str, float, Any]]:
    """Return topic, time [s] and message of what the page can show, in order."""
    read = []
    try:
        with file.open('rb') as opened:
            for schema, channel, message in make_reader(opened).iter_messages():
                kind = KINDS.get(channel.topic.rpartition('/')[2])
                if kind and schema and schema.name == type_name(kind):
                    found = deserialize_message(message.data, kind)
                    if kind is not LqrDesign or fits_names(found):
                        read.append((channel.topic, 1e-9 * message.log_time, found))
    except FAULTS as error:
        raise ObcError(f'{file} is not a recording of a loop: {error}') from error
    return read


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
