# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Time from the shell to the answer of a small problem, and of the import of the library.

Every command is run once in each of seven rounds; the times are medians. The floor is what Python
needs to import CasADi and numpy, without which no problem can be stated. Requirements: `obc solve`
and `obc lqr` at most 0.9 s, `import obc_ros` at most 0.4 s.
"""

import timing  # isort: skip - before numpy

from collections.abc import Callable
from functools import partial
import os
from pathlib import Path
import subprocess
import sys
import sysconfig
import tempfile
import time

FLOOR = 'import casadi, numpy'
LIBRARY = 'import obc_ros'
NAMES = 'from obc_ros import Problem, solve'  # with what the names import
ANSWER, IMPORT = 0.9, 0.4  # [s]
ROUNDS = 7
LEAST_TIME = """\
states: [p, v]
inputs: [u]
dynamics: {p: v, v: u}
running_cost: 1
initial_state: {p: 1, v: 0}
terminal_constraints: [p, v]
input_bounds: {u: [-1, 1]}
final_time: {free: true, lower: 0.01, upper: 50, guess: 4}
"""
REGULATOR = """\
A: [[0, 1], [0, 0]]
B: [[0], [1]]
Qx: [4, 0]
Qu: [1]
"""


def main() -> int:
    """Measure, print and return the exit status."""
    timing.arguments('times from the shell to an answer')
    with tempfile.TemporaryDirectory() as folder:
        times = timing.measure(_commands(Path(folder)), rounds=ROUNDS, least=0.0,
                               clock=time.perf_counter)
    timing.times_table('From the shell', times, FLOOR)
    timing.require('obc solve [s]', times['obc solve'].median, ANSWER)
    timing.require('obc lqr [s]', times['obc lqr'].median, ANSWER)
    timing.require(f'{LIBRARY} [s]', times[LIBRARY].median, IMPORT)
    return timing.finish()


def _commands(folder: Path) -> dict[str, Callable[[], None]]:
    """Return what is run, by its name."""
    obc = Path(sysconfig.get_path('scripts')) / 'obc'
    commands: dict[str, list[str | Path]] = {
        'python': [sys.executable, '-c', 'pass'], FLOOR: [sys.executable, '-c', FLOOR],
        LIBRARY: [sys.executable, '-c', LIBRARY], NAMES: [sys.executable, '-c', NAMES],
        'obc --help': [obc, '--help']}
    for command, text in (('solve', LEAST_TIME), ('lqr', REGULATOR)):
        file = folder / f'{command}.yaml'
        file.write_text(text, encoding='utf-8')
        commands[f'obc {command}'] = [obc, command, file]
    # a shell sets no number of threads
    environment = {name: value for name, value in os.environ.items()
                   if name not in timing.THREADS}
    return {name: partial(subprocess.run, words, check=True, env=environment,
                          stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                          stderr=subprocess.DEVNULL)
            for name, words in commands.items()}


if __name__ == '__main__':
    sys.exit(main())
