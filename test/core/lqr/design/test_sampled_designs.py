# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Designs for a sampled loop with delay."""

from dataclasses import replace
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.closed_loop.control import Control
from obc_ros.core.closed_loop.feedback import InputLimits
from obc_ros.core.closed_loop.loop import ControlLoop
from obc_ros.core.lqr.design.design import Design, design, linearize_plant, Sampling
from obc_ros.core.lqr.design.reference_tracking import compute_tracking_law, read_course
from obc_ros.core.simulation.flow import Conditions
from obc_ros.core.simulation.simulator import Simulator
from obc_ros.core.systems import registry
from obc_ros.core.text.errors import RefusedDesignError, StatementError
import pytest

Array = NDArray[np.float64]

# Example 2.5 with the weight of theta as corrected in errata.md
EXAMPLE_2_5: dict[str, Any] = {
    'Qx': (100.0, 1.0, (3.6 / math.pi)**2, 0.0, 0.0, 0.0), 'Qu': (0.1, 0.1)}


def fly(found: Design, h: float, delay: float) -> Array:
    """Return the maximum of |x| over each second of a simulation from px = 0.3."""
    system = found.plant.system
    control = Control(
        found.regulator, InputLimits(tuple(system.u_min), tuple(system.u_max), (2,)),
        found.plant.rest, system.state_names,
        prediction=found.prediction)
    loop = ControlLoop(control)
    craft = Simulator(system, [0.3, 0.0, 0.0, 0.0, 0.0, 0.0],
                      Conditions(dt=1e-3, input_delay=delay))
    sizes = []
    for k in range(round(10.0 / h)):
        u = loop.answer(round(k * h * 1e9), craft.x.tolist(), k * h)
        assert u is not None
        craft.command(np.array(u))
        craft.advance(round(h / 1e-3))
        sizes.append(np.abs(craft.x).max())
    return np.array(sizes)


def test_example_2_5_needs_a_sampled_design_at_20_hz() -> None:
    """With a delay of 50 ms the continuous gain is unstable; prediction stabilises."""
    at = linearize_plant(registry.get_system('aircraft'))
    continuous = design(at, EXAMPLE_2_5)
    with pytest.raises(RefusedDesignError, match=(
            'held for 0.3 s .* set design = sampled with sample_time = 0.3 first')):
        design(at, EXAMPLE_2_5, sampling=Sampling(0.3))
    found = design(at, EXAMPLE_2_5, sampling=Sampling(0.05, 0.05, exact=True))
    sizes = fly(found, 0.05, 0.05)
    assert sizes.max() < 3.0
    assert sizes[-20:].max() < 0.05
    unpredicted = fly(continuous, 0.05, 0.05)
    assert not unpredicted[-20:].max() < 0.05


def test_sampled_poles_tend_to_the_continuous_ones() -> None:
    """The limit is taken as the period tends to zero."""
    at = linearize_plant(registry.get_system('double_integrator'))
    continuous = design(at, {})
    quick = design(at, {}, sampling=Sampling(1e-4, exact=True))
    np.testing.assert_allclose(quick.K, continuous.K, rtol=1e-3)
    slow = design(at, {}, sampling=Sampling(1.0, exact=True))
    assert np.abs(slow.lqr.E).max() < 1.0
    assert slow.lqr.period == 1.0


@pytest.mark.parametrize(('given', 'sentence'), [
    ({'exact': True}, 'design = sampled needs the period'),
    ({'delay': 0.1}, 'delay = 0.1 needs the period'),
])
def test_invalid_sampling_is_rejected(given: dict[str, Any], sentence: str) -> None:
    """A delay or a sampled design needs a period, and the delay must be finite."""
    with pytest.raises(StatementError, match=sentence):
        Sampling(**given)


def test_gains_along_a_reference_are_sampled_too() -> None:
    """At the end of the reference they equal those of the design."""
    found = design(linearize_plant(registry.get_system('double_integrator')), {},
                   sampling=Sampling(0.2, exact=True))
    t = np.linspace(0.0, 20.0, 201)
    along = read_course(found.plant.system, ((), ()), t.tolist(), [0.0] * 402, [0.0] * 201, '', 0)
    law = compute_tracking_law(along, found)[0]
    np.testing.assert_allclose(law.along.at(0.0).K, found.K, rtol=1e-9)
    np.testing.assert_allclose(law.along.at(20.0).K, found.K, rtol=1e-9)
    other = replace(found, cost=replace(found.cost, Qx=4 * found.cost.Qx))
    K = design(found.plant, {'Qx': (4.0, 4.0)}, sampling=found.sampling).K
    np.testing.assert_allclose(compute_tracking_law(along, other)[0].along.at(0.0).K, K, rtol=1e-6)
