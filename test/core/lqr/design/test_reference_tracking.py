# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""References: validation, and tracking with the gains of equation (2.7)."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.closed_loop.control import Control, Rules
from obc_ros.core.closed_loop.feedback import convert_rows, InputLimits
from obc_ros.core.closed_loop.loop import ControlLoop
from obc_ros.core.lqr.design.design import Design, design, linearize_plant, Sampling
from obc_ros.core.lqr.design.reference_tracking import (
    compute_horizon_law,
    compute_tracking_law,
    Course,
    read_course,
)
from obc_ros.core.lqr.sampled import discretize_cost
from obc_ros.core.riccati.fixed_horizon import solve_finite_horizon
from obc_ros.core.simulation.simulator import Simulator
from obc_ros.core.systems import registry
from obc_ros.core.text.errors import StatementError
import pytest
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]
S = 10**9
SPEED, LENGTH = 10.0, 2.0


def given(system: Any, t: Any, x: Any, u: Any, interpolation: str = 'linear',
          begin: int | None = 0, names: Any = ((), ())) -> Course:
    """Return the reference of the given arrays."""
    return read_course(system, names, np.ravel(t).tolist(), np.ravel(x).tolist(),
                       np.ravel(u).tolist(), interpolation, begin)


def double_integrator() -> Design:
    """Return a design of Example 2.4."""
    return design(linearize_plant(registry.get_system('double_integrator')),
                  {'Qx': (4.0, 0.5), 'Qu': (0.5,)})


