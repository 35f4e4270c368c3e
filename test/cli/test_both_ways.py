# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
`obc solve` and `obc lqr` in processes of the command, and by a server: the same in both ways.

Results, words, exit status, time limit, cancelling, the bound on memory, and killed workers.
"""

import math
import os
from pathlib import Path
import resource
import signal
import time

import asking
from asking import ENDLESS, KEYS, SCALAR
import numpy as np
import problems
import pytest
from support import alive, wait_for

TOO_SHORT = {
    'name': 'too_short', 'states': ['x', 'v'], 'inputs': ['u'], 'dynamics': {'x': 'v', 'v': 'u'},
    'running_cost': 'u**2', 'initial_state': {'x': 1, 'v': 0}, 'terminal_constraints': ['x', 'v'],
    'input_bounds': {'u': [-1, 1]}, 'final_time': {'free': False, 'value': 1}}
REGULATORS = [
    {'name': 'example_2_4', 'A': [[0, 1], [0, 0]], 'B': [[0], [1]],
     'Qx': [['2**2', 0], [0, 0]], 'Qu': [[1]]},
    {'name': 'aircraft', 'system': 'aircraft', 'parameters': {'m': '2*2'},
     'Qx': [100, 1, '2*pi/9', 0, 0, 0], 'Qu': [0.1, 0.1]},
    {'name': 'bryson', 'system': 'vehicle', 'setpoint_input': [5, 0], 'weights': 'bryson',
     'x_max': [1, 1, 1], 'u_max': [1, 1]},
    {'name': 'sampled', 'system': 'linear', 'parameters': {'A': [[0, 1], [0, 0]], 'B': [[0], [1]]},
     'Qx': [1, 1], 'Qu': [1], 'sample_time': 0.1, 'delay': 0.05},
    {'name': 'out_of_reach', 'A': [[1]], 'B': [[0]], 'Qx': [[1]], 'Qu': [[1]]},
    {'name': 'indefinite', 'A': [[0]], 'B': [[1]], 'Qx': [[1]], 'Qu': [[-1]]}]


def statement(name):
    """Return the text of a problem file."""
    return (problems.FOLDER / f'{name}.yaml').read_text()


def test_certified_solutions_exit_with_0(both, tmp_path):
    names = ['lq_scalar_unit', 'di_mintime_rest']
    status, found, output = both('solve', {f'{name}.yaml': statement(name) for name in names},
                                 '--plot', str(tmp_path), '--trace')
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
        assert f'{name}: what was tried' in output
        assert answer['optimality']['kind'] == 'global'
        assert f"global ({answer['optimality']['reason']})" in output
    assert found['di_mintime_rest']['switching_times'] == pytest.approx([1.0], abs=1e-3)


def test_a_bound_that_decided_is_said(both):
    problem = {**TOO_SHORT, 'running_cost': 1,
               'final_time': {'free': True, 'lower': 3, 'upper': 9}}
    status, found, output = both('solve', {'too_long.yaml': {**problem, 'name': 'too_long'}})
    assert status == 0
    remark = 'T = 3 s is the lower bound of final_time: this bound decides the answer'
    assert found['too_long']['remark'] == remark
    assert f'too_long: {remark}\n' in output


def test_an_infeasible_problem_exits_with_1(both):
    status, found, output = both('solve', {'too_short.yaml': TOO_SHORT})
    assert status == 1
    assert (found['too_short']['status'], found['too_short']['message']) == (
        'infeasible', 'the terminal constraints cannot be met by T = 1: the minimum time is 2')
    assert f"too_short: {found['too_short']['message']}\n" in output


def test_a_malformed_problem_does_not_stop_the_others(both):
    status, found, output = both('solve', {
        'list.yaml': [{**SCALAR, 'name': 'good'}, 'nonsense',
                      {**SCALAR, 'name': 'bad', 'dynamics': {}}], 'missing.yaml': None})
    assert status == 2
    assert {name: answer['status'] for name, answer in found.items()} == {
        'good': 'solved', 'list_2': 'malformed', 'bad': 'malformed', 'missing': 'malformed'}
    assert "bad: dynamics: no equation for the state 'x'\n" in output


def test_malformed_statements_exit_with_2_and_have_their_json(both):
    changes = {
        'gravity': {'gravity': 9.81}, 'running_cost': {'running_cost': '().__class__'},
        'initial_state': {'initial_state': {'x': math.nan}}, 'states': {'states': 7},
        'parameters': {'parameters': 7}, 'method': {'method': 'magic'},
        'system': {'system': 'nothing', 'states': None, 'inputs': None, 'dynamics': None}}
    status, found, output = both('solve', {
        'list.yaml': [{**SCALAR, 'name': name, **change} for name, change in changes.items()]})
    assert status == 2
    assert found.keys() == changes.keys()
    for name, answer in found.items():
        asking.check_malformed(answer)
        assert name in answer['message']
        assert f"{name}: {answer['message']}\n" in output


def test_a_timeout_exits_with_1(both):
    # A solver process needs seconds to begin on a busy machine.
    status, found, output = both('solve', {'endless.yaml': ENDLESS, 'scalar.yaml': SCALAR},
                                 '--time-limit', '10')
    assert status == 1, output
    assert found['endless']['status'] == 'timed_out'
    assert found['scalar']['status'] == 'solved'
    assert found['endless']['message'] in output


def test_a_tiny_time_limit_gives_a_timeout(both):
    status, found, output = both('solve', {'endless.yaml': ENDLESS}, '--time-limit', '1e-5')
    assert status == 1, output
    assert found['endless']['status'] == 'timed_out', output


def test_ctrl_c_cancels_the_problems_and_writes_the_json(both):
    def interrupt(process):
        both.wait_until_busy(process)
        begun = time.monotonic()
        status = process.interrupt()
        assert time.monotonic() - begun < 10.0
        return status

    status, found, output = both('solve', {
        'endless.yaml': ENDLESS, 'scalar.yaml': '{',
        'others.yaml': [{**ENDLESS, 'name': f'other_{k}'} for k in range(2)]}, end=interrupt)
    assert status == 2
    assert found['scalar']['status'] == 'malformed'
    assert {found[name]['status'] for name in ('endless', 'other_0', 'other_1')} == {'cancelled'}
    assert found['endless']['message'].startswith('cancelled'), output
    assert found['other_1']['message'] == 'ended by SIGINT'
    assert 'Traceback' not in output


def test_a_problem_without_memory_does_not_stop_the_others(both):
    def bound(process):
        pid = both.wait_until_busy(process)
        text = Path(f'/proc/{pid}/status').read_text()
        [used] = [line.split()[1] for line in text.splitlines() if line.startswith('VmData')]
        most = (int(used) << 10) + (1 << 20)
        resource.prlimit(pid, resource.RLIMIT_DATA, (most, most))
        return process.wait(120.0)

    larger = {**asking.endless(60), 'name': 'larger'}
    status, found, output = both('solve', {'list.yaml': [larger, {**SCALAR, 'name': 'small'}]},
                                 '--time-limit', '60', end=bound)
    assert status == 1
    assert found['small']['status'] == 'solved'
    assert found['larger']['status'] == 'not_converged', output
    assert found['larger']['message'].startswith(
        'the worker process that was solving this has died: ')


def test_a_killed_worker_costs_its_problem_only(both):
    def kill(process):
        os.kill(both.wait_until_busy(process), signal.SIGKILL)
        return process.wait()

    status, found, output = both('solve', {
        'list.yaml': [ENDLESS, *({**SCALAR, 'name': f'scalar_{k}'} for k in range(3))]}, end=kill)
    assert status == 1
    assert {found[f'scalar_{k}']['status'] for k in range(3)} == {'solved'}, output
    assert found['endless']['status'] == 'not_converged'
    assert found['endless']['message'].startswith(
        'the worker process that was solving this has died: it was killed (SIGKILL)')


def test_regulators_are_designed_or_refused(both, tmp_path):
    q = 2.0  # Example 2.4: K = (q, sqrt(2 q)), with P and the closed-loop polynomial below
    status, found, output = both('lqr', {'cases.yaml': REGULATORS}, '--plot', str(tmp_path))
    assert status == 1, output
    assert {name: each['status'] for name, each in found.items()} == {
        'example_2_4': 'solved', 'aircraft': 'solved', 'bryson': 'solved', 'sampled': 'solved',
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
    assert {path.stem for path in tmp_path.glob('*.png')} == {
        'example_2_4', 'aircraft', 'bryson', 'sampled'}


@pytest.mark.nodes
def test_the_files_of_both_ways_are_equal_except_for_times(tmp_path, request):
    """Every number is equal, and so are messages, certificates and attempts."""
    files = {f'{name}.yaml': statement(name) for name in (
        'lq_scalar_unit', 'di_mintime_rest', 'di_fuel_abs', 'vanderpol_bounded', 'aircraft_5')}
    files |= {'too_short.yaml': TOO_SHORT, 'bad.yaml': {**SCALAR, 'states': 7}, 'guess.yaml': {
        **SCALAR, 'name': 'guess', 'running_cost': 'u**2 + u**4', 'parameters': {'a': 1 / 3},
        'initial_guess': {'states': {'x': ['a', 0.1]}, 'inputs': {'u': -0.7}}}}
    written = []
    for way in ('in process', 'server'):
        folder = tmp_path / way.replace(' ', '_')
        folder.mkdir()
        command = asking.Command(folder, request, way)
        texts = [command('solve', files, '--time-limit', '600')[2],
                 command('lqr', {'cases.yaml': REGULATORS})[2]]
        command.end()
        found = {path.name: asking.read_json(path) for path in folder.glob('*.json')}
        for answer in found.values():
            answer.pop('solve_time', None)
            answer.pop('build_time', None)
            answer.pop('first_path_time', None)
        written.append((found, [len(text.splitlines()) for text in texts]))
    assert written[0] == written[1]
    assert len(written[0][0]) == len(files) + len(REGULATORS)


@pytest.mark.slow
def test_the_workers_end_with_the_command(obc):
    started = []

    def watch(process):
        started.extend(wait_for(lambda: obc.workers(process)))
        return process.wait()

    def kill(process):
        started.extend(wait_for(lambda: obc.workers(process)))
        process.kill()
        return 0

    assert obc('solve', {'scalar.yaml': SCALAR}, end=watch)[0] == 0
    obc('solve', {'endless.yaml': ENDLESS}, end=kill)
    assert len(started) >= 2
    wait_for(lambda: not any(map(alive, started)))


@pytest.mark.slow
def test_there_are_as_many_workers_as_cores_but_not_more_than_problems(obc):
    most = 0

    def count(process):
        nonlocal most
        while process.running():
            most = max(most, len(obc.workers(process)))
            time.sleep(0.01)
        return process.wait()

    names = [f'scalar_{k}' for k in range(5)]
    assert obc('solve', {'list.yaml': [{**SCALAR, 'name': each} for each in names]},
               end=count)[0] == 0
    assert most <= min(5, len(os.sched_getaffinity(0)))
