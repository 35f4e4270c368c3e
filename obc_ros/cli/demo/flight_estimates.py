# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The aircraft without its state: lqr_node with the estimate from late and lost measurements."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import get_line, label_unit, LINE_COLOURS, new_figure, THIN
from obc_ros.cli.demo.flight import Flight, FlightEvent, fly, make_gust, report_loop, save_drawing
from obc_ros.cli.flight_client import Pilot, Samples
from obc_ros.cli.terminal import print_table
from obc_ros.core.estimation.filter import Consistency
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems.equilibrium import find_equilibrium
from obc_ros.core.systems.registry import get_system
from obc_ros.msg import Estimate, Measurement
from rclpy.serialization import deserialize_message

CONFIG, DURATION, GUST = 'aircraft.yaml', 16.0, 8.0   # the times in [s]
# The estimator has the same rate, so that there is an estimate for each state in lockstep.
PLANT = ('-p', 'publish_rate:=100.0', '-p', 'x0:=[1.0, 0.5, 0.0, 0.0, 0.0, 0.0]',
         *make_gust(GUST))
WHOLE, ESTIMATED = 'estimates_whole_state', 'estimates'   # the recordings
# The loop holds if the aircraft is that near to its set point in the last seconds.
NEAR, LAST = 0.5, 3.0   # [m], [s]
NORMAL = 1.96           # standard deviations of a 95 % band
OUTPUTS = {'gps_x': 'px', 'attitude': 'theta'}   # drawn, with their states
INNOVATIONS = 'attitude', 'gyro'   # of the sensor that is the newest one in most estimates


@dataclass(frozen=True, eq=False)
class EstimatedFlight:
    """
    What a flight with an estimator left.

    :ivar t, x: (N,), (N, n), times [s] and true states.
    :ivar te, xe, deviation: (K,), (K, n), (K, n), times [s] of the estimates, means and standard
        deviations.
    :ivar measured: times [s] and values of each output.
    :ivar innovations: times [s] of the measurements and normalised innovations of each output, as
        far as they are in an estimate.
    :ivar consistency: (K, 3), of each estimate: mean of the last normalised innovations squared,
        relative to its expectation, and the ends of its 95 % band.
    """

    t: Array
    x: Array
    te: Array
    xe: Array
    deviation: Array
    measured: dict[str, tuple[Array, Array]]
    innovations: dict[str, tuple[Array, Array]]
    consistency: Array

    @property
    def error(self) -> Array:
        """Return the errors (K, n) of the estimates."""
        errors: Array = self.xe - np.column_stack([np.interp(self.te, self.t, column)
                                                   for column in self.x.T])
        return errors


def run(out: Path, real_time: bool, formats: Sequence[str]) -> int:
    """Fly with the whole state and with the estimate, print the errors, and plot them."""
    known: list[tuple[Array, Array]] = []
    rest = tuple(find_equilibrium(get_system('aircraft'), None).u)
    for name, sensors, conclude in (
            (WHOLE, '', partial(_keep_whole_state, known)),
            (ESTIMATED, CONFIG, partial(_conclude, known, out, formats))):
        what = 'estimator_node' if sensors else 'the whole state'
        flight = Flight(name, CONFIG, DURATION, (
            FlightEvent(0.0, f'fly 1 m back and 0.5 m down to the origin, with {what}',
                  lambda pilot: ''),
            FlightEvent(GUST, 'a gust from the side, 4 N for 1 s', lambda pilot: '')),
            plant=PLANT, sensors=sensors, rest=rest if sensors else ())
        if status := fly(flight, out, real_time, conclude):
            return status
    return 0


def _keep_whole_state(known: list[tuple[Array, Array]], pilot: Pilot, wall: float) -> int:
    known.append(pilot.history()[:2])
    return 0


def _conclude(known: list[tuple[Array, Array]], out: Path, formats: Sequence[str], pilot: Pilot,
              wall: float) -> int:
    flown, [whole] = read_flight(pilot), known
    print_table(('rms from 2 s on', 'error of the estimate', 'expected by the filter',
                 'in the 95 % band', 'from the set point, whole state',
                 'from the set point, estimate'), list(_list_errors(flown, whole)))
    held, words = judge_flight(flown.t, flown.x)
    counts = pilot.told.get('estimate', {})
    ratio, low, high = flown.consistency[-1]
    print_table(('the loop', ''), [
        ('held' if held else 'NOT HELD', words),
        ('innovations', str(Consistency(ratio, low, high, len(flown.te)))),
        *((f'measurements {what}', counts.get(f'measurements {what}', ''))
          for what in ('used', 'missing', 'outliers')),
        ('states without an estimate', str(pilot.stood_in)),
        *report_loop(pilot, wall)])
    print(save_drawing(lambda: _draw(flown, whole), out / 'estimates', formats),
          f'  recording {out / ESTIMATED}')
    return 0 if held else 1


