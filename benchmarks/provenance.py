# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Provenance of the options: the problems and the tests that need the value of each.

Each problem of obc_ros/examples and test/collections is solved once to see which options its
search reads. Then each option is multiplied by 1/4 and by 4 on some of the problems that read it.
A problem needs the value if it is not solved, costs more, or takes longer with the changed one. If
no problem does, the tests of its strategy are run with the changed value: one that fails needs it.
If none fails, the factors 1/100 and 100 are tried on the problems and in the tests, and at last on
problems that take longer.
"""

import timing  # isort: skip - before numpy

import argparse
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
import json
import os
from pathlib import Path
import re
import subprocess
import sys
import time
from typing import Any

from obc_ros.core.ocp.certificate.certificate import TOLERANCES
from obc_ros.core.ocp.certificate.replay import LEAST_COST
from obc_ros.core.ocp.statement import build_problem, load_file
from obc_ros.core.solver.options import DEFAULTS, list_options, Option, Options
from obc_ros.core.solver.solve import solve

TEST = Path(__file__).resolve().parents[1] / 'test'
# An example comes before a problem of a collection that has its name.
FILES = {path.stem: path for folder in (TEST / 'collections', TEST.parent / 'obc_ros' / 'examples')
         for path in sorted(folder.rglob('*.yaml'))}
FACTORS, FAR = (0.25, 4.0), (0.01, 100.0)
LIMIT = 240.0      # [s] time limit of a solution with the default options
SLOW = 2.0         # [s] problems that take longer are solved with factors 1/100 and 100 only
SECONDS = 4.0      # [s] processor time of the problems of one option with its default
SECONDS_SLOW = 30.0   # [s] the same of slow problems
MOST = 12          # problems of one option
LONGER = 1.5       # ratio of processor times from which on a solution takes longer
NOTICED = 0.03     # [s] least difference of these times
LONGEST = 300.0    # [s] maximum of a file of tests

CHANGE = 'OBC_ROS_OPTION'   # variable with a changed option, for `_changed_option`
SOLVER = 'core/solver/'
# Tests of the strategies, in test/core/solver; the first that fails is the answer.
TESTS = {
    'coarse': ('test_coarse_mesh.py', 'test_stiff.py', 'improve/test_kink_mesh.py'),
    'refinement': ('adjoint/test_bvp.py',),
    'descent': ('improve/test_back_off.py', 'test_coarse_mesh.py',
                'improve/test_kink_mesh.py'),
    'budget': ('improve/test_back_off.py', 'test_uncertified.py',
               'diagnosis/test_explanation.py'),
    'guesses': ('starts/test_initial_guess.py', 'starts/test_multistart.py'),
    'obstacles': ('starts/test_obstacle_homotopy.py',),
    'rollouts': ('starts/test_multistart.py', 'transcription/test_program.py'),
    'multistart': ('starts/test_multistart.py',),
    'windows': ('starts/test_final_time_windows.py',),
    'bangs': ('improve/test_arc_iteration.py',),
    'wells': ('improve/test_hamiltonian_wells.py',),
    'kinks': ('improve/test_kink_mesh.py',),
    'boundary': ('arcs/test_phase_program.py',),
    'indirect': ('improve/test_kink_mesh.py',),
    'neighbour': ('test_repeats.py', 'improve/test_kink_mesh.py')}

Value = float | tuple[float, ...]


@dataclass(frozen=True)
class Result:
    """One solution: `time` is processor time [s], `options` those that were read."""

    name: str
    status: str
    cost: float
    time: float
    options: list[str]


def main() -> int:
    """Measure what is missing in the file of results, print it; return the exit status."""
    args = _arguments()
    known = _read(args.results)
    whole = {each['name']: Result(**each) for each in known if 'cost' in each}
    found = {each['option']: each for each in known if 'option' in each}
    with args.results.open('a', encoding='utf-8') as out:
        for name in FILES:
            if name not in whole:
                whole[name] = measure(name)
                _write(out, vars(whole[name]))
        for option in list_options():
            if option.name not in found and (not args.only or option.name in args.only):
                found[option.name] = try_option(option, whole, found.values(), args.seconds,
                                                args.seconds_slow)
                _write(out, found[option.name])
    rows = [(name, str(each['read']), str(len(each['tried'])), _describe(each))
            for name, each in found.items()]
    timing.table('What needs each option', ('option', 'read by', 'tried on', 'needed by'), rows)
    return timing.finish()


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().split('\n')[0])
    parser.add_argument('--peers', action='store_true', help='there are none')
    parser.add_argument('--only', nargs='+', metavar='NAME', help='options; default: all')
    parser.add_argument('--seconds', type=float, default=SECONDS, metavar='N',
                        help=f'processor time of the problems of one option; default: {SECONDS:g}')
    parser.add_argument('--seconds-slow', type=float, default=SECONDS_SLOW, metavar='N',
                        help=f'the same of problems that take over {SLOW:g} s; default: '
                        f'{SECONDS_SLOW:g}')
    parser.add_argument('--results', type=Path, default=Path('provenance.jsonl'), metavar='FILE',
                        help='lines of JSON; what it holds is not measured again')
    return parser.parse_args()


def _read(file: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in file.read_text(encoding='utf-8').splitlines()
            ] if file.exists() else []


def _write(out: Any, row: dict[str, Any]) -> None:
    print(json.dumps(row), file=out, flush=True)
    print('.', end='', file=sys.stderr, flush=True)


def watch(options: Options, seen: set[str]) -> Options:
    """Return options that note in `seen` which of them are read."""
    def watched(group: str) -> Any:
        values = getattr(options, group)
        names = {each.name for each in fields(values)}

        class Watched(type(values)):   # type: ignore[misc]
            def __getattribute__(self, name: str) -> Any:
                if name in names:
                    seen.add(f'{group}.{name}')
                return super().__getattribute__(name)

        return Watched(**{name: getattr(values, name) for name in names})

    return replace(options, **{each.name: watched(each.name) for each in fields(options)})


def measure(name: str) -> Result:
    """Solve a problem with the default options: once to note the options, once for the time."""
    seen = set[str]()
    found = run(name, watch(DEFAULTS, seen), LIMIT)
    if found.time < SLOW:
        found = run(name, DEFAULTS, LIMIT)
    return replace(found, options=sorted(seen))


def run(name: str, options: Options, limit: float) -> Result:
    """Solve a problem; an exception is its status."""
    problem = build_problem(load_file(FILES[name])[0])
    begun = time.process_time()
    try:
        found = solve(problem, time_limit=limit, options=options)
        status, cost = found.status.value, float(found.objective)
    except Exception as error:   # a changed value may make no sense
        status, cost = f'{type(error).__name__}: {error}', float('nan')
    return Result(name, status, cost, time.process_time() - begun, [])


def change(value: Value, factor: float) -> Value:
    """Return a multiple of a value: whole numbers stay whole and positive, 0 stays."""
    if isinstance(value, tuple):
        return tuple(float(change(each, factor)) if isinstance(each, float)
                     else change(each, factor) for each in value)   # type: ignore[misc]
    return max(1, round(value * factor)) if isinstance(value, int) and value else value * factor


def change_option(name: str, value: Value) -> Options:
    """Return the default options with another value of one of them."""
    group, key = name.split('.')
    return replace(DEFAULTS, **{group: replace(getattr(DEFAULTS, group), **{key: value})})


def try_option(option: Option, whole: dict[str, Result], others: Iterable[dict[str, Any]],
               seconds: float, seconds_slow: float) -> dict[str, Any]:
    """
    Solve problems with changed values of an option.

    Parameters
    ----------
    option : Option
        That is changed.
    whole : dict of Result
        Those with the default options.
    others : iterable of dict
        What is known of other options: problems that need these are tried first.
    seconds, seconds_slow : float
        Processor time of the quick and of the slow problems with the default options [s].

    Returns
    -------
    dict
        `option`, `read` (number of problems that read it), `tried` (names), `needs`: a list of
        [problem, factor, what happens].

    """
    reading = [each for each in whole.values() if option.name in each.options]
    solved = [each for each in reading if each.status == 'solved']
    needing = Counter(name for other in others for name, *_ in other['needs'])
    chosen = choose([each for each in solved if each.time < SLOW], needing, seconds)
    slow = choose([each for each in solved if each.time >= SLOW], needing, seconds_slow)
    needs = (list(_try_values(option, chosen, FACTORS)) or list(_try_tests(option, FACTORS))
             or list(_try_values(option, chosen, FAR)) or list(_try_tests(option, FAR))
             or list(_try_values(option, slow, FAR)))
    return {'option': option.name, 'read': len(reading),
            'tried': [each.name for each in chosen + slow], 'needs': needs}


def choose(results: Sequence[Result], needing: Counter[str], seconds: float) -> list[Result]:
    """Return problems: first those that need many options, then those that read many."""
    ranked = sorted(results, key=lambda each: (-needing[each.name], -len(each.options)))
    chosen, left = list[Result](), seconds
    for each in ranked:
        if len(chosen) < MOST and each.time <= left:
            chosen.append(each)
            left -= each.time
    return chosen


def _try_values(option: Option, chosen: Sequence[Result], factors: tuple[float, ...]
                ) -> Iterator[tuple[str, float, str]]:
    """Yield problem, factor and what happens; the first failure or higher cost ends a factor."""
    for factor in factors:
        value = change(option.value, factor)
        if value == option.value:
            continue
        options = change_option(option.name, value)
        for before in chosen:
            if what := compare(before, options):
                yield before.name, factor, what
                if not what.startswith('takes'):
                    break


def _try_tests(option: Option, factors: tuple[float, ...]) -> Iterator[tuple[str, float, str]]:
    """Yield test file, factor and the first test that fails."""
    for file in TESTS.get(option.name.split('.')[0], ()):
        for factor in factors:
            value = change(option.value, factor)
            if value != option.value and (test := find_failure(file, option.name, value)):
                yield Path(file).name, factor, f'fails: {test}'


def find_failure(file: str, name: str, value: Value) -> str:
    """Run a file of tests with a changed option; return the first test that fails, or ''."""
    given = ','.join(map(repr, value if isinstance(value, tuple) else (value,)))
    run = subprocess.run(
        [sys.executable, '-m', 'pytest', '-p', '_changed_option', '-x', '-q', '--tb=no',
         '-p', 'no:cacheprovider', str(TEST / SOLVER / file)], capture_output=True, text=True,
        timeout=LONGEST, check=False, env=os.environ | {
            CHANGE: f'{name}={given}', 'PYTHONPATH': str(Path(__file__).parent)})
    failed = re.search(r'^FAILED .*::(\w+)', run.stdout, re.MULTILINE)
    return failed.group(1) if failed else ''


def compare(before: Result, options: Options) -> str:
    """Return what is worse with other options: '' if nothing is."""
    after = run(before.name, options, 4 * before.time + 8.0)
    if after.status != 'solved':
        return f'is not solved: {after.status}'
    excess = (after.cost - before.cost) / max(abs(before.cost), LEAST_COST)
    if excess > TOLERANCES['cost']:
        return f'costs {excess:.1e} more'
    if not _takes_longer(before, after):
        return ''
    before = run(before.name, DEFAULTS, LIMIT)   # confirm: the machine may have had other load
    after = run(before.name, options, LIMIT)
    ratio = after.time / before.time
    return f'takes {ratio:.1f} times as long' if _takes_longer(before, after) else ''


def _takes_longer(before: Result, after: Result) -> bool:
    return after.time > max(LONGER * before.time, before.time + NOTICED)


def _describe(found: dict[str, Any]) -> str:
    return '; '.join(f'{name} {what} (times {factor:g})' for name, factor, what in found['needs']
                     ) or 'nothing found'


if __name__ == '__main__':
    sys.exit(main())
