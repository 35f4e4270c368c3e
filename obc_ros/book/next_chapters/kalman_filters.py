# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Kalman filters, in continuous time and sampled: of a scalar plant, and of a double integrator.

The sampled filter of a double integrator whose position is measured is the alpha-beta filter.
"""

from math import sqrt
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import EXACT_LINE, get_line, LINE_COLOURS, THIN
from obc_ros.book.entry import (
    ComparedRow,
    create_panels,
    draw_pole_pairs,
    EntryResult,
    GalleryEntry,
    label_axes,
)
from obc_ros.book.next_chapters.node_runs import EstimatedRun, run_estimator
from obc_ros.book.references import (
    run_filter,
    sample_noise,
    solve_sampled_scalar_filter,
    solve_scalar_filter,
    solve_tracking_filter,
)
from obc_ros.book.runner import Desk
from obc_ros.core.estimation.kalman_gain import dlqe, KalmanDesign, lqe, sampled_lqe
from obc_ros.core.numerics.arrays import Array
from scipy.linalg import solve_discrete_are

PLANTS = (-1.0, 0.0, 1.0)               # a [1/s]
NOISES = (0.01, 0.1, 0.5, 1.0, 4.0, 25.0)  # q for r = 1
PERIODS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)  # [s]
# The run: a stable plant, measured at 20 Hz, in a gust.
SCALAR_A, SCALAR_Q, SCALAR_DEVIATION, SCALAR_COUNT = -0.5, 0.3, 0.3, 120
RATE = 20.0   # [Hz] of the measurements of both runs
GUST = {'disturbance.gust.x': 2.0, 'disturbance.gust_start': 1.0,
        'disturbance.gust_duration': 2.0}


def estimation_1(desk: Desk) -> EntryResult:
    """Compare filters of a scalar plant with their closed forms."""
    cases = [(a, q) for a in PLANTS for q in NOISES]
    filters = [lqe([[a]], [[1.0]], [[q]], [[1.0]]) for a, q in cases]
    exact = np.array([solve_scalar_filter(a, q, 1.0) for a, q in cases])
    duals = desk.design_all([
        {'A': [[a]], 'B': [[1.0]], 'Qx': [q], 'Qu': [1.0]} for a, q in cases])
    sampled = [sampled_lqe([[1.0]], [[1.0]], [[1.0]], [[1.0 / h]], h) for h in PERIODS]
    wanted = np.array([solve_sampled_scalar_filter(1.0, 1.0, 1.0 / h, h) for h in PERIODS])
    run = run_estimator(desk, {
        'system': 'scalar', 'system_parameters.a': SCALAR_A, 'publish_rate': RATE,
        'measurement.x.rate': RATE, 'measurement.x.noise': SCALAR_DEVIATION, **GUST}, {
        'system': 'scalar', 'system_parameters.a': SCALAR_A, 'Qw': [SCALAR_Q],
        'Rv': [SCALAR_DEVIATION**2], 'x0_deviation': [2.0], 'gate': 1.0, 'rate': 0.0,
        'sample_time': 1.0 / RATE}, SCALAR_COUNT)
    a, c, q, r = (np.array([[each]]) for each in (SCALAR_A, 1.0, SCALAR_Q, SCALAR_DEVIATION**2))
    again = run_filter(a, c, q, r, run.t, run.y, run.x[0], run.P[0])
    after = solve_sampled_scalar_filter(SCALAR_A, SCALAR_Q, SCALAR_DEVIATION**2, 1.0 / RATE)[1]
    rows = [
        ComparedRow('variance $p$ of `lqe` for three $a$ and six $q/r$',
                    [each.P.item() for each in filters], exact[:, 0], '$r(a + √(a^2 + q/r))$'),
        ComparedRow('gain $L$ [1/s]', [each.L.item() for each in filters], exact[:, 1],
                    '$a + √(a^2 + q/r)$'),
        ComparedRow('pole of the filter [1/s]', [each.E.real.item() for each in filters],
                    exact[:, 2], '$-√(a^2 + q/r)$'),
        ComparedRow('$K$ of the regulator for $(A^T, C^T, Q_w, R_v)$',
                    [each.K.item() for each in duals], exact[:, 1], '$L$, duality'),
        ComparedRow('`sampled_lqe`: variance before a measurement, $h$ = 0.01 .. 3 s',
                    [each.P.item() for each in sampled], wanted[:, 0],
                    'quadratic equation of the sampled plant'),
        ComparedRow('the same after a measurement',
                    [each.P_filtered.item() for each in sampled], wanted[:, 1],
                    '$pR_v/(p + R_v)$'),
        ComparedRow(f'`estimator_node`: variance after {SCALAR_COUNT} measurements',
                    run.P[-1].item(), after, 'the same quadratic equation', relative=True),
        ComparedRow('`estimator_node`: variance after each measurement', run.P, again[1],
                    '$1/p$ grows by $1/R_v$ at a measurement'),
        ComparedRow('`estimator_node`: estimates', run.x, again[0],
                    'recursion with the same measurements')]
    return EntryResult(rows, _draw_scalar(cases, filters, sampled, run, after), (
        'Above: the larger $q/r$ is, the larger is the gain. Without process noise '
        'the gain of a stable plant tends to 0, that of an unstable plant to $2a$: its pole is '
        'the mirror image of the pole of the plant. Below, left: the same filter with one '
        'measurement of the variance $r/h$ in each period $h$. For $h → 0$ it is the filter in '
        'continuous time. Right: a run of `plant_simulator` and `estimator_node` with '
        f'$a = {SCALAR_A:g}$ and a measurement every {1e3 / RATE:g} ms. A gust takes the place '
        'of $w$.',))


def _draw_scalar(cases: list[tuple[float, float]], filters: list[KalmanDesign],
          sampled: list[KalmanDesign], run: EstimatedRun, after: float) -> Figure:
    figure, ((gains, poles), (periods, time)) = create_panels(2, 2, 3.4)
    grid = np.logspace(-2.3, 1.7, 200)
    for index, a in enumerate(PLANTS):
        mine = [(q, each) for (at, q), each in zip(cases, filters, strict=True) if at == a]
        q = [each for each, _ in mine]
        mark: dict[str, Any] = {'color': LINE_COLOURS[index], 'markersize': 6}
        gains.semilogx(q, [each.L.item() for _, each in mine], 'os^'[index],
                       label=f'$a = {a:g}$', **mark)
        poles.semilogx(q, [each.E.real.item() for _, each in mine], 'os^'[index], **mark)
        exact = np.array([solve_scalar_filter(a, float(each), 1.0) for each in grid])
        gains.semilogx(grid, exact[:, 1], **EXACT_LINE)
        poles.semilogx(grid, exact[:, 2], **EXACT_LINE)
    gains.plot([], [], label='closed form', **EXACT_LINE)
    label_axes(gains, r'gain $L = a + \sqrt{a^2 + q/r}$', '$q/r$ [s$^{-2}$]', '$L$ [s$^{-1}$]',
               legend='upper left')
    label_axes(poles, r'pole $-\sqrt{a^2 + q/r}$', '$q/r$ [s$^{-2}$]', 'pole [s$^{-1}$]')
    _draw_periods(periods, sampled)
    _draw_scalar_run(time, run, after)
    return figure


def _draw_periods(axes: Any, sampled: list[KalmanDesign]) -> None:
    """Draw the variances of a sampled filter over its period."""
    h = np.logspace(-2.1, 0.6, 200)
    exact = np.array([solve_sampled_scalar_filter(1.0, 1.0, 1.0 / each, each) for each in h])
    axes.loglog(h, exact[:, 0], **EXACT_LINE)
    axes.loglog(h, exact[:, 1], **EXACT_LINE)
    axes.loglog(PERIODS, [each.P.item() for each in sampled], 'o', color=LINE_COLOURS[0],
                label='before a measurement')
    axes.loglog(PERIODS, [each.P_filtered.item() for each in sampled], 's',
                color=LINE_COLOURS[1], label='after it')
    axes.axhline(1.0 + sqrt(2.0), label='continuous time', **THIN)
    axes.set_ylim(0.2, 1e3)
    label_axes(axes, 'sampled, $a = q = r = 1$', 'period $h$ [s]', 'variance $p$',
               legend='upper left')


def _draw_band(axes: Any, run: EstimatedRun, state: int) -> None:
    t, x, half = run.t - run.t[0], run.x[:, state], 1.96 * np.sqrt(run.P[:, state, state])
    axes.fill_between(t, x - half, x + half, color=LINE_COLOURS[0], alpha=0.25, linewidth=0,
                      label='95 % band')


def _draw_scalar_run(axes: Any, run: EstimatedRun, after: float) -> None:
    """Draw the state, the measurements and the estimate with its 95 % band."""
    t, x = run.t - run.t[0], run.x[:, 0]
    _draw_band(axes, run, 0)
    axes.plot(t, run.y[:, 0], '.', color='0.5', label='measurement')
    axes.plot(t, x, label=r'estimate $\hat x$', **get_line(0))
    axes.plot(t, run.true[:, 0], label='$x$', **get_line(1))
    axes.set(xlim=(0, t[-1]), ylim=(-1.2, 3.4))
    label_axes(axes, rf'run: $\sqrt{{p}}$ tends to {sqrt(after):.3f}', 'time $t$ [s]', '$x$',
               legend='upper left')


ESTIMATION_1 = GalleryEntry(
    'estimation-1', 'The scalar Kalman filter',
    'R. E. Kalman, R. S. Bucy, New results in linear filtering and prediction theory, 1961', (
        "$x' = ax + w$, $y = x + v$ with white noise $w$ and $v$ of the intensities $q$ and $r$. "
        'The Riccati equation $2ap - p^2/r + q = 0$ has the positive root '
        '$p = r(a + √(a^2 + q/r))$. '
        "The filter $x_e' = ax_e + L(y - x_e)$ has the gain $L = p/r$ and the pole "
        '$-√(a^2 + q/r)$.',
        'With one measurement of the variance $R_v$ in each period $h$, the variance of the '
        'estimate before a measurement is the positive root of '
        '$p^2 + (R_v - α^2 R_v - Q)p - QR_v = 0$ with $α = e^{ah}$ and $Q = q(α^2 - 1)/(2a)$, '
        '$a ≠ 0$.'),
    estimation_1, in_book=False)


A, C = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[1.0, 0.0]])
RATIOS = (1e-2, 0.1, 1.0, 4.0, 16.0, 100.0)        # q/r [1/s^4]
INDICES = (0.01, 0.1, 0.3, 1.0, 3.0, 10.0)         # tracking indices
# The run: a body at 1 m/s, its position measured at 20 Hz.
Q, DEVIATION, COUNT = 0.01, 0.2, 200


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
    t = run.t - run.t[0]
    _draw_band(axes, run, 1)
    axes.plot(t, run.x[:, 1], label='estimate', **get_line(0))
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
