# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The thrust vectored aircraft, in loops of nodes: Section 2.5 and Example 2.5.

Example 2.5 with Figures 2.4 and 2.5, three ways of choosing weights, and Figure 2.3: the aircraft
drawn, its model and a flight.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi, sqrt
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc
import numpy as np
from obc_ros.api.figures.bodies import draw_aircraft, INK, place_points
from obc_ros.api.figures.style import get_line, LINE_COLOURS, new_figure, THIN
from obc_ros.book.entry import (
    ComparedRow,
    create_panels,
    draw_arrow,
    EntryResult,
    GalleryEntry,
    label_axes,
)
from obc_ros.book.loop import NodeLoop, Run
from obc_ros.book.references import match_poles, run_sampled_loop, simulate_loop
from obc_ros.book.runner import AnsweredRegulator, Desk, read_design
from obc_ros.core.numerics.arrays import Array
from scipy.linalg import eigvals, solve_continuous_are

MASS, INERTIA, ARM, GRAVITY, DAMPING = 4.0, 0.0475, 0.25, 9.8, 0.05
FLIGHT_STEP = 0.02  # [s] from state to state
GOAL = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
CAPTION, LEGEND = (1.0, 1e2, 1e4), (0.1, 1.0, 10.0)  # rho in the caption and in the legend
NONLINEAR: dict[str, Any] = {'linestyle': (0, (1, 1.2)), 'linewidth': 2.4}
POSES = (0.0, 0.3, 0.6, 1.4, 3.0, 10.0)  # [s] at which the aircraft is drawn
SHRUNK = 0.25  # size of the drawn aircraft
IDENTITY = [1.0] * 6
PRINTED = [100.0, 1.0, 2 * pi / 9, 0.0, 0.0, 0.0]
MEANT = [100.0, 1.0, (3.6 / pi)**2, 0.0, 0.0, 0.0]
STEPS, LONG = 10.0, 15.0  # [s] of Figures 2.4 and 2.5


def linearize_at_hover() -> tuple[Array, Array]:
    """Return A and B at hover."""
    A, B = np.zeros((6, 6)), np.zeros((6, 2))
    A[:3, 3:] = np.eye(3)
    A[3, 2], A[3, 3], A[4, 4] = -GRAVITY, -DAMPING / MASS, -DAMPING / MASS
    B[3, 0], B[4, 1], B[5, 0] = 1 / MASS, 1 / MASS, ARM / INERTIA
    return A, B


def compute_gain(Qx: list[float], rho: float) -> Array:
    """Return K of u = -K x, without the server."""
    A, B = linearize_at_hover()
    K: Array = B.T @ solve_continuous_are(A, B, np.diag(Qx), rho * np.eye(2)) / rho
    return K


