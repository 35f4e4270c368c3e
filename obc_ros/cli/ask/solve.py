# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command ``obc solve``: certified solutions of the problems of files."""

import argparse
from collections.abc import Sequence
import math
from pathlib import Path
import shutil
import sys
from typing import Any

from obc_ros.cli import results, terminal
from obc_ros.cli.ask.problem_requests import Question
from obc_ros.core.ocp.method_names import get_method, NAMES
from obc_ros.core.solver.options import list_options, read_options
from obc_ros.core.text.errors import ObcError, quote, StatementError
from obc_ros.workers.pool import LONGEST_LIMIT, SHORTEST

HEADER = ('problem', 'status', 'cost', 'certificate', 'optimum', 'method', 'time')
STATUS_COLOURS = dict.fromkeys(('solved', 'holds'), 'green') | dict.fromkeys(
    ('infeasible', 'not_converged', 'timed_out', 'cancelled', 'malformed'), 'red')

NARROW = 80   # characters: least width of a line of a tree


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `obc solve`."""
    results.add_arguments(parser, 'problems')
    parser.add_argument('--time-limit', metavar='S', type=_seconds, default=0.0,
                        help='time limit of each problem in seconds (default: that of the server)')
    parser.add_argument('--method', metavar='NAME', type=_method,
                        help=f"{', '.join(NAMES)}; overrides the key 'method' of the files")
    parser.add_argument('--option', metavar='NAME=VALUE', type=_option, action='append',
                        default=[], dest='options',
                        help='a number that steers the search, as multistart.most=20; for experts')
    parser.add_argument('--list-options', action=_ListOptions,
                        help='print all options: default, meaning, and a problem or a test '
                             'that needs the value; and exit')
    parser.add_argument('--trace', action='store_true',
                        help='print what was tried, as a tree, with cost, work and the reason')


def run(args: argparse.Namespace) -> int:
    """Solve all problems of all files; return the exit status."""
    results.make_folders(args)
    asked = results.read_questions(Question, args.files)
    answerable = [question for question in asked if question.problem]
    if answerable:
        _solve(answerable, args.time_limit, args.method or '', args.options)
    try:
        _show(asked)
        if args.trace:
            _print_trees(asked)
    finally:  # also if the reader of a pipe has closed it
        results.save_answers(asked, args, _draw)
    return results.get_exit_status(
        'solved' if question.result and question.result.success else
        'malformed' if question.status == 'malformed' else 'unanswered' for question in asked)


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not 0.0 < seconds <= LONGEST_LIMIT:
        raise argparse.ArgumentTypeError(
            f"wanted a positive number of seconds, at most {LONGEST_LIMIT:g}, found '{text}'")
    return seconds


def _method(name: str) -> str:
    try:
        return get_method(name)
    except StatementError as error:
        raise argparse.ArgumentTypeError(str(error).removeprefix('method: ')) from None


def _write(value: float | tuple[float, ...]) -> str:
    """Return a value as a user writes it."""
    return ','.join(f'{each:g}' for each in (value if isinstance(value, tuple) else (value,)))


def _option(text: str) -> str:
    try:
        read_options([text])
    except StatementError as error:
        raise argparse.ArgumentTypeError(str(error).removeprefix('option: ')) from None
    return text


class _ListOptions(argparse.Action):
    """Print all options and exit."""

    def __init__(self, option_strings: Sequence[str], dest: str, **settings: Any) -> None:
        super().__init__(option_strings, dest, nargs=0, **settings)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        rows = [(each.name, _write(each.value), each.unit, each.meaning, each.needed_by)
                for each in list_options()]
        terminal.print_table(('option', 'default', 'unit', 'meaning', 'needed by'), rows)
        parser.exit()


def _solve(asked: list[Question], time_limit: float, method: str,
           options: Sequence[str]) -> None:
    """Send the problems to a server; each has a status afterwards."""
    from obc_ros.cli.processes import InterruptedByUserError
    # For a server that is started here. Its default may be below the limit that is asked for; a
    # second worker process has nothing to do for one problem.
    parameters = [f'time_limit:={max(time_limit, SHORTEST)}'] if time_limit else []
    parameters += ['workers:=1'] if len(asked) == 1 else []
    try:
        from obc_ros.cli.ask.batch import RequestBatch  # ROS is imported only if it is needed
        from obc_ros.cli.client import connect_client
        with connect_client(*parameters) as client, terminal.show_progress() as lines:
            RequestBatch(client, asked, time_limit, lines, method, options).work()
    except (InterruptedByUserError, KeyboardInterrupt) as error:
        _end(asked, 'cancelled', str(error) or 'ended by SIGINT')
    except ObcError as error:
        _end(asked, 'not_converged', str(error))


def _end(asked: list[Question], status: str, message: str) -> None:
    """End all problems that have no status yet."""
    for question in asked:
        if not question.status:
            question.end(status, message)


def _draw(path: Path, question: Question) -> None:
    answer = question.answer
    if answer.has_path:
        results.save_figure(answer.plot(), path)
        if answer.trace.costs > 1:
            results.save_figure(answer.plot_search(), path.with_suffix('.search.png'))


def _print_trees(asked: Sequence[Question]) -> None:
    """Print what was tried for each problem that a server has worked on."""
    width = (max(NARROW, shutil.get_terminal_size().columns) if sys.stdout.isatty() else None)
    for question in asked:
        if question.result is not None:
            print(f'\n{question.label}: what was tried')
            print(question.answer.trace.format(width))


def _show(asked: list[Question]) -> None:
    terminal.print_table(HEADER, [_row(question) for question in asked], STATUS_COLOURS)
    for question in asked:
        if found := question.result and question.result.free_parameters:
            print(f'{question.label}: ' + ', '.join(
                f'{each.name} = {each.values[0]:.10g}' for each in found))
        if question.status != 'solved' and question.message:
            print(quote(f'{question.label}: {question.message}', None))


def _row(question: Question) -> tuple[str, ...]:
    result = question.result
    if not result or not result.trajectory.t:
        return question.label, question.status, '', '', '', '', _time(question.took)
    certificate = result.certificate
    verdict = 'holds' if certificate.holds else certificate.sentence
    return (question.label, question.status, f'{result.objective:.10g}', verdict,
            _optimum(result.optimality), result.method, _time(question.took))


def _optimum(known: Any) -> str:
    """Return an Optimality message in a few words."""
    if known.kind != 'local':
        return known.kind and f'{known.kind} ({known.reason})'
    return f'local, best of {len(known.minima)}' if len(known.minima) > 1 else 'local, 1 found'


def _time(seconds: float) -> str:
    return '' if math.isnan(seconds) else f'{seconds:.3f} s'
