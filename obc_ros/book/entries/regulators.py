# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Theorem 2.2 and Example 2.4: linear quadratic regulators."""

from math import sqrt
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import EXACT, EXACT_LINE, get_line, LINE_COLOURS, LINE_DASHES, THIN
from obc_ros.book.closed_forms import solve_double_integrator_regulator
from obc_ros.book.entry import (
    ComparedRow,
    create_panels,
    draw_pole_pairs,
    EntryResult,
    GalleryEntry,
    label_axes,
)
from obc_ros.book.loop import Run
from obc_ros.book.references import compute_free_motion, run_sampled_loop
from obc_ros.book.runner import AnsweredRegulator, Desk, Trajectory
from obc_ros.core.numerics.arrays import Array
from scipy.linalg import expm, solve_continuous_are, solve_continuous_lyapunov

N, M = 4, 2
HORIZONS = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0)
LONG = 20.0  # [s]


def make_plant() -> tuple[Array, Array, Array, Array]:
    """Return A, B, H and Qu of an unstable system; (A, B) reachable, (A, H) observable."""
    random = np.random.default_rng(23)
    A = random.normal(size=(N, N)).round(2)
    return A, random.normal(size=(N, M)).round(2), random.normal(size=(1, N)).round(2), \
        np.diag([1.0, 0.5])


def state_lq_problem(
        A: Array, B: Array, Qx: Array, Qu: Array, x0: Array, T: float) -> dict[str, Any]:
    """Return the problem with the cost of Theorem 2.2 over [0, T]."""
    n, m = B.shape
    x, u = [f'x{i + 1}' for i in range(n)], [f'u{j + 1}' for j in range(m)]
    terms = [f'({float(Q[i, j])!r})*{names[i]}*{names[j]}' for Q, names in ((Qx, x), (Qu, u))
             for i, j in np.ndindex(Q.shape) if Q[i, j]]
    return {'system': 'linear', 'parameters': {'A': A.tolist(), 'B': B.tolist()},
            'running_cost': ' + '.join(terms),
            'initial_state': dict(zip(x, map(float, x0), strict=True)),
            'final_time': {'free': False, 'value': T}}


def theorem_2_2(desk: Desk) -> EntryResult:
    """Compare gain, P and minimum cost with Theorem 2.2."""
    A, B, H, Qu = make_plant()
    Qx = H.T @ H
    found, = desk.design_all([{'A': A, 'B': B, 'Qx': Qx, 'Qu': Qu}])
    starts = np.vstack([np.eye(N)[0], np.ones(N)])
    long = desk.solve_all([state_lq_problem(A, B, Qx, Qu, x0, LONG) for x0 in starts])
    short = desk.solve_all([state_lq_problem(A, B, Qx, Qu, starts[-1], T) for T in HORIZONS],
                           show=0)
    P = solve_continuous_are(A, B, Qx, Qu)
    K = np.linalg.solve(Qu, B.T @ P)
    left = P @ A + A.T @ P - P @ B @ K + Qx
    motion = compute_free_motion(A - B @ K, starts[-1], long[-1].t)
    own = found.P @ A + A.T @ found.P - found.P @ B @ found.K + Qx
    rows = [
        ComparedRow('$P$', found.P, P, 'SciPy, `solve_continuous_are`'),
        ComparedRow('$K = Q_u^{-1} B^T P$', found.K, K, 'SciPy'),
        ComparedRow('$PA + A^T P - PBQ_u^{-1}B^T P + Q_x$', own, np.zeros_like(left), '0, (2.9)'),
        ComparedRow(f'minimum cost $J$ over {LONG:g} s from two $x(0)$', [path.J for path in long],
                    np.einsum('ki,ij,kj->k', starts, P, starts), '$J* = x(0)^T P x(0)$'),
        ComparedRow(f'$x*(t)$ over {LONG:g} s', np.stack(list(long[-1].x.values()), axis=1),
                    motion, '$e^{(A - BK)t} x(0)$'),
        ComparedRow('minimum cost over $T$ = 0.25 .. 12 s', [path.J for path in short],
                    [_finite(A, B, Qx, Qu, starts[-1], T) for T in HORIZONS],
                    'Hamiltonian matrix, $J = x^T X_{21} X_{11}^{-1} x$')]
    return EntryResult(rows, _draw_thm_2_2(found, short, long[-1], motion), (
        'Left: the minimum cost over a finite horizon increases to $J* = x(0)^T P x(0)$. Middle: '
        'the optimum over 20 s is the closed loop of the constant gain. Right: the cost of the '
        'gains $K + δD_i$ for five random directions $D_i$, from the Lyapunov equation; every '
        'other gain costs more.',))


