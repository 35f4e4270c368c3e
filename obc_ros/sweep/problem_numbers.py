# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The numbers of a problem that a sweep can vary: see docs/sweeps.md."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
import json
import math
from typing import Any

import numpy as np
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.text.comparisons import state_comparisons
from obc_ros.core.text.errors import quote, StatementError, suggest_name
from obc_ros.core.text.recorded_functions import pack_statement, RecordedFunction
from obc_ros.sweep.dataset import PROBLEM_QUANTITIES

Place = tuple[str | int, ...]

SIDES = 'lower', 'upper'


class ProblemNumbers:
    """
    A problem whose numbers vary.

    :param statement: see docs/problems.md.
    :ivar dimensions: names of the states and of the inputs.
    :raises StatementError: if the statement is malformed.
    """

    kind = 'problem'
    quantities = PROBLEM_QUANTITIES

    def __init__(self, statement: Mapping[str, Any]) -> None:
        self.problem = build_problem(statement)
        # Which other processes can read, and in which each bound has its place.
        self.statement = state_comparisons(self.problem.statement)
        try:
            json.dumps(pack_statement(self.statement))
        except (TypeError, ValueError):
            raise StatementError('problem: other processes get the statement; wanted texts, '
                                 'numbers and functions, and a system by its name') from None
        self.dimensions = {'state': self.problem.states,
                           'input': self.problem.inputs[:self.problem.m - self.problem.held]}

    @cached_property
    def places(self) -> dict[str, Place]:
        """Return where the number of each key stands in the statement."""
        problem = self.problem
        found: dict[str, Place] = {f'x0.{name}': ('initial_state', name)
                                   for name in problem.states}
        # The numbers in terminal constraints are parameters of a problem, too, without a name.
        names = [name for name in problem.parameters if name.isidentifier()]
        found |= {name: ('parameters', name) for name in names if name != 'T'}
        found |= {f'parameters.{name}': ('parameters', name) for name in names}
        for section, bounded in (('input_bounds', self.dimensions['input']),
                                 ('state_bounds', problem.states)):
            found |= {f'{section}.{name}.{side}': (section, name, index)
                      for name in bounded for index, side in enumerate(SIDES)}
        found |= {f'path_constraints.{index}.{side}': ('path_constraints', index, side)
                  for index in range(problem.path.numel()) for side in SIDES}
        if problem.final_time.free:
            return found | {f'final_time.{each}': ('final_time', each)
                            for each in ('lower', 'upper', 'guess')}
        return found | {'T': ('final_time', 'value'), 'final_time.value': ('final_time', 'value')}

    def check_key(self, key: str) -> None:
        """Raise StatementError if there is no number with this key."""
        check_number_key(key, self.places, (
            "initial states are 'x0.NAME', parameters 'NAME', bounds 'input_bounds.NAME.upper'"))

    def vary(self, values: Mapping[str, float]) -> dict[str, Any]:
        """Return a request with other numbers; expressions of parameters follow them."""
        found = dict(self.statement)
        for key, value in values.items():
            section, *rest = self.places[key]
            found[str(section)] = replace_number(
                found.get(str(section)), tuple(rest), value,
                self._bounds.get(rest[0], (None, None)))
        return pack_statement(found)

    def long_key(self, key: str) -> str:
        """Return the key that begins with the section of the statement."""
        return '.'.join(map(str, self.places[key]))

    def unit(self, key: str) -> str:
        """Return the unit of a number; empty if it is not known."""
        place = self.places[key]
        if place[0] == 'final_time':
            return 's'
        return self.problem.units.get(str(place[1]), '')

    @cached_property
    def _bounds(self) -> dict[str | int, tuple[float | None, float | None]]:
        problem = self.problem
        lower = np.concatenate([problem.x_lower, problem.u_lower]).tolist()
        upper = np.concatenate([problem.x_upper, problem.u_upper]).tolist()
        return {name: (_known(low), _known(high)) for name, low, high in zip(
            (*problem.states, *problem.inputs), lower, upper, strict=True)}


def check_number_key(key: str, places: Mapping[str, Place], hint: str) -> None:
    """Raise StatementError, which ends with a hint, if a key is not known."""
    if key not in places:
        raise StatementError(f"there is no number '{quote(key)}'{suggest_name(key, places)}; "
                             f'{hint}')


def replace_number(value: Any, place: Place, number: float,
                   bounds: tuple[float | None, float | None] = (None, None)) -> Any:
    """
    Return mappings and lists with another number at one place; the rest is shared.

    :param value: nested mappings and lists; None for a mapping that is missing.
    :param place: keys and positions that lead to the number.
    :param bounds: list to put in place of one that is missing.
    """
    if not place:
        return number
    if isinstance(value, RecordedFunction):
        return replace(value, form=replace_number(value.form, place, number, bounds))
    step, rest = place[0], place[1:]
    if isinstance(step, str):
        section = dict(value or {})
        section[step] = replace_number(section.get(step), rest, number, bounds)
        return section
    items = list(bounds if value is None else value)
    items[step] = replace_number(items[step], rest, number, bounds)
    return items


def _known(bound: float) -> float | None:
    return bound if math.isfinite(bound) else None
