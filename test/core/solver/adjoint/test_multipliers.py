# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The fit of costates and multipliers along a path."""

import numpy as np
from obc_ros.core.ocp.certificate.certificate import certify
from obc_ros.core.solver.bench import build_bench, Task
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.options import DEFAULTS
from obc_ros.core.solver.program_cache import ProgramCache
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh
import problems
import pytest


@pytest.mark.parametrize('intervals', [24, 30, 45])
def test_densities_bend_at_mesh_points_where_these_are_the_samples(intervals):
    """Otherwise the samples have another integral of the density than the fit."""
    problem = problems.build('around_a_disc')
    bench = build_bench(Task(problem, ProgramCache(problem, DEFAULTS), Meter()))
    guess = bench.programs.guesser.line(problem, problem.final_time.value)
    guess.x[:, 1] += 0.5 * np.sin(np.pi * guess.t / guess.t[-1])   # above the disc
    outcome = bench.collocate(build_uniform_mesh(problem, intervals, 3), guess)
    assert outcome.converged
    course = bench.course(outcome)
    density = course.density_path.reshape(intervals, course.parts, 2, -1)
    assert np.abs(density).max() > 0
    first, last = density[:, 0, 0], density[:, -1, 1]
    for k in range(course.parts):
        for side in (0, 1):
            part = (k + side) / course.parts
            np.testing.assert_allclose(density[:, k, side], (1 - part) * first + part * last,
                                       atol=1e-9 * np.abs(density).max())
    samples = bench.programs.judge.samples(problem, course)
    assert certify(problem, samples).residuals['costate'] < 1e-3
