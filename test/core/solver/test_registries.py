# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Registries of the search: unique names, and a new entry that is used and recorded."""

from dataclasses import replace
from pathlib import Path

import _ablation
from obc_ros.core.ocp.solution import Verdict
from obc_ros.core.solver import solve as solving
from obc_ros.core.solver.bench import build_bench, Task
from obc_ros.core.solver.descent import descend
from obc_ros.core.solver.diagnosis import explanation
from obc_ros.core.solver.diagnosis.explanation import Check, explain, Reason, Situation
from obc_ros.core.solver.improve import registry as improvements
from obc_ros.core.solver.improve.registry import DescentStage, Improvement
from obc_ros.core.solver.linear_quadratic import solve_lq
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.program_cache import ProgramCache
from obc_ros.core.solver.solve import EXACT_METHODS, ExactMethod, METHODS, solve
from obc_ros.core.solver.starts import registry as starts
from obc_ros.core.solver.starts.start import Known, Proposal, Start, StartPool, StartStage
from obc_ros.core.solver.trace import GUESS, Trace
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh
import problems
import pytest

REGISTRIES = {'methods': EXACT_METHODS, 'starts': starts.STARTS,
              'improvements': improvements.IMPROVEMENTS, 'checks': explanation.CHECKS}
PAGE = Path(__file__).parents[3] / 'docs' / 'solver.md'


def test_names_are_unique():
    names = [each.name for registry in REGISTRIES.values() for each in registry]
    assert len(set(names)) == len(names) > 10
    assert not set(names) & (set(METHODS) - {each.name for each in EXACT_METHODS})


@pytest.mark.parametrize('registry', ['starts', 'improvements', 'checks'])
def test_the_page_lists_the_strategies_in_order(registry):
    rows = [f'| {each.name} | ' + (
        '; '.join(situation.value for situation in each.when) if registry == 'checks' else
        f'{each.stage.value} | {each.when}') + ' |' for each in REGISTRIES[registry]]
    assert '\n'.join(rows) + '\n\n' in PAGE.read_text(encoding='utf-8')


def test_a_new_exact_method_is_used_and_recorded(monkeypatch):
    """It is tried before the others; a problem of another kind goes on to them."""
    def solve_scalar(problem):
        return solve_lq(problem) if problem.n == 1 else None

    monkeypatch.setattr(solving, 'EXACT_METHODS', (
        ExactMethod('scalar', True, True, 'scalar problems', solve_scalar), *EXACT_METHODS))
    found = solve(problems.build('lq_scalar_unit'))
    assert (found.method, found.certified) == ('scalar', True)
    [attempt] = found.attempts
    assert (attempt.method, attempt.what, attempt.verdict) == (
        'exact method', 'scalar', Verdict.CERTIFIED)
    found = solve(problems.build('di_energy'))
    assert found.method == 'riccati'
    assert [(each.what, each.verdict) for each in found.attempts] == [
        ('scalar', Verdict.REJECTED), ('riccati', Verdict.CERTIFIED)]


@pytest.mark.parametrize('exact', EXACT_METHODS, ids=lambda exact: exact.name)
def test_an_exact_method_by_name_is_recorded(exact):
    """It does not solve this problem, whose dynamics are not linear, and nothing else is tried."""
    found = solve(problems.build('vanderpol_bounded'), method=exact.name)
    [attempt] = found.attempts
    assert (attempt.what, attempt.verdict) == (exact.name, Verdict.REJECTED)
    assert found.message.endswith('this problem is not one of them')


@pytest.fixture(name='bench')
def make_bench():
    """Return the bench of a problem with bounded inputs."""
    problem = problems.build('vanderpol_bounded')
    return build_bench(Task(problem, ProgramCache(problem), Meter()))


def solve_on_line(bench):
    """Return the outcome on a coarse mesh from the straight line."""
    line = bench.programs.guesser.line(bench.problem, bench.problem.final_time.value)
    return bench.collocate(build_uniform_mesh(bench.problem, 16, bench.stages), line)


@pytest.mark.parametrize('stage', [StartStage.FIRST_OUTCOME, StartStage.MULTISTART])
def test_a_new_start_is_used_and_recorded(monkeypatch, stage):
    """It proposes the line once more, which is seen to lead to the same minimum."""
    def start_again(bench, pool, known):
        line = bench.programs.guesser.line(bench.problem, bench.problem.final_time.value)
        return Proposal(first=iter([line]), wanted=1)

    problem = problems.build('vanderpol_bounded')
    monkeypatch.setattr(starts, 'STARTS', (*starts.STARTS, Start(
        'line once more', stage, 'always', lambda *_: True, start_again)))
    found = solve(problem, method='transcription')
    [made] = [each for each in found.attempts if each.method == 'line once more']
    assert made.verdict is Verdict.ACCEPTED
    [guess] = [each for each in found.attempts if (each.method, each.what) == (
        GUESS, 'line once more')]
    assert guess.work > 0
    assert found.certified, found.message


