# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sweeps of whole problems: closed forms, equal bytes, resumption."""

import json
import os
import signal

import numpy as np
import obc_ros as obc
from obc_ros.api.sweep import DATASET, sweep
from obc_ros.core.text.errors import StatementError
from obc_ros.sweep.dataset import read_dataset, STATUSES
from obc_ros.sweep.journal import JOURNAL
import problems
import pytest

pytest.importorskip('xarray')
pytestmark = pytest.mark.slow

REST = problems.FOLDER / 'di_mintime_rest.yaml'
SCALAR = {   # x(T)^2 = (x0 / (1 + T))^2 and J = x0^2 / (1 + T), by the Riccati equation p' = p^2
    'name': 'scalar', 'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u'},
    'units': {'x': 'm'}, 'running_cost': 'u**2', 'terminal_cost': 'x**2',
    'initial_state': {'x': 1}, 'final_time': {'free': False, 'value': 1}}


def least_time(x, v):
    """Return the least time to the origin (Example 2.3) and the input at t = 0."""
    side = np.sign(x + v * np.abs(v) / 2)
    side = np.where(side == 0, np.sign(v), side)
    return side * v + 2 * np.sqrt(np.maximum(side * x + v**2 / 2, 0.0)), -side


def bytes_without_times(dataset, path):
    """Return the bytes of the file of a dataset, but for the times that solving took."""
    from obc_ros.sweep.dataset import write_dataset
    write_dataset(dataset.drop_vars('time'), path)
    return path.read_bytes()


def test_least_times_agree_with_the_closed_form():
    found = sweep(REST, {'x0.x': '-2:2:7', 'x0.v': [-1.5, -0.5, 0.25, 1]}, workers=1)
    assert (found.sizes['x0.x'], found.sizes['x0.v']) == (7, 4)
    x, v = np.meshgrid(found['x0.x'], found['x0.v'], indexing='ij')
    T, u = least_time(x, v)
    assert (found['status'] == STATUSES.index('solved')).all()
    np.testing.assert_allclose(found['T'], T, atol=1e-8)
    np.testing.assert_allclose(found['J'], T, atol=1e-8)
    inner = found['switches'].values == 1
    assert inner.any()
    np.testing.assert_allclose(found['inputs'].sel(input='u').values[inner], u[inner])
    # H = 1 + lam_x v + lam_v u = 0 at t = 0
    lam_x, lam_v = (found['costates'].sel(state=name).values for name in 'xv')
    np.testing.assert_allclose((1 + lam_x * v + lam_v * u)[inner], 0.0, atol=1e-8)
    assert (found['worst_residual'] <= 1).all() and (found['optimum'] == 2).all()


def test_the_value_of_a_linear_quadratic_problem_over_samples():
    found = sweep(SCALAR, {'T': [0.5, 1, 3]}, sample={'x0.x': 'normal(0, 2)'}, count=20, seed=3,
                  workers=1)
    assert (found.sizes['final_time.value'], found.sizes['sample']) == (3, 20)
    x0, T = found['x0.x'].values, np.array([[0.5], [1.0], [3.0]])
    np.testing.assert_allclose(found['J'], x0**2 / (1 + T), rtol=1e-8)
    np.testing.assert_allclose(found['costates'].sel(state='x'), 2 * x0 / (1 + T), rtol=1e-8)
    assert found['x0.x'].attrs['units'] == 'm' and found['switches'].max() == 0


@pytest.mark.parametrize(('file', 'over'), [
    ('di_mintime_rest', {'x0.x': '-1:1:6', 'x0.v': '-1:1:6'}),
    ('lane_change', {'x0.y': '-2.5:-1.5:4', 'l': '2:4:3'})])
def test_answers_do_not_depend_on_the_number_of_workers(file, over, tmp_path):
    path = problems.FOLDER / f'{file}.yaml'
    found = [sweep(path, over, workers=workers, chunk=6) for workers in (1, 3)]
    first, second = (bytes_without_times(each, tmp_path / 'part.nc') for each in found)
    assert first == second and (found[0]['status'] == 0).all()


