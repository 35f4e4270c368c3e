# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Minimum time: Example 2.3 (bang-bang control) and Example 2.6 (nonholonomic integrator)."""

from math import pi, sqrt
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import get_line, LINE_COLOURS, THIN
from obc_ros.book.entry import (
    ComparedRow,
    create_panels,
    EntryResult,
    GalleryEntry,
    label_axes,
    place_legend_below,
)
from obc_ros.book.page import format_scientific
from obc_ros.book.runner import Desk, Trajectory
from obc_ros.core.numerics.arrays import Array
from scipy.interpolate import CubicHermiteSpline

STARTS = tuple((r * np.cos(angle), r * np.sin(angle))
               for r in (1.0, 2.5) for angle in np.arange(12) * pi / 6 + 0.2)
# Starts of the oscillator: first input, number of switches, lengths of the first and last arc.
ARCS = ((1, 0, 0.0, 2.0), (-1, 1, 1.0, 2.5), (1, 1, 2.0, 0.7), (-1, 2, 0.5, 1.5),
        (1, 2, 2.8, 2.9), (-1, 3, 1.7, 0.4), (1, 4, 1.2, 2.2), (-1, 5, 2.4, 1.1))
FREE = {'free': True, 'lower': 0.01, 'upper': 50}
SAMPLED = 0.02  # [s] period of the feedback law


def solve_double_integrator(x: float, v: float) -> tuple[float, float, float]:
    """Return the minimum time to the origin, the switching time, and the input after it."""
    side = 1.0 if x + v * abs(v) / 2 > 0 else -1.0
    root = sqrt(side * x + v * v / 2)
    return side * v + 2 * root, side * v + root, side


def start_backwards(first: int, switches: int, begin: float, end: float) -> tuple[Array, Array]:
    """
    Return the state from which given arcs lead to the origin, and the times at their ends.

    All arcs but the first and the last take half a period. Backwards in time the state rotates
    counter-clockwise about (u, 0).
    """
    lengths = [end] + [pi] * (switches - 1) + ([begin] if switches else [])
    x, u = np.zeros(2), first * (-1.0)**switches
    for length in lengths:
        c, s = np.cos(length), np.sin(length)
        x = np.array([u, 0]) + np.array([[c, -s], [s, c]]) @ (x - [u, 0])
        u = -u
    return x, np.cumsum(lengths[::-1])


def example_2_3(desk: Desk) -> EntryResult:
    """Compute Example 2.3 for two systems and many initial states."""
    common = {'running_cost': '1', 'terminal_constraints': ['x1', 'x2'],
              'input_bounds': {'u': [-1, 1]}, 'final_time': FREE}
    plain = desk.solve_all([{
        'system': 'double_integrator', 'initial_state': {'x1': x, 'x2': v}, **common}
        for x, v in STARTS])
    known = [start_backwards(*arcs) for arcs in ARCS]
    turning = desk.solve_all([{
        'states': ['x1', 'x2'], 'inputs': ['u'], 'dynamics': {'x1': 'x2', 'x2': '-x1 + u'},
        'initial_state': {'x1': float(x), 'x2': float(v)}, **common} for (x, v), _ in known])
    exact = np.array([solve_double_integrator(x, v) for x, v in STARTS])
    at = np.array([[np.interp(path.switching_times[0], path.t, path.x[name])
                    for name in ('x1', 'x2')] for path in plain])
    v = np.array(STARTS)[:, 1] - exact[:, 2] * exact[:, 1]
    paths, switching = [*plain, *turning], [*plain, *turning[1:]]
    lam = np.concatenate(_costates(switching, exact, known))
    away = np.abs(lam) > 1e-6
    rows = [
        ComparedRow(f'double integrator, {len(STARTS)} starts: minimum time $T$ [s]',
                    [path.T for path in plain], exact[:, 0], '$± v_0 + 2 √(± x_0 + v_0^2/2)$'),
        ComparedRow('double integrator: the switching time [s]',
                    [path.switching_times[0] for path in plain], exact[:, 1],
                    '$± v_0 + √(± x_0 + v_0^2/2)$'),
        ComparedRow('double integrator: $x$, $v$ at the switch', at,
                    np.column_stack([-v * np.abs(v) / 2, v]), 'the switching curve $x = -½ v|v|$'),
        ComparedRow(f'oscillator, {len(ARCS)} starts: minimum time $T$ [s]',
                    [path.T for path in turning],
                    [times[-1] for _, times in known], 'arcs joined backwards from the origin'),
        ComparedRow('oscillator: all switching times [s]',
                    np.concatenate([path.switching_times for path in turning]),
                    np.concatenate([times[:-1] for _, times in known]), 'the same arcs'),
        ComparedRow('$λ^T B$ along the paths that switch',
                    np.concatenate([path.lam['x2'] for path in switching]), lam,
                    'a line, a sine; 0 at the switches, $-u$ at $T$'),
        ComparedRow('$u = -sgn(λ^T B)$ along them',
                    np.concatenate([path.u['u'] for path in switching])[away], -np.sign(lam[away]),
                    'Example 2.3'),
        ComparedRow('$u$ along the one that does not switch', turning[0].u['u'],
                    np.full(turning[0].t.size, ARCS[0][0]),
                    'its start is on an arc to the origin'),
        ComparedRow('$H$ along all paths', np.concatenate([path.hamiltonian for path in paths]),
                    np.zeros(sum(path.t.size for path in paths)), '$H = 0$, as $T$ is free')]
    return EntryResult(rows, _draw_2_3(plain, turning), (
        'Dots: the initial states. The input is minus the sign of the switching function $λ^T B$; '
        'it changes sign on the switching curve (black). The undamped oscillator switches every '
        'half period.',
        'Second figure: the feedback law $u = -sgn(x_1 + c x_2|x_2|)$ of the double integrator, '
        f'computed {1 / SAMPLED:g} times a second. $c = ½$ is the switching curve: one switch, '
        'then a small cycle at the origin, which remains for any sampling period or delay. With '
        '$c = 0.3$ the path crosses the curve and switches ever more often. With $c = 0.8$, or '
        'with a gain of the input that is not the expected one, it slides along the curve and $u$ '
        'switches again and again: chattering.'),
        more={'feedback': _draw_feedback()})


