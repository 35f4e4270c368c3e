# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""lqr_node in its own process: horizons, schedules, limits, stamps, changing references."""

from collections.abc import Callable
import math
import time
from typing import Any

from lqr_bench import Bench, BEST_EFFORT, HOVER, LATCHED, matrix, reference
from nav_msgs.msg import Odometry
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.lqr.lqr import lqr
from obc_ros.core.riccati.fixed_horizon import solve_finite_horizon
from obc_ros.core.systems import registry
from obc_ros.core.systems.courses import build_lateral_reference, make_slalom
from obc_ros.msg import LqrWeights, State, Trajectory
from obc_ros.srv import TryDesign
import pytest

pytestmark = pytest.mark.nodes

Array = NDArray[np.float64]

X = [0.3, -0.2, 0.1, 0.05, -0.04, 0.02]
EXAMPLE_2_5 = {'Qx': [100.0, 1.0, (3.6 / math.pi)**2, 0.0, 0.0, 0.0], 'Qu': [0.1, 0.1]}


def double_integrator() -> tuple[Array, Array]:
    """Return (A, B) of Example 2.4."""
    return np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])


# A horizon


def test_a_horizon_has_the_gains_of_its_terminal_cost(spawn: Any, probe: Any) -> None:
    """Gains of (2.7) from the first state on; after the horizon the steady-state gain."""
    bench = Bench(spawn, probe, system='double_integrator', Qx=[1.0, 0.0], Qu=[1.0],
                  horizon=2.0, P1=[50.0, 10.0])
    A, B = double_integrator()
    steady, x = np.array([1.0, math.sqrt(2.0)]), [0.4, -0.1]
    assert 'time-varying gain over a horizon of 2 s' in bench.design(1).sentence

    def gain(to_go: float, P1: Any) -> Array:
        return solve_finite_horizon(A, B, np.diag([1.0, 0.0]), [[1.0]], P1, [0.0], to_go)[1][0]

    P1 = np.diag([50.0, 10.0])
    for t in (0.0, 0.5, 1.5, 1.9, 2.0):
        u = bench.answer(x, 10.0 + t)
        np.testing.assert_allclose(u, -gain(max(2.0 - t, 1e-9), P1) @ x, rtol=2e-3)
    jumps = [bench.answer(x, 12.0 + 0.01 * k)[0] for k in range(200)]
    assert np.abs(np.diff(jumps)).max() < 0.02 * np.abs(gain(1e-9, P1) @ x)
    assert jumps[-1] == pytest.approx(-steady @ x, rel=1e-9)
    assert not bench.set(P1=[1.0, -1.0]).successful
    assert 'P1 has 3 numbers; wanted 2' in bench.set(P1=[1.0, 1.0, 1.0]).reason
    assert bench.set(setpoint=[1.0, 0.0]).successful  # the horizon begins again
    bench.answer([1.0, 0.0], 20.0)
    u = bench.answer([1.4, -0.1], 21.5)
    np.testing.assert_allclose(u, -gain(0.5, P1) @ x, rtol=2e-3)
    assert bench.set(P1=[]).successful  # default: the cost-to-go of the steady design
    assert bench.answer([1.4, -0.1], 21.5)[0] == pytest.approx(-steady @ x, rel=1e-6)
    assert 'one or the other' in bench.set(schedule='m').reason
    assert bench.set(horizon=0.0).successful


# Speed


def odometry(py: float, theta: float, speed: float, stamp: float) -> Odometry:
    """Return odometry with lateral position, heading and forward speed."""
    message = Odometry(child_frame_id='base_link')
    message.header.frame_id = 'odom'
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(stamp * 1e9), 10**9)
    message.pose.pose.position.y = py
    message.pose.pose.orientation.z = math.sin(theta / 2)
    message.pose.pose.orientation.w = math.cos(theta / 2)
    message.twist.twist.linear.x = speed
    return message