def test_gains_along_a_reference_solve_the_riccati_equation() -> None:
    """For a time-invariant plant they are the finite-horizon gains."""
    found, T = double_integrator(), 6.0
    t = np.linspace(0.0, T, 601)
    along = given(found.plant.system, t, np.stack([t, np.ones_like(t)], axis=1), 0 * t)
    law = compute_tracking_law(along, found)[0].along
    grid = np.array(law.gains.grid)  # type: ignore[attr-defined]
    _, K = solve_finite_horizon(found.plant.A, found.plant.B, found.weights.Qx, found.weights.Qu,
                                found.lqr.P, grid, T)
    np.testing.assert_allclose([law.at(s).K for s in grid], K, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(law.at(0.0).K, found.K, rtol=1e-6)


def test_samples_are_interpolated_linearly_or_held() -> None:
    """A repeated time is a jump; names may be in any order."""
    found = double_integrator()
    t, x, u = [0.0, 1.0, 1.0, 2.0], [[0, 0], [1, 1], [1, 1], [2, 2]], [0.0, 2.0, -2.0, 4.0]
    linear = compute_tracking_law(given(found.plant.system, t, x, u), found)[0].along
    assert [linear.at(s).u[0] for s in (-1.0, 0.5, 1.0, 1.5, 2.0, 9.0)] == [0, 1, -2, 1, 4, 4]
    assert linear.at(0.25).x == (0.25, 0.25)
    held = compute_tracking_law(given(found.plant.system, t, x, u, 'zoh'), found)[0].along
    assert [held.at(s).u[0] for s in (0.5, 1.0, 1.5)] == [0.0, -2.0, -2.0]
    swapped = given(found.plant.system, [0.0, 1.0], [[0.0, 5.0], [1.0, 6.0]], [0.0, 0.0],
                    names=(('x2', 'x1'), ()))
    assert swapped.x.tolist() == [[5.0, 0.0], [6.0, 1.0]]
    last = compute_tracking_law(given(found.plant.system, [0.0, 1.0, 1.0],
                                      [[0, 0], [1, 0], [2, 0]],
                                      [0, 1, 2]), found)[0].along
    assert last.at(1.0).x == (1.0, 0.0)


def test_headings_are_interpolated_across_the_wrap() -> None:
    """A step from pi - 0.1 to -pi + 0.1 is a turn by 0.2."""
    system = registry.get_system('vehicle')
    x = [[0.0, 0.0, math.pi - 0.1], [1.0, 0.0, -math.pi + 0.1]]
    along = given(system, [0.0, 1.0], x, [[10.0, 0.0]] * 2)
    assert np.diff(along.x[:, 2]) == pytest.approx(0.2)


@pytest.mark.parametrize(('t', 'x', 'u', 'interpolation', 'names', 'sentence'), [
    ([0.0], [[0, 0]], [0], '', ((), ()), 'a reference has 1 samples; wanted 2 to'),
    ([0.0, 1.0], [[0, 0]], [0, 0], '', ((), ()), 'x has 2 numbers; wanted 2 x 2'),
    ([0.0, 1.0], [[0, 0]] * 2, [0], '', ((), ()), 'u has 1 numbers; wanted 2 x 1'),
    ([1.0, 0.0], [[0, 0]] * 2, [0, 0], '', ((), ()), 't: wanted finite times'),
    ([-1.0, 0.0], [[0, 0]] * 2, [0, 0], '', ((), ()), 't: wanted finite times'),
    ([1.0, 1.0], [[0, 0]] * 2, [0, 0], '', ((), ()), 't: the last time is not after the first'),
    ([0.0, math.nan], [[0, 0]] * 2, [0, 0], '', ((), ()), 't: wanted finite times'),
    ([0.0, 1.0], [[0, math.inf]] * 2, [0, 0], '', ((), ()), 'x: wanted finite numbers'),
    ([0.0, 1.0], [[0, 0]] * 2, [0, 0], 'cubic', ((), ()), "interpolation = 'cubic'"),
    ([0.0, 1.0], [[0, 0]] * 2, [0, 0], '', (('a', 'b'), ()), 'x: the reference has a, b; wanted'),
])
def test_malformed_references_are_rejected(
        t: Any, x: Any, u: Any, interpolation: str, names: Any, sentence: str) -> None:
    """Each fault has its own message."""
    with pytest.raises(StatementError) as error:
        given(registry.get_system('double_integrator'), t, x, u, interpolation, 0, names)
    assert str(error.value).startswith(sentence)


def slalom(t: Array, amplitude: float = 0.5, frequency: float = 0.5) -> tuple[Array, Array]:
    """Return (y, theta) and phi of a slalom at constant speed; y is a flat output."""
    w = math.tau * frequency
    y, dy, ddy = (amplitude * f for f in (
        1 - np.cos(w * t), w * np.sin(w * t), w**2 * np.cos(w * t)))
    theta = np.arcsin(dy / SPEED)
    dtheta = ddy / np.sqrt(SPEED**2 - dy**2)
    return np.stack([y, theta], axis=1), np.arctan(LENGTH * dtheta / SPEED)


def drive(found: Design, courses: tuple[Course, ...], start: list[float], begin: float,
          end: float, dt: float = 0.005) -> tuple[Array, Array, Array]:
    """Simulate the vehicle in closed loop; return times, states and inputs."""
    system = found.plant.system
    control = Control(
        regulator=found.regulator,
        limits=InputLimits(tuple(system.u_min), tuple(system.u_max), (1,)), rest=(0.0,),
        names=system.state_names, rules=Rules(),
        legs=tuple(compute_tracking_law(each, found)[0] for each in courses))
    loop, car = ControlLoop(control), Simulator(system, start)
    t, x, u = [], [], []
    for k in range(round((end - begin) / dt)):
        now = begin + k * dt
        command = loop.answer(round(now * S), car.x.tolist(), now)
        assert command is not None
        t.append(now)
        x.append(car.x)
        u.append(command)
        car.command(np.array(command))
        car.advance(round(dt / 1e-3))
    return np.array(t), np.array(x), np.array(u)


def lateral() -> Design:
    """Return the LQR design of the lateral vehicle."""
    return design(linearize_plant(registry.get_system('vehicle_lateral')), {
        'weights': 'bryson', 'x_max': (0.1, 0.1), 'u_max': (0.2,)})


def test_a_slalom_is_tracked_from_its_beginning() -> None:
    """A feasible reference is tracked up to the error of sampling its input."""
    found, t = lateral(), np.linspace(0.0, 4.0, 2_001)
    x, u = slalom(t)
    times, driven, inputs = drive(
        found, (given(found.plant.system, t, x, u),), x[0].tolist(), 0.0, 4.0)
    wanted = slalom(times)[0]
    assert np.abs(driven[:, 0] - wanted[:, 0]).max() < 5e-3
    assert np.abs(inputs).max() < 0.5


@pytest.mark.parametrize('begin', [0.0, 0.7, 1.9])
def test_a_slalom_joined_midway_off_the_path_is_tracked(begin: float) -> None:
    """The initial error of 0.3 m decays."""
    found, t = lateral(), np.linspace(0.0, 4.0, 2_001)
    x, u = slalom(t)
    start = slalom(np.array([begin]))[0][0] + [0.3, 0.0]
    times, driven, _ = drive(
        found, (given(found.plant.system, t, x, u),), start.tolist(), begin, 4.0)
    error = np.abs(driven[:, 0] - slalom(times)[0][:, 0])
    assert error[0] == pytest.approx(0.3)
    assert error[times > begin + 1.5].max() < 6e-3
    assert error.max() < 0.31


def test_the_end_of_a_slalom_is_held_without_an_input_jump() -> None:
    """After two periods the vehicle rests in its lane and stays there."""
    found, t = lateral(), np.linspace(0.0, 4.0, 2_001)
    x, u = slalom(t)
    u[-1] = 0.0  # the road goes straight on
    law, words = compute_tracking_law(given(found.plant.system, t, x, u), found)
    assert words == 'then its end is held'
    times, driven, inputs = drive(
        found, (given(found.plant.system, t, x, u),), x[0].tolist(), 0.0, 7.0)
    assert np.abs(driven[times > 6.0]).max() < 1e-3
    np.testing.assert_allclose(law.along.at(4.0).K, law.after.K, rtol=1e-12)


def test_a_reference_is_tracked_until_the_next_begins() -> None:
    """The second reference begins at 2 s and leads back to the lane."""
    found, t = lateral(), np.linspace(0.0, 4.0, 2_001)
    system = found.plant.system
    first = given(system, t, *slalom(t), begin=0)
    second = given(system, t, np.zeros((len(t), 2)), 0 * t, begin=2 * S)  # back in the lane
    times, driven, _ = drive(found, (first, second), [0.0, 0.0], 0.0, 4.0)
    wanted = np.where(times < 2.0, slalom(times)[0][:, 0], 0.0)
    error = np.abs(driven[:, 0] - wanted)
    assert error.max() < 6e-3


def test_an_end_that_is_no_equilibrium_is_reported() -> None:
    """A standing vehicle cannot be steered; a moving aircraft cannot stay."""
    found = design(linearize_plant(registry.get_system('vehicle')), {})
    still = given(found.plant.system, [0.0, 1.0], np.zeros((2, 3)), [[1.0, 0.0], [0.0, 0.0]])
    law, words = compute_tracking_law(still, found)
    assert 'input at rest is applied without feedback' in words
    assert law.after.u == (0.0, 0.0)
    assert law.after.K == ((0.0,) * 3,) * 2
    flying = design(linearize_plant(registry.get_system('aircraft')), {})
    moving = given(flying.plant.system, [0.0, 1.0], [[0.0] * 6, [1, 0, 0, 5, 0, 0]],
                   [[0.0, 39.2]] * 2)
    law, words = compute_tracking_law(moving, flying)
    assert 'then the set point is held' in words
    assert law.after.x == (0.0,) * 6


def test_gains_include_integrals_and_cross_terms() -> None:
    """The gains at the end of the reference equal those of the design there."""
    found = design(linearize_plant(registry.get_system('vehicle_lateral')), {
        'Qx': (1.0, 2.0), 'Qu': (0.5,), 'cross': (0.1, 0.2), 'stability': 0.5},
        ('py',), (2.0,))
    t = np.linspace(0.0, 3.0, 301)
    law = compute_tracking_law(given(found.plant.system, t, np.zeros((301, 2)), 0 * t), found)[0]
    np.testing.assert_allclose(law.along.at(3.0).K, found.K, rtol=1e-9)
    np.testing.assert_allclose(law.along.at(0.0).K, found.K, rtol=1e-6)  # the same plant


def test_an_end_almost_at_rest_is_held() -> None:
    """Solvers leave speeds of 1e-8; the end still counts as an equilibrium."""
    found = design(linearize_plant(registry.get_system('aircraft')), {})
    system, T = found.plant.system, np.linspace(0.0, 2.0, 21)
    x = np.outer(T / 2.0, [1.0, 2.0, 0.0, 0.5, 0.0, 0.0])
    x[-1] = [1.0, 2.0, 1e-8, -2e-8, 3e-8, 1e-8]
    u = [[0.3, 45.0]] * 21
    law, words = compute_tracking_law(given(system, T, x, u), found)
    assert words == 'then its end is held'
    end = law.after.at(0.0)
    np.testing.assert_allclose(end.x, [1.0, 2.0, 0, 0, 0, 0], atol=1e-7)
    np.testing.assert_allclose(system.f(np.array(end.x), np.array(end.u)), 0.0, atol=1e-7)
    x[-1, 3] = 0.5
    words = compute_tracking_law(given(system, T, x, u), found)[1]
    assert 'the set point is held: found no equilibrium' in words


# Terminal weights


@pytest.mark.parametrize('P1', [np.zeros((2, 2)), np.diag([100.0, 1.0]), np.diag([1e4, 1e4])])
def test_horizon_gains_solve_the_riccati_equation(P1: Array) -> None:
    """K(t) solves (2.7) backwards from P1, also where it changes fast; then K is steady."""
    found, T = double_integrator(), 3.0
    gains = compute_horizon_law(found, T, P1).gains
    grid = np.array(gains.grid[:-1])
    assert grid[-1] == T
    A, B, Qx, Qu = found.plant.A, found.plant.B, found.weights.Qx, found.weights.Qu
    _, K = solve_finite_horizon(A, B, Qx, Qu, P1, grid, T)
    np.testing.assert_allclose(gains.K[:-1], K, rtol=1e-9, atol=1e-9)
    assert gains.at(T + 10.0) == (convert_rows(found.K), ())
    t = np.sort(np.concatenate([np.linspace(0.0, T, 777), T - np.geomspace(1e-5, 0.1, 50)]))
    _, K = solve_finite_horizon(A, B, Qx, Qu, P1, np.unique(t), T)
    error = np.abs(K - [gains.at(s)[0] for s in np.unique(t)])
    assert (error <= 0.05 * np.abs(K) + 1e-3 * np.abs(found.K).max()).all()


def test_a_horizon_without_terminal_weight_has_steady_gains() -> None:
    """The default P1 = P is stationary."""
    found = double_integrator()
    for K in compute_horizon_law(found, 2.0).gains.K:
        np.testing.assert_allclose(K, found.K, rtol=1e-9)


def test_horizon_gains_minimise_the_cost() -> None:
    """The simulated cost is x0'P(0) x0; scaled gains cost more."""
    found, T, P1 = double_integrator(), 2.0, np.diag([50.0, 5.0])
    A, B, Qx, Qu = found.plant.A, found.plant.B, found.weights.Qx, found.weights.Qu
    gains = compute_horizon_law(found, T, P1).gains

    def cost(scale: float) -> float:
        def rate(t: float, z: Array) -> Array:
            u = -scale * np.array(gains.at(t)[0]) @ z[:2]
            return np.append(A @ z[:2] + B @ u, z[:2] @ Qx @ z[:2] + u @ Qu @ u)

        *x, J = solve_ivp(rate, (0.0, T), [1.0, -0.5, 0.0], rtol=1e-9, max_step=0.01).y[:, -1]
        return float(J + np.array(x) @ P1 @ x)

    P, _ = solve_finite_horizon(A, B, Qx, Qu, P1, [0.0], T)
    x0 = np.array([1.0, -0.5])
    assert cost(1.0) == pytest.approx(x0 @ P[0] @ x0, rel=1e-3)
    assert cost(0.9) > cost(1.0) < cost(1.1)


def test_sampled_horizon_gains_follow_the_difference_equation() -> None:
    """Recur backwards from P1 in whole periods."""
    found = design(linearize_plant(registry.get_system('double_integrator')),
                   {'Qx': (4.0, 0.5), 'Qu': (0.5,)},
                   sampling=Sampling(0.1, exact=True))
    P1 = np.diag([10.0, 2.0])
    gains = compute_horizon_law(found, 1.0, P1).gains
    Ad, Bd, cost = discretize_cost(found.plant.A, found.plant.B, found.weights, 0.1)
    assert cost.cross is not None
    P = P1
    for k in range(9, -1, -1):
        right = Bd.T @ P @ Ad + cost.cross.T
        K = np.linalg.solve(cost.Qu + Bd.T @ P @ Bd, right)
        P = Ad.T @ P @ Ad + cost.Qx - right.T @ K
        np.testing.assert_allclose(gains.at(0.1 * k)[0], K, rtol=1e-9)
    assert gains.at(5.0)[0] == convert_rows(found.K)


def test_a_terminal_weight_sets_the_gain_at_the_end() -> None:
    """The gain ends in Qu^-1 B'P1 and then tends to the steady gain without a jump."""
    found, T, P1 = double_integrator(), 3.0, np.diag([40.0, 8.0])
    t = np.linspace(0.0, T, 31)
    law = compute_tracking_law(given(found.plant.system, t, np.zeros((31, 2)), 0 * t), found,
                               P1)[0]
    last = np.linalg.solve(found.weights.Qu, found.plant.B.T @ P1)
    np.testing.assert_allclose(law.along.at(T).K, last)
    np.testing.assert_allclose(law.after.at(0.0).K, last)
    np.testing.assert_allclose(law.after.at(9.0).K, found.K)
    np.testing.assert_allclose(law.along.at(0.0).K, found.K, rtol=0.01)
    K = np.array([law.after.at(s).K for s in np.linspace(0.0, 1.0, 1001)])
    assert np.abs(np.diff(K, axis=0)).max() < 0.01 * np.abs(last).max()


# Disturbances along a reference


@pytest.mark.slow
def test_integral_action_compensates_an_offset_while_braking() -> None:
    """From 10 to 2 m/s with a steering offset, only integral action removes the lateral error."""
    system = registry.get_system('vehicle')
    t = np.linspace(0.0, 30.0, 301)
    v = np.interp(t, [10.0, 20.0], [10.0, 2.0])
    px = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])
    x, u = np.stack([px, 0 * t, 0 * t], axis=1), np.stack([v, 0 * t], axis=1)
    worst = {}
    for integral in ((), ('py',)):
        found = design(linearize_plant(system), {'Qx': (1.0, 4.0, 1.0), 'Qu': (1.0, 1.0)},
                       integral,
                       (4.0,) * len(integral))
        law = compute_tracking_law(given(system, t, x, u), found)[0]
        if integral:  # the gain changes with the speed
            Ki = [abs(law.along.at(s).Ki[1][0]) for s in (5.0, 15.0, 29.0)]
            assert max(Ki) > 1.01 * min(Ki)
        control = Control(
            regulator=found.regulator,
            limits=InputLimits(tuple(system.u_min), tuple(system.u_max), (2,)), rest=(0.0, 0.0),
            names=system.state_names, rules=Rules(), legs=(law,), C=convert_rows(found.C))
        loop, car, error = ControlLoop(control), Simulator(system, [0.0, 0.0, 0.0]), []
        for k in range(3_000):
            command = loop.answer(k * S // 100, car.x.tolist(), 0.01 * k)
            assert command is not None
            error.append(abs(car.x[1]))
            car.command(np.array(command) + [0.0, 0.05])
            car.advance(10)
        worst[bool(integral)] = max(error[900:])
    assert worst[False] > 0.02, worst
    assert worst[True] < 1e-3, worst
