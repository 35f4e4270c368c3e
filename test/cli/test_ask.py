# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The commands `obc solve` and `obc lqr`: exit status, JSON, figures and processes."""

import errno
import json
import math
import os
from pathlib import Path
import subprocess
import sys

from asking import check_malformed, read_json, SCALAR
from hypothesis import given, settings
from hypothesis import strategies as st
from obc_ros.cli import results
from obc_ros.cli.ask.batch import is_plain, Question
from obc_ros.cli.ask.regulator_requests import Case
from obc_ros.cli.obc import main
from obc_ros.core.systems import registry
from obc_ros.core.text.errors import StatementError
from obc_ros.workers.wire import pack, Packet, unpack
import problems
import pytest
import yaml


@pytest.mark.parametrize('content, words', [
    ('states: [x\n  nonsense: {', ''), ('', 'mapping'), ('- 1', 'mapping'), ('[]', 'empty'),
    ('a: 1\na: 2', 'twice'), ('\0\x01', ''), ('!!python/object/apply:os.system [ls]', ''),
], ids=str)
def test_a_malformed_file_exits_with_2_and_has_its_json(tmp_path, capsys, content, words):
    file = tmp_path / 'bad.yaml'
    file.write_text(content)
    assert main(['solve', str(file), '--json', str(tmp_path)]) == 2
    output = capsys.readouterr().out
    [answer] = map(read_json, tmp_path.glob('*.json'))
    check_malformed(answer)
    assert words in answer['message']
    assert answer['message'] in output


@pytest.mark.parametrize('change, words', [
    ('initial_state: {x: 2020-01-01}', 'initial_state.x: wanted a number or an expression, found '
     'a date'), ('1: 2', '1: unknown key'), ('states: &a [*a]', 'an alias contains itself'),
    (f'parameters: {{a: 0x{"f" * 5000}}}', 'parameters.a'),
    ('\n'.join(['parameters:', *(f'{" " * k}a:' for k in range(1, 60))]), 'parameters.a'),
    ('\n'.join(['parameters:', '  a0: &a0 [1, 1]', *(
        f'  a{k}: &a{k} [*a{k - 1}, *a{k - 1}]' for k in range(1, 60))]), 'its aliases expand it'),
    ('states: !!set {x}', 'states: wanted a list'), ('inputs: !!binary eA==', 'inputs')])
def test_a_statement_that_cannot_be_sent_is_malformed(tmp_path, change, words):
    """Values that JSON does not have, repetitions without bound, and nesting."""
    key = change.partition(':')[0]
    statement = yaml.safe_dump({name: value for name, value in SCALAR.items() if name != key})
    file = tmp_path / 'bad.yaml'
    file.write_text(f'{statement}{change}\n')
    [asked] = results.read_questions(Question, [file])
    assert asked.status == 'malformed'
    assert words in asked.message


def test_a_note_of_any_type_is_accepted(tmp_path):
    file = tmp_path / 'dated.yaml'
    file.write_text(f'{yaml.safe_dump(SCALAR)}source: 2010-01-04\nnotes: {{1: [2, 3]}}\n')
    [asked] = results.read_questions(Question, [file])
    assert not asked.status
    assert asked.make_request().plain['statement'] == SCALAR


@pytest.mark.slow
@settings(max_examples=25)
@given(st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inside: st.lists(inside) | st.dictionaries(st.text(), inside)))
def test_what_is_plain_is_unchanged_by_a_packet(value):
    assert is_plain(value)
    assert unpack(pack(Packet({'value': value}))).plain == {'value': value}


@pytest.mark.slow
def test_the_local_minima_and_the_search_are_reported(obc):
    text = (problems.FOLDER / 'aircraft_5.yaml').read_text()
    status, found, output = obc('solve', {'aircraft_5.yaml': text}, '--trace')
    assert status == 0, output
    answer = found['aircraft_5']
    assert 'aircraft_5: what was tried\nattempt ' in output
    assert [each for each in answer['attempts']
            if each['method'] == 'descent' and each['cost'] == answer['objective']]
    starts = [each for each in answer['attempts'] if each['method'] == 'initial guess']
    assert len(starts) == answer['optimality']['starts']
    assert f'initial guess: {starts[-1]["what"]} ' in output
    known = answer['optimality']
    assert known['kind'] == 'local'
    assert known['minima'][0] == answer['objective']
    assert known['minima'] == sorted(known['minima'])
    assert known['minima'][:2] == pytest.approx([1.0832, 1.2271], rel=5e-3)
    assert f"local, best of {len(known['minima'])}" in output


@pytest.mark.parametrize('line', [
    ['--time-limit', '-1'], ['--time-limit', 'nan'], ['--time-limit', '1e5'], ['--speed']])
