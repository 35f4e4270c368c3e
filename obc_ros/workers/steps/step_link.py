# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""One process that solves steps, seen from the node."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
import itertools
import os
import signal
import socket
import subprocess
import sys
import time
from typing import Any

from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import ObcError
from obc_ros.workers.pool import ENVIRONMENT
from obc_ros.workers.wire import Channel, Packet

SEND = 0.005   # [s] that a request may take to be sent: the process reads at once, or is stopped
LOOK_AGAIN = 0.05    # [s] between two looks whether a reply is still wanted
END = 0.2      # [s] until a process has ended after its channel was closed


class StepLink:
    """
    A process with a prepared problem.

    One thread sends and one receives. Both use finite times, because the socket has one mode.

    Parameters
    ----------
    module : str
        Module of the process that prepares the problem.
    problem : Packet
        The problem.
    priority : int
        Real-time priority of the process once it is prepared; 0: none.

    Attributes
    ----------
    ready : Packet or None
        Reply of the process when it is prepared.
    priority_refusal : str
        Why the system does not allow the priority; empty before `ready`, and if it does.
    is_broken : bool
        Whether a request was sent in part: the process cannot read another one.

    Raises
    ------
    ObcError
        On Windows, where a process cannot inherit a socket.
    OSError
        If the system starts no process, or it ends at once.

    """

    def __init__(self, module: str, problem: Packet, priority: int = 0) -> None:
        if sys.platform == 'win32':
            raise ObcError('the solver process needs Linux or macOS: on Windows, use the Windows '
                           'Subsystem for Linux')
        self.module, self.problem, self.priority = module, problem, priority
        self.ready: Packet | None = None
        self.priority_refusal = ''
        self.is_broken = False
        self._ids = itertools.count(1)
        ours, theirs = socket.socketpair()
        with ExitStack() as undo:
            undo.callback(ours.close)
            with theirs:
                self._process = subprocess.Popen(
                    [sys.executable, '-P', '-m', 'obc_ros.workers.steps.step_process',
                     str(theirs.fileno()), module, str(os.getpid()), str(priority)],
                    pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL, env={**os.environ, **ENVIRONMENT})
            undo.callback(self._process.wait)
            undo.callback(self._process.kill)
            self._channel = Channel(ours)
            self._channel.send(problem.plain, problem.arrays, timeout=1.0)
            undo.pop_all()

    @property
    def pid(self) -> int:
        """Return the process id."""
        return self._process.pid

    def wait_until_ready(self, timeout: float,
                         is_cancelled: Callable[[], bool] = lambda: False) -> Packet:
        """
        Return the reply of the prepared process.

        Raises
        ------
        ObcError
            If it refuses the problem, has ended, is not ready within `timeout` seconds, or is not
            wanted any more.

        """
        end = time.monotonic() + timeout
        while self.ready is None and (left := end - time.monotonic()) > 0.0:
            if is_cancelled():
                raise ObcError('cancelled')
            try:
                self.look(self._channel.receive(min(left, LOOK_AGAIN)))
            except EOFError:
                raise ObcError(f'the solver process has ended: {self.find_end()}') from None
        if self.ready is None:
            raise ObcError(f'the solver process is not ready after {timeout:g} s')
        return self.ready

    def look(self, packet: Packet | None) -> None:
        """Take the reply to the problem; ObcError: it is refused."""
        if packet is not None and 'refused' in packet.plain:
            raise ObcError(str(packet.plain['refused']))
        if packet is not None and 'ready' in packet.plain:
            self.priority_refusal = str(packet.plain['priority'])
            self.ready = Packet(packet.plain['ready'], packet.arrays)

    def send(self, plain: Mapping[str, Any], arrays: Mapping[str, Array]) -> int:
        """Send a request; return its id, 0 if it could not be sent."""
        if self.is_broken:
            return 0
        number = next(self._ids)
        try:
            self._channel.send({**plain, 'id': number}, arrays, timeout=SEND)
        except OSError:   # stopped or ended
            self.is_broken = True
            return 0
        return number

    def receive(self, timeout: float) -> Packet | None:
        """Return the next reply; None: there was none within `timeout`. EOFError: it has ended."""
        return self._channel.receive(timeout)

    def call(self, plain: Mapping[str, Any], arrays: Mapping[str, Array], timeout: float,
             is_cancelled: Callable[[], bool] = lambda: False) -> Packet:
        """
        Send a request and return its reply.

        Raises
        ------
        ObcError
            If the reply is a refusal or does not arrive, or is not wanted any more.

        """
        number, end = self.send(plain, arrays), time.monotonic() + timeout
        while (left := end - time.monotonic()) > 0.0:
            if is_cancelled():
                raise ObcError('cancelled')
            try:
                packet = self._channel.receive(min(left, LOOK_AGAIN))
            except EOFError:
                raise ObcError(f'the solver process has ended: {self.find_end()}') from None
            if packet is not None and packet.plain.get('id') == number:
                if 'refused' in packet.plain:
                    raise ObcError(str(packet.plain['refused']))
                return packet
        raise ObcError(f'the solver process has not answered within {timeout:g} s')

    def find_end(self) -> str:
        """Return how the process has ended."""
        try:
            status = self._process.wait(END)
        except subprocess.TimeoutExpired:
            return 'it has closed its channel'
        return (f'by {signal.Signals(-status).name}' if status < 0 else
                f'with exit status {status}')

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        self._channel.close()
