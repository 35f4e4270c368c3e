# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Weights for a specified response: found, verified by control, and rejected with reasons."""

import math

import control
import numpy as np
from obc_ros.core.lqr.lqr import lqr
from obc_ros.core.lqr.weight_search import StepSpecifications, suggest
from obc_ros.core.text.errors import StatementError
from plants import aircraft, CHAIN, FORCE
import pytest


def step_figures(A, B, weights, i):
    """Return rise time and overshoot of a step of state i by python-control."""
    K = lqr(A, B, weights.Qx, weights.Qu).K
    loop = control.ss(A - B @ K, B @ K[:, [i]], np.eye(len(A))[[i]], 0)
    info = control.step_info(loop, T=np.linspace(0, 40, 20001))
    return info['RiseTime'], info['Overshoot'] / 100


@pytest.mark.parametrize('rise, overshoot, peak', [
    (1.0, 0.05, 0.0), (0.3, 0.02, 0.0), (3.0, 0.0, 1.0), (0.0, 0.01, 0.5), (2.2, 0.05, 1.2)])
def test_specifications_of_a_double_integrator_are_met(rise, overshoot, peak):
    found = suggest(CHAIN, FORCE, StepSpecifications(rise, overshoot, (peak,)), inputs=['force'])
    assert found.success
    assert found.message.startswith('all specifications are met')
    seen_rise, seen_overshoot = step_figures(CHAIN, FORCE, found.best.weights, 0)
    assert not rise or seen_rise <= rise * 1.01
    assert not overshoot or seen_overshoot <= overshoot + 1e-3
    assert not peak or abs(found.best.design.K[0, 0]) <= peak * 1.01  # at t = 0


def test_specifications_of_the_aircraft_are_met():
    A, B = aircraft()
    found = suggest(A, B, StepSpecifications(1.0, 0.10, (40.0, 40.0)), inputs=['f1', 'f2'])
    assert found.success, found.message
    for i in range(2):
        rise, overshoot = step_figures(A, B, found.best.weights, i)
        assert rise <= 1.01
        assert overshoot <= 0.11


def test_the_table_trades_rise_time_for_peak_input():
    found = suggest(CHAIN, FORCE, StepSpecifications(1.0))
    scale = [trial.scale for trial in found.table]
    assert scale == sorted(scale)
    assert len(scale) >= 10
    peak = [trial.peak_input[0] for trial in found.table]
    rise = [trial.rise_time for trial in found.table]
    assert peak == sorted(peak)
    assert all(after <= 1.001 * before for before, after in zip(rise[:-1], rise[1:], strict=True))


def test_errors_name_conflicting_specifications():
    """From rest a force of 0.1 needs at least sqrt(2 / 0.1) s for 1 m."""
    found = suggest(CHAIN, FORCE, StepSpecifications(0.5, 0.0, (0.1,)), inputs=['force'])
    assert not found.success
    assert found.message.startswith('no weights were found that meet rise time 0.5 and peak of '
                                    'force 0.1 together: the minimum rise time found with peak ')
    assert 'the minimum peak of force found with rise time met is' in found.message
    assert np.linalg.eigvals(CHAIN - FORCE @ found.best.design.K).real.max() < 0


def test_errors_name_a_single_infeasible_specification():
    """Holding an unstable plant at 1 fixes its input; no weights lower it."""
    found = suggest(np.array([[1.0]]), np.array([[1.0]]), StepSpecifications(0.0, 0.0, (0.5,)))
    assert not found.success
    assert found.message.startswith('no weights were found that meet peak of input 0 0.5: the '
                                    'minimum peak of input 0 found is')


def test_invalid_specifications_are_rejected():
    for wanted, words in [
            (StepSpecifications(-1.0), 'rise_time = -1'),
            (StepSpecifications(1.0, math.nan), 'overshoot'),
            (StepSpecifications(1.0, 0.1, (1.0, 2.0)), 'peak_input has 2 numbers; wanted 1'),
            (StepSpecifications(peak_input=(math.inf,)), 'peak_input')]:
        with pytest.raises(StatementError, match=words):
            suggest(CHAIN, FORCE, wanted)
    with pytest.raises(StatementError, match='x_max has 1 number; wanted 2'):
        suggest(CHAIN, FORCE, StepSpecifications(1.0), x_max=[1.0])
    with pytest.raises(StatementError, match='no state of this system can be held'):
        suggest(np.array([[-1.0]]), np.array([[0.0]]), StepSpecifications(1.0))
