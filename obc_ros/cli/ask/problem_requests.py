# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The problems of files, each with its name and its result."""

from dataclasses import dataclass, field
import math
from typing import Any

from obc_ros.cli.results import Asked
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.statement import build_problem


@dataclass(eq=False)
class Question(Asked):
    """
    A problem of a file, and its result.

    `problem` is None if the statement is malformed. `result` is the result message of the server,
    None if none arrived. `took` is the time [s] from the sent goal to the result.
    """

    mapping: dict[str, Any] = field(default_factory=dict)
    problem: Problem | None = None
    result: Any = None
    took: float = math.nan

    def take(self, entry: dict[str, Any]) -> None:
        """Keep the statement, and build the problem from it."""
        self.mapping = entry
        self.problem = build_problem(entry)

    def as_json(self) -> dict[str, Any]:
        """Return the contents of ``NAME.json``; fields without a result are null, empty or 0."""
        found: dict[str, Any] = {
            'name': self.name, 'status': self.status, 'message': self.message, 'objective': None,
            't': [], 'x': {}, 'u': {}, 'lam': {}, 'interpolation': 'linear', 'switching_times': [],
            'certificate': {'holds': False, 'residuals': {}, 'tolerances': {}},
            'optimality': {'kind': '', 'reason': '', 'starts': 0, 'minima': []},
            'attempts': [], 'solve_time': None, 'build_time': None, 'iterations': 0}
        return found | (_answer(self.result) if self.result else {})


def _answer(result: Any) -> dict[str, Any]:
    """Return the fields of ``NAME.json`` that the result fills."""
    path, certificate, known = result.trajectory, result.certificate, result.optimality
    answer = {
        'certificate': {
            'holds': certificate.holds,
            'residuals': dict(zip(certificate.conditions, certificate.residuals, strict=True)),
            'tolerances': dict(zip(certificate.conditions, certificate.tolerances, strict=True))},
        'optimality': {'kind': known.kind, 'reason': known.reason, 'starts': known.starts,
                       'minima': known.minima.tolist()},
        'attempts': [{name: getattr(attempt, name)
                      for name in attempt.get_fields_and_field_types()}
                     for attempt in result.attempts],
        'solve_time': result.solve_time, 'build_time': result.build_time,
        'iterations': result.iterations}
    if path.t:
        n, m = len(path.state_names), len(path.input_names)
        answer |= {
            'objective': result.objective, 't': path.t.tolist(),
            'x': _columns(path.state_names, path.x, n), 'u': _columns(path.input_names, path.u, m),
            'lam': _columns(path.state_names, path.lam, n) if path.lam else {},
            'interpolation': path.interpolation,
            'switching_times': path.switching_times.tolist()}
    return answer


def _columns(names: list[str], values: Any, width: int) -> dict[str, list[float]]:
    """Return the columns of row-major values by name."""
    return {name: values[index::width].tolist() for index, name in enumerate(names)}
