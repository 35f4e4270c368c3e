# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command ``obc lqr``: verified gains for the plants and weights of files."""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from obc_ros.cli import results, terminal
from obc_ros.cli.ask.pool_batch import answer_all
from obc_ros.cli.ask.regulator_requests import Case
from obc_ros.core.lqr.design.report import read_matrices
from obc_ros.core.text.errors import quote

HEADER = ('case', 'status', 'gain K', 'poles')
DESIGN_COLOURS = {'solved': 'green', 'refused': 'red', 'malformed': 'red'}
WIDEST = 60  # characters of a cell


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `obc lqr`."""
    results.add_arguments(parser, 'cases')


def run(args: argparse.Namespace) -> int:
    """Design all regulators of all files; return the exit status."""
    results.make_folders(args)
    asked = answer_all(
        lambda: results.read_questions(Case, args.files), 'obc_ros.workers.designing',
        ('refused', 'refused'), None if args.server is None else partial(_ask_server, args.server),
        hidden=True)
    try:
        _show(asked)
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
                case.end(status if status == 'malformed' else 'refused',
                         words or response.message)


def _show(asked: list[Case]) -> None:
    terminal.print_table(HEADER, [_row(case) for case in asked], DESIGN_COLOURS)
    for case in asked:
        if case.message:
            print(quote(f'{case.label}: {case.message}', None))


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


def _row(case: Case) -> tuple[str, ...]:
    if not case.design:
        return case.label, case.status, '', ''
    told = read_matrices(case.design)
    gain = '; '.join(' '.join(f'{entry:.5g}' for entry in row) for row in told.K)
    return case.label, case.status, _short(gain), _short(', '.join(map(_pole, told.poles)))


def _pole(pole: complex) -> str:
    return f'{pole.real:.4g}' + (f'{pole.imag:+.4g}j' if pole.imag else '')


def _short(text: str) -> str:
    return text if len(text) <= WIDEST else text[:WIDEST - 3] + '...'