def test_a_malformed_command_line_exits_with_2(line):
    with pytest.raises(SystemExit) as exit_:
        main(['solve', 'scalar.yaml', *line])
    assert exit_.value.code == 2


@pytest.mark.parametrize('line', [
    ['solve', 'a.yaml'], ['lqr', 'a.yaml'], ['sweep', 'a.yaml', '--out', 'a'], ['gallery'],
    pytest.param(['demo', 'aircraft'], marks=pytest.mark.ros)], ids=lambda line: line[0])
def test_an_unknown_format_of_figures_exits_with_2(capsys, line):
    with pytest.raises(SystemExit) as exit_:
        main([*line, '--format', 'pdf,gif'])
    assert exit_.value.code == 2
    assert "no format 'gif': wanted one or several of png, pdf, svg" in capsys.readouterr().err


@pytest.mark.parametrize('line', [
    ['solve', 'missing.yaml', '--json'], ['solve', 'missing.yaml', '--plot'],
    ['lqr', 'missing.yaml', '--json'],
    pytest.param(['demo', 'aircraft', '--out'], marks=pytest.mark.ros)], ids=' '.join)
def test_an_output_folder_is_checked_before_any_request(tmp_path, capsys, line):
    (tmp_path / 'file').write_text('')
    assert main([*line, str(tmp_path / 'file' / 'out')]) == 1
    output = capsys.readouterr()
    assert output.err.startswith(f'obc {line[0]}: ')
    assert 'file/out' in output.err
    assert 'malformed' not in output.out


def test_an_unwritable_file_is_reported_after_the_results(tmp_path, capsys):
    (tmp_path / 'missing.json').mkdir()
    assert main(['solve', 'missing.yaml', '--json', str(tmp_path)]) == 1
    output = capsys.readouterr()
    assert 'missing.yaml: cannot be read' in output.out
    assert 'missing.json cannot be written: Is a directory' in output.err


def test_file_names_are_safe_and_unique(tmp_path):
    for folder in ('a', 'b'):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / 'p.yaml').write_text(yaml.safe_dump(SCALAR))
    several = tmp_path / 'several.yaml'
    several.write_text(yaml.safe_dump([{**SCALAR, 'name': name} for name in (
        'p', '../../etc/x', 'p', '.')]))
    asked = results.read_questions(Question,
                                   [tmp_path / 'a' / 'p.yaml', tmp_path / 'b' / 'p.yaml', several])
    assert [each.file_name for each in asked] == ['p', 'p_2', 'p_3', '_.._etc_x', 'p_4', 'problem']
    assert [each.name for each in asked] == ['scalar', 'scalar', 'p', '../../etc/x', 'p', '.']
    assert [each.renamed for each in asked] == [False, True, True, False, True, False]


def test_problems_with_equal_names_are_distinguished(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for folder in ('a', 'b'):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / 'p.yaml').write_text(yaml.safe_dump({**SCALAR, 'inputs': []}))
    Path('two.yaml').write_text(yaml.safe_dump([{**SCALAR, 'states': 7}, 3]))
    assert main(['solve', 'a/p.yaml', 'b/p.yaml', 'two.yaml', '--json', 'out']) == 2
    output = capsys.readouterr().out
    for where in ('a/p.yaml', 'b/p.yaml', 'two.yaml, entry 1'):
        assert f'scalar ({where}): ' in output
    assert 'scalar (b/p.yaml): written as p_2' in output
    assert 'two_2: two.yaml, entry 2: wanted a mapping' in output
    assert {path.stem for path in Path('out').iterdir()} == {'p', 'p_2', 'scalar', 'two_2'}


def test_hostile_names_are_escaped(tmp_path, capsys):
    names = ['\x1b[31mred\n\a', '\ud800', 'n' * 5000, *(f"{'計' * 100}{end}" for end in 'ab')]
    file = tmp_path / 'hostile.yaml'
    file.write_text(json.dumps([{**SCALAR, 'name': name, 'states': 7} for name in names]))
    assert main(['solve', str(file), '--json', str(tmp_path / 'out')]) == 2
    shown = capsys.readouterr().out
    assert shown.replace('\n', '').isprintable()
    assert max(map(len, shown.splitlines())) < 200
    assert '\\x1b[31mred' in shown
    assert '\\ud800' in shown
    found = [read_json(path) for path in (tmp_path / 'out').glob('*.json')]
    assert {answer['name'] for answer in found} == set(names)
    assert {answer['status'] for answer in found} == {'malformed'}


