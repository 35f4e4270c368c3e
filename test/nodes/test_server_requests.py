# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Requests for plans, regulators and minima, compared with known solutions."""

import math

import numpy as np
from obc_ros.msg import LqrWeights, NamedBounds, NamedExpression, Trajectory
from obc_ros.srv import DesignLqr, Minimize, PlanMotion
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile

pytestmark = pytest.mark.nodes

SERVER = '/trajectory_server'
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture(autouse=True)
def server(spawn):
    """Run a server."""
    spawn('trajectory_server', {'workers': 1})


def named(**expressions):
    """Return NamedExpression messages."""
    return [NamedExpression(name=name, expression=text) for name, text in expressions.items()]


def test_a_plan_is_published_as_a_reference_on_execute(probe):
    request = PlanMotion.Request(
        system='two_wheeled', start=[0.0, 0.0, 0.0], goal=[1.0, 0.0, 0.0], objective='time')
    received = probe.listen(Trajectory, 'reference', LATCHED)
    shown = probe.call(PlanMotion, f'{SERVER}/plan', request)
    assert shown.success, shown.message
    assert shown.objective == pytest.approx(1.0, abs=1e-6)
    assert shown.trajectory.state_names == ['px', 'py', 'theta']
    request.execute = True
    request.goal = [2.0, 0.0, 0.0]
    executed = probe.call(PlanMotion, f'{SERVER}/plan', request)
    probe.wait_for(lambda: received, what='the reference')
    assert received == [executed.trajectory]
    assert received[0].header.stamp.sec > 0
    assert received[0].system == 'two_wheeled'
    late = probe.listen(Trajectory, 'reference', LATCHED)
    probe.wait_for(lambda: late, what='the latched reference')
    request.goal = [math.nan, 0.0, 0.0]
    refused = probe.call(PlanMotion, f'{SERVER}/plan', request)
    assert (refused.status, refused.success) == ('malformed', False)
    assert 'goal' in refused.message
    probe.spin_for(0.2)
    assert len(received) == 1  # a refused plan is not published


def test_design_lqr_returns_the_optimal_gain_or_a_refusal(probe):
    aircraft = probe.call(DesignLqr, f'{SERVER}/design_lqr', DesignLqr.Request(
        system='aircraft', system_parameters=named(m='2*2')))
    assert aircraft.success, aircraft.message
    design = aircraft.design
    n, m = len(design.state_names), len(design.input_names)
    assert (n, m, design.system) == (6, 2, 'aircraft')
    A, B, Qx, Qu, K, P = (
        np.reshape(values, shape) for values, shape in (
            (design.a, (n, n)), (design.b, (n, m)), (design.qx, (n, n)), (design.qu, (m, m)),
            (design.k, (m, n)), (design.p, (n, n))))
    assert np.allclose(A.T @ P + P @ A - P @ B @ np.linalg.solve(Qu, B.T @ P) + Qx, 0, atol=1e-9)
    assert np.allclose(K, np.linalg.solve(Qu, B.T @ P))
    poles = np.array(design.poles_real) + 1j * np.array(design.poles_imag)
    assert np.allclose(np.sort_complex(poles), np.sort_complex(np.linalg.eigvals(A - B @ K)))
    assert np.allclose(design.damping, -poles.real / np.abs(poles))
    assert np.allclose(design.ue, [0.0, 4 * 9.8])
    # LQR margins with diagonal Qu: each loop, the others closed, has 60 degrees and half the gain
    for margin, least in ((design.phase_margin, np.pi / 3), (design.gain_margin, np.inf)):
        assert len(margin) == m
        assert min(margin) >= least - 1e-9
    assert max(design.gain_reduction_margin) <= 0.5 + 1e-9
    weights = LqrWeights(qx=[1.0], qu=[1.0])
    for request, words in (
            (DesignLqr.Request(), 'malformed: a has 0 numbers'),
            (DesignLqr.Request(a=[1.0, 2.0, 3.0], b=[1.0]), 'malformed: a has 3 numbers'),
            (DesignLqr.Request(a=[1.0], weights=weights), 'malformed: b has 0 numbers'),
            (DesignLqr.Request(a=[math.nan], b=[1.0], weights=weights), 'malformed: A'),
            (DesignLqr.Request(a=[1.0], b=[0.0], weights=weights), 'refused: (A, B) is not'),
            (DesignLqr.Request(a=[1.0], b=[1.0], weights=LqrWeights(qx=[1.0], qu=[0.0])),
             'refused: Qu[0] = 0'),
            (DesignLqr.Request(a=[1.0], b=[1.0], weights=LqrWeights(weights='magic')),
             'malformed: weights'),
            (DesignLqr.Request(a=[0.0] * 4, b=[1.0] * 2, weights=LqrWeights(
                qx=[1.0, 5.0, 2.0, 1.0], qu=[1.0])), 'malformed: Qx[0, 1] = 5'),
            (DesignLqr.Request(a=[1.0], b=[1.0], sample_time=-1.0), 'malformed: sample_time = -1'),
            (DesignLqr.Request(a=[1.0], b=[1.0], delay=0.1), 'malformed: delay = 0.1 needs'),
            (DesignLqr.Request(system='zeppelin'), "malformed: unknown system 'zeppelin'"),
            (DesignLqr.Request(system='aircraft', setpoint=[1.0]), 'malformed: set point'),
            (DesignLqr.Request(system='aircraft', system_parameters=named(m='-1')),
             'malformed: aircraft.m = -1')):
        response = probe.call(DesignLqr, f'{SERVER}/design_lqr', request)
        assert not response.success
        assert response.message.startswith(words), response.message


