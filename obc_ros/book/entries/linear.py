# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Exercise 2.7 (observable systems are stabilised) and Exercise 2.8 (an integrator and a lag)."""

from typing import Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
import numpy as np
from obc_ros.api.figures.style import EXACT, EXACT_LINE, get_line, LINE_COLOURS
from obc_ros.book.closed_forms import solve_lag_regulator
from obc_ros.book.entries.regulators import state_lq_problem
from obc_ros.book.entry import ComparedRow, create_panels, EntryResult, GalleryEntry, label_axes
from obc_ros.book.references import compute_free_motion, match_poles
from obc_ros.book.runner import AnsweredRegulator, Desk
from obc_ros.core.numerics.arrays import Array
from scipy.linalg import expm, solve_continuous_are

SYSTEMS = 24


def draw_systems() -> list[tuple[Array, Array, Array, float]]:
    """Return A, B, C and rho of random systems with 2 to 6 states; most are unstable."""
    random = np.random.default_rng(27)
    found = []
    for index in range(SYSTEMS):
        n = 2 + index % 5
        found.append((random.normal(size=(n, n)), random.normal(size=(n, 1)),
                      random.normal(size=(1, n)), float(10 ** random.uniform(-2, 2))))
    return found


def exercise_2_7(desk: Desk) -> EntryResult:
    """Compute Exercise 2.7 for random systems, and its counterexample."""
    systems = draw_systems()
    designs = desk.design_all([
        {'A': A, 'B': B, 'weights': 'output', 'H': C, 'rho': rho} for A, B, C, rho in systems])
    refusal = desk.refuse({'A': [[1.0]], 'B': [[0.0]], 'Qx': [1.0], 'Qu': [1.0]}, 'A = 1, B = 0')
    gains, poles, wanted = [], [], []
    for (A, B, C, rho), found in zip(systems, designs, strict=True):
        P = solve_continuous_are(A, B, C.T @ C, np.array([[rho]]))
        K = B.T @ P / rho
        gains.append((found.K.ravel(), K.ravel()))
        E = np.linalg.eigvals(A - B @ K)
        poles.append(match_poles(found.E, E))
        wanted.append(E)
    own, exact = np.concatenate(poles), np.concatenate(wanted)
    own_gains, exact_gains = map(np.concatenate, zip(*gains, strict=True))
    rows = [
        ComparedRow('stable closed loops', sum(bool((each.E.real < 0).all()) for each in designs),
                    SYSTEMS, 'the exercise'),
        ComparedRow('gains $K$', own_gains, exact_gains, 'SciPy, `solve_continuous_are`'),
        ComparedRow('real parts of the closed-loop poles [rad/s]', own.real, exact.real,
                    'eigenvalues of $A - BK$'),
        ComparedRow('imaginary parts [rad/s]', own.imag, exact.imag, 'eigenvalues of $A - BK$')]
    return EntryResult(rows, _draw_2_7(systems, designs), (
        f'{SYSTEMS} random observable systems of 2 to 6 states, one input and one output, each '
        'with its own $ρ$ between 0.01 and 100. With the optimal feedback, all poles are in the '
        'left half plane. Below: $V = x^T P x$ falls along every path of a closed loop, as '
        '$x^T P x$ is the cost that is left.',
        "Why: (2.9) gives $V' = -y^T y - ρu^T u ≤ 0$ along the loop. Where $V'$ stays 0, $u$ and "
        '$y$ are 0, and observability leaves $x = 0$ only. Hence $P > 0$, no pole is on the '
        'imaginary axis, and $V$ falls to 0. Without observability a state in the unobservable '
        'subspace has no cost, and may grow.'),
        f'For $A = 1$, $B = 0$, $C = 1$, `trajectory_server` reports: “{refusal}”.')


