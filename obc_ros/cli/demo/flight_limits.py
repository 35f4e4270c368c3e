# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The aircraft with limits of speed and tilt: lqr_node exceeds the first, mpc_node none."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import get_line, new_figure, THIN
from obc_ros.cli.demo.flight import Flight, FlightEvent, fly, report_loop, save_drawing
from obc_ros.cli.flight_client import Pilot
from obc_ros.cli.terminal import print_table
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems.registry import get_system

CONFIG, DURATION = 'aircraft_limits.yaml', 8.0   # [s]
LIMITS = {'vx': 0.4, 'theta': 0.2}   # [m/s], [rad] of the parameter x_bounds in CONFIG
CONTROLLERS = {'lqr_node': 'lqr_node, without the limits', 'mpc_node': 'mpc_node'}
# Of the status of the plans in /diagnostics.
DEADLINES = ('deadlines wanted', 'deadlines missed')
TIMES = tuple(f'solve {which} [ms]' for which in ('p50', 'p99', 'max'))


@dataclass(frozen=True)
class Flown:
    """The states (N, n) and commands (M, m) of a flight, with their times [s]."""

    t: Array
    x: Array
    tu: Array
    u: Array

    def find_largest(self, name: str) -> float:
        """Return the largest absolute value of a state."""
        return float(np.abs(self.x[:, _index(name)]).max())


def run(out: Path, real_time: bool, formats: Sequence[str]) -> int:
    """Fly with both controllers, print what the limits became, and plot it."""
    flown: dict[str, Flown] = {}
    for controller in CONTROLLERS:
        flight = Flight(f'limits_{controller}', CONFIG, DURATION, (
            FlightEvent(0.0, 'fly 1 m back and 0.5 m down to the origin', lambda pilot: ''),),
            controller)
        if status := fly(flight, out, real_time, partial(_conclude, flown, controller)):
            return status
    print(save_drawing(lambda: _draw(flown), out / 'limits', formats))
    return 0


def _conclude(flown: dict[str, Flown], controller: str, pilot: Pilot, wall: float) -> int:
    told = pilot.told.get('plan', {})
    found = flown[controller] = Flown(*pilot.history())
    unit = get_system('aircraft').units
    rows = [(f'largest |{name}|, of {limit:g} {unit[name]}', f'{found.find_largest(name):.6f}')
            for name, limit in LIMITS.items()]
    if told.get('outcome'):
        rows += [('deadlines missed', f'{told[DEADLINES[1]]} of {told[DEADLINES[0]]}'),
                 ('time of a plan, p50, p99, max',
                  ', '.join(told[each] for each in TIMES) + ' ms')]
    print_table((controller, ''), [*rows, *report_loop(pilot, wall)])
    return 0


def _draw(flown: dict[str, Flown]) -> Figure:
    figure: Figure = new_figure(7.5)
    axes = figure.subplots(3, 1, sharex=True)
    for number, (controller, label) in enumerate(CONTROLLERS.items()):
        each = flown[controller]
        axes[0].plot(each.t, each.x[:, _index('px')], label=label, **get_line(number))
        for row, name in enumerate(LIMITS, start=1):
            axes[row].plot(each.t, each.x[:, _index(name)], **get_line(number))
    for row, limit in enumerate(LIMITS.values(), start=1):
        for bound in (-limit, limit):
            axes[row].axhline(bound, **THIN)
    axes[0].set(ylabel='$p_x$ [m]')
    axes[1].set(ylabel='$v_x$ [m/s]')
    axes[2].set(ylabel=r'tilt $\theta$ [rad]', xlabel='time [s]', xlim=(0.0, DURATION))
    figure.legend(loc='outside lower center', ncols=len(CONTROLLERS))
    figure.align_ylabels()
    figure.suptitle('Aircraft with limits of speed and tilt (thin lines), over DDS')
    return figure


def _index(name: str) -> int:
    return get_system('aircraft').state_names.index(name)