def example_2_5(desk: Desk) -> EntryResult:
    """Compute Example 2.5 in loops with the linear and with the nonlinear model."""
    A, B = linearize_at_hover()
    cases: dict[float | str, tuple[list[float], float, float]] = {
        rho: (IDENTITY, rho, STEPS) for rho in (1.0, 0.1, 10.0, 1e2, 1e4)}
    cases |= {'printed': (PRINTED, 0.1, LONG), 'meant': (MEANT, 0.1, LONG)}
    plant = {'system': 'linear', 'system_parameters.A': A, 'system_parameters.B': B}
    with desk.loop('linear', {**plant, 'x0': [0.0] * 6, 'publish_rate': 1 / FLIGHT_STEP},
                   {**plant, 'setpoint': GOAL, 'Qx': IDENTITY, 'Qu': [1.0, 1.0]}) as loop:
        linear = {name: _fly(loop, *case) for name, case in cases.items()}
    with desk.loop('aircraft', {'system': 'aircraft', 'publish_rate': 1 / FLIGHT_STEP},
                   {'system': 'aircraft', 'setpoint': GOAL, 'Qx': IDENTITY,
                    'Qu': [1.0, 1.0]}) as loop:
        whole = {name: _fly(loop, *cases[name]) for name in (1.0, 'printed')}
        model = read_design(loop.design)
    rows = [
        ComparedRow('linearization: $A$', model.A, A, 'Newton, at hover'),
        ComparedRow('linearization: $B$', model.B, B, 'Newton, at hover'),
        ComparedRow('weights as printed: $K$', model.K, compute_gain(PRINTED, 0.1),
                    'SciPy, `solve_continuous_are`')]
    for name, (Qx, rho, _) in cases.items():
        run, text = linear[name], _text(name)
        x, u = run_sampled_loop(A, B, compute_gain(Qx, rho), -GOAL, FLIGHT_STEP, len(run.t) - 1)
        rows += [ComparedRow(f'{text}, linear: $x(t)$', run.x, GOAL + x, 'recursion, SciPy gain'),
                 ComparedRow(f'{text}, linear: $u(t)$', run.u, u, 'recursion, SciPy gain')]
    for name in whole:
        Qx, rho, _ = cases[name]
        run = whole[name]
        x, u = fly_nonlinear(compute_gain(Qx, rho), GOAL, len(run.t) - 1)
        rows += [
            ComparedRow(f'{_text(name)}, aircraft: $x(t)$', run.x, x, 'Dormand-Prince 8(5,3)'),
                 ComparedRow(f'{_text(name)}, aircraft: inputs [N]', run.u, u,
                             'Dormand-Prince 8(5,3)')]
    printed = linear['printed']
    return EntryResult(rows, _draw_steps(linear, whole), (
        'The states $x, y$ and inputs $u_1 = f_1$, $u_2 = f_2 - mg$ of two running loops, '
        'with the linear model and with the nonlinear one (dotted). The weights '
        'are changed while `lqr_node` runs; each step begins with a reset of the plant.',
        'With the weights as printed in the book, the aircraft tilts by '
        f'{np.degrees(np.abs(whole["printed"].x[:, 2])).max():.0f} degrees. The '
        'linear model neglects the loss of vertical thrust: the nonlinear model falls by '
        f'{-whole["printed"].x[:, 1].min():.2f} m before it climbs.',
        'Figure 2.4(b) is shown for $ρ$ as in its legend and as in its caption. The steps with '
        'the weights $2π/9$ and 1.3131 of $θ$ differ by at most '
        f'{100 * np.abs(printed.x - linear["meant"].x)[:, :2].max():.1f} cm.'),
        f'In the loop with the printed weights, the first inputs are $u_1 = '
        f'{printed.u[0, 0]:.1f}$ N and $u_2 = {printed.u[0, 1]:.2f}$ N, but the axis of Figure '
        '2.5(b) runs from 0 to 4.', {
            'inputs': _draw_inputs(linear, whole),
            'flight': _draw_flight(linear['printed'], whole['printed'])})


def _fly(loop: NodeLoop, Qx: list[float], rho: float, duration: float) -> Run:
    changes: dict[str, Any] = {'Qx': Qx} if list(loop.design.qx[::7]) != Qx else {}
    if loop.design.qu[0] != rho:
        changes['Qu'] = [rho, rho]
    if changes:
        loop.set(**changes)
    return loop.run(duration)


def fly_nonlinear(K: Array, goal: Array, count: int) -> tuple[Array, Array]:
    """Return x, u of `count` steps with K (2, 6) at hover, from rest to a goal, in SciPy."""
    hover = np.array([0.0, MASS * GRAVITY])

    def rate(x: Array, u: Array) -> list[Any]:
        _, _, theta, vx, vy, omega = x
        c, s = np.cos(theta), np.sin(theta)
        return [vx, vy, omega, (u[0] * c - u[1] * s - DAMPING * vx) / MASS,
                (u[0] * s + u[1] * c - DAMPING * vy) / MASS - GRAVITY, ARM * u[0] / INERTIA]

    return simulate_loop(rate, lambda _, x: hover - K @ (x - goal), np.zeros(6), FLIGHT_STEP,
                         count)


def _text(name: float | str) -> str:
    return {'printed': 'weights as printed', 'meant': 'weight 1.3131 of $θ$'}.get(
        str(name), f'$Q_x = I$, $ρ = {name:g}$' if isinstance(name, float) else '')


