# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
`obc launch`: start the nodes of a launch file as processes, and end them on Ctrl-C.

Each line of their output is printed with the name of its process. They get SIGINT when this
command is asked to end, and end with it if it is killed.
"""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
import os
from pathlib import Path
import selectors
import signal
import subprocess
import tempfile
import time
from typing import Any, cast

from obc_ros.cli.processes import die_with_parent, find_log_folder
from obc_ros.cli.ros2.launch_file import LaunchFile, Started
from obc_ros.cli.ros2.run import find_executable
from obc_ros.cli.ros_graph import keep_to_this_machine
from obc_ros.cli.share_folders import share_directory
from obc_ros.cli.terminal import Parser
from obc_ros.core.text.errors import ObcError, quote
import yaml

OWN = ('loop', 'fleet')  # launch files of this package, which need no package name
PATIENCE = 5.0  # [s] from SIGINT to SIGKILL
LAUNCH_LOOK = 0.2      # [s] between checks for ended processes


def add_arguments(parser: Parser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        'package_name', help='obc_ros, the path of a launch file, loop or fleet')
    parser.add_argument('words', nargs='*', metavar='launch_file NAME:=VALUE',
                        help='loop.launch.py or fleet.launch.py, and its arguments')
    parser.add_argument('-s', '--show-args', '--show-arguments', action='store_true',
                        help='show the arguments of the launch file')


def run(args: argparse.Namespace) -> int:
    """Start the nodes and wait until they have ended; return the exit status."""
    keep_to_this_machine()
    words = list(args.words)
    if Path(args.package_name).is_file():
        path = Path(args.package_name)
    elif args.package_name in OWN:
        path = _find('obc_ros', f'{args.package_name}.launch.py')
    elif words:
        path = _find(args.package_name, words.pop(0))
    else:
        raise ObcError('which launch file? obc launch loop, or obc launch PACKAGE FILE')
    file = LaunchFile(path)
    if args.show_args:
        _show(file)
        return 0
    wanted = file.nodes(dict(map(_argument, words)))
    find_log_folder()
    with tempfile.TemporaryDirectory(prefix='obc_launch_') as folder:
        return Launch([Process(k, each, _command(each, Path(folder) / f'{k}.yaml'))
                       for k, each in enumerate(wanted, start=1)]).run()


def _find(package: str, name: str) -> Path:
    folder = share_directory(package) / 'launch'
    path = folder / name
    if Path(name).name != name or not path.is_file():
        there = ', '.join(sorted(each.name for each in folder.glob('*.launch.*')))
        raise ObcError(f"{package} has no launch file '{quote(name)}'; it has {there or 'none'}")
    return path


def _argument(word: str) -> tuple[str, str]:
    name, separator, value = word.partition(':=')
    if not separator or not name:
        raise ObcError(f"malformed launch argument '{quote(word)}', "
                       "expected format '<name>:=<value>'")
    return name, value


def _show(file: LaunchFile) -> None:
    print("Arguments (pass arguments as '<name>:=<value>'):")
    for each in file.arguments:
        choices = f'. Valid choices are: {each.choices}' if each.choices is not None else ''
        print(f"\n    '{each.name}':\n        {each.description}{choices}")
        if isinstance(each.default_value, str):
            print(f"        (default: '{each.default_value}')")


def _command(node: Started, file: Path) -> list[str]:
    """Return the command of a node, after writing its parameter values to `file`."""
    place = f'/{node.namespace.strip("/")}' if node.namespace.strip('/') else ''
    command = [str(find_executable(node.package, node.executable)), '--ros-args',
               '-r', f'__node:={node.name}']
    if place:
        command += ['-r', f'__ns:={place}']
    for name, other in node.remappings:
        command += ['-r', f'{name}:={other}']
    for each in node.files:
        command += ['--params-file', str(each)]
    if node.values:
        file.write_text(yaml.safe_dump(
            {f'{place}/{node.name}': {'ros__parameters': node.values}}), encoding='utf-8')
        command += ['--params-file', str(file)]
    return command


@dataclass
class Process:
    """A node that runs, has ended, or starts again at `again` [s], by the monotonic clock."""

    number: int
    node: Started
    command: list[str]
    popen: subprocess.Popen[bytes] | None = None
    again: float | None = None
    rest: bytes = b''

    @property
    def label(self) -> str:
        """Return the prefix of its lines."""
        return f'{self.node.executable}-{self.number}'

    def start(self) -> None:
        """Start it in a session of its own: only this command gets the SIGINT of Ctrl-C."""
        self.again = None
        self.popen = subprocess.Popen(
            self.command, env={**os.environ, **self.node.environment}, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, bufsize=0,
            start_new_session=True, preexec_fn=die_with_parent)
        assert self.popen.stdout
        os.set_blocking(self.popen.stdout.fileno(), False)
        _say('INFO', self.label, f'process started with pid [{self.popen.pid}]')

    def tell(self) -> bool:
        """Print the lines that it has written; return whether more may follow."""
        assert self.popen and self.popen.stdout
        try:
            data = cast(bytes | None, self.popen.stdout.read(1 << 16))   # it does not block
        except ValueError:  # closed
            return False
        if data is None:
            return True
        *lines, self.rest = (self.rest + data).split(b'\n')
        if not data and self.rest:
            lines, self.rest = [self.rest], b''
        for line in lines:
            print(f'[{self.label}] {line.decode(errors="replace")}', flush=True)
        return bool(data)


class Launch:
    """The processes of one launch file."""

    def __init__(self, processes: list[Process]) -> None:
        self._processes = processes
        self._open = selectors.DefaultSelector()
        self._asked = 0     # signals to end
        self._failed = False

    def run(self) -> int:
        """Start all and wait; return 0 if they ended on a signal or without an error, else 1."""
        with self._heeding():
            try:
                for each in self._processes:
                    self._start(each)
                while not self._asked and any(
                        each.popen or each.again for each in self._processes):
                    self._look()
            finally:
                self._end()
        return 1 if self._failed and not self._asked else 0

    @contextmanager
    def _heeding(self) -> Iterator[None]:
        """Count the signals to end."""
        def ask(*_: Any) -> None:
            self._asked += 1

        before = {number: signal.signal(number, ask)
                  for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _start(self, process: Process) -> None:
        process.start()
        assert process.popen and process.popen.stdout
        self._open.register(process.popen.stdout, selectors.EVENT_READ, process)

    def _look(self) -> None:
        """Print new lines, handle ended processes and start those that are due."""
        for key, _ in self._open.select(LAUNCH_LOOK):
            if not key.data.tell():
                self._open.unregister(key.fileobj)
        now = time.monotonic()
        for each in self._processes:
            if each.popen and each.popen.poll() is not None:
                self._ended(each, each.popen)
            if each.again and now >= each.again and not self._asked:
                self._start(each)

    def _ended(self, process: Process, popen: subprocess.Popen[bytes]) -> None:
        assert popen.stdout
        if popen.stdout in self._open.get_map():
            while process.tell():
                if not self._open.select(0.0):  # a child of the process still has the pipe open
                    break
            self._open.unregister(popen.stdout)
        popen.stdout.close()
        process.popen = None
        if popen.returncode == 0:
            _say('INFO', process.label, f'process has finished cleanly [pid {popen.pid}]')
        else:
            self._failed = True
            _say('ERROR', process.label, f'process has died [pid {popen.pid}, '
                 f"exit code {popen.returncode}, cmd '{' '.join(process.command)}'].")
        if process.node.respawn and not self._asked:
            process.again = time.monotonic() + process.node.respawn_delay

    def _end(self) -> None:
        """Send SIGINT to those that run; SIGKILL after `PATIENCE` [s] or at a second signal."""
        asked, deadline = self._asked, time.monotonic() + PATIENCE
        if asked:
            _say('WARNING', 'launch', 'asked to end')
        self._asked = max(self._asked, 1)  # nothing starts again
        running = [each for each in self._processes if each.popen]
        for each in running:
            _say('INFO', each.label, f"sending signal 'SIGINT' to process[{each.label}]")
            self._signal(each, signal.SIGINT)
        while any(each.popen for each in running):
            self._look()
            if time.monotonic() > deadline or self._asked > max(asked, 1):
                for each in running:
                    self._signal(each, signal.SIGKILL)
        self._asked = asked

    @staticmethod
    def _signal(process: Process, number: signal.Signals) -> None:
        if process.popen and process.popen.poll() is None:
            process.popen.send_signal(number)


def _say(level: str, who: str, what: str) -> None:
    print(f'[{level}] [{who}]: {what}', flush=True)