@pytest.mark.parametrize('command', ['solve', 'lqr'])
def test_files_are_written_when_printing_fails(tmp_path, monkeypatch, command):
    def gone(*_):
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr(f'obc_ros.cli.ask.{command}.print_table', gone)
    assert main([command, 'missing.yaml', '--json', str(tmp_path)]) == 1
    assert read_json(tmp_path / 'missing.json')['status'] == 'malformed'


def test_a_bad_case_in_a_list_does_not_stop_the_others(tmp_path, capsys):
    case = {'A': [[0]], 'B': [[1]], 'Qx': [1], 'Qu': [1]}
    file = tmp_path / 'list.yaml'
    file.write_text(yaml.safe_dump([
        {**case, 'name': 'twin', 'Qx': [1, 2]}, 3, {**case, 'name': 'twin', 'Qu': None}]))
    assert main(['lqr', str(file), '--json', str(tmp_path)]) == 2
    output = capsys.readouterr().out
    assert f'twin ({file}, entry 1): Qx: wanted 1 rows of 1' in output
    assert f'twin ({file}, entry 3): Qu: missing' in output
    assert 'list_2: ' in output
    assert 'written as twin_2' in output
    assert {path.stem for path in tmp_path.glob('*.json')} == {'twin', 'list_2', 'twin_2'}
    bad = results.read_questions(Case, [file])[1]
    assert bad.status == 'malformed'
    assert 'entry 2: wanted a mapping' in bad.message


def test_a_file_with_a_plant_and_a_problem_is_read_as_both(tmp_path):
    file = tmp_path / 'cart.yaml'
    file.write_text(yaml.safe_dump({
        **SCALAR, 'units': {'x': 'm'}, 'angles': ['x'], 'setpoint': {'x': 0}}))
    [asked] = results.read_questions(Question, [file])
    assert asked.build_problem().states == ('x',)
    assert not asked.status
    assert registry.load_system(file).states[0].unit == 'm'


def test_json_has_null_for_nan_and_infinity(tmp_path):
    results.write(tmp_path, 'x', {'a': [1.0, math.nan, {'b': -math.inf}], 'c': (True, None, 'd')})
    assert read_json(tmp_path / 'x.json') == {
        'a': [1.0, None, {'b': None}], 'c': [True, None, 'd']}


@pytest.mark.parametrize('changes, words', [
    ({'A': [[1, 2]]}, 'A: wanted as many columns as rows'), ({'B': [[1]]}, 'B: wanted 2 rows'),
    ({'A': [[0, 1], [0]]}, 'A[1]'), ({'A': [[0, 'x'], [0, 0]]}, 'A[0][1]'),
    ({'Qx': [1, 2, 3]}, 'Qx: wanted 2 rows of 2'),
    ({'Qu': [[math.nan]]}, 'Qu[0][0]'), ({'Qu': None}, 'Qu: missing'), ({'Q': 1}, 'Q: unknown'),
    ({'system': 'aircraft'}, 'A: the system defines it already'), ({'A': {}}, 'A'),
    ({'weights': 'magic'}, 'weights'),
], ids=str)
def test_a_malformed_case_exits_with_2_and_has_its_json(tmp_path, changes, words):
    case = {'name': 'bad', 'A': [[0, 1], [0, 0]], 'B': [[0], [1]], 'Qx': [1, 1], 'Qu': [1]}
    file = tmp_path / 'bad.yaml'
    file.write_text(yaml.safe_dump({**case, **changes}))
    assert main(['lqr', str(file), '--json', str(tmp_path)]) == 2
    answer = read_json(tmp_path / 'bad.json')
    assert answer['status'] == 'malformed'
    assert words in answer['message']
    assert (answer['K'], answer['P'], answer['poles']) == ([], [], [])


@pytest.mark.slow
def test_an_option_steers_the_search(obc):
    text = (problems.FOLDER / 'aircraft_5.yaml').read_text()
    status, found, output = obc('solve', {'aircraft_5.yaml': text},
                                '--option', 'multistart.most=0')
    assert status == 0, output
    starts = [each for each in found['aircraft_5']['attempts']
              if each['method'] == 'initial guess']
    assert len(starts) == 1


@pytest.mark.slow
@pytest.mark.parametrize(('command', 'asked'), [
    ('solve', SCALAR), ('lqr', {'A': [[0]], 'B': [[1]], 'Qx': [1], 'Qu': [1]})])
