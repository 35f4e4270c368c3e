# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Descent from a coarse path to a certificate."""

from obc_ros.core.solver.bench import build_bench, Task
from obc_ros.core.solver.descent import descend
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.program_cache import ProgramCache
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh
import problems
import pytest


@pytest.mark.parametrize('name', ['vanderpol_bounded', 'rayleigh_bounded'])
def test_a_descent_from_a_coarse_path_is_certified_and_its_meshes_are_recorded(name):
    problem = problems.build(name)
    bench = build_bench(Task(problem, ProgramCache(problem), Meter()))
    line = bench.programs.guesser.line(problem, problem.final_time.value)
    coarse = bench.collocate(build_uniform_mesh(problem, 16, bench.stages), line)
    before = bench.trace.work
    found = descend(bench, coarse)
    assert found.certified
    assert found.solution.objective == pytest.approx(coarse.objective, rel=1e-2)
    meshes = [each for each in bench.trace.attempts() if each.method == 'mesh']
    [entry] = [each for each in bench.trace.attempts() if each.method == 'descent']
    assert len(meshes) > 1
    assert {each.parent for each in meshes} == {entry.number}
    assert entry.cost == found.solution.objective
    assert entry.work == bench.trace.work - before >= sum(each.work for each in meshes)
