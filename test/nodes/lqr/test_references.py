# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""lqr_node in its own process: checks of references, and smooth hand-overs."""

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
    """Return the list to which the log lines are appended."""
    return probe.listen(Log, '/rosout', ROSOUT)  # type: ignore[no-any-return]


def wait_for_warning(probe: Any, log: list[Log], words: str) -> str:
    """Return the first warning that contains `words`."""
    return str(probe.wait_for(
        lambda: next((each.msg for each in log
                      if each.level == WARN and words in each.msg), None),
        what=f'a warning of {words}'))


def straight(begin: float, length: float, speed: float = 10.0) -> tuple[Array, Array, Array]:
    """Return times, states and inputs of a straight drive."""
    t = np.linspace(0.0, length / speed, 101)
    return (t, np.column_stack([begin + speed * t, 0.0 * t, 0.0 * t]),
            np.column_stack([speed + 0.0 * t, 0.0 * t]))


def turn(x: Array, speed: float, rate: float, duration: float, length: float = LENGTH
         ) -> tuple[Array, Array, Array]:
    """Return times, states and inputs on a circle from the state x on, in closed form."""
    t = np.linspace(0.0, duration, 401)
    theta, radius = x[2] + rate * t, speed / rate
    return (t, np.column_stack([x[0] + radius * (np.sin(theta) - math.sin(x[2])),
                                x[1] - radius * (np.cos(theta) - math.cos(x[2])), theta]),
            np.column_stack([speed + 0.0 * t, math.atan(length * rate / speed) + 0.0 * t]))


def drive(bench: Bench, x: Array, begin: float, end: float) -> tuple[Array, Array]:
    """Simulate the vehicle in steps of 10 ms; return the last state and the commands."""
    commands, h = [], 0.01
    for k in range(round(begin / h), round(end / h)):
        v, phi = u = bench.answer(x, h * k)
        commands.append(u)
        theta = x[2] + h * v / LENGTH * math.tan(phi)
        middle = 0.5 * (x[2] + theta)
        x = np.array([x[0] + h * v * math.cos(middle), x[1] + h * v * math.sin(middle), theta])
    return x, np.array(commands)


def refusals(bench: Bench, count: int) -> str:
    """Return the last refusal, once diagnostics report `count` refusals."""
    status = bench.report(
        'design', lambda _, values: values['changes refused'] == str(count))
    return str({each.key: each.value for each in status.values}['last refusal'])


# Start of a reference


def test_a_plan_that_starts_elsewhere_is_refused(spawn: Any, probe: Any) -> None:
    """The vehicle is at px = 58.7 m, the plan starts at 0; the commands do not change."""
    bench, log = Bench(spawn, probe, **DRIVE, start_tolerance=[2.0, 1.0, 0.5]), listen(probe)
    publisher = probe.publisher(Trajectory, 'reference', LATCHED)
    x, _ = drive(bench, np.array([57.7, 0.0, 0.0]), 0.0, 0.1)
    bench.answer(x, 0.1)
    assert x[0] == pytest.approx(58.7)
    publisher.publish(reference(*straight(0.0, 20.0)))
    assert wait_for_warning(probe, log, 'a reference was rejected').endswith(
        "px is 58.7 m from the plan's start 0 m, allowed 2 m")
    assert refusals(bench, 1) == ("reference: px is 58.7 m from the plan's start 0 m, "
                                  'allowed 2 m')
    commands = drive(bench, x, 0.1, 2.0)[1]
    assert np.abs(commands - [10.0, 0.0]).max() < 1e-9


def test_a_refusal_names_every_state_that_is_too_far(spawn: Any, probe: Any) -> None:
    """The default bounds are a tenth of the range of the plan, or x_limits."""
    bench, log = Bench(spawn, probe, **DRIVE), listen(probe)
    publisher = probe.publisher(Trajectory, 'reference', LATCHED)
    bench.answer([58.7, 0.25, 0.0], 5.0)
    publisher.publish(reference(*straight(0.0, 20.0)))
    assert wait_for_warning(probe, log, 'px is 58.7').endswith(
        "px is 58.7 m from the plan's start 0 m, allowed 2 m; "
        "py is 0.25 m from the plan's start 0 m, allowed 0.1 m")
    assert bench.set(x_limits=[60.0, 0.2, 0.3]).successful
    publisher.publish(reference(*straight(0.0, 20.0)))
    assert wait_for_warning(probe, log, 'allowed 0.2').endswith(
        "rejected: py is 0.25 m from the plan's start 0 m, allowed 0.2 m")
    assert refusals(bench, 2).startswith('reference: py is 0.25 m')


