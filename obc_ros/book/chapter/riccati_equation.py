# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Section 2.4: the Riccati differential equation (2.7), backwards in time."""

from math import sqrt
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import EXACT, get_line, LINE_COLOURS, THIN
from obc_ros.book.entry import ComparedRow, create_panels, EntryResult, GalleryEntry, label_axes
from obc_ros.book.loop import Run
from obc_ros.book.references import run_sampled_loop, simulate_loop
from obc_ros.book.runner import Desk
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.riccati.fixed_horizon import solve_finite_horizon
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_continuous_lyapunov

# Scalar system x' = a x + u with Qx = Qu = 1.
GROWTH = 1.0  # a [1/s]
ROOT = sqrt(GROWTH**2 + 1.0)
SCALAR_TERMINAL = (0.0, 1.0, GROWTH + ROOT, 5.0)  # P1; the third solves (2.9)
SCALAR_HORIZONS = (0.5, 1.0, 2.0, 4.0)  # [s]
SCALAR_LONG = 3.0  # [s]
# Double integrator with Qx = diag(1, 0), Qu = 1.
A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
QX = np.diag([1.0, 0.0])
STATIONARY = np.array([[sqrt(2), 1.0], [1.0, sqrt(2)]])  # Example 2.4 with q = 1
DOUBLE_TERMINAL = {'0': 0.0, '2 I': 2.0}
HORIZONS = (1.0, 2.0, 4.0, 8.0)  # [s] of the problems of the server
LONG = 8.0  # [s]
X0 = np.array([1.0, 0.0])
STOP, HEAVY, STEP = 2.5, 100.0, 0.025  # horizon [s], P1 = HEAVY I and sampling [s] of the loop


def evaluate_scalar_riccati(P1: float, to_go: Array) -> Array:
    """
    Return P of -P' = 2 a P - P^2 + 1 at times to go.

    With the two roots P+ > 0 > P- of the right side, (P - P+) / (P - P-) decays like
    e^(-2 √(a^2 + 1) (T - t)).
    """
    upper, lower = GROWTH + ROOT, GROWTH - ROOT
    ratio = (P1 - upper) / (P1 - lower) * np.exp(-2 * ROOT * to_go)
    return np.asarray((upper - lower * ratio) / (1 - ratio))


def evaluate_final_state_riccati(weight: float, to_go: Array) -> Array:
    """
    Return P (N, 2, 2) of the double integrator with Qx = 0, Qu = 1 and P1 = weight I.

    The inverse of P satisfies a linear equation: with s = T - t it is
    e^(-A s) e^(-A's) / weight + the integral of e^(-A r) B B' e^(-A'r) over [0, s].
    """
    s, one = to_go, np.ones_like(to_go)
    inverse = (np.array([[one + s**2, -s], [-s, one]]) / weight
               + np.array([[s**3 / 3, -s**2 / 2], [-s**2 / 2, s]]))
    return np.linalg.inv(np.moveaxis(inverse, -1, 0))


def evaluate_distance(weight: float, to_go: Array) -> Array:
    """
    Return P(t) - P (N, 2, 2) of the double integrator with P1 = weight I.

    D = P(t) - P satisfies -D' = D M + M'D - D B B'D with M = A - B K, so that the inverse of D
    satisfies a linear equation. Its solution is given here in a form that needs no inverse of D1.
    """
    M = A - B @ STATIONARY[1:]
    D1 = weight * np.eye(2) - STATIONARY
    whole = solve_continuous_lyapunov(M, -B @ B.T)
    flow = np.array([expm(M * s) for s in to_go])
    across = np.swapaxes(flow, 1, 2)
    W = whole - flow @ whole @ across
    return np.asarray(across @ D1 @ np.linalg.solve(np.eye(2) + W @ D1, flow))


