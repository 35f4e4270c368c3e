# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Problems of files, and entries under way until each has a result.

The worker processes of the command, or a server, work on as many entries at once as they can.
"""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass, field
import os
from queue import Empty, SimpleQueue
import time
from typing import Any, ClassVar

from obc_ros.cli.results import Asked, Kind
from obc_ros.cli.terminal import EndSignals, InterruptedByUserError, Lines, show_progress
from obc_ros.core.ocp.solution import Solution, Status
from obc_ros.core.systems.file_kinds import FileKind, refuse_others
from obc_ros.core.text.errors import ObcError
from obc_ros.ros.installation import require_ros
from obc_ros.workers.pool import Job, Pool, RequestAnswer, SHORTEST, TIME_LIMIT
from obc_ros.workers.responses import compute_affinity, respond, unpack_solution
from obc_ros.workers.wire import Packet

MOST_VALUES = 250_000  # of a statement: more than the bytes of a file only if it repeats itself
DEEPEST = 50
CANCEL = 2.0  # [s] to wait for the results of cancelled requests
TICK = 0.02  # [s] until a signal is seen


@dataclass(eq=False)
class Question(Asked):
    """
    A problem of a file, and its answer.

    `solution` is None if nobody has worked on the problem; `columns` are the names of its states
    and inputs. `method`, `accept` and `options` are those of the command line.
    """

    kind: ClassVar[str] = 'solve'
    examples: ClassVar[bool] = True

    mapping: dict[str, Any] = field(default_factory=dict)
    method: str = ''
    accept: str = ''
    options: Sequence[str] = ()
    solution: Solution | None = None
    columns: tuple[Sequence[str], Sequence[str]] = ((), ())

    def take(self, entry: dict[str, Any]) -> None:
        """Keep the statement. Who solves the problem checks it, unless it cannot be sent."""
        self.mapping = entry
        refuse_others(entry, (FileKind.PROBLEM,), self.file)
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
                       'accept': self.accept, 'options': list(self.options), 'cache_size': 0})

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
    """Return whether YAML is at most `MOST_VALUES` mappings of texts, lists, texts and numbers."""
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


class Batch(ABC):
    """Entries of files, and who works on them: processes of this command, or a server."""

    def __init__(self, asked: Sequence[Asked], lines: Lines) -> None:
        self._waiting = deque(asked)
        self._lines = lines
        self._begun: dict[Any, float] = {}  # times at which entries under way were sent

    def work(self) -> None:
        """Have all entries worked on; on a signal, cancel those under way and raise."""
        try:
            while self._waiting or self._begun:
                while self._waiting and len(self._begun) < self.count_workers():
                    entry = self._waiting.popleft()
                    self._lines.update(entry.label, 'sent')
                    self._begun[entry] = time.monotonic()
                    self.send(entry)
                self.wait()
        except InterruptedByUserError:
            self._cancel()
            raise

    def report(self, entry: Asked, phase: str) -> None:
        """Show what is tried for an entry, and the best cost so far, in words."""
        self._lines.update(entry.label, phase)

    def finish(self, entry: Asked) -> None:
        """Take an entry that has its result out of those under way."""
        entry.took = time.monotonic() - self._begun.pop(entry)
        self._lines.end(entry.label)

    @abstractmethod
    def count_workers(self) -> int:
        """Return how many entries can be under way."""

    @abstractmethod
    def send(self, entry: Any) -> None:
        """Send an entry to be worked on."""

    @abstractmethod
    def wait(self, check: bool = True) -> None:
        """Process what arrives, or return after a short time; raise on a signal if `check`."""

    @abstractmethod
    def cancel(self, entry: Any) -> None:
        """Ask for an entry under way to be given up; called again while it is under way."""

    def _cancel(self) -> None:
        """Cancel the entries under way, and wait at most `CANCEL` seconds for their results."""
        deadline = time.monotonic() + CANCEL
        while self._begun and time.monotonic() < deadline:
            for entry in list(self._begun):
                self.cancel(entry)
            self.wait(check=False)


@contextmanager
def end_all(asked: Sequence[Asked], interrupted: str, failed: str) -> Iterator[None]:
    """End entries without a status by `interrupted` after a signal, by `failed` after an error."""
    try:
        yield
    except (InterruptedByUserError, KeyboardInterrupt) as error:
        status, message = interrupted, str(error) or 'ended by SIGINT'
    except ObcError as error:
        status, message = failed, str(error)
    else:
        return
    for entry in asked:
        if not entry.status:
            entry.end(status, message)


def answer_all(read: Callable[[], list[Kind]], module: str, endings: tuple[str, str],
               ask_server: Callable[[Sequence[Kind]], None] | None, time_limit: float = 0.0,
               hidden: bool = False) -> list[Kind]:
    """
    Return the entries of files; each has a status.

    :param read: returns the entries; malformed ones have a status already.
    :param module: answers requests in the processes of this command, see `Pool`.
    :param endings: status of entries without a result after a signal, and after an error.
    :param ask_server: has a server work on entries, in place of the processes of this command.
    :param time_limit: of each entry [s]; 0: that of a server.
    """
    with ExitStack() as stack:
        if not ask_server:
            pool = Pool(module, 1, niceness=0)  # the process starts while the files are read
            stack.callback(pool.close)
        asked = read()
        if waiting := [entry for entry in asked if not entry.status]:
            with end_all(waiting, *endings):
                if ask_server:
                    require_ros('--server')
                    ask_server(waiting)
                else:
                    cores = len(os.sched_getaffinity(0)) if hasattr(
                        os, 'sched_getaffinity') else os.cpu_count() or 1   # macOS
                    pool.resize(min(cores, len(waiting)))
                    limit = max(time_limit or TIME_LIMIT, SHORTEST)
                    with EndSignals() as signals, show_progress(hidden) as lines:
                        while not pool.wait_for_start(TICK):
                            signals.check()
                        PoolBatch(pool, signals, waiting, limit, lines).work()
    return asked


class PoolBatch(Batch):
    """Entries that the workers of a pool work on."""

    def __init__(self, pool: Pool, signals: EndSignals, asked: Sequence[Asked],
                 time_limit: float, lines: Lines) -> None:
        super().__init__(asked, lines)
        self._pool, self._signals = pool, signals
        self._time_limit = time_limit
        self._jobs: dict[Asked, Job] = {}
        # (entry, progress or answer), put there by the threads of the pool
        self._arrived: SimpleQueue[tuple[Asked, Any]] = SimpleQueue()

    def count_workers(self) -> int:
        """Return how many workers are ready."""
        ready = len(self._pool.pids)
        if not ready and self._pool.fault:
            raise ObcError(f'no worker starts: {self._pool.fault}')
        return ready

    def send(self, entry: Asked) -> None:
        """Give an entry to a worker."""
        request = entry.make_request()
        self._jobs[entry] = job = Job(
            kind=entry.kind, request=request, time_limit=self._time_limit,
            done=lambda answer: self._arrived.put((entry, answer)),
            progress=lambda phase, *_: self._arrived.put((entry, phase)),
            affinity=compute_affinity(request))
        self._pool.submit(job)

    def wait(self, check: bool = True) -> None:
        """Process what arrives next, or return after `TICK` seconds."""
        if check:
            self._signals.check()
        try:
            entry, what = self._arrived.get(timeout=TICK)
        except Empty:
            return
        if isinstance(what, RequestAnswer):
            entry.take_response(respond(what))
            self.finish(entry)
        else:
            self.report(entry, what)

    def cancel(self, entry: Asked) -> None:
        """Ask the worker to stop."""
        self._pool.cancel(self._jobs[entry])
