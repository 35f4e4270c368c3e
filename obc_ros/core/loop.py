# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
From states to commands: what a control law needs around it before a robot can trust it.

A `Control` says what to do and never changes; a `Loop` holds what a run has seen so far and turns
each state into a command. It is told the time: stamps of the states [ns] for whatever the law
does, a steady clock [s] for whether states still come.
"""

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import replace
import math
from operator import mul, sub

from obc_ros.core.control import Control, Integral, Prediction
from obc_ros.core.regulator import feedback, Point, Regulator

NS = 1e-9  # [s]
_AGAIN = 1.0  # [s] until the same thing is told again


class Loop:
    """
    One run of a control loop.

    `answer` and `overdue` belong to one thread; `adopt`, `stop` and `start` may be called from
    another, each of them being one assignment.

    A set point that moves starts where the plant is, in the states that it moves along, whenever
    the law begins or resumes; what a later change leaves as it was moves on.

    Attributes
    ----------
    counts : collections.Counter
        Of what has happened: answered, saturated, skipped, repeated, late, restarted, stale,
        outside, and each reason of dropping a state (size, finite, command).
    news : collections.deque of str
        What should be told, oldest first; the same thing at most once a second.
    stamp : int or None
        Of the last state in order [ns].
    x, command : sequence of float or None
        The last good state, and the last command.
    error : list of float or None
        x - xr at the last answer of the law.
    stopped : str
        Why the loop is stopped; empty while it is not.
    is_stale, is_outside : bool
        Whether the states fail to come, and whether the last was outside `x_limits`.

    """

    def __init__(self, control: Control) -> None:
        self.counts: Counter[str] = Counter()
        self.news: deque[str] = deque(maxlen=100)
        self.stamp: int | None = None
        self.x: Sequence[float] | None = None
        self.command: list[float] | None = None
        self.error: list[float] | None = None
        self.stopped = ''
        self.is_stale = self.is_outside = False
        self._control = self._next = control
        self._clock = _Clock()
        self._seen = self._spoken = self._now = -math.inf
        self._told: dict[str, float] = {}
        self._excess: Sequence[float] = ()
        self._since: int | None = None
        self._jump: list[float] | None = None
        self._past: deque[list[float]] = deque()
        self._begin(control)

    @property
    def control(self) -> Control:
        """Return what decides about the next command."""
        return self._next

    def adopt(self, control: Control) -> None:
        """Use another control from the next state on."""
        self._next = control

    def stop(self, reason: str) -> None:
        """Command the input at rest until `start`."""
        self.stopped = reason

    def start(self) -> None:
        """End a stop."""
        self.stopped = ''

    def answer(self, stamp: int, x: Sequence[float], now: float) -> list[float] | None:
        """
        Return the command (m,) that answers a state, or None.

        Parameters
        ----------
        stamp : int
            When the state was true [ns].
        x : sequence of float
            The state (n,).
        now : float
            Steady clock [s].

        """
        self._now = now
        if not (self._is_usable(x, now) and self._is_in_order(stamp)):
            return None
        self.x, self._seen, self.is_stale = x, now, False
        if not self._clock.is_due(stamp, self._next.rules.period):
            self.counts['skipped'] += 1
            return None
        if self._next is not self._control:
            self._take_over(self._next, stamp, x)
        u = self._decide(self._control, stamp, x)
        if u is None:
            return None
        if not all(map(math.isfinite, u)):
            self.drop('command', f'a command that is not finite ({u}) was dropped', now)
            return None
        self._clock.answered = stamp
        self._spoken, self.command = now, u
        self.counts['answered'] += 1
        return u

    def overdue(self, now: float) -> list[float] | None:
        """Return what to command while no state comes, or None: nothing, or not yet."""
        rules = self._next.rules
        if now < self.wake():
            return None
        if not self.is_stale:
            self.is_stale = True
            self.drop('stale', f'no good state for {rules.state_timeout:g} s; on_stale: '
                               f'{rules.on_stale}', now)
        self._spoken = now
        return self._instead('equilibrium' if self.stopped else rules.on_stale)

    def wake(self) -> float:
        """Return when `overdue` has something to do next, by the steady clock [s]."""
        timeout = self._next.rules.state_timeout
        if self.x is None or not timeout:
            return math.inf
        return (self._spoken if self.is_stale else self._seen) + timeout

    def age(self, now: float) -> float | None:
        """Return the time since the last good state [s], or None: there was none."""
        return None if self.x is None else now - self._seen

    def preview(self, control: Control) -> list[float] | None:
        """Return by how much (m,) a control would change the last command, or None: none yet."""
        if self.x is None or self.stamp is None or self.command is None:
            return None
        u = self._law(control, self._reference(control, self.stamp), self.stamp, self.x)
        control.limits.clip(u)
        return list(map(sub, u, self.command))

    def drop(self, kind: str, sentence: str, now: float) -> None:
        """Count and tell that a state was of no use, by the steady clock [s]."""
        self._now = now
        self.counts[kind] += 1
        self._tell(kind, sentence)

    # What came

    def _is_usable(self, x: Sequence[float], now: float) -> bool:
        names = self._next.names
        if len(x) != len(names):
            self.drop('size', f'a state with {len(x)} numbers was dropped: wanted {len(names)} '
                              f'({", ".join(names)})', now)
            return False
        if not all(map(math.isfinite, x)):
            wrong = next(i for i, value in enumerate(x) if not math.isfinite(value))
            self.drop('finite', f'a state with {names[wrong]} = {x[wrong]} was dropped', now)
            return False
        return True

    def _is_in_order(self, stamp: int) -> bool:
        last, order = self.stamp, self._clock.order(stamp, self._next.rules.state_timeout or 1.0)
        if last is not None and order:
            self.counts[order] += 1
            if order == 'late':
                self._tell(order, f'a state {(last - stamp) * NS:g} s older than the one before '
                                  'it was dropped')
                return False
            if order == 'restarted':
                self._tell(order, f'time went back by {(last - stamp) * NS:g} s: started again')
                self._begin(self._next)
        self.stamp = stamp
        return True

    # What to command

    def _decide(self, control: Control, stamp: int, x: Sequence[float]) -> list[float] | None:
        if self.stopped:
            return self._instead('equilibrium')
        if self._resting:
            self._resume(control, stamp, x)
        point = self._reference(control, stamp)
        error = control.limits.error(x, point.x)
        if control.rules.x_limits and self._is_beyond(control, error):
            return self._instead('equilibrium' if self.stopped else control.rules.on_envelope)
        if control.integral is not None:
            self._integrate(control.integral, error, stamp)
        self.error, self._since = error, stamp
        raw = self._law(control, point, stamp, x)
        if self._jump is not None:
            self._fade(raw, stamp)
        u = raw.copy()
        clipped = control.limits.clip(u)
        self.counts['saturated'] += bool(clipped)
        self._excess = list(map(sub, raw, u)) if clipped else ()
        if control.prediction is not None:
            self._remember(control.prediction, u, stamp)
        return u

    def _law(self, control: Control, point: Point, stamp: int, x: Sequence[float]
             ) -> list[float]:
        """Return the law's input without limits."""
        e, z = control.limits.error(x, point.x), self._z
        if control.prediction is not None:
            ahead = self._predict(control.prediction, [*e, *z], point.u)
            e, z = ahead[:len(e)], ahead[len(e):]
            if control.legs:
                point = self._reference(control, stamp + control.prediction.delay)
        u = feedback(point, e)
        if control.integral is not None:
            for j, row in enumerate(control.integral.Ki):
                u[j] -= sum(map(mul, row, z))
        return u

    def _reference(self, control: Control, stamp: int) -> Point:
        """Return where the plant should be at a stamp."""
        for leg in reversed(control.legs):
            begin, duration = leg.reference.begin, leg.reference.duration
            t = 0.0 if begin is None else (stamp - begin) * NS
            if t >= duration:
                return leg.after.at(t - duration)
            if t >= 0.0:
                return leg.along.at(t)
        if control is not self._control:
            return self._moved(control, stamp).at(0.0)
        return self._regulator.at((stamp - self._origin) * NS)

    def _instead(self, action: str) -> list[float] | None:
        """Return what is commanded in place of the law."""
        if action == 'hold':
            return self.command and self.command.copy()
        self._resting = True
        return list(self._control.rest) if action == 'equilibrium' else None

    def _is_beyond(self, control: Control, error: Sequence[float]) -> bool:
        for i, (value, (lower, upper)) in enumerate(
                zip(error, control.rules.x_limits, strict=True)):
            if not lower <= value <= upper:
                what = (f'the error of {control.names[i]} is {value:g}, outside [{lower:g}, '
                        f'{upper:g}]')
                if not self.is_outside:
                    self.is_outside = True
                    self.counts['outside'] += 1
                    self._tell('outside', f'{what}; on_envelope: {control.rules.on_envelope}')
                if control.rules.on_envelope == 'stop':
                    self.stop(what)
                return True
        self.is_outside = False
        return False

    # What has been: set point that moves, integral, transition, commands on their way

    def _begin(self, control: Control) -> None:
        """Forget the run."""
        self._regulator, self._origin = control.regulator, 0
        self._z = [0.0] * (len(control.integral.C) if control.integral else 0)
        self._excess = ()
        self._jump, self._jumped = None, 0
        self._resting = True
        self._past.clear()
        self._sent: int | None = None
        self.error = self._since = None

    def _resume(self, control: Control, stamp: int, x: Sequence[float]) -> None:
        """Let the law begin, or go on after something else was commanded."""
        self._resting = False
        self._z = [0.0] * len(self._z)
        self._since = None
        self._past.clear()
        drift, now = self._regulator.drift, self._regulator.at((stamp - self._origin) * NS).x
        here = [own if v else xr for own, xr, v in zip(x, now, drift, strict=True)]
        self._regulator, self._origin = replace(self._regulator, x=tuple(here)), stamp
        if self.command is not None:
            self._smooth(control, self.command, stamp, x)

    def _take_over(self, new: Control, stamp: int, x: Sequence[float]) -> None:
        """Make `new` the control in use."""
        before = None
        if not (self._resting or self.stopped or self.command is None):
            before = self._law(self._control, self._reference(self._control, stamp), stamp, x)
            if self._jump is not None:
                self._fade(before, stamp)
            self._control.limits.clip(before)
        self._regulator, self._origin = self._moved(new, stamp), stamp
        for leg in new.legs:
            if leg.reference.begin is None:
                leg.reference.begin = stamp
        if new.integral is None or self._control.integral is None or (
                new.integral.C != self._control.integral.C):
            self._z = [0.0] * (len(new.integral.C) if new.integral else 0)
        self._control, self._excess = new, ()
        if before is not None:
            self._smooth(new, before, stamp, x)

    def _moved(self, new: Control, stamp: int) -> Regulator:
        """Return the regulator of `new` with its set point where it is at a stamp."""
        old = self._control
        moved = self._regulator.at((stamp - self._origin) * NS).x
        if old.legs and not new.legs:  # go on from the end of a reference
            here = self._reference(old, stamp).x
            moves = map(any, zip(old.regulator.drift, new.regulator.drift, strict=True))
            moved = tuple([h if v else m for h, m, v in zip(here, moved, moves, strict=True)])
        x = [is_now if wanted == before else wanted for wanted, before, is_now in zip(
            new.regulator.x, old.regulator.x, moved, strict=True)]
        return replace(new.regulator, x=tuple(x))

    def _smooth(self, new: Control, before: Sequence[float], stamp: int, x: Sequence[float]
                ) -> None:
        """Begin a transition from the command `before`."""
        self._jump = None
        if new.rules.transition_time:
            after = self._law(new, self._reference(new, stamp), stamp, x)
            self._jump, self._jumped = list(map(sub, before, after)), stamp

    def _fade(self, u: list[float], stamp: int) -> None:
        """Add what is left of the jump, in place; both ends of its decay are level."""
        time = self._control.rules.transition_time
        s = (stamp - self._jumped) * NS / time if time else 1.0
        if self._jump is None or s >= 1.0:
            self._jump = None
            return
        left = 1.0 - s * s * (3.0 - 2.0 * s)
        for j, jump in enumerate(self._jump):
            u[j] += left * jump

    def _integrate(self, integral: Integral, error: Sequence[float], stamp: int) -> None:
        """
        Advance z by the trapezoidal rule.

        A component rests while an input is beyond a limit and the component would drive it
        further (conditional anti-windup).
        """
        if self.error is None or self._since is None:
            return
        dt = (stamp - self._since) * NS
        timeout = self._control.rules.state_timeout
        if timeout and dt > timeout:
            return  # nobody knows what the plant did meanwhile
        for k, row in enumerate(integral.C):
            now = sum(map(mul, row, error))
            if not any(-gains[k] * now * excess > 0.0
                       for gains, excess in zip(integral.Ki, self._excess, strict=False)):
                self._z[k] += 0.5 * dt * (now + sum(map(mul, row, self.error)))

    def _predict(self, prediction: Prediction, e: Sequence[float], ur: Sequence[float]
                 ) -> list[float]:
        ahead = [sum(map(mul, row, e)) for row in prediction.Phi]
        for Gamma, u in zip(prediction.Gammas, tuple(self._past), strict=False):
            du = list(map(sub, u, ur))
            for i, row in enumerate(Gamma):
                ahead[i] += sum(map(mul, row, du))
        return ahead

    def _remember(self, prediction: Prediction, u: list[float], stamp: int) -> None:
        """Keep a command that is still to take effect; a missed period repeats the last one."""
        periods = 1 if self._sent is None else round((stamp - self._sent) / prediction.period)
        if periods == 0 and self._past:
            self._past[0] = u  # the same state was answered again
            return
        for _ in range(min(periods, len(prediction.Gammas)) - 1):
            self._past.appendleft(self._past[0] if self._past else u)
        self._past.appendleft(u)
        self._sent = stamp
        while len(self._past) > len(prediction.Gammas):
            self._past.pop()

    def _tell(self, kind: str, sentence: str) -> None:
        if self._now - self._told.get(kind, -math.inf) >= _AGAIN:
            self._told[kind] = self._now
            self.news.append(sentence)


class _Clock:
    """Which stamp is in order, and which is due."""

    def __init__(self) -> None:
        self.answered: int | None = None
        self._last: int | None = None
        self._late: int | None = None
        self._due: int | None = None

    def order(self, stamp: int, far: float) -> str:
        """Return '' (later than the last), 'repeated', 'late' or 'restarted'."""
        last, late = self._last, self._late
        if last is not None and stamp < last:
            # two in a row, or far [s] back: no message that another has overtaken
            if not (late is not None and stamp >= late) and (last - stamp) * NS <= far:
                self._late = stamp
                return 'late'
            self.answered = self._due = None
        self._last, self._late = stamp, None
        if last is None or stamp > last:
            return ''
        return 'repeated' if stamp == last else 'restarted'

    def is_due(self, stamp: int, period: int) -> bool:
        """Return whether an answer is due, at most one in `period` [ns]; 0: always."""
        if not period or stamp == self.answered:
            return True
        # early by the rounding of the plant's own period is in time
        if self._due is not None and stamp < self._due - period // 1000:
            return False
        in_step = self._due is not None and stamp - self._due < period
        self._due = (self._due if in_step and self._due is not None else stamp) + period
        return True
