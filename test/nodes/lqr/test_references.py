# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""lqr_node in its own process: which references it takes up, and that nothing jumps."""

import math
from typing import Any

from lqr_bench import Bench, LATCHED, matrix, reference
import numpy as np
from numpy.typing import NDArray
from obc_ros.msg import Trajectory
import pytest
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger

pytestmark = pytest.mark.nodes

Array = NDArray[np.float64]

ROSOUT = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
WARN = Log.WARN
LENGTH = 2.0   # [m] wheelbase
DRIVE = {'system': 'vehicle', 'setpoint': [0.0, 0.0, 0.0], 'setpoint_input': [10.0, 0.0]}


def listen(probe: Any) -> list[Log]:
    """Return the list that the lines of the log are appended to."""
    return probe.listen(Log, '/rosout', ROSOUT)  # type: ignore[no-any-return]


def warned(probe: Any, log: list[Log], words: str) -> str:
    """Return the first warning with these words."""
    return str(probe.wait_for(
        lambda: next((each.msg for each in log
                      if each.level == WARN and words in each.msg), None),
        what=f'a warning of {words}'))


def straight(begin: float, length: float, speed: float = 10.0) -> tuple[Array, Array, Array]:
    """Return times, states and inputs along the road."""
    t = np.linspace(0.0, length / speed, 101)
    return (t, np.column_stack([begin + speed * t, 0.0 * t, 0.0 * t]),
            np.column_stack([speed + 0.0 * t, 0.0 * t]))


def turn(x: Array, speed: float, rate: float, duration: float, length: float = LENGTH
         ) -> tuple[Array, Array, Array]:
    """Return times, states and inputs of a vehicle on a circle from a state on, in closed form."""
    t = np.linspace(0.0, duration, 401)
    theta, radius = x[2] + rate * t, speed / rate
    return (t, np.column_stack([x[0] + radius * (np.sin(theta) - math.sin(x[2])),
                                x[1] - radius * (np.cos(theta) - math.cos(x[2])), theta]),
            np.column_stack([speed + 0.0 * t, math.atan(length * rate / speed) + 0.0 * t]))


def drive(bench: Bench, x: Array, begin: float, end: float) -> tuple[Array, Array]:
    """Answer states of a vehicle each 10 ms; return the last state and the commands."""
    commands, h = [], 0.01
    for k in range(round(begin / h), round(end / h)):
        v, phi = u = bench.answer(x, h * k)
        commands.append(u)
        theta = x[2] + h * v / LENGTH * math.tan(phi)
        middle = 0.5 * (x[2] + theta)
        x = np.array([x[0] + h * v * math.cos(middle), x[1] + h * v * math.sin(middle), theta])
    return x, np.array(commands)


def refusals(bench: Bench, count: int) -> str:
    """Return the last refusal, once diagnostics count so many."""
    status = bench.report(
        'design', lambda _, values: values['changes refused'] == str(count))
    return str({each.key: each.value for each in status.values}['last refusal'])


# Where it starts


def test_a_plan_from_elsewhere_is_refused_and_moves_nothing(spawn: Any, probe: Any) -> None:
    """A vehicle at px = 58.7 with a plan from 0: it goes on as before, to the last digit."""
    bench, log = Bench(spawn, probe, **DRIVE, start_tolerance=[2.0, 1.0, 0.5]), listen(probe)
    publisher = probe.publisher(Trajectory, 'reference', LATCHED)
    x, _ = drive(bench, np.array([57.7, 0.0, 0.0]), 0.0, 0.1)
    bench.answer(x, 0.1)
    assert x[0] == pytest.approx(58.7)
    publisher.publish(reference(*straight(0.0, 20.0)))
    assert warned(probe, log, 'a reference was rejected').endswith(
        "px is 58.7 m from the plan's start 0 m, allowed 2 m")
    assert refusals(bench, 1) == ("reference: px is 58.7 m from the plan's start 0 m, "
                                  'allowed 2 m')
    commands = drive(bench, x, 0.1, 2.0)[1]
    assert np.abs(commands - [10.0, 0.0]).max() < 1e-9


