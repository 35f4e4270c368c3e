# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Coarse paths of problems with boundary layers, whose discretisation error stays large."""

from pathlib import Path

from obc_ros.core.ocp.statement import build_problem, load_file
from obc_ros.core.solver.solve import solve
import pytest

MOTORS = Path(__file__).parents[2] / 'collections' / 'practical'


@pytest.mark.slow
@pytest.mark.parametrize('name', [
    'motor_a',   # linear quadratic with bounded voltage: convex
    'motor_c',   # the power u*i is not convex
    'motor_e'])
def test_a_motor_with_a_fast_winding_is_certified(name):
    """0.25 ms beside 0.5 s; the value is that of Radau collocation by hand, with IPOPT."""
    [mapping] = load_file(MOTORS / f'{name}.yaml')
    found = solve(build_problem(mapping))
    assert found.certified, found.message
    expected = mapping['expected']
    assert found.objective == pytest.approx(expected['objective'], abs=expected['tolerance'])
