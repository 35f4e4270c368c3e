# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The commands `obc solve` and `obc lqr`: exit status, JSON, figures and processes."""

import errno
import json
import math
import os
from pathlib import Path
import signal
import time

from _endless import endless  # of benchmarks/
from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from obc_ros.cli import client, results, ros_graph, terminal
from obc_ros.cli.ask.problem_requests import Question
from obc_ros.cli.ask.regulator_requests import Case
from obc_ros.cli.obc import main
from obc_ros.core.systems import registry
from obc_ros.srv import SolveOptimalControl
import problems
import pytest
from support import children, wait_for
import yaml

pytestmark = pytest.mark.nodes

KEYS = ['name', 'status', 'message', 'objective', 't', 'x', 'u', 'lam', 'interpolation',
        'switching_times', 'certificate', 'optimality', 'attempts', 'solve_time', 'build_time',
        'iterations']
SCALAR = {
    'name': 'scalar', 'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u'},
    'running_cost': 'u**2', 'terminal_cost': 'x**2', 'initial_state': {'x': 1},
    'final_time': {'free': False, 'value': 1}}
ENDLESS = endless(12)


@pytest.fixture
def obc(spawn, request, tmp_path):
    """Return a function that runs `obc` on files and returns status, JSON by name, output."""
    def run(command, files, *options, server=False, end=lambda process: process.wait(60.0)):
        if server:
            spawn('trajectory_server', {'workers': 2})
            ready(request.getfixturevalue('probe'))
        folder = tmp_path / 'in'
        folder.mkdir(exist_ok=True)
        for name, content in files.items():
            if content is not None:
                text = content if isinstance(content, str) else yaml.safe_dump(content)
                (folder / name).write_text(text)
        paths = [str(folder / name) for name in files]
        process = spawn('obc', arguments=[command, *paths, '--json', str(tmp_path), *options])
        status = end(process)
        found = {path.stem: read(path) for path in tmp_path.glob('*.json')}
        return status, found, process.output()
    return run


def ready(probe):
    """Wait until the server offers its services."""
    client_ = probe.node.create_client(SolveOptimalControl, '/trajectory_server/solve')
    probe.wait_for(client_.service_is_ready, what='the server')


def read(path):
    """Return the content of a JSON file; refuse NaN and infinity, which are not JSON."""
    def refuse(constant):
        raise AssertionError(f'{constant} in {path.name}')
    return json.loads(path.read_text(), parse_constant=refuse)


def test_certified_solutions_exit_with_0(obc, tmp_path):
    names = ['lq_scalar_unit', 'di_mintime_rest']
    status, found, output = obc('solve', {
        f'{name}.yaml': (problems.FOLDER / f'{name}.yaml').read_text() for name in names},
        '--plot', str(tmp_path))
    assert status == 0, output
    assert sorted(found) == sorted(names)
    for name in names:
        problem = problems.read(name)
        answer = found[name]
        assert list(answer) == KEYS
        assert (answer['name'], answer['status']) == (name, 'solved')
        assert answer['objective'] == pytest.approx(
            problem['expected']['objective'], abs=problem['expected']['tolerance'])
        for key, names_ in (('x', 'states'), ('u', 'inputs'), ('lam', 'states')):
            assert list(answer[key]) == problem[names_]
            assert {len(column) for column in answer[key].values()} == {len(answer['t'])}
        certificate = answer['certificate']
        assert certificate['holds'] is True
        assert certificate['residuals'].keys() == certificate['tolerances'].keys()
        assert all(certificate['residuals'][each] <= bound
                   for each, bound in certificate['tolerances'].items())
        assert (tmp_path / f'{name}.png').read_bytes().startswith(b'\x89PNG')
        assert name in output
        assert answer['optimality']['kind'] == 'global'
        assert f"global ({answer['optimality']['reason']})" in output
    assert found['di_mintime_rest']['switching_times'] == pytest.approx([1.0], abs=1e-3)


