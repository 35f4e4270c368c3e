# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
One problem solved for many values of its numbers.

The points are divided into chunks of neighbours (`chunks`). Workers solve the chunks, each in a
process that limits time and memory of each point (`chunk_solver`). Finished chunks are appended to
a journal (`journal`), from which the dataset is made (`dataset`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field
from importlib import metadata
import json
import math
import os
from pathlib import Path
import time
from typing import Any

import numpy as np
from obc_ros.api.given import convert_numbers
from obc_ros.api.problem import as_statement, ProblemLike
from obc_ros.core.lqr.case_plants import take_plant
from obc_ros.core.ocp.method_names import get_method
from obc_ros.core.solver.options import read_options
from obc_ros.core.systems.file_kinds import FileKind, recognise, refuse_others
from obc_ros.core.text.errors import StatementError
from obc_ros.core.text.recorded_functions import RecordedFunction
from obc_ros.sweep.axes import check_count, make_axes, make_draws, RandomNumber, SweepAxis
from obc_ros.sweep.chunk_solver import Chunk, Row, solve_locally
from obc_ros.sweep.chunks import divide_grid, Indices, order_samples
from obc_ros.sweep.cluster.chunks_on_cluster import solve_on_cluster
from obc_ros.sweep.cluster.connection import check_address, has_dask
from obc_ros.sweep.dataset import import_xarray, make_dataset, write_dataset
from obc_ros.sweep.journal import check_folder, Journal
from obc_ros.sweep.problem_numbers import ProblemNumbers
from obc_ros.sweep.regulator_numbers import RegulatorNumbers
from obc_ros.workers.pool import LONGEST_LIMIT, SHORTEST

DATASET = 'sweep.nc'
CHUNK = 64           # points
MOST_IN_CHUNK = 10_000
MOST_WORKERS = 1024
WITHOUT_DASK = 'none'


@dataclass(frozen=True)
class SweepProgress:
    """Points that are done, and how they ended; `earlier` ones were done before a resumption."""

    done: int
    total: int
    earlier: int
    elapsed: float
    statuses: Mapping[str, int]

    @property
    def rate(self) -> float:
        """Return the points per second since the start or the resumption."""
        return (self.done - self.earlier) / self.elapsed if self.elapsed > 0.0 else 0.0

    @property
    def left(self) -> float:
        """Return the expected time to the end [s]; infinite at the beginning."""
        return (self.total - self.done) / self.rate if self.rate > 0.0 else math.inf


def _say_nothing(progress: SweepProgress) -> None:
    """Ignore progress."""


@dataclass(frozen=True)
class SweepSettings:
    """How the points of a sweep are solved; see `sweep` for the fields."""

    seed: int = 0
    chunk: int = CHUNK
    time_limit: float = 60.0
    method: str = ''
    options: tuple[str, ...] = ()

    def check(self) -> None:
        """Raise StatementError if a setting is invalid."""
        for name, value, least, most in (('seed', self.seed, 0, 2**63),
                                         ('chunk', self.chunk, 1, MOST_IN_CHUNK)):
            if not isinstance(value, int) or not least <= value <= most:
                raise StatementError(f'{name} {value}: wanted a whole number from {least} to '
                                     f'{most}')
        if not SHORTEST <= self.time_limit <= LONGEST_LIMIT:
            raise StatementError(f'time_limit {self.time_limit:g}: wanted {SHORTEST:g} to '
                                 f'{LONGEST_LIMIT:g} s')
        if self.method:
            get_method(self.method)
        read_options(self.options)


@dataclass(frozen=True, eq=False)
class SweepQuestion:
    """A problem, the `points` at which it is to be solved, and how; checked when it is made."""

    numbers: ProblemNumbers | RegulatorNumbers
    axes: tuple[SweepAxis, ...]
    draws: tuple[RandomNumber, ...] = ()
    count: int = 0
    settings: SweepSettings = SweepSettings()
    points: int = field(init=False)
    samples: dict[str, list[float]] = field(init=False)

    def __post_init__(self) -> None:
        """Check the question, and draw the samples."""
        self.settings.check()
        if self.numbers.kind == RegulatorNumbers.kind:
            for name in ('method', 'options'):
                if getattr(self.settings, name):
                    raise StatementError(f'{name}: has no effect on a regulator; a Riccati '
                                         'equation gives its gain')
        object.__setattr__(self, 'points', check_count(self.axes, self.draws, self.count))
        for key in self.keys:
            self.numbers.check_key(key)
        object.__setattr__(self, 'samples', {
            draw.key: draw.draw(self.count, self.settings.seed).tolist() for draw in self.draws})

    @property
    def keys(self) -> list[str]:
        """Return the keys of all numbers that vary."""
        return [axis.key for axis in self.axes] + [draw.key for draw in self.draws]

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the number of values along each dimension; the samples are the last one."""
        return (*(len(axis.values) for axis in self.axes), *((self.count,) if self.draws else ()))

    def describe(self) -> dict[str, Any]:
        """Return all that the answers depend on, as JSON has it."""
        settings = self.settings
        described = {
            'version': metadata.version('obc-ros'), 'kind': self.numbers.kind,
            'statement': self.numbers.statement,
            'axes': {axis.key: axis.values for axis in self.axes},
            'distributions': {each.key: [each.distribution, *each.parameters]
                              for each in self.draws},
            'samples': self.samples, 'seed': settings.seed, 'chunk': settings.chunk,
            'time_limit': settings.time_limit, 'method': settings.method,
            'options': settings.options}
        try:
            found: dict[str, Any] = json.loads(json.dumps(described, default=_as_plain))
        except (TypeError, ValueError) as error:
            raise StatementError(f'the statement cannot be written as JSON: {error}') from None
        return found

    def divide(self) -> list[Indices]:
        """Return the points of each chunk in the order of solution, as flat indices."""
        shape = self.shape
        tiles = divide_grid(shape, self.settings.chunk)
        if not self.draws:
            return tiles
        order = order_samples(np.array(list(self.samples.values())).T)
        return [tile // shape[-1] * shape[-1] + order[tile % shape[-1]] for tile in tiles]

    def values_at(self, index: int) -> dict[str, float]:
        """Return the numbers at a point."""
        *place, sample = np.unravel_index(index, (*self.shape, *((1,) if not self.draws else ())))
        found = {axis.key: axis.values[int(k)] for axis, k in zip(self.axes, place, strict=True)}
        return found | {key: values[int(sample)] for key, values in self.samples.items()}

    def make_chunk(self, number: int, points: Indices) -> Chunk:
        """Return a chunk for the workers."""
        settings = self.settings
        common = {'method': settings.method, 'options': list(settings.options)}
        return Chunk(number, self.numbers.kind, tuple(
            {**self.numbers.vary(self.values_at(int(index))), **common}
            for index in points), settings.time_limit)


Workers = Callable[[Sequence[Chunk]], Generator[tuple[int, list[Row]]]]


class Sweep:
    """The points of a question, solved or not; without a folder, nothing is kept on the disk."""

    def __init__(self, question: SweepQuestion, folder: Path | None = None) -> None:
        import_xarray()   # before the work
        self.question = question
        self.folder = folder
        self._tiles = question.divide()
        self._chunks: dict[int, list[Row]] = {}

    @property
    def done(self) -> int:
        """Return the number of points with an answer."""
        return sum(map(len, self._chunks.values()))

    @property
    def statuses(self) -> Counter[str]:
        """Return how the points ended."""
        return Counter(row['status'] for rows in self._chunks.values() for row in rows)

    def messages(self, most: int) -> list[tuple[dict[str, float], str]]:
        """Return the numbers at the first points that are not solved, and why."""
        rows = sorted((int(index), row) for number, rows in self._chunks.items()
                      for index, row in zip(self._tiles[number], rows, strict=True)
                      if row['status'] != 'solved')
        return [(self.question.values_at(index), f"{row['status']}: {row['message']}")
                for index, row in rows[:most]]

    def check(self, resume: bool) -> None:
        """Check whether the folder can take the sweep, as `check_folder`; nothing is changed."""
        if self.folder is None:
            if resume:
                raise StatementError('resume: wanted the folder of the sweep')
            return
        check_folder(self.folder, self.question.describe(), resume)

    def run(self, workers: Workers, resume: bool = False,
            report: Callable[[SweepProgress], None] = _say_nothing) -> None:
        """
        Solve all points that are not solved yet; what is done is kept, also after an error.

        :param workers: solves chunks, and yields their numbers and answers as they are finished.
        :param report: called after each chunk.
        """
        self.check(resume)
        if self.folder is None:
            self._work(workers, self._chunks.__setitem__, report)
            return
        with Journal(self.folder, self.question.describe(), resume) as journal:
            self._chunks = journal.chunks
            self._work(workers, journal.append, report)

    def _work(self, workers: Workers, keep: Callable[[int, list[Row]], None],
              report: Callable[[SweepProgress], None]) -> None:
        earlier, begun = self.done, time.monotonic()
        counts, done = self.statuses, earlier
        report(SweepProgress(done, self.question.points, earlier, 0.0, counts))
        chunks = _Chunks(self.question, self._tiles, [
            number for number in range(len(self._tiles)) if number not in self._chunks])
        with closing(workers(chunks)) as finished:
            for number, rows in finished:
                keep(number, rows)
                done += len(rows)
                counts.update(row['status'] for row in rows)
                report(SweepProgress(done, self.question.points, earlier,
                                     time.monotonic() - begun, counts))

    def dataset(self) -> Any:
        """Return the dataset of all points; those without an answer have the status -1."""
        question = self.question
        rows = {int(index): row for number, rows in self._chunks.items()
                for index, row in zip(self._tiles[number], rows, strict=True)}
        numbers = question.numbers
        return make_dataset(
            {axis.key: axis.values for axis in question.axes},
            {key: numbers.unit(key) for key in question.keys},
            {key: numbers.long_key(key) for key in question.keys},
            question.samples, question.count, numbers.dimensions, numbers.quantities, rows,
            {'title': str(numbers.statement.get('name', 'problem')),
             'source': f"obc_ros {metadata.version('obc-ros')}", 'seed': question.settings.seed,
             'statement': json.dumps(question.describe()['statement'])})

    def save(self) -> Any:
        """Write the dataset into the folder, if there is one, and return it."""
        dataset = self.dataset()
        if self.folder:
            write_dataset(dataset, self.folder / DATASET)
        return dataset


def sweep(problem: ProblemLike,
          over: Mapping[str, Any] | None = None, *,
          sample: Mapping[str, str] | None = None, count: int = 0, seed: int = 0,
          out: str | Path | None = None, resume: bool = False, scheduler: str = '',
          workers: int = 0,
          chunk: int = CHUNK, time_limit: float = 60.0, method: str = '',
          options: Sequence[str] = (),
          report: Callable[[SweepProgress], None] = _say_nothing) -> Any:
    """
    Solve a problem for many values of its numbers.

    Parameters
    ----------
    problem : Problem, Answer, mapping, Path or str
        A problem as for `solve`, or a case of `obc lqr`; see docs/problems.md.
    over : mapping, optional
        Axes of a grid: key and values. Keys are ``x0.NAME`` for an initial state, ``NAME`` for a
        parameter, ``input_bounds.NAME.upper``, ``T``; see `problem_numbers`. Values are numbers or
        a text: ``'-2:2:101'``.
    sample : mapping, optional
        Random numbers: key and distribution, such as ``'normal(0, 1)'``.
    count : int
        Number of samples; each is combined with each point of the grid.
    seed : int
        Of the random numbers.
    out : str or Path, optional
        Folder of the journal and of the dataset ``sweep.nc``. What is finished is not lost if
        this process ends.
    resume : bool
        Whether to go on with the sweep in `out`.
    scheduler : str
        Address of a Dask scheduler, such as ``tcp://host:8786``. Empty: processes of this
        machine, through Dask if it is installed; ``none``: without Dask.
    workers : int
        Number of processes on this machine; 0: one for each processor.
    chunk : int
        Largest number of points that one worker solves one after the other.
    time_limit : float
        Of each point [s].
    method : str
        Method of solution; empty: that of the problem.
    options : sequence of str
        Numbers that steer the search.
    report : callable, optional
        Called with a SweepProgress after each chunk.

    Returns
    -------
    xarray.Dataset
        Over the axes, and over ``sample`` with random numbers: status, J, T [s], switching times
        [s], costates and inputs at t = 0, the worst residual relative to its tolerance, time [s].
        The answers do not depend on the number of workers.

    Raises
    ------
    StatementError
        If the problem or the points are invalid, or `out` holds another sweep.
    ObcError
        If xarray is not installed.

    """
    asked = SweepQuestion(
        load_numbers(problem), make_axes(over or {}), make_draws(sample or {}),
        count, SweepSettings(seed, chunk, time_limit, method, tuple(options)))
    run = Sweep(asked, Path(out) if out else None)
    try:
        run.run(choose_workers(scheduler, workers), resume, report)
    finally:
        if run.done:
            dataset = run.save()
    return dataset


def load_numbers(problem: ProblemLike) -> ProblemNumbers | RegulatorNumbers:
    """Return the numbers, that can be varied, of a problem or case, its statement, or its file."""
    statement = convert_numbers(as_statement(problem, {}))
    named = isinstance(problem, str | Path) and '\n' not in str(problem)
    path = Path(str(problem) if named else '.')
    refuse_others(statement, (FileKind.PROBLEM, FileKind.CASE, FileKind.PLANT), path)
    if recognise(statement) in (FileKind.CASE, FileKind.PLANT):
        plant, case = take_plant(statement, path.parent)
        return RegulatorNumbers(case, plant)
    return ProblemNumbers(statement)


def choose_workers(scheduler: str, workers: int) -> Workers:
    """Return what solves chunks; for the arguments, which are checked, see `sweep`."""
    if scheduler not in ('', WITHOUT_DASK):
        check_address(scheduler)
        if workers:
            raise StatementError(f'workers {workers}: has no effect with a scheduler, which has '
                                 'its own workers')
    if not 0 <= workers <= MOST_WORKERS:
        raise StatementError(f'workers {workers}: wanted 0 to {MOST_WORKERS}')
    number = workers or len(os.sched_getaffinity(0))
    if scheduler == WITHOUT_DASK or not scheduler and not has_dask():
        return lambda chunks: solve_locally(chunks, number)
    return lambda chunks: solve_on_cluster(chunks, scheduler, number)


class _Chunks(Sequence[Chunk]):
    """Chunks of a question, made when they are asked for."""

    def __init__(self, question: SweepQuestion, tiles: Sequence[Indices],
                 numbers: Sequence[int]) -> None:
        self._question, self._tiles, self._numbers = question, tiles, numbers

    def __len__(self) -> int:
        return len(self._numbers)

    def __getitem__(self, index: Any) -> Any:
        number = self._numbers[index]
        return self._question.make_chunk(number, self._tiles[number])


def _as_plain(value: Any) -> Any:
    """Return a number or an array of NumPy as JSON has it."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, RecordedFunction):
        return asdict(value)
    raise TypeError(f'{type(value).__name__} is not a number, a text, a list or a mapping')