def test_a_future_reference_is_checked_when_it_begins(spawn: Any, probe: Any) -> None:
    """The state at that time decides: one reference is refused, the next one is followed."""
    bench, log = Bench(spawn, probe, **DRIVE, start_tolerance=[1.0, 0.5, 0.5]), listen(probe)
    publisher = probe.publisher(Trajectory, 'reference', LATCHED)
    x, _ = drive(bench, np.zeros(3), 0.0, 0.5)
    publisher.publish(reference(*straight(5.0, 20.0), 1.0))   # starts at the present state
    bench.process.wait_for_output('a reference of 2 s')
    x, commands = drive(bench, x, 0.5, 1.5)
    assert wait_for_warning(probe, log, 'a reference was rejected').endswith(
        "px is 5 m from the plan's start 5 m, allowed 1 m")
    assert np.abs(commands - [10.0, 0.0]).max() < 1e-9
    publisher.publish(reference(*straight(20.5, 30.0), 2.0))  # starts 0.5 m ahead
    bench.process.wait_for_output('a reference of 3 s')
    x, commands = drive(bench, x, 1.5, 2.5)
    bench.process.wait_for_output('the reference of 3 s begins')
    assert np.abs(commands[:50] - [10.0, 0.0]).max() < 1e-9
    assert commands[50][0] > 10.1
    assert refusals(bench, 1)


def test_an_early_reference_is_checked_at_the_first_state(spawn: Any, probe: Any) -> None:
    """Nothing is commanded before the first state; then the set point is held."""
    bench, log = Bench(spawn, probe, **DRIVE), listen(probe)
    probe.publisher(Trajectory, 'reference', LATCHED).publish(reference(*straight(0.0, 20.0)))
    bench.process.wait_for_output('a reference of 2 s')
    assert not bench.commands
    assert np.abs(bench.answer([58.7, 0.0, 0.0], 3.0) - [10.0, 0.0]).max() < 1e-9
    assert wait_for_warning(probe, log, 'a reference was rejected').endswith(
        "px is 58.7 m from the plan's start 0 m, allowed 2 m")


def test_a_latched_reference_is_not_flown_again_by_a_restarted_node(spawn: Any, probe: Any
                                                                    ) -> None:
    """It has no stamp, and was published before the node started."""
    publisher = probe.node.create_publisher(Trajectory, 'reference', LATCHED)
    publisher.publish(reference(*straight(0.0, 20.0)))
    bench = Bench(spawn, probe, **DRIVE)
    log = listen(probe)
    assert 'before this node started, and has no stamp: publish it again' in wait_for_warning(
        probe, log, 'a reference was rejected: it was published')
    assert np.abs(drive(bench, np.zeros(3), 0.0, 0.5)[1] - [10.0, 0.0]).max() < 1e-9
    publisher.publish(reference(*straight(5.0, 20.0)))
    bench.process.wait_for_output('a reference of 2 s')
    drive(bench, np.array([5.0, 0.0, 0.0]), 0.5, 1.0)
    bench.process.wait_for_output('the reference of 2 s begins')


# After an outage


def wait_for_outage(bench: Bench) -> None:
    """Send no state until on_stale commands the equilibrium input."""
    seen = len(bench.commands)
    bench.probe.wait_for(lambda: len(bench.commands) > seen, what='a command without a state')
    assert not any(bench.commands[seen].u)


