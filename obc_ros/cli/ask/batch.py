# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Entries of files under way: as many at once as can be worked on, until each has a result."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import time
from typing import Any

from obc_ros.cli.console import InterruptedByUserError, Lines
from obc_ros.cli.results import Asked
from obc_ros.core.text.errors import ObcError

CANCEL = 2.0  # [s] to wait for the results of cancelled requests


class Batch(ABC):
    """Entries of files, and who works on them: processes of this command, or a server."""

    def __init__(self, asked: Sequence[Asked], lines: Lines) -> None:
        self._waiting = deque(asked)
        self._lines = lines
        self._begun: dict[Any, float] = {}  # times at which entries under way were sent

    def work(self) -> None:
        """
        Have all entries worked on; cancel those under way when interrupted.

        :raises InterruptedByUserError: on a signal.
        :raises ObcError: if nobody works on the entries any more.
        """
        try:
            while self._waiting or self._begun:
                while self._waiting and len(self._begun) < self.count_workers():
                    entry = self._waiting.popleft()
                    self._lines.update(entry.label, 'sent')
                    self._begun[entry] = time.monotonic()
                    self.send(entry)
                self.wait()
        except InterruptedByUserError:
            self._cancel()
            raise

    def report(self, entry: Asked, phase: str) -> None:
        """Show what is tried for an entry, and the best cost so far, in words."""
        self._lines.update(entry.label, phase)

    def finish(self, entry: Asked) -> None:
        """Take an entry that has its result out of those under way."""
        entry.took = time.monotonic() - self._begun.pop(entry)
        self._lines.end(entry.label)

    @abstractmethod
    def count_workers(self) -> int:
        """Return how many entries can be under way."""

    @abstractmethod
    def send(self, entry: Any) -> None:
        """Send an entry to be worked on."""

    @abstractmethod
    def wait(self, check: bool = True) -> None:
        """Process what arrives, or return after a short time; raise on a signal if `check`."""

    @abstractmethod
    def cancel(self, entry: Any) -> None:
        """Ask for an entry under way to be given up; called again while it is under way."""

    def _cancel(self) -> None:
        """Cancel the entries under way, and wait at most `CANCEL` seconds for their results."""
        deadline = time.monotonic() + CANCEL
        while self._begun and time.monotonic() < deadline:
            for entry in list(self._begun):
                self.cancel(entry)
            self.wait(check=False)


@contextmanager
def end_all(asked: Sequence[Asked], interrupted: str, failed: str) -> Iterator[None]:
    """
    End all entries without a status when the context is interrupted or fails.

    :param interrupted, failed: their status after a signal, and after an error.
    """
    try:
        yield
    except (InterruptedByUserError, KeyboardInterrupt) as error:
        status, message = interrupted, str(error) or 'ended by SIGINT'
    except ObcError as error:
        status, message = failed, str(error)
    else:
        return
    for entry in asked:
        if not entry.status:
            entry.end(status, message)