def _finite(A: Array, B: Array, Qx: Array, Qu: Array, x0: Array, T: float) -> float:
    """Return the minimum cost over [0, T], from the Hamiltonian matrix in small steps."""
    G = B @ np.linalg.solve(Qu, B.T)
    steps = int(np.ceil(T / 0.25))
    X = expm(-T / steps * np.block([[A, -G], [-Qx, -A.T]]))
    P = np.zeros_like(A)
    for _ in range(steps):
        top, bottom = (X @ np.vstack([np.eye(len(A)), P])).reshape(2, len(A), len(A))
        P = bottom @ np.linalg.inv(top)
    return float(x0 @ P @ x0)


def _draw_thm_2_2(found: AnsweredRegulator, short: list[Trajectory], long: Trajectory,
                  motion: Array) -> Figure:
    A, B, H, Qu = make_plant()
    x0 = np.ones(N)
    best = float(x0 @ found.P @ x0)
    figure, ((costs, states), (gains, empty)) = create_panels(2, 2, 3.2)
    empty.remove()
    T = np.linspace(0.05, 12, 200)
    costs.plot(HORIZONS, [path.J for path in short], 'o', color=LINE_COLOURS[0], markersize=5,
               label='trajectory_server')
    costs.plot(T, [_finite(A, B, H.T @ H, Qu, x0, each) for each in T],
               label='Hamiltonian matrix', **EXACT_LINE)
    costs.axhline(best, label='$x(0)^T P\\, x(0)$', zorder=1, **get_line(1))
    label_axes(costs, 'minimum cost over $[0, T]$', 'horizon $T$ [s]', '$J$', legend='lower right')
    costs.set_xlim(0, 12.4)
    for index, (name, values) in enumerate(long.x.items()):
        states.plot(long.t, values, label=f'$x_{name[1]}$', **get_line(index))
        states.plot(long.t, motion[:, index], **EXACT)
    states.plot([], [], label='$e^{(A - BK)t}x(0)$', **EXACT)
    states.set_xlim(0, 8)
    label_axes(states, 'optimal states', 'time $t$ [s]', '$x^*(t)$')
    random = np.random.default_rng(8)
    size = np.linspace(-0.4, 0.4, 41)
    for index in range(5):
        D = random.normal(size=found.K.shape)
        cost = np.array([_cost_of(A, B, H.T @ H, Qu, found.K + d * D, x0) for d in size])
        gains.plot(size, cost, color='0.35', linewidth=1.2,
                   label=None if index else '$K + \\delta D_i$, five random $D_i$')
    gains.plot(0, best, 'o', color='black', label='$K = Q_u^{-1}B^T P$', zorder=6)
    gains.set_ylim(0.995 * best, 1.1 * best)
    label_axes(gains, 'cost of other gains', '$\\delta$', '$J$')
    handles = [axes.get_legend_handles_labels() for axes in (states, gains)]
    figure.legend(handles[0][0] + handles[1][0], handles[0][1] + handles[1][1], loc='center',
                  bbox_to_anchor=(0.77, 0.25))
    return figure


def _cost_of(A: Array, B: Array, Qx: Array, Qu: Array, K: Array, x0: Array) -> float:
    """Return the cost of u = -K x from x0; nan if the closed loop is not stable."""
    closed = A - B @ K
    if np.linalg.eigvals(closed).real.max() >= 0:
        return np.nan
    X = solve_continuous_lyapunov(closed.T, -(Qx + K.T @ Qu @ K))
    return float(x0 @ X @ x0)


WEIGHTS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 10.0)
Q, STEP, DURATION = 2.0, 0.01, 8.0
DOUBLE = {'A': [[0.0, 1.0], [0.0, 0.0]], 'B': [[0.0], [1.0]]}


