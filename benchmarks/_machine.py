# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Measurements of the machine: memory and processor time of processes, and stalls of the machine.

The host of a virtual machine may pause it for a tenth of a second. A process that only sleeps
records such stalls, so that they are not attributed to the measured processes. It is ``python
_machine.py [CORE]``, on any core or on a given one.
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

SLEEP = 2e-3    # [s] of the sleeping process
STALL = 10e-3   # [s] by which a sleep is late if it counts as a stall
_PAGE, _TICK = os.sysconf('SC_PAGE_SIZE'), os.sysconf('SC_CLK_TCK')


def memory(pid: int) -> float:
    """Return the resident memory of a process [MiB]."""
    return int(Path(f'/proc/{pid}/statm').read_text().split()[1]) * _PAGE / 2**20


def share(pid: int) -> float:
    """Return the memory of a process [MiB]; shared pages are divided among their users."""
    lines = Path(f'/proc/{pid}/smaps_rollup').read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith('Pss:')) / 1024


def processor_time(pid: int) -> float:
    """Return the processor time that a process has used [s]."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICK


def children(pid: int) -> list[int]:
    """Return the child processes of a process; its threads may end meanwhile."""
    found = []
    for file in Path(f'/proc/{pid}/task').glob('*/children'):
        with suppress(FileNotFoundError, ProcessLookupError):
            found += [int(each) for each in file.read_text().split()]
    return found


def zombies(pids: Iterable[int]) -> list[int]:
    """Return the given processes that are zombies."""
    found = []
    for pid in pids:
        try:
            state = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0]
        except OSError:  # it no longer exists
            continue
        found += [pid] if state == 'Z' else []
    return found


class Stalls:
    """Records the stalls of the machine until `end`."""

    def __init__(self) -> None:
        # a pipe that is not read would block the process
        self._told = tempfile.TemporaryFile('w+')  # noqa: SIM115 - closed by `end`
        self._process = subprocess.Popen([sys.executable, __file__], stdout=self._told)

    def end(self) -> list[tuple[float, float]]:
        """Return begin, by the monotonic clock, and duration [s] of each stall."""
        self._process.terminate()
        self._process.wait()
        with self._told as lines:
            lines.seek(0)
            return [(float(begin), float(length)) for begin, length in map(str.split, lines)]


def still(stalls: list[tuple[float, float]], begin: float, end: float) -> float:
    """Return the total duration [s] of stalls within an interval."""
    return sum(max(0.0, min(since + length, end) - max(since, begin))
               for since, length in stalls)


def told(stalls: list[tuple[float, float]]) -> str:
    """Return stalls in words."""
    if not stalls:
        return f'no stall of the machine above {1e3 * STALL:g} ms'
    lengths = [length for _, length in stalls]
    return (f'the machine stalled {len(stalls)} times, for {1e3 * STALL:g} to '
            f'{1e3 * max(lengths):.0f} ms, {sum(lengths):.2f} s in all')


def main() -> None:
    """Sleep, and print begin and delay of each sleep that was too long."""
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
