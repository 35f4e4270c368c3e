# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Uncertified paths: the solution contains the path, its cost and the failed condition."""

import math
import re

from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.solve import solve
from obc_ros.core.solver.trace import GUESS
import problems
import pytest

SENTENCE = r'cost (\S+), not certified because .+: residual (\S+), allowed (\S+)'


@pytest.fixture(scope='module')
def coarse():
    """Return a problem and its solution on a mesh that is too coarse for a certificate."""
    problem = problems.build('vanderpol_bounded')
    return problem, solve(problem, max_intervals=10)


def check(found):
    """Check that an uncertified solution has a path, its cost, residuals and the message."""
    assert found.optimality is None
    assert not found.certificate.holds
    assert len(found.t) == len(found.x) == len(found.u) == len(found.lam) > 2
    cost, residual, allowed = map(float, re.search(SENTENCE, found.message).groups())
    worst = found.certificate.worst
    assert cost == pytest.approx(found.objective, rel=1e-6)
    assert residual == pytest.approx(found.certificate.residuals[worst], rel=0.1)
    assert allowed == found.certificate.tolerances[worst]


def test_a_path_on_a_coarse_mesh_is_returned(coarse):
    _, found = coarse
    assert found.status is Status.NOT_CONVERGED
    starts = sum(each.method == GUESS for each in found.attempts)
    assert re.search(rf'; {starts} initial guess(es were| was) tried, ', found.message)
    assert 'max_intervals = 10' in found.message
    if not found.certificate.feasible:
        assert re.search(r': residual (\S+), allowed (\S+)', found.message)
    else:
        check(found)


@pytest.mark.slow
def test_a_path_is_returned_where_no_minimum_exists():
    """The cost is unbounded below; the solution still contains a path."""
    found = solve(problems.pose({'x': 'u', 'y': 'x'}, 'x*u + y', (0, 0), 1))
    assert found.status is Status.NOT_CONVERGED
    assert found.message.startswith('no minimum was found: ')
    assert len(found.t)
    assert re.search(r'; cost \S+, not certified because ', found.message)
    assert not found.certified
    assert found.optimality is None


def test_a_path_is_returned_at_the_time_limit(monkeypatch):
    """The search is stopped after a few iterations."""
    from obc_ros.core.solver.nlp.meter import Meter
    problem = problems.build('vanderpol_bounded')
    step = Meter.step

    def late(self, cost, infeasibility):
        if self.iterations > 6:
            self.deadline = -math.inf
        return step(self, cost, infeasibility)
    monkeypatch.setattr(Meter, 'step', late)
    found = solve(problem, method='transcription')
    assert found.status is Status.TIMED_OUT
    assert len(found.t)
    assert found.certificate is not None
    assert not found.certificate.holds
    assert found.message.startswith('no certified solution within 60 s; ')
    assert ': residual ' in found.message
    assert '1 initial guess was tried, ' in found.message
    assert found.message.endswith('; the time was up during coarse mesh, initial guess')
