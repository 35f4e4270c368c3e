# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Measurements of the benchmarks: candidates in turn within one run, on one thread, by medians.

Computations are timed by processor time, which depends less on other load of the machine. Calls
that wait for other processes are timed with ``clock=time.perf_counter``.

Import this before numpy: BLAS reads its number of threads when it is loaded.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import gc
from importlib import import_module
import os
from pathlib import Path
import platform
from statistics import median
import sys
import time
from types import TracebackType
from typing import Any

from obc_ros.core.text.errors import ObcError

Clock = Callable[[], float]

THREADS = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')
os.environ.update(dict.fromkeys(THREADS, '1'))

ROUNDS = 9
LEAST = 0.02  # [s] minimum duration of one measurement

_failed: list[str] = []


def _end(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print the exception that ended a benchmark: nothing for Ctrl-C, else the traceback."""
    if issubclass(kind, ObcError):
        print(error, file=sys.stderr)
    elif not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)


sys.excepthook = _end


@dataclass(frozen=True)
class Times:
    """Seconds for one call, one entry for each round."""

    rounds: tuple[float, ...]

    @property
    def median(self) -> float:
        """Return the median [s]."""
        return median(self.rounds)

    def ratio(self, other: 'Times') -> float:
        """Return the median over the rounds of the ratio of this time to the other one."""
        return median(mine / its for mine, its in zip(self.rounds, other.rounds, strict=True))

    def __str__(self) -> str:
        return f'{_si(self.median)} [{_si(min(self.rounds))} to {_si(max(self.rounds))}]'


def measure(rivals: Mapping[str, Callable[[], object]], *, rounds: int = ROUNDS,
            least: float = LEAST, per: float = 1.0,
            clock: Clock = time.process_time) -> dict[str, Times]:
    """
    Time each candidate once in each round, so that disturbances affect all of them.

    Parameters
    ----------
    rivals : mapping of str to callable
        The candidates; called repeatedly for at least `least` seconds.
    rounds : int
        At least 7.
    least : float
        Minimum duration of one measurement [s].
    per : float
        Number of operations in one call; times are for one operation.
    clock : callable
        Returns seconds.

    """
    if rounds < 7:
        raise ValueError(f'{rounds} rounds: a median needs at least 7')
    calls = {name: _calls(rival, least, clock) for name, rival in rivals.items()}
    times: dict[str, list[float]] = {name: [] for name in rivals}
    gc.collect()
    gc.disable()
    try:
        for _ in range(rounds):
            for name, rival in rivals.items():
                times[name].append(_time(rival, calls[name], clock) / calls[name] / per)
    finally:
        gc.enable()
    return {name: Times(tuple(each)) for name, each in times.items()}


def _calls(rival: Callable[[], object], least: float, clock: Clock) -> int:
    calls = 1
    while (taken := _time(rival, calls, clock)) < least:
        calls = max(2 * calls, int(calls * least / max(taken, 1e-9)) + 1)
    return calls


def _time(rival: Callable[[], object], calls: int, clock: Clock) -> float:
    start = clock()
    for _ in range(calls):
        rival()
    return clock() - start


def table(title: str, head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table, its columns aligned."""
    text = [list(map(str, head)), *(list(map(str, row)) for row in rows)]
    widths = [max(map(len, column)) for column in zip(*text, strict=True)]
    print(f'\n{title}')
    for index, row in enumerate(text):
        print('  ' + '  '.join(cell.ljust(width) for cell, width in
                               zip(row, widths, strict=True)).rstrip())
        if index == 0:
            print('  ' + '  '.join('-' * width for width in widths))


def times_table(title: str, times: Mapping[str, Times], against: str) -> None:
    """Print times, and their ratios to one of them."""
    table(title, ('', 'median [minimum to maximum]', f'against {against}'), [
        (name, each, f'{each.ratio(times[against]):.3g}') for name, each in times.items()])


def require(what: str, value: float, limit: float) -> None:
    """Print whether a value is within its limit; `finish` returns whether all are."""
    holds = value <= limit
    print(f'  {"holds" if holds else "FAILS"}: {what}: {value:.3g} (limit {limit:g})')
    if not holds:
        _failed.append(what)


def peer(module: str) -> Any:
    """Return an optional module; if it is missing, print this and return None."""
    try:
        return import_module(module)
    except ImportError as error:
        print(f'  skipped: {module} ({error})')
        return None


def arguments(description: str, **numbers: float) -> argparse.Namespace:
    """
    Return the parsed command line; `peers`: whether to measure optional tools, too.

    Parameters
    ----------
    description : str
        What the benchmark does.
    **numbers
        Further options ``--NAME``, with their defaults.

    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument('--peers', action='store_true', help='measure optional tools, too')
    for name, default in numbers.items():
        parser.add_argument(f'--{name}', type=type(default), default=default, metavar='N',
                            help=f'default: {default:g}')
    args = parser.parse_args()
    print(f'{_processor()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, '
          f'Python {platform.python_version()}, one thread')
    return args


def finish() -> int:
    """Return the exit status: 0 if all requirements hold."""
    if _failed:
        print(f'\nrequirements not met: {"; ".join(_failed)}', file=sys.stderr)
    return 1 if _failed else 0


def _si(seconds: float) -> str:
    for unit, size in (('s', 1.0), ('ms', 1e-3), ('us', 1e-6)):
        if seconds >= size:
            return f'{seconds / size:.3g} {unit}'
    return f'{seconds * 1e9:.3g} ns'


def _processor() -> str:
    file = Path('/proc/cpuinfo')  # of Linux
    lines = file.read_text(encoding='utf-8').splitlines() if file.exists() else []
    names = [line.split(':', 1)[1].strip() for line in lines if line.startswith('model name')]
    return names[0] if names else platform.machine()
