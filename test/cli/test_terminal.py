# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the commands print: on terminals of 40 and 80 columns, in a pipe, in ASCII."""

import os
import re
import subprocess
import sys

from obc_ros.cli.obc import main
from obc_ros.core.text.tables import format_residual, format_value
import pytest
import yaml

ESCAPE = re.compile(r'\x1b\[([0-9;?]*)([A-Za-z])')
# Riccati: P = [[sqrt(2), 1], [1, sqrt(2)]], K = [1, sqrt(2)]; three plants side by side.
CHAINS = {
    'name': 'chains',
    'A': [[float(j == i + 1 and i % 2 == 0) for j in range(6)] for i in range(6)],
    'B': [[float(i == 2 * j + 1) for j in range(3)] for i in range(6)],
    'Qx': [1, 0] * 3, 'Qu': [1, 1, 1]}
# J = 6, u = 6 - 12 t.
ENERGY = {
    'name': 'energy', 'states': ['x', 'v'], 'inputs': ['u'], 'dynamics': {'x': 'v', 'v': 'u'},
    'running_cost': 'u**2/2', 'initial_state': {'x': 0, 'v': 0},
    'terminal_constraints': ['x - 1', 'v'], 'final_time': {'free': False, 'value': 1}}


def run_on_terminal(columns, *words, **variables):
    """Return status and output of `obc` on a pseudo-terminal."""
    master, slave = os.openpty()
    environment = {**os.environ, 'COLUMNS': str(columns), 'TERM': 'xterm', **variables}
    with subprocess.Popen([sys.executable, '-m', 'obc_ros.cli.obc', *words], stdin=slave,
                          stdout=slave, stderr=slave, env=environment) as process:
        os.close(slave)
        output = b''
        while True:
            try:
                read = os.read(master, 65536)
            except OSError:   # Linux: the other end is closed
                break
            if not read:
                break
            output += read
        status = process.wait(60)
    os.close(master)
    return status, output.decode()


