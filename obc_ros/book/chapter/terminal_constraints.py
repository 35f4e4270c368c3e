# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Section 2.2: full and partial terminal constraints, and a terminal cost."""

from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import EXACT, get_line, THIN
from obc_ros.book.entry import (
    ComparedRow,
    create_panels,
    draw_arrow,
    EntryResult,
    GalleryEntry,
    label_axes,
    place_legend_below,
)
from obc_ros.book.runner import Desk, Trajectory
from obc_ros.core.numerics.arrays import Array

T = 1.0  # [s]
WEIGHT = 12.0  # of the terminal cost
LENGTH = 0.35  # of the arrows of lambda(T)


@dataclass(frozen=True, eq=False)
class TerminalCase:
    """
    A terminal condition on x1' = x2, x2' = u from x(0) = 0, and its closed form.

    :ivar name, text: for the table, and for the figure.
    :ivar constraints: psi.
    :ivar nu: multipliers of psi.
    :ivar lam: lambda(T).
    :ivar J: minimum cost.
    """

    name: str
    text: str
    constraints: tuple[str, ...]
    nu: tuple[float, ...]
    lam: tuple[float, float]
    J: float

    def evaluate(self, t: Array) -> tuple[Array, Array, Array]:
        """Return states (N, 2), costates (N, 2) and u (N,) from lambda(T)."""
        p, q = self.lam
        # lambda_1 = p and lambda_2 = q + p (T - t), u = -lambda_2.
        u = -q - p * (T - t)
        speed = -(q + p * T) * t + p * t**2 / 2
        place = -(q + p * T) * t**2 / 2 + p * t**3 / 6
        return (np.column_stack([place, speed]), np.column_stack([np.full(t.shape, p), -u]), u)


FORCE = 3 * WEIGHT / (3 + WEIGHT)  # -lambda_1 with the terminal cost
CASES = (
    TerminalCase('full, $ψ = (x_1 - 1, x_2)$', r'full: $x_1 = 1$, $x_2 = 0$',
                 ('x1 - 1', 'x2'), (-12.0, 6.0), (-12.0, 6.0), 6.0),
    TerminalCase('partial, $ψ = x_1 - 1$', r'partial: $x_1 = 1$',
                 ('x1 - 1',), (-3.0,), (-3.0, 0.0), 1.5),
    TerminalCase('partial, $ψ = x_1 + x_2 - 2$', r'partial: $x_1 + x_2 = 2$',
                 ('x1 + x2 - 2',), (-6 / 7,), (-6 / 7, -6 / 7), 6 / 7),
    TerminalCase(f'none, $V = {WEIGHT / 2:g} (x_1 - 1)^2$',
                 f'none: $V = {WEIGHT / 2:g}\\,(x_1 - 1)^2$', (), (), (-FORCE, 0.0), FORCE / 2))


def state_reach_problem(case: TerminalCase) -> dict[str, Any]:
    """Return the problem with a terminal condition."""
    end = {'terminal_constraints': list(case.constraints)} if case.constraints else {
        'terminal_cost': f'{WEIGHT / 2!r}*(x1 - 1)**2'}
    return {'states': ['x1', 'x2'], 'inputs': ['u'], 'dynamics': {'x1': 'x2', 'x2': 'u'},
            'running_cost': 'u**2/2', 'initial_state': {'x1': 0, 'x2': 0}, **end,
            'final_time': {'free': False, 'value': T}}