def test_its_own_server_ends_with_the_command(obc):
    started = []

    def watch(process):
        [server] = wait_for(lambda: children(process.pid))
        started.extend([server, *wait_for(lambda: children(server))])
        return process.wait(60.0)

    assert obc('solve', {'scalar.yaml': SCALAR}, end=watch)[0] == 0
    wait_for(lambda: not any(Path(f'/proc/{pid}').exists() for pid in started))
    started.clear()

    def kill(process):
        [server] = wait_for(lambda: children(process.pid))
        started.extend([server, *wait_for(lambda: children(server))])
        process.kill()
        return 0

    obc('solve', {'endless.yaml': ENDLESS}, end=kill)
    wait_for(lambda: not any(Path(f'/proc/{pid}').exists() for pid in started))


def test_a_running_server_is_used(obc, probe):
    diagnostics = probe.listen(DiagnosticArray, '/diagnostics')
    status, found, output = obc('solve', {'list.yaml': [
        {**SCALAR, 'name': 'one'}, {**SCALAR, 'name': 'two', 'initial_state': {'x': 2}}]},
        server=True)
    assert status == 0, output
    assert sorted(found) == ['one', 'two']
    assert found['one']['objective'] == pytest.approx(0.5)
    assert found['two']['objective'] == pytest.approx(2.0)
    probe.wait_for(lambda: diagnostics and {
        each.key: each.value for each in diagnostics[-1].status[0].values}['requests'] == '2')


@pytest.mark.parametrize('content, words', [
    ('states: [x\n  nonsense: {', ''), ('', 'mapping'), ('- 1', 'mapping'), ('[]', 'empty'),
    ({**SCALAR, 'gravity': 9.81}, 'gravity'), ({**SCALAR, 'running_cost': '().__class__'}, 'cost'),
    ({**SCALAR, 'initial_state': {'x': math.nan}}, 'initial_state'),
    ({**SCALAR, 'states': 7}, 'states'), ('a: 1\na: 2', 'twice'), ('\0\x01', ''),
    ('!!python/object/apply:os.system [ls]', ''),
], ids=str)
def test_a_malformed_problem_exits_with_2_and_has_its_json(tmp_path, capsys, content, words):
    file = tmp_path / 'bad.yaml'
    file.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
    assert main(['solve', str(file), '--json', str(tmp_path)]) == 2
    output = capsys.readouterr().out
    [answer] = map(read, tmp_path.glob('*.json'))
    assert list(answer) == KEYS
    assert answer['status'] == 'malformed'
    assert words in answer['message']
    assert answer['message'] in output
    assert answer['objective'] is None
    assert answer['certificate'] == {'holds': False, 'residuals': {}, 'tolerances': {}}
    assert answer['optimality'] == {'kind': '', 'reason': '', 'starts': 0, 'minima': []}


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


def test_a_missing_file_does_not_stop_the_other_files(obc):
    status, found, _ = obc('solve', {'good.yaml': SCALAR, 'missing.yaml': None}, server=True)
    assert status == 2
    assert {name: answer['status'] for name, answer in found.items()} == {
        'good': 'solved', 'missing': 'malformed'}


def test_a_timeout_exits_with_1(obc):
    status, found, output = obc('solve', {'endless.yaml': ENDLESS, 'scalar.yaml': SCALAR},
                                '--time-limit', '0.8', server=True)
    assert status == 1, output
    assert found['endless']['status'] == 'timed_out'
    assert found['scalar']['status'] == 'solved'
    assert found['endless']['message'] in output


def test_a_tiny_time_limit_gives_a_timeout(obc):
    status, found, output = obc('solve', {'endless.yaml': ENDLESS}, '--time-limit', '1e-5')
    assert status == 1, output
    assert found['endless']['status'] == 'timed_out', output


@pytest.mark.parametrize('line', [
    ['--time-limit', '-1'], ['--time-limit', 'nan'], ['--time-limit', '1e5'], ['--speed']])
def test_a_malformed_command_line_exits_with_2(line):
    with pytest.raises(SystemExit) as exit_:
        main(['solve', 'scalar.yaml', *line])
    assert exit_.value.code == 2


