# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Exercise 2.10: lateral control of a vehicle; step and frequency response, slalom."""

from math import acos, atan, exp, pi, sqrt
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import EXACT, get_line, LINE_COLOURS, THIN, WIDTH
from obc_ros.book.entry import ComparedRow, create_panels, EntryResult, GalleryEntry, label_axes
from obc_ros.book.loop import Run
from obc_ros.book.references import simulate_loop
from obc_ros.book.runner import AnsweredRegulator, Desk
from obc_ros.core.numerics.arrays import Array
from obc_ros.msg import Trajectory
from obc_ros.ros.messages import flatten_doubles
from scipy.optimize import brentq

SPEED, LENGTH = 10.0, 2.0  # [m/s], [m]
RHO = 25.0  # Q_x = diag(1, 0): omega0^2 = v^2 / (l sqrt(rho)) = 10
STEP, DURATION = 0.005, 3.0  # [s]
# The course is r(t) = cos(2 pi (t - BEGIN)) from BEGIN on; before, the vehicle drives straight on.
RATE, BEGIN, COURSE, SHOWN = 2 * pi, 0.5, 4.0, 4.0  # [rad/s], [s], [s], [s]
A = np.array([[0.0, SPEED], [0.0, 0.0]])
B = np.array([[0.0], [SPEED / LENGTH]])
OMEGA0 = sqrt(SPEED**2 / LENGTH / sqrt(RHO))  # [rad/s]; zeta is 1 / sqrt(2)
TOLERANCE = [3.0, 3.0]  # [m], [rad]: accepts every course below, inconsistent ones too
LAWS = {'flat': 'flat feedforward', 'linear': 'linear feedforward', 'none': 'feedback alone'}
GAIN = np.array([[1 / sqrt(RHO), sqrt(2 * LENGTH / sqrt(RHO))]])


def follow_slalom(t: Array) -> dict[str, tuple[Array, Array]]:
    """
    Return states (y, theta) and steering phi on y = r(t) = cos(2 pi t), for several control laws.

    Flatness gives theta = asin(r' / v) and phi = atan(l theta' / v).
    """
    r, dr, ddr = np.cos(RATE * t), -RATE * np.sin(RATE * t), -RATE**2 * np.cos(RATE * t)
    turn = ddr / np.sqrt(SPEED**2 - dr**2)
    return {
        'flat': (np.column_stack([r, np.arcsin(dr / SPEED)]), np.arctan(LENGTH * turn / SPEED)),
        'linear': (np.column_stack([r, dr / SPEED]), LENGTH * ddr / SPEED**2),
        'none': (np.column_stack([r, 0 * r]), 0 * r)}


def make_course(name: str) -> Trajectory:
    """Return the slalom as a reference."""
    t = STEP * np.arange(round(COURSE / STEP) + 1, dtype=float)
    x, phi = follow_slalom(t)[name]
    reference = Trajectory(t=flatten_doubles(t), x=flatten_doubles(x.ravel().round(15)),
                           u=flatten_doubles(phi.round(15)), interpolation='linear')
    reference.header.stamp.nanosec = round(BEGIN * 1e9)
    return reference


