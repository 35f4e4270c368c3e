# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The scalar Kalman filter, in continuous time and sampled."""

from math import sqrt
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import EXACT_LINE, get_line, LINE_COLOURS, THIN
from obc_ros.book.drawing import create_panels, label_axes
from obc_ros.book.entry import ComparedRow, EntryResult, GalleryEntry
from obc_ros.book.next_chapters.node_runs import EstimatedRun, run_estimator
from obc_ros.book.references import (
    run_filter,
    solve_sampled_scalar_filter,
    solve_scalar_filter,
)
from obc_ros.book.runner import Desk
from obc_ros.core.estimation.kalman_gain import KalmanDesign, lqe, sampled_lqe

PLANTS = (-1.0, 0.0, 1.0)               # a [1/s]
NOISES = (0.01, 0.1, 0.5, 1.0, 4.0, 25.0)  # q for r = 1
PERIODS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)  # [s]
# The run: a stable plant, measured at 20 Hz, in a gust.
A, Q, DEVIATION, RATE, COUNT = -0.5, 0.3, 0.3, 20.0, 120
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
        'system': 'scalar', 'system_parameters.a': A, 'publish_rate': RATE,
        'measurement.x.rate': RATE, 'measurement.x.noise': DEVIATION, **GUST}, {
        'system': 'scalar', 'system_parameters.a': A, 'Qw': [Q], 'Rv': [DEVIATION**2],
        'x0_deviation': [2.0], 'gate': 1.0, 'rate': 0.0, 'sample_time': 1.0 / RATE}, COUNT)
    a, c, q, r = (np.array([[each]]) for each in (A, 1.0, Q, DEVIATION**2))
    again = run_filter(a, c, q, r, run.t, run.y, run.x[0], run.P[0])
    after = solve_sampled_scalar_filter(A, Q, DEVIATION**2, 1.0 / RATE)[1]
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
        ComparedRow(f'`estimator_node`: variance after {COUNT} measurements', run.P[-1].item(),
                    after, 'the same quadratic equation', relative=True),
        ComparedRow('`estimator_node`: variance after each measurement', run.P, again[1],
                    '$1/p$ grows by $1/R_v$ at a measurement'),
        ComparedRow('`estimator_node`: estimates', run.x, again[0],
                    'recursion with the same measurements')]
    return EntryResult(rows, _draw(cases, filters, sampled, run, after), (
        'Above: the larger $q/r$ is, the larger is the gain. Without process noise '
        'the gain of a stable plant tends to 0, that of an unstable plant to $2a$: its pole is '
        'the mirror image of the pole of the plant. Below, left: the same filter with one '
        'measurement of the variance $r/h$ in each period $h$. For $h → 0$ it is the filter in '
        'continuous time. Right: a run of `plant_simulator` and `estimator_node` with '
        f'$a = {A:g}$ and a measurement every {1e3 / RATE:g} ms. A gust takes the place of $w$.',))


def _draw(cases: list[tuple[float, float]], filters: list[KalmanDesign],
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
    _draw_run(time, run, after)
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


def _draw_run(axes: Any, run: EstimatedRun, after: float) -> None:
    """Draw the state, the measurements and the estimate with its 95 % band."""
    t, x = run.t - run.t[0], run.x[:, 0]
    half = 1.96 * np.sqrt(run.P[:, 0, 0])
    axes.fill_between(t, x - half, x + half, color=LINE_COLOURS[0], alpha=0.25, linewidth=0,
                      label='95 % band')
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
