# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command ``obc sweep``: one problem solved for many values of its numbers."""

import argparse
from collections.abc import Callable, Sequence
import math
from pathlib import Path
import sys
import time
from typing import Any

from obc_ros.api.sweep import (
    choose_workers,
    CHUNK,
    DATASET,
    load_numbers,
    Sweep,
    SweepProgress,
    SweepQuestion,
    SweepSettings,
    WITHOUT_DASK,
    Workers,
)
from obc_ros.cli import results
from obc_ros.cli.terminal import Lines, Parser, print_table, show_progress
from obc_ros.core.text.errors import DynamicsError, ObcError, quote, StatementError
from obc_ros.core.text.example_files import choose_file
from obc_ros.sweep.axes import make_axes, make_draws, parse_axes, parse_draws
from obc_ros.sweep.cluster.connection import explain_exposure
from obc_ros.sweep.dataset import WITH_ANSWER

HEADER = ('status', 'points', 'share')
SHOWN = 5           # messages of points that are not solved
PLAIN_PERIOD = 10.0  # [s] between two lines of progress without a terminal


def add_arguments(parser: Parser) -> None:
    """Declare the arguments of `obc sweep`."""
    parser.add_argument('file', metavar='FILE', type=Path, help='YAML file with one problem')
    parser.add_argument('--over', metavar='KEY=VALUES', action='append', default=[],
                        help="axis of a grid: 'x0.p=-2:2:101' or 'mass=1,2,4'; repeatable")
    parser.add_argument('--sample', metavar='KEY~DIST', action='append', default=[],
                        help="random number: 'x0.v~normal(0,1)', uniform(LOWER,UPPER), "
                             'lognormal(MEAN,DEVIATION); repeatable')
    parser.add_argument('--count', metavar='N', type=int, default=0, help='number of samples')
    parser.add_argument('--seed', metavar='N', type=int, default=0,
                        help='of the random numbers (default: 0)')
    parser.add_argument('--out', metavar='DIR', type=Path, required=True,
                        help=f'folder of the journal and of {DATASET}')
    parser.add_argument('--plot', action='store_true',
                        help='also write the figures value and success to DIR')
    results.add_format(parser)
    parser.add_argument('--resume', action='store_true',
                        help='go on with the sweep in DIR, which has the same arguments')
    parser.add_argument('--scheduler', metavar='ADDRESS', default='',
                        help='Dask scheduler, as tls://host:8786 (default: processes of this '
                             f'machine, through Dask if it is installed; {WITHOUT_DASK}: '
                             'without Dask)')
    parser.add_argument('--workers', metavar='N', type=int, default=0,
                        help='number of processes on this machine (default: one for each '
                             'processor)')
    parser.add_argument('--chunk', metavar='N', type=int, default=CHUNK,
                        help='largest number of neighbours that one worker solves one after the '
                             f'other (default: {CHUNK})')
    parser.add_argument('--time-limit', metavar='S', type=float, default=60.0,
                        help='of each point, in seconds (default: 60)')
    parser.add_argument('--method', metavar='NAME', default='',
                        help="method of solution; overrides the key 'method' of the file")
    parser.add_argument('--option', metavar='NAME=VALUE', action='append', default=[],
                        dest='options', help='a number that steers the search; see obc solve')
    parser.limit('--format', needs=['--plot'])
    parser.limit('--count', '--seed', needs=['--sample'])


def run(args: argparse.Namespace) -> int:
    """Solve all points; return the exit status."""
    try:
        sweep, workers = _ask(args)
        sweep.check(args.resume)
    except (StatementError, DynamicsError) as error:
        for line in str(error).split('\n'):
            print(f'obc sweep: {line}', file=sys.stderr)
        return 2
    if args.scheduler not in ('', WITHOUT_DASK) and (
            exposure := explain_exposure(args.scheduler)):
        print(f'obc sweep: {exposure}', file=sys.stderr)
    why = _solve(sweep, workers, args.resume)
    if sweep.done:
        dataset = sweep.save()
        _show(sweep)
        if args.plot:
            _draw(dataset, args.out, args.format)
    if sweep.done < sweep.question.points:
        print(f'obc sweep: {why}; {sweep.done} of {sweep.question.points} points are done; the '
              'same command with --resume solves the others', file=sys.stderr)
        return 1
    return int(sum(sweep.statuses[status] for status in WITH_ANSWER) < sweep.question.points)


def _ask(args: argparse.Namespace) -> tuple[Sweep, Workers]:
    """Return the sweep that the arguments describe, and what solves its points."""
    question = SweepQuestion(
        load_numbers(choose_file(args.file)), make_axes(parse_axes(args.over)),
        make_draws(parse_draws(args.sample)), args.count,
        SweepSettings(args.seed, args.chunk, args.time_limit, args.method, tuple(args.options)))
    return Sweep(question, args.out), choose_workers(args.scheduler, args.workers)


def _solve(sweep: Sweep, workers: Workers, resume: bool) -> str:
    """Solve the points; return why not all of them are solved, if so."""
    try:
        with show_progress() as lines:
            sweep.run(workers, resume, _reporter(lines))
    except KeyboardInterrupt:
        return 'ended by SIGINT'
    except ObcError as error:
        return str(error)
    return ''


def _draw(dataset: Any, folder: Path, formats: Sequence[str]) -> None:
    from obc_ros.cli.ask.sweep_figures import draw_sweep  # matplotlib takes a second
    paths = draw_sweep(dataset, folder, formats)
    print(f'written: {quote(", ".join(map(str, paths)), None)}' if paths else
          'no figures: they are drawn for one or two axes, and for samples without an axis')


def _reporter(lines: Lines) -> Callable[[SweepProgress], None]:
    """Return what shows progress: on a terminal at once, elsewhere from time to time."""
    told = [time.monotonic()]

    def report(progress: SweepProgress) -> None:
        lines.update('sweep', _describe(progress))
        now = time.monotonic()
        if not sys.stderr.isatty() and now - told[0] >= PLAIN_PERIOD:
            told[0] = now
            print(f'sweep: {_describe(progress)}', file=sys.stderr, flush=True)

    return report


def _describe(progress: SweepProgress) -> str:
    words = [f'{progress.done} of {progress.total}']
    if progress.rate > 0.0:
        words.append(f'{progress.rate:.3g}/s')
    if math.isfinite(progress.left):
        words.append(f'{progress.left:.0f} s left')
    words += [f'{count} {status}' for status, count in sorted(progress.statuses.items())
              if status != 'solved']
    return ', '.join(words)


def _show(sweep: Sweep) -> None:
    """Print how the points ended, and the reasons of the first that are not solved."""
    statuses = sweep.statuses
    print_table(HEADER, [
        (status, str(count), f'{count / sweep.question.points:.2%}')
        for status, count in statuses.most_common()])
    for values, message in sweep.messages(SHOWN):
        place = ', '.join(f'{key} = {value:.6g}' for key, value in values.items())
        print(quote(f'{place}: {message}', None))
    if sweep.folder:
        print(f'written: {quote(str(sweep.folder / DATASET), None)}')
