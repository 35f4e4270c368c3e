# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Exercise 2.10: lateral control of a vehicle; a step, its frequency response, a slalom."""

from math import acos, atan, exp, pi, sqrt
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray
from obc_ros.cli.figures import COLOURS, THIN
from obc_ros.cli.gallery_entries.desk import Desk, Regulator
from obc_ros.cli.gallery_entries.drawing import describe, EXACT, panels
from obc_ros.cli.gallery_entries.entry import Answer, Entry, Row
from obc_ros.cli.gallery_entries.exact import simulated_loop
from obc_ros.cli.gallery_entries.loop import Run
from obc_ros.msg import Trajectory
from obc_ros.nodes.messages import doubles
from scipy.optimize import brentq

Array = NDArray[np.float64]

SPEED, LENGTH = 10.0, 2.0  # [m/s], [m]
RHO = 25.0  # Q_x = diag(1, 0): omega0^2 = v^2 / (l sqrt(rho)) = 10
STEP, DURATION = 0.005, 3.0  # [s]
AMPLITUDE, RATE, BEGIN, COURSE = 1.0, 2 * pi, 0.5, 5.0  # [m], [rad/s], [s], [s]
A = np.array([[0.0, SPEED], [0.0, 0.0]])
B = np.array([[0.0], [SPEED / LENGTH]])
OMEGA0 = sqrt(SPEED**2 / LENGTH / sqrt(RHO))  # [rad/s]; zeta is 1 / sqrt(2)
GAIN = np.array([[1 / sqrt(RHO), sqrt(2 * LENGTH / sqrt(RHO))]])


def slalom(t: Array) -> tuple[Array, Array]:
    """
    Return the states (y, theta) and the steering phi on y = sin(2 pi t), by flatness.

    theta = asin(y' / v), phi = atan(l theta' / v).
    """
    y = AMPLITUDE * np.sin(RATE * t)
    dy, ddy = AMPLITUDE * RATE * np.cos(RATE * t), -RATE**2 * y
    turn = ddy / np.sqrt(SPEED**2 - dy**2)
    return np.column_stack([y, np.arcsin(dy / SPEED)]), np.arctan(LENGTH * turn / SPEED)


