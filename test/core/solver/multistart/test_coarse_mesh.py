# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Coarse paths, and those of boundary layers, whose discretisation error stays large."""

from pathlib import Path

from obc_ros.core.ocp.statement import build_problem, load_file
from obc_ros.core.solver.bench import build_bench, Task
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.options import read_options
from obc_ros.core.solver.program_cache import ProgramCache
from obc_ros.core.solver.solve import solve
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh
import problems
import pytest

MOTORS = Path(__file__).parents[3] / 'collections' / 'practical'


@pytest.mark.slow
@pytest.mark.filterwarnings('error')   # costates of motor_c overflow on the first meshes
@pytest.mark.parametrize('name', [
    'motor_a',   # linear quadratic with bounded voltage: convex
    'motor_c',   # the power u*i is not convex
    'motor_e'])
def test_a_motor_with_a_fast_winding_is_certified(name):
    """0.25 ms beside 0.5 s; the value is that of Radau collocation by hand, with IPOPT."""
    [mapping] = load_file(MOTORS / f'{name}.yaml')
    found = solve(build_problem(mapping), time_limit=600)
    assert found.certified, found.message
    expected = mapping['expected']
    assert found.objective == pytest.approx(expected['objective'], abs=expected['tolerance'])


def test_the_trace_shows_the_check_of_an_outcome_once():
    problem = problems.build('di_energy')
    options = read_options(['coarse.error=0'])   # no path is so accurate
    bench = build_bench(Task(problem, ProgramCache(problem, options), Meter()))
    guess = bench.programs.guesser.line(problem, problem.final_time.value)
    one, other = (bench.collocate(build_uniform_mesh(problem, intervals, 0), guess)
                  for intervals in (8, 16))
    assert one.converged and other.converged
    assert not any(bench.is_accurate(outcome) for outcome in (one, one, other, one))
    assert bench.trace.count('check') == 2