def integrate_riccati(weight: float, to_go: Array) -> Array:
    """Return P (N, 2, 2) of the double integrator at increasing times to go, from 0 on."""
    def rate(_: float, flat: Array) -> Array:
        P = flat.reshape(2, 2)
        return np.asarray(P @ A + A.T @ P - P @ B @ B.T @ P + QX).ravel()

    found = solve_ivp(rate, (0.0, to_go[-1]), weight * np.eye(2).ravel(), 'DOP853', to_go,
                      rtol=1e-12, atol=1e-13)
    return np.asarray(found.y.T.reshape(-1, 2, 2))


def state_horizon_problem(weight: float, T: float) -> dict[str, Any]:
    """Return the problem of section 2.4 for the double integrator, with P1 = weight I."""
    return {'states': ['x1', 'x2'], 'inputs': ['u'], 'dynamics': {'x1': 'x2', 'x2': 'u'},
            'running_cost': '(x1**2 + u**2)/2', 'terminal_cost': f'{weight / 2!r}*(x1**2 + x2**2)',
            'initial_state': {'x1': 1, 'x2': 0}, 'final_time': {'free': False, 'value': T}}


def section_2_4(desk: Desk) -> EntryResult:
    """Compare P(t), K(t), costates, costs and a loop over a horizon with references."""
    rows = _compare_scalar()
    t = np.linspace(0.0, LONG, 401)
    to_go = LONG - t
    P = {}
    for name, weight in DOUBLE_TERMINAL.items():
        P[name], K = solve_finite_horizon(A, B, QX, np.eye(1), weight * np.eye(2), t, LONG)
        exact = integrate_riccati(weight, to_go[::-1])[::-1]
        rows += [
            ComparedRow(f'$P(t)$ of the double integrator, $P_1 = {name}$', P[name], exact,
                        'Dormand-Prince 8(5,3)'),
            ComparedRow(f'$K(t)$, $P_1 = {name}$', K[:, 0], exact[:, 1], '$Q_u^{-1} B^T P(t)$'),
            ComparedRow(f'$P(t) - P$, $P_1 = {name}$', P[name] - STATIONARY,
                        evaluate_distance(weight, to_go),
                        '$Φ^T D_1 (I + W D_1)^{-1} Φ$, $Φ = e^{(A - BK)(T - t)}$')]
    bare = solve_finite_horizon(A, B, 0 * QX, np.eye(1), np.eye(2), t, LONG)[0]
    rows.append(ComparedRow('$P(t)$ with $Q_x = 0$, $P_1 = I$', bare,
                            evaluate_final_state_riccati(1.0, to_go),
                            '$(e^{-As} e^{-A^T s} + ∫ e^{-Ar}BB^T e^{-A^T r} dr)^{-1}$, '
                            '$s = T - t$'))
    rows += _compare_server(desk)
    runs = _fly_horizon(desk)
    rows += _compare_loop(runs)
    return EntryResult(rows, _draw_riccati(t, P, runs), (
        'Top left: $P(t)$ of a scalar system from four $P_1$ at the end. Backwards in time all '
        'tend to the positive root $1 + √2$ of (2.9); the end only matters for the last second. '
        'Top right: the elements of $P(t)$ of the double integrator, from $P_1 = 0$ (solid) and '
        '$P_1 = 2 I$ (dashed), and the solution of (2.9) (thin). As $Q_u = 1$, '
        '$K(t) = (p_{12}, p_{22})$. Bottom left: the distance to that solution decays twice as '
        'fast as the slowest pole of the closed loop, $-1/√2$. This is why the gain of the '
        'infinite horizon is a good gain until shortly before the end.',
        f'Bottom right: a loop of `plant_simulator` and `lqr_node` with `horizon` {STOP:g} s and '
        f'$P_1 = {HEAVY:g} I$. The heavy terminal weight brings the state to rest at the end of '
        'the horizon; the constant gain (dashed) is still on its way.'))


