# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Processes and a clock for tests that run executables."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
import os
from pathlib import Path
import select
import signal
import socket
import subprocess
import sys
import time
from typing import Any

import _machine  # of benchmarks/
from obc_ros.cli.processes import die_with_parent
import yaml

children = _machine.children
DEADLINE = 120.0  # [s] reached only by a test that fails
ISOLATED = {
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
    'OMP_NUM_THREADS': '1',
    'OPENBLAS_NUM_THREADS': '1',
    'PYTHONFAULTHANDLER': '1',
    'PYTHONUNBUFFERED': '1',
}
# Parameters of a controller whose plant is simulated: no protections of a robot.
DEMO = {'unlimited': True, 'transition_time': 0.0}
# Variables that a developer's shell may set and that tests must not depend on.
FOREIGN = (
    'ROS_NAMESPACE',
    'ROS_STATIC_PEERS',
    'ROS_LOCALHOST_ONLY',
    'ROS_SECURITY_ENABLE',
    'FASTRTPS_DEFAULT_PROFILES_FILE',
    'FASTDDS_DEFAULT_PROFILES_FILE',
    'PYTEST_CURRENT_TEST',  # NiceGUI behaves otherwise with it
)


def environment(domain: int) -> dict[str, str]:
    """Return the environment of a process that is confined to `domain` on this machine."""
    inherited = {key: value for key, value in os.environ.items() if key not in FOREIGN}
    return {**inherited, **ISOLATED, 'ROS_DOMAIN_ID': str(domain), 'PYTHONFAULTHANDLER': '1'}


def find(executable: str) -> str:
    """Return the path of an executable in this environment's ``bin`` or in the workspace."""
    prefixes = filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep))
    folders = [Path(prefix) / 'lib' / 'obc_ros' for prefix in prefixes]
    for folder in (*folders, Path(sys.executable).parent):
        if (folder / executable).is_file():
            return str(folder / executable)
    raise FileNotFoundError(f'{executable} is in none of {folders} nor beside {sys.executable}')


def find_port() -> int:
    """Return a free port of this machine."""
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        return int(probe.getsockname()[1])


def alive(pid: int) -> bool:
    """Return whether a process is running (a zombie is not)."""
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except (FileNotFoundError, ProcessLookupError):
        return False


def wait_for(condition: Callable[[], Any], timeout: float = 20.0) -> Any:
    """Return the value of a condition as soon as it is true; fail at the timeout."""
    deadline = time.monotonic() + timeout
    while not (value := condition()):
        assert time.monotonic() < deadline, f'not within {timeout} s'
        time.sleep(0.005)
    return value


class Clock:
    """
    The monotonic clock without the times at which a core of this machine was stalled.

    A process on each core sleeps repeatedly and reports when it wakes up too late.
    """

    def __init__(self) -> None:
        """Start to observe the cores."""
        self._watchers = [
            subprocess.Popen([sys.executable, _machine.__file__, str(core)], bufsize=0,
                             stdout=subprocess.PIPE)
            for core in os.sched_getaffinity(0)]
        self._stalls: list[tuple[float, float]] = []  # begin and end of each

    def close(self) -> None:
        """Stop observing."""
        for watcher in self._watchers:
            watcher.terminate()
            watcher.communicate()

    def since(self, begin: float) -> float:
        """Return the time [s] since a value of `time.monotonic`."""
        return self.between(begin, time.monotonic())

    def between(self, begin: float, end: float) -> float:
        """Return the time [s] between two values of `time.monotonic`."""
        time.sleep(0.03)  # until the last stall has been reported
        for watcher in self._watchers:
            while select.select([watcher.stdout], [], [], 0.0)[0]:
                late, length = map(float, watcher.stdout.readline().split())
                self._stalls.append((late, late + length))
        left, done = end - begin, begin
        for late, until in sorted(self._stalls):
            left -= max(0.0, min(until, end) - max(late, done))
            done = max(done, until)
        return left


