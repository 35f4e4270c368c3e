# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A Dask cluster for tests, whose processes they can kill."""

import socket
import subprocess
import sys
import time


def free_port():
    """Return a port that nobody uses now."""
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        return probe.getsockname()[1]


class Cluster:
    """A scheduler and workers, each a process."""

    def __init__(self, address=''):
        self.address = address or f'tcp://127.0.0.1:{free_port()}'
        self.processes = []
        self.scheduler = self.start(
            'scheduler', '--host', self.address, '--no-dashboard', '--no-show')
        end = time.monotonic() + 60.0
        host, port = self.address.removeprefix('tcp://').split(':')
        while True:
            try:
                socket.create_connection((host, int(port)), timeout=1.0).close()
                return
            except OSError:
                assert time.monotonic() < end and self.scheduler.poll() is None
                time.sleep(0.1)

    def start(self, kind, *arguments):
        """Start a process of Dask and return it."""
        self.processes.append(subprocess.Popen(
            [sys.executable, '-P', '-m', f'distributed.cli.dask_{kind}', *arguments],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))
        return self.processes[-1]

    def add_worker(self):
        """Start a worker, whose process has no nanny that would start it again."""
        return self.start('worker', self.address, '--nthreads', '1', '--no-nanny',
                          '--no-dashboard', '--death-timeout', '60')
