# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Doyle's example: an estimator in the loop leaves no margin, and how it is recovered."""

from math import atan, pi, sqrt
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import EXACT_LINE, get_line, LINE_COLOURS, THIN
from obc_ros.book.entry import ComparedRow, create_panels, EntryResult, GalleryEntry, label_axes
from obc_ros.book.next_chapters.node_runs import ask_estimator
from obc_ros.book.references import sample_noise
from obc_ros.book.runner import Desk
from obc_ros.core.estimation.kalman_gain import KalmanDesign, lqe
from obc_ros.core.estimation.output_feedback import combine, OutputFeedback, recover_loop_transfer
from obc_ros.core.lqr.lqr import lqr, LqrDesign
from obc_ros.core.numerics.arrays import Array, Complex
from obc_ros.srv import SuggestNoise
from scipy.linalg import expm, solve_continuous_are, solve_discrete_are
from scipy.optimize import brentq

A, B, C = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
ONES = np.ones((2, 2))
WEIGHTS = (1.0, 10.0, 100.0, 1000.0)                # values of q, and of sigma
CASES = ((10.0, 10.0), (100.0, 100.0), (100.0, 1.0), (1.0, 100.0), (1000.0, 10.0))   # q and sigma
Q = 100.0                       # q and sigma of the recovery and of the node
ADDED = np.logspace(1, 8, 15)   # process noise q_a of the figure
PERIOD = 0.002                  # [s] of the node


def find_gain_interval(f: float, L: Array) -> tuple[float, float]:
    """
    Return the interval of gains m of the plant, around 1, in which the loop is stable.

    By the criterion of Hurwitz for the characteristic polynomial s^4 + a3 s^3 + a2 s^2 + a1 s +
    a0, whose a1 and a0 are affine in m. K = f (1, 1), L (2,) is the gain of the filter.
    """
    l1, l2 = map(float, L)   # NumPy numbers times a poly1d would be arrays
    a3, a2 = l1 + f - 4.0, 6.0 - 3.0 * (l1 + f) + l1 * f + f + l2
    a1 = np.poly1d([f * (l1 + l2), 3.0 * (l1 + f) - 4.0 - 2.0 * (l1 * f + f + l2)])   # of m
    a0 = np.poly1d([-f * l1, 1.0 - l1 + l1 * f + l2])
    last = a3 * a2 * a1 - a1 * a1 - a3**2 * a0
    edges = np.real([*a1.roots, *a0.roots, *(each for each in last.roots if each.imag == 0.0)])
    return float(edges[edges < 1.0].max()), float(edges[edges > 1.0].min())


def find_whole_state_margins(f: float) -> tuple[float, float]:
    """
    Return the smallest gain m and the phase margin [rad] of K = f (1, 1) with the whole state.

    The loop f s/(s - 1)^2 is stable for m > 2/f. Its magnitude is 1 at both roots of
    w^2 - f w + 1 = 0, where its argument is pi/2 + 2 atan(w) and has the same distance from pi.
    """
    return 2.0 / f, 2.0 * atan(0.5 * (f + sqrt(f * f - 4.0))) - 0.5 * pi