def read_screen(output):
    """Return the lines that stay on a terminal: text after the last escape that erases."""
    left = output[max((each.end() for each in ESCAPE.finditer(output)
                       if each[2] in 'KAhl'), default=0):]
    return [line.rstrip() for line in ESCAPE.sub('', left).replace('\r', '').split('\n')]


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Enter a folder with a problem and a case."""
    monkeypatch.chdir(tmp_path)
    for each in (ENERGY, CHAINS):
        (tmp_path / f'{each["name"]}.yaml').write_text(yaml.safe_dump(each))
    return tmp_path


@pytest.mark.slow
def test_80_columns_have_a_table(files):
    status, output = run_on_terminal(80, 'solve', 'energy.yaml')
    lines = read_screen(output)
    assert status == 0
    assert max(map(len, lines)) <= 80
    assert lines[0].split() == [
        'problem', 'status', 'cost', 'certificate', 'optimum', 'method', 'time']
    assert lines[1].split()[:4] == ['energy', 'solved', '6', 'holds']
    assert '\x1b[32msolved' in output


@pytest.mark.slow
def test_40_columns_have_keys_and_values(files):
    status, output = run_on_terminal(40, 'solve', 'energy.yaml', 'energy.yaml')
    lines = read_screen(output)
    assert status == 0
    assert max(map(len, lines)) <= 40
    assert [line.split() for line in lines[:4]] == [
        ['problem', 'energy', '(energy.yaml)'], ['status', 'solved'], ['cost', '6'],
        ['certificate', 'holds']]
    assert lines.count('') >= 1   # between two problems
    assert sum(line.startswith('status') for line in lines) == 2


@pytest.mark.slow
@pytest.mark.parametrize('columns', [40, 80])
def test_a_gain_is_printed_whole_on_request(files, columns):
    status, output = run_on_terminal(columns, 'lqr', 'chains.yaml', '--full')
    lines = read_screen(output)
    gain = lines[lines.index('chains: K =') + 1:lines.index('chains: P =')]
    assert status == 0
    numbers = [word for line in gain for word in line.split()]
    root = '1.414213562'
    assert numbers == ['1', root, *'0000', '0', '0', '1', root, '0', '0', *'0000', '1', root]
    assert max(map(len, gain)) <= columns
    poles = lines[lines.index('chains: poles =') + 1:][:6]
    assert {pole.strip() for pole in poles} == {
        f'-0.7071067812{sign}0.7071067812j' for sign in '+-'}


@pytest.mark.slow
def test_a_cut_gain_names_the_option(files, capsys):
    assert main(['lqr', 'chains.yaml']) == 0
    output = capsys.readouterr().out
    assert '-0.7071-0.7071j' in output
    assert ' ...\n' in output
    assert output.endswith('--full prints what does not fit into the table\n')


@pytest.mark.slow
def test_a_pipe_has_neither_escapes_nor_progress(files):
    done = subprocess.run([sys.executable, '-m', 'obc_ros.cli.obc', 'solve', 'energy.yaml'],
                          capture_output=True, text=True, check=True)
    assert '\x1b' not in done.stdout
    assert done.stderr == ''
    assert [len(line) for line in done.stdout.splitlines()].count(0) == 0
    assert len(done.stdout.splitlines()) == 3


@pytest.mark.slow
@pytest.mark.parametrize('columns', [40, 80])
def test_no_color_leaves_the_colours_out(files, columns):
    status, output = run_on_terminal(columns, 'solve', 'energy.yaml', NO_COLOR='1')
    assert status == 0
    assert 'solved' in output
    codes = {code for found in ESCAPE.finditer(output) if found[2] == 'm'
             for code in found[1].split(';')}
    assert codes <= {'0', '1', ''}   # bold only


@pytest.mark.slow
@pytest.mark.parametrize(('columns', 'variables'), [
    (40, {'PYTHONIOENCODING': 'ascii'}), (80, {'PYTHONIOENCODING': 'ascii'}),
    (80, {'LC_ALL': 'C', 'PYTHONUTF8': '0', 'PYTHONCOERCECLOCALE': '0'}),
    (40, {'TERM': 'dumb'})], ids=str)
def test_a_terminal_without_unicode_is_enough(files, columns, variables):
    (files / 'ähnlich.yaml').write_text(yaml.safe_dump({**ENERGY, 'name': 'ähnlich'}))
    status, output = run_on_terminal(
        columns, 'solve', 'ähnlich.yaml', 'energy.yaml', '--trace', **variables)
    assert status == 0
    assert 'Traceback' not in output
    assert 'solved' in output
    if 'TERM' not in variables:
        assert output.isascii()


def test_an_error_has_no_empty_table_and_is_said_once(files, capsys):
    assert main(['solve', 'q.txt']) == 2
    output = capsys.readouterr()
    assert output.out == 'q: q.txt: cannot be read: No such file or directory\n'
    assert output.err == ''


@pytest.mark.slow
def test_the_reason_without_a_solution_is_said_once(files, capsys):
    (files / 'no.yaml').write_text(yaml.safe_dump({**ENERGY, 'input_bounds': {'u': [-1, 1]}}))
    assert main(['solve', 'no.yaml']) == 1
    output = capsys.readouterr()
    header, _, row, message, *more = output.out.splitlines()
    assert header.split() == ['problem', 'status', 'time']
    assert row.split()[:2] == ['energy', 'infeasible']
    assert message.startswith('energy: ')
    assert not more
    assert output.err == ''


@pytest.mark.parametrize('line, words', [
    (['solv', 'x'], "no 'solv' (did you mean 'solve'?)"),
    (['solve', 'x.yaml', '--tme-limit', '3'],
     "obc solve: error: unknown option '--tme-limit' (did you mean '--time-limit'?)"),
    (['lqr', 'x.yaml', '--ful'], None),   # an abbreviation is an option
    (['bench', '--peer', '--lists'], "unknown option '--lists' (did you mean '--list'?)"),
    (['solve', 'x.yaml', '--method', 'ricati'], "(did you mean 'riccati'?)"),
], ids=str)
def test_a_misspelt_word_has_a_suggestion(files, capsys, line, words):
    if words is None:
        assert main(line) == 2
        return
    with pytest.raises(SystemExit) as exit_:
        main(line)
    assert exit_.value.code == 2
    assert words in capsys.readouterr().err


def test_names_of_benchmarks_are_suggested(capsys):
    assert main(['bench', 'startp']) == 2
    assert "no benchmark 'startp' (did you mean 'startup'?)" in capsys.readouterr().err


def test_names_of_the_gallery_are_suggested(capsys):
    assert main(['gallery', 'excercise-2.7']) == 2
    assert "(did you mean 'exercise-2.7'?)" in capsys.readouterr().err


@pytest.mark.parametrize('value, text', [
    (9.6e-31, '0'), (-9.6e-31, '0'), (1e-8, '1e-08'), (6.283185307179586, '6.283185307'),
    (float('nan'), 'nan'), (float('-inf'), '-inf')])
def test_a_rounding_error_is_printed_as_zero(value, text):
    assert format_value(value) == text


@pytest.mark.parametrize('value, text', [
    (0.0, '0'), (9.6e-31, 'below 1e-09'), (1.23e-7, '1.2e-07'), (float('inf'), 'inf')])
def test_a_residual_below_all_tolerances_has_no_digits(value, text):
    assert format_residual(value) == text
