# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Theorem 2.1 on a nonlinear example, and the terminal constraints of Section 2.2."""

from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import EXACT, get_line, LINE_COLOURS, THIN
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
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

LIMIT, TARGET, T = 0.6, 1.0, 3.0  # |u|, theta(T) [rad], [s]


def minimize_hamiltonian(lam: Any) -> Any:
    """Return the input that minimises H over |u| <= LIMIT."""
    return np.clip(-lam, -LIMIT, LIMIT)


def theorem_2_1(desk: Desk) -> EntryResult:
    """Compare the solution of a pendulum's problem with every condition of Theorem 2.1."""
    path = desk.solve(
        states=['theta', 'omega'], inputs=['u'],
        dynamics={'theta': 'omega', 'omega': '-sin(theta) + u'},
        running_cost='(theta**2 + u**2)/2', terminal_cost='2*omega**2',
        initial_state={'theta': 0, 'omega': 0}, terminal_constraints=[f'theta - {TARGET}'],
        input_bounds={'u': [-LIMIT, LIMIT]}, final_time={'free': False, 'value': T},
        method='indirect')
    theta, omega, lam1, lam2, J = shoot(path.t)
    nu = path.nu[0]
    grid = np.linspace(-LIMIT, LIMIT, 241)
    H = compute_hamiltonian(path, grid[:, None])
    least = compute_hamiltonian(path, minimize_hamiltonian(path.lam['omega']))
    first = minimize_hamiltonian(lam2[0])  # at x(0) = 0
    H0 = first**2 / 2 + lam2[0] * first
    rows = [
        ComparedRow("$x' = (∂H/∂λ)^T$: $θ*(t)$ [rad]", path.x['theta'], theta, 'shooting'),
        ComparedRow("$x' = (∂H/∂λ)^T$: $ω*(t)$ [rad/s]", path.x['omega'], omega, 'shooting'),
        ComparedRow("$-λ' = (∂H/∂x)^T$: $λ_1(t)$", path.lam['theta'], lam1, 'shooting'),
        ComparedRow("$-λ' = (∂H/∂x)^T$: $λ_2(t)$", path.lam['omega'], lam2, 'shooting'),
        ComparedRow('$u*(t)$ [rad/s²]', path.u['u'], minimize_hamiltonian(lam2), 'shooting'),
        ComparedRow('$x(0)$ given', [path.x['theta'][0], path.x['omega'][0]], [0.0, 0.0], '0'),
        ComparedRow('$ψ(x(T)) = θ(T) - 1$ [rad]', path.x['theta'][-1] - TARGET, 0.0, '0'),
        ComparedRow('$λ(T) = ∂V/∂x + ν^T ∂ψ/∂x$',
                    [path.lam['theta'][-1], path.lam['omega'][-1]], [lam1[-1], 4 * omega[-1]],
                    '$(ν, 4ω(T))$, shooting'),
        ComparedRow('multiplier $ν$', nu, lam1[-1], 'shooting'),
        ComparedRow('$H(x*, u*, λ*) - min_{u ∈ Ω} H$',
                    compute_hamiltonian(path, path.u['u']) - least,
                    np.zeros(path.t.size), '0; $u*$ is $-λ_2$ within $Ω$'),
        ComparedRow('$min_{u ∈ Ω} H$ on a grid is not below it',
                    np.minimum(H.min(axis=0) - least, 0),
                    np.zeros(path.t.size), '241 inputs at each time'),
        ComparedRow('$H$ along the path', least, np.full(path.t.size, H0),
                    'its value at $t = 0$, shooting'),
        ComparedRow('cost $J$', path.J, J, 'shooting')]
    return EntryResult(rows, _draw(path, (theta, omega, lam1, lam2), grid, H - least), (
        'Bottom right: the square root of the excess of $H$ for every other input, at each time. '
        'The optimal input minimises $H$; where the minimiser is outside $Ω$, it is at the bound '
        'of $Ω$. Circles: the two-point boundary value problem, solved by shooting without '
        '`trajectory_server`.',
        f'Certificate of the solution: {path.verdict}.'))


def compute_hamiltonian(path: Trajectory, u: Array) -> Array:
    """Return H = L + lambda'f along a path, with the inputs u."""
    theta, omega = path.x['theta'], path.x['omega']
    H: Array = ((theta**2 + u**2) / 2 + path.lam['theta'] * omega
                + path.lam['omega'] * (u - np.sin(theta)))
    return H


def shoot(t: Array) -> tuple[Array, Array, Array, Array, float]:
    """Return theta, omega, lambda_1, lambda_2 at times, and J, without the server."""
    def slope(_: float, y: Array) -> list[Any]:
        theta, omega, lam1, lam2, _ = y
        u = minimize_hamiltonian(lam2)
        return [omega, u - np.sin(theta), lam2 * np.cos(theta) - theta, -lam1,
                (theta**2 + u**2) / 2]

    def path(lam0: Array, times: Array | None = None) -> Any:
        return solve_ivp(slope, (0, T), [0.0, 0.0, *lam0, 0.0], 'DOP853', times, rtol=1e-11,
                         atol=1e-12, max_step=0.02)

    def miss(lam0: Array) -> list[float]:
        theta, omega, _, lam2, _ = path(lam0).y[:, -1]
        return [theta - TARGET, lam2 - 4 * omega]

    lam0 = fsolve(miss, [1.0, 0.0], xtol=1e-12)
    theta, omega, lam1, lam2, J = path(lam0, np.clip(t, 0, T)).y
    return theta, omega, lam1, lam2, float(J[-1] + 2 * omega[-1]**2)


