# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Example 2.5: the thrust vectored aircraft, Figures 2.4 and 2.5, flown in loops of nodes."""

from math import pi
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.bodies import draw_aircraft
from obc_ros.api.figures.style import get_line, THIN
from obc_ros.book.entry import ComparedRow, create_panels, EntryResult, GalleryEntry, label_axes
from obc_ros.book.loop import NodeLoop, Run
from obc_ros.book.references import run_sampled_loop, simulate_loop
from obc_ros.book.runner import Desk, read_design
from obc_ros.core.numerics.arrays import Array
from scipy.linalg import solve_continuous_are

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
    """
    Return states and inputs of a flight of the nonlinear model, from rest, without the nodes.

    :param K: (2, 6), gain at hover.
    :param goal: (6,), set point.
    :param count: number of steps of FLIGHT_STEP.
    """
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
    '2.5', 'Thrust vectored aircraft', 'Example 2.5, Figures 2.4 and 2.5', (
        'The set point of the hovering aircraft steps by 1 m in $x$ and in $y$. First with '
        '$Q_x = I$, $Q_u = ρI$; then with weights that penalise errors of 1 cm in $x$, 10 cm in '
        '$y$ and 5 degrees in $θ$ equally: $Q_x = diag(100, 1, 2π/9, 0, 0, 0)$, $Q_u = 0.1 I$.',),
    example_2_5,
    'Errors of 1 cm, 10 cm and 5 degrees have equal costs if the weight of $θ$ is '
    '$(0.1/(π/36))^2 = (3.6/π)^2 = 1.3131$; the printed $2π/9$ is 40 degrees in radians. The '
    'caption of Figure 2.4(b) says $ρ = 1, 10^2, 10^4$, its legend 0.1, 1, 10. And contrary to '
    'the text, $Q_u = 0.1 I$ does not single out the sideways force.')
