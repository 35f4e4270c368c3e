# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Integration of an input between samples, compared with closed forms; batches of points."""

import math

import casadi as ca
import numpy as np
from obc_ros.core.numerics.vectorized import VectorizedFunction
from obc_ros.core.ocp.certificate.replay import Intervals, ReplayIntegrator
import problems
import pytest
from scipy.integrate import solve_ivp

QUARTERS = np.linspace(0, 1, 5)


def intervals(problem, h, x, lam, ua, ub, s=None, m=None):
    """Return intervals with constant multiplier densities."""
    x = np.atleast_2d(np.asarray(x, float))
    K, rows = len(x), problem.path.numel()
    columns = [np.broadcast_to(np.asarray(part, float), (K, 1)) for part in (ua, ub)]
    s = np.zeros((K, 2)) if s is None else np.broadcast_to(np.asarray(s, float), (K, 2))
    m = np.zeros((K, rows)) if m is None else np.broadcast_to(np.asarray(m, float), (K, rows))
    lam = np.broadcast_to(np.asarray(lam, float), (K, 2))
    return Intervals(np.broadcast_to(np.asarray(h, float), (K,)), x, lam, *columns, s, s, m, m)


def replayed(problem, course, tolerance=1e-10):
    """Integrate the inputs over the intervals."""
    return ReplayIntegrator(problem).replay(course, problem.p_value, np.ones(4), tolerance)


def test_linear_inputs_of_a_double_integrator_are_exact():
    problem = problems.pose({'x': 'v', 'v': 'u'}, 'u**2', (0, 0), 1)
    found = replayed(problem, intervals(problem, [2.0, 0.5], [[1, -1], [0, 2]], [3, -1],
                                        [[1], [-2]], [[3], [0]]))
    assert found.converged
    for k, (h, x0, v0, a, b) in enumerate([(2.0, 1, -1, 1, 3), (0.5, 0, 2, -2, 0)]):
        t, slope = h*QUARTERS, (b - a)/h
        assert found.x[k, :, 1] == pytest.approx(v0 + a*t + slope*t**2/2, abs=1e-12)
        assert found.x[k, :, 0] == pytest.approx(x0 + v0*t + a*t**2/2 + slope*t**3/6, abs=1e-12)
        # dlam_x/dt = 0 and dlam_v/dt = -lam_x
        assert found.lam[k, :, 1] == pytest.approx(-1 - 3*t, abs=1e-12)
        assert found.u[k, :, 0] == pytest.approx(a + (b - a)*QUARTERS)
        assert found.cost[k] == pytest.approx(h*(a*a + a*b + b*b)/3)


def test_nonlinear_states_and_costates_match_closed_forms():
    # x = tan(t + c), and lam (1 + x^2) is constant for x' = 1 + x^2
    problem = problems.pose({'x': '1 + x**2', 'v': 'u'}, '0', (0, 0), 1)
    found = replayed(problem, intervals(problem, [1.2, 0.1], [[0, 0], [1, 0]], [2, 0], 0, 0))
    assert found.converged
    assert found.x[0, :, 0] == pytest.approx(np.tan(1.2*QUARTERS), rel=1e-9)
    assert found.x[1, -1, 0] == pytest.approx(math.tan(0.1 + math.pi/4), rel=1e-9)
    assert found.lam[0, :, 0] == pytest.approx(2/(1 + np.tan(1.2*QUARTERS)**2), abs=1e-9)


def test_quadratic_drag_from_rest_matches_closed_forms():
    # x = tanh(t); lam_x / cosh(t)^2 and lam_v / cosh(t) are constant.
    drag = 'sqrt(x**2 + v**2)'
    problem = problems.pose({'x': f'u - {drag}*x', 'v': f'-{drag}*v'}, '0', (0, 0), 1)
    found = replayed(problem, intervals(problem, [1.0], [[0, 0]], [2, 3], 1, 1))
    assert found.converged
    assert found.x[0] == pytest.approx(np.column_stack([np.tanh(QUARTERS), 0*QUARTERS]), abs=1e-9)
    assert found.lam[0] == pytest.approx(np.column_stack([
        2*np.cosh(QUARTERS)**2, 3*np.cosh(QUARTERS)]), rel=1e-9)


def test_the_outflow_of_an_empty_tank_has_no_costates():
    problem = problems.pose({'x': 'u - sqrt(x)', 'v': '0'}, '0', (0, 0), 1)
    assert not replayed(problem, intervals(problem, [1.0], [[0, 0]], [2, 3], 1, 1)).converged


def test_the_path_within_a_step_has_order_four():
    problem = problems.pose({'x': 'v', 'v': '-x'}, 'x**2', (0, 0), 1)
    errors = []
    for h in (0.8, 0.4):
        course = intervals(problem, h, [[1, 0]], 0, 0, 0)
        found = replayed(problem, course, tolerance=1.0)
        errors.append(np.abs(found.x[0, :, 0] - np.cos(h*QUARTERS)).max())
    assert errors[0] < 1e-4
    assert math.log2(errors[0] / errors[1]) > 4.5


