# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The pool responds to every request within its time limit, also when workers fail."""

from contextlib import contextmanager
import errno
import math
import os
from pathlib import Path
import signal
import subprocess
import sys
from threading import Event
import time

from hypothesis import given, settings, strategies
import numpy as np
from obc_ros.api.search_tree import SearchTree
from obc_ros.core.text.errors import ObcError
from obc_ros.workers import pool as workers
from obc_ros.workers.pool import Job, Pool, RequestOutcome
from obc_ros.workers.responses import unpack_solution
from obc_ros.workers.wire import pack, Packet, unpack
import problems
import pytest
from support import alive, wait_for

DEADLINE = 20.0  # [s] reached only by a failing test
SLACK = 0.2      # [s] the documented tolerance of time limits and cancelling


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    """Put the folder of stand_in_worker on the path of the workers."""
    monkeypatch.setenv('PYTHONPATH', str(Path(__file__).parents[1]))


@contextmanager
def running(size=1, module='stand_in_worker', **options):
    """Yield a pool whose workers have all started; check that it leaves none of them."""
    pool = Pool(module, size, **options)
    try:
        wait_for(lambda: len(pool.pids) == size)
        yield pool
        pids = pool.pids
    finally:
        pool.close()
    assert not any(map(alive, pids))


class Submitted:
    """A submitted request: its response, its progress, and their times."""

    def __init__(self, pool, kind, time_limit=DEADLINE, affinity='', arrays=None, **plain):
        self.answers, self.progress = [], []
        self.finished = Event()
        self.pool = pool
        self.job = Job(
            kind=kind, request=Packet(plain, arrays or {}), time_limit=time_limit,
            done=self.done, progress=lambda *args: self.progress.append(args), affinity=affinity)
        self.start = time.monotonic()
        pool.submit(self.job)

    def done(self, answer):
        """Record the response and its time."""
        self.end = time.monotonic()
        self.answers.append(answer)
        self.finished.set()

    def answer(self):
        """Wait for the response, and check that there is only one."""
        assert self.finished.wait(DEADLINE)
        assert len(self.answers) == 1
        return self.answers[0]

    def response_time(self, clock, limit=0.0):
        """Return the time [s] from `limit` seconds after the submission to the response."""
        self.answer()
        return clock.between(self.start + limit, self.end)

    def wait_until_started(self):
        """Wait until a worker processes the request."""
        wait_for(lambda: self.progress)
        return self


def ask(pool, kind, **options):
    """Submit a request and return its response."""
    return Submitted(pool, kind, **options).answer()


json_values = strategies.recursive(
    strategies.none() | strategies.booleans() | strategies.integers(-2**63, 2**63)
    | strategies.floats(allow_nan=False) | strategies.text(),
    lambda inner: strategies.lists(inner) | strategies.dictionaries(strategies.text(), inner),
    max_leaves=10)


def test_windows_has_no_workers(monkeypatch):
    monkeypatch.setattr(sys, 'platform', 'win32')
    with pytest.raises(ObcError) as raised:
        Pool('stand_in_worker', 1)
    assert str(raised.value).startswith('worker processes need Linux or macOS: on Windows, use')


@pytest.mark.slow
@settings(deadline=None, max_examples=25)
@given(strategies.dictionaries(strategies.text(), json_values),
       strategies.lists(strategies.lists(strategies.integers(0, 4), max_size=3)))
def test_packets_are_unchanged_by_pack_and_unpack(plain, shapes):
    arrays = {str(k): np.random.default_rng(k).normal(size=shape)
              for k, shape in enumerate(shapes)}
    packet = unpack(pack(Packet(plain, arrays)))
    assert packet.plain == plain
    assert list(packet.arrays) == list(arrays)
    for name, array in arrays.items():
        assert packet.arrays[name].shape == array.shape
        assert np.array_equal(packet.arrays[name], array)


def test_packets_keep_nan_and_infinity():
    packet = unpack(pack(Packet({'cost': math.inf}, {'x': np.array([np.nan, -np.inf, -0.0])})))
    assert packet.plain == {'cost': math.inf}
    assert packet.arrays['x'].tobytes() == np.array([np.nan, -np.inf, -0.0]).tobytes()


