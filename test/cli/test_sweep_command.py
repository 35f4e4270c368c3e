# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `obc sweep`: table, files, exit status, interruption."""

import signal
import subprocess
import sys

from matplotlib import image
import numpy as np
from obc_ros.cli import obc
from obc_ros.sweep.journal import JOURNAL
import problems
import pytest
from support import wait_for

pytest.importorskip('xarray')

REST = str(problems.FOLDER / 'di_mintime_rest.yaml')


def run(*arguments):
    """Run `obc sweep` in this process; return its exit status."""
    return obc.main(['sweep', *map(str, arguments)])


@pytest.mark.slow
def test_the_table_and_the_exit_status(tmp_path, capsys):
    asked = [REST, '--over', 'final_time.upper=0.5,9', '--out', tmp_path / 'out', '--workers', 1]
    assert run(*asked) == 1   # the least time is 2
    told = capsys.readouterr().out
    assert 'solved' in told and 'final_time.upper = 0.5: infeasible' in told
    assert (tmp_path / 'out' / 'sweep.nc').exists()
    assert run(*asked) == 2
    assert '--resume goes on with it' in capsys.readouterr().err
    assert run(*asked, '--resume') == 1


@pytest.mark.slow
@pytest.mark.parametrize('asked', [
    ['--over', 'x0.x=-2:2:5'], ['--over', 'x0.x=-2:2:5', '--over', 'final_time.upper=0.5:9:4'],
    ['--sample', 'x0.x~normal(0,1)', '--count', '5'],
    ['--sample', 'x0.x~normal(0,1)', '--sample', 'x0.v~normal(0,1)', '--count', '5']])
def test_figures_of_axes_and_of_samples(asked, tmp_path, capsys):
    run(REST, *asked, '--out', tmp_path, '--plot', '--format', 'svg,png', '--workers', 1)
    assert 'value.svg, ' in capsys.readouterr().out
    for name in ('value.png', 'success.png'):
        pixels = image.imread(tmp_path / name)
        assert pixels.shape == (960, 1280, 4)
        assert len(np.unique(pixels.reshape(-1, 4), axis=0)) > 9
        assert (tmp_path / name).with_suffix('.svg').read_text().startswith('<?xml')


@pytest.mark.slow
def test_there_is_no_figure_of_three_axes(tmp_path, capsys):
    axes = ['--over', 'x0.x=1', '--over', 'x0.v=1', '--over', 'final_time.upper=9']
    assert run(REST, *axes, '--out', tmp_path, '--plot', '--workers', 1) == 0
    assert 'no figures' in capsys.readouterr().out


@pytest.mark.parametrize(('arguments', 'words'), [
    (['--over', 'x0.q=1'], "no number 'x0.q'"), (['--over', 'x0.x'], 'wanted KEY='),
    (['--sample', 'x0.x~norml(0,1)', '--count', '3'], "did you mean 'normal'?"),
    (['--sample', 'x0.x~normal(0,1)'], '--count'), ([], 'nothing to vary'),
    (['--over', 'x0.x=0:1:2000', '--over', 'x0.v=0:1:2000'], 'at most 1000000 are accepted'),
    (['--over', 'x0.x=1', '--resume'], 'no sweep to resume'),
    (['--over', 'x0.x=1', '--method', 'arks'], "did you mean 'arcs'?"),
    (['--over', 'x0.x=1', '--time-limit', 'nan'], 'time_limit nan')])
def test_a_bad_question_is_refused(arguments, words, tmp_path, capsys):
    assert run(REST, *arguments, '--out', tmp_path / 'out') == 2
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_file_of_several_problems_is_refused(tmp_path, capsys):
    (tmp_path / 'two.yaml').write_text('[{name: a}, {name: b}]')
    assert run(tmp_path / 'two.yaml', '--over', 'x0.x=1', '--out', tmp_path / 'out') == 2
    assert '2 entries, wanted one: a, b' in capsys.readouterr().err
    assert run(tmp_path / 'none.yaml', '--over', 'x0.x=1', '--out', tmp_path / 'out') == 2


@pytest.mark.slow
@pytest.mark.parametrize('how', [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_sweep_can_be_resumed(how, tmp_path):
    asked = [sys.executable, '-m', 'obc_ros.cli.obc', 'sweep', REST, '--over', 'x0.x=-2:2:24',
             '--over', 'x0.v=-2:2:24', '--workers', '1', '--out', str(tmp_path / 'out')]
    first = subprocess.Popen(asked, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    journal = tmp_path / 'out' / JOURNAL
    wait_for(lambda: journal.exists() and journal.read_bytes().count(b'\n') >= 2, 60.0)
    first.send_signal(how)
    _, told = first.communicate(timeout=30)
    done = journal.read_bytes().count(b'\n')
    assert done < 9, 'the sweep was over before it was interrupted'
    if how == signal.SIGINT:
        assert first.returncode == 1
        assert 'ended by SIGINT' in told and '--resume solves the others' in told
        assert (tmp_path / 'out' / 'sweep.nc').exists()
    second = subprocess.run([*asked, '--resume'], capture_output=True, text=True, timeout=120)
    assert second.returncode == 0, second.stderr
    assert 'solved  576     100.00%' in second.stdout
    assert journal.read_bytes().count(b'\n') == 9
