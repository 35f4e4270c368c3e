# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command ``obc lqr``: verified gains for the plants and weights of files."""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path
import sys
from typing import Any

import numpy as np
from obc_ros.cli import results
from obc_ros.cli.ask.batch import answer_all
from obc_ros.cli.ask.regulator_requests import Case
from obc_ros.cli.terminal import get_width, Parser, print_table
from obc_ros.core.lqr.design.report import Matrices, read_matrices
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.tables import format_value

HEADER = ('case', 'status', 'gain K', 'poles')
DESIGN_COLOURS = {'solved': 'green', 'refused': 'red', 'malformed': 'red'}
WIDEST = 60   # characters of a cell
INDENT = '    '   # of what does not fit into the line of a row
CUT = ' ...'   # at the end of a cell that is not whole


def add_arguments(parser: Parser) -> None:
    """Declare the arguments of `obc lqr`."""
    results.add_arguments(parser, 'cases')
    parser.add_argument('--full', action='store_true',
                        help='print K, P and the poles whole, with ten digits')


def run(args: argparse.Namespace) -> int:
    """Design all regulators of all files; return the exit status."""
    results.make_folders(args)
    asked = answer_all(
        lambda: results.read_questions(Case, args.files), 'obc_ros.workers.designing',
        ('refused', 'refused'), None if args.server is None else partial(_ask_server, args.server),
        hidden=True)
    try:
        _show(asked, args.full)
    finally:  # also if the reader of a pipe has closed it
        results.save_answers(asked, args, _draw)
    return results.get_exit_status(case.status for case in asked)


def _ask_server(server: str, asked: Sequence[Case]) -> None:
    from obc_ros.cli.client import connect_client  # ROS is imported only if needed
    from obc_ros.srv import DesignLqr
    with connect_client(server) as client:
        for case in asked:
            response = client.ask(DesignLqr, 'design_lqr', _request(DesignLqr, case.given))
            if response.success:
                case.design = response.design
                case.end('solved', response.message)
            else:
                status, _, words = response.message.partition(': ')
                case.end(status if status == 'malformed' else 'refused', words or response.message)


def _show(asked: list[Case], full: bool) -> None:
    rows = [_row(case, full) for case in asked if case.status != 'malformed']
    print_table(HEADER, rows, DESIGN_COLOURS)
    for case in asked:
        if full and case.design:
            _print_matrices(case)
        if case.message:
            results.print_lines(case.label, case.message)
    if any(cell.endswith(CUT) for row in rows for cell in row[2:]):
        print('--full prints what does not fit into the table')


def _print_matrices(case: Case) -> None:
    told = read_matrices(case.design)
    p = np.sqrt(np.maximum(np.diag(told.P), 0.0))
    gain = 'K of u = ue - K (predicted state - xe)' if case.design.delay else 'K'
    for name, rows in ((gain, _format_gain(told, 10)),
                       ('P', _format_entries(told.P, np.outer(p, p), 10)),
                       ('poles', [[_pole(pole, 10)] for pole in told.poles])):
        print(f'{case.label}: {name} =')
        wide = 2 + max(len(entry) for row in rows for entry in row)
        fitting = max(1, ((get_width() or sys.maxsize) - len(INDENT)) // wide)
        for row in rows:
            for first in range(0, len(row), fitting):
                entries = ''.join(each.rjust(wide) for each in row[first:first + fitting])
                print(INDENT * bool(first) + entries)


def _draw(path: Path, case: Case, formats: Sequence[str]) -> None:
    if case.design:
        from obc_ros.cli.ask import regulator_figures  # matplotlib and control take a second
        regulator_figures.draw_regulator(path, case, formats)


def _request(service: Any, given: Any) -> Any:
    from obc_ros.msg import LqrWeights
    from obc_ros.ros.messages import build_named_expressions, flatten_doubles

    def numbers(*keys: str) -> dict[str, Any]:
        return {key.lower(): flatten_doubles(given[key]) for key in keys if key in given}

    plain = {key: given[key] for key in ('system', 'sample_time', 'delay') if key in given}
    return service.Request(
        system_parameters=build_named_expressions(given.get('parameters', {})),
        weights=LqrWeights(
            weights=given['weights'],
            **numbers('Qx', 'Qu', 'cross', 'x_max', 'u_max', 'H'),
            **{key: given[key] for key in ('rho', 'stability') if key in given}),
        **plain, **numbers('A', 'B', 'setpoint', 'setpoint_input'))


def _row(case: Case, full: bool) -> tuple[str, ...]:
    if full or not case.design:
        return case.label, case.status, '', ''
    told = read_matrices(case.design)
    gain = '; '.join(' '.join(row) for row in _format_gain(told, 5))
    poles = ', '.join(_pole(pole, 4) for pole in told.poles)
    return case.label, case.status, _shorten(gain, ' '), _shorten(poles, ', ')


def _format_gain(told: Matrices, digits: int) -> list[list[str]]:
    """
    Return the entries of K as text.

    By P >= 0 the size of K[i, j] is judged in units in which Qu and P have diagonals of ones,
    whatever the units of the plant. What is far smaller is a rounding error and printed as 0.
    """
    p, q = np.diag(told.P), np.diag(told.Qu)
    return _format_entries(
        told.K, np.sqrt(np.maximum(p, 0.0)[None, :] / q[:, None]), digits)


def _format_entries(values: Array, scales: Array, digits: int) -> list[list[str]]:
    return [[format_value(value, digits, scale) for value, scale in zip(*each, strict=True)]
            for each in zip(values, scales, strict=True)]


def _pole(pole: complex, digits: int) -> str:
    """Return a pole as text, without the imaginary part that rounding gives to a double one."""
    is_real = abs(pole.imag) < 1e-7 * abs(pole)
    return f'{pole.real:.{digits}g}' + ('' if is_real else f'{pole.imag:+.{digits}g}j')


def _shorten(text: str, separator: str) -> str:
    """Return a text that fits into a cell, cut between two entries."""
    if len(text) <= WIDEST:
        return text
    return text[:WIDEST - len(CUT)].rpartition(separator)[0].rstrip(';,') + CUT