@pytest.mark.slow
def test_large_and_small_responses_arrive():
    with running() as pool:
        x = np.arange(3e6).reshape(1000, 3000)
        answer = ask(pool, 'echo', arrays={'x': x}, name='ä\0"')
        assert answer.outcome is RequestOutcome.ANSWERED
        assert answer.packet.plain['name'] == 'ä\0"'
        assert np.array_equal(answer.packet.arrays['x'], x)
        assert [ask(pool, 'echo', name=k).packet.plain['name'] for k in range(50)] == [*range(50)]
        assert pool.replaced == 0


@pytest.mark.slow
def test_affinity_selects_the_idle_worker_that_last_had_it():
    with running(2, affinities=2) as pool:
        homes = {name: ask(pool, 'echo', affinity=name).packet.plain['pid'] for name in 'abcd'}
        assert len(set(homes.values())) == 2
        for name in 'dabcabdc':
            assert ask(pool, 'echo', affinity=name).packet.plain['pid'] == homes[name]
        home = next(name for name in 'abcd' if homes[name] == homes['a'])
        busy = Submitted(pool, 'iterate', affinity=home).wait_until_started()
        assert ask(pool, 'echo', affinity=home).packet.plain['pid'] != homes['a']
        pool.cancel(busy.job)


@pytest.mark.slow
@pytest.mark.parametrize('kind, stopped', [('iterate', RequestOutcome.ANSWERED),
                                           ('hang', RequestOutcome.TIMED_OUT)])
def test_the_time_limit_is_kept(clock, kind, stopped):
    with running() as pool:
        sent = Submitted(pool, kind, time_limit=0.4)
        assert sent.answer().outcome is stopped
        assert sent.end - sent.start > 0.4 - SLACK
        assert sent.response_time(clock, 0.4) < SLACK
        assert ask(pool, 'echo').outcome is RequestOutcome.ANSWERED
        assert pool.replaced == (kind == 'hang')


@pytest.mark.slow
@pytest.mark.parametrize('kind, stopped', [('iterate', RequestOutcome.ANSWERED),
                                           ('hang', RequestOutcome.CANCELLED)])
def test_cancel_stops_a_request(clock, kind, stopped):
    with running() as pool:
        sent = Submitted(pool, kind).wait_until_started()
        start = time.monotonic()
        pool.cancel(sent.job)
        answer = sent.answer()
        assert clock.between(start, sent.end) < SLACK
        assert answer.outcome is stopped
        assert answer.packet.plain.get('stopped', True) is True
        assert ask(pool, 'echo').outcome is RequestOutcome.ANSWERED


@pytest.mark.slow
@pytest.mark.parametrize('kind, words', [
    ('fail', 'ZeroDivisionError: a mistake'),
    ('crash', 'SIGABRT'),
    ('eat', 'memory limit of a worker, 0.5 GiB'),
])
def test_a_worker_that_dies_is_replaced_and_loses_one_request(kind, words, capfd):
    with running(memory=1 << 29) as pool:
        [before] = pool.pids
        answer = ask(pool, kind)
        assert answer.outcome is RequestOutcome.DIED
        assert words in answer.message
        if kind == 'eat':
            assert 'state a smaller problem' in answer.message
            assert 'Traceback' not in capfd.readouterr().err
        after = ask(pool, 'echo').packet.plain['pid']
        assert after != before
        assert not alive(before)
        assert pool.replaced == 1


@pytest.mark.slow
def test_a_killed_worker_loses_only_its_own_request():
    with running(2) as pool:
        one = Submitted(pool, 'pid').wait_until_started()
        other = Submitted(pool, 'iterate', time_limit=1.5).wait_until_started()
        waiting = Submitted(pool, 'echo')
        os.kill(int(one.progress[0][0]), signal.SIGKILL)
        assert 'SIGKILL' in one.answer().message
        assert one.answer().outcome is RequestOutcome.DIED
        assert waiting.answer().outcome is RequestOutcome.ANSWERED
        assert other.answer().outcome is RequestOutcome.ANSWERED


@pytest.mark.slow
@pytest.mark.parametrize('kind, outcome',
                         [('crash', RequestOutcome.DIED), ('hang', RequestOutcome.TIMED_OUT)])
def test_a_lost_worker_leaves_its_last_kept_result(kind, outcome):
    with running() as pool:
        x = np.arange(6.0).reshape(2, 3)
        answer = ask(pool, kind, time_limit=1.0, keep=['first', 'last'], arrays={'x': x})
        assert answer.outcome is outcome
        assert answer.packet.plain == {'name': 'last'}
        assert np.array_equal(answer.packet.arrays['x'], x)
        assert ask(pool, kind, time_limit=1.0).packet.plain == {}
        assert ask(pool, 'echo', keep=['path'], name='answer').packet.plain['name'] == 'answer'


