# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The aircraft of Example 2.5: steps, new weights in flight, a gust, a rejected change."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi
from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from obc_ros.cli.console.tables import print_table
from obc_ros.cli.demo.flight import Event, Flight, fly, set_parameters
from obc_ros.cli.demo.report import measure_step, report_loop
from obc_ros.cli.flight_client import Pilot
from obc_ros.core.library.figures.files import save_figure
from obc_ros.core.library.figures.style import STYLE
from obc_ros.core.lqr.design.report import read_matrices
from obc_ros.core.numerics.arrays import Array
from obc_ros.msg import LqrDesign
from scipy.linalg import expm

FIRST_STEP, CHANGE, SECOND_STEP, GUST, REFUSAL, END = 1.0, 12.0, 13.0, 31.0, 37.0, 41.0
LABELS = -1.2  # [m] lower end of the axis: the labels of the events are below the curves
# The weights printed in Example 2.5; 5 degrees correspond to 1.3131 instead of 2 pi / 9.
EXAMPLE_2_5 = {'Qx': [100.0, 1.0, 2 * pi / 9, 0.0, 0.0, 0.0], 'Qu': [0.1, 0.1]}


@dataclass(frozen=True)
class UnitStep:
    """A unit step in x and y: begin [s], start [m], span [s], weights, figure and design."""

    begin: float
    start: float
    span: float
    weights: str
    figure: str
    design: LqrDesign


def run(out: Path, real_time: bool, formats: Sequence[str]) -> int:
    """Run the flight, print its figures of merit and plot it; return the exit status."""
    steps: list[UnitStep] = []
    flight = Flight('aircraft', 'aircraft.yaml', END, (
        Event(FIRST_STEP, 'step to (1, 1) with Qx = I',
              lambda pilot: _step(pilot, steps, 0.0, 10.0, 'Qx = I', '2.4a')),
        Event(CHANGE, 'weights of Example 2.5, in flight', _take_weights),
        Event(SECOND_STEP, 'step to (2, 2) with the weights of Example 2.5',
              lambda pilot: _step(pilot, steps, 1.0, 15.0, 'Example 2.5', '2.5')),
        Event(GUST, 'a gust from the side, 4 N for 1 s', lambda pilot: ''),
        Event(REFUSAL, 'Qu = [-0.1, 0.1]', _refused_weights)))
    return fly(flight, out, real_time, lambda pilot, wall: _conclude(
        pilot, wall, steps, out, formats))


def _step(pilot: Pilot, steps: list[UnitStep], start: float, span: float, weights: str,
          figure: str) -> str:
    goal, asked = start + 1.0, pilot.now
    design = _change(pilot, {'setpoint': [goal, goal, 0.0, 0.0, 0.0, 0.0]})
    steps.append(UnitStep(asked, start, span, weights, figure, design))
    return ''


def _take_weights(pilot: Pilot) -> str:
    return str(_change(pilot, EXAMPLE_2_5).sentence)


def _change(pilot: Pilot, values: dict[str, list[float]]) -> LqrDesign:
    """Set parameters of lqr_node; return the new design."""
    before = pilot.designs[-1].revision
    set_parameters('lqr_node', values)(pilot)
    pilot.wait(lambda: pilot.designs[-1].revision > before, 'the new design')
    return pilot.designs[-1]


def _refused_weights(pilot: Pilot) -> str:
    return set_parameters('lqr_node', {'Qu': [-0.1, 0.1]}, refused=True)(pilot)


def _conclude(pilot: Pilot, wall: float, steps: list[UnitStep], out: Path,
              formats: Sequence[str]) -> int:
    t, x, tu, u = pilot.history()
    steps = [replace(step, begin=_jump(step.begin, tu, u)) for step in steps]
    rows = []
    for step in steps:
        during = (t >= step.begin) & (t < step.begin + step.span)
        commanded = (tu >= step.begin) & (tu < step.begin + step.span)
        peaks = np.abs(u[commanded] - step.design.ue).max(axis=0)
        for index, axis in enumerate(('px', 'py')):
            figures = measure_step(
                t[during], x[during, index], step.start, step.start + 1.0)
            settling = f'{figures.settling_time:.2f} s' if np.isfinite(
                figures.settling_time) else f'> {step.span:g} s'
            rows.append((step.weights, axis, f'{figures.rise_time:.2f} s',
                         f'{100 * figures.overshoot:.1f} %', settling, f'{peaks[index]:.2f} N'))
    print_table(
        ('unit step', 'axis', 'rise time', 'overshoot', 'settling', 'peak |f - fe|'), rows)
    print_table(('the loop', ''), report_loop(pilot, wall))
    with mpl.rc_context(STYLE):
        drawn = save_figure(_draw(t, x, tu, u, steps), out / 'aircraft', formats)
    print(f'figure {", ".join(map(str, drawn))}   recording {out / "aircraft"}')
    return 0