def _draw_steps(linear: dict[Any, Run], whole: dict[Any, Run]) -> Figure:
    figure, ((a, b), (legend, caption)) = create_panels(2, 2, 3.2)
    for axes, name in ((a, 1.0), (b, 'printed')):
        for index, text in enumerate('xy'):
            axes.plot(linear[name].t, linear[name].x[:, index], label=f'${text}$, linear',
                      **get_line(index))
            axes.plot(whole[name].t, whole[name].x[:, index], label=f'${text}$, nonlinear',
                      **get_line(index) | NONLINEAR)
    for axes, values in ((legend, LEGEND), (caption, CAPTION)):
        for index, rho in enumerate(values):
            exponent = round(np.log10(rho))
            axes.plot(linear[rho].t, linear[rho].x[:, 0], **get_line(index),
                      label=rf'$\rho = 10^{exponent}$' if rho > 50 else rf'$\rho = {rho:g}$')
    both, one = 'position $x$, $y$ [m]', 'position $x$ [m]'
    for axes, title, y, limits in (
            (a, 'Figure 2.4(a): $Q_x = I$, $Q_u = I$', both, (0, 10, -0.05, 1.5)),
            (b, 'Figure 2.5(a): weights as printed', both, (0, 15, -0.9, 1.5)),
            (legend, r'Figure 2.4(b), $\rho$ as in its legend', one, (0, 10, -0.05, 1.5)),
            (caption, r'Figure 2.4(b), $\rho$ as in its caption', one, (0, 10, -0.05, 1.5))):
        label_axes(axes, title, 'time $t$ [s]', y, legend='lower right')
        axes.axis(limits)
        axes.axhline(1.0, **THIN)
    return figure


def _draw_inputs(linear: dict[Any, Run], whole: dict[Any, Run]) -> Figure:
    figure, ((first, inputs), (tilt, weights)) = create_panels(2, 2, 3.2)
    for axes, name in ((first, 1.0), (inputs, 'printed')):
        for index in range(2):
            axes.plot(linear[name].t, linear[name].u[:, index], drawstyle='steps-post',
                      label=f'$u_{index + 1}$', **get_line(index))
    inputs.axhspan(0, 4, color='0.85', zorder=1, label='axis of the book')
    run = linear['printed']
    for each, style, text in ((run, {}, 'linear'), (whole['printed'], NONLINEAR, 'nonlinear')):
        tilt.plot(each.t, np.degrees(each.x[:, 2]), label=text, **get_line(2) | style)
    for index, text in enumerate('xy'):
        weights.plot(run.t, 100 * (linear['meant'].x - run.x)[:, index], label=f'${text}$',
                     **get_line(index))
    for axes, title, y, limits in (
            (first, 'inputs of Figure 2.4(a)', '$u_1$, $u_2$ [N]', (0, 10, None, None)),
            (inputs, 'Figure 2.5(b), full range', '$u_1$, $u_2$ [N]', (0, 3, -35, 16)),
            (tilt, 'weights as printed: tilt', r'$\theta$ [deg]', (0, 3, -60, 60)),
            (weights, r'weight of $\theta$: 1.3131 or $2\pi/9$', 'difference [cm]',
             (0, 5, -0.7, 0.4))):
        label_axes(axes, title, 'time $t$ [s]', y, legend='best')
        axes.axis(limits)
        axes.axhline(0.0, **THIN)
    return figure


def _draw_flight(linear: Run, whole: Run) -> Figure:
    figure, ((plane,),) = create_panels(1, 1, 5.2)
    for run, line, style, text in ((linear, get_line(0), {}, 'linear model'),
                                   (whole, get_line(1), NONLINEAR, 'nonlinear model')):
        plane.plot(run.x[:, 0], run.x[:, 1], label=text, **line | style)
    for time in POSES:
        k = int(np.argmin(np.abs(whole.t - time)))
        px, py, theta = whole.x[k, :3]
        draw_aircraft(plane, px, py, theta, whole.u[k], arm=SHRUNK * ARM, plume=SHRUNK * 0.012)
        plane.annotate(f'{time:g} s', whole.x[k, :2], (18, 4), textcoords='offset points')
    plane.set(aspect='equal')
    plane.margins(0.08)
    label_axes(plane, 'weights as printed: the aircraft (a quarter of its size) falls as it tilts',
               '$x$ [m]', '$y$ [m]')
    plane.legend(loc='center left', bbox_to_anchor=(1.0, 0.5))
    return figure