def example_2_4(desk: Desk) -> EntryResult:
    """Compute Example 2.4 over q, and compare its gain with the printed one in a loop."""
    found = desk.design_all([{**DOUBLE, 'Qx': [q * q, 0.0], 'Qu': [1.0]} for q in WEIGHTS])
    exact = [solve_double_integrator_regulator(q) for q in WEIGHTS]
    printed = np.array([[1 / Q, sqrt(2 / Q)]])
    cost, cost_printed = (path.J for path in desk.solve_all([
        _with_gain(np.array([[Q, sqrt(2 * Q)]])), _with_gain(printed)], show=0))
    with desk.loop('double_integrator', {
            'system': 'double_integrator', 'x0': [1.0, 0.0], 'publish_rate': 1 / STEP}, {
            'system': 'double_integrator', 'Qx': [Q * Q, 0.0], 'Qu': [1.0]}) as loop:
        right = loop.run(DURATION)
        loop.set(Qx=[1.0, 0.0], Qu=[Q * Q])
        wrong = loop.run(DURATION)
    count = len(right.t) - 1
    A, B = (np.array(DOUBLE[key]) for key in 'AB')
    ends = [run_sampled_loop(A, B, K, [1, 0], STEP, count) for K in (exact[4].K, printed)]
    rows = [
        ComparedRow('$K$ for seven $q$ from 0.1 to 10', [each.K for each in found],
                    [each.K for each in exact], '$[q, √(2q)]$'),
        ComparedRow('$P$', [each.P for each in found], [each.P for each in exact],
                    '$[[√(2q^3), q], [q, √(2q)]]$'),
        ComparedRow('$ω_0$ [rad/s]', [abs(each.E[0]) for each in found], np.sqrt(WEIGHTS), '$√q$'),
        ComparedRow('damping ratio $ζ$', [each.message.damping[0] for each in found],
                    np.full(len(WEIGHTS), 1 / sqrt(2)), '$1/√2$'),
        ComparedRow(f'$q = {Q:g}$, $x(0) = (1, 0)$: cost of $K = [2, 2]$', cost, 4.0,
                    '$P_{11} = √(2q^3)$'),
        ComparedRow('the same: cost of the printed $K = [0.5, 1]$', cost_printed, 6.125,
                    'Lyapunov equation, 49/8'),
        ComparedRow('loop with $K = [2, 2]$: $x(t)$', right.x, ends[0][0],
                    'recursion of the sampled loop'),
        ComparedRow('loop with the printed $K$: $x(t)$', wrong.x, ends[1][0],
                    'recursion of the sampled loop'),
        ComparedRow('loop with the printed $K$: $u(t)$', wrong.u, ends[1][1],
                    'recursion of the sampled loop')]
    return EntryResult(rows, _draw_2_4(found, right, wrong), (
        'Above: the gain over $q$, corrected (solid) and as printed in the book (misprint, dashed '
        'and dotted), and the poles, which move outwards on two rays: the damping is the same for '
        f'every $q$. Below: both gains in a running loop for $q = {Q:g}$. With '
        '$Q_x = diag(1, 0)$ and $Q_u = q^2$, `lqr_node` computes the printed gain.',),
        f'For $q = {Q:g}$ and $x(0) = (1, 0)$ the corrected gain costs {cost:.6f}, the printed '
        f'one {cost_printed:.6f}.')


def _with_gain(K: Array) -> dict[str, Any]:
    """Return a problem whose minimum is the cost of a given gain in the example."""
    (k1, k2), = K
    return {'states': ['x1', 'x2'], 'inputs': ['w'],
            'parameters': {'k1': float(k1), 'k2': float(k2), 'q': Q},
            'dynamics': {'x1': 'x2', 'x2': '-k1*x1 - k2*x2'},
            'running_cost': '(q*x1)**2 + (k1*x1 + k2*x2)**2 + w**2',
            'initial_state': {'x1': 1, 'x2': 0}, 'final_time': {'free': False, 'value': LONG}}


