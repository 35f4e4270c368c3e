# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Arcs read off coarse paths that do not show them as they are."""

from pathlib import Path

from obc_ros.core.solve import solve
from obc_ros.core.statement import load_file, problem_from_mapping
import pytest


def test_a_singular_arc_between_bounds_that_a_coarse_path_shows_as_a_jump_to_and_fro():
    """
    Goddard's rocket, a thousandth higher and heavier: its singular arc ends at full thrust.

    Expected is the best of full thrust, a thrust of degree 5 in t, full thrust and none, by DOP853
    and a search over the switching times and the coefficients.
    """
    mapping = load_file(Path(__file__).parent / 'problems' / 'goddard.yaml')[0]
    problem = problem_from_mapping(mapping | {'initial_state': {'h': 1.001, 'v': 0, 'm': 1.001}})
    found = solve(problem)
    assert found.certified
    assert found.objective == pytest.approx(-1.017400253188, abs=1e-9)
    assert found.switching_times == pytest.approx([0.0316, 0.0557, 0.0620], abs=3e-4)
