# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Plans of the solver process: as laws of the loop, as messages, and their diagnostics."""

from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from statistics import quantiles
from time import monotonic
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from obc_ros.core.closed_loop.control import Control
from obc_ros.core.closed_loop.feedback import convert_rows
from obc_ros.core.closed_loop.laws import PlanLaw
from obc_ros.core.closed_loop.loop import ControlLoop
from obc_ros.core.systems.system import System
from obc_ros.msg import Trajectory
from obc_ros.ros.diagnostics import make_status
from obc_ros.ros.messages import flatten_doubles, set_stamp
from obc_ros.workers.wire import Packet

KEPT = 1e-6   # slack below which a bound is kept


def make_plan(reply: Packet, period: int, control: Control) -> PlanLaw:
    """
    Return a plan as a law, with the feedback of the set point along it.

    :param reply: a plan: ``stamp`` of its first sample [ns], arrays x (N + 1, n) and u (N, m).
    :param period: time between two samples [ns].
    """
    return PlanLaw(
        int(reply.plain['stamp']) - period // 2, period, convert_rows(reply.arrays['x']),
        convert_rows(reply.arrays['u']), control.regulator.K)


def make_plan_message(reply: Packet, period: int, system: System, frame: str) -> Trajectory:
    """Return the message of a plan: N + 1 samples in a frame; the last input is repeated."""
    x, u = reply.arrays['x'], reply.arrays['u']
    message = Trajectory(
        system=system.name, state_names=list(system.state_names),
        input_names=list(system.input_names), interpolation='zoh',
        t=flatten_doubles(1e-9 * period * np.arange(len(x))), x=flatten_doubles(x),
        u=flatten_doubles(np.vstack([u, u[-1:]])))
    message.header.frame_id = frame
    set_stamp(message.header.stamp, int(reply.plain['stamp']))
    return message


@dataclass
class PlanMonitor:
    """
    What is known of the plans.

    :ivar counts: wanted: states at which a new plan was due; missed: those at which it had not
        arrived; failed: replies without a plan.
    :ivar first: what was checked of the plan with which the node became active.
    :ivar period: time between two plans [s].
    """

    counts: Counter[str] = field(default_factory=Counter)
    last: Packet | None = None
    reason: str = ''
    first: str = ''
    period: float = 1.0
    _taken: float = 0.0
    _times: deque[float] = field(default_factory=lambda: deque(maxlen=5_000))
    _before: Counter[str] = field(default_factory=Counter)
    _longest: float = 0.0

    def add(self, reply: Packet) -> None:
        """Store a plan."""
        self.last, self._taken = reply, monotonic()
        seconds = float(reply.plain.get('seconds', 0.0))
        self._times.append(seconds)
        self._longest = max(self._longest, seconds)

    def fail(self, reason: str) -> None:
        """Count a step without a plan."""
        self.counts['failed'] += 1
        self.reason = reason

    def status(self, name: str, loop: ControlLoop, processes: Mapping[str, int], why: str
               ) -> DiagnosticStatus:
        """
        Return the status of the plans since the last call.

        :param loop: the loop; it may run at the same time.
        :param processes: numbers of lost solver processes by cause.
        :param why: why the node cannot plan at all; empty: it can.
        """
        new, interval = Counter(self.counts) - self._before, loop.interval
        self._before = Counter(self.counts)
        slack: dict[str, float] = {} if self.last is None else {
            what: value for what, value in self.last.plain['slack'].items() if value > KEPT}
        level, words = DiagnosticStatus.OK, 'plans are followed'
        if why:
            level, words = DiagnosticStatus.ERROR, why
        elif loop.is_unplanned:
            level, words = DiagnosticStatus.ERROR, (
                'no plan, and the state is outside the terminal set; on_unplanned: '
                f'{loop.control.rules.on_unplanned}')
        elif interval and not 0.7 < interval / self.period < 1.4:
            level, words = DiagnosticStatus.WARN, (
                f'states come at {1.0 / interval:.3g} Hz, and rate is {1.0 / self.period:.3g} Hz')
        elif new['failed']:
            level, words = DiagnosticStatus.WARN, f'{new["failed"]} steps failed: {self.reason}'
        elif new['missed']:
            level, words = DiagnosticStatus.WARN, f'{new["missed"]} deadlines missed'
        elif slack:
            level, words = DiagnosticStatus.WARN, 'exceeded in the plan: ' + ', '.join(
                f'{what} by {value:.3g}' for what, value in slack.items())
        elif self.last is None:
            words = 'no plan yet'
        elif loop.is_stale:
            words = 'no valid state to plan for'
        return make_status(f'{name}: plan', level, words, {
            **self._values(), 'first plan': self.first,
            'exceeded': max(slack.values(), default=0.0),
            **{f'exceeded {what}': f'{value:.3g}' for what, value in slack.items()},
            **{f'deadlines {kind}': self.counts[kind] for kind in ('wanted', 'missed')},
            'steps failed': self.counts['failed'], 'last failure': self.reason,
            'states without a plan': loop.counts['unplanned'],
            **{f'solver {kind}': processes[kind] for kind in ('ended', 'silent', 'unsent')}})

    def _values(self) -> dict[str, Any]:
        if self.last is None:
            return {}
        times, plain = list(self._times), self.last.plain
        percent = quantiles(times, n=100) if len(times) > 1 else [float('nan')] * 99
        return {'age [s]': f'{monotonic() - self._taken:.4f}', 'cost': f'{plain["cost"]:.6g}',
                'iterations': plain['iterations'], 'residual': f'{plain["residual"]:.3g}',
                'outcome': plain['status'], 'solve p50 [ms]': f'{1e3 * percent[49]:.3f}',
                'solve p99 [ms]': f'{1e3 * percent[98]:.3f}',
                'solve max [ms]': f'{1e3 * self._longest:.3f}'}
