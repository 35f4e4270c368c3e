# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The commands `obc solve` and `obc lqr`, run on files in either way: in process, by a server."""

from collections.abc import Callable, Iterable
import json
import os
from pathlib import Path
from typing import Any

from _endless import endless  # of benchmarks/
import pytest
import support
import yaml

KEYS = ['name', 'status', 'message', 'remark', 'objective', 't', 'x', 'u', 'lam',
        'free_parameters', 'interpolation', 'switching_times', 'certificate', 'optimality',
        'attempts', 'solve_time', 'build_time', 'first_path_time', 'iterations']
SCALAR = {
    'name': 'scalar', 'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u'},
    'running_cost': 'u**2', 'terminal_cost': 'x**2', 'initial_state': {'x': 1},
    'final_time': {'free': False, 'value': 1}}
ENDLESS = endless(12)
# Each takes over half a second of processor time.
WAYS = (pytest.param('in process', marks=pytest.mark.slow),
        pytest.param('server', marks=pytest.mark.nodes))


def read_json(path: Path) -> Any:
    """Return the content of a JSON file; refuse NaN and infinity, which are not JSON."""
    def refuse(constant: str) -> None:
        raise AssertionError(f'{constant} in {path.name}')
    return json.loads(path.read_text(), parse_constant=refuse)


def check_malformed(answer: Any) -> None:
    """Fail unless the content of a JSON file is that of a malformed problem."""
    assert list(answer) == KEYS
    assert answer['status'] == 'malformed'
    assert answer['message']
    assert answer['objective'] is None
    assert answer['certificate'] == {
        'holds': False, 'excess': None, 'residuals': {}, 'tolerances': {}}
    assert answer['optimality'] == {'kind': '', 'reason': '', 'starts': 0, 'minima': []}


class Command:
    """
    Runs `obc` on files; each call returns exit status, JSON by name, and output.

    `way`: 'in process', or 'server' for a server with two workers, which runs from the start.
    """

    def __init__(self, folder: Path, request: pytest.FixtureRequest, way: str) -> None:
        self._folder, self._way = folder, way
        self._processes: list[support.Process] = []
        self._server: support.Process | None = None
        self._start: Callable[[list[str]], support.Process] = self._start_here
        if way == 'server':
            spawn, probe = map(request.getfixturevalue, ('spawn', 'probe'))
            self._start = lambda words: spawn(words[0], arguments=words[1:])
            self._server = spawn('trajectory_server', {'workers': 2})
            from obc_ros.srv import SolveOptimalControl
            client = probe.node.create_client(SolveOptimalControl, '/trajectory_server/solve')
            probe.wait_for(client.service_is_ready, what='the server')

    def __call__(self, command: str, files: dict[str, Any], *options: str,
                 end: Callable[[support.Process], int] = lambda process: process.wait()
                 ) -> tuple[int, dict[str, Any], str]:
        """
        Run `obc` on files.

        Parameters
        ----------
        command : str
            'solve' or 'lqr'.
        files : dict
            Content by name: a text, what YAML can hold, or None for a missing file.
        *options : str
            Of the command.
        end : callable
            Gets the process, and returns its exit status once it has ended.

        """
        folder = self._folder / 'in'
        folder.mkdir(exist_ok=True)
        for name, content in files.items():
            if content is not None:
                text = content if isinstance(content, str) else yaml.safe_dump(content)
                (folder / name).write_text(text)
        server = ['--server'] if self._server else []
        process = self._start(['obc', command, *(str(folder / name) for name in files),
                               '--json', str(self._folder), *server, *options])
        status = end(process)
        found = {path.stem: read_json(path) for path in self._folder.glob('*.json')}
        return status, found, process.output()

    def workers(self, process: support.Process) -> list[int]:
        """Return the worker processes of a command, or those of the server."""
        return list(support.children((self._server or process).pid))

    def wait_until_busy(self, process: support.Process) -> int:
        """Return a worker of a command, or of the server, that works on a problem."""
        return int(support.wait_for(lambda: self._busy(self.workers(process)), 60.0))

    def end(self) -> None:
        """End the processes that were started here."""
        for process in self._processes:
            process.kill()

    def _start_here(self, words: list[str]) -> support.Process:
        count = len(self._processes)
        self._processes.append(support.Process(
            [support.find(words[0]), *words[1:]], self._folder / f'{count}.log', 0))
        return self._processes[-1]

    @staticmethod
    def _busy(pids: Iterable[int]) -> int:
        """Return a process that has computed for longer than its start takes; 0 if none has."""
        tick = os.sysconf('SC_CLK_TCK')
        for pid in pids:
            fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
            if (int(fields[11]) + int(fields[12])) / tick > 2.5:
                return pid
        return 0
