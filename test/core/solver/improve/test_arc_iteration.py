# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Arcs read off coarse paths that do not show them as they are, nor what they cost."""

from pathlib import Path

from obc_ros.core.ocp.statement import build_problem, load_file
from obc_ros.core.solver.descent import Search
from obc_ros.core.solver.nlp.progress import ProgressMonitor
from obc_ros.core.solver.program_cache import Kit
from obc_ros.core.solver.solve import solve
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh
import pytest


@pytest.mark.parametrize('intervals', [16, 24])
def test_what_coarse_paths_cost_without_the_gaps_between_their_steps(intervals: int):
    """
    Two discretisations of Rayleigh's problem: their inputs are about the same, their costs not.

    With 16 intervals one of them is below the least cost (published), which no input attains.
    """
    mapping = load_file(Path(__file__).parents[3] / 'problems' / 'rayleigh_bounded.yaml')[0]
    problem = build_problem(mapping)
    least, costs, closed = mapping['expected']['objective'], [], []
    for stages in (0, 3):
        search = Search(problem, Kit(problem), ProgressMonitor())
        line = search.kit.guesser.line(problem, problem.final_time.value)
        outcome = search.collocate(build_uniform_mesh(problem, intervals, stages), line)
        assert outcome.converged
        costs.append(outcome.objective - least)
        closed.append(search.kit.integrator.closed(problem, outcome) - least)
    assert max(costs) > 10 * abs(min(costs))
    assert closed[0] == pytest.approx(closed[1], rel=0.03)
    assert min(closed) > 0


@pytest.mark.slow
def test_a_singular_arc_between_bounds_that_a_coarse_path_shows_as_a_jump_to_and_fro():
    """
    Goddard's rocket, a thousandth higher and heavier: its singular arc ends at full thrust.

    Expected is the best of full thrust, a thrust of degree 5 in t, full thrust and none, by DOP853
    and a search over the switching times and the coefficients.
    """
    mapping = load_file(Path(__file__).parents[3] / 'problems' / 'goddard.yaml')[0]
    problem = build_problem(mapping | {'initial_state': {'h': 1.001, 'v': 0, 'm': 1.001}})
    found = solve(problem)
    assert found.certified
    assert found.objective == pytest.approx(-1.017400253188, abs=1e-9)
    assert found.switching_times == pytest.approx([0.0316, 0.0557, 0.0620], abs=3e-4)
