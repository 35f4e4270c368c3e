# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Sweeps: accuracy on a grid, throughput, neighbours against a random order, faults.

The least time of the double integrator on ``--grid`` x ``--grid`` starts is compared with its
closed form. The lane change is solved for ``--lane`` x ``--lane`` start positions and wheel
bases: by one and two workers, in the order of neighbours, in a random order and without any
neighbour. On a Dask cluster a worker and then the scheduler are killed, and the sweep is resumed.
``--part`` is the number of points that are measured more than once.
"""

import timing  # isort: skip - before numpy

from collections.abc import Sequence
from pathlib import Path
import socket
import subprocess
import sys
import tempfile
import time
from typing import Any

from _machine import memory, processor_time
import numpy as np
from obc_ros.api.sweep import sweep, SweepQuestion
from obc_ros.core.text.errors import ObcError
from obc_ros.sweep.axes import make_axes
from obc_ros.sweep.chunk_solver import solve_chunk, start_solver
from obc_ros.sweep.dataset import write_dataset
from obc_ros.sweep.problem_numbers import ProblemNumbers

STARTS = {
    'name': 'least_time', 'states': ['x', 'v'], 'inputs': ['u'],
    'dynamics': {'x': 'v', 'v': 'u'}, 'running_cost': 1, 'initial_state': {'x': 1, 'v': 0},
    'terminal_constraints': ['x', 'v'], 'input_bounds': {'u': [-1, 1]},
    'final_time': {'free': True, 'lower': 0.01, 'upper': 50}}
LANE = {   # the documented example of python-control (steering)
    'name': 'lane_change', 'states': ['x', 'y', 'theta'], 'inputs': ['v', 'phi'],
    'parameters': {'l': 3},
    'dynamics': {'x': 'v*cos(theta)', 'y': 'v*sin(theta)', 'theta': 'v*tan(phi)/l'},
    'running_cost': '(v-10)**2+phi**2', 'initial_state': {'x': 0, 'y': -2, 'theta': 0},
    'terminal_constraints': ['x-100', 'y-2', 'theta'],
    'input_bounds': {'v': [8, 12], 'phi': [-0.1, 0.1]},
    'final_time': {'free': False, 'value': 10}}
ACCURACY = 1e-8
ON_CURVE = 1e-15   # distance from the switching curve within which a start is on it by rounding
TWICE = 2.0        # times faster that neighbours make a point, at least


def least_time(x: Any, v: Any) -> tuple[Any, Any]:
    """Return the least time to the origin, and the distance from the switching curve."""
    x, v = (each.astype(np.longdouble) for each in (x, v))
    distance = x + v * np.abs(v) / 2
    side = np.where(distance == 0, np.sign(v), np.sign(distance))
    T = side * v + 2 * np.sqrt(np.maximum(side * x + v**2 / 2, 0))
    return np.maximum(T, STARTS['final_time']['lower']), np.abs(distance)


def compare_with_closed_form(number: int) -> None:
    """Sweep the starts of the double integrator, and check the least times."""
    begun = time.monotonic()
    found = sweep(STARTS, {'x0.x': f'-2:2:{number}', 'x0.v': f'-2:2:{number}'})
    took = time.monotonic() - begun
    x, v = np.meshgrid(found['x0.x'], found['x0.v'], indexing='ij')
    expected, distance = least_time(x, v)
    error = np.abs(found['T'].values - expected).astype(float)
    on_curve = (distance < ON_CURVE) & (distance > 0)
    print(f'\nleast time of {number} x {number} starts: {took:.0f} s, {error.size / took:.0f} a '
          f'second; {on_curve.sum()} starts are beside the switching curve by rounding, largest '
          f'error there {error[on_curve].max(initial=0.0):.1e}')
    timing.require('starts that are not solved', int((found['status'] != 0).sum()), 0)
    timing.require('largest error of T [s]', error[~on_curve].max(), ACCURACY)


class Orders:
    """Chunks of the lane change in several orders, solved by one solver process."""

    def __init__(self, number: int, points: int) -> None:
        numbers = ProblemNumbers(LANE)
        axes = make_axes(lane_axes(number))
        self.question = SweepQuestion(numbers, axes)
        tiles = self.question.divide()
        order = np.random.default_rng(1)
        chosen = order.permutation(len(tiles))[:max(1, points // len(tiles[0]))]
        self.near = [tiles[k] for k in chosen]
        points_there = order.permutation(np.concatenate(tiles))
        cuts = np.cumsum([len(tile) for tile in self.near])
        self.random = np.split(points_there[:cuts[-1]], cuts[:-1])
        self.single = [np.array([point]) for point in np.concatenate(self.near)[::5]]

    def measure(self, chunks: Sequence[Any]) -> tuple[float, float, float]:
        """Return seconds a point: of the processor of the solver, and of its keeper; and MiB."""
        pool = start_solver()
        try:
            while not pool.pids:
                time.sleep(0.05)
            [pid] = pool.pids
            before, keeper = processor_time(pid), time.process_time()
            for number, points in enumerate(chunks):
                solve_chunk(pool, self.question.make_chunk(number, points))
            count = sum(map(len, chunks))
            return ((processor_time(pid) - before) / count,
                    (time.process_time() - keeper) / count, memory(pid))
        finally:
            pool.close()


def lane_axes(number: int) -> dict[str, str]:
    """Return the axes of the lane change."""
    return {'x0.y': f'-3:-1:{number}', 'l': f'2:4:{number}'}


def compare_orders(number: int, points: int) -> None:
    """Measure the work of a point after neighbours, after random points, and alone."""
    orders = Orders(number, points)
    rows, times = [], {}
    for name, chunks in (('neighbours', orders.near), ('random', orders.random),
                         ('alone', orders.single)):
        solver, keeper, size = orders.measure(chunks)
        times[name] = solver
        rows.append((name, sum(map(len, chunks)), f'{1e3 * solver:.1f}', f'{1e3 * keeper:.2f}',
                     f'{size:.0f}', f'{solver / times["neighbours"]:.2f}'))
    timing.table('lane change, one solver process, by processor time',
                 ('order', 'points', 'solver [ms/point]', 'overhead [ms/point]', 'MiB',
                  'to neighbours'), rows)
    timing.require('time after neighbours, relative to no neighbours',
                   times['neighbours'] / times['alone'], 1.0 / TWICE)


def compare_workers(points: int) -> None:
    """Measure the throughput of one and of two workers."""
    side = max(2, int(points**0.5))
    rows = []
    for scheduler in ('none', ''):
        for workers in (1, 2):
            begun = time.monotonic()
            sweep(LANE, lane_axes(side), workers=workers, scheduler=scheduler)
            took = time.monotonic() - begun
            rows.append((workers, 'Dask' if not scheduler else 'processes', side**2,
                         f'{took:.1f}', f'{side**2 / took:.1f}'))
    timing.table('lane change, wall time, start included',
                 ('workers', 'through', 'points', 's', 'points/s'), rows)


class Cluster:
    """A scheduler and two workers of Dask, each a process."""

    def __init__(self) -> None:
        with socket.socket() as probe:
            probe.bind(('127.0.0.1', 0))
            self.address = f'tcp://127.0.0.1:{probe.getsockname()[1]}'
        self.processes = [self._start('scheduler', '--host', self.address, '--no-dashboard',
                                      '--no-show')]
        time.sleep(3.0)
        for _ in range(2):
            self.add_worker()

    def add_worker(self) -> None:
        """Start a worker."""
        self.processes.append(self._start('worker', self.address, '--nthreads', '1',
                                          '--no-nanny', '--no-dashboard'))

    def end(self) -> None:
        """Kill all processes."""
        for process in reversed(self.processes):
            process.kill()
            process.wait()

    def _start(self, kind: str, *arguments: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen([sys.executable, '-P', '-m', f'distributed.cli.dask_{kind}',
                                 *arguments],
                                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def survive_faults(points: int) -> None:
    """Kill workers, then the scheduler, resume, and compare with an undisturbed sweep."""
    axes = lane_axes(max(4, int(points**0.5)))
    expected = sweep(LANE, axes, chunk=16, scheduler='none')
    total = int(expected['status'].size)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / 'sweep'
        done: list[int] = []

        def disturb(progress: Any) -> None:
            done.append(progress.done)
            if progress.done > total // 4 and len(cluster.processes) == 3:
                cluster.processes[-1].kill()
                cluster.add_worker()
            if progress.done > total // 2:
                cluster.processes[0].kill()

        cluster = Cluster()
        try:
            sweep(LANE, axes, chunk=16, scheduler=cluster.address, out=out, report=disturb)
            raise SystemExit('the sweep was over before the scheduler was killed')
        except ObcError as error:
            print(f'\nafter a worker and the scheduler were killed: {error}')
        finally:
            cluster.end()
        resumed: list[int] = []
        cluster = Cluster()
        try:
            found = sweep(LANE, axes, chunk=16, scheduler=cluster.address, out=out, resume=True,
                          report=lambda progress: resumed.append(progress.done))
        finally:
            cluster.end()
        print(f'{done[-1]} of {total} points were finished, {resumed[0]} were found again')
        timing.require('finished points that were lost', done[-1] - resumed[0], 0)
        files = [Path(folder) / name for name in ('a.nc', 'b.nc')]
        for dataset, path in zip((expected, found), files, strict=True):
            write_dataset(dataset.drop_vars('time'), path)
        timing.require('bytes that differ from the undisturbed sweep',
                       int(files[0].read_bytes() != files[1].read_bytes()), 0)


def main() -> int:
    """Measure and print; return the exit status."""
    args = timing.arguments(__doc__ or '', grid=201, lane=100, part=512)
    if timing.peer('xarray') is None or timing.peer('distributed') is None:
        return 0
    compare_orders(args.lane, args.part)
    compare_workers(args.part)
    survive_faults(args.part)
    compare_with_closed_form(args.grid)
    begun = time.monotonic()
    found = sweep(LANE, lane_axes(args.lane))
    print(f'\nlane change on {args.lane} x {args.lane}: {time.monotonic() - begun:.0f} s, '
          f'{int((found["status"] == 0).sum())} solved')
    return timing.finish()


if __name__ == '__main__':
    sys.exit(main())
