# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The figure of `obc demo aircraft`: why py falls when px steps."""

from types import SimpleNamespace

import numpy as np
from obc_ros.book.entries import aircraft as flights
from obc_ros.cli.demo import aircraft as demo
import pytest


@pytest.fixture(scope='module')
def flown():
    """Return the nonlinear flight of 15 s with the printed weights, without nodes."""
    K = flights.compute_gain(flights.PRINTED, 0.1)
    x, u = flights.fly_nonlinear(K, flights.GOAL, round(15 / flights.FLIGHT_STEP))
    return flights.FLIGHT_STEP * np.arange(len(x)), x, u


def test_the_missing_lift_is_the_fall(flown):
    """M dvy/dt = lift - m g - c vy: both integrals of the recorded lift give the fall of py."""
    t, x, u = flown
    held = (demo.compute_lift(x[:-1], u[:-1]) + demo.compute_lift(x[1:], u[:-1])) / 2
    rate = (held - flights.DAMPING * x[:-1, 4]) / flights.MASS - flights.GRAVITY
    step = np.diff(t)
    vy = np.concatenate([[0.0], np.cumsum(rate * step)])
    py = np.concatenate([[0.0], np.cumsum((vy[:-1] + vy[1:]) / 2 * step)])
    early = t <= 2.0
    fall = -x[early, 1].min()
    assert 0.6 < fall < 0.75
    assert -py[early].min() == pytest.approx(fall, rel=0.02)
    level = u[:, 1] >= flights.MASS * flights.GRAVITY   # without a tilt the thrust carries it
    assert level[t < 0.8].all()


@pytest.mark.slow
def test_the_figure_says_why_it_falls(flown):
    t, x, u = flown
    design = SimpleNamespace(ue=[0.0, flights.MASS * flights.GRAVITY])
    steps = [demo.UnitStep(0.0, 0.0, 15.0, name, design) for name in ('Qx = I', 'Example 2.5')]
    figure = demo._draw(t, x, t, u, steps)
    plane, thrust, _ = figure.axes
    assert plane.get_aspect() == 1.0
    assert len(plane.patches) >= 4 * sum(map(len, demo.POSES))   # the parts of each aircraft
    assert f'falls by {-x[:, 1].min():.2f} m' in figure.get_suptitle()
    lift, weight = (line.get_ydata() for line in thrust.lines)
    assert np.ptp(weight) == 0
    assert lift.min() < 0.6 * weight[0]