def estimation_3(desk: Desk) -> EntryResult:
    """Compare Doyle's example, its margins and their recovery with closed forms."""
    gains = 2.0 + np.sqrt(4.0 + np.array(WEIGHTS))
    designs = desk.design_all([
        {'A': A, 'B': B, 'Qx': q * ONES, 'Qu': [1.0]} for q in WEIGHTS])
    filters = [lqe(A, C, q * ONES, [[1.0]]) for q in WEIGHTS]
    pairs = [(2.0 + sqrt(4.0 + q), 2.0 + sqrt(4.0 + s)) for q, s in CASES]
    loops = [combine(lqr(A, B, q * ONES, [[1.0]]), lqe(A, C, s * ONES, [[1.0]]))
             for q, s in CASES]
    regulator = lqr(A, B, Q * ONES, [[1.0]])
    recovered = recover_loop_transfer(regulator, C, Q * ONES, np.eye(1))
    f = 2.0 + sqrt(4.0 + Q)
    wanted = solve_continuous_are(A.T, C.T, Q * ONES + recovered.q * B @ B.T, [[1.0]])[:, 0]
    answer = _ask_node(desk, f)
    sampled = [_sampled_interval(f, Qw) for Qw in (
        Q * ONES, np.reshape(answer.qw, (2, 2)))] + [_sampled_interval(f, None)]
    rows = [
        ComparedRow('$K$ for four $q$ from 1 to 1000', [each.K.ravel() for each in designs],
                    np.column_stack([gains, gains]), '$f[1, 1]$, $f = 2 + √(4 + q)$'),
        ComparedRow('$L$ for four $σ$', [each.L.ravel() for each in filters],
                    np.column_stack([gains, gains]), '$d[1, 1]^T$, $d = 2 + √(4 + σ)$'),
        ComparedRow('largest gain $m$ of the plant, five pairs of $q$ and $σ$',
                    [each.figures.gain_margin[0] for each in loops],
                    [1.0 + 1.0 / (f_ * d) for f_, d in pairs], '$1 + 1/(fd)$'),
        ComparedRow('smallest gain $m$',
                    [each.figures.gain_reduction_margin[0] for each in loops],
                    [find_gain_interval(f_, np.array([d, d]))[0] for f_, d in pairs],
                    'criterion of Hurwitz, a quadratic equation in $m$'),
        ComparedRow('smallest gain with the whole state',
                    [each.full_state.gain_reduction_margin[0] for each in loops],
                    [2.0 / f_ for f_, _ in pairs], '$2/f$'),
        ComparedRow('phase margin with the whole state [rad]',
                    [each.full_state.phase_margin[0] for each in loops],
                    [find_whole_state_margins(f_)[1] for f_, _ in pairs],
                    '$L(iω) = fiω/(iω - 1)^2$'),
        ComparedRow(f'$q = σ = {Q:g}$, recovered: $L$', recovered.loop.estimator.L.ravel(),
                    wanted, 'SciPy, `solve_continuous_are`'),
        ComparedRow('the same: smallest and largest gain $m$',
                    [recovered.loop.figures.gain_reduction_margin[0],
                     recovered.loop.figures.gain_margin[0]], find_gain_interval(f, wanted),
                    'criterion of Hurwitz'),
        ComparedRow('`estimator_node`: smallest gain of the sampled loop, before, after, and with '
                    'the whole state', answer.gain_reduction_margin,
                    [low for low, _ in sampled], 'spectral radius of the loop'),
        ComparedRow('the same: largest gain', answer.gain_margin, [high for _, high in sampled],
                    'spectral radius of the loop')]
    before, after, whole = np.degrees(answer.phase_margin)
    return EntryResult(rows, _draw(loops, regulator, recovered.loop), (
        'Above: the right-most pole of the loop over the gain $m$ of the plant, whose nominal '
        'value is 1; and the interval of stable $m$ over $q = σ$, which shrinks to the point 1. '
        'With the whole state every $m > 2/f$ is stable. Below, left: Nyquist curves of the loop, '
        'opened at the input of the plant. Right: with process noise $σ[[1, 1], [1, 1]] + q_a '
        'BB^T$ the interval grows with $q_a$ and tends to that of the whole state.',
        f'`estimator_node`, sampled every {1e3 * PERIOD:g} ms, suggests adding '
        f'{answer.added:.0f} $BB^T$: the phase margin grows from {before:.3g} to {after:.3g} '
        f'degrees. With the whole state it is {whole:.3g} degrees.'))


def _ask_node(desk: Desk, f: float) -> SuggestNoise.Response:
    return ask_estimator(desk, {
        'system': 'linear', 'system_parameters.A': A.ravel(), 'system_parameters.B': B.ravel(),
        'outputs': ['x1'], 'Qw': np.full(4, Q), 'Rv': [1.0 / PERIOD, 1.0],
        'sample_time': PERIOD}, SuggestNoise.Request(k=[f, f]))


