# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A child process that exchanges packets with this one.

It ends with the thread that has started it. Two policies say what becomes of its work, and when
another one is started: `pool.Pool` and `steps.step_supervisor.StepSupervisor`.
"""

from contextlib import ExitStack
import os
import signal
import socket
import subprocess
import sys

from obc_ros.core.text.errors import ObcError
from obc_ros.workers.wire import Channel

START_TIME = 60.0  # [s] in which a process must be ready
END = 0.2          # [s] until a process has ended after its channel was closed
ENVIRONMENT = {'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1', 'MKL_NUM_THREADS': '1'}


class SupervisedProcess:
    """
    A child process, seen from its parent.

    :param program: module that runs in the process; it begins with
        `child_start.connect_to_parent`.
    :param has_session: whether the process has a session of its own: signals of the terminal do
        not reach it.
    :raises OSError: if the system starts no process.
    """

    def __init__(self, program: str, *arguments: str, has_session: bool = False) -> None:
        check_system()
        ours, theirs = socket.socketpair()
        with theirs, ExitStack() as undo:
            undo.callback(ours.close)
            self._process = subprocess.Popen(
                [sys.executable, '-P', '-m', program, str(theirs.fileno()), str(os.getpid()),
                 *arguments],
                pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                env={**os.environ, **ENVIRONMENT}, start_new_session=has_session)
            undo.pop_all()
        self.channel = Channel(ours)

    @property
    def pid(self) -> int:
        """Return the process id."""
        return self._process.pid

    @property
    def has_ended(self) -> bool:
        """Return whether the process has ended."""
        return self._process.poll() is not None

    def describe_end(self) -> str:
        """Return how the process has ended, such as 'has ended by SIGKILL'."""
        try:
            status = self._process.wait(END)
        except subprocess.TimeoutExpired:
            return 'takes no more data'
        return (f'has ended by {signal.Signals(-status).name}' if status < 0 else
                f'has ended with exit status {status}')

    def kill(self) -> None:
        """End the process; its channel can still be read."""
        self._process.kill()

    def close(self) -> None:
        """End the process and close its channel."""
        self._process.kill()
        self._process.wait()
        self.channel.close()


def check_system() -> None:
    """Raise ObcError on Windows, where a process cannot inherit a socket."""
    if sys.platform == 'win32':
        raise ObcError('worker processes need Linux or macOS: on Windows, use the Windows '
                       'Subsystem for Linux, or call obc_ros in Python')


def find_pause(failures: int, first: float, longest: float) -> float:
    """
    Return the pause [s] before another start of a process.

    :param failures: number of failed starts; 0: no pause.
    :param first, longest: the pause [s] after the first one, doubled after each further one, and
        its maximum.
    """
    return min(first * 2.0**min(failures - 1, 100), longest) if failures else 0.0
