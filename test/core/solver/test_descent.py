# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Descent from a coarse path to a certificate, at once or in parts."""

from obc_ros.core.solver.bench import build_bench, Task
from obc_ros.core.solver.descent import descend, Descent
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.program_cache import ProgramCache
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh
import problems
import pytest


def solve_on_line(problem):
    """Return a bench and the outcome on a coarse mesh from the straight line."""
    bench = build_bench(Task(problem, ProgramCache(problem), Meter()))
    line = bench.programs.guesser.line(problem, problem.final_time.value)
    return bench, bench.collocate(build_uniform_mesh(problem, 16, bench.stages), line)


@pytest.mark.parametrize('name', ['vanderpol_bounded', 'rayleigh_bounded'])
def test_an_interrupted_descent_leads_to_the_same_solution(name):
    """It is interrupted after each mesh; other work in between is not counted as its own."""
    problem = problems.build(name)
    whole = descend(*solve_on_line(problem))
    bench, outcome = solve_on_line(problem)
    descent, found, parts = Descent(bench, outcome), None, 0
    while found is None:
        found, parts = descent.advance(0), parts + 1
        with bench.trace.attempt('between'):
            bench.trace.spend(1000)
    assert parts > 1
    assert found.certified
    assert found.solution.objective == whole.solution.objective
    meshes = [each for each in bench.trace.attempts() if each.method == 'mesh']
    [entry] = [each for each in bench.trace.attempts() if each.method == 'descent']
    assert {each.parent for each in meshes} == {entry.number}
    assert entry.work >= sum(each.work for each in meshes)
    assert entry.work < bench.trace.work - 1000 * parts
