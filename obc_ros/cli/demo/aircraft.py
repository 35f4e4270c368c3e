# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The aircraft of Example 2.5: steps, new weights in flight, a gust, a rejected change."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.bodies import ARM, draw_aircraft, PLUME
from obc_ros.api.figures.style import get_line, LINE_COLOURS, new_figure, THIN
from obc_ros.cli.demo.flight import (
    Flight,
    FlightEvent,
    fly,
    make_gust,
    measure_step,
    report_loop,
    save_drawing,
    set_parameters,
)
from obc_ros.cli.flight_client import Pilot
from obc_ros.cli.terminal import print_table
from obc_ros.core.numerics.arrays import Array
from obc_ros.msg import LqrDesign

FIRST_STEP, CHANGE, SECOND_STEP, GUST, REFUSAL, END = 1.0, 12.0, 13.0, 31.0, 37.0, 41.0
LABELS = -2.2  # [m] lower end of the axis: the labels of the events are below the curves
SHOWN = 3.0  # [s] after the second step
POSES = (0.0, 1.2, 3.0), (0.3, 0.7, 1.4, 3.0, 10.0)  # [s] after the steps
SHRUNK = 0.35  # size of the drawn aircraft
# The weights printed in Example 2.5; 5 degrees correspond to 1.3131 instead of 2 pi / 9.
EXAMPLE_2_5 = {'Qx': [100.0, 1.0, 2 * pi / 9, 0.0, 0.0, 0.0], 'Qu': [0.1, 0.1]}


@dataclass(frozen=True)
class UnitStep:
    """A unit step in x and y: begin [s], start [m], span [s], weights and design."""

    begin: float
    start: float
    span: float
    weights: str
    design: LqrDesign


def run(out: Path, real_time: bool, formats: Sequence[str]) -> int:
    """Run the flight, print its figures of merit and plot it; return the exit status."""
    steps: list[UnitStep] = []
    flight = Flight('aircraft', 'aircraft.yaml', END, (
        FlightEvent(FIRST_STEP, 'step to (1, 1) with Qx = I',
              lambda pilot: _step(pilot, steps, 0.0, 10.0, 'Qx = I')),
        FlightEvent(CHANGE, 'weights of Example 2.5, in flight',
                    lambda pilot: str(_change(pilot, EXAMPLE_2_5).sentence)),
        FlightEvent(SECOND_STEP, 'step to (2, 2) with the weights of Example 2.5',
              lambda pilot: _step(pilot, steps, 1.0, 15.0, 'Example 2.5')),
        FlightEvent(GUST, 'a gust from the side, 4 N for 1 s', lambda pilot: ''),
        FlightEvent(REFUSAL, 'Qu = [-0.1, 0.1]',
                    set_parameters('lqr_node', {'Qu': [-0.1, 0.1]}, refused=True))),
        plant=make_gust(GUST))
    return fly(flight, out, real_time, lambda pilot, wall: _conclude(
        pilot, wall, steps, out, formats))


def _step(pilot: Pilot, steps: list[UnitStep], start: float, span: float, weights: str) -> str:
    goal, asked = start + 1.0, pilot.now
    design = _change(pilot, {'setpoint': [goal, goal, 0.0, 0.0, 0.0, 0.0]})
    steps.append(UnitStep(asked, start, span, weights, design))
    return ''


def _change(pilot: Pilot, values: dict[str, list[float]]) -> LqrDesign:
    """Set parameters of lqr_node; return the new design."""
    before = pilot.designs[-1].revision
    set_parameters('lqr_node', values)(pilot)
    pilot.wait(lambda: pilot.designs[-1].revision > before, 'the new design')
    return pilot.designs[-1]


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
    print(save_drawing(lambda: _draw(t, x, tu, u, steps), out / 'aircraft', formats),
          f'  recording {out / "aircraft"}')
    return 0


def _jump(asked: float, t: Array, u: Array) -> float:
    """Return the time [s] of the first jump of the command after a step was requested."""
    after = np.flatnonzero((t[1:] > asked) & (np.abs(np.diff(u, axis=0)).max(axis=1) > 0.5))
    return float(t[1 + after[0]])


