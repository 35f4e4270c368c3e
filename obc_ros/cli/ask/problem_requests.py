# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The problems of files, each with its name, its request and its answer."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from obc_ros.cli.results import Asked
from obc_ros.core.ocp.solution import Solution, Status
from obc_ros.workers.unpacking import unpack_solution
from obc_ros.workers.wire import Packet

CACHE_SIZE = 32       # problem structures whose solvers a worker keeps, as those of a server
MOST_VALUES = 250_000  # of a statement: more than the bytes of a file only if it repeats itself
DEEPEST = 50


@dataclass(eq=False)
class Question(Asked):
    """
    A problem of a file, and its answer.

    `solution` is None if nobody has worked on the problem; `columns` are the names of its states
    and inputs. `method` and `options` are those of the command line.
    """

    kind: ClassVar[str] = 'solve'

    mapping: dict[str, Any] = field(default_factory=dict)
    method: str = ''
    options: Sequence[str] = ()
    solution: Solution | None = None
    columns: tuple[Sequence[str], Sequence[str]] = ((), ())

    def take(self, entry: dict[str, Any]) -> None:
        """Keep the statement. Who solves the problem checks it, unless it cannot be sent."""
        self.mapping = entry
        if not is_plain(entry):
            from obc_ros.core.ocp.statement import FOR_THE_SOLVER
            self.build_problem()
            self.mapping = {key: entry[key] for key in FOR_THE_SOLVER if key in entry}

    def build_problem(self) -> Any:
        """Return the Problem; raise StatementError if the statement is malformed."""
        from obc_ros.core.ocp.statement import build_problem  # imports CasADi
        return build_problem(self.mapping)

    def make_request(self) -> Packet:
        """Return the request to a worker."""
        return Packet({'statement': self.mapping, 'method': self.method,
                       'options': list(self.options), 'cache_size': CACHE_SIZE})

    def take_response(self, response: Packet) -> None:
        """Keep the solution that a worker has found."""
        self.take_solution(unpack_solution(response), response.plain.get('states', ()),
                           response.plain.get('inputs', ()))

    def take_solution(self, solution: Solution, states: Sequence[str], inputs: Sequence[str]
                      ) -> None:
        """Keep the solution."""
        if solution.status is not Status.MALFORMED:
            self.solution, self.columns = solution, (states, inputs)
        self.end(solution.status.value, solution.message)

    def read_answer(self, with_problem: bool = False) -> Any:
        """Return the Answer; if nobody has worked on the problem, status and message only."""
        from obc_ros.api.answer import Answer  # imports CasADi
        states, inputs = self.columns
        return Answer(
            self.name, tuple(states), tuple(inputs),
            self.solution or Solution(Status(self.status), self.message),
            self.build_problem() if with_problem else None, str(self.mapping.get('title') or ''))

    def as_json(self) -> dict[str, Any]:
        """Return the contents of ``NAME.json``; fields without a result are null, empty or 0."""
        found: dict[str, Any] = self.read_answer().as_json()
        return found


def is_plain(entry: Any) -> bool:
    """
    Return whether a value of YAML can be sent to a worker, and is the same there.

    It may have dates, keys that are no texts, or contain itself. Wanted are at most `MOST_VALUES`
    mappings of texts, lists, texts and numbers.
    """
    waiting, count = [(entry, 0)], 0
    while waiting:
        value, depth = waiting.pop()
        count += 1
        if isinstance(value, dict) and all(isinstance(key, str) for key in value):
            inside = list(value.values())
        elif isinstance(value, list):
            inside = value
        elif value is None or isinstance(value, (str, float)) or (
                isinstance(value, int) and abs(value) < 1e300):
            continue
        else:
            return False
        if depth >= DEEPEST or count + len(waiting) + len(inside) > MOST_VALUES:
            return False
        waiting += [(each, depth + 1) for each in inside]
    return True
