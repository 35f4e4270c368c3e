# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Methods are chosen by name: in a file, in a call, on the command line."""

import json

from obc_ros.cli.obc import main
from obc_ros.core.ocp.method_names import get_method, NAMES
from obc_ros.core.ocp.solution import MAX_INTERVALS
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.solver.solve import METHODS, solve
from obc_ros.core.text.errors import StatementError
from obc_ros.workers.requests import answer
from obc_ros.workers.wire import Packet
import pytest
import yaml

SCALAR = {
    'name': 'scalar', 'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u'},
    'running_cost': 'u**2', 'terminal_cost': 'x**2', 'initial_state': {'x': 1},
    'final_time': {'free': False, 'value': 1}}


def test_each_method_has_a_name():
    assert tuple(METHODS) == NAMES


def test_the_method_of_the_problem_is_used_by_default():
    problem = build_problem({**SCALAR, 'method': 'transcription'})
    assert build_problem(SCALAR).method == 'auto'
    assert solve(problem).method == 'transcription'
    assert solve(problem, method='arcs').method == 'arcs'
    assert problem.structure == build_problem(SCALAR).structure


@pytest.mark.parametrize('given, asked, method', [
    (None, '', 'riccati'), ('arcs', '', 'arcs'), ('arcs', 'transcription', 'transcription')])
def test_the_requested_method_overrides_the_problem(given, asked, method):
    statement = SCALAR | ({'method': given} if given else {})
    packet = answer('solve', Packet(
        {'statement': statement, 'method': asked, 'cache_size': 1,
         'max_intervals': MAX_INTERVALS}), 30.0, lambda *_: False)
    assert (packet.plain['status'], packet.plain['method']) == ('solved', method)


@pytest.mark.parametrize('value, words', [
    ('ricatti', "did you mean 'riccati'"), (3, 'wanted a name'), (['arcs'], 'wanted a name'),
    ('x' * 10_000, 'is unknown'), ('auto\n', 'is unknown')])
def test_errors_for_unknown_methods_list_the_known_ones(value, words):
    with pytest.raises(StatementError, match='^method: ') as error:
        build_problem({**SCALAR, 'method': value})
    assert words in str(error.value)
    assert ', '.join(NAMES) in str(error.value)
    assert len(str(error.value)) < 300


@pytest.mark.parametrize('value', [None, ''])
def test_an_empty_method_means_auto(value):
    assert get_method(value) == 'auto'


def test_the_command_line_checks_the_name(capsys):
    with pytest.raises(SystemExit) as end:
        main(['solve', 'scalar.yaml', '--method', 'arc'])
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert "argument --method: 'arc' is unknown (did you mean 'arcs'?)" in said
    assert ', '.join(NAMES) in ' '.join(said.split())


@pytest.mark.nodes
def test_the_command_line_passes_the_method_on(spawn, tmp_path):
    for name, more in (('own', {'method': 'transcription'}), ('plain', {})):
        (tmp_path / f'{name}.yaml').write_text(yaml.safe_dump({**SCALAR, **more, 'name': name}))
    files = [str(tmp_path / f'{name}.yaml') for name in ('own', 'plain')]
    for options, methods in (((), ['transcription', 'riccati']),
                             (('--method', 'arcs'), ['arcs', 'arcs'])):
        process = spawn('obc', arguments=['solve', *files, '--json', str(tmp_path), *options])
        assert process.wait(60.0) == 0, process.output()
        rows = [line.split() for line in process.output().splitlines()]
        assert [row[-3] for row in rows if row[0] in ('own', 'plain')] == methods
    assert json.loads((tmp_path / 'own.json').read_text())['status'] == 'solved'