def _sampled_interval(f: float, Qw: Array | None) -> tuple[float, float]:
    """Return the stable gains of the sampled loop with a filter, or with the whole state."""
    held = expm(PERIOD * np.block([[A, B], [np.zeros((1, 3))]]))
    Ad, Bd, K = held[:2, :2], held[:2, 2:], f * np.ones((1, 2))
    # The loop is fixed + m scaled.
    if Qw is None:
        fixed, scaled = Ad, -Bd @ K
    else:   # states: x, and the estimate before a measurement
        Qd, R = sample_noise(A, Qw, PERIOD)[1], np.array([[1.0 / PERIOD]])
        P = solve_discrete_are(Ad.T, C.T, Qd, R)
        M, zero = P @ C.T @ np.linalg.inv(C @ P @ C.T + R), np.zeros((2, 2))
        estimate = np.hstack([M @ C, np.eye(2) - M @ C])
        fixed = np.block([[Ad, zero], [(Ad - Bd @ K) @ estimate]])
        scaled = np.vstack([-Bd @ K @ estimate, np.zeros((2, 4))])

    def find_growth(m: float) -> float:
        return float(abs(np.linalg.eigvals(fixed + m * scaled)).max() - 1.0)

    grid = np.concatenate([1.0 - np.logspace(-6, -1e-6, 400), 1.0 + np.logspace(-6, 4, 800)])
    found = []
    for side in (grid[:400], grid[400:]):
        stable, unstable = 1.0, side[np.argmax([find_growth(m) >= 0.0 for m in side])]
        found.append(brentq(find_growth, stable, unstable, xtol=1e-13, rtol=1e-14))
    return found[0], found[1]


def _draw(loops: list[OutputFeedback], regulator: LqrDesign, recovered: OutputFeedback) -> Figure:
    figure, ((poles, margins), (nyquist, recovery)) = create_panels(2, 2, 3.5)
    _draw_poles(poles)
    _draw_margins(margins, loops)
    _draw_nyquist(nyquist, regulator, recovered.estimator)
    _draw_recovery(recovery, regulator)
    return figure


def _draw_poles(axes: Any) -> None:
    """Draw the right-most pole over the gain of the plant."""
    m = np.linspace(0.85, 1.1, 201)
    for index, q in enumerate((10.0, 100.0, 1000.0)):
        f = 2.0 + sqrt(4.0 + q)
        right = [np.linalg.eigvals(np.block([
            [A, -each * f * B @ np.ones((1, 2))],
            [f * np.ones((2, 1)) @ C, A - f * B @ np.ones((1, 2)) - f * np.ones((2, 1)) @ C]])
        ).real.max() for each in m]
        axes.plot(m, right, label=rf'$q = \sigma = {q:g}$', **get_line(index))
    axes.axhline(0, color='black', linewidth=1)
    axes.axvline(1, **THIN)
    axes.set(xlim=(m[0], m[-1]), ylim=(-0.4, 0.4))
    label_axes(axes, 'right-most pole', 'gain $m$ of the plant', 'real part [s$^{-1}$]',
               legend='lower left')


def _draw_margins(axes: Any, loops: list[OutputFeedback]) -> None:
    """Draw the interval of stable gains over q = sigma."""
    grid = np.logspace(0, 4, 100)
    gains = [2.0 + sqrt(4.0 + q) for q in grid]
    ends = np.array([find_gain_interval(f, np.array([f, f])) for f in gains])
    axes.loglog(grid, ends[:, 1] - 1.0, label='closed form', **EXACT_LINE)
    axes.loglog(grid, 1.0 - ends[:, 0], **EXACT_LINE)
    same = [(q, each) for (q, s), each in zip(CASES, loops, strict=True) if q == s]
    axes.loglog([q for q, _ in same], [each.figures.gain_margin[0] - 1 for _, each in same],
                'o', color=LINE_COLOURS[0], label=r'upwards, $m - 1$')
    axes.loglog([q for q, _ in same],
                [1 - each.figures.gain_reduction_margin[0] for _, each in same],
                's', color=LINE_COLOURS[1], label=r'downwards, $1 - m$')
    label_axes(axes, 'change of gain that is stable', r'$q = \sigma$', '$|m - 1|$',
               legend='lower left')


