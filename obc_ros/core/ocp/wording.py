# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numbers, bounds and terminal constraints of a problem as text for messages."""

from collections.abc import Iterable

from obc_ros.core.ocp.affine_constraints import find_affine_rows
from obc_ros.core.ocp.problem import Problem

_ONE = 1e-9   # distance of a factor from 1 up to which it is left out


def format_number(value: float) -> str:
    """Return six significant digits of a number; '0' if its magnitude is at most 1e-12."""
    return f'{value:.6g}' if abs(value) > 1e-12 else '0'


def describe_terminal(problem: Problem, row: int) -> str:
    """Return a terminal constraint: as ``x + 2*v = 9`` if it is affine, else as its key."""
    A, b, affine = find_affine_rows(problem)
    if not affine[row]:
        return problem.ends[row]
    names = [(name, a) for name, a in zip(problem.states, A[row], strict=True) if a]
    if len(names) == 1:
        return f'{names[0][0]} = {format_number(-b[row] / names[0][1])}'
    return f'{describe_sum(names)} = {format_number(-b[row])}'


def state_bound(problem: Problem, index: int, upper: bool) -> str:
    """Return a state bound as text, such as ``v <= 1``."""
    bound = (problem.x_upper if upper else problem.x_lower)[index]
    return f'{problem.states[index]} {"<=" if upper else ">="} {format_number(bound)}'


def describe_sum(terms: Iterable[tuple[str, float]], times: str = '*') -> str:
    """Return a sum of names times factors as text, such as ``2*x - y``."""
    text = ''
    for name, factor in terms:
        size = '' if abs(abs(factor) - 1) < _ONE else f'{format_number(abs(factor))}{times}'
        text += f' {"-" if factor < 0 else "+"} {size}{name}'
    return text[3:] if text.startswith(' + ') else '-' + text[3:]
