# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command ``obc solve``: certified solutions of the problems of files."""

import argparse
from collections.abc import Sequence
from functools import partial
from importlib import import_module
import math
from pathlib import Path
from typing import Any

from obc_ros.api.figures.files import save_figure
from obc_ros.cli import results
from obc_ros.cli.ask.batch import answer_all, Question
from obc_ros.cli.terminal import get_width, Parser, print_table
from obc_ros.core.ocp.method_names import ACCEPTED, get_method, NAMES
from obc_ros.core.ocp.solution import Condition, Optimality, Solution
from obc_ros.core.text.errors import StatementError
from obc_ros.core.text.example_files import choose_file
from obc_ros.core.text.tables import format_value
from obc_ros.workers.pool import LONGEST_LIMIT, TIME_LIMIT

HEADER = ('problem', 'status', 'cost', 'certificate', 'optimum', 'method', 'time')
STATUS_COLOURS = {'solved': 'green', 'holds': 'green', 'feasible': 'yellow'} | dict.fromkeys(
    ('infeasible', 'not_converged', 'timed_out', 'cancelled', 'malformed'), 'red')

VANISHING_COST = 1e-6   # to which the certificate compares the error of a cost of 0
NARROW = 80   # characters: least width of a line of a tree


def add_arguments(parser: Parser) -> None:
    """Declare the arguments of `obc solve`."""
    results.add_arguments(parser, 'problems')
    parser.add_argument('--time-limit', metavar='S', type=_seconds, default=0.0,
                        help='time limit of each problem in seconds (default: '
                             f'{TIME_LIMIT:g}, or that of the server)')
    parser.add_argument('--method', metavar='NAME', type=_method,
                        help=f"{', '.join(NAMES)}; overrides the key 'method' of the files")
    parser.add_argument('--accept', choices=ACCEPTED, default='',
                        help='path: end at the first path that meets all constraints; best: end '
                             'at the time limit with the best one if none is certified by then '
                             "(default: the key 'accept' of the files, or certified)")
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
    asked = answer_all(
        lambda: _read(args), 'obc_ros.workers.solving', ('cancelled', 'not_converged'),
        None if args.server is None else partial(_ask_server, args), args.time_limit)
    try:
        _show(asked)
        if args.trace:
            _print_trees(asked)
    finally:  # also if the reader of a pipe has closed it
        results.save_answers(asked, args, _draw)
    return results.get_exit_status(map(_get_ending, asked))


def _get_ending(question: Question) -> str:
    """Return a status for the exit status: a path is an answer if it was asked for."""
    if question.status == 'feasible':
        return 'solved'
    certified = question.solution and question.solution.certified
    return question.status if question.status != 'solved' or certified else 'unanswered'


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
    return ','.join(f'{each:g}' for each in (value if isinstance(value, tuple) else (value,)))


def _option(text: str) -> str:
    from obc_ros.core.solver.options import read_options  # 10 ms
    try:
        read_options([text])
    except StatementError as error:
        raise argparse.ArgumentTypeError(str(error).removeprefix('option: ')) from None
    return text


class _ListOptions(argparse.Action):
    def __init__(self, option_strings: Sequence[str], dest: str, **settings: Any) -> None:
        super().__init__(option_strings, dest, nargs=0, **settings)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from obc_ros.core.solver.options import list_options
        rows = [(each.name, _write(each.value), each.unit, each.meaning, each.needed_by)
                for each in list_options()]
        print_table(('option', 'default', 'unit', 'meaning', 'needed by'), rows)
        parser.exit()


def _read(args: argparse.Namespace) -> list[Question]:
    asked = results.read_questions(Question, map(choose_file, args.files))
    for question in asked:
        question.method, question.accept = args.method or '', args.accept
        question.options = args.options
    if args.json or args.plot or args.trace:
        import_module('obc_ros.api.answer')  # while the worker starts
    return asked


def _ask_server(args: argparse.Namespace, asked: Sequence[Question]) -> None:
    from obc_ros.cli.ask.server_batch import answer_by_server  # ROS is imported only if needed
    answer_by_server(args.server, asked, args.time_limit)


def _draw(path: Path, question: Question, formats: Sequence[str]) -> None:
    if question.solution and question.solution.t.size:
        from obc_ros.api.answer import draw_answer, draw_answer_search  # with CasADi
        answer = question.read_answer(with_problem=True)
        save_figure(draw_answer(answer), path, formats)
        if answer.trace.costs > 1:
            save_figure(draw_answer_search(answer), path.with_name(f'{path.name}.search'), formats)


def _print_trees(asked: Sequence[Question]) -> None:
    """Print what was tried for each problem that was worked on."""
    width = (columns := get_width()) and max(NARROW, columns)
    for question in asked:
        if question.solution:
            print(f'\n{question.label}: what was tried')
            print(question.read_answer().trace.format(width))


def _show(asked: list[Question]) -> None:
    print_table(HEADER, [
        _row(question) for question in asked if question.status != 'malformed'], STATUS_COLOURS)
    for question in asked:
        if found := question.solution and question.solution.free_parameters:
            print(f'{question.label}: ' + ', '.join(
                f'{name} = {format_value(value)}' for name, value in found.items()))
        remark = question.solution.remark if question.solution else ''
        if sentence := remark if question.status == 'solved' else question.message:
            results.print_lines(question.label, sentence)


def _row(question: Question) -> tuple[str, ...]:
    found = question.solution
    if not found or not found.t.size:
        return question.label, question.status, '', '', '', '', _time(question.took)
    verdict = found.certificate and ('holds' if found.certified else 'does not hold')
    return (question.label, question.status, _cost(found), verdict or '',
            _optimum(found.optimality), found.method, _time(question.took))


def _cost(found: Solution) -> str:
    """Return the cost; 0 if the certificate cannot tell it from 0."""
    allowed = found.certificate.tolerances[Condition.COST] if found.certificate else 0.0
    return f'{found.objective:.10g}' if abs(found.objective) > allowed * VANISHING_COST else '0'


def _optimum(known: Optimality | None) -> str:
    """Return the optimality in a few words."""
    if known is None:
        return ''
    if known.kind != 'local':
        return f'{known.kind} ({known.reason})'
    return f'local, best of {len(known.minima)}' if len(known.minima) > 1 else 'local, 1 found'


def _time(seconds: float) -> str:
    return '' if math.isnan(seconds) else f'{seconds:.3f} s'