def _draw_nyquist(axes: Any, regulator: LqrDesign, recovered: KalmanDesign) -> None:
    """Draw the loop with the whole state, with Doyle's filter, and recovered."""
    w = np.logspace(-3, 4, 4000)
    K, f = regulator.K, float(regulator.K[0, 0])
    lines = (('whole state', f * 1j * w / (1j * w - 1.0)**2),
             (r'$\sigma = 100$', _respond(K, np.array([[f], [f]]), w)),
             ('recovered', _respond(K, recovered.L, w)))
    for index, (text, loop) in enumerate(lines):
        axes.plot(loop.real, loop.imag, label=text, **get_line(index))
    axes.plot(-1, 0, '+', color='black', markersize=12, markeredgewidth=2)
    angle = np.linspace(0, 2 * pi, 100)
    axes.plot(-1 + np.cos(angle), np.sin(angle), **THIN)
    axes.set(xlim=(-4.6, 3.4), ylim=(-3.2, 3.2), aspect='equal')
    label_axes(axes, 'Nyquist curve at the input', 'real part', 'imaginary part',
               legend='upper right')


def _respond(K: Array, L: Array, w: Array) -> Complex:
    """Return the response of K (s I - A + B K + L C)^-1 L C (s I - A)^-1 B at s = i w."""
    s = 1j * w[:, None, None] * np.eye(2)
    plant = C @ np.linalg.solve(s - A, np.broadcast_to(B, (len(w), 2, 1)))
    filter_ = K @ np.linalg.solve(s - (A - B @ K - L @ C), np.broadcast_to(L, (len(w), 2, 1)))
    return np.asarray((filter_ @ plant)[:, 0, 0])


def _draw_recovery(axes: Any, regulator: LqrDesign) -> None:
    """Draw the interval of stable gains over the added noise."""
    f, found = float(regulator.K[0, 0]), []
    loops = [combine(regulator, lqe(A, C, Q * ONES + q * B @ B.T, [[1.0]])) for q in ADDED]
    for q in ADDED:
        found.append(find_gain_interval(f, solve_continuous_are(
            A.T, C.T, Q * ONES + q * B @ B.T, [[1.0]])[:, 0]))
    ends = np.array(found)
    axes.loglog(ADDED, ends[:, 1], label='Hurwitz', **EXACT_LINE)
    axes.loglog(ADDED, ends[:, 0], **EXACT_LINE)
    axes.loglog(ADDED, [each.figures.gain_margin[0] for each in loops], 'o',
                color=LINE_COLOURS[0], label='largest $m$')
    axes.loglog(ADDED, [each.figures.gain_reduction_margin[0] for each in loops], 's',
                color=LINE_COLOURS[1], label='smallest $m$')
    axes.axhline(2.0 / f, label='whole state, $2/f$', **THIN)
    label_axes(axes, rf'recovery, $q = \sigma = {Q:g}$', 'added noise $q_a$',
               'stable gains $m$', legend='upper left')


ESTIMATION_3 = GalleryEntry(
    'estimation-3', 'An estimator may leave no margins',
    'J. C. Doyle, Guaranteed margins for LQG regulators, IEEE Trans. Automatic Control 23, 1978', (
        "$x' = [[1, 1], [0, 1]]x + [0, 1]^T u + [1, 1]^T w$, $y = x_1 + v$ with the weights "
        '$Q_x = q[1, 1]^T[1, 1]$, $Q_u = 1$ and the intensities $σ$ of $w$ and 1 of $v$. The '
        'gains are $K = f[1, 1]$, $f = 2 + √(4 + q)$ and $L = d[1, 1]^T$, $d = 2 + √(4 + σ)$. Let '
        'the plant have the gain $m$ in place of 1. The characteristic polynomial ends with '
        '$(d + f - 4 + 2(m - 1)df)s + 1 + (1 - m)df$. The loop is unstable for $m > 1 + 1/(df)$ '
        'and for $m < 1 - (d + f - 4)/(2df)$: for large $q$ and $σ$ there is no margin.',
        'Doyle and Stein (1979) recover the margins of the whole state by process noise '
        '$q_a BB^T$ in the design of the filter (loop transfer recovery).'),
    estimation_3, in_book=False)
