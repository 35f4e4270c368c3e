# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The kinds of YAML and JSON files of the package, which a user may confuse."""

from collections.abc import Collection, Mapping
from enum import Enum
import re
from typing import Any

from obc_ros.core.text.errors import quote, StatementError


class FileKind(Enum):
    """What a file holds, in words, and the command that takes it."""

    PROBLEM = 'an optimal control problem', 'obc solve {}'
    PLANT = 'a plant without a task', 'obc lqr {}'
    CASE = 'a case of a regulator', 'obc lqr {}'
    PARAMETERS = ('a file of ROS parameters',
                  'obc run obc_ros NODE --ros-args --params-file {}')
    SHEET = 'an exercise sheet', 'obc gallery --check {}'
    ANSWER = ('an answer, not what was asked', '')


_CASE = {'Qx', 'Qu', 'weights', 'A', 'B', 'x_max', 'u_max'}
_TASK = {'running_cost', 'terminal_cost', 'initial_state', 'final_time', 'terminal_constraints',
         'path_constraints', 'boundary_constraints', 'periodic', 'phases'}
_ANSWERS = {'status', 'certificate', 'lam'}, {'status', 'K', 'poles'}
_EXERCISE = re.compile(r'[a-z]+(-[a-z]+)*-\d+(\.\d+)?(-\w+)*')


def recognise(mapping: Mapping[Any, Any]) -> FileKind | None:
    """Return the kind of a file by its keys; None if they do not tell."""
    keys = {key for key, value in mapping.items() if key not in ('name', 'title', 'notes')}
    if any(isinstance(value, Mapping) and 'ros__parameters' in value
           for value in mapping.values()):
        return FileKind.PARAMETERS
    if any(keys >= answer for answer in _ANSWERS):
        return FileKind.ANSWER
    if keys and all(isinstance(key, str) and _EXERCISE.fullmatch(key) for key in keys):
        return FileKind.SHEET
    if keys & _CASE and not keys & _TASK:
        return FileKind.CASE
    if keys & _TASK:
        return FileKind.PROBLEM
    return FileKind.PLANT if keys >= {'states', 'dynamics'} else None


def refuse_others(mapping: Mapping[Any, Any], wanted: Collection[FileKind], file: object) -> None:
    """Raise StatementError, with the command for it, if a file is of another kind."""
    kind = recognise(mapping)
    if kind and kind not in wanted:
        what, command = kind.value
        told = f': {command.format(quote(str(file), None))}' if command else ''
        if kind is FileKind.PLANT:
            told = f'; add running_cost, initial_state and final_time, or{told[1:]}'
        raise StatementError(f'this is {what}{told}')