WEIGHTS_2_5 = GalleryEntry(
    'example-2.5', 'Thrust vectored aircraft', 'Example 2.5, Figures 2.4 and 2.5', (
        'The set point of the hovering aircraft steps by 1 m in $x$ and in $y$. First with '
        '$Q_x = I$, $Q_u = ρI$; then with weights that penalise errors of 1 cm in $x$, 10 cm in '
        '$y$ and 5 degrees in $θ$ equally: $Q_x = diag(100, 1, 2π/9, 0, 0, 0)$, $Q_u = 0.1 I$.',),
    example_2_5,
    'Errors of 1 cm, 10 cm and 5 degrees have equal costs if the weight of $θ$ is '
    '$(0.1/(π/36))^2 = (3.6/π)^2 = 1.3131$; the printed $2π/9$ is 40 degrees in radians. The '
    'caption of Figure 2.4(b) says $ρ = 1, 10^2, 10^4$, its legend 0.1, 1, 10. And contrary to '
    'the text, $Q_u = 0.1 I$ does not single out the sideways force.')


STEP_TIME, SHOWN = 8.0, 3.0  # [s]
X_MAX = [0.5, 0.5, pi / 12, 1.0, 1.0, pi / 2]  # [m], [m], [rad], [m/s], [m/s], [rad/s]
U_MAX = [2.0, 10.0]  # [N]
RHO = 0.1  # of the output weight
H = np.eye(2, 6)  # z = (x, y)


@dataclass(frozen=True, eq=False)
class WeightChoice:
    """A way of choosing weights: parameters of `lqr_node`, and the matrices Qx and Qu."""

    parameters: Mapping[str, Any]
    Qx: Array
    Qu: Array

    @property
    def gain(self) -> Array:
        """Return K, without the nodes."""
        A, B = linearize_at_hover()
        right: Array = np.linalg.solve(self.Qu, B.T @ solve_continuous_are(A, B, self.Qx, self.Qu))
        return right

    @property
    def poles(self) -> Any:
        """Return the poles of A - B K [rad/s]."""
        A, B = linearize_at_hover()
        return np.linalg.eigvals(A - B @ self.gain)


CHOICES = {
    'diagonal': WeightChoice({'Qx': [1.0] * 6, 'Qu': [1.0] * 2}, np.eye(6), np.eye(2)),
    'Bryson': WeightChoice({'weights': 'bryson', 'x_max': X_MAX, 'u_max': U_MAX},
                           np.diag(np.power(X_MAX, -2)), np.diag(np.power(U_MAX, -2))),
    'output': WeightChoice({'weights': 'output', 'H': H.ravel(), 'rho': RHO},
                           H.T @ H, RHO * np.eye(2))}


LEADS = {
    'diagonal': 'Diagonal: one unit of each state costs as much as 1 N, whatever the units mean.',
    'Bryson': 'Bryson and Ho: acceptable deviations, in units that an engineer can give.',
    'output': 'Output: only $x$ and $y$ cost; tilt and velocities are free.'}


def section_2_5(desk: Desk) -> EntryResult:
    """Compare gains, poles, peak inputs and steps of three choices with references."""
    A, B = linearize_at_hover()
    designs = dict(zip(CHOICES, desk.design_all(
        [{'system': 'aircraft', **each.parameters} for each in CHOICES.values()],
        show=len(CHOICES)), strict=True))
    plant = {'system': 'linear', 'system_parameters.A': A, 'system_parameters.B': B}
    runs: dict[str, Run] = {}
    used: dict[str, AnsweredRegulator] = {}
    with desk.loop('weights', {**plant, 'x0': [0.0] * 6, 'publish_rate': 1 / FLIGHT_STEP},
                   {**plant, 'setpoint': GOAL, **CHOICES['diagonal'].parameters}) as loop:
        for name, choice in CHOICES.items():
            if runs:
                loop.set(**choice.parameters)
            runs[name], used[name] = loop.run(STEP_TIME), read_design(loop.design)
    rows = []
    for name, choice in CHOICES.items():
        K, design, run = choice.gain, designs[name], runs[name]
        x, u = run_sampled_loop(A, B, K, -GOAL, FLIGHT_STEP, len(run.t) - 1)
        poles = match_poles(design.E, choice.poles)
        Q = np.diag(choice.Qx)[:2] / np.diag(choice.Qu)
        rows += [
            ComparedRow(f'{name}: $Q_x$ in use', np.reshape(used[name].message.qx, (6, 6)),
                        choice.Qx, 'the rule'),
            ComparedRow(f'{name}: $K$', design.K, K, 'SciPy, `solve_continuous_are`'),
            ComparedRow(f'{name}: poles, real parts [rad/s]', poles.real, choice.poles.real,
                        'eigenvalues of $A - BK$'),
            ComparedRow(f'{name}: poles, imaginary parts [rad/s]', poles.imag, choice.poles.imag,
                        'eigenvalues of $A - BK$'),
            ComparedRow(f'{name}: peak inputs $u_1$, $u_2$ of the step [N]',
                        np.abs(run.u).max(axis=0), np.sqrt(Q), '$√(q_i/ρ_i)$ for a step of 1 m'),
            ComparedRow(f'{name}: $x(t)$', run.x, GOAL + x, 'recursion, SciPy gain'),
            ComparedRow(f'{name}: $u(t)$', run.u, u, 'recursion, SciPy gain')]
    return EntryResult(rows, _draw_choices(runs, designs), (
        *(_describe(name, designs[name], runs[name]) for name in CHOICES),
        'Row and column of a position in $PA + A^T P$ are 0 at its place, so that (2.9) gives '
        '$ρ_j K_{ji}^2 = q_i$: the position gains are $√(q_i/ρ_j)$. With the rule of Bryson this '
        'is the ratio of the acceptable deviations. The second '
        'step of the rule, the compromise between response time, damping and effort, is trial '
        'and error: `ros2 param set` while the loop runs.'))