def _draw(t: Array, x: Array, tu: Array, u: Array, steps: list[UnitStep]) -> Figure:
    figure: Figure = new_figure(8.6)
    grid = figure.add_gridspec(2, 2, height_ratios=(1.35, 1.0))
    plane = figure.add_subplot(grid[0, :])
    for index, step in enumerate(steps):
        during = (t >= step.begin) & (t <= step.begin + step.span)
        plane.plot(*x[during, :2].T, label=f'step, {step.weights}', **get_line(index))
    for moments, step in zip(POSES, steps, strict=True):
        for moment in moments:
            at = t.searchsorted(step.begin + moment).clip(max=len(t) - 1)
            force = u[tu.searchsorted(t[at], 'right').clip(1) - 1]
            px, py, theta = x[at, :3]
            draw_aircraft(plane, px, py, theta, force, arm=SHRUNK * ARM, plume=SHRUNK * PLUME)
            plane.annotate(f'{moment:g} s', (px, py), (16, -18), textcoords='offset points')
    plane.set(aspect='equal', xlim=(-0.35, 3.0), ylim=(-0.3, 2.3), xlabel='$p_x$ [m]',
              ylabel='$p_y$ [m]')
    plane.legend(loc='upper left')
    fast = steps[-1]
    _thrust(figure.add_subplot(grid[1, 0]), t, x, tu, u, fast)
    _flight(figure.add_subplot(grid[1, 1]), t, x)
    later = (t >= fast.begin) & (t <= fast.begin + fast.span)
    fall, tilt = fast.start - x[later, 1].min(), np.degrees(np.abs(x[later, 2]).max())
    figure.suptitle(f'The fast step in $p_x$ tilts the aircraft by up to {tilt:.0f}°. Tilted, its '
                    f'thrust does not\ncarry its weight, and $p_y$ falls by {fall:.2f} m before '
                    'it climbs. (Three nodes over DDS)')
    return figure


def compute_lift(x: Array, u: Array) -> Array:
    """Return f1 sin theta + f2 cos theta [N] for states (N, 6) and forces f1, f2 (N, 2) [N]."""
    lift: Array = u[:, 0] * np.sin(x[:, 2]) + u[:, 1] * np.cos(x[:, 2])
    return lift


def _thrust(axes: Axes, t: Array, x: Array, tu: Array, u: Array, step: UnitStep) -> None:
    """Draw the vertical part of the thrust and the weight in the first seconds of a step."""
    during = (t >= step.begin) & (t <= step.begin + SHOWN)
    force = u[tu.searchsorted(t[during], 'right') - 1]
    time, lift, weight = t[during] - step.begin, compute_lift(x[during], force), step.design.ue[1]
    axes.plot(time, lift, label='vertical thrust', **get_line(1))
    axes.axhline(weight, color='black', linewidth=1.3, label='weight $m g$')
    axes.fill_between(time, lift, weight, where=lift < weight, color=LINE_COLOURS[1], alpha=0.25)
    axes.set(xlim=(0, SHOWN), xlabel='time since the step [s]', ylabel='force [N]',
             title=f'step, {step.weights}')
    axes.legend(loc='lower right')


def _flight(axes: Axes, t: Array, x: Array) -> None:
    for index, name in enumerate(('$p_x$', '$p_y$')):
        axes.plot(t, x[:, index], label=name, **get_line(index))
    for moment, what, side in (
            (FIRST_STEP, 'step', 'left'), (CHANGE, 'new weights', 'right'),
            (SECOND_STEP, 'step', 'left'), (GUST, 'gust', 'left'),
            (REFUSAL, 'refusal', 'left')):
        axes.axvline(moment, **THIN)
        axes.annotate(what, (moment, 0.03), (2 if side == 'left' else -2, 0),
                      xycoords=('data', 'axes fraction'), textcoords='offset points',
                      rotation=90, ha=side, va='bottom')
    axes.set(xlim=(-2, END), ylim=(LABELS, 2.3), xlabel='time [s]', ylabel='position [m]',
             yticks=[0, 1, 2], title='the whole flight')
    axes.legend(loc='center', bbox_to_anchor=(0.62, 0.6))