def test_a_resumed_sweep_solves_the_rest_only(tmp_path):
    over, out = {'x0.x': '-1:1:6', 'x0.v': '-1:1:6'}, tmp_path / 'sweep'
    whole = sweep(REST, over, out=out, chunk=9, workers=1)
    lines = (out / JOURNAL).read_text().splitlines(keepends=True)
    assert len(lines) == 4
    (out / JOURNAL).write_text(''.join(lines[:2]) + lines[2][:50])   # a process that was killed
    reports = []
    again = sweep(REST, over, out=out, chunk=9, workers=2, resume=True, report=reports.append)
    assert reports[0].done == reports[0].earlier == 18 and reports[-1].done == 36
    assert (out / JOURNAL).read_text().splitlines(keepends=True)[:2] == lines[:2]
    first, second = (bytes_without_times(each, tmp_path / 'part.nc') for each in (whole, again))
    assert first == second
    assert read_dataset(out / DATASET).identical(again)
    with pytest.raises(StatementError, match='axes changed'):
        sweep(REST, {**over, 'x0.v': '-1:1:7'}, out=out, chunk=9, resume=True)


def test_solver_processes_that_are_killed_cost_nothing(tmp_path):
    over = {'x0.x': '-1:1:6', 'x0.v': '-1:1:6'}

    kills = []

    def kill(progress):
        kills.append(progress.done)
        for process in children() if len(kills) in (2, 3) else ():
            os.kill(process, signal.SIGKILL)

    found = [sweep(REST, over, chunk=6, workers=2, **more) for more in ({}, {'report': kill})]
    first, second = (bytes_without_times(each, tmp_path / 'part.nc') for each in found)
    assert first == second


def children():
    """Return the solver processes of this process."""
    found = []
    for entry in filter(str.isdigit, os.listdir('/proc')):
        try:
            with open(f'/proc/{entry}/cmdline', 'rb') as file:
                words = file.read().split(b'\0')
        except OSError:
            continue
        if b'obc_ros.sweep.point_requests' in words and str(os.getpid()).encode() in words:
            found.append(int(entry))
    return found


def test_a_point_without_a_valid_problem_is_a_result():
    statement = {**problems.read('di_mintime_rest'), 'parameters': {'m': 1}, 'name': 'inverse',
                 'dynamics': {'x': 'v', 'v': 'u/m'}}
    found = sweep(statement, {'m': [0, 1]}, workers=1)
    assert [STATUSES[code] for code in found['status'].values] == ['malformed', 'solved']
    assert np.isnan(found['J'][0]) and found['J'][1] == pytest.approx(2.0)


@pytest.mark.parametrize(('over', 'more', 'words'), [
    ({'x0.q': [1]}, {}, 'did you mean'), ({}, {}, 'nothing to vary'),
    ({'x0.x': [1]}, {'chunk': 0}, 'chunk 0'), ({'x0.x': [1]}, {'seed': -1}, 'seed -1'),
    ({'x0.x': [1]}, {'time_limit': float('nan')}, 'time_limit nan'),
    ({'x0.x': [1]}, {'method': 'ars'}, 'ars'), ({'x0.x': [1]}, {'options': ['a=1']}, 'a'),
    ({'x0.x': [1]}, {'workers': -1}, 'workers -1'), ({'x0.x': [1]}, {'resume': True}, 'resume')])
def test_a_bad_question_is_refused_before_anything_is_written(over, more, words, tmp_path):
    out = {} if more.get('resume') else {'out': tmp_path / 'sweep'}
    with pytest.raises(StatementError) as caught:
        sweep(REST, over, **out, **more)
    assert words in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_problem_of_the_library_can_be_swept():
    problem = obc.Problem(**SCALAR)
    found = obc.sweep(problem, {'x0.x': np.array([1.0, 2.0])}, workers=1)
    np.testing.assert_allclose(found['J'], [0.5, 2.0], rtol=1e-8)


def test_the_dataset_keeps_the_question(tmp_path):
    found = sweep(SCALAR, {'x0.x': [1, 2]}, out=tmp_path / 'sweep', workers=1)
    kept = read_dataset(tmp_path / 'sweep' / DATASET)
    assert json.loads(kept.attrs['statement']) == SCALAR
    assert kept['T'].attrs['units'] == 's' and 'solved' in kept['status'].attrs['flag_meanings']
    assert found.identical(kept)