def exercise_2_10(desk: Desk) -> EntryResult:
    """Compute Exercise 2.10, (a) and (b)."""
    design, = desk.design_all([{'system': 'vehicle_lateral', 'Qx': [1.0, 0.0], 'Qu': [RHO]}])
    with desk.loop('lateral', {
            'system': 'vehicle_lateral', 'x0': [0.0, 0.0], 'publish_rate': 1 / STEP}, {
            'system': 'linear', 'system_parameters.A': A, 'system_parameters.B': B,
            'system_parameters.states': 'py, theta', 'system_parameters.inputs': 'phi',
            'setpoint': [1.0, 0.0], 'Qx': [1.0, 0.0], 'Qu': [RHO],
            'start_tolerance': TOLERANCE}) as loop:
        step = loop.run(DURATION)
        loop.set('plant_simulator', x0=[1.0, 0.0])
        driven = {name: loop.run(SHOWN, make_course(name), name) for name in LAWS}
        loop.set('plant_simulator', x0=[0.0, 0.0])
        loop.set(setpoint=[0.0, 0.0])
        driven['off'] = loop.run(SHOWN, make_course('flat'), 'flat')
    wanted = simulate_loop(_rate, lambda _, at: -GAIN @ (at - [1.0, 0.0]), [0.0, 0.0], STEP,
                           len(step.t) - 1)
    message, crossover = design.message, OMEGA0 * sqrt(1 + sqrt(2))
    rows = [
        ComparedRow('(a) $K$', design.K, GAIN, '$[1/√ρ, √(2l/√ρ)]$'),
        ComparedRow('(a) overshoot', message.overshoot[0], exp(-pi),
                    '$e^{-πζ/√(1-ζ^2)}$, $ζ = 1/√2$', relative=True),
        ComparedRow('(a) rise time, 10 to 90 % [s]', message.rise_time[0],
                    np.diff(_find_rise()).item(),
                    'the step response of second order', relative=True),
        ComparedRow('(a) gain crossover [rad/s]', message.bandwidth[0], crossover,
                    '$ω_0 √(1 + √2)$'),
        ComparedRow('(a) bandwidth, $|T| = 1/√2$ [rad/s]', _bandwidth(design.K), OMEGA0,
                    '$ω_0 = √(v^2/l√ρ)$'),
        ComparedRow('(a) phase margin [rad]', message.phase_margin[0],
                    atan(sqrt(2 * (1 + sqrt(2)))), '$atan √(2 + 2√2)$ = 65.5 degrees'),
        ComparedRow('(a) step of the vehicle: $y$, $θ$', step.x, wanted[0],
                    'Dormand-Prince 8(5,3)'),
        ComparedRow('(a) step of the vehicle: $φ$ [rad]', step.u, wanted[1],
                    'Dormand-Prince 8(5,3)')]
    for name, text in (*LAWS.items(), ('off', 'flat feedforward, start 1 m off')):
        x, u = _followed(name, len(driven[name].t) - 1)
        rows += [ComparedRow(f'(b) {text}: $y$, $θ$', driven[name].x, x, 'Dormand-Prince 8(5,3)'),
                 ComparedRow(f'(b) {text}: $φ$ [rad]', driven[name].u, u, 'Dormand-Prince 8(5,3)')]
    away = {name: run.x[:, 0] - evaluate_reference(run.t) for name, run in driven.items()}
    worst = {name: np.abs(error[driven[name].t > SHOWN - 1]).max() for name, error in away.items()}
    return EntryResult(rows, _draw(design, step), (
        f'(a) $Q_x = diag(1, 0)$, $Q_u = {RHO:g}$: $ω_0 = {OMEGA0:.3f}$ rad/s, $ζ = 0.707$. '
        f'Overshoot {100 * message.overshoot[0]:.2f} %, rise time {message.rise_time[0]:.3f} s, '
        f'crossover at {message.bandwidth[0]:.3f} rad/s, bandwidth {OMEGA0:.3f} rad/s, phase '
        f'margin {np.degrees(message.phase_margin[0]):.1f} degrees. The loop is broken at the '
        'steering. The regulator is designed for the linear model and drives the '
        'nonlinear model.',
        "(b) $u = φ_d - K (x - x_d)$, where $θ_d = asin(r'/v)$ and $φ_d = atan(l θ_d'/v)$ follow "
        'from $r(t)$ by flatness. The course is published as `reference`; it begins at 0.5 s. By '
        'default `lqr_node` rejects a course that begins 1 m off the state of the plant, or whose '
        'inputs do not drive the plant along it; `start_tolerance` allows both. The slalom is '
        'faster than the loop, whose bandwidth is half of 1 Hz: by feedback alone, '
        f'$x_d = (r, 0)$, $φ_d = 0$, the error reaches {worst["none"]:.2f} m; with the '
        f"feedforward of the linear model, $θ_d = r'/v$, $φ_d = l r''/v^2$, "
        f'{100 * worst["linear"]:.0f} cm; with the flat one {1e3 * worst["flat"]:.0f} mm, the '
        f'effect of a zero-order hold of {1e3 * STEP:g} ms. A start 1 m off the course is '
        'corrected within two seconds.'),
        more={'slalom': _draw_slalom(driven, away)})


