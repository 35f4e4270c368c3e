# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `obc`: subcommands, imports, exit status, closed streams."""

import argparse
from importlib import metadata
import re
import shlex
import subprocess
import sys
from types import SimpleNamespace

from obc_ros.cli import bench, obc
from obc_ros.ros import installation
import pytest
from selection import imports_ros


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
        assert re.search(rf'\n    {name}[ \n]|[:,] {name}\b', answer), name


def find_examples(parser):
    """Yield the program, the help and the examples of a parser and of those inside it."""
    told = parser.format_help()
    yield parser.prog, told, re.findall(r'^example: (.*)$', told, re.M)
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                yield from find_examples(inner)


def test_each_help_ends_with_an_example_that_is_parsed():
    pure = bool(installation.explain_missing_ros())
    names = [name for name in obc.find_subcommands() if not (pure and name in obc.NEED_ROS)]
    parser = obc.build_parser(names, epilog=obc.tell_more(pure))
    for program, told, examples in find_examples(parser):
        if pure and any(f'obc {name}' in program for name in obc.NEED_ROS):
            continue
        assert len(examples) == 1, program
        assert program == 'obc' or told.endswith(f'example: {examples[0]}\n')
        assert f'{examples[0]} '.startswith(f'{program} ')
        assert parser.parse_args(shlex.split(examples[0])[1:]).run


# A process in which ROS 2 is not installed, wherever the test runs.
PURE = 'import sys; sys.modules["obc_ros.msg"] = None; sys.argv[0] = {program!r}; {run}'


@pytest.fixture
def pure(monkeypatch):
    """Have the commands find no ROS 2."""
    monkeypatch.setitem(sys.modules, 'obc_ros.msg', None)


@pytest.mark.parametrize('name', obc.NEED_ROS)
def test_a_command_without_ros_says_what_it_needs(name, pure, capsys):
    assert obc.main([name]) == 1
    told = capsys.readouterr()
    assert told.err.startswith(f'obc: {name} needs ROS 2, and obc_ros is installed without it')
    assert told.err.count('\n') == 1
    assert told.out == ''


def test_the_gallery_without_ros_has_the_results_of_the_package(pure, tmp_path, capsys):
    out = tmp_path / 'gallery'
    assert obc.main(['gallery', '2.4', 'example-2.5', '--out', str(out)]) == 0
    table, _, last = capsys.readouterr().out.rstrip().rpartition('\n')
    assert [line.split()[:2] for line in table.splitlines()[-2:]] == [
        ['example-2.4', 'holds'], ['example-2.5', 'holds']]
    assert last.startswith('2 entries, computed before at commit ')
    assert {path.name for path in out.iterdir()} == {
        'index.html', 'gallery.json', 'example-2.5-inputs.png', 'example-2.5-flight.png',
        *(f'example-2.{k}.{ending}' for k in (4, 5) for ending in ('png', 'py', 'ipynb'))}
    assert obc.main(['gallery', '--format', 'pdf', '--out', str(out)]) == 1
    assert capsys.readouterr().err.startswith('obc gallery: --format needs ROS 2, and obc_ros')


def test_sheets_need_no_ros(pure, tmp_path):
    assert obc.main(['gallery', '--sheet', str(tmp_path / 'sheet.yaml')]) == 0
    assert obc.main(['gallery', '--check', str(tmp_path / 'sheet.yaml')]) == 0


def test_the_help_without_ros_lists_apart_what_does_not_work(pure, capsys):
    with pytest.raises(SystemExit):
        obc.main(['--help'])
    listed, _, apart = capsys.readouterr().out.partition('commands that need ROS 2')
    assert '\n    solve' in listed
    for name in obc.NEED_ROS:
        assert f'\n    {name}' not in listed
        assert re.search(rf'[:,] {name}\b', apart)


@pytest.mark.parametrize('command, file', [('solve', 'dido'), ('lqr', 'case.yaml')])
def test_a_server_without_ros_is_an_error_in_words(pure, tmp_path, monkeypatch, capsys, command,
                                                   file):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'case.yaml').write_text('{A: [[0]], B: [[1]], Qx: [1], Qu: [1]}')
    assert obc.main([command, file, '--server']) == 1
    assert '--server needs ROS 2, and obc_ros is installed without it' in capsys.readouterr().out


@pytest.mark.slow
def test_benchmarks_that_need_ros_are_known():
    scripts = bench.find_benchmarks()
    assert set(bench.NODES) == {name for name, script in scripts.items() if imports_ros(script)
                                or '_fuzz' in script.read_text(encoding='utf-8')}


def test_benchmarks_without_ros_leave_out_the_others(pure, capsys):
    assert obc.main(['bench', '--list']) == 0
    listed = capsys.readouterr().out.split()
    assert 'lqr' in listed
    assert not set(bench.NODES) & set(listed)
    assert obc.main(['bench', 'latency']) == 1
    assert capsys.readouterr().err.startswith('obc bench: latency needs ROS 2, and obc_ros is')


@pytest.mark.parametrize('node', ['lqr_node', 'plant_simulator', 'trajectory_server'])
def test_a_node_without_ros_says_what_it_needs(node):
    done = subprocess.run(
        [sys.executable, '-c', PURE.format(program=node, run=f'import obc_ros.nodes.{node}')],
        capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith(f'{node} needs ROS 2, and obc_ros is installed without it')
    assert done.stderr.count('\n') == 1


@pytest.mark.parametrize('platform, words', [
    ('linux-x86_64', 'OBC_ROS_PURE=1, or a pure wheel): `pip install .` in its sources, without'),
    ('macosx-14.0-arm64', 'Linux on x86-64 only, and this is macosx-14.0-arm64. Where ROS 2')])
def test_the_way_to_ros_depends_on_the_platform(platform, words, pure, monkeypatch):
    monkeypatch.setattr(installation.sysconfig, 'get_platform', lambda: platform)
    assert words in installation.explain_missing_ros()


def test_messages_without_rclpy_are_another_case(monkeypatch):
    monkeypatch.setitem(sys.modules, 'obc_ros.msg', installation)
    monkeypatch.setitem(sys.modules, 'rclpy', None)
    assert 'finds no rclpy: source the setup file' in installation.explain_missing_ros()


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
        [sys.executable, '-P', '-m', 'obc_ros.cli.obc', 'solve', 'räte.yaml'],
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