def test_no_package_of_ros_is_imported(tmp_path, command, asked):
    """Neither by the command nor by its workers, with a figure and a file."""
    (tmp_path / 'asked.yaml').write_text(yaml.safe_dump(asked))
    blocker = tmp_path / 'blocker'
    blocker.mkdir()
    (blocker / 'sitecustomize.py').write_text(
        'import sys\n'
        'from importlib.machinery import ModuleSpec\n'
        'class Blocker:\n'
        '    def find_spec(self, name, path=None, target=None):\n'
        '        top, _, rest = name.partition(".")\n'
        '        if top.startswith(("rcl", "rosidl", "ament")) or top.endswith("_msgs") or (\n'
        '                top == "obc_ros" and rest in ("msg", "srv", "action")):\n'
        '            return ModuleSpec(name, self)\n'
        '    def create_module(self, spec):\n'
        '        raise ImportError(f"{spec.name} belongs to ROS")\n'
        '    def exec_module(self, module):\n'
        '        raise NotImplementedError\n'
        'sys.meta_path.insert(0, Blocker())\n')
    program = 'import sys; from obc_ros.cli.obc import main; sys.exit(main(sys.argv[1:]))'
    done = subprocess.run(
        [sys.executable, '-c', program, command, str(tmp_path / 'asked.yaml'), '--json',
         str(tmp_path), '--plot', str(tmp_path), '--format', 'pdf,png'],
        env={**os.environ, 'PYTHONPATH': str(blocker)}, capture_output=True, text=True,
        check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert read_json(tmp_path / 'asked.json')['status'] == 'solved'
    assert (tmp_path / 'asked.png').exists()
    assert (tmp_path / 'asked.pdf').read_bytes().startswith(b'%PDF')
    refused = subprocess.run(
        [sys.executable, '-c', 'import rclpy'], env={**os.environ, 'PYTHONPATH': str(blocker)},
        capture_output=True, text=True, check=False)
    assert 'rclpy belongs to ROS' in refused.stderr


@pytest.mark.slow
@pytest.mark.parametrize(('program', 'unwanted'), [
    ('import obc_ros.workers.solving, obc_ros.workers.designing',
     {'scipy', 'control', 'matplotlib'}),
    ('from obc_ros.cli.obc import main; assert main(["solve", "asked.yaml"]) == 0',
     {'casadi', 'scipy', 'control', 'matplotlib', 'rich', 'rclpy', 'importlib.metadata'})])
def test_heavy_packages_are_imported_only_when_they_are_used(tmp_path, program, unwanted):
    (tmp_path / 'asked.yaml').write_text(yaml.safe_dump(SCALAR))
    done = subprocess.run(
        [sys.executable, '-c', f'{program}\n'
         f'import sys\nprint(sorted({unwanted} & {{*sys.modules}}))'],
        cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout.endswith('[]\n'), done.stdout + done.stderr


@pytest.mark.parametrize('name', ['a.yaml', 'a b', '1st', 'a//b', 'a/'])
def test_a_malformed_name_of_a_server_exits_with_2(capsys, name):
    with pytest.raises(SystemExit) as exit_:
        main(['solve', 'scalar.yaml', '--server', name])
    assert exit_.value.code == 2
    assert 'write --server after the files' in capsys.readouterr().err


def test_all_errors_of_a_file_are_printed_each_on_its_line(tmp_path, capsys):
    (tmp_path / 'scalar.yaml').write_text(yaml.safe_dump({
        **SCALAR, 'final_time': [3], 'colour': 'red', 'running_cost': 'y'}, sort_keys=False))
    assert main(['solve', str(tmp_path / 'scalar.yaml'), '--json', str(tmp_path)]) == 2
    printed = capsys.readouterr().out.splitlines()
    answer = read_json(tmp_path / 'scalar.json')
    check_malformed(answer)
    assert printed == [f'scalar: {line}' for line in answer['message'].split('\n')]
    keys = [line.split()[1] for line in printed]
    assert keys == [f'{key}:' for key in [*SCALAR, 'colour']
                    if key in ('final_time', 'colour', 'running_cost')]


def test_all_errors_of_a_regulator_are_printed_each_on_its_line(tmp_path, capsys):
    (tmp_path / 'case.yaml').write_text(
        '{A: [[0]], B: [[1], [2]], Qx: [a], weights: brison, rho: [], delays: 1}')
    assert main(['lqr', str(tmp_path / 'case.yaml')]) == 2
    keys = [line.split()[1] for line in capsys.readouterr().out.splitlines()]
    assert keys == ['B:', 'weights:', 'rho:', 'delays:']


def test_all_errors_of_a_system_file_are_told(tmp_path):
    (tmp_path / 'plant.yaml').write_text(
        '{states: [x, v], inputs: [u], parameters: {m: 1/}, dynamics: {x: v, v: u/n},'
        ' state_bounds: {x: [1, 0], v: [0, m]}, plane: round}')
    with pytest.raises(StatementError) as error:
        registry.load_system(tmp_path / 'plant.yaml')
    starts = [line.split(': ')[1] for line in str(error.value).split('\n')]
    assert starts == ['parameters.m', 'dynamics.v', 'state_bounds.x', 'plane']