def test_every_state_that_is_too_far_is_named(spawn: Any, probe: Any) -> None:
    """The bounds are a tenth of the range, or x_limits; nothing else need be given."""
    bench, log = Bench(spawn, probe, **DRIVE), listen(probe)
    publisher = probe.publisher(Trajectory, 'reference', LATCHED)
    bench.answer([58.7, 0.25, 0.0], 5.0)
    publisher.publish(reference(*straight(0.0, 20.0)))
    assert warned(probe, log, 'px is 58.7').endswith(
        "px is 58.7 m from the plan's start 0 m, allowed 2 m; "
        "py is 0.25 m from the plan's start 0 m, allowed 0.1 m")
    assert bench.set(x_limits=[60.0, 0.2, 0.3]).successful
    publisher.publish(reference(*straight(0.0, 20.0)))
    assert warned(probe, log, 'allowed 0.2').endswith(
        "rejected: py is 0.25 m from the plan's start 0 m, allowed 0.2 m")
    assert refusals(bench, 2).startswith('reference: py is 0.25 m')


def test_a_reference_of_the_future_is_judged_when_it_begins(spawn: Any, probe: Any) -> None:
    """By the state then: one is refused, the next one is followed."""
    bench, log = Bench(spawn, probe, **DRIVE, start_tolerance=[1.0, 0.5, 0.5]), listen(probe)
    publisher = probe.publisher(Trajectory, 'reference', LATCHED)
    x, _ = drive(bench, np.zeros(3), 0.0, 0.5)
    publisher.publish(reference(*straight(5.0, 20.0), 1.0))   # that is where it is now
    bench.process.wait_for_output('a reference of 2 s')
    x, commands = drive(bench, x, 0.5, 1.5)
    assert warned(probe, log, 'a reference was rejected').endswith(
        "px is 5 m from the plan's start 5 m, allowed 1 m")
    assert np.abs(commands - [10.0, 0.0]).max() < 1e-9
    publisher.publish(reference(*straight(20.5, 30.0), 2.0))  # where it will be, half a metre on
    bench.process.wait_for_output('a reference of 3 s')
    x, commands = drive(bench, x, 1.5, 2.5)
    bench.process.wait_for_output('the reference of 3 s begins')
    assert np.abs(commands[:50] - [10.0, 0.0]).max() < 1e-9
    assert commands[50][0] > 10.1
    assert refusals(bench, 1)


def test_a_reference_before_the_first_state_is_judged_by_that(spawn: Any, probe: Any) -> None:
    """Nothing is commanded before, and the first command is that of the set point."""
    bench, log = Bench(spawn, probe, **DRIVE), listen(probe)
    probe.publisher(Trajectory, 'reference', LATCHED).publish(reference(*straight(0.0, 20.0)))
    bench.process.wait_for_output('a reference of 2 s')
    assert not bench.commands
    assert np.abs(bench.answer([58.7, 0.0, 0.0], 3.0) - [10.0, 0.0]).max() < 1e-9
    assert warned(probe, log, 'a reference was rejected').endswith(
        "px is 58.7 m from the plan's start 0 m, allowed 2 m")


# After an outage


def lose(bench: Bench) -> None:
    """Send no state until on_stale commands the input at rest."""
    seen = len(bench.commands)
    bench.probe.wait_for(lambda: len(bench.commands) > seen, what='a command without a state')
    assert not any(bench.commands[seen].u)


def test_a_reference_is_judged_again_after_an_outage(spawn: Any, probe: Any) -> None:
    """The vehicle has stopped meanwhile: the reference is given up; it stands until ~/start."""
    bench = Bench(spawn, probe, **DRIVE, start_tolerance=[2.0, 1.0, 0.5], state_timeout=0.5)
    log = listen(probe)
    bench.ask(np.zeros(3))
    probe.publisher(Trajectory, 'reference', LATCHED).publish(
        reference(*straight(100.0, 50.0), 100.0))
    bench.process.wait_for_output('a reference of 5 s')
    x, _ = drive(bench, np.array([100.0, 0.2, 0.0]), 100.0, 101.0)
    lose(bench)
    commands = drive(bench, x, 102.0, 102.2)[1]
    assert (commands == 0.0).all()                # at rest, as while no state came
    words = warned(probe, log, 'a reference was rejected: after ')
    seconds, rest = words.removeprefix('a reference was rejected: after ').split(' s ', 1)
    assert float(seconds) >= 0.5
    distance = abs(x[0] - 120.0)
    assert distance == pytest.approx(10.0, abs=0.2)
    assert rest == (f'without a state, px is {distance:.4g} m from 120 m of the plan at t = 2 s, '
                    'allowed 2 m; stopped until ~/start')
    bench.report('commands', lambda status, _: status.message.startswith(
        f'stopped: after {seconds} s without a state, px is '))
    assert rest in refusals(bench, 1)
    assert probe.call(Trigger, '/lqr_node/start').success
    first = bench.answer(x, 102.3)                # the set point moves on from where it is
    assert first[0] == pytest.approx(10.0, abs=1e-6)
    assert abs(first[1]) < 0.2
    assert not [each for each in log if 'has ended' in each.msg]


