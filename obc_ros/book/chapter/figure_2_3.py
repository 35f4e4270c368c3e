# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figure 2.3: the thrust vectored aircraft, drawn, its model and a flight."""

from math import sqrt
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc
import numpy as np
from obc_ros.api.figures.bodies import draw_aircraft, INK, place_points
from obc_ros.api.figures.style import LINE_COLOURS, new_figure, THIN
from obc_ros.book.entries.aircraft import (
    ARM,
    FLIGHT_STEP,
    fly_nonlinear,
    GRAVITY,
    INERTIA,
    linearize_at_hover,
    MASS,
)
from obc_ros.book.entry import ComparedRow, draw_arrow, EntryResult, GalleryEntry, label_axes
from obc_ros.book.loop import Run
from obc_ros.book.runner import Desk, read_design
from obc_ros.core.numerics.arrays import Array
from scipy.linalg import eigvals, solve_continuous_are

TARGET = np.array([5.0, 1.5, 0.0, 0.0, 0.0, 0.0])
QX, QU = [1.0, 9.0, 1.0, 1.0, 4.0, 0.1], [1.0, 1.0]
DURATION = 6.0  # [s]
POSES = (0.0, 0.7, 1.1, 1.6, 2.3, 6.0)  # [s]
TILT = 0.35  # [rad] of the drawing


def figure_2_3(desk: Desk) -> EntryResult:
    """Compare the model, its zeros and a flight with references."""
    A, B = linearize_at_hover()
    with desk.loop('aircraft', {'system': 'aircraft', 'publish_rate': 1 / FLIGHT_STEP},
                   {'system': 'aircraft', 'setpoint': TARGET, 'Qx': QX, 'Qu': QU}) as loop:
        run, design = loop.run(DURATION), read_design(loop.design)
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
    _draw_flight(panels['flight'], run)
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


def _draw_flight(axes: Axes, run: Run) -> None:
    axes.plot(run.x[:, 0], run.x[:, 1], color='0.6', linewidth=1)
    for time in POSES:
        k = int(np.argmin(np.abs(run.t - time)))
        px, py, theta = run.x[k, :3]
        draw_aircraft(axes, px, py, theta, run.u[k])
    label_axes(axes, f'flight, $t$ = {", ".join(f"{t:g}" for t in POSES)} s', '$x$ [m]', '$y$ [m]')
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
