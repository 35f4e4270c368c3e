# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Signals that ask a command to end."""

import signal
from types import FrameType, TracebackType
from typing import ClassVar

from obc_ros.core.text.errors import ObcError


class InterruptedByUserError(ObcError):
    """The user or the system asked the command to end."""


class EndSignals:
    """
    Signals that ask a command to end: they are noted, and `check` raises.

    A context manager. A signal reaches all nested instances.
    """

    _open: ClassVar[int] = 0
    _number: ClassVar[int] = 0

    def __enter__(self) -> 'EndSignals':
        if not EndSignals._open:
            EndSignals._number = 0
        EndSignals._open += 1
        self._previous = {
            number: signal.signal(number, self._note)
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        EndSignals._open -= 1

    @staticmethod
    def _note(number: int, frame: FrameType | None) -> None:
        EndSignals._number = number  # nothing is torn down inside a handler

    @staticmethod
    def check() -> None:
        """Raise InterruptedByUserError if this command was asked to end."""
        if EndSignals._number:
            name = signal.Signals(EndSignals._number).name
            raise InterruptedByUserError(f'ended by {name}')
