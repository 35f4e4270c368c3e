# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A process of benchmarks/ablation.py: ``python _ablation.py STRATEGY SECONDS FILE...``.

Solves the problems with one strategy of the search switched off ('' for none). Prints a line of
JSON for each file: its name, status, cost, processor time, and the strategies that had an effect.
"""

import timing  # isort: skip - before numpy

from collections.abc import Callable, Iterator
from contextlib import contextmanager, ExitStack
from dataclasses import replace
from functools import wraps
import json
from pathlib import Path
import sys
import time
from typing import Any
from unittest.mock import patch

from obc_ros.core.ocp.solution import Verdict
from obc_ros.core.ocp.statement import build_problem, load_file
from obc_ros.core.solver import bench, conclusion, methods, program_cache, search
from obc_ros.core.solver.diagnosis import explanation
from obc_ros.core.solver.improve import registry as improvements
from obc_ros.core.solver.solve import solve
from obc_ros.core.solver.starts import multistart
from obc_ros.core.solver.starts import registry as starts
from obc_ros.core.solver.transcription import banded_program


def skip_multistart(*args: Any, **_: Any) -> Any:
    """Return the result of the first descent."""
    return multistart.Explored(args[2], [], '')


def skip_tightening(*args: Any) -> Any:
    """Return the former margin, and the violation of the constraints."""
    return args[4], bench.compute_tightening.__wrapped__(*args)[1]   # type: ignore[attr-defined]


# Where the registries are, the function of a record, and whether its result has an effect.
REGISTRIES: tuple[tuple[Any, str, str, Callable[..., bool]], ...] = (
    (methods, 'EXACT_METHODS', 'solve', lambda found, *_: found is not None),
    (starts, 'STARTS', 'run', lambda made, *_: made.judge()[0] is Verdict.ACCEPTED),
    (improvements, 'IMPROVEMENTS', 'run', lambda new, state: not isinstance(new, str) and (
        new.judge(state)[0] is not Verdict.REJECTED)),
    (explanation, 'CHECKS', 'run', lambda reason, *_: reason is not None))
RECORDS = tuple(each.name for module, registry, *_ in REGISTRIES
                for each in getattr(module, registry))
# Records that do the same at different stages, switched off together.
TOGETHER = {
    'bang arcs, both': ('bang arcs', 'bang arcs of jumping inputs'),
    'boundary arcs, both': ('boundary arcs', 'boundary arcs at once')}
# Strategies in no registry: where the function is looked up, what takes its place, and whether a
# result has an effect.
CALLS: dict[str, tuple[Any, str, Callable[..., Any], Callable[..., bool]]] = {
    'absolute values': (program_cache, 'build_smooth_twin', lambda *_: None,
                        lambda found, *_: found is not None),
    'multistart': (search, 'explore_starts', skip_multistart, lambda *_, **__: True),
    'constraint tightening': (bench, 'compute_tightening', skip_tightening, lambda *_: True),
    'negative curvature': (banded_program, 'leave_saddle', lambda *args: args[1],
                           lambda found, *args: found is not args[1]),
    'chattering budget': (search, '_mixes', lambda *_: False, lambda found, *_: found),
    'larger inputs': (conclusion, 'explain_larger_inputs', lambda *_: '',
                      lambda found, *_: bool(found))}
STRATEGIES = (*RECORDS, *TOGETHER, *CALLS)


@contextmanager
def switched(name: str, acted: set[str]) -> Iterator[None]:
    """Switch one strategy off, and note the others that have an effect."""
    without = TOGETHER.get(name, (name,))
    with ExitStack() as stack:
        for module, registry, run, acts in REGISTRIES:
            kept = tuple(
                replace(each, **{run: watched(each.name, getattr(each, run), acts, acted)})
                for each in getattr(module, registry) if each.name not in without)
            stack.enter_context(patch.object(module, registry, kept))
        for other, (module, attribute, off, acts) in CALLS.items():
            function = getattr(module, attribute)
            new = wraps(function)(off) if other == name else watched(other, function, acts, acted)
            stack.enter_context(patch.object(module, attribute, new))
        yield


def watched(name: str, function: Callable[..., Any], acts: Callable[..., bool],
            acted: set[str]) -> Callable[..., Any]:
    """Return a function that also notes its strategy if its result has an effect."""
    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        found = function(*args, **kwargs)
        if acts(found, *args, **kwargs):
            acted.update({name, *(group for group, names in TOGETHER.items() if name in names)})
        return found

    return call


def main() -> None:
    """Solve the problems and print their results."""
    assert timing
    name, seconds = sys.argv[1], float(sys.argv[2])
    for file in map(Path, sys.argv[3:]):
        problem, acted = build_problem(load_file(file)[0]), set[str]()
        begun = time.process_time()
        with switched(name, acted):
            found = solve(problem, time_limit=seconds)
        print(json.dumps({
            'name': file.stem, 'status': found.status.value, 'cost': float(found.objective),
            'time': time.process_time() - begun, 'acted': sorted(acted)}), flush=True)


if __name__ == '__main__':
    main()