def _compare_scalar() -> list[ComparedRow]:
    one, rows = np.eye(1), []
    t = np.linspace(0.0, SCALAR_LONG, 301)
    for P1 in SCALAR_TERMINAL:
        P, _ = solve_finite_horizon([[GROWTH]], one, one, one, P1 * one, t, SCALAR_LONG)
        rows.append(ComparedRow(f'scalar $P(t)$, $P_1 = {P1:.4g}$', P[:, 0, 0],
                                evaluate_scalar_riccati(P1, SCALAR_LONG - t),
                                '$(P - P_+)/(P - P_-) ~ e^{-2√2 (T - t)}$'))
    starts = [[solve_finite_horizon([[GROWTH]], one, one, one, P1 * one, [0.0], T)[0][0, 0, 0]
               for T in SCALAR_HORIZONS] for P1 in SCALAR_TERMINAL]
    rows.append(ComparedRow('scalar $P(0)$ over $T$ = 0.5, 1, 2 and 4 s', starts, [
        evaluate_scalar_riccati(P1, np.array(SCALAR_HORIZONS)) for P1 in SCALAR_TERMINAL],
        'the same'))
    return rows


def _compare_server(desk: Desk) -> list[ComparedRow]:
    cases = [(weight, T) for weight in DOUBLE_TERMINAL.values() for T in HORIZONS]
    paths = desk.solve_all([state_horizon_problem(*case) for case in cases])
    starts, costates = [], []
    for (weight, T), path in zip(cases, paths, strict=True):
        to_go, place = np.unique(np.clip(T - path.t, 0.0, T), return_inverse=True)
        P = integrate_riccati(weight, to_go)[place]
        starts.append(X0 @ P[0] @ X0 / 2)
        x = np.stack([*path.x.values()], axis=1)
        costates.append((np.stack([*path.lam.values()], axis=1), np.einsum('kij,kj->ki', P, x)))
    found, wanted = map(np.concatenate, zip(*costates, strict=True))
    return [
        ComparedRow('`trajectory_server`: cost $J$ for two $P_1$ and four $T$',
                    [path.J for path in paths], starts, '$½ x(0)^T P(0) x(0)$'),
        ComparedRow('`trajectory_server`: costate $λ(t)$', found, wanted, '$P(t) x(t)$')]


def _fly_horizon(desk: Desk) -> dict[str, Run]:
    with desk.loop('horizon', {
            'system': 'double_integrator', 'x0': X0, 'publish_rate': 1 / STEP},
            {'system': 'double_integrator', 'Qx': np.diag(QX), 'Qu': [1.0]}) as loop:
        constant = loop.run(2 * STOP)
        loop.set(horizon=STOP, P1=[HEAVY, HEAVY])
        return {'constant': constant, 'horizon': loop.run(STOP)}


def _compare_loop(runs: dict[str, Run]) -> list[ComparedRow]:
    constant, horizon = runs.values()
    fixed = run_sampled_loop(A, B, STATIONARY[1:], X0, STEP, len(constant.t) - 1)[0]
    K = integrate_riccati(HEAVY, STEP * np.arange(len(horizon.t), dtype=float))[::-1, 1]
    x, u = simulate_loop(lambda x, u: [x[1], u[0]], lambda t, x: -K[[round(t / STEP)]] @ x, X0,
                         STEP, len(horizon.t) - 1)
    return [ComparedRow('loop with the constant gain: $x(t)$', constant.x, fixed,
                        'recursion of the sampled loop'),
            ComparedRow(f'loop with $K(t)$ over {STOP:g} s: $x(t)$', horizon.x, x,
                        'Dormand-Prince 8(5,3), of (2.7) too'),
            ComparedRow(f'loop with $K(t)$ over {STOP:g} s: $u(t)$', horizon.u, u,
                        'Dormand-Prince 8(5,3), of (2.7) too')]