def _costates(paths: list[Trajectory], plain: Array, known: list[tuple[Array, Array]]
              ) -> list[Array]:
    """Return the costate of x2 on each path: a line, or a sine for the oscillator."""
    found = [-last * (path.t - switch) / (T - switch)
             for (T, switch, last), path in zip(plain, paths, strict=False)]
    for (first, switches, *_), (_, times), path in zip(
            ARCS[1:], known[1:], paths[len(plain):], strict=True):
        *_, switch, T = times
        found.append(-first * (-1)**switches * np.sin(path.t - switch) / np.sin(T - switch))
    return found


def _draw_2_3(plain: list[Trajectory], turning: list[Trajectory]) -> Figure:
    figure, ((left, middle, right),) = create_panels(1, 3, 3.7, width_ratios=(1, 1, 1.1))
    for axes, paths in ((left, plain), (middle, turning)):
        for path in paths:
            for sign, line in ((-1, get_line(0)), (1, get_line(1))):
                x1, x2, u = smooth(path)
                part = np.where(u * sign > 0, 1.0, np.nan)
                axes.plot(x1 * part, x2 * part, **line | {'linewidth': 1.1})
            axes.plot(path.x['x1'][0], path.x['x2'][0], '.', color='black', markersize=4)
    for index, text in enumerate(('$u = -1$', '$u = +1$')):
        left.plot([], [], label=text, **get_line(index))
    v = np.linspace(-2.6, 2.6, 201)
    left.plot(-v * np.abs(v) / 2, v, color='black', linewidth=2.4, label='switching curve')
    left.set(xlim=(-4, 4), ylim=(-3.2, 3.2))
    angle = np.linspace(0, pi, 100)
    for k in range(5):
        for side in (1, -1):
            middle.plot(side * (2 * k + 1 + np.cos(angle)), -side * np.sin(angle), color='black',
                        linewidth=2.4)
    middle.set(aspect='equal', xlim=(-10, 10), ylim=(-11, 11), xticks=[-8, -4, 0, 4, 8],
               yticks=[-8, -4, 0, 4, 8])
    label_axes(left, 'double integrator', '$x_1$ [m]', '$x_2$ [m/s]')
    label_axes(middle, 'oscillator $\\ddot x + x = u$', '$x_1$ [m]', '$x_2$ [m/s]')
    path = turning[-1]
    right.plot(path.t, path.u['u'], color=LINE_COLOURS[2], drawstyle='steps-post', label='$u(t)$')
    right.plot(path.t, path.lam['x2'], label='$\\lambda^T B$', **get_line(1))
    right.plot(path.t, path.hamiltonian, label='$H$', **get_line(3))
    for time in path.switching_times:
        right.axvline(time, **THIN)
    label_axes(right, 'five switches', 'time $t$ [s]', '$u$, $\\lambda^T B$, $H$')
    right.set(xlim=(0, path.T), ylim=(-1.3, 1.9))
    right.legend(loc='upper center', ncols=3, columnspacing=0.6, handlelength=1.3,
                 handletextpad=0.3)
    place_legend_below(figure, left, 3)
    return figure