def _describe(name: str, design: AnsweredRegulator, run: Run) -> str:
    """Return gains, poles, peaks and the step of a choice as a sentence."""
    rise, overshoot = design.message.rise_time, design.message.overshoot
    gains = '; '.join(
        f'$u_{j + 1}$: ' + ', '.join(f'{gain:.2f}' for gain in row[row != 0].round(2) if gain)
        for j, row in enumerate(design.K))
    peaks = np.abs(run.u).max(axis=0)
    return (
        f'{LEADS[name]} Gains of the states that an input uses: {gains}. Slowest pole at '
        f'{design.E.real.max():.2f} rad/s. The step takes {rise[0]:.1f} s in $x$ and '
        f'{rise[1]:.1f} s in $y$ (10 % to 90 %), with overshoots of {100 * overshoot[0]:.0f} % '
        f'and {100 * overshoot[1]:.0f} %, a tilt of {np.degrees(np.abs(run.x[:, 2]).max()):.0f} '
        f'degrees and peak inputs of {peaks[0]:.1f} N and {peaks[1]:.1f} N.')


def _draw_choices(runs: Mapping[str, Run], designs: Mapping[str, AnsweredRegulator]) -> Figure:
    figure, ((place, height), (tilt, plane)) = create_panels(2, 2)
    for index, ((name, run), marker) in enumerate(zip(runs.items(), 'osD', strict=True)):
        line = get_line(index)
        for axes, values in ((place, run.x[:, 0]), (height, run.x[:, 1]),
                             (tilt, np.degrees(run.x[:, 2]))):
            axes.plot(run.t, values, label=name, **line)
        E = designs[name].E
        plane.plot(E.real, E.imag, marker, color=line['color'], fillstyle='none', label=name)
    for axes, text in ((place, 'x'), (height, 'y')):
        axes.axhline(1, **THIN)
        label_axes(axes, f'step of 1 m: ${text}$', 'time $t$ [s]', f'${text}$ [m]')
        axes.set(xlim=(0, STEP_TIME), ylim=(-0.05, 1.15))
    for axes in (tilt, plane):
        axes.axhline(0, **THIN)
    plane.axvline(0, color='black', linewidth=1)
    place.legend(loc='lower right')
    label_axes(tilt, 'tilt', 'time $t$ [s]', r'$\theta$ [deg]')
    label_axes(plane, 'poles of $A - BK$', 'real part [rad/s]', 'imaginary part [rad/s]',
               legend='upper left')
    plane.set_xlim(-11.0, 0.4)  # leaves room for the legend
    tilt.set_xlim(0, SHOWN)
    return figure