def test_the_gain_is_scheduled_by_the_speed_of_odometry(spawn: Any, probe: Any) -> None:
    """Exercise 2.10 at 1 to 30 m/s, on and between the points of the gain table."""
    bench = Bench(spawn, probe, message=Odometry, topic='odom', system='vehicle_lateral',
                  state_source='odom', Qx=[1.0, 0.1], Qu=[1.0], stability=1.0, schedule='v',
                  schedule_range=[1.0, 30.0])
    sentence = bench.design(1).sentence
    assert 'the gain follows v from 1 to 30' in sentence
    assert 'stability verified' in sentence
    py, theta, stamp = 0.2, 0.05, 0.0
    for v in (1.0, 1.7, 4.0, 10.0, 22.0, 30.0):
        stamp, seen = stamp + 0.1, len(bench.commands)
        bench.publisher.publish(odometry(py, theta, v, stamp))
        command = probe.wait_for(lambda seen=seen: bench.commands[seen:] or None)[-1]
        A, B = np.array([[0.0, v], [0.0, 0.0]]), np.array([[0.0], [v / 2.0]])
        K = lqr(A, B, np.diag([1.0, 0.1]), [[1.0]], stability=1.0).K
        np.testing.assert_allclose(command.u, np.clip(-K @ [py, theta], -1.2, 1.2),
                                   rtol=1e-6 if v in (1.0, 30.0) else 0.03)
    for values, words in (
            ({'schedule': 'w'}, "no input or parameter 'w'; it has phi, v, l"),
            ({'schedule': 'l'}, 'odometry measures a speed in m/s only'),
            ({'schedule_range': [1.0]}, 'schedule_range has 1 number;'),
            ({'schedule_range': [0.0, 9.0]}, 'v = 0'),
            ({'delay': 0.1, 'rate': 50.0}, 'wanted design = continuous and delay = 0')):
        assert words in bench.set(**values).reason, values
    assert bench.set(schedule='', schedule_range=[]).successful


def closed_loop(system: str, x: Any) -> Callable[[Any], Any]:
    """Return a function that applies a command for 10 ms and returns the state."""
    from obc_ros.core.simulation.simulator import Simulator
    plant = Simulator(registry.get_system(system), x)

    def move(u: Any) -> Any:
        plant.command(np.array(u))
        plant.advance(10)
        return plant.x.copy()

    return move


def test_the_gain_is_scheduled_by_the_commanded_speed(spawn: Any, probe: Any) -> None:
    """A reference accelerates from 1 to 30 m/s; no command jumps."""
    bench = Bench(spawn, probe, system='vehicle', Qx=[1.0, 1.0, 0.1], Qu=[1.0, 1.0],
                  setpoint_input=[1.0, 0.0], stability=0.5, schedule='v',
                  schedule_range=[1.0, 40.0], transition_time=0.5,
                  start_tolerance=[1.0, 0.2, 0.2])
    x, worst = np.array([0.0, 0.4, 0.0]), 0.0
    move = closed_loop('vehicle', x)
    for k in range(300):
        x = move(bench.answer(x, 0.01 * k))
    assert abs(x[1]) < 0.2
    assert x[0] < 4.0
    t = np.linspace(0.0, 6.0, 121)
    v = 1.0 + 29.0 * np.clip(t / 5.0, 0.0, 1.0)
    px = x[0] + np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])
    course = reference(t, np.stack([px, 0 * t, 0 * t], axis=1), np.stack([v, 0 * t], axis=1), 3.0)
    probe.publisher(Trajectory, 'reference', LATCHED).publish(course)
    bench.process.wait_for_output('a reference of 6 s, then its end is held')
    u, before = None, None
    for k in range(300, 1_200):
        u = bench.answer(x, 0.01 * k)
        if before is not None:
            assert np.abs(u - before).max() < 0.2  # at the start and the end of the reference too
        x, before = move(u), u
        if k > 600:
            worst = max(worst, abs(x[1]))
    assert worst < 0.02
    assert u is not None
    assert u[0] == pytest.approx(30.0, abs=0.1)


# Limits and weights


