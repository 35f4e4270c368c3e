# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What is reported of a design belongs to the loop that runs: ControlLoop on the held plant."""

import math
from typing import Any

import numpy as np
from obc_ros.core.closed_loop.control import Control
from obc_ros.core.closed_loop.feedback import convert_rows, InputLimits
from obc_ros.core.closed_loop.loop import ControlLoop
from obc_ros.core.lqr.design.design import Design, design, linearize_plant, Sampling
from obc_ros.core.lqr.design.report import Change, report_fields
from obc_ros.core.lqr.margins import compute_margins
from obc_ros.core.simulation.flow import Conditions
from obc_ros.core.simulation.simulator import Simulator
from obc_ros.core.systems import registry
from obc_ros.core.text.errors import RefusedDesignError
import pytest

FLEXIBLE = 1e-3   # [s] step of the simulator


def plant(name: str = 'double_integrator', **parameters: Any) -> Any:
    return linearize_plant(registry.get_system(name, parameters))


def fields(found: Design, period: float = 0.0) -> dict[str, Any]:
    return report_fields(found, Change(), None, period)


def grows(found: Design, period: float, gain: float = 1.0, extra: float = 0.0) -> bool:
    """Return whether the controller's loop grows with a gain and a delay at the plant's input."""
    system = found.plant.system
    free = (-math.inf,) * system.m, (math.inf,) * system.m
    loop = ControlLoop(Control(
        found.regulator, InputLimits(*free), found.plant.rest, system.state_names,
        prediction=found.prediction, C=convert_rows(found.C)))
    craft = Simulator(system, [1e-3] + [0.0] * (system.n - 1),
                      Conditions(dt=FLEXIBLE, input_delay=found.sampling.delay + extra))
    sizes = []
    for k in range(400):
        u = loop.answer(round(k * period * 1e9), craft.x.tolist(), k * period)
        assert u is not None
        craft.command(gain * np.array(u))
        craft.advance(round(period / FLEXIBLE))
        sizes.append(np.abs(craft.x).max())
    return bool(max(sizes[-100:]) > max(sizes[200:300]))


@pytest.mark.parametrize(('sampling', 'integral'), [
    (Sampling(0.5), ()), (Sampling(0.5, exact=True), ('x1',)),
    (Sampling(0.5, 0.5, exact=True), ()), (Sampling(0.2, 0.25, exact=True), ('x1',)),
    (Sampling(0.1, 0.5), ())])
def test_the_controller_is_stable_within_the_reported_margins_only(sampling: Sampling,
                                                                   integral: Any) -> None:
    found = design(plant(), {}, integral, sampling=sampling)
    seen, h = fields(found), sampling.period
    assert seen['loop_period'] == h
    assert not grows(found, h)
    assert not grows(found, h, gain=0.97 * seen['gain_margin'][0])
    assert grows(found, h, gain=1.03 * seen['gain_margin'][0])
    margin = seen['delay_margin'][0]
    assert not grows(found, h, extra=margin - 0.02)
    assert grows(found, h, extra=margin + 0.02)


@pytest.mark.parametrize(('A', 'sampling', 'figure', 'alone', 'runs'), [
    ((0, 1, 0, 0), Sampling(0.5), 'phase_margin', 72.0, 47.0),
    ((0, 1, 0, 0), Sampling(0.1, 0.5, exact=True), 'gain_margin', 12.2, 2.6),
    ((0, 1, 0, 0), Sampling(0.5, 0.5, exact=True), 'gain_margin', 3.0, 2.0),
    ((0, 1, 3, 0), Sampling(0.05, 1.0, exact=True), 'phase_margin', 56.0, 5.7),
])
def test_the_figures_are_not_those_of_the_gain_alone(A: Any, sampling: Sampling, figure: str,
                                                     alone: float, runs: float) -> None:
    """The table of docs/regulator.md; in test_held_margins the margins bracket the stability."""
    found = design(linearize_plant(registry.get_system('linear', {
        'A': list(map(float, A)), 'B': [0.0, 1.0]})), {}, sampling=sampling)
    of_gain = getattr(compute_margins(
        found.lqr.A, found.lqr.B, found.K, found.lqr.period), figure)[0]
    of_loop = fields(found)[figure][0]
    unit = 180.0 / math.pi if figure == 'phase_margin' else 1.0
    assert of_gain * unit == pytest.approx(alone, rel=0.02)
    assert of_loop * unit == pytest.approx(runs, rel=0.03)


def test_the_sentence_says_of_which_loop_the_figures_are() -> None:
    found = design(plant(), {})
    assert found.held_loop() is None
    assert fields(found)['loop_period'] == 0.0
    assert '(in continuous time, the period of the commands is not known)' in fields(
        found)['sentence']
    held = fields(found, 0.2)
    assert held['loop_period'] == 0.2
    assert '(with commands every 0.2 s)' in held['sentence']
    assert held['phase_margin'][0] < fields(found)['phase_margin'][0]
    assert 'minimum delay margin' in held['sentence']
    ahead = fields(design(plant(), {}, sampling=Sampling(0.1, 0.3, exact=True)))['sentence']
    assert 'u = ue - K (predicted state - xe)' in ahead


def test_an_unstable_loop_is_called_so() -> None:
    """K2 h < 2 for a period h of the double integrator, K2 = sqrt 3."""
    found = design(plant(), {})
    slow = fields(found, 1.2)
    assert slow['sentence'].startswith('double_integrator: unstable, spectral abscissa ')
    assert np.isnan(slow['phase_margin']).all()


def test_the_longest_period_is_that_by_hand() -> None:
    """Jury's criterion for K = (1, sqrt 3), see test_held_margins; loops of 20 Hz and unknown."""
    for sampling in (Sampling(), Sampling(0.05)):
        found = design(plant(), {}, sampling=sampling)
        longest = found.longest_period
        assert longest == pytest.approx(2.0 / math.sqrt(3.0), rel=2e-6)
        below = found.held_loop(0.999 * longest)
        assert below
        assert below.radius < 1.0
        assert not grows(found, 1.1)
        assert grows(found, 1.2)


def test_a_loop_without_a_longest_period() -> None:
    """With x' = -x + u and K = sqrt(2) - 1 the map of a long period is -K."""
    assert design(plant('scalar', a=-1.0), {}).longest_period == math.inf


def test_integral_action_that_is_unstable_as_a_sum_is_refused() -> None:
    """A design integrates the motion, the controller sums samples (trapezoidal rule)."""
    with pytest.raises(RefusedDesignError, match='the gain with integral action is unstable'):
        design(plant(), {}, ('x1',), (1e4,), Sampling(1.0, exact=True))
    found = design(plant(), {}, ('x1',), (1.0,), Sampling(1.0, exact=True))
    assert not grows(found, 1.0)


def test_positions_with_integral_action_have_step_figures() -> None:
    found = design(plant(), {}, ('x1',), sampling=Sampling(0.1, exact=True))
    seen = fields(found)
    assert seen['rise_time'][0] > 0.1
    assert seen['overshoot'][0] > 0.0
    assert math.isnan(seen['rise_time'][1])
