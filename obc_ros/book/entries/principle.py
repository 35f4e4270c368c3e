# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Theorem 2.1 on a nonlinear example."""

from typing import Any

from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import EXACT, get_line, LINE_COLOURS, THIN
from obc_ros.book.entry import ComparedRow, create_panels, EntryResult, GalleryEntry, label_axes
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
