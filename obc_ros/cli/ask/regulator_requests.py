# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The cases of linear quadratic regulators in files: the keys are in docs/problems.md."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
from obc_ros.cli.results import Asked
from obc_ros.core.lqr.case_plants import CASE_WEIGHTS, format_weights, take_plant
from obc_ros.core.lqr.design.design import linearize_plant
from obc_ros.core.lqr.design.report import read_matrices
from obc_ros.core.lqr.weights import WEIGHT_KINDS
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems.file import build_plant, FOR_PEOPLE
from obc_ros.core.systems.file_kinds import FileKind, refuse_others
from obc_ros.core.systems.registry import find_registered
from obc_ros.core.text.errors import (
    DependentError,
    describe_type,
    Faults,
    StatementError,
    suggest_name,
)
from obc_ros.core.text.expressions import parse_number
from obc_ros.core.text.fields import check_keys, read_section
from obc_ros.workers.wire import Packet

PLANT = ('A', 'B')
SYSTEM = ('parameters', 'setpoint', 'setpoint_input')
LISTS = ('cross', 'x_max', 'u_max', 'H')
NUMBERS = ('rho', 'stability', 'sample_time', 'delay')
KEYS = ('name', 'system', *PLANT, *SYSTEM, 'weights', 'Qx', 'Qu', *LISTS, *NUMBERS)


@dataclass(eq=False)
class Case(Asked):
    """
    A regulator to be designed.

    `given` holds the entries of the file by key; None if it is malformed. `design` has the fields
    of the message LqrDesign; None if there is none. `note` is added to the message of a design.
    """

    kind: ClassVar[str] = 'design_lqr'
    examples: ClassVar[bool] = False

    given: dict[str, Any] | None = None
    note: str = ''
    design: Any = field(default=None, repr=False)

    def take(self, entry: dict[str, Any]) -> None:
        """Check the entries of the case, and keep them."""
        refuse_others(entry, (FileKind.CASE, FileKind.PLANT), self.file)
        plant, case = take_plant(entry, self.file.parent)
        if plant and not set(CASE_WEIGHTS) & set(entry):
            self.note = f"weights by Bryson's rule: {format_weights(case)}"
        self.given = check_case(case, plant)

    def make_request(self) -> Packet:
        """Return the request to a worker."""
        given = self.given or {}
        return Packet(
            {'system': given.get('system', ''), 'parameters': given.get('parameters', {}),
             'weights': given['weights'], **{key: given.get(key, 0.0) for key in NUMBERS}},
            {key.lower(): given.get(key, np.zeros(0)) for key in (
                *PLANT, *SYSTEM[1:], 'Qx', 'Qu', *LISTS)})

    def take_response(self, response: Packet) -> None:
        """Keep the design of a worker; without one, the case is refused or malformed."""
        status, message = response.plain['status'], response.plain['message']
        if status == 'solved':
            self.design = SimpleNamespace(**response.plain['design'], **response.arrays)
        self.end(status if status in ('solved', 'malformed') else 'refused', message)

    def end(self, status: str, message: str) -> None:
        """Set status and message of the result."""
        super().end(status, '; '.join(filter(None, (
            message, self.note if status == 'solved' else ''))))

    def as_json(self) -> dict[str, Any]:
        """Return the contents of ``NAME.json``; without a design, the matrices are empty."""
        found: dict[str, Any] = {'name': self.name, 'status': self.status,
                                 'message': self.message, 'K': [], 'P': [], 'poles': []}
        if self.design:
            told = read_matrices(self.design)
            found |= {'K': told.K.tolist(), 'P': told.P.tolist(),
                      'poles': [[pole.real, pole.imag] for pole in told.poles.tolist()]}
        return found


def check_case(mapping: Mapping[Any, Any], plant: Mapping[str, Any] | None = None
               ) -> dict[str, Any]:
    """
    Return the checked entries of a case by key: flat arrays, numbers and names.

    :param plant: as `take_plant` returns it; its linearization takes its place.
    """
    given = {key: value for key, value in mapping.items() if key in KEYS and value is not None}
    found = {key: given[key] for key in ('system', 'parameters') if key in given}
    with Faults(mapping) as faults:
        faults.attempt(check_keys, mapping, KEYS, FOR_PEOPLE)
        if plant is not None:
            linear = faults.attempt(_linearize, plant, given)
            if linear is None:
                raise DependentError('the plant is malformed')
            given |= linear
            found = {}
        sizes = faults.attempt(_system if 'system' in given else _plant, given)
        for key, size in zip(('Qx', 'Qu'), sizes or (), strict=False):
            if key in given:
                found[key] = faults.attempt(_weight, key, given[key], size)
        for key in (*PLANT, *LISTS, 'setpoint', 'setpoint_input'):
            if key in given:
                found[key] = faults.attempt(_flat, key, given[key])
        for key in NUMBERS:
            if key in given:
                found[key] = faults.attempt(parse_number, given[key], {}, key)
        found['weights'] = faults.attempt(_kind_of_weights, given.get('weights', 'matrices'))
        for key in ('Qx', 'Qu') if found['weights'] == 'matrices' else ():
            if key not in given:
                faults.note(StatementError(
                    f'{key}: missing; wanted a list of rows or a diagonal'))
    return found