def _draw_2_7(systems: list[Any], designs: list[AnsweredRegulator]) -> Figure:
    figure, ((plane, slowest), (energy, empty)) = create_panels(2, 2, 3.2)
    empty.remove()
    for (A, *_), found in zip(systems, designs, strict=True):
        before = np.linalg.eigvals(A)
        plane.plot(before.real, before.imag, 'x', color='0.45', markersize=5)
        plane.plot(found.E.real, found.E.imag, 'o', color=LINE_COLOURS[0], markersize=4)
    plane.axvline(0, color='black', linewidth=1)
    far = sum(int((found.E.real < -7).sum()) for found in designs)
    plane.annotate(f'{far} further left', (-6.9, 0), (-6.7, -2.2), arrowprops={'arrowstyle': '->'})
    plane.set_xlim(-7, 4)
    label_axes(plane, f'poles of {len(designs)} systems', 'real part [rad/s]',
               'imaginary part [rad/s]')
    index = np.arange(1, len(designs) + 1)
    slowest.bar(index, [np.linalg.eigvals(A).real.max() for A, *_ in systems], color='0.75')
    slowest.bar(index, [each.E.real.max() for each in designs], color=LINE_COLOURS[0], width=0.5)
    slowest.axhline(0, color='black', linewidth=1)
    slowest.set(xlim=(0.2, len(designs) + 0.8))
    label_axes(slowest, 'rightmost pole', 'system', 'real part [rad/s]')
    _draw_cost_to_go(energy, systems, designs)
    figure.legend(handles=[
        Line2D([], [], marker='x', linestyle='none', color='0.45', label='poles of $A$'),
        Line2D([], [], marker='o', linestyle='none', color=LINE_COLOURS[0],
               label='poles of $A - BK$'),
        Patch(color='0.75', label='without feedback'),
        Patch(color=LINE_COLOURS[0], label='with the optimal feedback'),
        Line2D([], [], label='$V = x^T P x$ with feedback', **get_line(0)),
        Line2D([], [], label='the same without feedback', **get_line(1))],
        loc='center', bbox_to_anchor=(0.77, 0.24))
    return figure


def _draw_cost_to_go(axes: Any, systems: list[Any], designs: list[AnsweredRegulator]) -> None:
    """Draw V = x'Px from x = (1, ..., 1): it falls with feedback, and need not without."""
    t = np.linspace(0, 3, 121)
    for (A, *_), found in zip(systems[:5], designs, strict=False):
        for M, line in ((found.A - found.B @ found.K, 0), (A, 1)):
            step = expm(M * t[1])
            states = [np.ones(len(A))]
            for _ in t[1:]:
                states.append(step @ states[-1])
            values = np.einsum('ki,ij,kj->k', states, found.P, states)
            if line == 0 or np.linalg.eigvals(A).real.max() > 0:
                axes.semilogy(t, values / values[0], **get_line(line))
    axes.set(xlim=(0, 3), ylim=(1e-3, 1e3))
    label_axes(axes, r'Lyapunov: $\dot V = -x^T(Q_x + K^T Q_u K)x$', 'time $t$ [s]', '$V(t)/V(0)$')


LAGS = (0.1, 0.5, 1.0, 2.0, 3.0)
ZEROS = (0.5, 1.0, 4.0)
X0, LONG = np.array([1.0, 0.0]), 60.0  # [s] the slowest pole is at -0.34


def build_lag(a: float) -> tuple[Array, Array]:
    """Return A and B of Exercise 2.8."""
    return np.array([[0.0, 1.0], [0.0, -a]]), np.array([[0.0], [1.0]])


def exercise_2_8(desk: Desk) -> EntryResult:
    """Compute Exercise 2.8 over a and b."""
    Qx, Qu = np.diag([1.0, 0.0]), np.eye(1)
    designs = desk.design_all([
        {'A': build_lag(a)[0], 'B': build_lag(a)[1], 'Qx': [1.0, 0.0], 'Qu': [1.0]} for a in LAGS])
    paths = desk.solve_all([state_lq_problem(*build_lag(a), Qx, Qu, X0, LONG) for a in LAGS],
                           show=0)
    exact = [solve_lag_regulator(a) for a in LAGS]
    four = []
    for a, found in zip(LAGS, designs, strict=True):
        (p11, p12), (p21, p22) = found.P
        four.append([1 - p12 * p21, p11 - a * p12 - p12 * p22, p11 - a * p21 - p21 * p22,
                     p12 + p21 - 2 * a * p22 - p22**2])
    motions = [compute_free_motion(A - B @ own.K, X0, path.t) for (A, B), own, path in zip(
        map(build_lag, LAGS), exact, paths, strict=True)]
    outputs = [(b * path.x['x1'] + path.x['x2'], motion @ [b, 1.0])
               for path, motion in zip(paths, motions, strict=True) for b in ZEROS]
    own_outputs, exact_outputs = map(np.concatenate, zip(*outputs, strict=True))
    rows = [
        ComparedRow('(a) the four equations, five $a$', four, np.zeros((len(LAGS), 4)),
                    '$1 - p_{12}p_{21}$, $p_{11} - ap_{12} - p_{12}p_{22}$ and its mirror image, '
                    '$p_{12} + p_{21} - 2ap_{22} - p_{22}^2$ are 0'),
        ComparedRow('(b) $K$ for $a$ from 0.1 to 3', [each.K for each in designs],
                    [each.K for each in exact], '$[1, √(a^2 + 2) - a]$'),
        ComparedRow('$P$', [each.P for each in designs], [each.P for each in exact],
                    '$[[√(a^2 + 2), 1], [1, √(a^2 + 2) - a]]$'),
        ComparedRow('(c) $ω_0$ [rad/s]', [np.sqrt(np.prod(each.E).real) for each in designs],
                    np.ones(len(LAGS)), '1 for every $a$'),
        ComparedRow('(c) damping ratio $ζ$', [
                    -each.E.sum().real / 2 / np.sqrt(np.prod(each.E).real) for each in designs],
                    [each.zeta for each in exact], '$½ √(a^2 + 2)$'),
        ComparedRow('minimum cost from $x(0) = (1, 0)$', [path.J for path in paths],
                    [each.P[0, 0] for each in exact], '$P_{11} = √(a^2 + 2)$'),
        ComparedRow('$y(t) = b x_1 + x_2$ for 15 pairs of $a$ and $b$', own_outputs,
                    exact_outputs, '$[b, 1] e^{(A - BK)t} x(0)$')]
    return EntryResult(rows, _draw_2_8(designs, paths, motions), (
        'The zero $-b$ of the transfer function affects the output $y$, but neither the gain nor '
        'the poles: the cost depends on $x_1$ and $u$ only. For $a = √2$ the damping ratio is 1; '
        'for larger $a$ the two poles are real.',))