class Process:
    """An executable of this environment that runs in a process group of its own."""

    def __init__(self, command: Sequence[str], log: Path, domain: int) -> None:
        """Start `command` with its output going to the file `log`."""
        self.command = list(command)
        self.log = log
        self.watched = True
        with log.open('wb') as output:
            self.popen = subprocess.Popen(
                self.command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
                env=environment(domain), start_new_session=True, preexec_fn=die_with_parent)

    @property
    def pid(self) -> int:
        """Return the process id."""
        return self.popen.pid

    def output(self) -> str:
        """Return its output so far, both streams."""
        return self.log.read_text(encoding='utf-8', errors='replace')

    def running(self) -> bool:
        """Return whether it is still running."""
        return self.popen.poll() is None

    def wait(self, timeout: float = DEADLINE) -> int:
        """Wait until it ends by itself and return its exit status."""
        self.watched = False
        try:
            return self.popen.wait(timeout)
        except subprocess.TimeoutExpired:
            self._write_stacks()
            raise AssertionError(
                f'{self.command[0]} still runs after {timeout} s:\n{self.output()}') from None

    def _write_stacks(self) -> None:
        """End the process; faulthandler writes the stacks of all its threads."""
        self.watched = False
        self.popen.send_signal(signal.SIGABRT)
        with suppress(subprocess.TimeoutExpired):
            self.popen.wait(5.0)

    def wait_for_output(self, text: str, timeout: float = DEADLINE) -> str:
        """Wait until its output contains `text` and return the output."""
        deadline = time.monotonic() + timeout
        while text not in self.output():
            assert self.running(), f'{self.command[0]} ended before {text!r}:\n{self.output()}'
            if time.monotonic() > deadline:
                self._write_stacks()
                raise AssertionError(f'no {text!r} in {timeout} s:\n{self.output()}')
            time.sleep(0.02)
        return self.output()

    def interrupt(self, timeout: float = DEADLINE) -> int:
        """Send SIGINT, as Ctrl-C does, and return the exit status."""
        self.popen.send_signal(signal.SIGINT)
        return self.wait(timeout)

    def kill(self) -> None:
        """Kill the whole process group at once, as in a crash."""
        self.watched = False
        self._kill_group()

    def end(self) -> str | None:
        """End the process and its children; return what was wrong, if anything."""
        wrong = None
        if self.running():
            self.popen.send_signal(signal.SIGINT)
            try:
                self.popen.wait(5.0)
            except subprocess.TimeoutExpired:
                wrong = 'did not end within 5 s of SIGINT'
        elif self.watched:
            wrong = f'ended by itself with status {self.popen.returncode}'
        self._kill_group()
        return wrong and f'{" ".join(self.command)}: {wrong}'

    def _kill_group(self) -> None:
        with suppress(ProcessLookupError):  # the group has ended
            os.killpg(self.pid, signal.SIGKILL)
        self.popen.wait()


class Spawner:
    """Start executables of this environment and end all of them; the fixture `spawn`."""

    def __init__(self, folder: Path, domain: int) -> None:
        """Keep logs and parameter files in `folder`."""
        self.folder = folder
        self.domain = domain
        self.processes: list[Process] = []

    def __call__(
        self,
        executable: str,
        parameters: Mapping[str, Any] | None = None,
        *,
        arguments: Sequence[str] = (),
        name: str | None = None,
        namespace: str | None = None,
        remappings: Mapping[str, str] | None = None,
        domain: int | None = None,
    ) -> Process:
        """
        Start `executable`.

        Parameters
        ----------
        executable : str
            Its name: ``lqr_node``, ``obc``, ...
        parameters : mapping, optional
            Parameter names (dots included) and values, passed in a file, types kept.
        arguments : sequence of str
            What comes before ``--ros-args``.
        name, namespace : str, optional
            Of the node.
        remappings : mapping, optional
            From each name to its replacement.
        domain : int, optional
            Another domain than that of the test.

        """
        count = len(self.processes)
        command = [find(executable), *arguments]
        ros = []
        for old, new in {'__node': name, '__ns': namespace, **(remappings or {})}.items():
            ros += ['--remap', f'{old}:={new}'] if new is not None else []
        if parameters is not None:
            file = self.folder / f'{count}_{executable}.yaml'
            file.write_text(yaml.safe_dump({'/**': {'ros__parameters': dict(parameters)}}))
            ros += ['--params-file', str(file)]
        process = Process([*command, '--ros-args', *ros] if ros else command,
                          self.folder / f'{count}_{executable}.log',
                          self.domain if domain is None else domain)
        self.processes.append(process)
        return process

    def end(self) -> list[str]:
        """End all processes; return a sentence for each that had died or did not end in order."""
        return [wrong for process in reversed(self.processes) if (wrong := process.end())]
