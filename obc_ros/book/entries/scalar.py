# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Linear systems with one state: Example 2.2 and Exercise 2.9."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from obc_ros.api.figures.style import EXACT, EXACT_LINE, get_line, LINE_COLOURS, THIN
from obc_ros.book.closed_forms import solve_scalar_finite_horizon
from obc_ros.book.entry import (
    ComparedRow,
    create_panels,
    EntryResult,
    GalleryEntry,
    label_axes,
    place_legend_below,
)
from obc_ros.book.runner import Desk, Trajectory
from obc_ros.core.numerics.arrays import Array

WEIGHTS = (0.1, 1.0, 10.0, 100.0)
MANY_WEIGHTS = tuple(np.logspace(-2, 8, 21))
A, B, X0, TF = 1.0, 1.0, 1.0, 1.0


def state_example_2_2(a: float, b: float, x0: float, tf: float, c: float | None) -> dict[str, Any]:
    """Return the problem of Example 2.2; `c` None for x(tf) = 0."""
    end = ({'terminal_constraints': ['x']} if c is None else {'terminal_cost': 'c*x**2/2'})
    return {'system': 'scalar', 'parameters': {'a': a, 'b': b} | ({} if c is None else {'c': c}),
            'running_cost': 'u**2/2', **end, 'initial_state': {'x': x0},
            'final_time': {'free': False, 'value': tf}}


def evaluate_equation_2_4(t: Array, c: float) -> Array:
    """Return u*(t) from equation (2.4)."""
    s = 2 * A - B**2 * c * (1 - np.exp(2 * A * TF))
    u: Array = -2 * A * B * c * np.exp(A * (2 * TF - t)) * X0 / s
    return u


def evaluate_equation_2_5(t: Array, c: float) -> Array:
    """Return x*(t) from equation (2.5)."""
    s = 2 * A - B**2 * c * (1 - np.exp(2 * A * TF))
    x: Array = X0 * np.exp(A * t) + B**2 * c * np.exp(A * TF) * X0 / s * (
        np.exp(A * (TF - t)) - np.exp(A * (t + TF)))
    return x


def example_2_2(desk: Desk) -> EntryResult:
    """Compute Example 2.2 for several c, and for the limit."""
    paths = desk.solve_all([state_example_2_2(A, B, X0, TF, c) for c in WEIGHTS])
    many = desk.solve_all([state_example_2_2(A, B, X0, TF, c) for c in MANY_WEIGHTS], show=0)
    limit = desk.solve(**state_example_2_2(A, B, X0, TF, None))
    rows = []
    for c, path in zip(WEIGHTS, paths, strict=True):
        rows += [ComparedRow(f'$x*(t)$, $c = {c:g}$', path.x['x'],
                             evaluate_equation_2_5(path.t, c), 'equation (2.5)'),
                 ComparedRow(f'$u*(t)$, $c = {c:g}$', path.u['u'],
                             evaluate_equation_2_4(path.t, c), 'equation (2.4)')]
    costate = paths[2].lam['x'], 10.0 * evaluate_equation_2_5(np.array(TF), 10.0) * np.exp(
        A * (TF - paths[2].t))
    growth = 1 - np.exp(-2 * A * TF)
    ends = np.array([path.x['x'][-1] for path in many])
    rows += [
        ComparedRow('costate $λ(t)$, $c = 10$', *costate, '$c x(t_f) e^{a(t_f - t)}$'),
        ComparedRow('$x*(t_f)$ for $c$ from 0.01 to $10^8$', ends,
                    [2 * A * np.exp(A * TF) * X0 / (2 * A + B**2 * c * np.expm1(2 * A * TF))
                     for c in MANY_WEIGHTS], 'equation (2.5) at $t_f$', relative=True),
        ComparedRow('cost $J$ for $c$ from 0.01 to $10^8$', [path.J for path in many],
                    [solve_scalar_finite_horizon(A, B, c, X0, [0.0], tf=TF).J
                     for c in MANY_WEIGHTS],
                    '$½ P(t_0) x(t_0)^2$', relative=True),
        ComparedRow('$x(t_f)$ with the constraint $x(t_f) = 0$', limit.x['x'][-1], 0.0,
                    'the limit $c → ∞$'),
        ComparedRow('cost $J$ with the constraint $x(t_f) = 0$', limit.J,
                    A * X0**2 / (B**2 * growth), '$a x(t_0)^2 / b^2(1 - e^{-2a(t_f - t_0)})$')]
    return EntryResult(rows, _draw_2_2(paths, many, limit), (
        'Coloured: solutions of `trajectory_server` for several weights $c$ of the final state. '
        'Circles: equations (2.5) and (2.4). As $c$ grows, $x*(t_f)$ decreases like $1/c$, and '
        'the trajectory tends to that with the terminal constraint $x(t_f) = 0$ (grey, wide).',
        'The cost increases with $c$, $dJ/dc = ½ x*(t_f)^2$. For small $c$ it is the final cost '
        'of $u = 0$. For large $c$ it tends to the least input energy that reaches '
        '$x(t_f) = 0$, which is finite.'))


