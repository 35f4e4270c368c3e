# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A process of benchmarks/backends.py: ``python _backends.py SECONDS CHANGES FILE BACKEND...``.

Solves a problem with each back-end of the transcription in turn: without a cache, and then with
its numbers changed, all with one cache. Prints a line of JSON for each back-end: its name, and for
each solution status, cost and processor time; how often it ran, and how often it converged. Where
the own method never runs, its variants are the same program and are not run again.
"""

import timing  # isort: skip - before numpy

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, ExitStack
import json
from pathlib import Path
import sys
import time
from typing import Any
from unittest.mock import patch

from _stagewise import Fatrop, order_by_stages
from obc_ros.core.ocp.statement import load_file
from obc_ros.core.solver.nlp.meter import Meter, Watch
from obc_ros.core.solver.solve import Cache, solve
from obc_ros.core.solver.transcription import banded_program
from obc_ros.core.solver.transcription.local_minima import LocalMinima
from obc_ros.core.solver.transcription.program import Transcription, TranscriptionOutcome
from repeats import vary

SIZE = 1e-2   # relative change of each number
WARM_UP = {
    'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u - x**3'}, 'running_cost': 'u**2 + x**4',
    'initial_state': {'x': 1}, 'final_time': {'free': False, 'value': 1}}


class KnownMinima:
    """A meter that also stops at the local minima known to multistart, as the own method."""

    def __init__(self, meter: Meter, known: LocalMinima) -> None:
        self._meter, self._known = meter, known

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the meter."""
        return getattr(self._meter, name)

    def step(self, cost: float, infeasibility: float) -> bool:
        """Count an iteration; return whether to stop."""
        again = self._known.record_iterate(cost, infeasibility)
        return self._meter.step(cost, infeasibility) or again


def _solve_until_known(solve_program: Callable[..., TranscriptionOutcome]
                       ) -> Callable[..., TranscriptionOutcome]:
    """Return `Transcription.solve` with early ends at known minima for any back-end."""
    def solve_known(self: Transcription, *args: Any, once: bool = False,
                    known: LocalMinima | None = None, **kwargs: Any) -> TranscriptionOutcome:
        if once and known is not None and self.is_banded:
            args = *args[:-1], KnownMinima(args[-1], known)
        return solve_program(self, *args, once=once, **kwargs)

    return solve_known


def _solve_by_fatrop(self: Transcription, start: str) -> tuple[Fatrop, Watch]:
    """Return what `Transcription._solver` returns, with fatrop in place of IPOPT."""
    kept = self.__dict__.setdefault('_by_fatrop', {})
    if 'stagewise' not in kept:
        kept['stagewise'] = order_by_stages(self)
    if start not in kept:
        watch = Watch(self.unknowns, int(self._program.nlp['g'].numel()), self.constants)
        kept[start] = Fatrop(kept['stagewise'], start, watch), watch
    return kept[start]


NOT_OWN = ((Transcription, '_staged', None),
           (Transcription, 'solve', _solve_until_known(Transcription.solve)))
FATROP = ((Transcription, '_solver', _solve_by_fatrop),)
BACKENDS: dict[str, tuple[tuple[Any, str, Any], ...]] = {
    'own, IPOPT': (),
    'IPOPT': NOT_OWN,
    'fatrop': (*NOT_OWN, *FATROP),
    'own, fatrop': FATROP,
    'own without negative curvature': (
        (banded_program, 'leave_saddle', lambda _, end, *rest: end),),
}


@contextmanager
def use(name: str) -> Iterator[Counter[str]]:
    """Solve with a back-end; count the runs of the own method and of the other one."""
    counts = Counter[str]()

    def counted(kind: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            found = function(*args, **kwargs)
            counts[kind] += 1
            counts[f'{kind} converged'] += found.converged
            return found

        return call

    with ExitStack() as stack:
        for of, attribute, value in BACKENDS[name]:
            stack.enter_context(patch.object(of, attribute, value))
        for of, attribute, kind in ((banded_program.Stages, 'run', 'own'),
                                    (Transcription, 'solve', 'all')):
            stack.enter_context(patch.object(
                of, attribute, counted(kind, getattr(of, attribute))))
        yield counts


def answer(mapping: dict[str, Any], name: str, changes: int, seconds: float) -> dict[str, Any]:
    """Return status, cost and processor time of each solution with a back-end."""
    cache, status, cost, times = Cache(), list[str](), list[float](), list[float]()
    with use(name) as counts:
        for problem in vary(mapping, changes, SIZE):
            begun = time.process_time()
            try:
                found = solve(problem, cache=cache, time_limit=seconds)
                status.append(found.status.value)
                cost.append(float(found.objective))
            except Exception as error:  # exceptions of any kind are results here
                status.append(f'{type(error).__name__}: {str(error).splitlines()[0]}')
                cost.append(float('nan'))
            times.append(time.process_time() - begun)
    return {'status': status, 'cost': cost, 'times': times, **counts}


def main() -> None:
    """Solve the problem and print the results."""
    assert timing
    seconds, changes, file = float(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])
    mapping = load_file(file)[0]
    for name in sys.argv[4:]:
        answer(WARM_UP, name, 0, seconds)   # loads the solver
    unused: dict[str, Any] | None = None   # the result where the own method never runs
    for name in sys.argv[4:]:
        found = unused if unused and name.startswith('own ') else answer(
            mapping, name, changes, seconds)
        unused = found if name == 'own, IPOPT' and not found.get('own') else unused
        print(json.dumps({'name': file.stem, 'backend': name, **found}), flush=True)


if __name__ == '__main__':
    main()