def _draw_riccati(t: Array, P: dict[str, Array], runs: dict[str, Run]) -> Figure:
    figure, ((scalar, elements), (decay, loop)) = create_panels(2, 2)
    fine = np.linspace(0, SCALAR_LONG, 200)
    for index, P1 in enumerate(SCALAR_TERMINAL):
        line = get_line(index)
        found, _ = solve_finite_horizon([[GROWTH]], np.eye(1), np.eye(1), np.eye(1), [[P1]], fine,
                                        SCALAR_LONG)
        scalar.plot(fine, found[:, 0, 0], **line)
        scalar.plot(fine, evaluate_scalar_riccati(P1, SCALAR_LONG - fine), **EXACT)
        scalar.plot(SCALAR_LONG, P1, 'o', color=line['color'], clip_on=False,
                    label='$P_1 = 1 + \\sqrt{2}$' if P1 == GROWTH + ROOT else f'$P_1 = {P1:g}$')
    scalar.plot([], [], label='closed form', **EXACT)
    for index, (i, j) in enumerate(((0, 0), (0, 1), (1, 1))):
        for values, style in zip(P.values(), ('-', '--'), strict=True):
            elements.plot(t, values[:, i, j], style, color=LINE_COLOURS[index],
                          label=f'$p_{{{i + 1}{j + 1}}}$' if style == '-' else None)
        elements.axhline(STATIONARY[i, j], **THIN)
    for (name, values), style, colour in zip(P.items(), ('-', '--'), LINE_COLOURS, strict=False):
        decay.semilogy(LONG - t, np.abs(values - STATIONARY).max(axis=(1, 2)), style, color=colour,
                       label=f'$P_1 = {name}$')
    decay.semilogy(LONG - t, 8 * np.exp(-sqrt(2) * (LONG - t)), color='0.4', linewidth=1,
                   label=r'$8\,e^{-\sqrt{2}(T - t)}$')
    for run, style, text in ((runs['horizon'], '-', 'horizon'),
                             (runs['constant'], '--', 'constant gain')):
        for index in range(2):
            loop.plot(run.t, run.x[:, index], style, color=LINE_COLOURS[index],
                      label=f'$x_{index + 1}$, {text}')
    loop.axvline(STOP, **THIN)
    loop.axhline(0, **THIN)
    label_axes(scalar, 'scalar: $P(t)$ from four $P_1$', 'time $t$ [s]', '$P$',
               legend='upper left')
    label_axes(elements, 'double integrator: $P(t)$', 'time $t$ [s]', '$p_{ij}$',
               legend='lower left')
    label_axes(decay, 'distance to the solution of (2.9)', 'time to go $T - t$ [s]',
               r'$\max_{ij}\,|P(t) - P|_{ij}$', legend='upper right')
    label_axes(loop, f'loop: $T = {STOP:g}$ s, $P_1 = {HEAVY:g}\\,I$', 'time $t$ [s]',
               '$x_1$ [m], $x_2$ [m/s]', legend='upper right')
    scalar.set(xlim=(0, SCALAR_LONG), ylim=(-0.2, 5.2))
    elements.set(xlim=(0, LONG), ylim=(-0.1, 2.6))
    decay.set_xlim(0, LONG)
    loop.set_xlim(0, 2 * STOP)
    return figure


SECTION_2_4 = GalleryEntry(
    'section-2.4', 'The Riccati equation backwards in time',
    'Section 2.4, equations (2.6) and (2.7)', (
        'The finite horizon: minimise $J = ½ ∫_0^T (x^T Q_x x + u^T Q_u u) dt + '
        "½ x(T)^T P_1 x(T)$ for $x' = Ax + Bu$. The conditions (2.6) with $λ = P(t) x$ give "
        "$-P' = PA + A^T P - PBQ_u^{-1}B^T P + Q_x$, $P(T) = P_1$ (2.7), which is solved "
        'backwards from the end, and $u = -K(t) x$ with $K(t) = Q_u^{-1}B^T P(t)$.',
        "Here for $x' = x + u$ with $Q_x = Q_u = 1$, and for the double integrator with "
        '$Q_x = diag(1, 0)$, $Q_u = 1$.'),
    section_2_4,
    'In the third line of (2.6), “$Q_u u + λ^T B$” adds a column and a row: '
    '$Q_u u + B^T λ = 0$.')
