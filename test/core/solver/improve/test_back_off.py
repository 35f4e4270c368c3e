# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Constraint tightening of paths that violate their bounds between mesh points."""

from dataclasses import replace
import time
from types import SimpleNamespace

from obc_ros.core.ocp.solution import Condition, Status
from obc_ros.core.solver.bench import build_bench, State, Task
from obc_ros.core.solver.conclusion import conclude
from obc_ros.core.solver.descent import descend
from obc_ros.core.solver.improve.registry import (
    solve_within_tighter_bounds,
    violates_bounds_only,
)
from obc_ros.core.solver.nlp import meter as clocks
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.options import DEFAULTS
from obc_ros.core.solver.program_cache import ProgramCache
from obc_ros.core.solver.solve import METHODS, solve
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh
import problems
import pytest

LEAST = 4.0   # 4/(9 l) for l = 1/9, Bryson and Ho, section 3.11


def state_problem():
    """Return the problem of least effort with x <= 1/9."""
    return problems.pose(
        {'x': 'v', 'v': 'u'}, 'u**2/2', (0, 1), 1, terminal_constraints=['x', 'v + 1'],
        state_bounds={'x': [-1, 1 / 9]})


def solve_on_line(options=DEFAULTS):
    """Return a bench and the path on 16 intervals."""
    problem = state_problem()
    bench = build_bench(Task(problem, ProgramCache(problem, options), Meter()))
    line = bench.programs.guesser.line(problem, problem.final_time.value)
    return bench, bench.collocate(build_uniform_mesh(problem, 16, bench.stages), line)


def test_the_path_is_within_its_bounds_and_costs_little_more():
    """No path within the bounds costs less than the minimum; the one before does."""
    bench, outcome = solve_on_line()
    state = State(bench, outcome, best=bench.certify(outcome))
    assert state.best.solution.certificate.faults == (Condition.BOUNDS,)
    assert state.best.solution.x[:, 0].max() > 1 / 9 + 1e-6
    assert violates_bounds_only(state)
    new = solve_within_tighter_bounds(state)
    assert new.best.feasible
    assert new.best.solution.x[:, 0].max() < 1 / 9 + 1e-7
    assert LEAST < new.best.solution.objective == pytest.approx(LEAST, rel=1e-2)
    assert (new.bench, new.outcome) == (bench, outcome)
    assert not violates_bounds_only(new)


def test_a_large_violation_is_left_to_the_mesh():
    bench, outcome = solve_on_line()
    best = bench.certify(outcome)
    certificate = best.solution.certificate
    for residuals in ({Condition.BOUNDS: 1e-2}, {Condition.DYNAMICS: 1e-3}):
        other = replace(best, solution=replace(best.solution, certificate=replace(
            certificate, residuals={**certificate.residuals, **residuals})))
        assert not violates_bounds_only(State(bench, outcome, best=other))


def test_a_descent_that_ends_early_returns_a_feasible_path():
    options = replace(DEFAULTS, descent=replace(DEFAULTS.descent, meshes=1))
    bench, outcome = solve_on_line(options)
    found = descend(bench, outcome)
    assert found.feasible
    assert 'tighter bounds' in {each.method for each in bench.trace.attempts()}


@pytest.mark.parametrize('kept', [10.0, 0.0])
def test_time_is_kept_for_a_path_within_the_bounds(kept):
    """The time is up on the first finer mesh; the path before violates the bounds."""
    problem = state_problem()

    def end(phase, *_):
        if 'mesh' in phase and 'coarse' not in phase:
            meter.deadline = time.monotonic()
        return False

    meter = Meter(report=end, kept=kept)
    task = Task(problem, ProgramCache(problem), meter, 1.0)
    found = conclude(task, METHODS['transcription'](task))
    assert found.status is Status.TIMED_OUT
    assert found.certificate.feasible == bool(kept), found.message
    assert ('cost 4.' in found.message) == bool(kept)


def test_a_search_ends_early_enough_for_a_path_within_the_bounds(monkeypatch):
    """On the first finer mesh the clock jumps to 96 % of the time limit."""
    jumped = []

    def jump(phase, *_):
        if 'mesh' in phase and 'coarse' not in phase:
            jumped.append(0.96 * 60)
        return False

    monkeypatch.setattr(clocks, 'time', SimpleNamespace(
        monotonic=lambda: time.monotonic() + max(jumped, default=0.0)))
    found = solve(state_problem(), method='transcription', time_limit=60.0, report=jump)
    assert jumped
    assert found.status is Status.TIMED_OUT
    assert found.certificate.feasible, found.message
