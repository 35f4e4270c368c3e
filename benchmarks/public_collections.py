# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Public collections of optimal control problems: our cost beside the published one.

The collections are the tables test/collections/*.csv: an example, the file with our statement of
it, the published cost and the published time [s]; in practical.csv, the problems of robots and
vehicles, both are those of a second method. Every file is solved in a process of its own
with a time limit. A solution counts if it is certified within the limit of processor time. The
processes get PATIENCE times this limit of wall-clock time, for a machine with other load.
"""

import timing  # isort: skip - before numpy

import csv
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
import sys
import time

from obc_ros.core.ocp.solution import Status
from obc_ros.core.ocp.statement import build_problem, load_file
from obc_ros.core.solver.solve import solve
from obc_ros.core.text.errors import ObcError

ROOT = Path(__file__).resolve().parent.parent
TESTS = ROOT / 'test'
LIMIT = 60.0  # [s] of processor time
SHARE = 0.95  # required share of certified examples of a collection
LOWER = 1e-5  # a relative difference from the published cost that is marked
GRACE = 30.0  # [s] after the time limit until a process is killed


@dataclass(frozen=True)
class Example:
    """A row of a collection's table; `published` and `seconds` are empty where there are none."""

    example: str
    problem: str
    published: str
    seconds: str


@dataclass(frozen=True)
class Answer:
    """The result for one file: the status, the cost, the processor time [s] and the message."""

    status: str
    cost: float
    seconds: float
    message: str

    def certified(self, limit: float) -> bool:
        """Return whether there is a certified solution within the limit of processor time."""
        return self.status == Status.SOLVED and self.seconds <= limit

    def compare(self, published: str) -> str:
        """Return how the cost compares with the published one."""
        if not published or self.status != Status.SOLVED:
            return ''
        theirs = float(published)
        difference = (self.cost - theirs) / max(abs(theirs), abs(self.cost), 1e-9)
        if abs(difference) <= LOWER:
            return 'equal'
        return f'{"lower" if difference < 0 else "higher"} by {abs(difference):.1e}'


def main() -> int:
    """Solve the collections and print a table of each; return the exit status."""
    args = timing.arguments('public collections of problems', limit=LIMIT, patience=1.0)
    tables = sorted((TESTS / 'collections').glob('*.csv'))
    if not tables:
        raise ObcError('public_collections: no test/collections: run it from a checkout')
    answers: dict[str, Answer] = {}
    for path in tables:
        rows = []
        examples = read_table(path)
        for row in examples:
            if row.problem not in answers:
                answers[row.problem] = solve_alone(row.problem, args.limit * args.patience)
            answer = answers[row.problem]
            print(f'{row.example}: {answer}', file=sys.stderr, flush=True)
            rows.append((
                row.example, row.published or '-', f'{answer.cost:.8g}',
                answer.compare(row.published), row.seconds or '-', f'{answer.seconds:.2f}',
                'certified' if answer.certified(args.limit)
                else f'{answer.status}: {answer.message}'))
        timing.table(path.stem, ('example', 'published', 'cost', 'against published',
                                 'published [s]', 'seconds', 'result'), rows)
        certified = sum(answers[row.problem].certified(args.limit) for row in examples)
        timing.require(f'{path.stem}: {certified} of {len(examples)} certified, share of others',
                       1 - certified / len(examples), 1 - SHARE)
    return timing.finish()


def read_table(path: Path) -> list[Example]:
    """Return the examples of a collection."""
    with path.open(encoding='utf-8', newline='') as file:
        return [Example(**row) for row in csv.DictReader(file)]


def find_file(problem: str) -> Path:
    """Return the file of a problem: an example of the package, or a file of the collections."""
    folder = ROOT / 'obc_ros' if problem.startswith('examples/') else TESTS
    return folder / f'{problem}.yaml'


def solve_alone(problem: str, time_limit: float) -> Answer:
    """Return the answer to a problem of a table, from a process that ends with it."""
    context = get_context('spawn')
    ours, theirs = context.Pipe()
    process = context.Process(target=answer_file, args=(theirs, problem, time_limit), daemon=True)
    process.start()
    theirs.close()
    try:
        if not ours.poll(time_limit + GRACE):
            return Answer('killed', float('nan'), time_limit + GRACE, 'beyond its time limit')
        answer: Answer = ours.recv()
        return answer
    except EOFError:
        return Answer('failed', float('nan'), 0.0, 'the process ended without an answer')
    finally:
        process.kill()
        process.join()


def answer_file(pipe: Connection, problem: str, time_limit: float) -> None:
    """Send the answer to a problem of a table."""
    [mapping] = load_file(find_file(problem))
    begun = time.process_time()
    found = solve(build_problem(mapping), time_limit=time_limit)
    pipe.send(Answer(found.status.value, float(found.objective) if found.t.size else float('nan'),
                     time.process_time() - begun, found.message))


if __name__ == '__main__':
    sys.exit(main())