def test_multiplier_densities_drive_the_costates():
    problem = problems.pose(
        {'x': 'v', 'v': 'u'}, '0', (0, 0), 1,
        path_constraints=[{'expr': 'x*v', 'lower': None, 'upper': 9}])
    found = replayed(problem, intervals(problem, 1.0, [[1, 2]], 0, 0, 0, s=[5, 0], m=[3]))
    # dlam_x/dt = -5 - 3 v with v = 2; dlam_v/dt = -lam_x - 3 x with x = 1 + 2 t
    t = QUARTERS
    assert found.lam[0, :, 0] == pytest.approx(-11*t, abs=1e-12)
    assert found.lam[0, :, 1] == pytest.approx(11*t**2/2 - 3*t - 3*t**2, abs=1e-12)


def test_fast_modes_are_integrated_accurately():
    problem = problems.pose({'x': '-50*(x - v)', 'v': '1'}, '0', (0, 0), 1)
    found = replayed(problem, intervals(problem, 1.0, [[1, 0]], 0, 0, 0), 1e-7)
    assert found.converged
    expected = QUARTERS - 1/50 + (1 + 1/50)*np.exp(-50*QUARTERS)
    assert found.x[0, :, 0] == pytest.approx(expected, abs=1e-8)


def test_a_path_that_diverges_is_reported_as_infinite():
    problem = problems.pose({'x': '1 + x**2', 'v': 'u'}, '0', (0, 0), 1)
    assert not replayed(problem, intervals(problem, 2.0, [[0, 0]], 0, 0, 0)).converged


@pytest.mark.parametrize('count', [1, 31, 32, 33, 127, 1024, 1500])
def test_batches_equal_single_evaluations(count):
    x, p = ca.SX.sym('x', 2), ca.SX.sym('p', 1)
    batch = VectorizedFunction([x, ca.SX(0, 1), p],
                               [ca.sin(x)*p, ca.SX(0, 1), ca.jacobian(x**2, x), p])
    rows = np.linspace(-3, 3, 2*count).reshape(count, 2)
    sine, none, slope, same = batch(rows, np.zeros(0), np.array([2.0]))
    assert sine == pytest.approx(2*np.sin(rows))
    assert none.shape == (count, 0)
    assert slope.reshape(-1, 2, 2)[:, 1, 1] == pytest.approx(2*rows[:, 1])
    assert not slope.reshape(-1, 2, 2)[:, 0, 1].any()
    assert np.all(same == 2.0)


def test_stiff_costates_are_integrated_backwards():
    """State x follows v within 1 ms; forwards, lam of x would grow by exp(1000) in 1 s."""
    problem = problems.pose({'x': '-1000*(x - v)', 'v': '-v + u'}, 'x**2 + v**2', (0, 0), 1)
    h, end, v0 = 0.5, np.array([[0.3, -0.2]]), 0.4
    x0 = v0 + (1 - v0) / 999   # without a fast component
    course = intervals(problem, h, [[x0 + (1 - v0) * 2 / 999, v0]], 0, 1, 1)
    run = problem.p_value, np.ones(4), 1e-8
    forward = ReplayIntegrator(problem).replay(course, *run)
    assert not forward.converged
    found, defect = ReplayIntegrator(problem).there_and_back(forward, course, end, *run)
    assert found.converged

    def back(s, z):
        v = 1 + (v0 - 1) * np.exp(s - h)
        x = 1 + (v0 - 1) * 1000 / 999 * np.exp(s - h)
        x += (course.x[0, 0] - 1 - (v0 - 1) * 1000 / 999) * np.exp(1000 * (s - h))
        return [-1000 * z[0] + 2 * x, 1000 * z[0] - z[1] + 2 * v]

    exact = solve_ivp(back, (0, h), end[0], 'Radau', rtol=1e-10, atol=1e-12).y[:, -1]
    assert found.lam[0, -1] == pytest.approx(end[0])
    assert found.lam[0, 0] == pytest.approx([0, 0], abs=1e-14)   # returned as given
    assert -defect[0] == pytest.approx(exact, abs=1e-7)


def test_the_bound_on_the_growth_of_costate_defects_holds():
    """For df/dx = -k x and scales that preserve its norm, the bound equals the growth e^(k h)."""
    h, k = 0.25, 8.0
    problem = problems.pose({'x': f'-{k}*x + u', 'v': 'x*0'}, 'u**2', (0, 0), 1)
    integrator, p = ReplayIntegrator(problem), problem.p_value
    for size in (1.0, 1e6):   # scale of the states; that of the costates is its inverse
        scale = np.array([size, size, 1/size, 1/size])
        ends = []
        for lam in (0.0, 1/size):
            course = intervals(problem, h, [[size, 0], [0, size]], lam, 1, 1)
            ran = integrator.replay(course, p, scale, 1e-9)
            ends.append(ran.lam[:, -1, 0])
        grown = (ends[1] - ends[0]) * size
        bound = integrator.growth(ran, course, p, scale)
        assert grown == pytest.approx(math.exp(k * h), rel=1e-6)
        assert bound == pytest.approx(math.exp(k * h), rel=1e-9)