def _draw(path: Trajectory, exact: tuple[Array, ...], grid: Array, valley: Array) -> Figure:
    figure, ((states, costates), (inputs, above)) = create_panels(2, 2, 3.2)
    for axes, pairs, values, names in (
            (states, path.x, exact[:2], (r'$\theta$', r'$\omega$')),
            (costates, path.lam, exact[2:], (r'$\lambda_1$', r'$\lambda_2$'))):
        for index, (line, dots) in enumerate(zip(pairs.values(), values, strict=True)):
            axes.plot(path.t, line, label=names[index], **get_line(index))
            axes.plot(path.t, dots, **EXACT)
        axes.plot([], [], label='shooting', **EXACT)
    states.plot(T, TARGET, 'o', color='black', clip_on=False)
    states.annotate(r'$\psi = \theta(T) - 1 = 0$', (T, TARGET), (-30, -3), ha='right',
                    textcoords='offset points')
    costates.plot([T, T], [path.nu[0], 4 * path.x['omega'][-1]], 'o', color='black', clip_on=False)
    costates.annotate(r'$\lambda_1(T) = \nu$', (T, path.nu[0]), (-30, 2), ha='right',
                      textcoords='offset points')
    costates.annotate(r'$\lambda_2(T) = \partial V/\partial\omega$',
                      (T, 4 * path.x['omega'][-1]), (-8, 9), ha='right',
                      textcoords='offset points')
    inputs.plot(path.t, path.u['u'], color=LINE_COLOURS[2], label='$u^*$')
    inputs.plot(path.t, -path.lam['omega'], label=r'$-\lambda_2$', **get_line(1))
    for bound in (-LIMIT, LIMIT):
        inputs.axhline(bound, **THIN)
    mesh = above.pcolormesh(path.t, grid, np.sqrt(np.maximum(valley, 0)), cmap='Blues',
                            shading='gouraud')
    above.plot(path.t, path.u['u'], color=LINE_COLOURS[2], label='$u^*(t)$', clip_on=False)
    above.grid(False)
    figure.colorbar(mesh, ax=above, label=r'$\sqrt{H(u) - H(u^*)}$')
    label_axes(states, 'state', 'time $t$ [s]', r'$\theta$ [rad], $\omega$ [rad/s]',
               legend='upper left')
    label_axes(costates, 'costate', 'time $t$ [s]', r'$\lambda_1$ [rad], $\lambda_2$ [rad s]',
               legend='lower left')
    label_axes(inputs, r'input, $\Omega = [-0.6, 0.6]$', 'time $t$ [s]', '$u$ [rad/s$^2$]',
               legend=True)
    label_axes(above, '$H$ over the input', 'time $t$ [s]', '$u$ [rad/s$^2$]', legend='lower left')
    for axes in (states, costates, inputs, above):
        axes.set_xlim(0, T)
    return figure


THEOREM_2_1 = GalleryEntry(
    'theorem-2.1', 'The maximum principle', 'Theorem 2.1', (
        "If $(x*, u*)$ is optimal there are $λ*(t)$ and $ν*$ with $x_i' = ∂H/∂λ_i$, "
        "$-λ_i' = ∂H/∂x_i$, $ψ(x(T)) = 0$, $λ(T) = ∂V/∂x + ν^T ∂ψ/∂x$, and $H(x*, u*, λ*) ≤ "
        'H(x*, u, λ*)$ for all $u ∈ Ω$.',
        "Here for a pendulum, $θ' = ω$, $ω' = -sin θ + u$ with $|u| ≤ 0.6$, driven from rest to "
        '$θ(3) = 1$. The cost is $½ ∫ (θ^2 + u^2) dt + 2 ω(3)^2$.'),
    theorem_2_1,
    'The theorem lacks the condition for a free final time, $H = 0$ at $T$, which Example 2.3 and '
    'Exercise 2.6 need, and states the normal form only (cost multiplier 1). In the sketch of its '
    'proof, ψ depends on $x(T)$ alone.')


END_TIME = 1.0  # [s]
WEIGHT = 12.0  # of the terminal cost
LENGTH = 0.35  # of the arrows of lambda(T)


@dataclass(frozen=True, eq=False)
class TerminalCase:
    """
    A terminal condition psi on x1' = x2, x2' = u from x(0) = 0, and its closed form.

    :ivar name, text: for the table, and for the figure.
    :ivar nu, lam, J: multipliers of psi, lambda(T) and the minimum cost.
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
        u = -q - p * (END_TIME - t)
        speed = -(q + p * END_TIME) * t + p * t**2 / 2
        place = -(q + p * END_TIME) * t**2 / 2 + p * t**3 / 6
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
            'final_time': {'free': False, 'value': END_TIME}}


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
            axes.plot(END_TIME, values[-1], 'o', color=line['color'], clip_on=False, zorder=6)
    _draw_sets(plane)
    inputs.plot([], [], label='closed form', **EXACT)
    for axes in (first, second, inputs):
        axes.axhline(0, **THIN)
        axes.set_xlim(0, END_TIME)
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
