# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The Kalman filter of a double integrator with its position measured; the alpha-beta filter."""

from math import sqrt
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import EXACT_LINE, get_line, LINE_COLOURS
from obc_ros.book.drawing import create_panels, draw_pole_pairs, label_axes
from obc_ros.book.entry import ComparedRow, EntryResult, GalleryEntry
from obc_ros.book.next_chapters.node_runs import EstimatedRun, run_estimator
from obc_ros.book.references import (
    run_filter,
    sample_noise,
    solve_tracking_filter,
)
from obc_ros.book.runner import Desk
from obc_ros.core.estimation.kalman_gain import dlqe, KalmanDesign, lqe
from obc_ros.core.numerics.arrays import Array
from scipy.linalg import solve_discrete_are

A, C = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[1.0, 0.0]])
RATIOS = (1e-2, 0.1, 1.0, 4.0, 16.0, 100.0)        # q/r [1/s^4]
INDICES = (0.01, 0.1, 0.3, 1.0, 3.0, 10.0)         # tracking indices
# The run: a body at 1 m/s, its position measured at 20 Hz.
Q, DEVIATION, RATE, COUNT = 0.01, 0.2, 20.0, 200


def build_covariance(omega: float) -> Array:
    """Return P of the filter in continuous time with r = 1 and (q/r)^(1/4) = omega."""
    return np.array([[sqrt(2.0) * omega, omega**2], [omega**2, sqrt(2.0) * omega**3]])


def estimation_2(desk: Desk) -> EntryResult:
    """Compare filters of the double integrator with closed forms."""
    filters = [lqe(A, C, np.diag([0.0, q]), [[1.0]]) for q in RATIOS]
    omega = np.array(RATIOS)**0.25
    duals = desk.design_all([{'A': A.T, 'B': C.T, 'Qx': [0.0, q], 'Qu': [1.0]} for q in RATIOS])
    trackers = [_design_tracker(index) for index in INDICES]
    kalata = np.array([solve_tracking_filter(index) for index in INDICES])
    Rv = np.array([[DEVIATION**2]])
    run = run_estimator(desk, {
        'system': 'double_integrator', 'x0': [0.0, 1.0], 'publish_rate': RATE,
        'measurement.x1.rate': RATE, 'measurement.x1.noise': DEVIATION}, {
        'system': 'double_integrator', 'outputs': ['x1'], 'Qw': [0.0, Q],
        'Rv': [DEVIATION**2, 1.0], 'x0_deviation': [1.0], 'gate': 1.0, 'rate': 0.0,
        'sample_time': 1.0 / RATE}, COUNT)
    again = run_filter(A, C, np.diag([0.0, Q]), Rv, run.t, run.y, run.x[0], run.P[0])
    Ad, Qd = sample_noise(A, np.diag([0.0, Q]), 1.0 / RATE)
    before = solve_discrete_are(Ad.T, C.T, Qd, Rv)
    after = np.linalg.inv(np.linalg.inv(before) + C.T @ C / DEVIATION**2)
    rows = [
        ComparedRow('gain $L$ of `lqe` for six $q/r$', [each.L.ravel() for each in filters],
                    np.column_stack([sqrt(2.0) * omega, omega**2]), '$[√2 ω, ω^2]$'),
        ComparedRow('covariance $P$', [each.P for each in filters],
                    [build_covariance(each) for each in omega], '$r[[√2 ω, ω^2], [ω^2, √2 ω^3]]$'),
        ComparedRow('natural frequency of the filter [rad/s]',
                    [abs(each.E[0]) for each in filters], omega, '$ω = (q/r)^{1/4}$'),
        ComparedRow('damping ratio $ζ$', [-each.E[0].real / abs(each.E[0]) for each in filters],
                    np.full(len(RATIOS), 1 / sqrt(2)), '$1/√2$'),
        ComparedRow('crossover frequency of the filter [rad/s]',
                    [each.bandwidth[0] for each in filters], omega * sqrt(1 + sqrt(2)),
                    '$ω √(1 + √2)$'),
        ComparedRow('$K$ of the regulator for $(A^T, C^T, Q_w, R_v)$',
                    [each.K.ravel() for each in duals],
                    np.column_stack([sqrt(2.0) * omega, omega**2]), '$L^T$, duality'),
        ComparedRow('$α, β$ of `dlqe` for six tracking indices',
                    [each.M.ravel() for each in trackers], kalata, 'Kalata 1984'),
        ComparedRow(f'`estimator_node`: covariance after {COUNT} measurements', run.P[-1],
                    after, 'SciPy, `solve_discrete_are`'),
        ComparedRow('`estimator_node`: covariance after each measurement', run.P, again[1],
                    'information form'),
        ComparedRow('`estimator_node`: position and velocity', run.x, again[0],
                    'recursion with the same measurements')]
    return EntryResult(rows, _draw(filters, trackers, run), (
        'Above: the gain depends on $ω$ only. The poles of the filter are on two rays: the '
        'damping ratio is the same for every $q/r$. This is the dual of Example 2.4. Below, left: '
        'the acceleration is constant in each period $h$ and has the standard deviation $σ_w$. '
        'The measurements have the standard deviation $σ_v$. The gain of the sampled filter is '
        '$(α, β/h)$; $α$ and $β$ depend on the tracking index $σ_w h^2/σ_v$ only. Right: a body '
        'has a constant velocity of 1 m/s, which is not measured. Its position is measured 20 '
        'times a second.',))