def test_the_outcome_of_a_new_start_ends_its_stage(monkeypatch, bench):
    outcome = solve_on_line(bench)

    def fail(*_):
        raise AssertionError('the stage has ended')

    monkeypatch.setattr(starts, 'STARTS', (
        Start('nothing', StartStage.LAST_RESORT, 'always', lambda *_: True,
              lambda *_: Proposal(why='no idea')),
        Start('not now', StartStage.SECOND_MESH, 'always', lambda *_: True, fail),
        Start('never', StartStage.LAST_RESORT, 'never', lambda *_: False, fail),
        Start('line', StartStage.LAST_RESORT, 'always', lambda *_: True,
              lambda *_: Proposal(outcomes=(outcome,))),
        Start('too late', StartStage.LAST_RESORT, 'always', lambda *_: True, fail)))
    pool = StartPool(bench.problem, bench.programs)
    assert starts.try_starts(StartStage.LAST_RESORT, bench, pool, Known()).outcomes == (outcome,)
    assert [(each.method, each.verdict, each.why) for each in bench.trace.attempts()[1:]] == [
        ('nothing', Verdict.REJECTED, 'no idea'), ('line', Verdict.ACCEPTED, '')]


def test_a_new_improvement_is_used_and_recorded(monkeypatch, bench):
    """It certifies the coarse outcome, so that the descent ends without a finer mesh."""
    def certify_now(state):
        return replace(state, best=state.bench.certify(state.outcome))

    monkeypatch.setattr(improvements, 'IMPROVEMENTS', (
        Improvement('nothing', DescentStage.START, 'always', lambda _: True, lambda _: 'no idea'),
        Improvement('certificate at once', DescentStage.START, 'always', lambda _: True,
                    certify_now), *improvements.IMPROVEMENTS))
    found = descend(bench, solve_on_line(bench))
    _, descent, nothing, tried = bench.trace.attempts()
    assert (nothing.method, nothing.verdict, nothing.why) == (
        'nothing', Verdict.REJECTED, 'no idea')
    assert (tried.method, tried.parent) == ('certificate at once', descent.number)
    assert tried.verdict is descent.verdict is Verdict.NOT_CERTIFIED
    assert tried.cost == found.solution.objective


def test_a_new_check_is_used_and_recorded(monkeypatch):
    """It is tried after those that examine the statement, and its reason is the answer."""
    reason = Reason(False, 'it is Monday')
    monkeypatch.setattr(explanation, 'CHECKS', (
        *(check for check in explanation.CHECKS if Situation.STATED in check.when),
        Check('weekday', (Situation.STATED,), lambda _: reason)))
    trace = Trace()
    assert explain(problems.build('vanderpol_bounded'), trace=trace) is reason
    assert [(each.method, each.verdict, each.why) for each in trace.attempts()] == [
        ('contradiction', Verdict.NOT_PROVED, ''), ('no minimum', Verdict.NOT_PROVED, ''),
        ('weekday', Verdict.NOT_PROVED, 'it is Monday')]


def test_the_statement_is_examined_once():
    """What the trace shows is not tried again, whatever the check would return now."""
    problem = problems.build('vanderpol_bounded')
    trace = Trace()
    for _ in range(2):
        assert explain(problem, trace=trace) is None
    assert [each.method for each in trace.attempts()] == ['contradiction', 'no minimum']


@pytest.mark.parametrize(('strategy', 'others'), [
    ('riccati', {'multistart'}), ('', {'riccati'}), ('multistart', {'riccati'})])
def test_a_strategy_is_switched_off_for_the_ablation(strategy, others):
    """Without Riccati equations a search solves the problem; the registries are restored."""
    acted = set()
    with _ablation.switched((strategy,), acted):
        found = solve(problems.build('lq_scalar_unit'))
    assert found.method == ('arcs' if strategy == 'riccati' else 'riccati')
    assert found.objective == pytest.approx(problems.read(
        'lq_scalar_unit')['expected']['objective'], rel=1e-6)
    assert strategy not in acted
    assert others <= acted
    assert list(REGISTRIES.values()) == [
        solving.EXACT_METHODS, starts.STARTS, improvements.IMPROVEMENTS, explanation.CHECKS]


def test_each_strategy_of_a_registry_can_be_switched_off():
    names = [each.name for registry in REGISTRIES.values() for each in registry]
    assert list(_ablation.STRATEGIES[:len(names)]) == names
    assert len(set(_ablation.STRATEGIES)) == len(_ablation.STRATEGIES)
