# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Random problems with known properties.

feasible     the constraints are set around a simulated path, with a margin;
infeasible   an interval or an invariant excludes the terminal constraint, by a margin;
convex       the minimum cost is known in closed form, or from a matrix exponential.
"""

from dataclasses import dataclass, replace
import math
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.text.expressions import parse_expression
from scipy.linalg import expm

Array = NDArray[np.float64]
Mapping = dict[str, Any]

STEPS = 256         # steps of a simulation
ACCURATE = 1e-9     # largest relative change of a simulation with half as many steps
LARGE = 1e4         # a path whose state, in its unit, exceeds this is discarded
MARGINS = 1e-3, 0.5
KINDS = ('polynomial', 'rational', 'trigonometric', 'linear', 'rotation', 'population',
         'undriven', 'twins', 'vehicle', 'fuel', 'chain')


@dataclass(frozen=True)
class Truth:
    """A problem as in a file, and an admissible path t (N,), x (N, n), u (N, m)."""

    kind: str
    mapping: Mapping
    t: Array
    x: Array
    u: Array


@dataclass
class _Draft:
    """Dynamics without units; states and inputs have the names z0, z1 .. and w0, w1 .."""

    rates: list[str]
    inputs: int
    start: Array
    equality: str = ''   # the last input as a function of the others


def feasible(rng: np.random.Generator) -> Truth:
    """Return a problem with an admissible path."""
    while True:
        kind = str(rng.choice(KINDS))
        truth = _truth(kind, _draft(kind, rng), rng)
        if truth is not None:
            return truth


def _number(rng: np.random.Generator) -> str:
    value = float(rng.normal())
    return f'({value!r})' if rng.random() < 0.5 else f'({round(value, 1)!r})'


def _term(kind: str, n: int, m: int, rng: np.random.Generator) -> str:
    """Return a random term of states and inputs."""
    z, y = (f'z{rng.integers(n)}' for _ in range(2))
    w = f'w{rng.integers(m)}'
    terms = {
        'polynomial': [z, f'{z}*{y}', f'{z}*{w}', w, '1', f'{z}**3/10', f'{w}**2'],
        'rational': [f'{z}/(1 + {y}**2)', f'{w}/(2 + {z}**2)', f'1/(3 + {z}*{z})', w,
                     f'{z}*{w}/(1 + {y}**2 + {z}**2)'],
        'trigonometric': [f'sin({z})', f'cos({z})*{w}', f'{z}*sin({y})', w, f'sin({w})',
                          f'cos({z} - {y})'],
        'linear': [z, y, w, w, '1'],
    }[kind]
    return f'{_number(rng)}*{terms[rng.integers(len(terms))]}'


def _draft(kind: str, rng: np.random.Generator) -> _Draft:
    n, m = int(rng.integers(1, 7)), int(rng.integers(1, 3))
    start = rng.normal(size=6)
    if kind in ('polynomial', 'rational', 'trigonometric', 'linear'):
        rates = [' + '.join(_term(kind, n, m, rng) for _ in range(rng.integers(1, 4)))
                 + (f' - z{i}' if rng.random() < 0.5 else '') for i in range(n)]
        draft = _Draft(rates, m, start[:n])
    elif kind == 'rotation':
        n = max(n, 2)
        S, D = ((M - M.T).tolist() for M in rng.normal(size=(2, n, n)))
        draft = _Draft([' + '.join(f'(({a!r}) + ({b!r})*w0)*z{j}' for j, (a, b) in enumerate(
            zip(S[i], D[i], strict=True))) for i in range(n)], 1, start[:n])
    elif kind == 'population':
        a, b = (abs(float(value)) for value in rng.normal(size=2))
        draft = _Draft([f'-{a!r}*z0*z1 - w0**2*z0', f'{a!r}*z0*z1 - {b!r}*z1',
                        f'{b!r}*z1 + w0**2*z0'], 1, np.abs(start[:3]))
    elif kind == 'undriven':
        fast = float(rng.uniform(1, 40))
        draft = _Draft(['w0 - z0', f'{fast!r}*z2', f'-{fast!r}*z1', '1', 'z3*cos(z1)'][
            :int(rng.integers(3, 6))], 1, start[:5])
        draft.start = draft.start[:len(draft.rates)]
    elif kind == 'twins':
        a = float(rng.normal())
        draft = _Draft([f'{a!r}*z0 + w0', f'{a!r}*z1 + w0', 'z0 - z1'], 1, start[:3])
    elif kind == 'vehicle':
        draft = _Draft(['w0*cos(z2)', 'w0*sin(z2)', 'w1'], 2, start[:3])
    elif kind == 'fuel':
        draft = _Draft(['z1', 'w0/z2 - 1', '-0.05*abs(w0) - 0.01'], 1, np.append(start[:2], 5.0))
    else:
        draft = _Draft([*(f'z{i + 1}' for i in range(n - 1)), f'w0 + {_number(rng)}'], 1,
                       start[:n])
    if rng.random() < 0.2:
        draft.equality = f'sin(z0) + w0*{_number(rng)}/2'
        draft.rates[-1] += f' + {_number(rng)}*w{draft.inputs}'
        draft.inputs += 1
    return draft


def _truth(kind: str, draft: _Draft, rng: np.random.Generator) -> Truth | None:
    """Return the problem of a draft in random units, with constraints around a path, or None."""
    n, m = len(draft.rates), draft.inputs
    T = float(10 ** rng.uniform(-0.7, 0.7))
    half = 10 ** rng.uniform(-1, 0.7, m)
    far = np.where(rng.random(m) < 0.5, 10 ** rng.uniform(0, 3, m), 0.0)
    middle = half * far * rng.choice([-1.0, 1.0], m)
    # Inputs with a large offset would be large, unless the dynamics subtract the offset.
    shift = np.where(rng.random(m) < 0.6, middle, 0.0)
    bad = rng.random() < 0.4
    units = 10 ** rng.uniform(-8, 8, n) if bad else np.ones(n)
    input_units = 10 ** rng.uniform(-8, 8, m) if bad else np.ones(m)
    second = float(10 ** rng.uniform(-4, 4)) if bad else 1.0
    free = m - bool(draft.equality)
    names, inputs = [f'x{i}' for i in range(n)], [f'u{k}' for k in range(m)]

    def stated(text: str) -> str:
        """Return an expression in z and w as one in the states and inputs with units."""
        for k in range(m):
            moved = f' - ({float(shift[k])!r})' if shift[k] and k < free else ''
            text = text.replace(f'w{k}', f'(u{k}/{float(input_units[k])!r}{moved})')
        for i in range(n):
            text = text.replace(f'z{i}', f'(x{i}/{float(units[i])!r})' if bad else f'x{i}')
        return text

    texts = [f'({stated(rate)})*({float(units[i] / second)!r})' if bad else stated(rate)
             for i, rate in enumerate(draft.rates)]
    margin = float(np.exp(rng.uniform(*np.log(MARGINS))))
    phase, pace = rng.uniform(0, 6, m), rng.uniform(0, 6, m)
    time = T * second
    t = np.linspace(0.0, time, 2 * STEPS + 1)
    u = input_units * (middle + (1 - margin) * half * np.sin(
        phase + pace * (t / time)[:, None]))
    symbols = {name: ca.SX.sym(name) for name in (*names, *inputs)}
    found = _simulated(symbols, texts, stated(draft.equality) if draft.equality else '',
                       names, inputs, draft.start * units, t, u, LARGE * units)
    if found is None:
        return None
    x, u = found
    mapping = _around(rng, margin, kind, names, inputs, x, u, float(time))
    low, high = input_units * (middle - half), input_units * (middle + half)
    limits = {name: [float(a), float(b)] for name, a, b in zip(
        inputs[:free], low, high, strict=False)}
    if rng.random() < 0.2:   # sometimes no bounds: more paths are admissible
        limits.popitem()
    paths = list(mapping['path_constraints'])
    if draft.equality:
        paths.append({'expr': f'{inputs[-1]}/{float(input_units[-1])!r} - ('
                              f'{stated(draft.equality)})', 'lower': 0, 'upper': 0})
    return Truth(kind, mapping | {
        'states': names, 'inputs': inputs, 'dynamics': dict(zip(names, texts, strict=True)),
        'initial_state': dict(zip(names, x[0].tolist(), strict=True)), 'input_bounds': limits,
        'path_constraints': paths}, t[::2], x, u)


def _simulated(symbols: dict[str, ca.SX], texts: list[str], equality: str, names: list[str],
               inputs: list[str], start: Array, t: Array, u: Array, most: Array
               ) -> tuple[Array, Array] | None:
    """Return states and inputs at every second time, by a Runge-Kutta method, or None."""
    x, w = (ca.vertcat(*(symbols[name] for name in each)) for each in (names, inputs))
    f = ca.vertcat(*(parse_expression(text, symbols, 'rate') for text in texts))
    last = parse_expression(equality, symbols, 'equality') if equality else w[-1]
    used = ca.vertcat(*ca.vertsplit(w)[:-1], last)
    given = ca.Function('last', [x, w], [used])
    rate = ca.Function('rate', [x, w], [ca.substitute(f, w, used)])
    h = ca.SX.sym('h')
    a, b, c = (ca.SX.sym(name, len(inputs)) for name in 'abc')
    k1 = rate(x, a)
    k2 = rate(x + h / 2 * k1, b)
    k3 = rate(x + h / 2 * k2, b)
    k4 = rate(x + h * k3, c)
    step = ca.Function('step', [x, a, b, c, h], [x + h / 6 * (k1 + 2*k2 + 2*k3 + k4)])
    ends = []
    for every in (2, 4):
        count = (len(t) - 1) // every
        lengths = np.full((1, count), t[every])
        path = step.mapaccum(count)(start, u[:-1:every].T, u[every // 2::every].T,
                                    u[every::every].T, lengths).full().T
        ends.append(np.vstack([start, path]))
    fine, coarse = ends[0], ends[1]
    size = np.abs(fine).max(axis=0)
    if not np.isfinite(fine).all() or np.any(size > most):
        return None
    if np.any(np.abs(fine[::2] - coarse) > ACCURATE * size):
        return None
    inputs_used = given.map(len(fine))(fine.T, u[::2].T).full().T
    return (fine, inputs_used) if np.isfinite(inputs_used).all() else None


def _around(rng: np.random.Generator, margin: float, kind: str, names: list[str],
            inputs: list[str], x: Array, u: Array, time: float) -> Mapping:
    """Return constraints that a path satisfies."""
    size = np.abs(x).max(axis=0)
    width = margin * (np.ptp(x, axis=0) + 1e-3 * size + 1e-300)
    bounds = {}
    for i, name in enumerate(names):
        if rng.random() < 0.5:
            low, high = float(x[:, i].min() - width[i]), float(x[:, i].max() + width[i])
            bounds[name] = [low if rng.random() < 0.8 else None,
                            high if rng.random() < 0.8 else None]
    share = rng.random()
    end = [f'{name} - ({float(value)!r})' for name, value in zip(names, x[-1], strict=True)
           if rng.random() < share]
    if len(names) > 1 and rng.random() < 0.5:
        row = rng.normal(size=len(names)).round(int(rng.integers(0, 3))) / size
        total = float(row @ x[-1])
        end.append(' + '.join(f'({float(a)!r})*{name}' for a, name in zip(
            row, names, strict=True)) + f' - ({total!r})')
        if rng.random() < 0.3:
            end.append(f'3*({end[-1]})')
        if not row.any():
            end = end[:-2]
    if rng.random() < 0.3:
        i, j = rng.integers(len(names), size=2)
        value = float((x[-1, i] / size[i]) ** 2 + x[-1, j] / size[j])
        end.append(f'({names[i]}/{float(size[i])!r})**2 + {names[j]}/{float(size[j])!r} - '
                   f'({value!r})')
    cost = ['1', ' + '.join(f'({name}/{float(np.abs(u[:, k]).max())!r})**2'
                            for k, name in enumerate(inputs))][int(rng.random() < 0.7)]
    free = bool(rng.random() < 0.5)
    final = {'free': True, 'lower': float(time * rng.uniform(0, 0.9)),
             'upper': float(time * rng.uniform(1.01, 2))} if free else {
                 'free': False, 'value': time}
    return {'running_cost': cost, 'state_bounds': bounds, 'terminal_constraints': end,
            'path_constraints': _paths(rng, margin, names, inputs, x, u), 'final_time': final}


def _paths(rng: np.random.Generator, margin: float, names: list[str], inputs: list[str],
           x: Array, u: Array) -> list[Mapping]:
    found = []
    while rng.random() < 0.3:
        i, k = int(rng.integers(len(names))), int(rng.integers(len(inputs)))
        size, span = float(np.abs(x[:, i]).max()), float(np.abs(u[:, k]).max())
        if not size or not span:
            break
        z, w = x[:, i] / size, u[:, k] / span
        form = int(rng.integers(4))
        values = (z**2, z + w, np.sin(3 * z), z * w)[form]
        first, second = f'({names[i]}/{size!r})', f'({inputs[k]}/{span!r})'
        text = (f'{first}**2', f'{first} + {second}', f'sin(3*{first})',
                f'{first}*{second}')[form]
        room = margin * (float(np.ptp(values)) + 1e-3)
        found.append({'expr': text, 'lower': float(values.min() - room),
                      'upper': float(values.max() + room) if rng.random() < 0.5 else None})
    return found


def loosened(truth: Truth, rng: np.random.Generator) -> Truth:
    """Return a feasible problem with initial values within ranges around those of its path."""
    def around(value: float) -> float | list[float | None] | None:
        low, high = value - np.abs(rng.normal(size=2)) * [1, -1] * (1e-3 + abs(value))
        return (value, None, [float(low), None], [float(low), float(high)])[rng.integers(4)]

    start = {name: around(value) for name, value in truth.mapping['initial_state'].items()}
    return replace(truth, kind=f'{truth.kind}, free start',
                   mapping=truth.mapping | {'initial_state': start})


def infeasible(rng: np.random.Generator) -> tuple[str, Mapping]:
    """Return an infeasible problem, and its kind."""
    margin = float(np.exp(rng.uniform(np.log(1e-2), np.log(0.5))))
    T = float(10 ** rng.uniform(-0.5, 0.5))
    n = int(rng.integers(2, 5))
    names = [f'x{i}' for i in range(n)]
    start = rng.normal(size=n)
    base: Mapping = {
        'states': names, 'inputs': ['u'], 'running_cost': 'u**2',
        'initial_state': dict(zip(names, start.tolist(), strict=True)),
        'input_bounds': {'u': [-1, 1]}, 'final_time': {'free': False, 'value': T}}
    kind = str(rng.choice(['reach', 'rotation', 'population', 'undriven', 'bounds', 'free start',
                           'drift']))
    if kind == 'reach':
        speed = float(10 ** rng.uniform(-1, 1))
        far = float(start[0] + rng.choice([-1, 1]) * speed * T * (1 + margin))
        rates = [f'{speed!r}*sin(x1)*u', *['u'] * (n - 1)]
        return kind, base | {'dynamics': dict(zip(names, rates, strict=True)),
                             'terminal_constraints': [f'x0 - ({far!r})']}
    if kind == 'free start':
        # From nowhere in the box of x(0).
        width = float(rng.exponential())
        far = float(start[0] + T * (1 + margin))
        box = dict(zip(names, start.tolist(), strict=True)) | {
            'x0': [float(start[0] - width), float(start[0])]}
        return kind, base | {
            'dynamics': dict(zip(names, ['sin(x1)*u', *['u'] * (n - 1)], strict=True)),
            'initial_state': box, 'terminal_constraints': [f'x0 - ({far!r})']}
    if kind == 'drift':
        # A rate that inputs cannot stop, and a state that must return.
        return kind, base | {
            'dynamics': dict(zip(names, [f'{1 + margin!r} + u', *['u'] * (n - 1)], strict=True)),
            'initial_state': dict.fromkeys(names), 'periodic': ['x0']}
    if kind == 'rotation':
        S, D = ((M - M.T).tolist() for M in rng.normal(size=(2, n, n)))
        rates = [' + '.join(f'(({a!r}) + ({b!r})*u)*x{j}' for j, (a, b) in enumerate(
            zip(S[i], D[i], strict=True))) for i in range(n)]
        end = rng.normal(size=n)
        end *= (1 + margin) * np.linalg.norm(start) / np.linalg.norm(end)
        return kind, base | {
            'dynamics': dict(zip(names, rates, strict=True)), 'terminal_constraints': [
                f'{name} - ({value!r})' for name, value in zip(
                    names, end.tolist(), strict=True)]}
    if kind == 'population':
        start = np.abs(start[:2])
        total = float(start.sum() * (1 + margin))
        return kind, base | {
            'states': names[:2], 'initial_state': dict(zip(names, start.tolist(), strict=False)),
            'dynamics': {'x0': '-u**2*x0*x1 - x0', 'x1': 'u**2*x0*x1 + x0'},
            'terminal_constraints': [f'x0 + x1 - {total!r}']}
    rates = ['u', '-x1', *['u*x0'] * (n - 2)]
    if kind == 'undriven':
        wrong = float(start[1] * math.exp(-T) * (1 + margin) + margin)
        return kind, base | {'dynamics': dict(zip(names, rates, strict=True)),
                             'terminal_constraints': [f'x1 - ({wrong!r})']}
    return kind, base | {
        'dynamics': dict(zip(names, rates, strict=True)),
        'state_bounds': {'x0': [None, float(start[0] + margin)]},
        'terminal_constraints': [f'x0 - ({float(start[0] + 2 * margin)!r})']}


def convex(rng: np.random.Generator) -> tuple[str, Mapping, float]:
    """Return a convex problem, its kind and its minimum cost."""
    kind = str(rng.choice(['regulator', 'transfer', 'speed limit', 'initial cost', 'periodic',
                           'free parameter']))
    if kind == 'speed limit':
        return kind, *_speed_limit(rng)
    if kind in ('initial cost', 'periodic', 'free parameter'):
        return kind, *_free_ends(kind, rng)
    n, T = int(rng.integers(1, 4)), float(10 ** rng.uniform(-0.3, 0.5))
    A, b, start = rng.normal(size=(n, n)), rng.normal(size=n), rng.normal(size=n)
    q = np.abs(rng.normal(size=n)) * (kind == 'regulator')
    names = [f'x{i}' for i in range(n)]
    cost = ' + '.join(['u**2', *(f'({value!r})*{name}**2' for name, value in zip(
        names, q.tolist(), strict=True))])
    rates = [' + '.join([*(f'({a!r})*{name}' for a, name in zip(row, names, strict=True)),
                         f'({float(c)!r})*u']) for row, c in zip(A.tolist(), b, strict=True)]
    mapping: Mapping = {
        'states': names, 'inputs': ['u'], 'running_cost': cost,
        'dynamics': dict(zip(names, rates, strict=True)),
        'initial_state': dict(zip(names, start.tolist(), strict=True)),
        'final_time': {'free': False, 'value': T}}
    # With the costate lam, d/dt (x, lam) = [[A, -b b'/2], [-2 Q, -A']] (x, lam).
    flow = expm(T * np.block([[A, -np.outer(b, b) / 2], [-2 * np.diag(q), -A.T]]))
    if kind == 'regulator':
        lam = -np.linalg.solve(flow[n:, n:], flow[n:, :n] @ start)
        least = float(lam @ start) / 2
    else:
        # An end that inputs of this size reach; it determines lam(0).
        lam = rng.normal(size=n)
        end = flow[:n, :n] @ start + flow[:n, n:] @ lam
        last = flow[n:, :n] @ start + flow[n:, n:] @ lam
        least = float(lam @ start - last @ end) / 2
        mapping['terminal_constraints'] = [
            f'{name} - ({value!r})' for name, value in zip(names, end.tolist(), strict=True)]
    if rng.random() < 0.3:
        # Bounds that are inactive at the optimum: the same solution by another method.
        mapping['input_bounds'] = {'u': [-1e3 * (1 + least), 1e3 * (1 + least)]}
    return kind, mapping, least


def _free_ends(kind: str, rng: np.random.Generator) -> tuple[Mapping, float]:
    """Return a linear system that follows a wave, with what is found besides u, and its cost."""
    n, T = int(rng.integers(1, 4)), float(10 ** rng.uniform(-0.3, 0.4))
    A, b, g = rng.normal(size=(n, n)), rng.normal(size=n), rng.normal(size=n)
    q, weight = 0.1 + np.abs(rng.normal(size=n)), 0.1 + float(rng.exponential())
    pace = float(rng.uniform(0.5, 4))
    wanted, start = rng.normal(size=n), rng.normal(size=n)
    names, found = [f'x{i}' for i in range(n)], kind == 'free parameter'
    rates = [' + '.join([*(f'({a!r})*{name}' for a, name in zip(row, names, strict=True)),
                         f'({b[i].item()!r})*u', *[f'({g[i].item()!r})*p'] * found])
             for i, row in enumerate(A.tolist())]
    mapping: Mapping = {
        'states': names, 'inputs': ['u'], 'dynamics': dict(zip(names, rates, strict=True)),
        'running_cost': ' + '.join(['u**2', *(
            f'({a!r})*({name} - ({c!r})*cos({pace!r}*t))**2'
            for a, c, name in zip(q.tolist(), wanted.tolist(), names, strict=True))]),
        'initial_state': dict.fromkeys(names), 'final_time': {'free': False, 'value': T}}
    if found:
        mapping |= {'free_parameters': {'p': None}, 'terminal_cost': f'{weight!r}*p**2',
                    'initial_state': dict(zip(names, start.tolist(), strict=True))}
    elif kind == 'periodic':
        mapping['periodic'] = names
    else:
        mapping['initial_cost'] = ' + '.join(
            f'{weight!r}*({name} - ({c!r}))**2'
            for name, c in zip(names, start.tolist(), strict=True))
    # y = (x, lam, lam_p, p, cos, sin): dlam_p/dt = -g'lam.
    N = 2 * n + 4
    M = np.zeros((N, N))
    M[:n, :n], M[:n, n:2 * n], M[:n, 2 * n + 1] = A, -np.outer(b, b) / 2, g * found
    M[n:2 * n, :n], M[n:2 * n, n:2 * n], M[n:2 * n, -2] = -2 * np.diag(q), -A.T, 2 * q * wanted
    M[2 * n, n:2 * n] = -g * found
    M[-2, -1], M[-1, -2] = -pace, pace
    flow, one = expm(M * T), np.eye(N)
    x, lam = slice(0, n), slice(n, 2 * n)
    rows, right = [one[2 * n], one[-2], one[-1]], [0.0, 1.0, 0.0]
    if found:
        rows += [*one[x], *flow[lam], flow[2 * n] - 2 * weight * one[2 * n + 1]]
        right += [*start, *np.zeros(n + 1)]
    else:
        rows += [one[2 * n + 1], *(flow - one if kind == 'periodic' else flow)[lam]]
        rows += [*(flow - one)[x]] if kind == 'periodic' else [*(one[lam] + 2 * weight * one[x])]
        right += [*np.zeros(n + 1), *(2 * weight * start * (kind != 'periodic'))]
    y = np.linalg.solve(np.array(rows), np.array(right))
    nodes, weights = np.polynomial.legendre.leggauss(60)
    path = np.stack([expm(M * s) @ y for s in T * (1 + nodes) / 2])
    L = (path[:, lam] @ b / 2)**2 + (path[:, x] - np.outer(path[:, -2], wanted))**2 @ q
    ends = weight * (y[2 * n + 1]**2 if found else
                     (kind != 'periodic') * float(np.sum((y[x] - start)**2)))
    return mapping, float(T / 2 * weights @ L + ends)


def _speed_limit(rng: np.random.Generator) -> tuple[Mapping, float]:
    """Return a double integrator, rest to rest, whose speed is at its limit for an interval."""
    d, T = float(10 ** rng.uniform(-1, 1)), float(10 ** rng.uniform(-0.5, 0.7))
    limit = float(d / T * rng.uniform(1.1, 1.4))
    # v = limit (1 - (1 - t/a)^2) for a time a, and symmetrically at the end.
    a = 1.5 * (T - d / limit)
    return {
        'states': ['x', 'v'], 'inputs': ['u'], 'dynamics': {'x': 'v', 'v': 'u'},
        'running_cost': 'u**2', 'initial_state': {'x': 0, 'v': 0},
        'terminal_constraints': [f'x - {d!r}', 'v'], 'state_bounds': {'v': [None, limit]},
        'final_time': {'free': False, 'value': T}}, 8 * limit**2 / (3 * a)