def _draw_2_4(found: list[AnsweredRegulator], right: Run, wrong: Run) -> Figure:
    figure, ((gains, plane), (states, inputs)) = create_panels(2, 2, 3.3)
    q = np.logspace(-1, 1, 100)
    printed = (1 / q, np.sqrt(2 / q))
    for index, text in enumerate(('$1/q$', '$\\sqrt{2/q}$')):
        values = [each.K[0, index] for each in found]
        gains.loglog(WEIGHTS, values, 'os'[index], color=LINE_COLOURS[index],
                     label=f'$K_{index + 1}$')
        gains.loglog(q, (q, np.sqrt(2 * q))[index], label='exact' if index else None,
                     **EXACT_LINE)
        gains.loglog(q, printed[index], color=LINE_COLOURS[index], linewidth=1.3,
                     linestyle=('--', ':')[index], label=f'$K_{index + 1}$ printed: {text}')
    gains.set(ylim=(0.08, 20))
    gains.grid(True, which='major')
    label_axes(gains, 'gain', 'weight $q$', '$K_1$ [s$^{-2}$], $K_2$ [s$^{-1}$]')
    gains.legend(loc='upper center', bbox_to_anchor=(0.5, -0.2), ncols=2, columnspacing=0.8)
    texts = [f'$q = {each:g}$' if each in (0.1, 1.0, 4.0, 10.0) else '' for each in WEIGHTS]
    draw_pole_pairs(plane, zip((each.E for each in found), texts, strict=True),
                    r'poles $\sqrt{q/2}\,(-1 \pm i)$')
    for run, dashes, text in ((right, (0, 1), '$K = [q, \\sqrt{2q}]$, $J = 4$'),
                              (wrong, (2, 3), 'as printed, $J = 6.125$')):
        for index, name in enumerate(('x_1', 'x_2')):
            states.plot(run.t, run.x[:, index], color=LINE_COLOURS[index],
                        linestyle=LINE_DASHES[dashes[index]],
                        label=f'${name}$' + (', printed' if run is wrong else ''))
        inputs.plot(run.t, run.u[:, 0], color=LINE_COLOURS[dashes[0]],
                    linestyle=LINE_DASHES[dashes[0]], drawstyle='steps-post', label=text)
    for axes in (states, inputs):
        axes.axhline(0, **THIN)
        axes.set_xlim(0, DURATION)
    label_axes(states, f'loop, $q = {Q:g}$: state', 'time $t$ [s]', '$x_1$ [m], $x_2$ [m/s]',
               legend='upper right')
    label_axes(inputs, f'loop, $q = {Q:g}$: input', 'time $t$ [s]', '$u$ [m/s$^2$]',
               legend='lower right')
    return figure


THEOREM_2_2 = GalleryEntry(
    'theorem-2.2', 'The linear quadratic regulator', 'Theorem 2.2', (
        "For $x' = Ax + Bu$ and $J = ∫_0^∞ (x^T Q_x x + u^T Q_u u) dt$ with $(A, B)$ reachable, "
        '$Q_x = H^T H$ with $(A, H)$ observable and $Q_u > 0$: the optimum is '
        '$u = -Q_u^{-1}B^T P x$, $PA + A^T P - PBQ_u^{-1}B^T P = -Q_x$, and the minimum cost is '
        '$J* = x^T(0) P x(0)$. Here for a random system of four states and two inputs.',),
    theorem_2_2,
    '“$Q_u = H^T H$” must read $Q_x = H^T H$. Reachability and observability are more than is '
    'needed: stabilisable and detectable are enough. In section 2.4, before (2.7), '
    '“$PBQ_u^{-1}BPx$” lacks a transpose, $B^T Px$, and $u$ is in $R^m$; $P_1 ≥ 0$, as there, is '
    'what is needed, not $P_1 > 0$ as in section 2.2. And contrary to section 2.2, $L(x, u)$ need '
    'not approach zero if the cost is finite: pulses of height 1 and width $2^{-k}$ have a finite '
    'integral. (Here it does: $x*(t)$ is a sum of exponentials.)')
EXAMPLE_2_4 = GalleryEntry(
    'example-2.4', 'Optimal control of a double integrator', 'Example 2.4', (
        "$x_1' = x_2$, $x_2' = u$ with $Q_x = diag(q^2, 0)$, $Q_u = 1$. The Riccati equation has "
        'the solution $P = [[√(2q^3), q], [q, √(2q)]]$, and the closed loop is damped by '
        '$ζ = 1/√2$ for every $q$.',),
    example_2_4,
    'The book prints $K = [1/q, √(2/q)]$ and $ω_0 = √(1/q)$. From $P$ follow '
    '$K = Q_u^{-1}B^T P = [q, √(2q)]$, its second row, and $ω_0 = √q$; both agree for $q = 1$ '
    'only. The printed gain belongs to $Q_x = diag(1, 0)$, $Q_u = q^2$.')
