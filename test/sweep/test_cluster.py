# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sweeps on a Dask cluster: the same answers, and nothing lost when workers or scheduler end."""

from contextlib import contextmanager

from dask_cluster import Cluster, free_port
from obc_ros.api.sweep import sweep
from obc_ros.core.text.errors import ObcError, StatementError
from obc_ros.sweep.cluster.connection import (
    check_address,
    check_versions,
    connect,
    explain_exposure,
    tell_version,
)
from obc_ros.sweep.dataset import write_dataset
import problems
import pytest

pytest.importorskip('distributed')

REST = problems.FOLDER / 'di_mintime_rest.yaml'
OVER = {'x0.x': '-1:1:12', 'x0.v': '-1:1:12'}


@contextmanager
def running(workers):
    """Yield a cluster."""
    cluster = Cluster()
    try:
        for _ in range(workers):
            cluster.add_worker()
        yield cluster
    finally:
        for process in reversed(cluster.processes):
            process.kill()
            process.wait()


def content(dataset, folder):
    """Return the bytes of a dataset without the times that solving took."""
    write_dataset(dataset.drop_vars('time'), folder / 'part.nc')
    return (folder / 'part.nc').read_bytes()


@pytest.fixture(scope='module')
def expected():
    """Return the dataset of one process without Dask."""
    return sweep(REST, OVER, chunk=12, workers=1, scheduler='none')


@pytest.mark.slow
def test_a_cluster_in_this_process_gives_the_same_answers(expected, tmp_path):
    found = sweep(REST, OVER, chunk=12, workers=2)
    assert content(found, tmp_path) == content(expected, tmp_path)


@pytest.mark.slow
def test_a_worker_that_is_killed_costs_nothing(expected, tmp_path):
    with running(2) as cluster:
        victim = cluster.processes[-1]
        found = sweep(REST, OVER, chunk=12, scheduler=cluster.address, out=tmp_path / 'sweep',
                      report=lambda progress: progress.done > 12 and victim.kill())
        assert victim.wait() != 0
    assert content(found, tmp_path) == content(expected, tmp_path)


@pytest.mark.slow
def test_a_sweep_is_resumed_after_the_scheduler_was_killed(expected, tmp_path):
    out, reports = tmp_path / 'sweep', []

    def kill(progress):
        reports.append(progress.done)
        if progress.done >= 24:
            cluster.scheduler.kill()

    with running(1) as cluster, pytest.raises(ObcError, match='scheduler of .* is gone'):
        sweep(REST, OVER, chunk=12, scheduler=cluster.address, out=out, report=kill)
    assert 24 <= reports[-1] < 144
    resumed = []
    with running(1) as cluster:
        found = sweep(REST, OVER, chunk=12, scheduler=cluster.address, out=out, resume=True,
                      report=resumed.append)
    assert resumed[0].earlier == reports[-1]
    assert content(found, tmp_path) == content(expected, tmp_path)


@pytest.mark.parametrize('address', [
    'host:8786', 'tcp://host', 'tcp://host:0', 'tcp://host:99999', 'http://host:8786', 'tcp://'])
def test_a_malformed_address_is_refused(address):
    with pytest.raises(StatementError, match='tcp://host:8786'):
        check_address(address)


@pytest.mark.slow
@pytest.mark.parametrize(('address', 'is_open'), [
    ('tcp://127.0.0.1:8786', False), ('tcp://localhost:8786', False), ('tcp://[::1]:8786', False),
    ('tls://host:8786', False), ('tcp://host:8786', True), ('tcp://10.0.0.2:8786', True),
    ('ws://localhost.example:8786', True)])
def test_an_open_connection_to_another_machine_is_said(address, is_open):
    assert ('use tls://' in explain_exposure(address)) is is_open


def test_an_address_without_a_scheduler_is_an_error_in_words():
    with pytest.raises(ObcError, match='no scheduler answers at tcp://127.0.0.1'):
        connect(f'tcp://127.0.0.1:{free_port()}')


def test_workers_of_another_version_are_refused():
    check_versions({'a': tell_version()})
    for other in ('0.0', ModuleNotFoundError("No module named 'obc_ros'")):
        with pytest.raises(ObcError, match='worker b has obc_ros'):
            check_versions({'a': tell_version(), 'b': other})
