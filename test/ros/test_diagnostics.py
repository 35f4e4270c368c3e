# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What diagnostics say at WARN or ERROR the log says once; a node that drops all is not OK."""

from collections import Counter
from types import SimpleNamespace

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from obc_ros.core.closed_loop.modes import Mode
from obc_ros.core.estimation.delayed_filter import DelayedFilter
from obc_ros.core.simulation.paced_plant import ANSWERED
from obc_ros.nodes.control.loop_monitor import DROPPED, LoopMonitor
from obc_ros.nodes.estimator_messages import estimator_status, Traffic
from obc_ros.nodes.estimator_settings import judge_estimator_settings, Settings
from obc_ros.nodes.plant_simulator import judge_commands
from obc_ros.ros import diagnostics
from obc_ros.ros.diagnostics import Diagnostics
import pytest

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class Node:
    """A node without middleware: what it has published and logged."""

    def __init__(self):
        self.sent, self.lines = [], []
        self.publish = self.sent.append
        self.warning = lambda words: self.lines.append((WARN, words))
        self.error = lambda words: self.lines.append((ERROR, words))

    def create_publisher(self, *_):
        return self

    def get_logger(self):
        return self

    def get_namespace(self):
        return '/robot'


@pytest.fixture
def node(monkeypatch):
    """Return a node, whose `at` is the steady clock [s], and `say`, which publishes a status."""
    found = Node()
    found.at, published = 100.0, Diagnostics(found)
    monkeypatch.setattr(diagnostics, 'monotonic', lambda: found.at)

    def say(level, words, part='states', told=()):
        status = DiagnosticStatus(name=f'robot/node: {part}', level=level, message=words)
        published.publish([status], Time(sec=3), '', 'plant', told)

    found.say = say
    return found


def test_a_condition_is_logged_when_it_begins(node):
    node.say(OK, 'states are answered')
    for second in range(60):
        node.at += 1.0
        node.say(ERROR, f'no valid state for {second + 0.5:.3g} s')
    assert node.lines == [(ERROR, 'states: no valid state for 0.5 s')]
    assert len(node.sent) == 61
    assert {each.status[0].hardware_id for each in node.sent} == {'robot'}
    assert {each.header.stamp.sec for each in node.sent} == {3}


def test_other_words_are_another_condition(node):
    node.say(WARN, '2 deadlines missed')
    node.say(ERROR, 'all states are dropped: 4 not finite')
    node.say(WARN, '2 deadlines missed', 'plan')
    assert [words for _, words in node.lines] == [
        'states: 2 deadlines missed', 'states: all states are dropped: 4 not finite',
        'plan: 2 deadlines missed']


def test_conditions_that_alternate_are_logged_once_each(node):
    for second in range(60):
        node.at += 1.0
        node.say(*((WARN, 'at a limit 60% of the time'), (OK, 'within the limits'),
                   (WARN, 'the error is outside x_limits'))[second % 3], 'commands')
    assert len(node.lines) == 2


def test_a_condition_that_returns_later_is_logged_again(node):
    for _ in range(2):
        node.say(WARN, 'the queue is full')
        node.at += 11.0
    assert len(node.lines) == 2


def test_what_the_log_has_already_is_not_repeated(node):
    node.say(WARN, 'states dropped: 1 not finite', told={'robot/node: states'})
    assert not node.lines


def read_states(loop, monitor, **grown):
    loop.counts.update(grown)
    return monitor.statuses('node', loop, 1, True)[0]


@pytest.fixture
def loop():
    rules = SimpleNamespace(state_timeout=0.5, on_stale='rest', x_limits=())
    return SimpleNamespace(
        counts=Counter(), control=SimpleNamespace(rules=rules), lag=None, interval=None,
        reason='', mode=Mode.WAITING, is_stale=False, is_outside=False, is_stopped=False,
        age=lambda now: None)


@pytest.mark.parametrize('kind', sorted(DROPPED))
def test_a_controller_that_drops_every_state_is_never_ok(loop, kind):
    monitor = LoopMonitor()
    assert read_states(loop, monitor).level == OK   # nothing has come
    assert read_states(loop, monitor, **{kind: 50}).level == ERROR
    status = read_states(loop, monitor)   # states come less than once a second
    assert status.level == ERROR and DROPPED[kind] in status.message
    assert monitor.told == {'node: states'}


@pytest.mark.parametrize('kind', sorted(DROPPED))
def test_a_controller_that_drops_every_state_after_an_answer_is_never_ok(loop, kind):
    """With `state_timeout: 0` the loop is never stale, and states come every other second."""
    monitor = LoopMonitor()
    loop.age = lambda now: 0.0
    assert read_states(loop, monitor, answered=1).level == OK
    loop.age = lambda now: 30.0
    assert read_states(loop, monitor).level == OK   # no new state
    for count in (1, 2):
        for grown in ({kind: 1}, {}):
            status = read_states(loop, monitor, **grown)
            assert status.level == ERROR and f'{count} {DROPPED[kind]}' in status.message
    loop.age = lambda now: 0.0
    assert read_states(loop, monitor, answered=1).level == OK
    loop.age = lambda now: 30.0
    assert read_states(loop, monitor).level == OK


@pytest.mark.parametrize('mode', [Mode.RESTING, Mode.STOPPED])
def test_the_log_does_not_say_again_why_a_loop_rests(loop, mode):
    """The loop has reported the change of its mode."""
    monitor = LoopMonitor()
    loop.mode, loop.reason, loop.is_stopped = mode, 'a reason', mode is Mode.STOPPED
    commands = monitor.statuses('node', loop, 1, True)[1]
    assert commands.level == WARN and 'a reason' in commands.message
    assert commands.name in monitor.told


def test_a_simulator_that_drops_every_command_is_never_ok():
    assert judge_commands(0, Counter()) is None and judge_commands(50, Counter()) is None
    for reason in ('malformed', 'other components', ANSWERED):
        level, words = judge_commands(0, Counter({reason: 50}))
        assert level == ERROR and words == f'all commands are dropped: 50 {reason}'
    assert judge_commands(50, Counter({'malformed': 1}))[0] == WARN
    assert judge_commands(50, Counter({ANSWERED: 1})) is None


def test_an_estimator_that_drops_messages_is_not_ok():
    candidate = judge_estimator_settings(Settings())
    settings = candidate.settings
    delayed = DelayedFilter(candidate.kalman, candidate.x0, candidate.P0, candidate.u0,
                            settings.longest_lag, outputs=candidate.outputs)
    delayed.measure(1_000_000_000, list(candidate.outputs), [0.0] * len(candidate.outputs))
    before = Traffic(1, 1, Counter(used=1), 0.01, 0.0, 0.01)

    def judge(received, published, **grown):
        return estimator_status('node', candidate, delayed, Traffic(
            1 + received, 1 + published, before.counts + Counter(grown), 0.01, 0.0, 0.01), before)

    assert judge(50, 50, used=50).level == OK
    for kind in ('malformed', 'future'):
        assert judge(50, 25, used=25, **{kind: 25}).level == WARN
        assert judge(50, 0, **{kind: 50}).level == ERROR
    status = judge(50, 50, used=50, malformed=50)   # all commands
    assert status.level == WARN and '50 malformed' in status.message