def test_u_limits_limit_the_inputs_also_with_brysons_rule(spawn: Any, probe: Any) -> None:
    """With Bryson's rule u_max is a scale and does not limit the inputs."""
    bench = Bench(spawn, probe, weights='bryson', x_max=[0.1] * 6, u_max=[5.0, 2.0])
    np.testing.assert_allclose(matrix(bench.design(1).qu, 2), np.diag([1 / 25.0, 1 / 4.0]))
    free = bench.answer([1.0, -1.0, 0.0, 0.0, 0.0, 0.0])
    assert free[1] > HOVER[1] + 2.0  # ten times x_max: more than u_max
    assert bench.set(u_limits=[-3.0, 3.0, 30.0, 41.0]).successful
    limited = bench.answer([1.0, -1.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(limited, np.clip(free, [-3.0, 30.0], [3.0, 41.0]))
    assert bench.set(weights='matrices').successful
    assert probe.get_parameters('/lqr_node', 'u_max') == {'u_max': []}
    assert (np.abs(bench.answer([9.0, -9.0, 0.0, 0.0, 0.0, 0.0])) <= [3.0, 41.0]).all()
    for limits, words in (([1.0] * 3, 'u_limits has 3 numbers; wanted 2, the maximum absolute v'),
                          ([-1.0, 1.0, 0.0, 39.0], 'the input of the set point, f2 = 39.2, is o'),
                          ([1.0, -1.0, 0.0, 50.0], 'u_limits of f1: the lower limit 1 is not be')):
        assert words in bench.set(u_limits=limits).reason
    assert bench.set(u_limits=[2.0, 40.0]).successful
    assert bench.answer([9.0, -9.0, 0.0, 0.0, 0.0, 0.0])[1] == 40.0
    assert bench.set(u_limits=[]).successful
    assert bench.answer([9.0, -9.0, 0.0, 0.0, 0.0, 0.0])[1] > 41.0


PLAIN: dict[str, Any] = {'weights': 'matrices', 'Qx': [], 'Qu': [], 'cross': [], 'stability': 0.0}
CHOICES: list[dict[str, Any]] = [
    {'Qx': [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], 'Qu': [0.5, 2.0],
     'cross': [0.1, 0.0, 0.0, 0.2, 0.0, 0.0, 0.1, 0.0, 0.0, 0.1, 0.0, 0.0]},
    {'weights': 'output', 'H': [1.0] + 6 * [0.0] + [2.0] + 4 * [0.0], 'rho': 0.1},
    {'stability': 0.7},
]


def test_each_choice_of_weights_gives_its_optimal_gain(spawn: Any, probe: Any) -> None:
    """Check gain and Riccati equation of the cost, with cross weights and shifts."""
    bench = Bench(spawn, probe)
    for revision, choice in enumerate(CHOICES, start=2):
        assert bench.set(**{**PLAIN, **choice}).successful, choice
        design = bench.design(revision)
        A, B, K = matrix(design.a, 6), matrix(design.b, 6), matrix(design.k, 2)
        np.testing.assert_allclose(bench.answer(X), HOVER - K @ X, rtol=1e-12)
        Qx, Qu = np.eye(6), np.eye(2)
        N, alpha = np.zeros((6, 2)), choice.get('stability', 0.0)
        if 'cross' in choice:
            Qx, Qu, N = np.diag(choice['Qx']), np.diag(choice['Qu']), matrix(choice['cross'], 6)
        if 'H' in choice:
            H = matrix(choice['H'], 2)
            Qx, Qu = H.T @ H, 0.1 * np.eye(2)
        P, shifted = matrix(design.p, 6), A + alpha * np.eye(6)
        np.testing.assert_allclose(np.linalg.solve(Qu, B.T @ P + N.T), K, rtol=1e-9, atol=1e-9)
        residual = shifted.T @ P + P @ shifted - K.T @ Qu @ K + Qx
        assert np.abs(residual).max() < 1e-9 * np.abs(P).max()
        assert max(design.poles_real) < -alpha
        assert design.residual < 1e-12


# Time


def test_states_with_wrong_stamps_are_dropped(spawn: Any, probe: Any) -> None:
    """States stamped in the past or future are dropped at any age, unless there is no check."""
    bench = Bench(spawn, probe, state_timeout=0.2, stamp_timeout=0.3,
                  **{'qos_overrides./state.subscription.depth': 10})
    good = bench.answer(X, time.time())
    for late in (5.0, -5.0, 86400.0):
        seen = len(bench.commands)
        bench.send([0.9] * 6, time.time() - late)
        probe.spin_for(0.1)
        assert all((np.array(each.u) != good).any() for each in bench.commands[seen:])
    bench.process.wait_for_output('s before the local time was dropped (stamp_timeout: 0.3 s)')
    bench.process.wait_for_output('s after the local time was dropped')
    status = bench.report('states', lambda status, values: (
        values['dropped stamped too long ago'], values['dropped stamped in the future'])
        == ('2', '1'))
    assert status.level == b'\x02'
    assert 'no valid state' in status.message  # on_stale is in force
    assert (np.array(bench.commands[-1].u) == HOVER).all()
    assert (bench.answer(X, time.time()) == good).all()
    assert bench.set(stamp_timeout=0.0).successful
    bench.answer(X, time.time() - 5.0)


def test_a_slow_rate_is_set_as_the_refusals_say(spawn: Any, probe: Any) -> None:
    """At 5 Hz the continuous gain is unstable; the refusals lead to a sampled design."""
    bench = Bench(spawn, probe, **EXAMPLE_2_5)
    assert 'needs the period' in bench.set(design='sampled').reason
    refusal = 'held for 0.2 s (spectral radius'
    answer = bench.set(rate=5.0)
    assert refusal in answer.reason
    assert 'set design = sampled with sample_time = 0.2 first, both with' in answer.reason
    for wanted in ({'sample_time': 0.2, 'design': 'sampled'}, {'rate': 5.0}):
        assert bench.set(**wanted).successful, wanted
    sampled = probe.call(TryDesign, '/lqr_node/try_design', TryDesign.Request()).design
    assert (sampled.design, sampled.sample_time) == ('sampled', 0.2)
    assert refusal in bench.set(design='continuous').reason
    for back in ({'rate': 0.0}, {'design': 'continuous'}):
        assert bench.set(**back).successful, back
    assert probe.get_parameters('/lqr_node', 'sample_time') == {'sample_time': 0.0}


# Closed loops


def test_example_2_5_at_20_hz_and_50_ms_needs_a_sampled_design(spawn: Any, probe: Any) -> None:
    """The continuous gain is unstable; the gain designed for period and delay is stable."""
    loops: dict[str, dict[str, Any]] = {
        'naive': {}, 'sampled': {'design': 'sampled', 'rate': 20.0, 'delay': 0.05}}
    states: dict[str, list[State]] = {}
    for name in loops:
        states[name] = probe.listen(State, f'/{name}/state', 1_000)
        spawn('plant_simulator', {  # it waits for a command
            'lockstep': True, 'speed': 4.0, 'x0': [0.1, 0.0, 0.0, 0.0, 0.0, 0.0],
            'publish_rate': 20.0, 'dt': 0.001, 'input_delay': 0.05}, namespace=f'/{name}')
    probe.wait_for(lambda: all(states.values()), what='the first states')
    for name, parameters in loops.items():
        spawn('lqr_node', {**EXAMPLE_2_5, **parameters, 'state_timeout': 0.0,
                           'stamp_timeout': 0.0}, namespace=f'/{name}')
    probe.wait_for(lambda: all(
        seen[-1].header.stamp.sec >= 6 for seen in states.values()), 40.0)
    sizes = {name: max(np.abs(each.x[:2]).max() for each in seen if each.header.stamp.sec == 5)
             for name, seen in states.items()}
    assert sizes['naive'] > 1.0, sizes
    assert sizes['sampled'] < 0.01, sizes


def test_a_slalom_of_1_m_and_1_hz_is_followed(spawn: Any, probe: Any) -> None:
    """Flat feedforward and gains along it; the vehicle joins the slalom in the middle."""
    bench = Bench(spawn, probe, BEST_EFFORT, system='vehicle_lateral', weights='bryson',
                  x_max=[0.1, 0.1], u_max=[0.2], transition_time=0.2,
                  start_tolerance=[0.3, 0.5])
    t = np.linspace(0.0, 6.0, 3_001)
    x, u = build_lateral_reference(*make_slalom(t), 10.0, 2.0)
    publisher = probe.publisher(Trajectory, 'reference', LATCHED)
    publisher.publish(reference(t, x, u, 100.0))
    bench.process.wait_for_output('a reference of 6 s')
    place = np.array([np.interp(2.0, t, column) for column in x.T]) + [0.2, 0.0]
    move, error = closed_loop('vehicle_lateral', place), []
    for k in range(350):
        now = 102.0 + 0.01 * k
        error.append(place[0] - np.interp(now - 100.0, t, x[:, 0]))
        place = move(bench.answer(place, now))
    assert error[0] == pytest.approx(0.2)
    assert np.abs(error[150:]).max() < 0.02
    assert np.abs(x[:, 0]).max() == pytest.approx(1.0, abs=0.01)


def test_commands_do_not_jump_when_references_change_or_end(spawn: Any, probe: Any) -> None:
    """With transition_time no command jumps at the start, at a replacement or at the end."""
    bench = Bench(spawn, probe, system='double_integrator', Qx=[4.0, 1.0], Qu=[1.0],
                  transition_time=0.5, start_tolerance=[3.0, 3.0])
    publisher = probe.publisher(Trajectory, 'reference', LATCHED)
    move, place = closed_loop('double_integrator', [0.0, 0.0]), np.zeros(2)
    t = np.linspace(0.0, 2.0, 21)
    commands: list[float] = []

    def drive(begin: float, end: float) -> None:
        nonlocal place
        for k in range(round(100 * begin), round(100 * end)):
            commands.append(float(bench.answer(place, 0.01 * k)[0]))
            place = move(commands[-1:])

    drive(10.0, 10.5)
    # the reference began 0.5 s ago, 1 m from the plant
    publisher.publish(reference(t, np.stack([1.0 + t, 1.0 + 0 * t], axis=1), 0 * t, 10.0))
    bench.process.wait_for_output('a reference of 2 s')
    drive(10.5, 11.0)
    w = math.pi / 1.5
    s = 0.75 * t
    publisher.publish(reference(s, np.stack(
        [-0.5 * (1.0 - np.cos(w * s)), -0.5 * w * np.sin(w * s)], axis=1),
        -0.5 * w * w * np.cos(w * s), 11.0))
    bench.process.wait_for_output('a reference of 1.5 s, then its end is held')
    drive(11.0, 16.0)
    # the steepest slope of the transition is 1.5 times its mean slope
    largest = 1.5 * 0.01 / 0.5 * 15.0
    assert max(np.abs(np.diff(commands))) < largest
    assert place == pytest.approx([-1.0, 0.0], abs=2e-2)


def test_a_dry_run_predicts_the_response(spawn: Any, probe: Any) -> None:
    """Poles, step response and peak input of the dry run are those after the change."""
    bench = Bench(spawn, probe, system='double_integrator')
    weights = LqrWeights(qx=[16.0, 1.0], qu=[0.5])
    tried = probe.call(TryDesign, '/lqr_node/try_design', TryDesign.Request(weights=weights))
    assert tried.success
    assert len(bench.designs) == 1
    assert bench.set(Qx=[16.0, 1.0], Qu=[0.5]).successful
    design = bench.design(2)
    assert list(tried.design.poles_real) == list(design.poles_real)
    move, place, path, inputs = closed_loop('double_integrator', [-1.0, 0.0]), [-1.0, 0.0], [], []
    for k in range(600):
        path.append(1.0 + place[0])
        inputs.append(float(bench.answer(place, 0.01 * k)[0]))
        place = move(inputs[-1:])
    y = np.array(path)
    rise = (np.argmax(y >= 0.9) - np.argmax(y >= 0.1)) * 0.01
    assert rise == pytest.approx(design.rise_time[0], rel=0.05)
    assert max(y.max() - 1.0, 0.0) == pytest.approx(design.overshoot[0], abs=0.01)
    assert max(map(abs, inputs)) == pytest.approx(design.peak_input[0], rel=1e-3)


def test_the_order_of_single_changes_does_not_matter(spawn: Any, probe: Any) -> None:
    """Six parameters are set one after the other in three orders, with equal results."""
    bench = Bench(spawn, probe)
    end = {'Qx': [2.0] * 6, 'Qu': [3.0, 4.0], 'u_limits': [4.0, 60.0],
           'setpoint': [1.0, 2.0, 0.0, 0.0, 0.0, 0.0], 'rate': 50.0, 'stability': 0.1}
    final = []
    for order in (list(end), list(reversed(end)), sorted(end)):
        assert bench.set(Qx=[], Qu=[], u_limits=[], setpoint=[], rate=0.0,
                         stability=0.0).successful
        for name in order:
            assert bench.set(**{name: end[name]}).successful, (order, name)
        final.append(bench.answer(X, 1.0 + len(final)).tolist())
    assert final[0] == final[1] == final[2]