SECTION_2_5 = GalleryEntry(
    'section-2.5', 'Three ways of choosing weights', 'Section 2.5', (
        'The set point of the aircraft of Example 2.5 steps by 1 m in $x$ and in $y$. The '
        'weights are chosen in three ways: diagonal, $Q_x = I$, $Q_u = I$; by the rule of Bryson '
        'and Ho, $q_i = 1/x_{i,max}^2$, $ρ_j = 1/u_{j,max}^2$ for acceptable deviations of '
        '0.5 m, 0.5 m, 15 degrees, 1 m/s, 1 m/s, 90 degrees/s and 2 N, 10 N; for an output, '
        f'$Q_x = H^T H$, $Q_u = ρI$ with $z = Hx = (x, y)$ and $ρ = {RHO:g}$.',),
    section_2_5,
    '“$Q_u = diag(ρ_1, ..., ρ_n)$” has as many entries as there are inputs: '
    '$Q_u = diag(ρ_1, ..., ρ_m)$.')


TARGET = np.array([5.0, 1.5, 0.0, 0.0, 0.0, 0.0])
QX, QU = [1.0, 9.0, 1.0, 1.0, 4.0, 0.1], [1.0, 1.0]
FLIGHT_TIME = 6.0  # [s]
FLIGHT_POSES = (0.0, 0.7, 1.1, 1.6, 2.3, 6.0)  # [s]
TILT = 0.35  # [rad] of the drawing


def figure_2_3(desk: Desk) -> EntryResult:
    """Compare the model, its zeros and a flight with references."""
    A, B = linearize_at_hover()
    with desk.loop('aircraft', {'system': 'aircraft', 'publish_rate': 1 / FLIGHT_STEP},
                   {'system': 'aircraft', 'setpoint': TARGET, 'Qx': QX, 'Qu': QU}) as loop:
        run, design = loop.run(FLIGHT_TIME), read_design(loop.design)
    K = np.linalg.solve(np.diag(QU), B.T @ solve_continuous_are(A, B, np.diag(QX), np.diag(QU)))
    x, u = fly_nonlinear(K, TARGET, len(run.t) - 1)
    zero = sqrt(MASS * GRAVITY * ARM / INERTIA)
    rows = [
        ComparedRow('hover: $f_1$, $f_2$ [N]', design.message.ue, [0.0, MASS * GRAVITY],
                    '0, $mg$'),
        ComparedRow('linearization: $A$', design.A, A, 'Newton, at hover'),
        ComparedRow('linearization: $B$', design.B, B, 'Newton, at hover'),
        ComparedRow('zeros from $f_1$ to $x$ [rad/s]', find_zeros(design.A, design.B[:, 0]),
                    [-zero, zero], '$±√(mgr/J)$'),
        ComparedRow('flight: $x(t)$', run.x, x, 'Dormand-Prince 8(5,3)'),
        ComparedRow('flight: inputs [N]', run.u, u, 'Dormand-Prince 8(5,3)')]
    return EntryResult(rows, _draw_figure_2_3(run), (
        'Top left: the forces and lengths of Figure 2.3(b), drawn for a positive $θ$. Below: a '
        f'flight of running nodes to the set point ({TARGET[0]:g} m, {TARGET[1]:g} m), drawn to '
        'scale, with the exhaust of the thrust. To fly to the right the aircraft tilts clockwise, '
        'so that $f_2$ points to the right; on arrival it tilts back to brake.',
        'Top right: the first 0.3 s. Clockwise is $f_1 < 0$, which first pushes the aircraft to '
        f'the left, by {-1000 * run.x[:, 0].min():.0f} mm. This is the zero in the right half '
        f'plane, at $√(mgr/J) = {zero:.1f}$ rad/s: no control law avoids it, and it '
        'limits how fast the loop can be.'))


def find_zeros(A: Array, b: Array) -> Array:
    """Return the zeros of the transfer function from one input to x, sorted [rad/s]."""
    n = len(A)
    pencil = np.block([[A, b[:, None]], [np.eye(1, n), np.zeros((1, 1))]])
    found = eigvals(pencil, np.diag([1.0] * n + [0.0]))
    finite = found[np.isfinite(found) & (np.abs(found) < 1e6)]
    moving = finite[np.abs(finite) > 0.1]  # the vertical motion cancels: poles at 0 and -c/m
    return np.sort(moving.real)


def _draw_figure_2_3(run: Run) -> Figure:
    figure: Figure = new_figure(7.6)
    panels = figure.subplot_mosaic([['sketch', 'start'], ['flight', 'flight']],
                                   width_ratios=(1.4, 1.0), height_ratios=(1.0, 0.95))
    start = panels['start']
    draw_schematic(panels['sketch'])
    _draw_poses(panels['flight'], run)
    early = run.t < 0.31
    start.plot(run.t[early], 1000 * run.x[early, 0], color=LINE_COLOURS[0])
    start.axhline(0, **THIN)
    label_axes(start, 'the first 0.3 s', 'time $t$ [s]', '$x$ [mm]')
    start.set_xlim(0, 0.3)
    return figure


