# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The thrust vectored aircraft of Example 2.5: steps, live weights, a gust, a refused change."""

from math import pi
from pathlib import Path

import matplotlib as mpl

mpl.use('Agg')
from matplotlib.axes import Axes  # noqa: E402 - after the choice of a backend without a screen
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from numpy.typing import NDArray  # noqa: E402

from obc_ros.cli.demo import Event, Flight, fly, set_parameters  # noqa: E402
from obc_ros.cli.pilot import Pilot  # noqa: E402
from obc_ros.cli.report import loop_rows, show, step_figures  # noqa: E402

Array = NDArray[np.float64]

FIRST_STEP, CHANGE, SECOND_STEP, GUST, REFUSAL, END = 1.0, 12.0, 13.0, 29.0, 36.0, 40.0
# The weights that Example 2.5 prints; 2 pi / 9 is its own (5 degrees would be 1.3131).
EXAMPLE_2_5 = {'Qx': [100.0, 1.0, 2 * pi / 9, 0.0, 0.0, 0.0], 'Qu': [0.1, 0.1]}


def run(out: Path, real_time: bool) -> int:
    """Fly, report, draw; return the exit status."""
    flight = Flight('aircraft', 'aircraft.yaml', END, (
        Event(FIRST_STEP, 'step to (1, 1) with Qx = I', _go_to(1.0, 1.0)),
        Event(CHANGE, 'weights of Example 2.5, while it flies', _take_weights),
        Event(SECOND_STEP, 'step to (2, 2) with the weights of Example 2.5', _go_to(2.0, 2.0)),
        Event(GUST, 'a gust from the side, 4 N for 1 s', lambda pilot: ''),
        Event(REFUSAL, 'Qu = [-0.1, 0.1]', _refused_weights)))
    return fly(flight, out, real_time, lambda pilot, wall: _conclude(pilot, wall, out))


def _go_to(px: float, py: float):
    return set_parameters('lqr_node', {'setpoint': [px, py, 0.0, 0.0, 0.0, 0.0]})


def _take_weights(pilot: Pilot) -> str:
    before = pilot.designs[-1].revision
    set_parameters('lqr_node', EXAMPLE_2_5)(pilot)
    pilot.wait(lambda: pilot.designs[-1].revision > before, 'the new design')
    return pilot.designs[-1].sentence


def _refused_weights(pilot: Pilot) -> str:
    return set_parameters('lqr_node', {'Qu': [-0.1, 0.1]}, refused=True)(pilot)


def _conclude(pilot: Pilot, wall: float, out: Path) -> int:
    t, x, tu, u = pilot.history()
    rows = []
    for name, begin, end, start in (('Qx = I', FIRST_STEP, CHANGE, 0.0),
                                    ('Example 2.5', SECOND_STEP, GUST, 1.0)):
        during, commanded = (t >= begin) & (t < end), (tu >= begin) & (tu < end)
        peaks = np.abs(u[commanded] - u[0]).max(axis=0)
        for index, axis in enumerate(('px', 'py')):
            step = step_figures(t[during], x[during, index], start, start + 1.0)
            rows.append((name, axis, f'{step.rise_time:.2f} s', f'{100 * step.overshoot:.1f} %',
                         f'{step.settling_time:.2f} s', f'{peaks[index]:.2f} N'))
    show('Unit steps', ('weights', 'axis', 'rise time', 'overshoot', 'settling', 'peak |f - fe|'),
         rows)
    show('The loop', ('', ''), loop_rows(pilot, wall))
    figure = out / 'aircraft.png'
    _draw(t, x, tu, u, figure)
    print(f'figure {figure}   recording {out / "aircraft"}')
    return 0


def _draw(t: Array, x: Array, tu: Array, u: Array, path: Path) -> None:
    figure, axes = plt.subplots(2, 3, figsize=(13, 7), layout='constrained')
    for row, (begin, start, span, label) in enumerate((
            (FIRST_STEP, 0.0, 10.0, 'Qx = I, Qu = I (Figure 2.4a)'),
            (SECOND_STEP, 1.0, 15.0, 'weights of Example 2.5 (Figure 2.5)'))):
        _positions(axes[row, 0], t - begin, x[:, :2] - start, span, label)
        _inputs(axes[row, 1], tu - begin, u, span, label)
    _flight(axes[0, 2], t, x)
    _tilt(axes[1, 2], t, x)
    figure.suptitle('Vectored thrust aircraft, three nodes over DDS')
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _positions(axes: Axes, t: Array, positions: Array, span: float, label: str) -> None:
    axes.plot(t, positions[:, 0], label='x')
    axes.plot(t, positions[:, 1], '--', label='y')
    axes.axhline(1.0, color='0.7', linewidth=0.8, zorder=0)
    axes.set(xlim=(0, span), ylim=(0, 1.5), xlabel='time since the step [s]',
             ylabel='position x, y [m]', title=f'Step, {label}')
    axes.legend(loc='lower right')


def _inputs(axes: Axes, t: Array, u: Array, span: float, label: str) -> None:
    during = (t >= -0.5) & (t <= span)
    equilibrium = u[0]
    axes.step(t[during], u[during, 0] - equilibrium[0], where='post', label='u1 = f1')
    axes.step(t[during], u[during, 1] - equilibrium[1], '--', where='post', label='u2 = f2 - m g')
    axes.set(xlim=(-0.5, span), xlabel='time since the step [s]', ylabel='input [N]',
             title=f'Inputs, {label}')
    axes.legend()


def _flight(axes: Axes, t: Array, x: Array) -> None:
    axes.plot(t, x[:, 0], label='x')
    axes.plot(t, x[:, 1], '--', label='y')
    for moment, what in ((FIRST_STEP, 'step'), (CHANGE, 'new weights'), (SECOND_STEP, 'step'),
                         (GUST, 'gust'), (REFUSAL, 'refused change')):
        axes.axvline(moment, color='0.8', linewidth=0.8, zorder=0)
        axes.annotate(what, (moment, 0.02), xycoords=('data', 'axes fraction'), rotation=90,
                      fontsize=8, color='0.4', ha='right', va='bottom')
    axes.set(xlim=(0, END), xlabel='time [s]', ylabel='position [m]', title='The whole flight')
    axes.legend(loc='upper left')


def _tilt(axes: Axes, t: Array, x: Array) -> None:
    axes.plot(t, np.degrees(x[:, 2]))
    axes.set(xlim=(0, END), xlabel='time [s]', ylabel='angle theta [deg]', title='Tilt')
