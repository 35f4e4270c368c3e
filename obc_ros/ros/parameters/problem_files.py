# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Problem files that give a node the start values of its parameters."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.statement import build_problem, load_file
from obc_ros.core.systems.registry import is_file
from obc_ros.core.text.errors import quote, StatementError
from obc_ros.core.text.example_files import choose_file, suggest_file
from obc_ros.core.text.expressions import parse_number
from obc_ros.ros.parameters.system_parameters import list_system_parameters, SYSTEM_PARAMETERS
from obc_ros.ros.parameters.table import ParameterRow, Value


@dataclass(frozen=True)
class ProblemFile:
    """A problem file: its path, its keys and values, and the problem built from them."""

    path: Path
    statement: Mapping[str, Any]
    problem: Problem


def read_problem_file(name: str) -> ProblemFile:
    """Return the problem of a file or an example; StatementError: there is not one."""
    path = choose_file(Path(name))
    if not is_file(str(path)):
        raise StatementError(f"'{quote(name)}' is neither a YAML file nor an example"
                             f'{suggest_file(path)}')
    entries = load_file(path)
    if len(entries) != 1:
        raise StatementError(f'{path}: {len(entries)} problems; wanted a file with one')
    return ProblemFile(path, entries[0], build_problem(entries[0]))


def list_plant_values(found: ProblemFile) -> dict[str, Value]:
    """
    Return the parameters of a node by which it has the plant of a problem.

    :return: ``system``: a registered system, or else the file itself; ``system_parameters.*``:
        values that the problem gives a registered system.
    """
    system, problem = found.statement.get('system'), found.problem
    if system is None:
        return {'system': str(found.path)}
    given = found.statement.get('parameters') or {}
    numbers = dict(zip(problem.parameters, problem.p_value.tolist(), strict=True))
    return {'system': system, **{
        f'{SYSTEM_PARAMETERS}{row.name}': numbers[row.name] if row.name in numbers
        else _read_option(row, given[row.name])
        for row in list_system_parameters({'system': system}) if row.name in given}}


def _read_option(row: ParameterRow, value: Any) -> Value:
    if isinstance(row.default, tuple):
        return tuple(np.array(value, dtype=float).ravel().tolist())
    number = parse_number(value, {}, f'parameters.{row.name}')
    return int(number) if isinstance(row.default, int) else number