def test_a_reference_goes_on_after_an_outage(spawn: Any, probe: Any) -> None:
    """The vehicle has rolled on, and is where the reference is."""
    bench = Bench(spawn, probe, **DRIVE, start_tolerance=[2.0, 1.0, 0.5], state_timeout=0.5)
    log = listen(probe)
    bench.ask(np.zeros(3))
    probe.publisher(Trajectory, 'reference', LATCHED).publish(
        reference(*straight(100.0, 50.0), 100.0))
    bench.process.wait_for_output('a reference of 5 s')
    drive(bench, np.array([100.0, 0.0, 0.0]), 100.0, 101.0)
    lose(bench)
    x, commands = drive(bench, np.array([119.0, 0.0, 0.0]), 102.0, 105.5)
    assert commands[0][0] > 10.1
    assert x[0] == pytest.approx(150.0 + 5.0, abs=1.0)
    bench.process.wait_for_output('the reference of 5 s has ended')
    assert not [each.msg for each in log if 'rejected' in each.msg]


# Whether the plant can follow it


def test_what_the_plant_cannot_follow_is_refused(spawn: Any, probe: Any) -> None:
    """Inputs beyond the limits, and the path of another plant."""
    bench, log = Bench(spawn, probe, **DRIVE, u_limits=[0.0, 15.0, -0.6, 0.6]), listen(probe)
    publisher = probe.publisher(Trajectory, 'reference', LATCHED)
    bench.answer(np.zeros(3), 1.0)
    publisher.publish(reference(*straight(0.0, 20.0, 16.0)))
    assert warned(probe, log, 'v is 16 m/s').endswith(
        'v is 16 m/s at t = 0 s, the limit is 15 m/s')
    t, x, u = turn(np.zeros(3), 10.0, 0.8, 4.0)
    other = turn(np.zeros(3), 10.0, 0.8, 4.0, 2.0 * LENGTH)[2]
    publisher.publish(reference(t, x, other))
    assert 'with its inputs theta deviates by' in warned(
        probe, log, 'the reference does not satisfy the dynamics')
    t, x, u = straight(0.0, 20.0)
    publisher.publish(reference(t, x * [5.0, 1.0, 1.0], u))   # 50 m/s with an input of 10 m/s
    assert 'px deviates by' in warned(probe, log, 'with its inputs px')
    assert refusals(bench, 3).startswith('reference: the reference does not satisfy the dynamics')
    assert np.abs(bench.answer([0.1, 0.0, 0.0], 1.01) - [10.0, 0.0]).max() < 1e-9


# Re-planning


@pytest.mark.parametrize('stamped', [True, False])
def test_planning_anew_while_following_does_not_jump(spawn: Any, probe: Any, stamped: bool
                                                     ) -> None:
    """A new reference from the state at the hand-over: the command changes as the inputs do."""
    bench = Bench(spawn, probe, **DRIVE)
    publisher = probe.publisher(Trajectory, 'reference', LATCHED)
    bench.answer(np.zeros(3), 0.99)
    first = turn(np.zeros(3), 9.0, 0.3, 6.0)
    publisher.publish(reference(*first, 1.0))
    bench.process.wait_for_output('a reference of 6 s')
    x, before = drive(bench, np.zeros(3), 1.0, 3.0)
    assert np.abs(before - first[2][0]).max() < 1e-3
    t, path, u = turn(x, 8.0, -0.2, 4.0)
    message = reference(t, path, u, 3.0)
    if not stamped:  # it begins at the last state, which is one step back
        message = reference(t, path - path[1] + path[0], u)
    publisher.publish(message)
    bench.process.wait_for_output('a reference of 4 s')
    x, after = drive(bench, x, 3.0, 5.0)
    bench.process.wait_for_output('the reference of 4 s begins')
    differ = np.abs(u[0] - first[2][0])
    steps = np.abs(np.diff(np.concatenate([before[-1:], after]), axis=0))
    slack = 2e-2 if not stamped else 1e-3
    assert (steps[0] <= differ + slack).all(), steps.max(axis=0)
    assert (steps[1:] <= slack).all(), steps.max(axis=0)
    assert np.abs(after[-1] - u[0]).max() < slack
    assert matrix(bench.design(1).k, 2).any()