def _draw_2_8(designs: list[AnsweredRegulator], paths: list[Any], motions: list[Array]) -> Figure:
    figure, ((gains, loop), (slow, fast)) = create_panels(2, 2, 3.1)
    a = np.linspace(0, 3.2, 100)
    root = np.sqrt(a**2 + 2)
    gains.plot(a, np.ones_like(a), **EXACT_LINE)
    gains.plot(a, root - a, **EXACT_LINE)
    for index, marker in enumerate('os'):
        gains.plot(LAGS, [each.K[0, index] for each in designs], marker, color=LINE_COLOURS[index],
                   label=f'$K_{index + 1}$')
    gains.set_ylim(0, 1.6)
    label_axes(gains, '(b) gain', '$a$ [s$^{-1}$]', '$K_1$ [s$^{-2}$], $K_2$ [s$^{-1}$]',
               legend=True)
    poles = np.array([each.E for each in designs])
    loop.plot(a, np.ones_like(a), **EXACT_LINE)
    loop.plot(a, root / 2, label='closed form', **EXACT_LINE)
    omega0 = np.sqrt(np.prod(poles, axis=1).real)
    loop.plot(LAGS, omega0, 'o', color=LINE_COLOURS[0], label='$\\omega_0$ [rad/s]')
    loop.plot(LAGS, -poles.sum(axis=1).real / 2 / omega0, 's', color=LINE_COLOURS[1],
              label='$\\zeta$')
    label_axes(loop, '(c) closed loop', '$a$ [s$^{-1}$]', '$\\omega_0$ [rad/s], $\\zeta$',
               legend='upper left')
    for axes, path, motion, lag in zip((slow, fast), paths[1::2], motions[1::2], LAGS[1::2],
                                       strict=False):
        for index, b in enumerate(ZEROS):
            axes.plot(path.t, b * path.x['x1'] + path.x['x2'], label=f'$b = {b:g}$',
                      **get_line(index))
            axes.plot(path.t, motion @ [b, 1.0], **EXACT)
        axes.plot([], [], label='closed form', **EXACT)
        axes.set_xlim(0, 8)
        label_axes(axes, f'output, $a = {lag:g}$ s$^{{-1}}$', 'time $t$ [s]', '$y = bx_1 + x_2$',
                   legend='upper right')
    return figure


EXERCISE_2_7 = GalleryEntry(
    'exercise-2.7', 'Observable systems are stabilised', 'Exercise 2.7', (
        'Minimise $J = ∫_0^∞ (y^T y + ρ u^T u) dt$ with $y = Cx$. Show that the closed loop of '
        'the optimal $u = -Kx$ is stable if the system is observable.',),
    exercise_2_7,
    'Observability alone is not enough: $A = 1$, $B = 0$, $C = 1$ is observable, no feedback '
    'stabilises it and the cost is infinite. $(A, B)$ must be stabilisable.')
EXERCISE_2_8 = GalleryEntry(
    'exercise-2.8', 'An integrator and a lag', 'Exercise 2.8', (
        '$H(s) = (s + b)/s(s + a)$ with $V = ∫ (x_1^2 + u^2) dt$: (a) the Riccati equation as '
        'four equations, (b) the gains, (c) natural frequency and damping ratio of the loop.',
        'The four equations: $1 - p_{12}p_{21} = 0$, $p_{11} - ap_{12} - p_{12}p_{22} = 0$, '
        '$p_{11} - ap_{21} - p_{21}p_{22} = 0$, $p_{12} + p_{21} - 2ap_{22} - p_{22}^2 = 0$.'),
    exercise_2_8)
