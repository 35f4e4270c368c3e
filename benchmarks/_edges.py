# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Random problems at the edge of what a method can decide.

touching     a constraint is met at given ends with a margin from 0 to 1e-6, and well between them;
reachable    a reference is tracked that the plant can follow: the least cost is 0.
"""

from dataclasses import replace

import _truths
import numpy as np

MOST = 1e-6         # largest margin at an end, relative to the size of the state
VANISHING = 1e-10   # part of the size of what cancels in a cost below which it counts as 0


def touching(rng: np.random.Generator) -> _truths.Truth:
    """Return a problem with an admissible path that begins, and may end, at a constraint."""
    while True:
        truth = _truths.feasible(rng)
        if truth.kind != 'twins' and truth.t[-1] < _truths.LARGE:
            break
    i = int(rng.integers(truth.x.shape[1]))
    name, values, t = list(truth.mapping['states'])[i], truth.x[:, i], truth.t
    size = float(np.abs(values).max()) or 1.0
    paths = [*truth.mapping['path_constraints'], _touch(name, values / size, t, size, rng)]
    mapping = truth.mapping | {'path_constraints': paths}
    final = mapping['final_time']
    if rng.random() < 0.5 and not final['free']:
        end = f'{name} - ({float(values[-1])!r})'
        mapping['path_constraints'] = [*paths, _touch(
            name, values[::-1] / size, t[-1] - t[::-1], size, rng, float(t[-1]))]
        mapping['terminal_constraints'] = [*mapping['terminal_constraints'], end]
    return replace(truth, kind=f'touching, {truth.kind}', mapping=mapping)


def _touch(name: str, q: _truths.Array, since: _truths.Array, size: float,
           rng: np.random.Generator, end: float | None = None) -> _truths.Mapping:
    """Return q + s (time since the end) >= q there - margin, that the path meets."""
    margin = float(rng.choice([0.0, 10 ** rng.uniform(-12, np.log10(MOST))]))
    steepest = float(np.max((q[0] - q[1:]) / since[1:]))
    slope = max(steepest, 0.0) * 1.5 + 0.1 / float(since[-1])
    time = 't' if end is None else f'({end!r} - t)'
    return {'expr': f'{name}/({size!r}) + ({slope!r})*{time}', 'lower': float(q[0]) - margin,
            'upper': None}


def reachable(rng: np.random.Generator) -> tuple[str, _truths.Mapping, float, float]:
    """
    Return a problem of tracking: its kind, the statement, the least cost, and what counts as 0.

    The last is 1e-10 of the integral of w (|x| + |r|)^2 for each summand w (x - r)^2.
    """
    n, T = int(rng.integers(1, 4)), float(10 ** rng.uniform(-0.3, 0.7))
    pace, phase = float(rng.uniform(0.5, 3)), float(rng.uniform(0, 6))
    amplitude = float(10 ** rng.uniform(-1, 1))
    names = [f'x{i}' for i in range(n)]
    # x0 follows a wave; each further state is the derivative of the one before.
    waves = [f'({amplitude * pace**k!r})*sin({pace!r}*t + {phase + k * np.pi / 2!r})'
             for k in range(n + 1)]
    start = [amplitude * pace**k * float(np.sin(phase + k * np.pi / 2)) for k in range(n)]
    kind = str(rng.choice(['chain', 'pendulum', 'damped']))
    pull = {'chain': '', 'pendulum': ' - sin(x0)', 'damped': f' - 0.5*{names[-1]}**3'}[kind]
    wave = {'chain': '', 'pendulum': f' + sin({waves[0]})',
            'damped': f' + 0.5*({waves[n - 1]})**3'}[kind]
    weights = (0.1 + rng.exponential(size=n + 1)).tolist()
    cost = ' + '.join(f'({w!r})*({what} - ({wanted}))**2' for w, what, wanted in zip(
        weights, [*names, 'u'], [*waves[:n], waves[n] + wave], strict=True))
    mapping: _truths.Mapping = {
        'states': names, 'inputs': ['u'], 'running_cost': cost,
        'dynamics': dict(zip(names, [*names[1:], 'u' + pull], strict=True)),
        'initial_state': dict(zip(names, start, strict=True)),
        'final_time': {'free': False, 'value': T}}
    t = np.linspace(0.0, T, 1001)
    along = [amplitude * pace**k * np.sin(pace * t + phase + k * np.pi / 2) for k in range(n + 1)]
    along[n] = along[n] + {'chain': 0.0, 'pendulum': np.sin(along[0]),
                           'damped': 0.5 * along[n - 1]**3}[kind]
    if rng.random() < 0.3:   # wide enough for the input along the reference
        most = 1.1 * float(np.abs(along[n]).max())
        mapping['input_bounds'] = {'u': [-most, most]}
    size = sum(w * float(np.mean(4.0 * r**2)) * T for w, r in zip(weights, along, strict=True))
    return f'reachable, {kind}', mapping, 0.0, VANISHING * size
