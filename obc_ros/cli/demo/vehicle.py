# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The vehicle: it follows a planned lane change, and the slalom of Exercise 2.10."""

from array import array
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import EXACT, get_line, new_figure, THIN
from obc_ros.cli.demo.flight import Flight, FlightEvent, fly, report_loop, save_drawing
from obc_ros.cli.flight_client import Pilot
from obc_ros.cli.terminal import print_table
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems.courses import build_lateral_reference, make_slalom
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import NamedBounds, Trajectory
from obc_ros.srv import PlanMotion

SPEED, LENGTH = 10.0, 2.0  # [m/s], the v_d of Exercise 2.10, and the wheelbase [m]
AMPLITUDE, FREQUENCY, COURSE = 1.0, 1.0, 6.0  # [m], [Hz], [s] of slalom
AHEAD = 1.0  # [s] from the request for a plan until it begins


def run(out: Path, real_time: bool, formats: Sequence[str]) -> int:
    """Drive both courses, print figures of merit and plot them; return the exit status."""
    planned: list[Trajectory] = []
    course: list[Trajectory] = []
    change = Flight('lane_change', 'vehicle.yaml', 14.0, (
        FlightEvent(1.0, 'plan a lane change of 4 m within 100 m',
                    lambda pilot: _plan(pilot, planned)),
    ))
    weaving = Flight('slalom', 'vehicle_lateral.yaml', 2.0 + COURSE, (
        FlightEvent(1.0, f'slalom of {AMPLITUDE:g} m and {FREQUENCY:g} Hz at {SPEED:g} m/s',
              lambda pilot: _slalom(pilot, course)),))
    status = fly(change, out, real_time, lambda pilot, wall: _conclude(
        pilot, wall, planned[0], 1, 'lane change', out, formats))
    return status or fly(weaving, out, real_time, lambda pilot, wall: _conclude(
        pilot, wall, course[0], 0, 'slalom', out, formats))


def _plan(pilot: Pilot, planned: list[Trajectory]) -> str:
    """Plan from the predicted state of the vehicle, and publish the plan as the reference."""
    with pilot.hold():
        begin = pilot.states.stamp[-1] + int(AHEAD * 1e9)
        px = float(pilot.x[0]) + SPEED * AHEAD
        answer = pilot.call(PlanMotion, 'trajectory_server/plan', PlanMotion.Request(
            system='vehicle', start=[px, -2.0, 0.0], goal=[px + 100.0, 2.0, 0.0],
            objective='effort', final_time=10.0, input_bounds=[
                NamedBounds(name='v', lower='8', upper='12'),
                NamedBounds(name='phi', lower='-0.1', upper='0.1')]))
        if not answer.success:
            raise ObcError(f'no plan: {answer.message}')
        planned.append(_publish(pilot, answer.trajectory, begin))
    return str(answer.message)


def _slalom(pilot: Pilot, course: list[Trajectory]) -> str:
    """Publish y = r(t) with the heading and the steering that flatness gives for it."""
    t = np.linspace(0.0, COURSE, int(COURSE * 500) + 1)
    x, phi = build_lateral_reference(*make_slalom(t, AMPLITUDE, FREQUENCY, end=COURSE), SPEED,
                                     LENGTH)
    trajectory = Trajectory(
        system='vehicle_lateral', state_names=['py', 'theta'], input_names=['phi'],
        t=array('d', t), x=array('d', x.ravel()), u=array('d', phi.ravel()),
        interpolation='linear')
    with pilot.hold():
        course.append(_publish(pilot, trajectory, pilot.states.stamp[-1] + int(0.2e9)))
    return f'steering up to {np.abs(phi).max():.2f} rad'


def _publish(pilot: Pilot, trajectory: Trajectory, begin: int) -> Trajectory:
    """Publish a reference; time must be paused until lqr_node has the gains along it."""
    trajectory.header.stamp.sec, trajectory.header.stamp.nanosec = divmod(begin, 10**9)
    said = len(pilot.said)
    pilot.publisher.publish(trajectory)
    # Not 'the reference has ended', which the one before it may still say.
    pilot.wait(lambda: any(each.name.endswith('lqr_node') and each.msg.startswith('a reference')
                           for each in pilot.said[said:]), 'lqr_node to take the reference')
    return trajectory


def _conclude(pilot: Pilot, wall: float, reference: Trajectory, lateral: int, name: str,
              out: Path, formats: Sequence[str]) -> int:
    t, x, tu, u = pilot.history()
    begin = (reference.header.stamp.sec * 10**9 + reference.header.stamp.nanosec
             - pilot.states.stamp[0]) * 1e-9
    times = np.asarray(reference.t) + begin
    wanted = np.asarray(reference.x).reshape(times.size, -1)
    during = (t >= times[0]) & (t <= times[-1])
    error = x[during, lateral] - np.interp(t[during], times, wanted[:, lateral])
    heading = x[during, lateral + 1] - np.interp(t[during], times, wanted[:, lateral + 1])
    print_table((name, ''), [
        ('maximum lateral error', f'{1e3 * np.abs(error).max():.2f} mm'),
        ('lateral error at the end', f'{1e3 * abs(error[-1]):.2f} mm'),
        ('maximum heading error', f'{1e3 * np.abs(heading).max():.2f} mrad'),
        ('maximum steering angle', f'{np.abs(u[:, -1]).max():.3f} rad'),
        *report_loop(pilot, wall)])
    print(save_drawing(
        lambda: _draw(name, (times, wanted[:, lateral]), (t, x[:, lateral]), (t[during], error),
                      (tu, u[:, -1])), out / name.replace(' ', '_'), formats))
    return 0


def _draw(name: str, wanted: tuple[Array, Array], driven: tuple[Array, Array],
          error: tuple[Array, Array], steering: tuple[Array, Array]) -> Figure:
    figure: Figure = new_figure(7.0)
    axes = figure.subplots(3, 1, sharex=True)
    axes[0].plot(*driven, label='driven', **get_line(0))
    axes[0].plot(*wanted, label='reference', **EXACT)
    axes[0].set(ylabel='$p_y$ [m]')
    figure.legend(loc='outside lower center', ncols=2)
    axes[1].plot(error[0], 1e3 * error[1], **get_line(0))
    axes[1].axhline(0.0, **THIN)
    axes[1].set(ylabel='error of $p_y$ [mm]')
    axes[2].plot(*steering, drawstyle='steps-post', **get_line(0))
    axes[2].set(ylabel=r'steering $\phi$ [rad]', xlabel='time [s]')
    figure.align_ylabels()
    figure.suptitle(f'Vehicle at {SPEED:g} m/s: {name}, three nodes over DDS')
    return figure