def _draw_feedback() -> Figure:
    """Draw paths and inputs of u = -sgn(x1 + c x2 |x2|), sampled, for three c."""
    figure, ((plane, inputs),) = create_panels(1, 2, 3.9)
    t = np.arange(0.0, 6.0, SAMPLED)
    for index, c in enumerate((0.5, 0.3, 0.8)):
        x, u = np.empty((len(t), 2)), np.empty(len(t))
        x1, x2 = 2.0, 0.0
        for k in range(len(t)):
            x[k], u[k] = (x1, x2), -np.sign(x1 + c * x2 * abs(x2))
            x1, x2 = x1 + SAMPLED * x2 + SAMPLED**2 / 2 * u[k], x2 + SAMPLED * u[k]
        plane.plot(x[:, 0], x[:, 1], label=f'$c = {c:g}$', **get_line(index))
        inputs.plot(t, u - 3 * index, color=get_line(index)['color'], linewidth=1.2,
                    drawstyle='steps-post')
        inputs.annotate(f'$c = {c:g}$', (0.05, 1.25 - 3 * index), color=get_line(index)['color'])
    v = np.linspace(-1.7, 0.7, 101)
    plane.plot(-v * np.abs(v) / 2, v, color='black', linewidth=1.0, label='switching curve')
    label_axes(plane, 'feedback on another curve', '$x_1$ [m]', '$x_2$ [m/s]',
               legend='upper right')
    label_axes(inputs, 'inputs', 'time $t$ [s]', '$u$ from -1 to 1, shifted')
    inputs.set(xlim=(0, 6), ylim=(-7.4, 2.1), yticks=[-7, -6, -5, -4, -3, -2, -1, 0, 1],
               yticklabels=['$-1$', '', '1'] * 3)
    return figure


def smooth(path: Trajectory) -> tuple[Array, Array, Array]:
    """Return x1, x2 and u at many times, from cubics with the values x1 and the slopes x2."""
    knots, index = np.unique(path.t, return_index=True)
    spline = CubicHermiteSpline(knots, path.x['x1'][index], path.x['x2'][index])
    t = np.unique(np.concatenate([np.linspace(0, path.T, 400), path.switching_times,
                                  path.switching_times - 1e-9]))
    return spline(t), spline(t, 1), path.u['u'][np.searchsorted(path.t, t, 'right') - 1]


LINES = (0.5, 2.0, 3.0)
LOOPS = ((1.0, 1.0), (2.0, 0.5), (0.5, 1.5))  # a and d of `walk_diamond`
AREAS = (0.5, 2.0)


def walk_diamond(a: float, d: float) -> tuple[float, float, list[float]]:
    """
    Return x3(T), T and the switching times of the path along a diamond to (a, 0, x3).

    With |u1|, |u2| <= 1 a curve of duration T encloses the largest area with the x1 axis if it
    follows a diamond with sides in the directions (1, 1) and (1, -1), by the isoperimetric
    inequality of the norm max(|u1|, |u2|): back by d, up to the top, down, and back by d.
    """
    r = d + a / 2
    return 2 * r * r - a * a / 4, 2 * (r + d), [d, d + r, d + 2 * r]


def compute_diamond_costates(a: float, d: float, t: Array) -> Array:
    """
    Return the costates, shape (N, 3), on the path along a diamond.

    lambda_1 + lambda_3 x2 is 0 at x2 = d, where u1 switches. lambda_2 is 0 at x1 = a/2, where u2
    switches. H = 0 determines the scale.
    """
    r = d + a / 2
    x1 = np.interp(t, [0, d, d + 2 * r, 2 * (r + d)], [0, -d, 2 * r - d, a])
    return np.column_stack([np.full(t.size, d), x1 - a / 2, np.full(t.size, -1)]) / r