def _jump(asked: float, t: Array, u: Array) -> float:
    """Return the time [s] of the first jump of the command after a step was requested."""
    after = np.flatnonzero((t[1:] > asked) & (np.abs(np.diff(u, axis=0)).max(axis=1) > 0.5))
    return float(t[1 + after[0]])


def _draw(t: Array, x: Array, tu: Array, u: Array, steps: list[UnitStep]) -> Figure:
    figure = Figure(figsize=(13, 7), layout='constrained')
    axes = figure.subplots(2, 3)
    for row, step in enumerate(steps):
        _positions(axes[row, 0], t - step.begin, x[:, :2] - step.start, step)
        _inputs(axes[row, 1], tu - step.begin, u - step.design.ue, step)
    _flight(axes[0, 2], t, x)
    _tilt(axes[1, 2], t, x)
    figure.suptitle('Vectored thrust aircraft, three nodes over DDS')
    return figure


def _linear(step: UnitStep) -> tuple[Array, Array, Array]:
    """Return t, x and u - ue of the same step of the linearization, as in the book."""
    told = read_matrices(step.design)
    times = np.linspace(0.0, step.span, 1001)
    one = expm((told.A - told.B @ told.K) * times[1])
    errors = [-np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])]
    for _ in times[1:]:
        errors.append(one @ errors[-1])
    return times, np.array(errors) + [1.0, 1.0, 0.0, 0.0, 0.0, 0.0], -np.array(errors) @ told.K.T


def _positions(axes: Axes, t: Array, positions: Array, step: UnitStep) -> None:
    for index, (name, style) in enumerate((('px', '-'), ('py', '--'))):
        axes.plot(t, positions[:, index], style, label=name)
    times, linear, _ = _linear(step)
    axes.plot(times, linear[:, :2], ':', color='0.4', linewidth=1, label=['linear model', None])
    axes.axhline(1.0, color='0.7', linewidth=0.8, zorder=0)
    lowest = min(0.0, positions[(t >= 0) & (t <= step.span)].min() - 0.05)
    axes.set(xlim=(0, step.span), ylim=(lowest, 1.5), xlabel='time since the step [s]',
             ylabel='position px, py [m]', title=f'Step, {step.weights} (Figure {step.figure})')
    axes.legend(loc='lower right')


def _inputs(axes: Axes, t: Array, u: Array, step: UnitStep) -> None:
    during = (t >= -0.5) & (t <= step.span)
    axes.step(t[during], u[during, 0], where='post', label='u1 = f1')
    axes.step(t[during], u[during, 1], '--', where='post', label='u2 = f2 - m g')
    times, _, linear = _linear(step)
    axes.plot(times, linear, ':', color='0.4', linewidth=1, label=['linear model', None])
    axes.set(xlim=(-0.5, step.span), xlabel='time since the step [s]', ylabel='input [N]',
             title=f'Inputs, {step.weights} (Figure {step.figure})')
    axes.legend()


def _flight(axes: Axes, t: Array, x: Array) -> None:
    axes.plot(t, x[:, 0], label='px')
    axes.plot(t, x[:, 1], '--', label='py')
    for moment, what, side in (
            (FIRST_STEP, 'step', 'left'), (CHANGE, 'new weights', 'right'),
            (SECOND_STEP, 'step', 'left'), (GUST, 'gust', 'left'),
            (REFUSAL, 'rejected change', 'left')):
        axes.axvline(moment, color='0.8', linewidth=0.8, zorder=0)
        axes.annotate(what, (moment, 0.03), (4 if side == 'left' else -4, 0),
                      xycoords=('data', 'axes fraction'), textcoords='offset points',
                      rotation=90, fontsize=9, color='0.3', ha=side, va='bottom')
    axes.set(xlim=(-2, END), ylim=(LABELS, 2.3), xlabel='time [s]', ylabel='position [m]',
             yticks=np.arange(0.0, 2.1, 0.5), title='Whole flight')
    axes.legend(loc='center', bbox_to_anchor=(0.62, 0.55))


def _tilt(axes: Axes, t: Array, x: Array) -> None:
    axes.plot(t, np.degrees(x[:, 2]))
    axes.set(xlim=(0, END), xlabel='time [s]', ylabel='angle theta [deg]', title='Tilt')
