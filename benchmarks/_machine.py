# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What the machine did meanwhile: memory and processor time of processes, and its own stalls.

A virtual machine may stand still for a tenth of a second; a process that does nothing but sleep
tells when, so that nobody else is blamed. ``python _machine.py [CORE]`` is that process, on any
core or on one.
"""

from collections.abc import Iterable
from contextlib import suppress
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time

SLEEP = 2e-3    # [s] of the process that does nothing
STALL = 10e-3   # [s] that it is late when the machine is said to have stood still
_PAGE, _TICK = os.sysconf('SC_PAGE_SIZE'), os.sysconf('SC_CLK_TCK')


def memory(pid: int) -> float:
    """Return the resident memory of a process [MiB]."""
    return int(Path(f'/proc/{pid}/statm').read_text().split()[1]) * _PAGE / 2**20


def share(pid: int) -> float:
    """Return the memory of a process [MiB], what it shares with others divided among them."""
    lines = Path(f'/proc/{pid}/smaps_rollup').read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith('Pss:')) / 1024


def processor_time(pid: int) -> float:
    """Return the processor time that a process has used [s]."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICK


def children(pid: int) -> list[int]:
    """Return the processes that a process has started; threads may end meanwhile."""
    found = []
    for file in Path(f'/proc/{pid}/task').glob('*/children'):
        with suppress(FileNotFoundError, ProcessLookupError):
            found += [int(each) for each in file.read_text().split()]
    return found


def zombies(pids: Iterable[int]) -> list[int]:
    """Return those of some processes that have ended and wait for their parent."""
    found = []
    for pid in pids:
        try:
            state = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0]
        except OSError:  # it has gone
            continue
        found += [pid] if state == 'Z' else []
    return found


class Stalls:
    """Watches the machine until `end`."""

    def __init__(self) -> None:
        # a pipe that nobody reads would hold the process up
        self._told = tempfile.TemporaryFile('w+')  # noqa: SIM115 - closed by `end`
        self._process = subprocess.Popen([sys.executable, __file__], stdout=self._told)

    def end(self) -> list[tuple[float, float]]:
        """Return when the machine stood still, by the steady clock, and how long [s]."""
        self._process.terminate()
        self._process.wait()
        with self._told as lines:
            lines.seek(0)
            return [(float(begin), float(length)) for begin, length in map(str.split, lines)]


def still(stalls: list[tuple[float, float]], begin: float, end: float) -> float:
    """Return for how long [s] of a time the machine stood still."""
    return sum(max(0.0, min(since + length, end) - max(since, begin))
               for since, length in stalls)


def told(stalls: list[tuple[float, float]]) -> str:
    """Return stalls in words."""
    if not stalls:
        return f'the machine never stood still for {1e3 * STALL:g} ms'
    lengths = [length for _, length in stalls]
    return (f'the machine itself stood still {len(stalls)} times for {1e3 * STALL:g} to '
            f'{1e3 * max(lengths):.0f} ms, {sum(lengths):.2f} s in all')


def main() -> None:
    """Sleep, and tell when a sleep was too long: since when, and by how much."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: sys.exit())
    if sys.argv[1:]:
        os.sched_setaffinity(0, {int(sys.argv[1])})
    last = time.monotonic()
    while True:
        time.sleep(SLEEP)
        now = time.monotonic()
        if now - last > SLEEP + STALL:
            print(last, now - last - SLEEP, flush=True)
        last = now


if __name__ == '__main__':
    main()
