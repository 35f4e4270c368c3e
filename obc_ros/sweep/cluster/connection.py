# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The connection to a Dask cluster: one in this process, or one that runs already.

Dask executes what a client sends, and a client unpickles what workers answer: who can connect to
a scheduler can run programs on its workers and on its clients. The address is therefore the
operator's alone; ``tls://`` takes the certificates of Dask's own configuration. A local cluster
can be reached from this process only; its workers are threads, each with a solver process.
"""

from collections.abc import Mapping
from importlib import metadata
from ipaddress import ip_address
import logging
from typing import Any

from obc_ros.core.text.errors import ObcError, quote, StatementError

CONNECT_TIMEOUT = 10.0   # [s]
LOOPBACK = '127.0.0.1:0'   # for Dask's pages about its state, which cannot be switched off
SCHEMES = ('tcp://', 'tls://', 'ws://', 'wss://', 'ucx://')
ENCRYPTED = ('tls://', 'wss://')


def has_dask() -> bool:
    """Return whether Dask's scheduler is installed."""
    try:
        metadata.version('distributed')
    except metadata.PackageNotFoundError:
        return False
    return True


def check_address(address: str) -> None:
    """Raise StatementError unless an address has a form such as ``tcp://host:8786``."""
    scheme = next((each for each in SCHEMES if address.startswith(each)), '')
    port = address.rpartition(':')[2]
    if not scheme or not port.isdigit() or not 0 < int(port) < 2**16:
        raise StatementError(f"scheduler '{quote(address)}': wanted an address such as "
                             'tcp://host:8786')


def explain_exposure(address: str) -> str:
    """Return who could run programs here through a scheduler; empty: nobody else."""
    host = address.partition('://')[2].rpartition(':')[0].strip('[]')
    try:
        is_here = host == 'localhost' or ip_address(host).is_loopback
    except ValueError:   # a name
        is_here = False
    if is_here or address.startswith(ENCRYPTED):
        return ''
    return (f'the connection to the cluster {quote(address)} is not encrypted: whoever can reach '
            'its scheduler or its network can run programs on this machine; use tls://')


def connect(address: str, patience: float = CONNECT_TIMEOUT) -> Any:
    """
    Return a client of a running cluster.

    :param patience: time in which it must answer [s].
    :raises StatementError: if the address has another form.
    :raises ObcError: if Dask is not installed, there is no scheduler, or its workers have another
        version.
    """
    check_address(address)
    distributed = _import_distributed()
    logging.getLogger('distributed.client').setLevel(logging.CRITICAL)   # errors say the same
    try:
        client = distributed.Client(address, timeout=patience, set_as_default=False)
    except (OSError, TimeoutError, ValueError, TypeError) as error:   # TypeError: no certificates
        raise ObcError(f'no scheduler answers at {quote(address)}: '
                       f'{quote(" ".join(str(error).split()), 200)}') from None
    try:
        check_versions(client.run(tell_version, on_error='return'))
    except BaseException:
        client.close()
        raise
    return client


def start_local(workers: int) -> Any:
    """Return a client of a cluster in this process; closing it ends the cluster."""
    distributed = _import_distributed()
    cluster = distributed.LocalCluster(
        n_workers=workers, threads_per_worker=1, processes=False, dashboard_address=LOOPBACK,
        worker_dashboard_address=LOOPBACK, scheduler_kwargs={'dashboard': False},
        memory_limit=None, silence_logs=logging.ERROR)
    return distributed.Client(cluster, set_as_default=False)


def count_threads(client: Any) -> int | None:
    """Return the number of threads of all workers; None if the scheduler does not answer."""
    if client.status != 'running':
        return None
    try:
        threads: int = sum(client.nthreads().values())
    except (OSError, TimeoutError):
        return None
    return threads


def _import_distributed() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise ObcError(f'a cluster needs Dask: pip install distributed ({error})') from None
    return distributed


def tell_version() -> str:
    """Return the version of obc_ros, which answers depend on."""
    return metadata.version('obc-ros')


def check_versions(told: Mapping[str, object]) -> None:
    """Raise ObcError unless all workers, by address, have told this version of obc_ros."""
    here = tell_version()
    for worker, version in told.items():
        if version != here:
            raise ObcError(f'the worker {worker} has obc_ros {quote(str(version), 200)}; '
                           f'wanted {here}, as here')