@pytest.mark.slow
def test_a_worker_killed_while_solving_leaves_its_path():
    statement = problems.read('vanderpol_bounded')
    with running() as pool:
        sent = Submitted(pool, 'solve', time_limit=60.0, statement=statement, method='auto',
                         cache_size=1)
        wait_for(lambda: sent.progress and sent.progress[-1][0] == 'kept')
        [pid] = pool.pids
        os.kill(pid, signal.SIGKILL)
        answer = sent.answer()
        assert answer.outcome is RequestOutcome.DIED
        assert 'SIGKILL' in answer.message
        found, path = answer.packet.plain, answer.packet.arrays
        assert found['status'] == 'not_converged'
        assert f'cost {found["objective"]:.8g}, not certified because' in found['message']
        problem = problems.build(statement)
        assert path['x'].shape == (len(path['t']), problem.n)
        assert path['x'][0] == pytest.approx(problem.x0)
        residuals, tolerances = (found['certificate'][key] for key in ('residuals', 'tolerances'))
        assert any(residuals[key] > tolerances[key] for key in tolerances)
        assert residuals['dynamics'] <= tolerances['dynamics']
        assert 'coarse mesh' in [each['method'] for each in found['attempts']]
        assert 'without a search' not in str(SearchTree(unpack_solution(answer.packet).attempts))
        assert ask(pool, 'echo').outcome is RequestOutcome.ANSWERED


@pytest.mark.slow
def test_a_killed_idle_worker_loses_no_request():
    with running() as pool:
        for _ in range(3):
            [pid] = wait_for(lambda: pool.pids)
            os.kill(pid, signal.SIGKILL)
            wait_for(lambda: not alive(pid))  # noqa: B023 - called at once
            assert ask(pool, 'echo').outcome is RequestOutcome.ANSWERED
        assert pool.replaced == 3


@pytest.mark.slow
def test_a_stopped_worker_is_replaced_at_the_time_limit(clock):
    with running() as pool:
        [pid] = pool.pids
        os.kill(pid, signal.SIGSTOP)
        sent = Submitted(pool, 'echo', time_limit=0.3)
        assert sent.answer().outcome is RequestOutcome.TIMED_OUT
        assert sent.response_time(clock, 0.3) < SLACK
        assert ask(pool, 'echo').packet.plain['pid'] != pid


@pytest.mark.slow
def test_the_queue_refuses_cancels_and_times_out_requests(clock):
    with running(queue_length=2) as pool:
        busy = Submitted(pool, 'iterate').wait_until_started()
        first, second = Submitted(pool, 'echo'), Submitted(pool, 'echo', time_limit=0.2)
        refused = Submitted(pool, 'echo')
        assert refused.answer().outcome is RequestOutcome.REFUSED
        assert 'the queue is full, with 2 requests' in refused.answer().message
        assert refused.response_time(clock) < SLACK
        assert (pool.waiting, pool.busy) == (2, 1)
        assert second.answer().outcome is RequestOutcome.TIMED_OUT
        assert second.end - second.start >= 0.2
        assert second.response_time(clock, 0.2) < SLACK
        pool.cancel(first.job)
        assert first.answer().outcome is RequestOutcome.CANCELLED
        pool.cancel(busy.job)
        assert busy.answer().packet.plain['stopped'] is True
        assert (pool.waiting, pool.busy) == (0, 0)


@pytest.mark.slow
def test_has_started_is_set_after_a_start_or_a_failure():
    for module, ready in (('stand_in_worker', 1), ('no_such_module', 0)):
        pool = Pool(module, 1)
        wait_for(lambda: pool.has_started)  # noqa: B023 - called at once
        assert len(pool.pids) == ready
        pool.close()


@pytest.mark.slow
def test_a_pool_grows_and_shrinks():
    with running() as pool:
        busy = Submitted(pool, 'iterate', time_limit=1.0).wait_until_started()
        pool.resize(2)
        assert ask(pool, 'echo').outcome is RequestOutcome.ANSWERED
        pool.resize(1)
        wait_for(lambda: len(pool.pids) == 1)
        assert busy.answer().outcome is RequestOutcome.ANSWERED


def test_an_import_error_of_the_worker_is_reported():
    pool = Pool('no_such_module', 1)
    sent = Submitted(pool, 'echo')
    assert sent.answer().outcome is RequestOutcome.DIED
    assert "No module named 'no_such_module'" in sent.answer().message
    pool.close()


