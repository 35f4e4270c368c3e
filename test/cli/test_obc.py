# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `obc`: it finds its subcommands, loads no other, and its exit status is theirs."""

from importlib import metadata
import subprocess
import sys
from types import SimpleNamespace

from obc_ros.cli import obc
import pytest


@pytest.fixture
def greet(monkeypatch):
    """Put a subcommand `solve` in place whose exit status is its argument; return what it saw."""
    seen = []

    def run(args):
        seen.append(args.number)
        if args.number == 99:
            raise KeyboardInterrupt
        return args.number

    module = SimpleNamespace(
        add_arguments=lambda parser: parser.add_argument('number', type=int), run=run)
    monkeypatch.setattr(obc, 'find_subcommands', lambda: {'solve': 'greet', 'lqr': 'never loaded'})
    monkeypatch.setattr(
        obc, 'import_module', {'obc_ros.cli.ask.solve': module}.__getitem__)
    return seen


@pytest.mark.parametrize('status', [0, 1, 2])
def test_exit_status_is_that_of_the_subcommand(greet, status):
    assert obc.main(['solve', str(status)]) == status
    assert greet == [status]


def test_interrupt_is_an_exit_status_and_no_traceback(greet):
    assert obc.main(['solve', '99']) == 130


@pytest.mark.parametrize('line', [[], ['sole'], ['solve'], ['solve', 'x'], ['--nonsense']])
def test_malformed_line_is_2(greet, line, capsys):
    with pytest.raises(SystemExit) as exit_:
        obc.main(line)
    assert exit_.value.code == 2
    assert 'usage: obc' in capsys.readouterr().err
    assert greet == []


def test_version(capsys):
    with pytest.raises(SystemExit) as exit_:
        obc.main(['--version'])
    assert exit_.value.code == 0
    assert capsys.readouterr().out == f'obc_ros {metadata.version("obc-ros")}\n'


def test_help_lists_what_is_installed_and_imports_nothing_heavy():
    program = (
        'import sys; from obc_ros.cli import obc\n'
        'try: obc.main(["--help"])\n'
        'except SystemExit: pass\n'
        'print(sorted({"rclpy", "numpy", "casadi", "rich", "yaml"} & set(sys.modules)))')
    answer = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, check=True).stdout
    assert answer.endswith('[]\n')
    for name in obc.find_subcommands():
        assert f'\n    {name}' in answer


def test_reader_that_leaves_early_is_no_crash():
    program = (
        'import sys; from types import SimpleNamespace; from obc_ros.cli import obc\n'
        'obc.find_subcommands = lambda: {"solve": ""}\n'
        'obc.import_module = lambda name: SimpleNamespace(add_arguments=lambda parser: None,\n'
        '    run=lambda args: print("line\\n" * 100000) or 0)\n'
        'sys.exit(obc.main(["solve"]))')
    with subprocess.Popen([sys.executable, '-c', program], stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == 'line\n'
        process.stdout.close()
        assert process.wait(20) == 1
        assert process.stderr.read() == ''


def obc_without_streams(closed):
    """Return how ``obc solve`` of a file that is not there ends without some standard streams."""
    return subprocess.run(
        ['sh', '-c', f'exec "$0" -m obc_ros.cli.obc solve missing.yaml {closed}', sys.executable],
        capture_output=True, text=True, check=False)


@pytest.mark.parametrize('closed', ['>&-', '2>&-', '<&-', '<&- >&- 2>&-'])
def test_streams_that_are_closed_are_no_crash(closed):
    answer = obc_without_streams(closed)
    assert answer.returncode == 2
    assert not answer.stderr
    assert ('cannot be read' in answer.stdout) == (' >&-' not in f' {closed}')


def test_text_that_the_terminal_has_no_signs_for(monkeypatch):
    monkeypatch.setenv('PYTHONIOENCODING', 'ascii')
    answer = subprocess.run(
        [sys.executable, '-m', 'obc_ros.cli.obc', 'solve', 'räte.yaml'],
        capture_output=True, text=True, check=False)
    assert answer.returncode == 2
    assert not answer.stderr
    assert 'r\\xe4te.yaml: cannot be read' in answer.stdout


def test_interrupted_while_it_loads_it_ends_without_a_traceback():
    program = (
        'import os, signal, sys; sys.argv = ["/bin/obc"]; import obc_ros.cli\n'
        'os.kill(os.getpid(), signal.SIGINT); signal.pause()')
    answer = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, check=False, timeout=30.0)
    assert (answer.returncode, answer.stdout, answer.stderr) == (130, '', '')