@pytest.mark.parametrize('server', [True, False])
def test_ctrl_c_cancels_the_requests(obc, probe, clock, server):
    diagnostics = probe.listen(DiagnosticArray, '/diagnostics')

    def busy():
        return diagnostics and {
            each.key: each.value for each in diagnostics[-1].status[0].values}['busy']

    def interrupt(process):
        if server:
            probe.wait_for(lambda: busy() == '1', what='the server solves')
        else:
            [server_] = wait_for(lambda: children(process.pid))
            wait_for(lambda: children(server_))
        begun = time.monotonic()
        status = process.interrupt()
        assert clock.since(begun) < 2.5
        return status

    status, found, output = obc('solve', {'endless.yaml': ENDLESS, 'scalar.yaml': '{'},
                                server=server, end=interrupt)
    assert status == 2
    assert found['scalar']['status'] == 'malformed'
    assert found['endless']['status'] == 'cancelled', output
    assert 'Traceback' not in output
    if server:
        probe.wait_for(lambda: busy() == '0', what='the server is idle again')


def test_the_death_of_its_own_server_is_reported(obc):
    def kill(process):
        [server] = wait_for(lambda: children(process.pid))
        wait_for(lambda: len(children(server)) == 2)
        os.kill(server, signal.SIGKILL)
        return process.wait()

    status, found, output = obc('solve', {'endless.yaml': ENDLESS}, end=kill)
    assert status == 1
    assert found['endless']['status'] == 'not_converged'
    assert 'trajectory_server was ended by SIGKILL' in found['endless']['message'], output


def test_waiting_for_a_lost_server_ends(probe, clock, monkeypatch):
    monkeypatch.setattr(ros_graph, 'SILENCE', 0.2)
    lonely = client.Client(probe.context, lambda: None)
    begun = time.monotonic()
    with pytest.raises(client.ServerLostError, match='does not respond any more'):
        lonely.wait(lambda: False, lambda: time.monotonic() < begun + 0.3)
    assert time.monotonic() - begun >= 0.45
    assert clock.since(begun) < 5.0
    lonely.close()


@pytest.mark.parametrize('line', [
    ['solve', 'missing.yaml', '--json'], ['solve', 'missing.yaml', '--plot'],
    ['lqr', 'missing.yaml', '--json'], ['demo', 'aircraft', '--out']], ids=' '.join)
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


@pytest.mark.parametrize(('command', 'status', 'question'), [
    ('solve', 'not_converged', SCALAR),
    ('lqr', 'refused', {'A': [[0]], 'B': [[1]], 'Qx': [1], 'Qu': [1]})])
def test_an_invalid_ros_environment_is_reported(tmp_path, monkeypatch, capsys, command, status,
                                                question):
    monkeypatch.setenv('ROS_DOMAIN_ID', 'one')
    (tmp_path / 'good.yaml').write_text(yaml.safe_dump(question))
    assert main([command, str(tmp_path / 'good.yaml'), '--json', str(tmp_path)]) == 1
    answer = read(tmp_path / 'good.json')
    assert answer['status'] == status
    assert 'ROS_DOMAIN_ID is not an integral number' in answer['message']
    assert answer['message'] in capsys.readouterr().out


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
    found = [read(path) for path in (tmp_path / 'out').glob('*.json')]
    assert {answer['name'] for answer in found} == set(names)
    assert {answer['status'] for answer in found} == {'malformed'}


@pytest.mark.parametrize(('command', 'status', 'question'), [
    ('solve', 'cancelled', SCALAR),
    ('lqr', 'refused', {'A': [[0]], 'B': [[1]], 'Qx': [1], 'Qu': [1]})])
def test_an_interrupt_before_connecting_still_writes_the_json(tmp_path, monkeypatch, command,
                                                              status, question):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(client, 'connect_client', interrupted)
    (tmp_path / 'good.yaml').write_text(yaml.safe_dump(question))
    assert main([command, str(tmp_path / 'good.yaml'), '--json', str(tmp_path)]) == 1
    answer = read(tmp_path / 'good.json')
    assert (answer['status'], answer['message']) == (status, 'ended by SIGINT')


