# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Exercise 2.6: minimum-time trajectories and Pontryagin's conditions."""

from math import pi

import casadi as ca
from hypothesis import example, given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.ocp.problem import FinalTime, Problem
from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.exact.two_wheeled import find_least_time_path, solve_two_wheeled
from obc_ros.core.solver.solve import solve
from obc_ros.core.text.errors import StatementError
import pytest

poses = st.tuples(st.floats(-5, 5), st.floats(-5, 5), st.floats(-4, 4))
limits = st.floats(0.2, 4)


def robot(start, goal, L=1.0, M=1.0, order=(0, 1, 2), rate=1.0, upper=50.0, weight=1.0):
    """Return Exercise 2.6 as a Problem; `order` holds the indices of x, y and theta."""
    x, u, p = ca.SX.sym('x', 3), ca.SX.sym('u', 2), ca.SX.sym('p', 1)
    theta = x[order[2]]
    f = ca.SX(3, 1)
    f[order[0]], f[order[1]], f[order[2]] = (
        u[0] * ca.cos(theta), u[0] * ca.sin(theta), p[0] * u[1])
    x0, xf = np.zeros(3), np.zeros(3)
    x0[list(order)], xf[list(order)] = start, goal
    none = np.full(3, np.inf)
    return Problem(
        name='robot', states=('a', 'b', 'c'), inputs=('v', 'w'), parameters=('k',), x=x, u=u,
        p=p, f=f, L=rate * p[0], V=ca.SX(0), psi=2 * (x - xf), path=ca.SX(0, 1),
        p_value=np.array([weight]), x0=x0, x_lower=-none, x_upper=none,
        u_lower=-np.array([L, M]), u_upper=np.array([L, M]), path_lower=np.zeros(0),
        path_upper=np.zeros(0), final_time=FinalTime(True, lower=0.01, upper=upper))


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(poses, poses, limits, limits)
@example((0.0, 0.0, 2.0**-23), (2.0**-23, 0.0, 2.0**-23), 3.0, 1.0)
@example((0.0, 0.0, 0.0), (0.0, 0.0, 2.4e-289), 1.0, 1.0)
def test_paths_satisfy_pontryagins_conditions(start, goal, L, M):
    found = find_least_time_path(start, goal, L, M)
    x, u, lam = found.x, found.u, found.lam
    assert found.status is Status.SOLVED
    assert (np.abs(u) <= [L + 1e-12, M + 1e-12]).all()
    if found.objective == 0:
        return
    p = lam[:, 0] * np.cos(x[:, 2]) + lam[:, 1] * np.sin(x[:, 2])
    # Positions are accurate to 1e-14 m; for a path of 1e-7 m the costate is 1e7 s/m.
    tolerance = 1e-9 + 1e-14 * np.abs(lam[0, :2]).max()
    assert np.abs(found.hamiltonian).max() < tolerance
    np.testing.assert_allclose(1 + u[:, 0] * p + u[:, 1] * lam[:, 2], found.hamiltonian,
                               atol=1e-12)
    # The minimum of H over the box is attained.
    assert np.abs(1 - L * np.abs(p) - M * np.abs(lam[:, 2])).max() < tolerance
    # Costate equation: lam1, lam2 constant, lam3' = v (lam1 sin - lam2 cos).
    assert np.ptp(lam[:, :2], axis=0).max() == 0
    turn = lam[:, 0] * (x[:, 1] - x[0, 1]) - lam[:, 1] * (x[:, 0] - x[0, 0])
    np.testing.assert_allclose(lam[:, 2], lam[0, 2] + turn, atol=1e-9)


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(poses, poses, limits, limits)
def test_inputs_reproduce_the_states(start, goal, L, M):
    found = find_least_time_path(start, goal, L, M)
    assert tuple(found.x[0]) == start
    np.testing.assert_allclose(found.x[-1, :2], goal[:2], atol=1e-12)
    assert abs(np.exp(1j * found.x[-1, 2]) - np.exp(1j * goal[2])) < 1e-12
    dt = np.diff(found.t)
    v, omega = found.u[:-1].T
    middle = found.x[:-1, 2] + omega * dt / 2
    chord = v * dt * np.sinc(omega * dt / 2 / pi)
    step = np.column_stack((chord * np.cos(middle), chord * np.sin(middle), omega * dt))
    np.testing.assert_allclose(np.diff(found.x, axis=0), step, atol=1e-11)
    jumps = found.t[1:][dt == 0]
    np.testing.assert_allclose(jumps, found.switching_times, atol=1e-12)