def section_2_2(desk: Desk) -> EntryResult:
    """Compare states, costates, multipliers and costs of four terminal conditions."""
    paths = desk.solve_all([state_reach_problem(case) for case in CASES], method='indirect',
                           show=len(CASES))
    rows = []
    for case, path in zip(CASES, paths, strict=True):
        x, lam, u = case.evaluate(path.t)
        rows += [
            ComparedRow(f'{case.name}: $x*(t)$', np.stack([*path.x.values()], axis=1), x,
                        'cubic polynomials'),
            ComparedRow(f'{case.name}: $u*(t)$', path.u['u'], u, '$-λ_2(t)$, a line'),
            ComparedRow(f'{case.name}: $λ(t)$', np.stack([*path.lam.values()], axis=1), lam,
                        '$λ_1(T)$, $λ_2(T) + λ_1(T) (T - t)$'),
            ComparedRow(f'{case.name}: $λ(T)$', [each[-1] for each in path.lam.values()],
                        case.lam, '$∂V/∂x + ν^T ∂ψ/∂x$'),
            ComparedRow(f'{case.name}: cost $J$', path.J, case.J, 'closed form')]
        if case.nu:
            rows.append(ComparedRow(f'{case.name}: $ν$', path.nu, case.nu, 'closed form'))
    return EntryResult(rows, _draw_ends(paths), (
        'Top left: the four paths in the plane of the states, their terminal sets (thin) and '
        '$λ(T)$ '
        '(arrows, scaled to one length). $λ(T)$ is normal to the terminal set. A point has every '
        'direction as a normal: both components of $λ(T)$ are free. On the line $x_1 = 1$ the '
        'final speed is free, so that $λ_2(T) = 0$. On the oblique line both components of '
        '$λ(T)$ are equal.',
        'Below: $λ_1$ is constant and $λ_2$ is a line, in every case. With '
        '$q$ constraints there are $q$ multipliers $ν$ and $n - q$ conditions on $λ(T)$: 0 with '
        'the full constraint, 1 with each partial one, 2 without a constraint. Each condition '
        'that is removed lowers the cost: 6, 1.5, and 1.2 with the terminal cost, which does not '
        'reach $x_1 = 1$. For $V = ½c (x_1 - 1)^2$, $λ_1 = -3c/(3 + c)$ tends to the multiplier '
        '-3 as $c$ grows.'))


def _draw_ends(paths: list[Trajectory]) -> Figure:
    figure, ((plane, inputs), (first, second)) = create_panels(2, 2)
    for index, (case, path) in enumerate(zip(CASES, paths, strict=True)):
        x, lam, u = case.evaluate(path.t)
        x1, x2 = path.x.values()
        line = get_line(index)
        plane.plot(x1, x2, label=case.text, **line)
        plane.plot(x1[-1], x2[-1], 'o', color=line['color'], zorder=6)
        end = np.array([each[-1] for each in path.lam.values()])
        draw_arrow(plane, (x1[-1], x2[-1]), LENGTH * end / np.hypot(*end), color=line['color'])
        inputs.plot(path.t, path.u['u'], **line)
        inputs.plot(path.t, u, **EXACT)
        for axes, values, exact in zip((first, second), path.lam.values(), lam.T, strict=True):
            axes.plot(path.t, values, **line)
            axes.plot(path.t, exact, **EXACT)
            axes.plot(T, values[-1], 'o', color=line['color'], clip_on=False, zorder=6)
    _draw_sets(plane)
    inputs.plot([], [], label='closed form', **EXACT)
    for axes in (first, second, inputs):
        axes.axhline(0, **THIN)
        axes.set_xlim(0, T)
    label_axes(plane, 'paths, terminal sets, $\\lambda(T)$', '$x_1$ [m]', '$x_2$ [m/s]')
    label_axes(first, 'costate $\\lambda_1$', 'time $t$ [s]', '$\\lambda_1(t)$')
    label_axes(second, 'costate $\\lambda_2$', 'time $t$ [s]', '$\\lambda_2(t)$')
    label_axes(inputs, 'input $u = -\\lambda_2$', 'time $t$ [s]', '$u^*$ [m/s$^2$]', legend=True)
    place_legend_below(figure, plane, 2)
    return figure


def _draw_sets(plane: Axes) -> None:
    line = np.array([0.55, 1.45])
    plane.axvline(1.0, **THIN)
    plane.plot(line, 2 - line, **THIN)
    plane.set_aspect('equal', adjustable='datalim')  # shows that lambda(T) is normal


SECTION_2_2 = GalleryEntry(
    'section-2.2', 'Full and partial terminal constraints', 'Section 2.2, terminal constraints', (
        "$x_1' = x_2$, $x_2' = u$ from rest at 0, $J = ½ ∫_0^1 u^2 dt$, with four terminal "
        'conditions: the full constraint $x(1) = (1, 0)$; the partial constraints $x_1(1) = 1$ '
        'and $x_1(1) + x_2(1) = 2$; no constraint, but the terminal cost '
        f'$V = {WEIGHT / 2:g} (x_1(1) - 1)^2$. What do they leave free in $λ(T) = ∂V/∂x + '
        'ν^T ∂ψ/∂x$?',),
    section_2_2)
