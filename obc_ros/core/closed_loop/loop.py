# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The control loop: from states to commands, with checks of the states and limits of the commands.

A `Control` is constant. A `ControlLoop` holds the memory of a run and returns a command for each
state. The caller passes the time: stamps of the states [ns] for the control law, and a steady
clock [s] for time-outs. The module is long because all methods change the memory of one run.
"""

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import replace
import math
from operator import add, mul, sub

from obc_ros.core.closed_loop import references
from obc_ros.core.closed_loop.control import Control, Prediction, Schedule
from obc_ros.core.closed_loop.feedback import (
    compute_feedback,
    ReferenceLaw,
    ReferencePoint,
    StateFeedback,
)
from obc_ros.core.closed_loop.message_stamps import compute_age, NS, StampOrder
from obc_ros.core.closed_loop.references import Running, set_point

_AGAIN = 1.0  # [s] until the same kind of event is reported again


class SentCommands:
    """The commands that have not acted yet, and the prediction over the delay with them."""

    def __init__(self) -> None:
        self._past: deque[list[float]] = deque()
        self._stamp: int | None = None

    def forget(self) -> None:
        """Forget the commands."""
        self._past.clear()

    def predict(self, prediction: Prediction, e: Sequence[float], ur: Sequence[float], p: int
                ) -> tuple[list[float], Sequence[float]]:
        """Return the error after the delay, and the growth of the p integrals until then."""
        whole = [*e, *[0.0] * p]
        ahead = [sum(map(mul, row, whole)) for row in prediction.Phi]
        for Gamma, u in zip(prediction.Gammas, tuple(self._past), strict=False):
            du = list(map(sub, u, ur))
            for i, row in enumerate(Gamma):
                ahead[i] += sum(map(mul, row, du))
        return ahead[:len(e)], ahead[len(e):]

    def remember(self, prediction: Prediction, u: list[float], stamp: int) -> None:
        """Keep the command for a stamp [ns]; in a missed period the last one still acts."""
        periods = 1 if self._stamp is None else round((stamp - self._stamp) / prediction.period)
        if periods == 0 and self._past:
            self._past[0] = u  # another command for the same state
            return
        for _ in range(min(periods, len(prediction.Gammas)) - 1):
            self._past.appendleft(self._past[0] if self._past else u)
        self._past.appendleft(u)
        self._stamp = stamp
        while len(self._past) > len(prediction.Gammas):
            self._past.pop()


class ControlLoop:
    """
    One run of a control loop.

    `answer` and `overdue` must be called from one thread. `adopt`, `stop` and `start` may be
    called from another thread: each is one assignment.

    A moving set point begins at the plant, in the states along which it moves. It does so when
    the control law begins or resumes, and at each state until a transition to it has ended. A
    later change keeps the position in the states that it does not change.

    Attributes
    ----------
    counts : collections.Counter
        Numbers of events: answered, saturated, skipped, repeated, late, restarted, stale,
        outside, unplanned, and each reason for which a state is dropped (size, finite, old,
        ahead, command).
    news : collections.deque of str
        Warnings, oldest first; each kind at most once a second.
    events : collections.deque of str
        Other messages: references that begin and end, states that return.
    refused : collections.deque of str
        Reasons for which references were rejected.
    stamp : int or None
        Stamp of the last state in order [ns].
    x, command : sequence of float or None
        The last valid state, and the last command.
    error : list of float or None
        x - xr at the last command of the control law.
    stopped : str
        Why the loop is stopped; empty: it is not.
    is_stale, is_outside, is_unplanned : bool
        Whether states are missing, whether the last one was outside `x_limits`, and whether it
        was outside the region of the feedback that was to be used.
    lag : float or None
        Age of the last state [s] from its stamp; None: not known.

    """

    def __init__(self, control: Control) -> None:
        self.counts: Counter[str] = Counter()
        self.news, self.events, self.refused = (deque[str](maxlen=100) for _ in range(3))
        self.stamp: int | None = None
        self.x: Sequence[float] | None = None
        self.command: list[float] | None = None
        self.error: list[float] | None = None
        self.stopped = ''
        self.is_stale = self.is_outside = self.is_unplanned = False
        self.lag: float | None = None
        self._control = self._next = control
        self._followed, self._order = set_point(control, control.regulator, 0), StampOrder()
        self._seen = self._spoken = self._now = -math.inf
        self._reports: dict[str, float] = {}
        self._excess: Sequence[float] = ()
        self._since: int | None = None
        self._reported: ReferenceLaw | None = None
        self._jump: list[float] | None = None
        self._sent = SentCommands()
        self._measured: float | None = None
        self._begin(control)

    @property
    def control(self) -> Control:
        """Return the control that the next state will use."""
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

    def answer(self, stamp: int, x: Sequence[float], now: float, clock: int | None = None,
               measured: float | None = None) -> list[float] | None:
        """
        Return the command (m,) for a state, or None.

        Parameters
        ----------
        stamp : int
            Time of the state [ns].
        x : sequence of float
            The state (n,).
        now : float
            Steady clock [s].
        clock : int, optional
            Present time of the clock of the stamps [ns]; None: the age of a state is not known.
        measured : float, optional
            The scheduling variable, if it is measured.

        Returns
        -------
        list of float or None
            None: the state is dropped or skipped, or the rules ask for silence.

        """
        self._now = now
        if not (self._is_usable(x, measured, now) and self._is_timely(stamp, clock, now)
                and self._is_in_order(stamp)):
            return None
        self._note_outage(now)
        self.x, self._seen, self.is_stale, self._measured = x, now, False, measured
        if not self._order.is_due(stamp, self._next.rules.period):
            self.counts['skipped'] += 1
            return None
        new = self._next
        if not self.stopped:
            self._judge(new, stamp, x)
        if new is not self._control:
            self._take_over(new, stamp, x)
        u = self._decide(self._control, stamp, x)
        if u is None:
            return None
        if not all(map(math.isfinite, u)):
            self.drop('command', f'a command that is not finite ({u}) was dropped', now)
            return None
        self._order.answered = stamp
        self._spoken, self.command = now, u
        self.counts['answered'] += 1
        return u

    def overdue(self, now: float) -> list[float] | None:
        """Return the command while no state arrives; None: none is due."""
        rules = self._next.rules
        if now < self.wake():
            return None
        if not self.is_stale:
            self.is_stale = True
            self.drop('stale', f'no valid state for {rules.state_timeout:g} s; on_stale: '
                               f'{rules.on_stale}', now)
        self._spoken = now
        return self._instead('equilibrium' if self.stopped else rules.on_stale)

    def wake(self) -> float:
        """Return the time of the steady clock [s] at which to call `overdue` next."""
        timeout = self._next.rules.state_timeout
        if self.x is None or not timeout:
            return math.inf
        return (self._spoken if self.is_stale else self._seen) + timeout

    def age(self, now: float) -> float | None:
        """Return the time since the last valid state [s]; None: there was none."""
        return None if self.x is None else now - self._seen

    def preview(self, control: Control) -> list[float] | None:
        """Return the change (m,) of the last command under another control; None: none yet."""
        if self.x is None or self.stamp is None or self.command is None:
            return None
        u = self._input(control, self._ahead(control, self.stamp), self.stamp, self.x)
        control.limits.clip(u)
        return list(map(sub, u, self.command))

    def drop(self, kind: str, sentence: str, now: float) -> None:
        """Count and report a dropped state; `now` is the steady clock [s]."""
        self._now = now
        self.counts[kind] += 1
        self._report(kind, sentence)

    # Checks of a state

    def _note_outage(self, now: float) -> None:
        gap = now - self._seen
        if self.is_stale:
            self._report('back', f'states have returned after {gap:.3g} s', self.events)
        if self.x is not None and 0.0 < self._next.rules.state_timeout <= gap:
            self._lost = gap

    def _is_usable(self, x: Sequence[float], measured: float | None, now: float) -> bool:
        names = self._next.names
        if len(x) != len(names):
            self.drop('size', f'a state with {len(x)} numbers was dropped: wanted {len(names)} '
                              f'({", ".join(names)})', now)
            return False
        if not all(map(math.isfinite, x)):
            wrong = next(i for i, value in enumerate(x) if not math.isfinite(value))
            self.drop('finite', f'a state with {names[wrong]} = {x[wrong]} was dropped', now)
            return False
        if measured is not None and self._next.schedule and not math.isfinite(measured):
            self.drop('finite', f'a state with a speed of {measured} was dropped', now)
            return False
        return True

    def _is_timely(self, stamp: int, clock: int | None, now: float) -> bool:
        timeout = self._next.rules.stamp_timeout
        self.lag = None if clock is None else compute_age(stamp, clock)
        if not timeout or self.lag is None or abs(self.lag) <= timeout:
            return True
        kind, words = ('old', 'before') if self.lag > 0.0 else ('ahead', 'after')
        self.drop(kind, f'a state stamped {abs(self.lag):.3g} s {words} the local time was '
                        f'dropped (stamp_timeout: {timeout:g} s): it is late, or the clocks '
                        'differ', now)
        return False

    def _is_in_order(self, stamp: int) -> bool:
        last, order = self.stamp, self._order.order(stamp, self._next.rules.state_timeout or 1.0)
        if last is not None and order:
            self.counts[order] += 1
            if order == 'late':
                self._report(order, f'a state {(last - stamp) * NS:g} s older than the previous '
                                    'one was dropped')
                return False
            if order == 'restarted':
                self._report(order, f'time went back by {(last - stamp) * NS:g} s: the loop was '
                                    'restarted')
                self._begin(self._next)
        self.stamp = stamp
        return True

    def _judge(self, new: Control, stamp: int, x: Sequence[float]) -> None:
        """Check references when they begin, and the followed one after an outage."""
        if references.has_unjudged(new.legs):
            self.refused.extend(
                references.judge_references(new, *self._expected(self._control, stamp, x)))
        if self._lost and (reason := references.judge_again(new, stamp, x)):
            reason = f'after {self._lost:.3g} s without a state, {reason}'
            self.refused.append(f'{reason}; stopped until ~/start')
            self.stop(reason)
        self._lost = 0.0

    # The command

    def _decide(self, control: Control, stamp: int, x: Sequence[float]) -> list[float] | None:
        if self.stopped:
            return self._instead('equilibrium')
        if self._resting:
            self._resume(control, stamp, x)
        elif self._is_entering and self._followed is self._setpoint:
            self._place(control, stamp, x, self._setpoint.origin)
            self._followed = self._setpoint
        now = self._running(control, stamp)
        ahead = now if control.prediction is None else self._ahead(control, stamp)
        if ahead.law is not self._followed.law:  # a reference has begun or ended
            before = self._going_on(stamp, x)
            self._followed = ahead
            self._smooth(control, before, stamp, x)
        if ahead.law is not self._reported:
            self._reported = ahead.law
            self.events.extend(references.describe_events(control.legs, ahead.law))
        here = self._point(control, now, stamp)
        error = control.limits.error(x, here.x)
        if control.rules.x_limits and self._is_beyond(control, error):
            return self._instead('equilibrium' if self.stopped else control.rules.on_envelope)
        if self._is_unplanned(ahead.law, error):
            return self._instead(control.rules.on_stale)
        if control.C:
            self._integrate(control, here, error, stamp)
        self.error, self._since = error, stamp
        raw = self._law(control, here, error, now, ahead, stamp)
        if self._jump is not None:
            self._fade(raw, stamp)
        u = raw.copy()
        clipped = control.limits.clip(u)
        self.counts['saturated'] += bool(clipped)
        self._excess = list(map(sub, raw, u)) if clipped else ()
        if control.prediction is not None:
            self._sent.remember(control.prediction, u, stamp)
        return u

    def _input(self, control: Control, ahead: Running, stamp: int, x: Sequence[float]
               ) -> list[float]:
        """Return the command of a control law for a state, without limits."""
        now = ahead if control.prediction is None else self._running(control, stamp)
        here = self._point(control, now, stamp)
        return self._law(control, here, control.limits.error(x, here.x), now, ahead, stamp)

    def _law(self, control: Control, here: ReferencePoint, e: list[float], now: Running,
             ahead: Running,
             stamp: int) -> list[float]:
        """Return the unlimited input of the law `ahead`; e is the error from `here` of `now`."""
        point = here
        z: Sequence[float] = ()
        if control.prediction is not None:
            e, z = self._sent.predict(control.prediction, e, here.u, len(control.C))
            if control.legs or control.horizon is not None:
                later = stamp + control.prediction.delay
                point = self._point(control, ahead, later)
                if ahead.law is not now.law:
                    on = self._point(control, now, later).x
                    e = control.limits.error(list(map(add, on, e)), point.x)
        u = compute_feedback(point, e)
        if control.C:
            for j, row in enumerate(point.Ki):
                u[j] -= self._w[j] + sum(map(mul, row, z))
        return u

    def _ahead(self, control: Control, stamp: int) -> Running:
        """Return the control law at the time when the command for a stamp acts."""
        delay = control.prediction.delay if control.prediction is not None else 0
        return self._running(control, stamp + delay)

    def _running(self, control: Control, stamp: int) -> Running:
        """Return the control law at a stamp."""
        if running := references.find_current(control.legs, stamp):
            return running
        if control is self._control:
            return self._setpoint
        return set_point(control, *self._moved(control, stamp))

    def _expected(self, control: Control, stamp: int, x: Sequence[float]
                  ) -> tuple[int, Sequence[float]]:
        """Return the stamp at which the command acts, and the predicted state (n,)."""
        if control.prediction is None:
            return stamp, x
        later, now = stamp + control.prediction.delay, self._running(control, stamp)
        here = self._point(control, now, stamp)
        e, _ = self._sent.predict(control.prediction, control.limits.error(x, here.x), here.u,
                                  len(control.C))
        return later, list(map(add, self._point(control, now, later).x, e))

    def _point(self, control: Control, running: Running, stamp: int) -> ReferencePoint:
        """Return the reference and the gain at a stamp."""
        point = running.law.at((stamp - running.origin) * NS)
        schedule = control.schedule
        if schedule is None or not (running.is_setpoint or schedule.input < 0):
            return point
        K, Ki = schedule.gains.at(self._variable(schedule, point))
        return point._replace(K=K, Ki=Ki)

    def _variable(self, schedule: Schedule, point: ReferencePoint) -> float:
        """Return the scheduling variable: measured, or else from the last command."""
        if self._measured is not None:
            return self._measured
        # Before the first command of the law the plant does not follow a command.
        is_moving = self._since is not None and self.command is not None
        return (self.command if is_moving and self.command else point.u)[schedule.input]

    def _instead(self, action: str) -> list[float] | None:
        """Return the command that replaces the control law."""
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
                    self._report('outside', f'{what}; on_envelope: {control.rules.on_envelope}')
                if control.rules.on_envelope == 'stop':
                    self.stop(what)
                return True
        self.is_outside = False
        return False

    def _is_unplanned(self, law: ReferenceLaw, error: Sequence[float]) -> bool:
        """Return whether an error is outside the region of the feedback that is to be used."""
        region = law.region if isinstance(law, StateFeedback) else None
        value = 0.0 if region is None else region.measure(error)
        was_unplanned = self.is_unplanned
        self.is_unplanned = region is not None and not value <= region.level
        if region is None or not self.is_unplanned:
            if was_unplanned:
                self._report('planned', 'the state can be controlled again', self.events)
            return False
        self.counts['unplanned'] += 1
        self._report('unplanned', f'no plan, and the state is outside the terminal set (its value '
                     f'is {value:.4g}, the level {region.level:.4g}); on_stale: '
                     f'{self._control.rules.on_stale}')
        return True

    # The memory of a run: moving set point, integral, transition, sent commands

    def _begin(self, control: Control) -> None:
        """Reset the memory."""
        references.forget(control.legs)
        self._regulator = control.regulator
        self._setpoint = set_point(control, control.regulator, 0)
        self._followed = self._setpoint
        self._w = [0.0] * len(control.regulator.u)
        self._excess, self._reported = (), None
        self._jump, self._jumped, self._is_entering = None, 0, False
        self._resting, self._lost = True, 0.0
        self._sent = SentCommands()
        self.error = self._since = None

    def _resume(self, control: Control, stamp: int, x: Sequence[float]) -> None:
        """Begin with the control law, or resume it after another command."""
        self._resting = False
        self._w = [0.0] * len(self._w)
        self._since = None
        self._sent.forget()
        self._place(control, stamp, x, stamp)
        self._follow(control, stamp)
        before = self.command or (list(control.rest) if control.rules.from_rest else None)
        if before is not None:
            self._smooth(control, before, stamp, x)
        self._is_entering = self._jump is not None

    def _place(self, control: Control, stamp: int, x: Sequence[float], origin: int) -> None:
        """Put a moving set point at the plant; `origin` is the stamp of its t = 0."""
        here = self._regulator.beside(x, (stamp - self._setpoint.origin) * NS)
        self._hold(control, replace(here, x=here.at((origin - stamp) * NS).x), origin)

    def _hold(self, control: Control, regulator: StateFeedback, origin: int) -> None:
        """Use a regulator for the set point."""
        self._regulator, self._setpoint = regulator, set_point(control, regulator, origin)

    def _follow(self, control: Control, stamp: int) -> None:
        """Store the present control law; references without a beginning begin now."""
        references.begin_now(control.legs, stamp)
        self._followed = self._ahead(control, stamp)

    def _take_over(self, new: Control, stamp: int, x: Sequence[float]) -> None:
        """Replace the control by `new`."""
        before = None
        if not (self._resting or self.stopped or self.command is None):
            before = self._going_on(stamp, x)
        self._hold(new, *self._moved(new, stamp))
        if not (new.C and self._control.C):
            self._w = [0.0] * len(self._w)
        self._control, self._excess = new, ()
        self._follow(new, stamp)
        if before is not None:
            self._smooth(new, before, stamp, x)

    def _going_on(self, stamp: int, x: Sequence[float]) -> list[float]:
        """Return the command of the control law before a change."""
        u = self._input(self._control, self._followed, stamp, x)
        if self._jump is not None:
            self._fade(u, stamp)
        self._control.limits.clip(u)
        return u

    def _moved(self, new: Control, stamp: int) -> tuple[StateFeedback, int]:
        """Return the regulator of `new` at the present set point, and the stamp of t = 0."""
        old = self._control
        moved = self._regulator.at((stamp - self._setpoint.origin) * NS).x
        # Continue from the end of a reference.
        if references.select_accepted(old.legs) and not new.legs:
            here = self._point(old, self._running(old, stamp), stamp).x
            moves = map(any, zip(old.regulator.drift, new.regulator.drift, strict=True))
            moved = tuple([h if v else m for h, m, v in zip(here, moved, moves, strict=True)])
        x = [is_now if wanted == before else wanted for wanted, before, is_now in zip(
            new.regulator.x, old.regulator.x, moved, strict=True)]
        regulator = replace(new.regulator, x=tuple(x))
        if new.horizon is None or references.restarts_horizon(old, new):
            return regulator, stamp
        origin = self._setpoint.origin
        return replace(regulator, x=regulator.at((origin - stamp) * NS).x), origin

    def _smooth(self, new: Control, before: Sequence[float], stamp: int, x: Sequence[float]
                ) -> None:
        """Begin a transition from the command `before`."""
        self._jump = None
        if new.rules.transition_time:
            after = self._input(new, self._followed, stamp, x)
            self._jump, self._jumped = list(map(sub, before, after)), stamp

    def _fade(self, u: list[float], stamp: int) -> None:
        """Add the rest of the jump, in place; it decays with zero slope at both ends."""
        time = self._control.rules.transition_time
        s = (stamp - self._jumped) * NS / time if time else 1.0
        if self._jump is None or s >= 1.0:
            self._jump, self._is_entering = None, False
            return
        left = 1.0 - s * s * (3.0 - 2.0 * s)
        for j, jump in enumerate(self._jump):
            u[j] += left * jump

    def _integrate(self, control: Control, here: ReferencePoint, error: Sequence[float], stamp: int
                   ) -> None:
        """
        Advance w, dw/dt = Ki C e, by the trapezoidal rule.

        The integral of an output is held while an input exceeds a limit and the output would
        increase the excess (conditional anti-windup).
        """
        if self.error is None or self._since is None:
            return
        dt = (stamp - self._since) * NS
        timeout = control.rules.state_timeout
        if timeout and dt > timeout:
            return  # the error in between is not known
        for k, row in enumerate(control.C):
            now = sum(map(mul, row, error))
            if not any(-gains[k] * now * excess > 0.0
                       for gains, excess in zip(here.Ki, self._excess, strict=False)):
                dz = 0.5 * dt * (now + sum(map(mul, row, self.error)))
                for j, gains in enumerate(here.Ki):
                    self._w[j] += gains[k] * dz

    def _report(self, kind: str, sentence: str, queue: deque[str] | None = None) -> None:
        if self._now - self._reports.get(kind, -math.inf) >= _AGAIN:
            self._reports[kind] = self._now
            (self.news if queue is None else queue).append(sentence)
