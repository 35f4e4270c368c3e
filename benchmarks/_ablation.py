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
from dataclasses import dataclass
from functools import partial, wraps
import json
from pathlib import Path
import sys
import time
from typing import Any
from unittest.mock import patch

from obc_ros.core.ocp.statement import build_problem, load_file
from obc_ros.core.solver import (
    bench,
    coarse_mesh,
    conclusion,
    descent,
    methods,
    program_cache,
    search,
)
from obc_ros.core.solver.improve import arc_iteration, indirect, state_arcs
from obc_ros.core.solver.solve import solve
from obc_ros.core.solver.starts import initial_guess, multistart
from obc_ros.core.solver.transcription import banded_program


def give(value: Any) -> Callable[..., Any]:
    """Return a function that returns a value."""
    return lambda *_, **__: value


def argument(number: int) -> Callable[..., Any]:
    """Return a function that returns one of its arguments."""
    return lambda *args, **__: args[number]


@dataclass(frozen=True)
class Strategy:
    """
    A part of the search that can be switched off.

    Attributes
    ----------
    places : tuple of (object, str)
        Where the function of the strategy is looked up.
    off : callable
        What takes its place. The strategy had an effect if it returns something else.

    """

    places: tuple[tuple[Any, str], ...]
    off: Callable[..., Any]


def skip_multistart(*args: Any, **_: Any) -> Any:
    """Return the result of the first descent."""
    return multistart.Explored(args[2], [], '')


STRATEGIES = {
    'riccati': Strategy(((methods.EXACT_METHODS[0], 'solve'),), give(None)),
    'time_optimal': Strategy(((methods.EXACT_METHODS[1], 'solve'),), give(None)),
    'reeds_shepp': Strategy(((methods.EXACT_METHODS[2], 'solve'),), give(None)),
    'absolute values': Strategy(((program_cache, 'build_smooth_twin'),), give(None)),
    'obstacle homotopy': Strategy(((coarse_mesh, 'start_around'),), give(0)),
    'horizon continuation': Strategy(((coarse_mesh, 'lengthen_horizon'),), give(None)),
    'rollouts, first starts': Strategy(((coarse_mesh, 'start_from_rollouts'),), give([])),
    'rollouts, brief search': Strategy(((multistart, 'search_rollouts_briefly'),), give([])),
    'rollouts, multistart': Strategy(((multistart, 'interleave_rollouts'),), give(None)),
    'final-time windows': Strategy(((multistart, 'find_other_lengths'),), give([])),
    'lines to other final states': Strategy(
        ((initial_guess.Guesser, 'scattered'),), argument(3)),
    'multistart': Strategy(((search, 'explore_starts'),), skip_multistart),
    'Hamiltonian minima': Strategy(((multistart, 'move_to_best_branch'),), argument(1)),
    'bang arcs': Strategy(((arc_iteration.ArcIteration, 'settle'),), argument(1)),
    'mesh at kinks': Strategy(((descent, 'solve_on_kinks'),), give(None)),
    'boundary arcs': Strategy(
        ((descent, 'solve_along_bounds'), (state_arcs, 'solve_along_bounds')), give(None)),
    'boundary arcs at once': Strategy(((descent, 'solve_at_once'),), give(None)),
    'constraint tightening': Strategy(((bench, 'compute_tightening'),), lambda *args: (
        args[3], bench.compute_tightening.__wrapped__(*args)[1])),  # type: ignore[attr-defined]
    'indirect refinement': Strategy(((indirect, '_better'),), argument(1)),
    'negative curvature': Strategy(((banded_program, 'leave_saddle'),), argument(1)),
    'active set': Strategy(((banded_program, 'follow_active_set'),), give(None)),
    'positivity': Strategy(((search, '_keep_inside'),), give(None)),
    'chattering': Strategy(((search, '_mixes'),), give(False)),
    'larger inputs': Strategy(((conclusion, 'explain_larger_inputs'),), give('')),
    'proofs before the search': Strategy(((methods, '_prove_infeasible'),), give('')),
}


@contextmanager
def switched(name: str, acted: set[str]) -> Iterator[None]:
    """Switch one strategy off, and note the others that have an effect."""
    with ExitStack() as stack:
        for other, strategy in STRATEGIES.items():
            for of, attribute in strategy.places:
                function = getattr(of, attribute)
                new = watched(function, partial(_note, other, strategy.off, acted))
                if other == name:
                    new = wraps(function)(strategy.off)
                if isinstance(of, methods.ExactMethod):   # frozen
                    object.__setattr__(of, attribute, new)
                    stack.callback(object.__setattr__, of, attribute, function)
                else:
                    stack.enter_context(patch.object(of, attribute, new))
        yield


def _note(name: str, off: Callable[..., Any], acted: set[str], found: Any, *args: Any) -> None:
    """Note a strategy whose result differs from what takes its place."""
    if name in ('constraint tightening', 'multistart', 'lines to other final states',
                'rollouts, multistart'):
        acted.add(name)
    else:
        other = off(*args)
        if found is not other and not (isinstance(found, int | str | list) and found == other):
            acted.add(name)


def watched(function: Callable[..., Any], note: Callable[..., None]) -> Callable[..., Any]:
    """Return a function that also notes its result."""
    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        found = function(*args, **kwargs)
        note(found, *args)
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