def example_2_6(desk: Desk) -> EntryResult:
    """Compute Example 2.6: the singular line, and paths with switches."""
    lines = desk.solve_all([_nonholonomic(rho, 0.0) for rho in LINES])
    exact = [walk_diamond(a, d) for a, d in LOOPS]
    loops = desk.solve_all([
        _nonholonomic(a, x3) for (a, _), (x3, _, _) in zip(LOOPS, exact, strict=True)])
    closed = desk.solve_all([_nonholonomic(0.0, area) for area in AREAS], show=0)
    rows = []
    for rho, path in zip(LINES, lines, strict=True):
        rows += [
            ComparedRow(f'line of $ρ = {rho:g}$: minimum time $T$ [s]', path.T, rho, '$ρ$'),
            ComparedRow(f'line of $ρ = {rho:g}$: $u_1(t)$', path.u['u1'], np.ones(path.t.size),
                        '1'),
            ComparedRow(f'line of $ρ = {rho:g}$: costates',
                        np.stack([path.lam[name] for name in ('x1', 'x2', 'x3')]),
                        np.outer([-1.0, 0.0, 0.0], np.ones(path.t.size)), '$(-1, 0, 0)$')]
    for (a, d), (x3, T, times), path in zip(LOOPS, exact, loops, strict=True):
        rows += [
            ComparedRow(f'to $({a:g}, 0, {x3:g})$: minimum time $T$ [s]', path.T, T,
                        'isoperimetric inequality'),
            ComparedRow(f'to $({a:g}, 0, {x3:g})$: switching times [s]', path.switching_times,
                        times, 'corners of the diamond'),
            ComparedRow(f'to $({a:g}, 0, {x3:g})$: costates',
                        np.column_stack([path.lam[name] for name in ('x1', 'x2', 'x3')]),
                        compute_diamond_costates(a, d, path.t),
                        '$(d, x_1 - a/2, -1) / (d + a/2)$; $d$ is the distance driven back')]
    shown, paths = loops[0], [*lines, *loops, *closed]
    rows += [
        ComparedRow('back to $(0, 0, x_3)$: minimum time $T$ [s]', [path.T for path in closed],
                    [2 * sqrt(2 * area) for area in AREAS], '$2 √(2|x_3|)$'),
        ComparedRow('$H$ along all paths', np.concatenate([p.hamiltonian for p in paths]),
                    np.zeros(sum(p.t.size for p in paths)), '$H = 0$, as $T$ is free')]
    printed = _printed(shown)
    off = float(np.abs(compute_diamond_costates(*LOOPS[0], shown.t)[:, 1] - shown.lam['x2']).max())
    return EntryResult(rows, _draw_2_6(lines[1], shown, printed), (
        'On the line $λ_2 ≡ λ_3 ≡ 0$: $H$ does not depend on $u_2$, the extremal is singular in '
        '$u_2$. The minimum time $ρ$ requires only $u_1 ≡ 1$: every $x_2(t)$ with zero mean that '
        'starts and ends at 0, such as the grey one, takes the same time as $u_2 = 0$.',
        'The path to (1, 0, 4.25) follows a part of a diamond, the curve that encloses the '
        'largest area in a given time. The inputs switch one after the other. Dashed grey lines: '
        'the switching times.'),
        f'On the path to (1, 0, 4.25), $λ_2$ integrated by the printed equation is off by up to '
        f'{np.abs(printed - shown.lam["x2"]).max():.2g}; by the corrected one by '
        f'{format_scientific(f"{off:.0e}")}.')


def _nonholonomic(x1: float, x3: float) -> dict[str, Any]:
    return {'system': 'nonholonomic_integrator', 'running_cost': '1', 'final_time': FREE,
            'initial_state': {'x1': 0, 'x2': 0, 'x3': 0},
            'terminal_constraints': [f'x1 - {x1!r}', 'x2', f'x3 - {x3!r}']}


def _printed(path: Trajectory) -> Array:
    """Return lambda_2 by the printed equation, lambda_2' = lambda_3 x_2."""
    slope = path.lam['x3'] * path.x['x2']
    steps = np.diff(path.t) * (slope[1:] + slope[:-1]) / 2
    costate: Array = path.lam['x2'][0] + np.concatenate([[0.0], np.cumsum(steps)])
    return costate


