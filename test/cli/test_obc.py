# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `obc`: subcommands, imports, exit status, closed streams."""

from importlib import metadata
import subprocess
import sys
from types import SimpleNamespace

from obc_ros.cli import obc
import pytest


@pytest.fixture
def greet(monkeypatch):
    """Replace `solve` by a subcommand that exits with its argument; return its arguments."""
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
def test_the_exit_status_is_that_of_the_subcommand(greet, status):
    assert obc.main(['solve', str(status)]) == status
    assert greet == [status]


def test_an_interrupt_exits_with_130(greet):
    assert obc.main(['solve', '99']) == 130


@pytest.mark.parametrize('line', [[], ['sole'], ['solve'], ['solve', 'x'], ['--nonsense']])
def test_a_malformed_command_line_exits_with_2(greet, line, capsys):
    with pytest.raises(SystemExit) as exit_:
        obc.main(line)
    assert exit_.value.code == 2
    assert 'usage: obc' in capsys.readouterr().err
    assert greet == []


def test_the_version_is_printed(capsys):
    with pytest.raises(SystemExit) as exit_:
        obc.main(['--version'])
    assert exit_.value.code == 0
    assert capsys.readouterr().out == f'obc_ros {metadata.version("obc-ros")}\n'


def test_help_lists_all_subcommands_without_heavy_imports():
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


def test_a_closed_pipe_causes_no_traceback():
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


def run_without_streams(closed):
    """Return the completed `obc solve` of a missing file, run with some streams closed."""
    return subprocess.run(
        ['sh', '-c', f'exec "$0" -m obc_ros.cli.obc solve missing.yaml {closed}', sys.executable],
        capture_output=True, text=True, check=False)


@pytest.mark.parametrize('closed', ['>&-', '2>&-', '<&-', '<&- >&- 2>&-'])
def test_closed_standard_streams_cause_no_traceback(closed):
    answer = run_without_streams(closed)
    assert answer.returncode == 2
    assert not answer.stderr
    assert ('cannot be read' in answer.stdout) == (' >&-' not in f' {closed}')


def test_characters_unknown_to_the_terminal_are_escaped(monkeypatch):
    monkeypatch.setenv('PYTHONIOENCODING', 'ascii')
    answer = subprocess.run(
        [sys.executable, '-m', 'obc_ros.cli.obc', 'solve', 'räte.yaml'],
        capture_output=True, text=True, check=False)
    assert answer.returncode == 2
    assert not answer.stderr
    assert 'r\\xe4te.yaml: cannot be read' in answer.stdout


def test_sigint_while_loading_causes_no_traceback():
    program = (
        'import os, signal, sys; sys.argv = ["/bin/obc"]; import obc_ros.cli\n'
        'os.kill(os.getpid(), signal.SIGINT); signal.pause()')
    answer = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, check=False, timeout=30.0)
    assert (answer.returncode, answer.stdout, answer.stderr) == (130, '', '')