def draw_schematic(axes: Axes) -> None:
    """Draw Figure 2.3(b): the aircraft at an angle, its forces and lengths; no axes."""
    def at(px: float, py: float) -> Any:
        return place_points(np.array([[px, py]]), 0.0, 0.0, TILT)[0]

    def write(text: str, place: Any, **options: Any) -> None:
        axes.annotate(text, place, ha='center', va='center', fontsize=15, **options)

    draw_aircraft(axes, 0.0, 0.0, TILT)
    point = at(0.0, -ARM)
    for name, back, label in (('$F_1$', at(-0.36, 0.0), at(-0.42, -ARM + 0.07)),
                              ('$F_2$', at(0.0, -0.42), at(0.08, -ARM - 0.38))):
        draw_arrow(axes, point + back, -back, color=LINE_COLOURS[1])
        write(name, label, color=LINE_COLOURS[1])
    draw_arrow(axes, (0.0, 0.0), (0.0, -0.62), color='0.35')
    write('$mg$', np.array([-0.1, -0.58]), color='0.35')
    side = [at(0.3, 0.0), at(0.3, -ARM)]  # dimension line of r, beside the body
    for end, near in zip(side, ((0.0, 0.0), point), strict=True):
        axes.plot(*zip(near, end, strict=True), **THIN)
    axes.annotate('', side[0], side[1], arrowprops={'arrowstyle': '<->', 'shrinkA': 0,
                                                    'shrinkB': 0})
    write('$r$', at(0.35, -ARM / 2))
    axes.plot([0, 0], [0, 0.72], **THIN)
    axes.plot(*zip((0.0, 0.0), at(0.0, 0.72), strict=True), **THIN)
    turn = np.degrees(TILT)
    axes.add_patch(Arc((0, 0), 1.24, 1.24, theta1=90, theta2=90 + turn, color=INK))
    write(r'$\theta$', place_points(np.array([[0.0, 0.7]]), 0.0, 0.0, TILT / 2)[0])
    axes.plot(0, 0, 'o', color='white', markeredgecolor=INK, markersize=6, zorder=6)
    write('$(x, y)$', np.array([-0.29, 0.1]))
    corner = np.array([-0.62, -0.72])
    for along, text in (((0.25, 0.0), '$x$'), ((0.0, 0.25), '$y$')):
        draw_arrow(axes, corner, along, color=INK, linewidth=1.0)
        write(text, corner + 1.22 * np.array(along))
    axes.set_title('forces and lengths')
    axes.set_aspect('equal')
    axes.axis((-0.68, 0.68, -0.78, 0.82))
    axes.axis('off')


def _draw_poses(axes: Axes, run: Run) -> None:
    axes.plot(run.x[:, 0], run.x[:, 1], color='0.6', linewidth=1)
    for time in FLIGHT_POSES:
        k = int(np.argmin(np.abs(run.t - time)))
        px, py, theta = run.x[k, :3]
        draw_aircraft(axes, px, py, theta, run.u[k])
    label_axes(axes, f'flight, $t$ = {", ".join(f"{t:g}" for t in FLIGHT_POSES)} s',
               '$x$ [m]', '$y$ [m]')
    axes.set_aspect('equal')
    axes.axis((-0.7, 5.7, -1.0, 2.2))


FIGURE_2_3 = GalleryEntry(
    'figure-2.3', 'The thrust vectored aircraft', 'Figure 2.3; Example 2.5', (
        'An aircraft of mass $m$ and moment of inertia $J$ hovers on its thrust. The thrust has '
        'a component $F_1$ across and $F_2$ along the body, which act at the distance $r$ below '
        'the centre of mass $(x, y)$; $θ$ is the angle of the body. With damping $c$, '
        "$mx'' = F_1 cos θ - F_2 sin θ - cx'$, $my'' = F_1 sin θ + F_2 cos θ - cy' - mg$, "
        "$Jθ'' = rF_1$. The nodes call the forces `f1` and `f2`.",),
    figure_2_3)