def test_turning_on_the_spot_takes_as_long_as_three_arcs():
    found = find_least_time_path((0, 0, 0), (0, 0, pi / 2), 1, 1)
    assert found.objective == pytest.approx(pi / 2, abs=1e-12)
    first, last = found.switching_times[0], pi / 2 - found.switching_times[1]
    # The circles' centres are 2, 2 and sqrt(2) apart.
    np.testing.assert_allclose([first, last], (pi / 2 - 2 * np.arcsin(2**0.5 / 4)) / 2)
    np.testing.assert_allclose(found.lam, np.tile([0, 0, -1], (len(found.t), 1)), atol=1e-12)
    assert 'turning on the spot' in found.message


@pytest.mark.slow
@settings(max_examples=50, deadline=None)
@given(poses, poses, limits, st.floats(0.1, 10))
def test_scaling_both_limits_scales_time(start, goal, L, factor):
    once = find_least_time_path(start, goal, L, 1.0)
    scaled = find_least_time_path(start, goal, factor * L, factor)
    assert scaled.objective == pytest.approx(once.objective / factor, rel=1e-9)


@pytest.mark.parametrize('order', [(0, 1, 2), (2, 0, 1), (1, 2, 0)])
def test_the_problem_is_recognised_in_any_order_of_states(order):
    start, goal = (0.2, -0.1, 0.3), (1.5, 1.0, 1.2)
    problem = robot(start, goal, 1.3, 0.8, order, rate=3.0)
    found, direct = solve_two_wheeled(problem), find_least_time_path(start, goal, 1.3, 0.8)
    assert found.objective == pytest.approx(3 * direct.objective)
    np.testing.assert_allclose(found.x[:, list(order)], direct.x)
    np.testing.assert_allclose(found.lam[-1], 2 * found.nu)
    np.testing.assert_allclose(found.lam[:, list(order)], 3 * direct.lam, atol=1e-12)
    assert np.abs(found.hamiltonian).max() < 1e-9


def test_problems_other_than_exercise_2_6_are_not_accepted():
    assert solve_two_wheeled(robot((0, 0, 0), (1, 1, 1), weight=2.0)) is None
    assert solve_two_wheeled(robot((0, 0, 0), (0, 0, 0))) is None
    # Three full turns: a Problem's theta does not wrap.
    assert solve_two_wheeled(robot((0, 0, 0), (1, 1, 6 * pi))) is None


@pytest.mark.parametrize(('missed', 'proved'), [(2e-6, False), (2e-2, True)])
def test_a_time_in_which_a_certificate_sees_no_miss_is_not_too_short(missed, proved):
    """After 4 s - 2e-6 s, x(T) is 5e-7 of 4 short of 4: a certificate counts that as met."""
    found = solve_two_wheeled(robot((0, 0, 0), (4, 0, 0), upper=4 - missed))
    assert (found is not None and found.status is Status.INFEASIBLE) == proved


def test_too_short_a_final_time_is_infeasible():
    found = solve_two_wheeled(robot((0, 0, 0), (4, 0, 0), upper=3.0))
    assert found.status is Status.INFEASIBLE
    assert found.message == (
        'the terminal constraints cannot be met by T = 3: the minimum time is 4')


@pytest.mark.parametrize('limit', [0, -1, float('inf'), float('nan'), '1', None])
def test_bad_limits_are_rejected(limit):
    with pytest.raises(StatementError, match='max_speed must be a finite number > 0'):
        find_least_time_path((0, 0, 0), (1, 0, 0), limit, 1.0)
    with pytest.raises(StatementError, match='max_turn_rate'):
        find_least_time_path((0, 0, 0), (1, 0, 0), 1.0, limit)


def test_solve_selects_the_shortest_path():
    problem = robot((0, 0, 0), (1, 2, 0.5), 1.3, 0.8)
    found = solve(problem)
    assert (found.method, found.status) == ('reeds_shepp', Status.SOLVED)
    assert found.certificate.holds
    assert found.objective == pytest.approx(
        solve(problem, method='arcs').objective, rel=1e-6)
