# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of a controller: states, commands and design, once a second (REP 107)."""

from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
import math
from statistics import quantiles
from time import monotonic

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from obc_ros.core.closed_loop.clock import NS
from obc_ros.core.closed_loop.control import Control
from obc_ros.core.closed_loop.loop import ControlLoop
from obc_ros.core.closed_loop.modes import Mode
from obc_ros.core.systems.system import System
from obc_ros.ros.diagnostics import make_status

DROPPED = {'unreadable': 'that cannot be read', 'size': 'of wrong size',
           'finite': 'not finite', 'frame': 'in another frame',
           'names': 'of other names', 'source': 'of a second publisher',
           'late': 'out of order', 'old': 'stamped too long ago',
           'ahead': 'stamped in the future', 'command': 'without a finite command'}
LOOKS, GROWTH = 5, 4.0  # successive increases of the cost-to-go, and their total factor
COUNTED = ('answered', 'skipped', 'repeated', 'restarted', 'stale', 'deadline')
LONGEST_PREDICTION = 1.0   # [s] between two states: over more the model is not compared


@dataclass
class LoopMonitor:
    """Observations of a loop since the last diagnostics."""

    latencies: deque[float] = field(default_factory=lambda: deque(maxlen=5_000))
    refusals: int = 0
    last_refusal: str = ''
    design: str = ''
    topic: str = ''
    faults: dict[str, str] = field(default_factory=dict)
    told: set[str] = field(default_factory=set)   # statuses of which the loop's own log speaks
    _costs: deque[float] = field(default_factory=lambda: deque(maxlen=LOOKS + 1))
    _worst: float = 0.0
    _control: Control | None = None
    _suspected: set[str] = field(default_factory=set)
    _before: Counter[str] = field(default_factory=Counter)
    _unheard: Counter[str] = field(default_factory=Counter)   # since the last valid state
    _looked: float = field(default_factory=monotonic)

    def refused(self, sentence: str) -> None:
        """Store the reason of a rejected change."""
        self.refusals, self.last_refusal = self.refusals + 1, sentence

    def found(self, faults: dict[str, str]) -> list[str]:
        """Store the present faults of the topics; return the messages that are new."""
        # An endpoint that is just being discovered may show wrong QoS: a fault must occur twice.
        lasting = {what: words for what, words in faults.items() if what in self._suspected}
        self._suspected = set(faults)
        new = [words for what, words in lasting.items() if self.faults.get(what) != words]
        self.faults = lasting
        return new

    def runs_away(self, cost: float | None, control: Control) -> bool:
        """
        Store the cost-to-go; return whether it grows although it should fall.

        It must have grown at several calls in a row, beyond all its values under this control.
        """
        if control is not self._control:
            self._control, self._worst = control, 0.0
            self._costs.clear()
        if cost is None:
            return False
        if len(self._costs) > LOOKS:
            self._worst = max(self._worst, self._costs[0])
        self._costs.append(cost)
        grows = len(self._costs) > LOOKS and all(a < b for a, b in pairwise(self._costs))
        return not math.isfinite(cost) or (
            grows and cost > max(self._worst, GROWTH * self._costs[0]))

    def statuses(self, name: str, loop: ControlLoop, revision: int, is_active: bool,
                 cost: float | None = None, idle: str = '',
                 missed: Mapping[str, float] | None = None) -> list[DiagnosticStatus]:
        """
        Return the statuses of states, commands and design.

        :param loop: the loop; it may run at the same time.
        :param cost: cost-to-go at the last error; None: there was no error.
        :param idle: why the node is not active although it should be; empty: it need not be.
        :param missed: by how much the model has missed the last state, by name.
        """
        now, counts = monotonic(), Counter(loop.counts)
        elapsed, self._looked = now - self._looked, now
        new, self._before = counts - self._before, counts
        self.told = set()
        return [self._states(name, loop, new, elapsed, now, is_active, idle),
                self._commands(name, loop, new, cost, missed or {}),
                make_status(f'{name}: design', DiagnosticStatus.OK, self.design, {
                    'revision': revision, 'changes refused': self.refusals,
                    'last refusal': self.last_refusal})]

    def _states(self, name: str, loop: ControlLoop, new: Counter[str], elapsed: float, now: float,
                is_active: bool, idle: str) -> DiagnosticStatus:
        age = loop.age(now)
        is_heard = new['answered'] or (age is not None and age < elapsed)
        self._unheard = Counter() if is_heard else self._unheard + new
        of = new if is_heard else self._unheard   # without a state, all since the last one
        dropped = {words: of[kind] for kind, words in DROPPED.items() if of[kind]}
        level, words = DiagnosticStatus.OK, 'states are answered'
        if idle:
            level, words = DiagnosticStatus.ERROR, f'not active: {idle}'
        elif not is_active:
            words = 'not active'
        elif loop.is_stale:
            level, words = DiagnosticStatus.ERROR, (
                f'no valid state for {age:.3g} s; on_stale: {loop.control.rules.on_stale}')
        elif age is None and not dropped:
            words = 'no state yet'
        elif dropped and not new['answered']:
            level, words = DiagnosticStatus.ERROR, 'all states are dropped: ' + ', '.join(
                f'{count} {what}' for what, count in dropped.items())
        elif dropped:
            level, words = DiagnosticStatus.WARN, 'states dropped: ' + ', '.join(
                f'{count} {what}' for what, count in dropped.items())
        elif new['deadline']:
            level, words = DiagnosticStatus.WARN, (
                f'{new["deadline"]} deadlines missed on {self.topic}')
        elif new['answered'] > 1 and new['repeated'] >= new['answered']:
            level, words = DiagnosticStatus.WARN, 'the stamps of the states do not advance'
        elif not new['answered']:
            words = 'no new state'
        if dropped:
            self.told.add(f'{name}: states')
        if self.faults:
            self.told.add(f'{name}: states')
            level = max(level, DiagnosticStatus.WARN)
            words = '; '.join([words, *self.faults.values()])
        return make_status(f'{name}: states', level, words, {
            'rate [Hz]': f'{new["answered"] / elapsed:.1f}',
            'age [s]': '' if age is None else f'{age:.4f}',
            'age by its stamp [s]': '' if loop.lag is None else f'{loop.lag:.4f}',
            'interval [s]': '' if loop.interval is None else f'{loop.interval:.4f}',
            **{kind: loop.counts[kind] for kind in COUNTED},
            **{f'dropped {words}': loop.counts[kind] for kind, words in DROPPED.items()}})

    def _commands(self, name: str, loop: ControlLoop, new: Counter[str], cost: float | None,
                  missed: Mapping[str, float]) -> DiagnosticStatus:
        latencies, share = list(self.latencies), new['saturated'] / max(new['answered'], 1)
        self.latencies.clear()
        percent = quantiles(latencies, n=100) if len(latencies) > 1 else [float('nan')] * 99
        level, words = DiagnosticStatus.OK, (
            'within the limits' if new['answered'] else 'no state is answered')
        if share:
            words = f'at a limit {share:.0%} of the time'
        if share > 0.5:
            level = DiagnosticStatus.WARN
        if self.runs_away(cost, loop.control):
            level, words = DiagnosticStatus.WARN, (
                'the cost-to-go grows: the plant differs from the model, or a disturbance acts on '
                'it' + '; x_limits are not set'
                * (not loop.control.rules.x_limits))
        if loop.is_outside:
            level, words = DiagnosticStatus.WARN, 'the error is outside x_limits'
        if loop.mode is Mode.RESTING:
            level, words = DiagnosticStatus.WARN, f'the control law rests: {loop.reason}'
        if loop.is_stopped:
            level, words = DiagnosticStatus.WARN, f'stopped: {loop.reason}'
        if loop.mode in (Mode.RESTING, Mode.STOPPED):
            self.told.add(f'{name}: commands')
        return make_status(f'{name}: commands', level, words, {
            'mode': loop.mode.name, 'mode reason': loop.reason,
            'latency p50 [us]': f'{1e6 * percent[49]:.0f}',
            'latency p99 [us]': f'{1e6 * percent[98]:.0f}',
            'share at a limit': f'{share:.3f}',
            'cost-to-go': '' if cost is None else f'{cost:.4g}',
            'answers at a limit': loop.counts['saturated'],
            'times outside x_limits': loop.counts['outside'],
            'states too far apart': loop.counts['slow'],
            **{f'missed by the model {name}': f'{value:.3g}' for name, value in missed.items()}})


def predict_error(system: System, loop: ControlLoop) -> dict[str, float]:
    """
    Return by how much the model has missed the last state, by name.

    The prediction begins at the state before it, with the command that was sent for that one; it
    is empty if the command acts later, or if the states are far apart.
    """
    samples = loop.samples
    if len(samples) < 2 or loop.control.prediction is not None:
        return {}
    first, last = samples
    dt = (last.stamp - first.stamp) * NS
    if not 0.0 < dt < LONGEST_PREDICTION:
        return {}
    x, u = np.array(first.x), np.array(first.u)
    k1 = system.f(x, u)   # the classical Runge-Kutta method
    k2 = system.f(x + 0.5 * dt * k1, u)
    k3 = system.f(x + 0.5 * dt * k2, u)
    ahead = x + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + system.f(x + dt * k3, u))
    return dict(zip(system.state_names, loop.control.limits.error(last.x, ahead.tolist()),
                    strict=True))