@pytest.mark.parametrize('command', ['solve', 'lqr'])
def test_files_are_written_when_printing_fails(tmp_path, monkeypatch, command):
    def gone(*_):
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr(terminal, 'print_table', gone)
    assert main([command, 'missing.yaml', '--json', str(tmp_path)]) == 1
    assert read(tmp_path / 'missing.json')['status'] == 'malformed'


def test_a_bad_problem_in_a_list_does_not_stop_the_others(obc):
    status, found, _ = obc('solve', {'list.yaml': [
        {**SCALAR, 'name': 'good'}, 'nonsense', {**SCALAR, 'name': 'bad', 'dynamics': {}}]})
    assert status == 2
    assert {name: answer['status'] for name, answer in found.items()} == {
        'good': 'solved', 'list_2': 'malformed', 'bad': 'malformed'}


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
    assert asked.problem
    assert not asked.status
    assert registry.load_system(file).states[0].unit == 'm'


def test_json_has_null_for_nan_and_infinity(tmp_path):
    results.write(tmp_path, 'x', {'a': [1.0, math.nan, {'b': -math.inf}], 'c': (True, None, 'd')})
    assert read(tmp_path / 'x.json') == {'a': [1.0, None, {'b': None}], 'c': [True, None, 'd']}


def test_regulators_are_designed_or_refused(obc, tmp_path):
    q = 2.0  # Example 2.4: K = (q, sqrt(2 q)), with P and the closed-loop polynomial below
    cases = [
        {'name': 'example_2_4', 'A': [[0, 1], [0, 0]], 'B': [[0], [1]],
         'Qx': [['2**2', 0], [0, 0]], 'Qu': [[1]]},
        {'name': 'aircraft', 'system': 'aircraft', 'parameters': {'m': '2*2'},
         'Qx': [100, 1, '2*pi/9', 0, 0, 0], 'Qu': [0.1, 0.1]},
        {'name': 'bryson', 'system': 'vehicle', 'setpoint_input': [5, 0], 'weights': 'bryson',
         'x_max': [1, 1, 1], 'u_max': [1, 1]},
        {'name': 'out_of_reach', 'A': [[1]], 'B': [[0]], 'Qx': [[1]], 'Qu': [[1]]},
        {'name': 'indefinite', 'A': [[0]], 'B': [[1]], 'Qx': [[1]], 'Qu': [[-1]]}]
    status, found, output = obc('lqr', {'cases.yaml': cases}, '--plot', str(tmp_path))
    assert status == 1, output
    assert {name: each['status'] for name, each in found.items()} == {
        'example_2_4': 'solved', 'aircraft': 'solved', 'bryson': 'solved',
        'out_of_reach': 'refused', 'indefinite': 'refused'}
    assert all(list(each) == ['name', 'status', 'message', 'K', 'P', 'poles']
               for each in found.values())
    example = found['example_2_4']
    assert np.allclose(example['K'], [[q, math.sqrt(2 * q)]], rtol=0, atol=1e-12)
    assert np.allclose(example['P'], [[math.sqrt(2 * q**3), q], [q, math.sqrt(2 * q)]])
    poles = [complex(*pole) for pole in example['poles']]
    assert np.allclose(np.poly(poles), [1, math.sqrt(2 * q), q])
    assert 'uncontrollable' in found['out_of_reach']['message']
    assert 'Qu[0] = -1' in found['indefinite']['message']
    assert len(found['aircraft']['K']) == 2
    assert {path.stem for path in tmp_path.glob('*.png')} == {'example_2_4', 'aircraft', 'bryson'}


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
    answer = read(tmp_path / 'bad.json')
    assert answer['status'] == 'malformed'
    assert words in answer['message']
    assert (answer['K'], answer['P'], answer['poles']) == ([], [], [])


def test_an_option_steers_the_search(obc):
    text = (problems.FOLDER / 'aircraft_5.yaml').read_text()
    status, found, output = obc('solve', {'aircraft_5.yaml': text},
                                '--option', 'multistart.most=0')
    assert status == 0, output
    starts = [each for each in found['aircraft_5']['attempts']
              if each['method'] == 'initial guess']
    assert len(starts) == 1