def _draw_2_2(paths: list[Trajectory], many: list[Trajectory], limit: Trajectory) -> Any:
    figure, ((states, inputs), (ends, costs)) = create_panels(2, 2)
    t = np.linspace(0, TF, 200)
    for index, (c, path) in enumerate(zip(WEIGHTS, paths, strict=False)):
        states.plot(path.t, path.x['x'], label=f'$c = {c:g}$', **get_line(index))
        inputs.plot(path.t, path.u['u'], **get_line(index))
        states.plot(t, evaluate_equation_2_5(t, c), **EXACT)
        inputs.plot(t, evaluate_equation_2_4(t, c), **EXACT)
    for axes, values in ((states, limit.x['x']), (inputs, limit.u['u'])):
        axes.plot(limit.t, values, color='0.8', linewidth=5, zorder=1, label='$x(t_f) = 0$')
        axes.plot([], [], label='(2.5), (2.4)', **EXACT)
        axes.set_xlim(0, TF)
    ends.loglog(MANY_WEIGHTS, [path.x['x'][-1] for path in many], 'o', markersize=4.5,
                color=LINE_COLOURS[0], label='server')
    fine = np.logspace(-2, 8, 200)
    ends.loglog(fine, [evaluate_equation_2_5(np.array(TF), c) for c in fine], label='(2.5)',
                **EXACT_LINE)
    costs.semilogx(MANY_WEIGHTS, [path.J for path in many], 'o', markersize=4.5,
                   color=LINE_COLOURS[0], label='server')
    costs.semilogx(fine, [solve_scalar_finite_horizon(A, B, c, X0, [0.0], tf=TF).J for c in fine],
                   label='closed form', **EXACT_LINE)
    costs.axhline(limit.J, label='$x(t_f) = 0$', **THIN)
    label_axes(costs, 'cost', 'weight $c$', '$J$', legend='lower right')
    label_axes(states, 'state', 'time $t$ [s]', '$x^*(t)$')
    label_axes(inputs, 'input', 'time $t$ [s]', '$u^*(t)$ [1/s]')
    label_axes(ends, 'final state', 'weight $c$', '$x^*(t_f)$', legend='lower left')
    place_legend_below(figure, states, 3)
    figure.suptitle(f'$\\dot x = ax + bu$,  $a = {A:g}$ s$^{{-1}}$,  $b = {B:g}$,  '
                    f'$x(0) = {X0:g}$,  $t_f = {TF:g}$ s')
    return figure


NINE = {'a': 2.0, 'b': 0.5, 'x0': 4.0}
CURVES = tuple(product((0.1, 10.0), (0.5, 1.0, 10.0)))
LONG = 20.0  # [s] e^(-2 a LONG) is far below rounding


def exercise_2_9(desk: Desk) -> EntryResult:
    """Compute Exercise 2.9: the six curves and the infinite horizon."""
    a, b, x0 = NINE.values()
    paths = desk.solve_all([state_example_2_2(**NINE, tf=tf, c=c) for c, tf in CURVES])
    infinite = desk.solve(**state_example_2_2(**NINE, tf=LONG, c=None))
    refusal = desk.refuse({'A': [[a]], 'B': [[b]], 'Qx': [0.0], 'Qu': [1.0]},
                          'Qx = 0 and an unstable A')
    rows, distances = [], []
    for (c, tf), path in zip(CURVES, paths, strict=True):
        exact = solve_scalar_finite_horizon(a, b, c, x0, path.t, tf=tf)
        far = x0 * np.exp(-a * path.t)
        name = f'$c = {c:g}$, $t_f = {tf:g}$ s'
        rows.append(ComparedRow(f'$x*(t)$, {name}', path.x['x'], exact.x, 'Example 2.2',
                                relative=True))
        distances.append((np.abs(path.x['x'] - far).max(), np.abs(exact.x - far).max()))
        rows.append(ComparedRow(f'cost $J$, {name}', path.J, exact.J, '$½ P(t_0) x(t_0)^2$'))
    P, early = 2 * a / b**2, infinite.t < 5.0
    rows += [
        ComparedRow('infinite horizon: $x*(t)$', infinite.x['x'], x0 * np.exp(-a * infinite.t),
                    '$x(t_0) e^{-at}$'),
        ComparedRow('infinite horizon: $P = λ(t_0) / x(t_0)$', infinite.lam['x'][0] / x0, P,
                    '$2a/b^2$'),
        ComparedRow('infinite horizon: $-u(t)/x(t) = bP$ while $t < 5$ s',
                    -infinite.u['u'][early] / infinite.x['x'][early],
                    np.full(early.sum(), b * P), '$2a/b$'),
        ComparedRow('infinite horizon: cost $J$', infinite.J, P * x0**2 / 2, '$½ P x(t_0)^2$')]
    measured, wanted = zip(*distances, strict=True)
    c, tf = CURVES[int(np.argmin(measured))]
    rows += [
        ComparedRow('distance $max |x* - x*_∞|$ of each curve', measured, wanted,
                    'the closed forms', relative=True),
        ComparedRow('closest: its $c$ and $t_f$', [c, tf], CURVES[int(np.argmin(wanted))],
                    'the minimum of the closed forms')]
    return EntryResult(rows, _draw_2_9(paths, measured), (
        f'Closest to the infinite horizon: $c = {c:g}$, $t_f = {tf:g}$ s. The gain is that of the '
        'infinite horizon until a few $1/a$ before $t_f$. With a long horizon $x$ is close to 0 '
        'by then, and the larger $c$ keeps it closer. With a short horizon and a small $c$ the '
        'final state costs less than the input that would reduce it, and $x$ grows.',
        'Equation (2.5) is a difference of numbers of size $e^{at}$: at $t_f = 10$ s no digit of '
        '$x*(t_f)$ is correct in double precision. The reference is evaluated as a sum of terms '
        'of one sign.'),
        f'For the infinite horizon with $Q_x = 0$, `trajectory_server` reports: '
        f'“{refusal}”. '
        f'With the constraint $x({LONG:g}) = 0$, $P = {infinite.lam["x"][0] / x0:.9g}$.')