def _kind_of_weights(value: object) -> str:
    if value not in WEIGHT_KINDS:
        raise StatementError(f'weights: wanted one of {", ".join(WEIGHT_KINDS)}, found '
                             f'{describe_type(value)}{suggest_name(str(value), WEIGHT_KINDS)}')
    return str(value)


def _linearize(plant: Mapping[str, Any], given: dict[str, Any]) -> dict[str, Any]:
    """Return A and B of a plant at its set point, which are taken out of a case."""
    at = [_flat(key, given.pop(key)).tolist() if key in given else []
          for key in ('setpoint', 'setpoint_input')]
    system = build_plant(plant, read_section(given, 'parameters'))
    given.pop('parameters', None)
    linear = linearize_plant(system, *at)
    return {'A': linear.A.tolist(), 'B': linear.B.tolist()}


def _system(given: Mapping[str, Any]) -> tuple[int, int]:
    """Return the numbers of states and inputs of the named system."""
    for key in PLANT:
        if key in given:
            raise StatementError(f"{key}: the system defines it already; give either 'system' or "
                                 "'A' and 'B'")
    parameters = given.get('parameters', {})
    if not isinstance(given['system'], str):
        raise StatementError(f'system: wanted a name, found {describe_type(given["system"])}')
    if not isinstance(parameters, Mapping) or not all(isinstance(key, str) for key in parameters):
        raise StatementError('parameters: wanted a mapping of names to numbers, found '
                             f'{describe_type(parameters)}')
    system = find_registered(given['system'], parameters)
    return system.n, system.m


def _plant(given: Mapping[str, Any]) -> tuple[int, int]:
    with Faults() as faults:
        for key in PLANT:
            if key not in given:
                faults.note(StatementError(f"{key}: missing; wanted a list of rows (or 'system')"))
        for key in SYSTEM:
            if key in given:
                faults.note(StatementError(f"{key}: goes with 'system', not with 'A' and 'B'"))
        A: Array = faults.attempt(_matrix, 'A', given.get('A', 0))
        B: Array = faults.attempt(_matrix, 'B', given.get('B', 0))
    if A.shape[0] != A.shape[1]:
        raise StatementError(f'A: wanted as many columns as rows, found {A.shape[0]} rows of '
                             f'{A.shape[1]}')
    if len(B) != len(A):
        raise StatementError(f'B: wanted {len(A)} rows as A has, found {len(B)}')
    return len(B), B.shape[1]


def _weight(key: str, value: Any, n: int) -> Array:
    """Return the n*n entries of a weight, or the n entries of its diagonal."""
    M = _matrix(key, value)
    is_diagonal = M.size == n and not _has_rows(value)
    if M.shape != (n, n) and not is_diagonal:
        raise StatementError(f'{key}: wanted {n} rows of {n}, or a diagonal of {n} numbers, '
                             f'found {M.shape[0]} of {M.shape[1]}')
    return M.ravel()


def _flat(key: str, value: Any) -> Array:
    return _matrix(key, value).ravel()


def _matrix(key: str, value: Any) -> Array:
    """Return a matrix, given as a list of rows, as one row, or as a number."""
    rows = value if isinstance(value, (list, tuple)) else [value]
    if not _has_rows(rows):
        rows = [rows]
    for index, row in enumerate(rows):
        if not isinstance(row, (list, tuple)):
            raise StatementError(
                f'{key}[{index}]: wanted a row of numbers, found {describe_type(row)}')
        if len(row) != len(rows[0]) or not row:
            raise StatementError(f'{key}[{index}]: wanted a row of {len(rows[0]) or "numbers"}, '
                                 f'found one of {len(row)}')
    return np.array([[parse_number(entry, {}, f'{key}[{i}][{j}]') for j, entry in enumerate(row)]
                     for i, row in enumerate(rows)])


def _has_rows(value: Any) -> bool:
    return isinstance(value, (list, tuple)) and any(
        isinstance(row, (list, tuple)) for row in value)