def read_flight(pilot: Pilot) -> EstimatedFlight:
    """Return what a pilot has recorded of a flight with an estimator."""
    t, x = pilot.history()[:2]
    start = pilot.states.stamp[0]
    estimates = [deserialize_message(data, Estimate) for data in pilot.estimates.data]
    te = _seconds(pilot.estimates, start)
    n = x.shape[1]
    P = np.array([each.covariance for each in estimates]).reshape(-1, n, n)
    measured: dict[str, list[tuple[float, float]]] = {}
    for at, data in zip(_seconds(pilot.measurements, start), pilot.measurements.data, strict=True):
        message = deserialize_message(data, Measurement)
        for name, value in zip(message.names, message.y, strict=True):
            measured.setdefault(name, []).append((at, value))
    innovations: dict[str, list[tuple[float, float]]] = {}
    for at, each in zip(te, estimates, strict=True):
        for name, value in zip(each.names, each.innovation, strict=True):
            innovations.setdefault(name, []).append((at - each.age, value))
    return EstimatedFlight(
        t, x, te, np.array([each.x for each in estimates]),
        np.sqrt(np.diagonal(P, axis1=1, axis2=2)), _columns(measured), _columns(innovations),
        np.array([(each.consistency, *each.band) for each in estimates]))


def _seconds(samples: Samples, start: int) -> Array:
    return (np.array(samples.stamp) - start) * 1e-9


def _columns(rows: dict[str, list[tuple[float, float]]]) -> dict[str, tuple[Array, Array]]:
    """Return times and values by name; what is repeated occurs once."""
    found = {name: np.unique(np.array(each), axis=0).T for name, each in rows.items()}
    return {name: (times, values) for name, (times, values) in found.items()}


def judge_flight(t: Array, x: Array) -> tuple[bool, str]:
    """Return whether a loop holds the origin, and why, for t (N,) [s] and true states (N, n)."""
    distance = float(np.linalg.norm(x[t > t[-1] - LAST, :2], axis=1).max())
    return distance <= NEAR, (f'in the last {LAST:g} s at most {distance:.2f} m from the set '
                              f'point; wanted {NEAR:g} m')


def _list_errors(flown: EstimatedFlight, whole: tuple[Array, Array]) -> Iterator[tuple[str, ...]]:
    late, error = flown.te >= 2.0, flown.error
    for i, signal in enumerate(get_system('aircraft').states):
        found, spread = error[late, i], flown.deviation[late, i]
        inside = np.mean(np.abs(found) <= NORMAL * spread)
        yield (f'{signal.name} [{signal.unit}]', _rms(found), _rms(spread),
               f'{100 * inside:.1f} %', _rms(whole[1][whole[0] >= 2.0, i]),
               _rms(flown.x[flown.t >= 2.0, i]))


def _rms(values: Array) -> str:
    return f'{np.sqrt(np.mean(values**2)):.3f}'


def _draw(flown: EstimatedFlight, whole: tuple[Array, Array]) -> Figure:
    figure: Figure = new_figure(10.4)
    axes = figure.subplots(5, 1, sharex=True, height_ratios=(2.2, 1.6, 1.6, 1.3, 1.3))
    for panel, name in zip(axes, ('px', 'vx', 'theta'), strict=False):
        _draw_state(panel, flown, whole, name)
    for number, name in enumerate(INNOVATIONS):
        axes[3].plot(*flown.innovations[name], label=name, **_dots(number + 2))
    for level in (-NORMAL, NORMAL):
        axes[3].axhline(level, **THIN)
    axes[3].set(ylabel='innovation / σ', ylim=(-4.5, 4.5))
    axes[3].legend(loc='upper right', ncols=2, markerscale=3.0)
    ratio, low, high = flown.consistency.T
    axes[4].plot(flown.te, ratio, **get_line(0))
    axes[4].fill_between(flown.te, low, high, color='grey', alpha=0.25, linewidth=0)
    axes[4].set(ylabel='consistency', ylim=(0.0, 2.0), xlabel='time [s]', xlim=(0.0, DURATION))
    figure.legend(*axes[0].get_legend_handles_labels(), loc='outside lower center', ncols=2,
                  markerscale=3.0)
    figure.align_ylabels()
    figure.suptitle('Aircraft with gps at 10 Hz, attitude and gyro at 100 Hz, 50 ms late, 5 % '
                    'lost, over DDS')
    return figure


def _draw_state(axes: Axes, flown: EstimatedFlight, whole: tuple[Array, Array], name: str
                ) -> None:
    """Draw a state, its estimate with the 95 % band, and the measurements of its output."""
    system = get_system('aircraft')
    i, label = system.state_names.index(name), name
    band = NORMAL * flown.deviation[:, i]
    for output, state in OUTPUTS.items():
        if state == name and output in flown.measured:
            axes.plot(*flown.measured[output], label='measurements', zorder=1, **_dots(6))
            label = f'{name}, {output}'
    axes.fill_between(flown.te, flown.xe[:, i] - band, flown.xe[:, i] + band, linewidth=0,
                      color=LINE_COLOURS[1], alpha=0.25, label='95 % band of the estimate')
    axes.plot(whole[0], whole[1][:, i], label='regulator with the whole state', **THIN)
    axes.plot(flown.t, flown.x[:, i], label='true state', **get_line(0))
    axes.plot(flown.te, flown.xe[:, i], label='estimate', **get_line(1))
    shown = np.concatenate([flown.x[:, i], flown.xe[flown.te > 1.0, i]])
    margin = 0.25 * np.ptp(shown)
    axes.set(ylabel=label_unit(label, system.states[i].unit),
             ylim=(shown.min() - margin, shown.max() + margin))


def _dots(number: int) -> dict[str, Any]:
    return {'color': LINE_COLOURS[number], 'linestyle': 'none', 'marker': '.', 'markersize': 2.5}