@pytest.mark.slow
def test_failed_starts_are_retried_at_growing_intervals(monkeypatch):
    pauses = []
    monkeypatch.setattr(Pool, 'pause', lambda pool, worker, duration: pauses.append(duration))
    pool = Pool('no_such_module', 1)
    wait_for(lambda: len(pauses) >= 8)
    pool.close()
    assert pauses[:8] == [1, 2, 4, 8, 16, 32, 60, 60]


@pytest.mark.slow
def test_requests_fail_at_once_while_no_worker_starts(monkeypatch, tmp_path, clock):
    """After three failed starts requests fail at once, until the module can be imported."""
    monkeypatch.setenv('PYTHONPATH', str(tmp_path))
    monkeypatch.setattr(workers, 'START_PAUSE', 0.1)
    pool = Pool('mended_module', 1)
    wait_for(lambda: pool._workers[0].failures >= workers.TRIES)
    sent = Submitted(pool, 'echo')
    assert sent.response_time(clock) < SLACK
    assert sent.answer().outcome is RequestOutcome.DIED
    assert sent.answer().message == (
        "no worker starts: ModuleNotFoundError: No module named 'mended_module'")
    assert pool.fault in sent.answer().message
    (tmp_path / 'mended_module.py').write_text(
        (Path(__file__).parents[1] / 'stand_in_worker.py').read_text())
    wait_for(lambda: pool.pids)
    assert ask(pool, 'echo').outcome is RequestOutcome.ANSWERED
    assert not pool.fault
    pool.close()


def test_time_limits_hold_while_no_worker_starts(monkeypatch, clock):
    monkeypatch.setattr(workers, 'START_PAUSE', 5.0)
    pool = Pool('no_such_module', 1)
    wait_for(lambda: pool.fault)
    sent = Submitted(pool, 'echo', time_limit=0.3)
    assert sent.answer().outcome is RequestOutcome.TIMED_OUT
    assert sent.response_time(clock, 0.3) < SLACK
    pool.close()


@pytest.mark.slow
def test_a_process_that_cannot_be_created_is_reported(monkeypatch):
    def refuse(*args, **options):
        raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))
    monkeypatch.setattr(subprocess, 'Popen', refuse)
    pool = Pool('stand_in_worker', 1)
    assert 'temporarily unavailable' in ask(pool, 'echo').message
    monkeypatch.undo()
    monkeypatch.setenv('PYTHONPATH', str(Path(__file__).parents[1]))
    wait_for(lambda: pool.pids)
    pool.close()


@pytest.mark.slow
def test_closing_cancels_the_open_requests():
    with running() as pool:
        sent = [Submitted(pool, 'hang').wait_until_started(), Submitted(pool, 'echo')]
    assert [each.answer().outcome for each in sent] == [RequestOutcome.CANCELLED] * 2
    assert ask(pool, 'echo').outcome is RequestOutcome.REFUSED


@pytest.mark.slow
def test_no_worker_outlives_a_killed_process():
    program = ('import time; from obc_ros.workers.pool import Pool\n'
               'pool = Pool("stand_in_worker", 2)\n'
               'while len(pool.pids) < 2: time.sleep(0.01)\n'
               'print(*pool.pids, flush=True)\n'
               'time.sleep(1000)')
    with subprocess.Popen([sys.executable, '-c', program], stdout=subprocess.PIPE) as process:
        pids = [*map(int, process.stdout.readline().split())]
        assert all(map(alive, pids))
        process.kill()
    wait_for(lambda: not any(map(alive, pids)))


@pytest.mark.slow
def test_a_worker_has_low_priority_and_bounded_memory():
    with running(memory=1 << 30) as pool:
        [pid] = pool.pids
        limits = Path(f'/proc/{pid}/limits').read_text().splitlines()
        [data] = [line for line in limits if line.startswith('Max data size')]
        assert data.split()[3:5] == [str(1 << 30)] * 2
        nice = os.getpriority(os.PRIO_PROCESS, pid)
        assert nice > os.getpriority(os.PRIO_PROCESS, 0)
        group = Path(f'/proc/{pid}/autogroup')  # content: '/autogroup-17 nice 5', or empty
        if group.exists() and (words := group.read_text().split()):
            assert words[1:] == ['nice', str(nice)]
        assert 'OMP_NUM_THREADS=1' in Path(f'/proc/{pid}/environ').read_text().split('\0')