def _design_tracker(index: float) -> KalmanDesign:
    """Return the filter of a tracking index, with h = 1 s and sigma_v = 1 m."""
    push = index * np.array([[0.5], [1.0]])
    return dlqe([[1.0, 1.0], [0.0, 1.0]], C, push @ push.T, [[1.0]])


def _draw(filters: list[KalmanDesign], trackers: list[KalmanDesign], run: EstimatedRun) -> Figure:
    figure, ((gains, plane), (tracking, time)) = create_panels(2, 2, 3.4)
    grid = np.logspace(-2.3, 2.3, 100)
    omega = grid**0.25
    for index, (text, exact) in enumerate((
            (r'$L_1 = \sqrt{2}\,\omega$', sqrt(2) * omega), (r'$L_2 = \omega^2$', omega**2))):
        gains.loglog(grid, exact, **EXACT_LINE)
        gains.loglog(RATIOS, [each.L[index, 0] for each in filters], 'os'[index],
                     color=LINE_COLOURS[index], label=text)
    gains.plot([], [], label='closed form', **EXACT_LINE)
    label_axes(gains, 'gain', '$q/r$ [s$^{-4}$]', '$L_1$ [s$^{-1}$], $L_2$ [s$^{-2}$]',
               legend='upper left')
    texts = [f'$q/r = {q:g}$' if q >= 1 else '' for q in RATIOS]
    draw_pole_pairs(plane, zip((each.E for each in filters), texts, strict=True),
                    r'poles $\omega\,(-1 \pm i)/\sqrt{2}$')
    _draw_tracking(tracking, trackers)
    _draw_run(time, run)
    return figure


def _draw_tracking(axes: Any, trackers: list[KalmanDesign]) -> None:
    """Draw the gains of the alpha-beta filter over the tracking index."""
    grid = np.logspace(-2.3, 1.3, 100)
    exact = np.array([solve_tracking_filter(float(each)) for each in grid])
    for index, letter in enumerate(('alpha', 'beta')):
        axes.semilogx(grid, exact[:, index], **EXACT_LINE)
        axes.semilogx(INDICES, [each.M[index, 0] for each in trackers], 'os'[index],
                      color=LINE_COLOURS[index], label=rf'$\{letter}$')
    axes.plot([], [], label='Kalata', **EXACT_LINE)
    label_axes(axes, 'sampled: alpha-beta filter', r'tracking index $\sigma_w h^2/\sigma_v$',
               r'$\alpha$, $\beta$', legend='upper left')


def _draw_run(axes: Any, run: EstimatedRun) -> None:
    """Draw the estimated velocity with its 95 % band."""
    t, v = run.t - run.t[0], run.x[:, 1]
    half = 1.96 * np.sqrt(run.P[:, 1, 1])
    axes.fill_between(t, v - half, v + half, color=LINE_COLOURS[0], alpha=0.25, linewidth=0,
                      label='95 % band')
    axes.plot(t, v, label='estimate', **get_line(0))
    axes.plot(t, run.true[:, 1], label='velocity', **get_line(1))
    axes.set(xlim=(0, t[-1]), ylim=(0, 2))
    label_axes(axes, 'run: velocity from positions', 'time $t$ [s]', '$x_2$ [m/s]',
               legend='lower right')


ESTIMATION_2 = GalleryEntry(
    'estimation-2', 'A double integrator with its position measured',
    'P. R. Kalata, The tracking index, IEEE Trans. Aerospace and Electronic Systems 20, 1984', (
        "$x_1' = x_2$, $x_2' = w$, $y = x_1 + v$ with white noise of the intensities $q$ and $r$. "
        'With $ω = (q/r)^{1/4}$ the Riccati equation has the solution '
        '$P = r[[√2 ω, ω^2], [ω^2, √2 ω^3]]$, and the filter has the gain $L = [√2 ω, ω^2]$, the '
        'poles $ω(-1 ± i)/√2$ and the damping ratio $1/√2$.',),
    estimation_2, in_book=False)
