# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Statements about random problems are true: a short form of benchmarks/truth.py."""

from math import inf

import _edges  # of benchmarks/
import _truths
import numpy as np
from obc_ros.core.ocp.solution import Status
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.solver.solve import solve
from obc_ros.core.text.expressions import parse_number
import pytest
import truth  # of benchmarks/


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(4))
def test_feasible_problems_get_no_false_statement(seed):
    tally = truth.ask_feasible(75, np.random.default_rng([100, seed]), inf)
    assert sum(tally.asked.values()) > 50
    assert tally.false == []


@pytest.mark.slow
def test_infeasible_problems_are_not_solved():
    tally = truth.ask_infeasible(25, np.random.default_rng(101), inf)
    assert sum(tally.asked.values()) == 25
    assert tally.false == []


@pytest.mark.slow
def test_no_convex_solution_is_certified_above_the_minimum():
    tally = truth.ask_convex(40, np.random.default_rng(102), inf)
    assert tally.found['solved'] > 30
    assert tally.false == []


@pytest.mark.slow
def test_the_simulated_paths_satisfy_their_constraints():
    """Otherwise a statement that such a problem is infeasible might be true."""
    rng = np.random.default_rng(103)
    for _ in range(40):
        made = _truths.feasible(rng)
        mapping = made.mapping
        for name, (low, high) in mapping['state_bounds'].items():
            column = made.x[:, mapping['states'].index(name)]
            if low is not None:
                assert column.min() > low
            if high is not None:
                assert column.max() < high
        for name, (low, high) in mapping['input_bounds'].items():
            column = made.u[:, mapping['inputs'].index(name)]
            assert low < column.min()
            assert column.max() < high
        final = mapping['final_time']
        if final['free']:
            assert final['lower'] < made.t[-1] < final['upper']


@pytest.mark.slow
def test_paths_at_the_edge_meet_their_constraints():
    rng = np.random.default_rng(106)
    for _ in range(20):
        made = _edges.touching(rng)
        names, row = [*made.mapping['states'], 't'], made.mapping['path_constraints'][-1]
        values = [parse_number(row['expr'], dict(zip(names, [*x, t], strict=True)), 'row')
                  - row['lower']
                  for t, x in zip(made.t, made.x, strict=True)]
        assert -1e-12 < min(values[0], values[-1]) < 2e-6
        assert min(values[1:-1]) > 0.0


@pytest.mark.slow
def test_problems_at_the_edge_get_no_false_statement():
    tally = truth.ask_edges(15, np.random.default_rng(107), inf)
    assert sum(tally.asked.values()) > 10
    assert tally.false == []


def test_a_false_finding_is_counted(monkeypatch, capsys):
    def false_check(problem):
        yield 'this cannot be'

    monkeypatch.setattr(truth, 'CONTRADICTIONS', (false_check,))
    tally = truth.ask_feasible(3, np.random.default_rng(104), inf)
    assert sum(tally.asked.values()) > 0
    assert len(tally.false) == sum(tally.asked.values())
    assert 'false_check: this cannot be' in capsys.readouterr().out


@pytest.mark.parametrize('kind', ['reach', 'rotation', 'population', 'undriven', 'bounds'])
def test_each_kind_of_infeasibility_is_proved(kind):
    rng = np.random.default_rng(105)
    while True:
        found, mapping = _truths.infeasible(rng)
        if found == kind:
            break
    assert solve(build_problem(mapping)).status is Status.INFEASIBLE