def exercise_2_10(desk: Desk) -> Answer:
    """Answer Exercise 2.10, (a) and (b)."""
    design, = desk.design_all([{'system': 'vehicle_lateral', 'Qx': [1.0, 0.0], 'Qu': [RHO]}])
    t = STEP * np.arange(round(COURSE / STEP) + 1)
    x, phi = slalom(t)
    reference = Trajectory(t=doubles(t), x=doubles(x.ravel()), u=doubles(phi),
                           interpolation='linear')
    reference.header.stamp.nanosec = round(BEGIN * 1e9)
    with desk.loop('lateral', {
            'system': 'vehicle_lateral', 'x0': [0.0, 0.0], 'publish_rate': 1 / STEP}, {
            'system': 'linear', 'system_parameters.A': A, 'system_parameters.B': B,
            'setpoint': [1.0, 0.0], 'Qx': [1.0, 0.0], 'Qu': [RHO]}) as loop:
        step = loop.run(DURATION)
        loop.set(setpoint=[0.0, 0.0])
        driven = loop.run(BEGIN + COURSE - STEP, reference)
    wanted = simulated_loop(_rate, lambda _, at: -GAIN @ (at - [1.0, 0.0]), [0.0, 0.0], STEP,
                            len(step.t) - 1)
    followed = simulated_loop(_rate, _following, [0.0, 0.0], STEP, len(driven.t) - 1)
    message, crossover = design.message, OMEGA0 * sqrt(1 + sqrt(2))
    rows = [
        Row('(a) $K$', design.K, GAIN, '$[1/√ρ, √(2l/√ρ)]$'),
        Row('(a) overshoot', message.overshoot[0], exp(-pi), '$e^{-πζ/√(1-ζ^2)}$, $ζ = 1/√2$'),
        Row('(a) rise time, 10 to 90 % [s]', message.rise_time[0], _rise_time(),
            'the step response of second order'),
        Row('(a) gain crossover [rad/s]', message.bandwidth[0], crossover, '$ω_0 √(1 + √2)$'),
        Row('(a) bandwidth, $|T| = 1/√2$ [rad/s]', _bandwidth(design.K), OMEGA0,
            '$ω_0 = √(v^2/l√ρ)$'),
        Row('(a) phase margin [rad]', message.phase_margin[0],
            atan(sqrt(2 * (1 + sqrt(2)))), '$atan √(2 + 2√2)$ = 65.5 degrees'),
        Row('(a) step of the vehicle: $y$, $θ$', step.x, wanted[0], 'Dormand-Prince 8(5,3)'),
        Row('(a) step of the vehicle: $φ$ [rad]', step.u, wanted[1][step.heard],
            'Dormand-Prince 8(5,3)'),
        Row('(b) slalom: $y$, $θ$', driven.x, followed[0], 'Dormand-Prince 8(5,3)'),
        Row('(b) slalom: $φ$ [rad]', driven.u, followed[1][driven.heard],
            'Dormand-Prince 8(5,3)')]
    error = driven.x[:, 0] - AMPLITUDE * np.sin(RATE * np.maximum(driven.t - BEGIN, 0))
    settled = np.abs(error[driven.t > BEGIN + 3.0]).max()
    return Answer(rows, _draw(design, step, driven, error), (
        f'(a) $Q_x = diag(1, 0)$, $Q_u = {RHO:g}$: $ω_0 = {OMEGA0:.3f}$ rad/s, $ζ = 0.707$. '
        f'Overshoot {100 * message.overshoot[0]:.2f} %, rise time {message.rise_time[0]:.3f} s, '
        f'crossover at {message.bandwidth[0]:.3f} rad/s, bandwidth {OMEGA0:.3f} rad/s, phase '
        f'margin {np.degrees(message.phase_margin[0]):.1f} degrees. The loop is broken at the '
        'steering.',
        "(b) $u = φ_d(t) - K (x - x_d(t))$, where $θ_d = asin(r'/v)$ and "
        "$φ_d = atan(l θ_d'/v)$ follow from $r(t)$ by flatness. The course is published as "
        '`reference`; it begins at 0.5 s, when the vehicle still stands straight. Three seconds '
        f'later the error is at most {1e3 * settled:.1f} mm, what holding the steering for '
        f'{1e3 * STEP:g} ms leaves.'))


def _rate(x: Array, u: Array) -> list[Any]:
    return [SPEED * np.sin(x[1]), SPEED / LENGTH * np.tan(u[0])]


def _following(t: float, x: Array) -> Array:
    if t < BEGIN - 1e-9:
        return -GAIN @ x
    wanted, phi = slalom(np.array([t - BEGIN]))
    law: Array = phi - GAIN @ (x - wanted[0])
    return law


def _rise_time() -> float:
    """Return the 10 to 90 % rise time [s] of a second-order step with zeta = 1 / sqrt(2)."""
    w = OMEGA0 / sqrt(2)

    def above(t: float, level: float) -> float:
        return 1 - level - exp(-w * t) * (np.cos(w * t) + np.sin(w * t))

    top = acos(-1.0) / w  # the first maximum
    return float(brentq(above, 0, top, (0.9,), 1e-14) - brentq(above, 0, top, (0.1,), 1e-14))


def _bandwidth(K: Array) -> float:
    def above(w: float) -> float:
        return float(np.abs(_closed(K, np.array([w]))[0]) - 1 / sqrt(2))

    return float(brentq(above, 0.1, 50.0, xtol=1e-13))


def _open(K: Array, w: Array) -> Any:
    """Return the loop transfer function K (jw - A)^-1 B."""
    s = 1j * w
    return K[0, 1] * B[1, 0] / s + K[0, 0] * SPEED * B[1, 0] / s**2


def _closed(K: Array, w: Array) -> Any:
    """Return the transfer function from r to y."""
    s = 1j * w
    a0 = K[0, 0] * SPEED * B[1, 0]
    return a0 / (s**2 + K[0, 1] * B[1, 0] * s + a0)