def evaluate_reference(t: Array) -> Array:
    """Return r(t); before the course its first value."""
    return np.cos(RATE * np.maximum(t - BEGIN, 0.0))


def _followed(name: str, count: int) -> tuple[Array, Array]:
    """Return states and steering on the slalom, without the nodes."""
    start = np.array([0.0 if name == 'off' else 1.0, 0.0])

    def law(t: float, x: Array) -> Array:
        u: Array
        if t < BEGIN - 1e-9:
            u = -GAIN @ (x - start)
            return u
        (wanted,), phi = follow_slalom(np.array([t - BEGIN]))['flat' if name == 'off' else name]
        u = phi - GAIN @ (x - wanted)
        return u

    return simulate_loop(_rate, law, start, STEP, count)


def _rate(x: Array, u: Array) -> list[Any]:
    return [SPEED * np.sin(x[1]), SPEED / LENGTH * np.tan(u[0])]


def _find_rise() -> tuple[float, float]:
    """Return when a second-order step with zeta = 1 / sqrt(2) is at 10 % and at 90 % [s]."""
    w = OMEGA0 / sqrt(2)

    def above(t: float, level: float) -> float:
        return float(1 - level - exp(-w * t) * (np.cos(w * t) + np.sin(w * t)))

    top = acos(-1.0) / w  # the first maximum
    return brentq(above, 0, top, (0.1,), 1e-14), brentq(above, 0, top, (0.9,), 1e-14)


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


def _draw(design: AnsweredRegulator, step: Run) -> Figure:
    figure = Figure(figsize=(WIDTH, 6.4), layout='constrained')
    panels = figure.subplot_mosaic([['step', 'step'], ['magnitude', 'phase']])
    _draw_step(panels['step'], design, step)
    _draw_frequency(panels['magnitude'], panels['phase'], design)
    return figure


def _draw_step(axes: Axes, design: AnsweredRegulator, step: Run) -> None:
    t, w = np.linspace(0, DURATION, 300), OMEGA0 / sqrt(2)
    begin, end = _find_rise()
    overshoot = design.message.overshoot[0]
    axes.plot(step.t, step.x[:, 0], color=LINE_COLOURS[0], label='nonlinear model')
    axes.plot(t, 1 - np.exp(-w * t) * (np.cos(w * t) + np.sin(w * t)), label='linear model',
              **EXACT)
    axes.axhline(1, **THIN)
    for time, level in ((begin, 0.1), (end, 0.9)):
        axes.plot([time, time, 0], [0, level, level], **THIN)
    _draw_span(axes, (begin, 0.03), (end, 0.03))
    axes.text((begin + end) / 2, 0.06, f'rise time {design.message.rise_time[0]:.3f} s',
              ha='center', va='bottom')
    _draw_span(axes, (pi / w, 1.0), (pi / w, 1 + overshoot))
    axes.text(pi / w, 1.06, f'overshoot {100 * overshoot:.1f} %', ha='center', va='bottom')
    axes.set(xlim=(0, DURATION), ylim=(0, 1.2), yticks=[0, 0.1, 0.5, 0.9, 1])
    label_axes(axes, '(a) step of $y_d$ by 1 m', 'time $t$ [s]', 'position $y$ [m]',
               legend='lower right')