def _draw_2_6(line: Trajectory, loop: Trajectory, printed: Array) -> Figure:
    figure, ((plane, third), (first, second), (costates, empty)) = create_panels(3, 2, 2.9)
    empty.remove()
    s = np.linspace(0, 2, 201)
    plane.plot(s, np.interp(s, [0, 0.5, 1.5, 2], [0, 0.5, -0.5, 0]), color='0.6',
               label='the same time, to (2, 0, 0)')
    plane.plot(line.x['x1'], line.x['x2'], label='to (2, 0, 0)', **get_line(1))
    plane.plot(loop.x['x1'], loop.x['x2'], label='to (1, 0, 4.25)', **get_line(0))
    for k in np.searchsorted(loop.t, [0.5, 1.75, 3.25, 4.5]):
        plane.annotate('', (loop.x['x1'][k], loop.x['x2'][k]),
                       (loop.x['x1'][k - 1], loop.x['x2'][k - 1]),
                       arrowprops={'arrowstyle': '-|>', 'color': LINE_COLOURS[0]})
    plane.set(aspect='equal')
    plane.set(xticks=[-1, 0, 1, 2], yticks=[0, 1, 2])
    label_axes(plane, 'paths in the plane', '$x_1$', '$x_2$')
    for index, path in ((1, line), (0, loop)):
        third.plot(path.t, path.x['x3'], **get_line(index))
        for axes, name in ((first, 'u1'), (second, 'u2')):
            axes.plot(path.t, path.u[name], drawstyle='steps-post', **get_line(index))
    label_axes(third, 'third state', 'time $t$ [s]', '$x_3$')
    second.axvspan(0, line.T, color=LINE_COLOURS[1], alpha=0.15, zorder=1)
    second.text(line.T / 2, 0.12, 'singular arc', ha='center', color=LINE_COLOURS[1])
    for index, axes in ((1, first), (2, second)):
        axes.set(ylim=(-1.3, 1.3), yticks=[-1, 0, 1])
        label_axes(axes, f'input $u_{index}$', 'time $t$ [s]', f'$u_{index}$')
    for index, name in enumerate(('x1', 'x2', 'x3')):
        costates.plot(loop.t, loop.lam[name], label=f'$\\lambda_{index + 1}$ to (1, 0, 4.25)',
                      **get_line(2 + index))
    costates.plot(loop.t, printed, '--', color='grey', label='$\\lambda_2$ as printed (misprint)')
    label_axes(costates, 'costates to (1, 0, 4.25)', 'time $t$ [s]', '$\\lambda$')
    for axes in (third, first, second, costates):
        for time in loop.switching_times:
            axes.axvline(time, **THIN)
        axes.set_xlim(0, loop.T)
    costates.plot([], [], label='a switch to (1, 0, 4.25)', **THIN)
    handles = [axes.get_legend_handles_labels() for axes in (plane, costates)]
    figure.legend(handles[0][0] + handles[1][0], handles[0][1] + handles[1][1], loc='center',
                  bbox_to_anchor=(0.77, 0.17))
    return figure


EXAMPLE_2_3 = GalleryEntry(
    'example-2.3', 'Bang-bang control', 'Example 2.3', (
        "Bring $x' = Ax + Bu$, $|u| ≤ 1$, to the origin in minimum time. $H = 1 + λ^T(Ax + Bu)$ "
        'is minimal for $u = -sgn(λ^T B)$: the input is always at one of its limits. Here for the '
        'double integrator from 24 initial states and for an undamped oscillator from 8.',),
    example_2_3,
    'The example uses $H = 0$ along the path, which follows from the free final time; Theorem 2.1 '
    'does not list this condition.')
EXAMPLE_2_6 = GalleryEntry(
    'example-2.6', 'Nonholonomic integrator', 'Example 2.6, equation (2.10)', (
        "Minimum time for $x_1' = u_1$, $x_2' = u_2$, $x_3' = x_2 u_1$, $|u_i| ≤ 1$. From the "
        'origin to $(ρ, 0, 0)$ the optimal path is a straight line, on which the maximum '
        'principle does not determine one input; on paths to other points the inputs switch.',),
    example_2_6,
    "From $H = 1 + λ_1 u_1 + λ_2 u_2 + λ_3 x_2 u_1$ follow $λ_2' = -λ_3 u_1$ (printed: "
    "$λ_2' = λ_3 x_2$) and $u_1 = -sgn(λ_1 + λ_3 x_2)$ (printed with $u_1$ on both sides). The "
    'extremal on the line is not abnormal: with $λ = (-1, 0, 0)$ the cost has the multiplier 1 '
    'and $H = 0$. It is singular in $u_2$.')