def _draw_2_9(paths: list[Trajectory], distances: Sequence[float]) -> Any:
    figure, ((short, long), (away, empty)) = create_panels(2, 2, 3.2)
    empty.remove()
    names = []
    for index, ((c, tf), path) in enumerate(zip(CURVES, paths, strict=False)):
        names.append(f'$c = {c:g}$, $t_f = {tf:g}$ s')
        for axes in (short, long):
            axes.plot(path.t, path.x['x'], label=names[-1], **get_line(index))
    t = np.linspace(0, 10, 1001)
    for axes, end in ((short, 1.05), (long, 10.0)):
        axes.plot(t[t <= end], NINE['x0'] * np.exp(-NINE['a'] * t[t <= end]),
                  label='infinite horizon', **EXACT)
    top = 1.3 * max(path.x['x'].max() for path in paths)
    short.set(xlim=(0, 1.05), yscale='log', ylim=(0.3, top))
    long.set(xlim=(0, 10.2), yscale='log', ylim=(1e-9, 1e3), yticks=[1e-8, 1e-4, 1])
    label_axes(short, 'the first second', 'time $t$ [s]', '$x^*(t)$')
    label_axes(long, 'ten seconds', 'time $t$ [s]', '$x^*(t)$')
    places = np.arange(len(CURVES))
    away.barh(places, distances, color=LINE_COLOURS[:len(CURVES)])
    away.set(xscale='log', xlim=(min(distances) / 10, 30), yticks=places)
    away.set_yticklabels([f'{c:g}, {tf:g} s' for c, tf in CURVES])
    away.invert_yaxis()
    away.axvline(min(distances), **THIN)
    label_axes(away, 'distance from $x^*_\\infty$', '$\\max_t |x^* - x^*_\\infty|$', '$c$, $t_f$')
    figure.legend(*short.get_legend_handles_labels(), loc='center', bbox_to_anchor=(0.78, 0.23))
    figure.suptitle('$\\dot x = ax + bu$,  $a = 2$ s$^{-1}$,  $b = 0.5$,  $x(t_0) = 4$')
    return figure


EXAMPLE_2_2 = GalleryEntry(
    'example-2.2', 'Scalar linear system', 'Example 2.2, equations (2.3) to (2.5)', (
        "Minimise $J = ½ ∫ u^2 dt + ½ c x(t_f)^2$ for $x' = ax + bu$, $x(t_0)$ and $t_f$ given. "
        'The maximum principle gives $u* = -bλ$ with $λ(t) = c x*(t_f) e^{a(t_f - t)}$, and from '
        'it the input (2.4) and the state (2.5). What is the limit of $x*(t_f)$ for $c → ∞$?',),
    example_2_2)
EXERCISE_2_9 = GalleryEntry(
    'exercise-2.9', 'Finite and infinite horizon', 'Exercise 2.9', (
        'Example 2.2 with $a = 2$, $b = 0.5$, $x(t_0) = 4$: the optimal states for $c = 0.1, 10$ '
        'and $t_f = 0.5, 1, 10$ s, compared with the infinite horizon with $x(∞) = 0$, whose '
        'optimum is the feedback $u = -bPx$. Which finite horizon is closest to it, and why?',),
    exercise_2_9,
    'With $Q_x = 0$ the pair $(A, H)$ is not detectable: Theorem 2.2 does not apply, and $P = 0$ '
    'solves the algebraic Riccati equation too. $P = 2a/b^2$ is right only because $x(∞) = 0$ is '
    'imposed. And with the factor ½ in $J$ the minimum cost is $½ P x_0^2$, in Theorem 2.2 it is '
    '$x_0^T P x_0$.')
