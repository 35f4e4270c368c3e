# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A sweep over two hosts: the Dask scheduler and the command on one, a worker on the other.

The hosts are network namespaces of this machine, connected by a bridge. The answers are compared
with those of one process; the bytes on the network are counted.
"""

import timing  # isort: skip - before numpy

import json
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from _hosts import enter, Network, run
from obc_ros.sweep.dataset import read_dataset

STATEMENT = """
name: least_time
states: [x, v]
inputs: [u]
dynamics: {x: v, v: u}
running_cost: 1
initial_state: {x: 1, v: 0}
terminal_constraints: [x, v]
input_bounds: {u: [-1, 1]}
final_time: {free: true, lower: 0.01, upper: 50}
"""
ADDRESS = 'tcp://10.0.0.1:8786'
DASK = (sys.executable, '-P', '-m')


def count_bytes(host: str) -> int:
    """Return the bytes that a host has sent and received."""
    [link] = json.loads(run('ip', '-n', host, '-s', '-j', 'link', 'show', 'dev', 'veth1'))
    return int(sum(link['stats64'][way]['bytes'] for way in ('rx', 'tx')))


def main() -> int:
    """Measure and print; return the exit status."""
    if missing := enter():
        print(f'  skipped: {missing}')
        return 0
    args = timing.arguments(__doc__ or '', grid=24)
    if timing.peer('distributed') is None:
        return 0
    network = Network(2, wire=False)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'least_time.yaml'
        file.write_text(STATEMENT, encoding='utf-8')
        common = [sys.executable, '-P', '-m', 'obc_ros.cli.obc', 'sweep', str(file),
                  '--over', f'x0.x=-2:2:{args.grid}', '--over', f'x0.v=-2:2:{args.grid}']
        started = [network.start('host1', [
            *DASK, 'distributed.cli.dask_scheduler', '--host', ADDRESS, '--no-dashboard',
            '--no-show'])]
        time.sleep(5.0)
        started.append(network.start('host2', [
            *DASK, 'distributed.cli.dask_worker', ADDRESS, '--host', '10.0.0.2', '--nthreads',
            '1', '--no-nanny', '--no-dashboard']))
        try:
            before, begun = count_bytes('host1'), time.monotonic()
            remote = ['ip', 'netns', 'exec', 'host1', *common]
            run(*remote, '--scheduler', ADDRESS, '--out', f'{folder}/there')
            took, sent = time.monotonic() - begun, count_bytes('host1') - before
        finally:
            for process in reversed(started):
                process.kill()
                process.wait()
        subprocess.run([*common, '--scheduler', 'none', '--workers', '1', '--out',
                        f'{folder}/here'], check=True, stdout=subprocess.DEVNULL)
        there, here = (read_dataset(Path(folder) / name / 'sweep.nc').drop_vars('time')
                       for name in ('there', 'here'))
    points = args.grid**2
    print(f'\n{points} points in {took:.1f} s, start included; {sent / points:.0f} bytes a point '
          f'on the network, {sent / points * 64 / 1024:.0f} KiB a chunk')
    timing.require('answers that differ from those of one process',
                   int(not there.identical(here)), 0)
    network.close()
    return timing.finish()


if __name__ == '__main__':
    sys.exit(main())
