# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A process of benchmarks/ablation.py, and its plugin of pytest: the search without some strategies.

``python _ablation.py NAMES SECONDS FILE...`` switches off the strategies of a list in JSON and
solves each problem, and again with other numbers and the cache of the first solution. It prints a
line of JSON for each: file, status, cost, processor times, and the strategies that had an effect.

``pytest -p _ablation`` reads the list from the variable OBC_ROS_WITHOUT, and writes the tests that
failed to the file in OBC_ROS_FAILED.
"""

import timing  # isort: skip - before numpy

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, ExitStack
from dataclasses import replace
from functools import wraps
import json
import os
from pathlib import Path
import sys
import time
from typing import Any
from unittest.mock import patch

from obc_ros.core.ocp.solution import Verdict
from obc_ros.core.ocp.statement import load_file
from obc_ros.core.solver import bench, conclusion, program_cache, search
from obc_ros.core.solver import solve as solving
from obc_ros.core.solver.diagnosis import explanation
from obc_ros.core.solver.improve import registry as improvements
from obc_ros.core.solver.multistart import multistart
from obc_ros.core.solver.program_cache import Cache
from obc_ros.core.solver.proofs import contradictions
from obc_ros.core.solver.solve import solve
from obc_ros.core.solver.starts import registry as starts
from obc_ros.core.solver.transcription import banded_program
import pytest
from repeats import vary

SIZE = 1e-2   # relative change of the numbers of a repeated problem


def skip_multistart(*args: Any, **_: Any) -> Any:
    """Return the result of the first descent."""
    return multistart.Explored(args[2], [], '')


def skip_tightening(*args: Any) -> Any:
    """Return the former margin, and the violation of the constraints."""
    return args[4], bench.compute_tightening.__wrapped__(*args)[1]   # type: ignore[attr-defined]


def name_proof(proof: Callable[..., Any]) -> str:
    """Return the name of a proof of CONTRADICTIONS."""
    return f'proof: {proof.__name__.strip("_").replace("_", " ")}'


# Where the registries are, the function of a record, and whether its result has an effect.
REGISTRIES: tuple[tuple[Any, str, str, Callable[..., bool]], ...] = (
    (solving, 'EXACT_METHODS', 'solve', lambda found, *_: found is not None),
    (starts, 'STARTS', 'run', lambda made, *_: made.judge()[0] is Verdict.ACCEPTED),
    (improvements, 'IMPROVEMENTS', 'run', lambda new, state: not isinstance(new, str) and (
        new.judge(state)[0] is not Verdict.REJECTED)),
    (explanation, 'CHECKS', 'run', lambda reason, *_: bool(reason)))
RECORDS = tuple(each.name for module, registry, *_ in REGISTRIES
                for each in getattr(module, registry))
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
PROOFS = tuple(map(name_proof, contradictions.CONTRADICTIONS))
STRATEGIES = (*RECORDS, *CALLS, *PROOFS)


@contextmanager
def switched(without: Collection[str], acted: set[str]) -> Iterator[None]:
    """Switch strategies off together, and note the others that have an effect."""
    with ExitStack() as stack:
        for module, registry, run, acts in REGISTRIES:
            kept = tuple(
                replace(each, **{run: watched(each.name, getattr(each, run), acts, acted)})
                for each in getattr(module, registry) if each.name not in without)
            stack.enter_context(patch.object(module, registry, kept))
        for name, (module, attribute, off, acts) in CALLS.items():
            function = getattr(module, attribute)
            new = wraps(function)(off) if name in without else watched(name, function, acts, acted)
            stack.enter_context(patch.object(module, attribute, new))
        stack.enter_context(patch.object(contradictions, 'CONTRADICTIONS', tuple(
            proof for proof in contradictions.CONTRADICTIONS if name_proof(proof) not in without)))
        yield


def watched(name: str, function: Callable[..., Any], acts: Callable[..., bool],
            acted: set[str]) -> Callable[..., Any]:
    """Return a function that also notes its strategy if its result has an effect."""
    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        found = function(*args, **kwargs)
        if acts(found, *args, **kwargs):
            acted.add(name)
        return found

    return call


_switched, _failed = ExitStack(), list[str]()


def pytest_sessionstart() -> None:
    """Switch the strategies off."""
    _switched.enter_context(switched(json.loads(os.environ['OBC_ROS_WITHOUT']), set()))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Keep the name of a test that fails."""
    if report.failed:
        _failed.append(report.nodeid)


def pytest_sessionfinish() -> None:
    """Write the tests that failed."""
    _switched.close()
    Path(os.environ['OBC_ROS_FAILED']).write_text(json.dumps(_failed), encoding='utf-8')


def main() -> None:
    """Solve the problems and print their results."""
    assert timing
    without, seconds = json.loads(sys.argv[1]), float(sys.argv[2])
    for file in sys.argv[3:]:
        acted, times, cache = set[str](), list[float](), Cache()
        problems = vary(load_file(Path(file))[0], 1, SIZE)
        with switched(without, acted):
            answers = []
            for problem in problems:
                begun = time.process_time()
                answers.append(solve(problem, cache=cache, time_limit=seconds))
                times.append(time.process_time() - begun)
        print(json.dumps({
            'file': file, 'status': [each.status.value for each in answers],
            'cost': [float(each.objective) for each in answers], 'time': times,
            'acted': sorted(acted)}), flush=True)


if __name__ == '__main__':
    main()