def test_a_far_reference_is_given_up_after_an_outage(spawn: Any, probe: Any) -> None:
    """The vehicle has stopped during the outage; it stays at rest until ~/start."""
    bench = Bench(spawn, probe, **DRIVE, start_tolerance=[2.0, 1.0, 0.5], state_timeout=0.5)
    log = listen(probe)
    bench.ask(np.zeros(3))
    probe.publisher(Trajectory, 'reference', LATCHED).publish(
        reference(*straight(100.0, 50.0), 100.0))
    bench.process.wait_for_output('a reference of 5 s')
    x, _ = drive(bench, np.array([100.0, 0.2, 0.0]), 100.0, 101.0)
    wait_for_outage(bench)
    commands = drive(bench, x, 102.0, 102.2)[1]
    assert (commands == 0.0).all()                # at rest, as during the outage
    words = wait_for_warning(probe, log, 'a reference was rejected: after ')
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
    first = bench.answer(x, 102.3)                # the set point moves on from x
    assert first[0] == pytest.approx(10.0, abs=1e-6)
    assert abs(first[1]) < 0.2
    assert not [each for each in log if 'has ended' in each.msg]


def test_a_near_reference_continues_after_an_outage(spawn: Any, probe: Any) -> None:
    """The vehicle has rolled on during the outage and is near the reference."""
    bench = Bench(spawn, probe, **DRIVE, start_tolerance=[2.0, 1.0, 0.5], state_timeout=0.5)
    log = listen(probe)
    bench.ask(np.zeros(3))
    probe.publisher(Trajectory, 'reference', LATCHED).publish(
        reference(*straight(100.0, 50.0), 100.0))
    bench.process.wait_for_output('a reference of 5 s')
    drive(bench, np.array([100.0, 0.0, 0.0]), 100.0, 101.0)
    wait_for_outage(bench)
    x, commands = drive(bench, np.array([119.0, 0.0, 0.0]), 102.0, 105.5)
    assert commands[0][0] > 10.1
    assert x[0] == pytest.approx(150.0 + 5.0, abs=1.0)
    bench.process.wait_for_output('the reference of 5 s has ended')
    assert not [each.msg for each in log if 'rejected' in each.msg]


# Feasibility


def test_an_infeasible_reference_is_refused(spawn: Any, probe: Any) -> None:
    """Inputs violate the limits, or states and inputs do not satisfy the dynamics."""
    bench, log = Bench(spawn, probe, **DRIVE, u_limits=[0.0, 15.0, -0.6, 0.6]), listen(probe)
    publisher = probe.publisher(Trajectory, 'reference', LATCHED)
    bench.answer(np.zeros(3), 1.0)
    publisher.publish(reference(*straight(0.0, 20.0, 16.0)))
    assert wait_for_warning(probe, log, 'v is 16 m/s').endswith(
        'v is 16 m/s at t = 0 s, the limit is 15 m/s')
    t, x, u = turn(np.zeros(3), 10.0, 0.8, 4.0)
    other = turn(np.zeros(3), 10.0, 0.8, 4.0, 2.0 * LENGTH)[2]
    publisher.publish(reference(t, x, other))
    assert 'with its inputs theta deviates by' in wait_for_warning(
        probe, log, 'the reference does not satisfy the dynamics')
    t, x, u = straight(0.0, 20.0)
    publisher.publish(reference(t, x * [5.0, 1.0, 1.0], u))   # 50 m/s with an input of 10 m/s
    assert 'px deviates by' in wait_for_warning(probe, log, 'with its inputs px')
    assert refusals(bench, 3).startswith('reference: the reference does not satisfy the dynamics')
    assert np.abs(bench.answer([0.1, 0.0, 0.0], 1.01) - [10.0, 0.0]).max() < 1e-9


# Re-planning


@pytest.mark.parametrize('stamped', [True, False])
def test_a_new_plan_while_following_causes_no_jump(spawn: Any, probe: Any, stamped: bool) -> None:
    """At the hand-over the command changes by the difference of the inputs of the plans."""
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
    if not stamped:  # it begins at the last state, one step earlier
        message = reference(t, path - path[1] + path[0], u)
    publisher.publish(message)
    bench.process.wait_for_output('a reference of 4 s')
    x, after = drive(bench, x, 3.0, 5.0)
    bench.process.wait_for_output('the reference of 4 s begins')
    expected = np.abs(u[0] - first[2][0])
    steps = np.abs(np.diff(np.concatenate([before[-1:], after]), axis=0))
    tolerance = 2e-2 if not stamped else 1e-3
    assert (steps[0] <= expected + tolerance).all(), steps.max(axis=0)
    assert (steps[1:] <= tolerance).all(), steps.max(axis=0)
    assert np.abs(after[-1] - u[0]).max() < tolerance
    assert matrix(bench.design(1).k, 2).any()
