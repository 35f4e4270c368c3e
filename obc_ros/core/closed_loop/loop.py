# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The control loop: clock, mode machine, law, gate; from a state to the command that answers it.

A `Control` is constant. A `ControlLoop` holds the memory of a run. The caller passes the time:
stamps of the states [ns] for everything that is computed, and a steady clock [s], which only says
that no state arrives.

The module is long because all methods share the memory of one run.
"""

from collections import Counter, deque
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
import math
from operator import add, mul, sub
from threading import RLock
from typing import NamedTuple

from obc_ros.core.closed_loop.clock import NS, Order, Pace, StampClock, Tick
from obc_ros.core.closed_loop.control import Control, Leg, Reference, Schedule
from obc_ros.core.closed_loop.feedback import compute_feedback, ReferencePoint, StateFeedback
from obc_ros.core.closed_loop.laws import (
    Along,
    FollowedLaw,
    free_drift,
    HeldSetPoint,
    PlanLaw,
    select_plan,
)
from obc_ros.core.closed_loop.memory import CommandGate, Integral, SentCommands
from obc_ros.core.closed_loop.modes import (
    Effect,
    Effects,
    Event,
    FOLLOWING,
    Mode,
    NO_EFFECTS,
    switch_mode,
)
from obc_ros.core.closed_loop.references import explain_distance, find_leg, Itinerary

_AGAIN = 1.0        # [s] until the same kind of event is reported again
_REPEAT = 0.05      # [s] between two commands without a state, at least
_TOO_SLOW = 3       # intervals in a row above the longest period


class Followed(NamedTuple):
    """What is followed from a stamp [ns] on: a reference, or the set point."""

    since: int
    reference: Reference | None


class Aim(NamedTuple):
    """The laws at a state, and at the time when its command acts."""

    now: FollowedLaw
    ahead: FollowedLaw


class Fault(NamedTuple):
    """Why the law does not answer: for the log, and as a reason; what a rule asks for instead."""

    sentence: str
    reason: str
    action: str


class Sample(NamedTuple):
    """A state, its stamp [ns], and the command that was sent for it."""

    stamp: int
    x: Sequence[float]
    u: Sequence[float]


class ControlLoop:
    """
    One run of a control loop. All methods may be called from any thread.

    :ivar counts: numbers of events: answered, saturated, skipped, repeated, late, restarted,
        stale, outside, unplanned, slow, and each reason for which a state is dropped (size,
        finite, old, ahead, command).
    :ivar news: warnings, oldest first; each kind at most once a second.
    :ivar events: other messages: the first state, references that begin and end, states that
        return.
    :ivar refused: reasons for which references were rejected or given up.
    :ivar reason: why the loop is resting or stopped; empty: it is neither.
    :ivar run: how often plans were given up: those that began before are not used.
    :ivar stamp, due: stamps [ns] of the last state in order, and of the last one for which a
        command was due.
    :ivar x, error: the last valid state; its error from what was asked for, a set point or a
        reference, at the last command of the control law.
    :ivar lag: age of the last state [s] from its stamp; None: not known.
    :ivar samples: the last two states that the control law has answered, the later one last.
    :ivar is_outside, is_unplanned: whether the last state was outside `x_limits`, and whether
        there was no plan for it and it was outside the region of the feedback.
    """

    def __init__(self, control: Control, mode: Mode = Mode.WAITING) -> None:
        self.counts: Counter[str] = Counter()
        self.news, self.events, self.refused = (deque[str](maxlen=100) for _ in range(3))
        self.mode, self.reason, self.run = mode, '', 0
        self.due: int | None = None
        self.x: Sequence[float] | None = None
        self.error: list[float] | None = None
        self.lag: float | None = None
        self.samples: tuple[Sample, ...] = ()
        self.is_outside = self.is_unplanned = False
        self._lock = RLock()
        self._clock, self._pace, self._gate = StampClock(), Pace(), CommandGate()
        self._control = self._next = control
        self._effects: Effects = NO_EFFECTS
        self._cause = ''
        self._itinerary = Itinerary()
        self._plans: tuple[PlanLaw, ...] = ()
        self._sent, self._integral = SentCommands(), Integral(len(control.rest))
        self._setpoint: HeldSetPoint
        self._course: deque[Followed]
        self._begin_set_point(0)
        self._seen = self._spoken = self._now = -math.inf
        self._reports: dict[str, float] = {}
        self._intervals: deque[float] = deque(maxlen=_TOO_SLOW)
        self._measured: float | None = None
        self._restarts: int | None = None

    @property
    def control(self) -> Control:
        """Return the control that the next state will use."""
        return self._next

    @property
    def stamp(self) -> int | None:
        """Return the stamp of the last state in order [ns]."""
        return self._clock.last

    @property
    def command(self) -> list[float] | None:
        """Return the last command (m,)."""
        return self._gate.sent

    @property
    def is_stopped(self) -> bool:
        """Return whether the loop is stopped."""
        return self.mode is Mode.STOPPED

    @property
    def is_stale(self) -> bool:
        """Return whether states are missing."""
        timeout = self._next.rules.state_timeout
        return self.x is not None and timeout > 0.0 and self._now >= self._seen + timeout

    @property
    def reference(self) -> Reference | None:
        """Return the reference that is followed, or whose end is held."""
        return self._itinerary.followed or self._itinerary.held

    @property
    def interval(self) -> float | None:
        """Return the mean of the last intervals between states [s]; None: not known."""
        known = tuple(self._intervals)
        return sum(known) / len(known) if len(known) == _TOO_SLOW else None

    # What others ask for, from any thread

    def activate(self) -> None:
        """Begin a run; a stop goes on."""
        with self._lock:
            self._clock, self._intervals = StampClock(), deque(maxlen=_TOO_SLOW)
            self.due = None
            self._pace.forget()
            self._gate = CommandGate()
            self.x = self.error = self._restarts = None
            self._seen = self._spoken = -math.inf
            self._step(Event.ACTIVATE, 'the loop waits for a state')

    def deactivate(self) -> list[float] | None:
        """End a run; return the last command (m,), None if there was none before."""
        with self._lock:
            has_spoken = self._gate.sent is not None
            self._step(Event.DEACTIVATE, 'the loop has ended')
            return self._rest() if has_spoken else None

    def stop(self, reason: str) -> None:
        """Command the input at rest until `start`, and give up all references."""
        with self._lock:
            self._step(Event.STOP, f'stopped: {reason}', reason)

    def start(self) -> None:
        """End a stop."""
        with self._lock:
            self._step(Event.START, 'started: the next state begins the control law')

    def adopt(self, control: Control) -> None:
        """Use another control from the next state on."""
        with self._lock:
            self._next = control

    def offer(self, control: Control) -> str:
        """
        Adopt a control whose last reference is new, if the present state is near enough to it.

        :return: why it is rejected, and nothing is adopted; empty: it is accepted. One that begins
            later is judged again at its beginning.
        """
        with self._lock:
            if not (self.mode in FOLLOWING and not self.is_stale and control.legs):
                self._next = control
                return ''
            leg, stamp = control.legs[-1], self._clock.last
            begin = leg.reference.begin
            if stamp is not None and self.x is not None and (begin is None or begin <= stamp):
                reason = self._judge(control, leg, begin, stamp, self.x)
                if reason:
                    return reason
                if begin is None:
                    self._itinerary.set_begin(leg.reference, self._acts(control, stamp))
            self._next = control
            return ''

    def add_plan(self, plan: PlanLaw, run: int) -> bool:
        """
        Use a plan for the states that it covers; the one that covers the last state is kept.

        :param run: `run` at the state from which it was made.
        :return: whether it is used: the law has not begun anew since then.
        """
        with self._lock:
            if run != self.run or self.mode in (Mode.INACTIVE, Mode.STOPPED):
                return False
            now = self._clock.last
            present = None if now is None else select_plan(self._plans, now)
            self._plans = (plan,) if present is None else (present, plan)
            return True

    def reframe(self) -> None:
        """Tell that the next states are in another frame."""
        with self._lock:
            self._step(Event.FRAME, 'the frame of the states has changed: the next state begins '
                                    'the control law')

    def replace_source(self) -> None:
        """Tell that another node publishes the next states."""
        with self._lock:
            self._clock.renew()
            self._cause = 'with another publisher of the states'
            self._step(Event.REPLACED, f'{self._cause} the control law begins anew')

    # Prediction

    def fork(self) -> 'ControlLoop':
        """Return a loop that goes on from here on its own; see `imagine`."""
        with self._lock:
            controls = self._control, self._next
            constant = (*controls, *self._plans, self._setpoint, *(
                leg.reference for control in controls for leg in control.legs))
            return deepcopy(self, {id(each): each for each in constant}
                            | {id(self._lock): RLock()})

    def imagine(self, stamp: int, x: Sequence[float]) -> list[float] | None:
        """Return the command for a predicted state as `answer` does, as if it came in time."""
        last = self._clock.last
        passed = 0.0 if last is None else (stamp - last) * NS
        return self.answer(stamp, x, self._seen + passed, None, self._measured,
                           self._restarts or 0)

    def list_earlier(self) -> list[tuple[int, list[float]]]:
        """Return the commands before the last one that act or will, oldest first, with stamps."""
        prediction = self._control.prediction
        return [] if prediction is None else self._sent.list_earlier(prediction)

    # States and time, in one thread

    def answer(self, stamp: int, x: Sequence[float], now: float, clock: int | None = None,
               measured: float | None = None, restarts: int = 0) -> list[float] | None:
        """
        Return the command (m,) for a state (n,), or None.

        :param stamp: time of the state [ns].
        :param now: steady clock [s].
        :param clock: present time of the clock of the stamps [ns]; None: the age of a state is not
            known.
        :param restarts: how often the source of the states has begun anew.
        :return: None: the state is dropped or skipped, or the rules ask for silence.
        """
        with self._lock:
            self._now = now
            if not (self._is_usable(x, measured) and self._is_timely(stamp, clock)):
                return None
            if self._restarts is not None and restarts != self._restarts:
                self._clock.renew()
            order = self._clock.order(stamp, self._next.rules.state_timeout)
            if order.tick is Tick.LATE:
                self.counts['late'] += 1
                self._report('late', f'a state {order.by:g} s older than the previous one was '
                                     'dropped')
                return None
            self._note_order(order, restarts)
            before, dropped = (self.x, self._seen, self._measured), self.counts['command']
            self.x, self._seen, self._measured = x, now, measured
            if not self._pace.is_due(stamp, self._next.rules.period):
                self.counts['skipped'] += 1
                return None
            self.due = stamp
            u = self._answer_due(stamp, x)
            if self.counts['command'] > dropped:   # a state that has no answer is not valid
                self.x, self._seen, self._measured = before
            if u is not None:
                self._spoken = now
                self.counts['answered'] += 1
            return u

    def overdue(self, now: float) -> list[float] | None:
        """Return the command that is due without a state; None: none is."""
        with self._lock:
            self._now, rules = now, self._next.rules
            if now < self.wake():
                return None
            if self.is_stale and self.mode not in (Mode.RESTING, Mode.STOPPED):
                self.counts['stale'] += 1
                words = f'no valid state for {rules.state_timeout:g} s'
                self._step(Event.LOST, f'{words}; on_stale: {rules.on_stale}', words)
            self._spoken = now
            if self.is_stopped:
                return self._rest()
            return self._act(rules.on_stale) if self.mode is Mode.RESTING else None

    def wake(self) -> float:
        """Return the time of the steady clock [s] at which to call `overdue` next."""
        rest = self._gate.sent is not None and self.mode is Mode.STOPPED
        if rest and self._gate.sent != self._clip_rest():
            return -math.inf   # a stop is not to wait for a state
        timeout = self._next.rules.state_timeout
        if self.x is None or not timeout or self.mode is Mode.INACTIVE:
            return math.inf
        return max(self._seen + timeout, self._spoken + max(timeout, _REPEAT)
                   if self._spoken > self._seen else -math.inf)

    def age(self, now: float) -> float | None:
        """Return the time since the last valid state [s]; None: there was none."""
        return None if self.x is None else now - self._seen

    def preview(self, control: Control) -> list[float] | None:
        """Return the change (m,) of the last command under another control; None: none yet."""
        with self._lock:
            stamp, sent = self._clock.last, self._gate.sent
            if self.x is None or stamp is None or sent is None:
                return None
            at = self._carry_set_point(control, stamp, self.x, is_withdrawn=False)
            aim = self._aim(control, at, stamp)
            here = self._point(control, aim.now, stamp)
            u = self._compute(control, aim, here, stamp, control.limits.error(self.x, here.x))
            control.limits.clip(u)
            return list(map(sub, u, sent))

    def drop(self, kind: str, sentence: str, now: float) -> None:
        """Count and report a dropped state; `now` is the steady clock [s]."""
        with self._lock:
            self._now = now
            self.counts[kind] += 1
            self._report(kind, sentence)

    # Events of a state

    def _is_usable(self, x: Sequence[float], measured: float | None) -> bool:
        names = self._next.names
        if len(x) != len(names):
            self.drop('size', f'a state with {len(x)} numbers was dropped: wanted {len(names)} '
                              f'({", ".join(names)})', self._now)
            return False
        if not all(map(math.isfinite, x)):
            wrong = next(i for i, value in enumerate(x) if not math.isfinite(value))
            self.drop('finite', f'a state with {names[wrong]} = {x[wrong]} was dropped',
                      self._now)
            return False
        if measured is not None and self._next.schedule and not math.isfinite(measured):
            self.drop('finite', f'a state with a speed of {measured} was dropped', self._now)
            return False
        return True

    def _is_timely(self, stamp: int, clock: int | None) -> bool:
        timeout = self._next.rules.stamp_timeout
        self.lag = None if clock is None else (clock - stamp) * NS
        if not timeout or self.lag is None or abs(self.lag) <= timeout:
            return True
        kind, words = ('old', 'before') if self.lag > 0.0 else ('ahead', 'after')
        self.drop(kind, f'a state stamped {abs(self.lag):.3g} s {words} the local time was '
                        f'dropped (stamp_timeout: {timeout:g} s): it is late, or the clocks '
                        'differ: set use_sim_time for a simulation, or stamp_timeout: 0 for '
                        'clocks that are not synchronised',
                  self._now)
        return False

    def _note_order(self, order: Order, restarts: int) -> None:
        """Report the events that the stamps and the source of a state tell of."""
        gap = self._now - self._seen
        if order.tick is Tick.NEXT:
            self._gate.advance(order.by)
            self._intervals.append(order.by)
        elif order.tick is Tick.FIRST:
            self._pace.forget()
        elif order.tick is Tick.SAME:
            self.counts['repeated'] += 1
        elif order.tick is Tick.RESTART:
            self.counts['restarted'] += 1
            self._pace.forget()
            self._intervals.clear()
            self._step(Event.RESTART, f'time went back by {order.by:g} s: the loop was restarted')
        elif order.tick is Tick.OUTAGE:
            self._intervals.append(order.by)
            self._cause = f'after {order.by:.3g} s without a state'
            self._step(Event.OUTAGE, f'{self._cause} the control law begins anew')
        if self.is_stale:
            self._cause = f'after {gap:.3g} s without a state'
            self._step(Event.BACK, f'states have returned after {gap:.3g} s')
        if self._restarts is not None and restarts != self._restarts:
            self._cause = 'after a new beginning of the source of the states'
            self._step(Event.JUMP, f'{self._cause} the control law begins anew')
        self._restarts = restarts

    def _step(self, event: Event, sentence: str, reason: str = '') -> None:
        """Switch the mode by the table; collect the effects, and say what has happened."""
        before, change = self.mode, switch_mode(self.mode, event)
        if change.mode is before and not change.effects:
            return
        self._effects |= change.effects
        self.mode = change.mode
        if change.mode is not before or change.mode is Mode.STOPPED and event is Event.STOP:
            self.reason = reason if change.mode in (Mode.RESTING, Mode.STOPPED) else ''
        if change.mode is not before or change.effects - {Effect.FADE}:
            is_warning = change.mode in (Mode.RESTING, Mode.STOPPED) or event in _WARNED
            self._report(event.name, sentence, self.news if is_warning else self.events)
        if not change.effects.isdisjoint((Effect.DROP, Effect.CLEAR)):
            self._plans, self.run = (), self.run + 1
        if Effect.DROP in change.effects:
            self._effects = NO_EFFECTS
            self._begin_set_point(self._clock.last or 0)
            self.refused.extend([sentence] * self._itinerary.drop(self._next.legs))

    # The answer to a state

    def _answer_due(self, stamp: int, x: Sequence[float]) -> list[float] | None:
        if self.is_stopped:
            return self._rest()
        if self.mode is Mode.INACTIVE:
            return None
        former = self._control, self._aim_now(stamp)   # what would have gone on
        was_following = self.mode in FOLLOWING
        if self._next is not self._control:
            self._take_over(self._next, stamp, x)
        self._step(Event.STATE, 'the control law begins')
        control = self._control
        if self.mode is Mode.RESTING:
            here = self._point(control, self._aim_now(stamp).now, stamp)
            error = control.limits.error(x, here.x)
            if fault := self._find_fault(control, stamp, x, here, error):
                return self._act(fault.action)
            self._step(Event.RESUME, 'the control law is resumed')
        if Effect.PLACE in self._effects or control.prediction is None:
            self._sent.forget()
        if control.legs:
            if not self._judge_references(control, stamp, x):
                return self._rest()
            self._end_reference(control, stamp)
        self._choose_plan(stamp)
        # Without an effect, what would have gone on goes on; an entry moves the set point.
        aim = former[1]
        if self._effects or self._gate.is_entering:
            self._place(control, stamp, x)
            aim = self._aim_now(stamp)
        here = self._point(control, aim.now, stamp)
        error = control.limits.error(x, here.x)
        if fault := self._find_fault(control, stamp, x, here, error):
            return self._interrupt(fault)
        if control.C:
            self._integral.advance(control.C, here.Ki, error, stamp)
        raw = self._compute(control, aim, here, stamp, error)
        if Effect.FADE in self._effects:
            self._fade(control, raw, stamp, x, former if was_following else None)
        return self._send(control, raw, stamp, x)

    def _place(self, control: Control, stamp: int, x: Sequence[float]) -> None:
        """Let the law begin or go on at a state."""
        is_anew = Effect.ANEW in self._effects
        if is_anew:
            self._integral = Integral(len(control.rest))
        if Effect.PLACE in self._effects:
            self._integral.pause()
        if Effect.PLACE in self._effects or (
                self._gate.is_entering and self._itinerary.followed is None):
            self._setpoint = self._setpoint.place(
                x, stamp, control.limits.error, stamp if is_anew else self._setpoint.origin)

    def _judge_references(self, control: Control, stamp: int, x: Sequence[float]) -> bool:
        """
        Let near references begin, and judge the followed one again after a discontinuity.

        :return: False: the followed one is too far, and the loop is stopped.
        """
        acts = self._acts(control, stamp)
        for leg in list(self._itinerary.find_due(control.legs, acts)):
            begin = self._itinerary.find_begin(leg.reference)
            reason = self._judge(control, leg, begin, stamp, x)
            if reason:
                self._itinerary.reject(leg)
                self.refused.append(reason)
                continue
            self._itinerary.begin(leg, acts)
            self._course.append(Followed(acts, leg.reference))
            self._effects -= {Effect.JUDGE}
            self._step(Event.BEGIN, '')
            self.events.append(f'the reference of {leg.reference.duration:g} s begins')
        followed = find_leg(control.legs, self._itinerary.followed)
        if followed is None or Effect.JUDGE not in self._effects:
            return True
        reason = self._judge(
            control, followed, self._itinerary.get_begin(followed.reference), stamp, x)
        if reason:
            reason = f'{self._cause}, {reason}'
            self._step(Event.STOP, f'{reason}; stopped until ~/start', reason)
            return False
        if self.mode is not Mode.REFERENCE:
            self._step(Event.BEGIN, 'the reference is followed again')
        return True

    def _end_reference(self, control: Control, stamp: int) -> None:
        """Hold the end of the followed reference from its end on."""
        followed = self._itinerary.followed
        leg, acts = find_leg(control.legs, followed), self._acts(control, stamp)
        if followed is None or leg is None or acts < (end := self._itinerary.get_end(followed)):
            return
        self._itinerary.end()
        self._setpoint = HeldSetPoint(leg.after, leg.after.x, end, is_designed=False)
        self._course.append(Followed(acts, None))
        self._step(Event.END, f'the reference of {followed.duration:g} s has ended')

    def _choose_plan(self, stamp: int) -> None:
        if not self._plans and self.mode is not Mode.PLAN:
            return
        if select_plan(self._plans, stamp) is not None:
            self._step(Event.PLANNED, 'the plan is followed')
        else:
            self._step(Event.UNPLANNED, 'no plan for this state')

    def _find_fault(self, control: Control, stamp: int, x: Sequence[float], here: ReferencePoint,
                    error: list[float]) -> Fault | None:
        """
        Return why a rule does not let the law answer a state, and what it asks for.

        `here` is the target at the stamp, and `error` that of the state from it.
        """
        rules, asked = control.rules, self._find_asked(control, stamp, x, here)
        self.error = error if asked is here.x else control.limits.error(x, asked)
        if what := self._explain_excess(control, self.error) or self._explain_slowness(control):
            return Fault(f'{what}; on_envelope: {rules.on_envelope}', what, rules.on_envelope)
        what = self._explain_no_plan(control, stamp, self.error)
        if self.is_unplanned and not what:
            self._report('planned', 'the state can be controlled again', self.events)
        self.is_unplanned = bool(what)
        if not what:
            return None
        self.counts['unplanned'] += 1
        sentence = f'{what}; on_unplanned: {rules.on_unplanned}'
        if rules.on_unplanned == 'regulator':
            self._report('unplanned', sentence)
            return None
        return Fault(sentence, what, rules.on_unplanned)

    def _interrupt(self, fault: Fault) -> list[float] | None:
        """Stop or suspend the law; return the command that replaces it."""
        if fault.action == 'stop':
            self._step(Event.STOP, f'stopped: {fault.reason}', fault.reason)
            return self._rest()
        self._step(Event.SUSPEND, fault.sentence, fault.reason)
        return self._act(fault.action)

    def _send(self, control: Control, raw: Sequence[float], stamp: int, x: Sequence[float]
              ) -> list[float] | None:
        """Return an input of the control law as a command, through the gate."""
        wanted = self._gate.smooth(raw)
        u = self._gate.let_through(wanted, control.limits)
        if u is None:
            self._integral = Integral(len(control.rest))
            self.drop('command', f'a command that is not finite ({wanted}) was dropped', self._now)
            return None
        self._effects = NO_EFFECTS
        self.counts['saturated'] += u != wanted
        if control.C:
            self._integral.note(wanted, u)
        if control.prediction is not None:
            self._sent.remember(control.prediction, u, stamp)
        self.samples = (*self.samples[-1:], Sample(stamp, x, u))
        return u

    def _fade(self, control: Control, raw: Sequence[float], stamp: int, x: Sequence[float],
              former: tuple[Control, Aim] | None) -> None:
        """Begin a transition: from the command that would have gone on, or that was sent last."""
        gate, time = self._gate, control.rules.transition_time
        if former is None or Effect.PLACE in self._effects:
            before = gate.sent or (list(control.rest) if control.rules.from_rest else None)
            if before is not None:
                gate.enter(before, raw, time)
            return
        old, aim = former
        here = self._point(old, aim.now, stamp)
        before = gate.smooth(self._compute(old, aim, here, stamp, old.limits.error(x, here.x)))
        old.limits.clip(before)
        gate.leave(before, gate.smooth(raw), time)

    def _act(self, action: str) -> list[float] | None:
        """Return the command that replaces the control law."""
        if action == 'hold':
            held = self._gate.sent
            return held and self._gate.let_through(held, self._next.limits)
        return self._rest() if action == 'equilibrium' else None

    def _rest(self) -> list[float] | None:
        self._gate.settle()
        return self._gate.let_through(self._next.rest, self._next.limits)

    def _clip_rest(self) -> list[float]:
        rest = list(self._next.rest)
        self._next.limits.clip(rest)
        return rest

    # The rules

    def _find_asked(self, control: Control, stamp: int, x: Sequence[float], here: ReferencePoint
                    ) -> Sequence[float]:
        """Return what was asked for: a point of the reference, or of the set point."""
        if self._itinerary.followed is not None or self.mode is Mode.SET_POINT:
            return here.x
        # A plan, or a law that will begin, goes on along the drift from where the plant is.
        return free_drift(x, self._setpoint.at(stamp).x, self._setpoint.law.drift,
                          control.limits.error)

    def _explain_excess(self, control: Control, error: Sequence[float]) -> str:
        """Return which error is outside of `x_limits`; empty: none is."""
        was_outside, self.is_outside = self.is_outside, False
        for index, (lower, upper) in enumerate(control.rules.x_limits):
            if not lower <= error[index] <= upper:
                self.counts['outside'] += not was_outside
                self.is_outside = True
                return (f'the error of {control.names[index]} is {error[index]:g}, outside '
                        f'[{lower:g}, {upper:g}]')
        return ''

    def _explain_slowness(self, control: Control) -> str:
        """Return by how much states are too far apart for the gain; empty: they are not."""
        longest = control.longest_period if control.rules.state_timeout else math.inf
        if len(self._intervals) < _TOO_SLOW or min(self._intervals) <= longest:
            return ''
        self.counts['slow'] += 1
        return (f'the last {_TOO_SLOW} states were {min(self._intervals):.3g} s apart or more: '
                f'held longer than {longest:.3g} s the gain is unstable')

    def _explain_no_plan(self, control: Control, stamp: int, error: Sequence[float]) -> str:
        """Return that a state has no plan and is outside the region of the feedback, or ''."""
        region = control.regulator.region
        if region is None or select_plan(self._plans, stamp) is not None or (
                value := region.measure(error)) <= region.level:
            return ''
        return ('no plan, and the state is outside the terminal set (its value is '
                f'{value:.4g}, the level {region.level:.4g})')

    # Laws

    def _acts(self, control: Control, stamp: int) -> int:
        """Return the stamp [ns] at which the command for a stamp takes effect."""
        return stamp + (control.prediction.delay if control.prediction is not None else 0)

    def _aim_now(self, stamp: int) -> Aim:
        """Return what is followed, and forget what was followed before."""
        while len(self._course) > 1 and self._course[1].since <= stamp:
            self._course.popleft()
        return self._aim(self._control, self._setpoint, stamp)

    def _aim(self, control: Control, setpoint: HeldSetPoint, stamp: int) -> Aim:
        """Return the laws at a stamp [ns] and at the time when its command acts."""
        if self.mode is Mode.PLAN and control is self._control:
            plan = select_plan(self._plans, stamp)
            if plan is not None:
                return Aim(plan, plan)
        if not control.legs:
            return Aim(setpoint, setpoint)
        now = self._find_followed(stamp)
        later = now if control.prediction is None else self._find_followed(
            self._acts(control, stamp))
        law = self._resolve(control, setpoint, now)
        return Aim(law, law if later is now else self._resolve(control, setpoint, later))

    def _find_followed(self, stamp: int) -> Followed:
        """Return what is followed at a stamp [ns]."""
        return next((each for each in reversed(self._course) if each.since <= stamp),
                    self._course[0])

    def _resolve(self, control: Control, setpoint: HeldSetPoint, followed: Followed
                 ) -> FollowedLaw:
        leg = find_leg(control.legs, followed.reference)
        if leg is None or followed.reference is None:
            return setpoint
        return Along(leg.along, self._itinerary.get_begin(followed.reference))

    def _point(self, control: Control, law: FollowedLaw, stamp: int) -> ReferencePoint:
        """Return the target and the gain of a law at a stamp [ns]."""
        point, schedule = law.at(stamp), control.schedule
        if schedule is None or isinstance(law, PlanLaw) or not (
                schedule.input < 0 or isinstance(law, HeldSetPoint) and law.is_designed):
            return point
        K, Ki = schedule.gains.at(self._variable(schedule, point))
        return point._replace(K=K, Ki=Ki)

    def _variable(self, schedule: Schedule, point: ReferencePoint) -> float:
        """Return the scheduling variable: measured, or else from the last command."""
        if self._measured is not None:
            return self._measured
        # Before the first command of the law the plant does not follow a command.
        has_begun = self.mode in FOLLOWING and Effect.PLACE not in self._effects
        return (self._gate.sent if has_begun and self._gate.sent else point.u)[schedule.input]

    def _compute(self, control: Control, aim: Aim, here: ReferencePoint, stamp: int,
                 error: Sequence[float]) -> list[float]:
        """
        Return the input of the law at the time when it acts, without limits.

        `here` is the target at the stamp, and `error` that of the state from it.
        """
        e, point = error, here
        z: Sequence[float] = ()
        if control.prediction is not None:
            e, z = self._sent.predict(control.prediction, error, here.u, len(control.C), stamp)
            later = self._acts(control, stamp)
            point = self._point(control, aim.ahead, later)
            if aim.ahead is not aim.now:
                on = self._point(control, aim.now, later).x
                e = control.limits.error(list(map(add, on, e)), point.x)
        u = compute_feedback(point, e)
        for j, row in enumerate(point.Ki if control.C else ()):
            u[j] -= self._integral.w[j] + sum(map(mul, row, z))
        return u

    def _judge(self, control: Control, leg: Leg, begin: int | None, stamp: int,
               x: Sequence[float]) -> str:
        """Return why a state is too far from a reference where its command acts; empty: near."""
        acts = self._acts(control, stamp)
        begin = acts if begin is None else begin
        t, end = (acts - begin) * NS, leg.reference.duration
        wanted = leg.along.at(t) if t < end else leg.after.at(t - end)
        return explain_distance(control, leg, t, self._expect(stamp, x), wanted.x)

    def _expect(self, stamp: int, x: Sequence[float]) -> Sequence[float]:
        """Return the state (n,) that is predicted for the time when a command acts."""
        control = self._control
        if control.prediction is None:
            return x
        law, later = self._aim(control, self._setpoint, stamp).now, self._acts(control, stamp)
        here = self._point(control, law, stamp)
        e, _ = self._sent.predict(control.prediction, control.limits.error(x, here.x), here.u,
                                  len(control.C), stamp)
        return list(map(add, self._point(control, law, later).x, e))

    # Changes of the control

    def _begin_set_point(self, origin: int) -> None:
        """Let the set point of the parameters begin at a stamp [ns]."""
        law = _design_law(self._control)
        self._setpoint = HeldSetPoint(law, law.x, origin)
        self._course = deque([Followed(origin, None)])

    def _carry_set_point(self, new: Control, stamp: int, x: Sequence[float], is_withdrawn: bool
                         ) -> HeldSetPoint:
        """Return the present set point by another design; another one begins beside the state."""
        held = find_leg(new.legs, self._itinerary.held)
        if held is not None:
            return self._setpoint.carry(held.after, stamp, restarts=False)
        law, old = _design_law(new), self._control
        if is_withdrawn or self.mode is Mode.WAITING or not self._setpoint.is_designed:
            return HeldSetPoint(law, law.x, stamp)
        restarts = new.horizon is None or (
            old.horizon is None or old.horizon.time != new.horizon.time
            or (old.regulator.x, old.regulator.u) != (new.regulator.x, new.regulator.u))
        carried = self._setpoint.carry(law, stamp, restarts)
        if self._setpoint.is_of(law):
            return carried
        return carried.place(x, stamp, new.limits.error, carried.origin)

    def _take_over(self, new: Control, stamp: int, x: Sequence[float]) -> None:
        is_withdrawn = self._itinerary.keep(new.legs)
        self._setpoint = self._carry_set_point(new, stamp, x, is_withdrawn)
        if not (new.C and self._control.C):
            self._integral = Integral(len(new.rest))
        self._integral.note((), ())
        self._control = new
        self._step(Event.ADOPT, '')
        if is_withdrawn:
            self._course = deque([Followed(stamp, None)])
            self._step(Event.WITHDRAWN, 'the reference is given up: the set point is held')

    def _report(self, kind: str, sentence: str, queue: deque[str] | None = None) -> None:
        last = self._reports.get(kind)
        if sentence and (last is None or self._now - last >= _AGAIN):
            self._reports[kind] = self._now
            (self.news if queue is None else queue).append(sentence)


_WARNED = (Event.RESTART, Event.OUTAGE, Event.JUMP, Event.REPLACED, Event.FRAME)


def _design_law(control: Control) -> StateFeedback:
    """Return the law of the set point of a control, with the gains of its horizon if any."""
    if control.horizon is None:
        return control.regulator
    return replace(control.regulator, gains=control.horizon.gains)