def _draw_span(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Draw the arrow of a distance between two points."""
    axes.annotate('', start, end, arrowprops={
        'arrowstyle': '<->', 'color': 'black', 'shrinkA': 0, 'shrinkB': 0})


def _draw_slalom(driven: dict[str, Run], away: dict[str, Array]) -> Figure:
    figure, ((path, steering), (error, empty)) = create_panels(2, 2, 3.2)
    empty.remove()
    course_t = np.linspace(BEGIN, SHOWN, 500)
    for index, (name, text) in enumerate((
            ('flat', 'flat feedforward'), ('linear', 'linear feedforward'),
            ('none', 'feedback alone'), ('off', 'flat feedforward, 1 m off'))):
        run, style = driven[name], get_line((2, 1, 3, 0)[index])
        path.plot(run.t, run.x[:, 0], label=text, **style)
        if name in ('flat', 'off'):
            steering.plot(run.t, run.u[:, 0], drawstyle='steps-post', **style)
        error.semilogy(run.t, np.maximum(np.abs(away[name]), 1e-6), **style)
    path.plot(course_t, evaluate_reference(course_t), label='course $r(t)$', **EXACT)
    path.set(xlim=(0, SHOWN), ylim=(-1.6, 1.6), yticks=[-1, 0, 1])
    label_axes(path, '(b) slalom of 1 m and 1 Hz', 'time $t$ [s]', 'position $y$ [m]')
    steering.set(xlim=(0, SHOWN), ylim=(-0.9, 0.9))
    label_axes(steering, '(b) steering', 'time $t$ [s]', r'$\phi$ [rad]')
    error.set(xlim=(0, SHOWN), ylim=(1e-3, 4))
    label_axes(error, '(b) tracking error', 'time $t$ [s]', '$|y - r|$ [m]')
    figure.legend(*path.get_legend_handles_labels(), loc='center', bbox_to_anchor=(0.77, 0.25))
    return figure


def _draw_frequency(magnitude: Axes, phase: Axes, design: AnsweredRegulator) -> None:
    frequency = np.logspace(-1, 2, 300)
    loop, closed = _open(design.K, frequency), _closed(design.K, frequency)
    crossover, margin = design.message.bandwidth[0], design.message.phase_margin[0]
    for axes, values in ((magnitude, (20 * np.log10(np.abs(loop)), 20 * np.log10(np.abs(closed)))),
                         (phase, (np.degrees(np.unwrap(np.angle(loop))),
                                  np.degrees(np.unwrap(np.angle(closed)))))):
        axes.semilogx(frequency, values[0], label='loop $L$', **get_line(0))
        axes.semilogx(frequency, values[1], label='$r$ to $y$', **get_line(1))
        axes.axvline(crossover, **THIN)
        axes.set_xlim(0.1, 100)
    magnitude.axhline(0, **THIN)
    for w, level, name, offset in ((OMEGA0, -10 * np.log10(2), 'bandwidth', (-8, -31)),
                                   (crossover, 0.0, 'crossover', (8, 8))):
        magnitude.plot(w, level, 'o', color='black', zorder=5)
        magnitude.annotate(f'{name}\n{w:.2f} rad/s', (w, level), offset,
                           textcoords='offset points', ha='right' if w == OMEGA0 else 'left')
    magnitude.set(ylim=(-60, 60), yticks=range(-60, 61, 20))
    phase.axhline(-180, **THIN)
    _draw_span(phase, (crossover, -180), (crossover, np.degrees(margin) - 180))
    phase.text(0.85 * crossover, -168, f'{np.degrees(margin):.1f}°', ha='right')
    phase.set(ylim=(-190, 40), yticks=[-180, -135, -90, -45, 0])
    label_axes(magnitude, '(a) frequency response', 'frequency [rad/s]', 'magnitude [dB]',
               legend='lower left')
    label_axes(phase, '(a) phase and its margin', 'frequency [rad/s]', 'phase [deg]')


EXERCISE_2_10 = GalleryEntry(
    'exercise-2.10', 'Lateral control of a vehicle', 'Exercise 2.10', (
        "$y' = v_d sin θ$, $θ' = (v_d/l) tan φ$ with $v_d = 10$ m/s, $l = 2$ m. (a) Design a "
        'regulator to $y_d = 0$; step and frequency response; overshoot, rise time, bandwidth and '
        'phase margin. (b) Track $y_d = r(t)$ on a slalom of 1 m and 1 Hz.',),
    exercise_2_10)
