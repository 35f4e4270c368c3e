# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The problems of files, each with its name and its result."""

from dataclasses import dataclass, field
import math
from typing import Any

from obc_ros.cli.results import Asked
from obc_ros.core.library.answer import Answer
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution, Status
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

    @property
    def answer(self) -> Answer:
        """Return what the server answered; without an answer, status and message only."""
        title = str(self.mapping.get('title') or '')
        if self.result is None:
            nothing = Solution(Status(self.status), self.message)
            return Answer(self.name, (), (), nothing, self.problem, title)
        from obc_ros.ros.messages import read_solution  # imported already by who has a result
        path = self.result.trajectory
        return Answer(self.name, tuple(path.state_names), tuple(path.input_names),
                      read_solution(self.result), self.problem, title)

    def as_json(self) -> dict[str, Any]:
        """Return the contents of ``NAME.json``; fields without a result are null, empty or 0."""
        return self.answer.as_json()
