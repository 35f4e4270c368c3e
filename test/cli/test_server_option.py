# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc solve --server` and `obc lqr --server`: which server, and what if there is none."""

import time

from asking import read_json, SCALAR
from diagnostic_msgs.msg import DiagnosticArray
from obc_ros.cli import client, ros_graph
from obc_ros.cli.obc import main
from obc_ros.srv import SolveOptimalControl
import pytest
import yaml

pytestmark = pytest.mark.nodes

REGULATOR = {'A': [[0]], 'B': [[1]], 'Qx': [1], 'Qu': [1]}
COMMANDS = pytest.mark.parametrize(('command', 'status', 'asked'), [
    ('solve', 'not_converged', SCALAR), ('lqr', 'refused', REGULATOR)])


def ask(folder, command, asked, *options):
    """Run a command on a file; return its exit status and the JSON file."""
    (folder / 'asked.yaml').write_text(yaml.safe_dump(asked))
    status = main([command, str(folder / 'asked.yaml'), '--json', str(folder), *options])
    return status, read_json(folder / 'asked.json')


def test_the_server_of_the_name_is_used(spawn, probe, tmp_path):
    diagnostics = probe.listen(DiagnosticArray, '/diagnostics')
    for name in ('one', 'two'):
        spawn('trajectory_server', {'workers': 1}, name=name)
        client_ = probe.node.create_client(SolveOptimalControl, f'/{name}/solve')
        probe.wait_for(client_.service_is_ready, what=f'the server {name}')
    (tmp_path / 'two.yaml').write_text(yaml.safe_dump([
        {**SCALAR, 'name': 'a'}, {**SCALAR, 'name': 'b', 'initial_state': {'x': 2}}]))
    process = spawn('obc', arguments=[
        'solve', str(tmp_path / 'two.yaml'), '--json', str(tmp_path), '--server', 'two'])
    assert process.wait() == 0, process.output()
    assert read_json(tmp_path / 'a.json')['objective'] == pytest.approx(0.5)
    assert read_json(tmp_path / 'b.json')['objective'] == pytest.approx(2.0)

    def requests(name):
        found = [each for array in diagnostics for each in array.status
                 if each.name.startswith(f'{name}:')]
        return found and {each.key: each.value for each in found[-1].values}['requests']

    probe.wait_for(lambda: requests('two') == '2', what='the diagnostics of two')
    assert requests('one') == '0'
    other = spawn('obc', arguments=['solve', str(tmp_path / 'two.yaml'), '--server', '/three'])
    assert other.wait() == 1
    assert 'no trajectory_server /three is running; there is /one, /two' in other.output()


@COMMANDS
def test_without_a_server_the_error_says_how_to_start_one(
        domain, tmp_path, monkeypatch, capsys, command, status, asked):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    code, answer = ask(tmp_path, command, asked, '--server')
    assert code == 1
    assert answer['status'] == status
    assert answer['message'].startswith(
        f'no trajectory_server runs on ROS_DOMAIN_ID={domain}: start one')
    assert answer['message'] in capsys.readouterr().out


@COMMANDS
def test_an_invalid_ros_environment_is_reported(tmp_path, monkeypatch, capsys, command, status,
                                                asked):
    monkeypatch.setenv('ROS_DOMAIN_ID', 'one')
    code, answer = ask(tmp_path, command, asked, '--server')
    assert code == 1
    assert answer['status'] == status
    assert 'ROS_DOMAIN_ID is not an integral number' in answer['message']
    assert answer['message'] in capsys.readouterr().out


@pytest.mark.parametrize(('command', 'status', 'asked'), [
    ('solve', 'cancelled', SCALAR), ('lqr', 'refused', REGULATOR)])
def test_an_interrupt_before_connecting_still_writes_the_json(tmp_path, monkeypatch, command,
                                                              status, asked):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(client, 'join_graph', interrupted)
    code, answer = ask(tmp_path, command, asked, '--server')
    assert code == 1
    assert (answer['status'], answer['message']) == (status, 'ended by SIGINT')


def test_waiting_for_a_lost_server_ends(probe, clock, monkeypatch):
    monkeypatch.setattr(ros_graph, 'SILENCE', 0.2)
    lonely = client.Client(probe.context, lambda: None)
    begun = time.monotonic()
    with pytest.raises(client.ServerLostError, match='does not respond any more'):
        lonely.wait(lambda: False, lambda: time.monotonic() < begun + 0.3)
    assert time.monotonic() - begun >= 0.45
    assert clock.since(begun) < 5.0
    lonely.close()