def test_a_sampled_design_stabilises_the_sampled_loop(probe):
    h = 0.5  # double integrator under a zero-order hold: Ad, Bd in closed form
    Ad, Bd = np.array([[1.0, h], [0.0, 1.0]]), np.array([[h * h / 2], [h]])
    gains = []
    for sample_time in (0.0, h):
        response = probe.call(DesignLqr, f'{SERVER}/design_lqr', DesignLqr.Request(
            a=[0.0, 1.0, 0.0, 0.0], b=[0.0, 1.0], sample_time=sample_time,
            weights=LqrWeights(qx=[100.0, 0.0], qu=[0.01])))
        assert response.success, response.message
        assert response.design.sample_time == sample_time
        gains.append(np.array(response.design.k))
    assert response.design.design == 'sampled'
    assert np.abs(np.linalg.eigvals(Ad - Bd @ gains[0][None])).max() > 1.0  # unstable at h
    assert np.abs(np.linalg.eigvals(Ad - Bd @ gains[1][None])).max() < 1.0


def test_minimize_solves_known_problems(probe):

    def ask(**request):
        return probe.call(Minimize, f'{SERVER}/minimize', Minimize.Request(**request))

    circle = {'variables': ['x1', 'x2'], 'parameters': named(r='2'), 'cost': 'x1 + x2',
              'equalities': ['x1**2 + x2**2 - r**2']}
    response = ask(**circle)
    assert response.success, response.message
    assert response.status == 'solved'
    assert np.allclose(response.x, -np.sqrt(2.0), atol=1e-8)
    assert response.objective == pytest.approx(-2 * np.sqrt(2.0), abs=1e-8)
    # grad F + lam grad G = 0
    assert 1 + response.lam[0] * 2 * response.x[0] == pytest.approx(0.0, abs=1e-7)
    assert response.certificate.holds
    bound = ask(variables=['x'], cost='(x - 3)**2', inequalities=['x - 1'])
    assert np.allclose([*bound.x, *bound.mu], [1.0, 4.0], atol=1e-7)
    infeasible = ask(**{**circle, 'bounds': [NamedBounds(name='x1', lower='3')]})
    assert (infeasible.status, infeasible.success) == ('infeasible', False), infeasible.message
    for changes, words in (({'variables': []}, 'variables'), ({'cost': 'x1 + y'}, 'y'),
                           ({'cost': 'x1.__class__'}, 'cost'),
                           ({'time_limit': -1.0}, 'time_limit'),
                           ({'parameters': named(r='2') * 2}, 'is given twice'),
                           ({'guess': [1.0]}, 'guess')):
        refused = ask(**{**circle, **changes})
        assert (refused.status, refused.success) == ('malformed', False), changes
        assert words in refused.message, refused.message