def _draw(design: Regulator, step: Run, driven: Run, error: Array) -> Figure:
    figure, ((response, steering, magnitude), (course, away, phase)) = panels(2, 3, 3.1)
    t = np.linspace(0, DURATION, 300)
    w = OMEGA0 / sqrt(2)
    response.plot(step.t, step.x[:, 0], color=COLOURS[0], label='the vehicle')
    response.plot(t, 1 - np.exp(-w * t) * (np.cos(w * t) + np.sin(w * t)), label='linear', **EXACT)
    response.axhline(1, **THIN)
    describe(response, '(a) step of $y_d$ by 1 m', 'time $t$ [s]', 'position $y$ [m]',
             legend='lower right')
    steering.plot(step.tu, step.u[:, 0], color=COLOURS[1], drawstyle='steps-post', label='step')
    steering.plot(driven.tu, driven.u[:, 0], color=COLOURS[2], linewidth=1,
                  drawstyle='steps-post', label='slalom')
    describe(steering, 'steering', 'time $t$ [s]', '$\\phi$ [rad]')
    steering.set_ylim(-0.8, 1.0)
    steering.legend(loc='upper right', ncols=2)
    frequency = np.logspace(-1, 2, 300)
    loop, closed = _open(design.K, frequency), _closed(design.K, frequency)
    crossover, margin = design.message.bandwidth[0], design.message.phase_margin[0]
    for axes, values in ((magnitude, (20 * np.log10(np.abs(loop)), 20 * np.log10(np.abs(closed)))),
                         (phase, (np.degrees(np.unwrap(np.angle(loop))),
                                  np.degrees(np.unwrap(np.angle(closed)))))):
        axes.semilogx(frequency, values[0], color=COLOURS[0], label='loop $L$')
        axes.semilogx(frequency, values[1], '--', color=COLOURS[1], label='$r$ to $y$')
        axes.axvline(crossover, **THIN)
    magnitude.axhline(0, **THIN)
    magnitude.set_ylim(-60, 60)
    phase.axhline(-180, **THIN)
    phase.annotate('', (crossover, -180), (crossover, np.degrees(margin) - 180),
                   arrowprops={'arrowstyle': '<->', 'color': COLOURS[3]})
    phase.text(1.15 * crossover, -165, f'{np.degrees(margin):.1f}°', color=COLOURS[3])
    phase.set_yticks([-180, -135, -90, -45, 0])
    describe(magnitude, '(a) frequency response', 'frequency [rad/s]', 'magnitude [dB]',
             legend=True)
    describe(phase, '(a) phase and its margin', 'frequency [rad/s]', 'phase [deg]',
             legend='upper right')
    course.plot(driven.t, driven.x[:, 0], color=COLOURS[2], label='the vehicle')
    course.plot(driven.t, np.where(
        driven.t < BEGIN, np.nan, AMPLITUDE * np.sin(RATE * (driven.t - BEGIN))),
        label='$r(t)$', **EXACT)
    course.set_ylim(-1.5, 1.6)
    describe(course, '(b) slalom, 1 m, 1 Hz', 'time $t$ [s]', 'position $y$ [m]')
    course.legend(loc='upper center', ncols=2)
    away.semilogy(driven.t, np.maximum(np.abs(error), 1e-6), color=COLOURS[2])
    away.set_ylim(1e-4, 2)
    describe(away, '(b) tracking error', 'time $t$ [s]', '$|y - r|$ [m]')
    return figure


EXERCISE_2_10 = Entry(
    'exercise-2.10', 'Lateral control of a vehicle', 'Exercise 2.10', (
        "$y' = v_d sin θ$, $θ' = (v_d/l) tan φ$ with $v_d = 10$ m/s, $l = 2$ m. (a) Design a "
        'regulator to $y_d = 0$; step and frequency response; overshoot, rise time, bandwidth and '
        'phase margin. (b) Track $y_d = r(t)$ on a slalom of 1 m and 1 Hz.',),
    exercise_2_10)
