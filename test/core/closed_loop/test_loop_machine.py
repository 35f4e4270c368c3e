# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Any sequence of events of the control loop: what always holds, in all worlds alike."""

from dataclasses import replace
import math
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    initialize,
    precondition,
    rule,
    RuleBasedStateMachine,
    run_state_machine_as_test,
)
from loop_bench import MS, S
from loop_worlds import ALLOWED, DRIFTS, PERIOD, Route, Setup, TARGETS, World
from obc_ros.core.closed_loop.control import ENVELOPE, Rules, STALE, UNPLANNED
from obc_ros.core.closed_loop.modes import FOLLOWING, Mode
import pytest

STEPS = 100          # of a sequence
FAR = 86_400 * S     # [ns] by which one world's stamps are later
BOX = ((-9.0, 9.0),) * 4
TURNED = math.cos(0.7), math.sin(0.7)
STILL = (0.0,) * 4

jitter = st.tuples(*[st.integers(-9, 9)] * 4)
rarely = st.sampled_from([False] * 4 + [True])
steps = st.sampled_from([0, 1, 20, 50, 100, 100, 100, 250])   # [ms]


@pytest.mark.slow
def test_what_always_holds(pytestconfig: pytest.Config) -> None:
    """Run `--steps` random events; each sequence has 100."""
    run_state_machine_as_test(LoopMachine, settings=settings(
        max_examples=max(pytestconfig.getoption('steps') // STEPS, 1),
        stateful_step_count=STEPS, deadline=None))


def are_near(a: Any, b: Any) -> bool:
    """Return whether commands are equal to rounding, or neither is given."""
    if a is None or b is None:
        return a is b
    return all(math.isclose(*each, rel_tol=1e-7, abs_tol=1e-7) for each in zip(a, b, strict=True))


class LoopMachine(RuleBasedStateMachine):
    """A loop, its twins in other worlds, and what is known about its references and plans."""

    @initialize(moves=st.sampled_from(DRIFTS), delay=st.sampled_from([0, 0, 1, 2]),
                is_boxed=st.booleans(), has_integral=st.booleans(), has_region=st.booleans(),
                longest=st.sampled_from([math.inf, math.inf, 0.2]),
                period=st.sampled_from([0, 0, PERIOD]), stale=st.sampled_from(STALE),
                envelope=st.sampled_from(ENVELOPE), unplanned=st.sampled_from(UNPLANNED),
                transition=st.sampled_from([0.0, 0.5]), timeout=st.sampled_from([0.5, 0.5, 0.0]),
                from_rest=st.booleans())
    def begin(self, moves: Any, delay: int, is_boxed: bool, has_integral: bool, has_region: bool,
              longest: float, period: int, stale: str, envelope: str, unplanned: str,
              transition: float, timeout: float, from_rest: bool) -> None:
        """Begin with any rules; limits of single inputs and states need a plane on the axes."""
        self.is_boxed = is_boxed
        # Anti-windup is not continuous: an input at its limit exceeds it by rounding, or does not.
        has_integral &= not is_boxed
        rules = Rules(period, timeout, stale, BOX if is_boxed else (), envelope, unplanned,
                      transition, from_rest)
        self.setup = Setup(rules, drift=moves, limit=5.0 if is_boxed else math.inf, delay=delay,
                           has_integral=has_integral, has_region=has_region, longest=longest)
        self.worlds = World(), World(shift=FAR), World(repeats=True), World(
            turn=(0.0, 1.0) if is_boxed else TURNED)
        for world in self.worlds:
            world.begin(self.setup)
        self.loop = self.worlds[0].loop
        self.stamp, self.now, self.restarts = 1000 * S, 50.0, 0
        self.known, self.is_replaced = 0, False
        self.is_behind = False             # whether a source was behind the one before
        self.last: int | None = None       # stamp in order
        self.x = [0.0] * 4
        self.routes: dict[int, Route] = {}
        self.begins: dict[int, int] = {}   # [ns] of those that have begun
        self.followed: int | None = None
        self.over: set[int] = set()
        self.dropped: set[int] = set()
        self.runs = [0]
        self.is_active = self.is_unjudged = self.has_plan = False
        self.told = (-math.inf, self.loop.mode)
        self.activate()

    # Events

    def tell(self, method: str, *given: Any) -> list[Any]:
        """Call a method of the loop in every world."""
        return [getattr(world.loop, method)(*given) for world in self.worlds]

    @precondition(lambda self: not self.is_active)
    @rule()
    def activate(self) -> None:
        """Begin a run."""
        self.is_active, self.last, self.is_replaced = True, None, False
        if self.loop.mode in (Mode.RESTING, *FOLLOWING):   # after a stop and a start
            self.lose()
        self.tell('activate')
        self.check_modes()

    @precondition(lambda self: self.is_active)
    @rule(is_now=rarely)
    def deactivate(self, is_now: bool) -> None:
        """End a run; the last command is the input at rest."""
        if not is_now:
            return
        self.is_active = False
        self.lose()
        self.check_commands(self.tell('deactivate'))
        assert self.loop.mode in (Mode.INACTIVE, Mode.STOPPED)
        self.check_modes()

    @rule(is_now=rarely)
    def stop(self, is_now: bool) -> None:
        """Stop; the input at rest is due at once if there was a command."""
        if not is_now:
            return
        self.lose()
        self.tell('stop', 'by test')
        assert self.loop.mode is Mode.STOPPED
        self.check_modes()
        had = self.loop.command is not None
        self.tell('overdue', self.now)
        assert not had or self.loop.command == self.find_rest()
        self.check_commands([world.loop.command for world in self.worlds])

    @rule()
    def start(self) -> None:
        """Start: it is a beginning, or nothing."""
        before = self.loop.mode
        self.tell('start')
        assert self.loop.mode is (Mode.WAITING if before is Mode.STOPPED else before)
        self.check_modes()

    @rule(is_now=rarely)
    def reframe(self, is_now: bool) -> None:
        """Change the frame."""
        if not is_now:
            return
        self.lose()
        self.tell('reframe')
        assert self.loop.mode not in FOLLOWING
        self.check_modes()

    @rule(is_now=rarely)
    def replace_source(self, is_now: bool) -> None:
        """Let another node publish the states."""
        if not is_now:
            return
        self.doubt()
        self.is_replaced = True
        self.tell('replace_source')
        self.check_modes()

    @rule(is_now=rarely)
    def restart_source(self, is_now: bool) -> None:
        """Let the source begin anew; the next state tells it."""
        self.restarts += is_now

    @rule(wait=st.sampled_from([0.0, 0.1, 0.6, 3.0]))
    def be_silent(self, wait: float) -> None:
        """Let time pass without a state."""
        self.now += wait
        self.check_commands(self.tell('overdue', self.now))
        self.check_modes()

    @rule(ms=steps, near=jitter)
    def send_next(self, ms: int, near: Any) -> None:
        """Send a state near to what is followed."""
        self.send(self.stamp + ms * MS, near, 0.03, ms * 1e-3)

    @rule(near=jitter, count=st.integers(1, 3))
    def send_more(self, near: Any, count: int) -> None:
        """Run the loop, if it does not, with states near to what is followed."""
        if not self.is_active:
            self.activate()
        if self.loop.mode is Mode.STOPPED:
            self.start()
        for _ in range(count):
            self.send_next(100, near)

    @rule(near=jitter, count=st.integers(1, 3), duration=st.sampled_from([0.2, 4.0, 4.0]),
          gap=st.sampled_from([0, 0, 700]))
    def follow(self, near: Any, count: int, duration: float, gap: int) -> None:
        """Follow a new reference, or try to; then let the plant be elsewhere, after a gap."""
        self.send_more(near, 1)
        self.offer(None, near, duration, True, False)
        self.send_more(near, count)
        if gap:
            self.send(self.stamp + gap * MS, near, 0.9, 0.1)

    @rule(near=jitter, count=st.integers(1, 3), samples=st.sampled_from([1, 2, 20]))
    def follow_plans(self, near: Any, count: int, samples: int) -> None:
        """Follow a plan that each state renews."""
        for _ in range(count):
            self.send_more(near, 1)
            self.plan(1, samples, near, False)

    @rule(ms=steps, far=jitter, is_now=rarely)
    def send_far(self, ms: int, far: Any, is_now: bool) -> None:
        """Send a state elsewhere."""
        if is_now:
            self.send(self.stamp + ms * MS, far, 1.73, ms * 1e-3)

    @rule(ms=st.sampled_from([-1, -20, -300, 700, 700, 20_000, -700, -5_000]), offsets=jitter,
          size=st.sampled_from([0.03, 0.03, 0.9]), wait=st.sampled_from([0.0, 0.1, 2.0]))
    def jump(self, ms: int, offsets: Any, size: float, wait: float) -> None:
        """Send a state whose stamp is late or jumps."""
        self.send(self.stamp + ms * MS, offsets, size, wait)

    @rule(x=st.sampled_from([(math.nan, *STILL[1:]), (*STILL[1:], -math.inf), (), STILL * 2]))
    def send_nonsense(self, x: Any) -> None:
        """Send what is no state: nothing changes."""
        before = self.loop.mode, self.loop.command, self.loop.reference
        assert self.tell('answer', self.stamp + 1, x, self.now) == [None] * len(self.worlds)
        assert before == (self.loop.mode, self.loop.command, self.loop.reference)

    @rule(what=st.sampled_from(['gain', 'target', 'drift', 'rules', 'limit', 'stale', 'timeout',
                                'transition', 'delay', 'integral']),
          pick=st.integers(0, 2))
    def adopt(self, what: str, pick: int) -> None:
        """Change a parameter."""
        setup, rules = self.setup, self.setup.rules
        changed: dict[str, Any] = {
            'gain': {'gain': (0.7, 1.0, 1.6)[pick]},
            'target': {'target': TARGETS[pick], 'legs': ()},
            'drift': {'drift': DRIFTS[pick], 'legs': ()},
            'limit': {'limit': (0.5, 2.0, 5.0)[pick] if self.is_boxed else math.inf},
            'rules': {'rules': replace(rules, on_envelope=ENVELOPE[pick],
                                       on_unplanned=UNPLANNED[pick])},
            'stale': {'rules': replace(rules, on_stale=STALE[pick])},
            'timeout': {'rules': replace(rules, state_timeout=(0.0, 0.3, 0.5)[pick])},
            'transition': {'rules': replace(rules, transition_time=(0.0, 0.4, 1.0)[pick])},
            'delay': {'delay': pick},
            'integral': {'has_integral': bool(pick) and not self.is_boxed}}[what]
        self.setup = setup._replace(**changed)
        for world in self.worlds:
            world.loop.adopt(world.make(self.setup))

    @rule(begin=st.sampled_from([None, None, -5_000, -300, 0, 100, 500]), near=jitter,
          duration=st.sampled_from([0.2, 1.0, 4.0]), is_judged=st.booleans(),
          keeps=st.booleans())
    def offer(self, begin: int | None, near: Any, duration: float, is_judged: bool, keeps: bool
              ) -> None:
        """Offer a reference that begins with the next state, earlier or later."""
        number = len(self.routes)
        start = tuple(a + 0.05 * b for a, b in zip(self.x, near, strict=False))[:2]
        route = Route(None if begin is None else self.stamp + begin * MS, duration, start,
                      tuple(self.x[2:]), is_judged or self.is_boxed and not keeps)
        route = route._replace(is_judged=route.is_judged and self.is_boxed)
        self.routes[number] = route
        legs = (*(self.setup.legs if keeps else ()), number)
        for world in self.worlds:
            world.add_leg(number, route, self.setup.gain)
        wanted = self.setup._replace(legs=legs)
        reasons = [world.loop.offer(world.make(wanted)) for world in self.worlds]
        assert len(set(map(bool, reasons))) == 1
        if not reasons[0]:
            self.setup = wanted

    @precondition(lambda self: self.setup.legs)
    @rule()
    def withdraw(self) -> None:
        """Give up the references."""
        self.setup = self.setup._replace(legs=())
        for world in self.worlds:
            world.loop.adopt(world.make(self.setup))

    @precondition(lambda self: self.routes)
    @rule(pick=st.integers(0, 2))
    def give_again(self, pick: int) -> None:
        """Adopt a reference of before once more."""
        self.setup = self.setup._replace(legs=(max(len(self.routes) - 1 - pick, 0),))
        for world in self.worlds:
            world.loop.adopt(world.make(self.setup))

    @rule(ahead=st.sampled_from([0, 0, 1, 3]), samples=st.sampled_from([1, 2, 20]), near=jitter,
          is_old=st.booleans())
    def plan(self, ahead: int, samples: int, near: Any, is_old: bool) -> None:
        """Let a plan arrive, also one that was asked for before the law began anew."""
        run = self.runs[0] if is_old else self.loop.run
        x = [a + 0.01 * b for a, b in zip(self.x, near, strict=True)]
        taken = [world.loop.add_plan(
            world.make_plan(self.stamp + ahead * PERIOD, x, samples), run)
            for world in self.worlds]
        assert len(set(taken)) == 1
        assert not taken[0] or run == self.loop.run
        self.has_plan |= taken[0]

    # States

    def send(self, stamp: int, offsets: Any, size: float, wait: float) -> None:
        """Send a state in every world, and compare the commands."""
        self.now += wait
        before, timeout = self.loop.mode, self.setup.rules.state_timeout
        far = timeout or 1.0
        by = 0.0 if self.last is None else (stamp - self.last) * 1e-9
        has_jumped = self.last is not None and self.known != self.restarts
        is_new = has_jumped or self.is_replaced
        is_late, is_back = -far <= by < 0.0 and not is_new, by < -far
        self.is_behind |= by < 0.0 and is_new
        self.x = self.find_target(stamp)
        self.x = [a + size * b for a, b in zip(self.x, offsets, strict=True)]
        if is_back:
            self.lose()
        elif before is Mode.RESTING and self.loop.age(self.now) >= timeout > 0.0 or (
                0.0 < timeout < by):
            self.doubt()
        if has_jumped:
            self.doubt()
        self.known, self.is_replaced = self.restarts, False
        given = []
        for world in self.worlds:
            state = stamp + world.shift, world.rotate(self.x), self.now, None, None, self.restarts
            given.append(world.loop.answer(*state))
            # A law that rests is resumed at its set point, from which only the second is judged.
            if world.repeats and world.loop.mode is not Mode.RESTING:
                assert are_near(given[-1], world.loop.answer(*state))
        if is_late:
            assert given[0] is None
            assert self.loop.mode is before
        else:
            self.last = self.stamp = stamp
        self.check_commands(given)
        if self.loop.due == stamp and not is_late:
            self.check_following(stamp)
        self.check_modes()

    def find_target(self, stamp: int) -> list[float]:
        """Return the point of the followed reference, or where a free mass would be."""
        number = self.worlds[0].find_number()
        if number is not None and number in self.begins:
            return self.routes[number].place((stamp - self.begins[number]) * 1e-9)
        t = max(stamp - self.stamp, 0) * 1e-9
        v = self.setup.drift
        return [*(a + b * t for a, b in zip(self.x[:2], v, strict=True)), *v]

    # What always holds

    def lose(self) -> None:
        """Note that all references and plans are given up."""
        self.over.update(self.setup.legs)
        self.dropped.update(self.setup.legs)
        self.doubt()

    def doubt(self) -> None:
        """Note that the plant may be elsewhere."""
        self.is_unjudged, self.has_plan = True, False

    def find_rest(self) -> list[float]:
        """Return the input at rest within the limits in force."""
        rest = list(self.loop.control.rest)
        self.loop.control.limits.clip(rest)
        return rest

    def check_commands(self, given: list[Any]) -> None:
        """Check the command of the first world, and that the others are the same."""
        u = given[0]
        if u is not None:
            assert all(math.isfinite(each) and abs(each) <= self.setup.limit for each in u)
        if self.loop.mode in (Mode.STOPPED, Mode.INACTIVE):
            assert u is None or u == self.find_rest()
        if self.loop.mode is Mode.RESTING and u is not None:
            assert u in (self.find_rest(), self.loop.command)
        for world, other in zip(self.worlds[1:], given[1:], strict=True):
            assert are_near(u and world.rotate(u), other)

    def check_modes(self) -> None:
        """Check that the worlds agree, and that a change of mode was told."""
        for world in self.worlds[1:]:
            assert world.loop.mode is self.loop.mode
            assert world.find_number() == self.worlds[0].find_number()
        assert self.worlds[0].find_number() not in self.dropped
        sentences = [*self.loop.news, *self.loop.events, *self.loop.refused]
        assert all(sentences)
        told, before = self.told
        if self.loop.mode is Mode.RESTING is not before:
            self.doubt()
        if self.loop.mode is not before and self.now - told > 1.0:
            assert [*self.loop.news, *self.loop.events]
        if sentences:
            told = self.now
        self.told = told, self.loop.mode
        for world in self.worlds:
            for queue in (world.loop.news, world.loop.events, world.loop.refused):
                queue.clear()
        if self.loop.mode is not Mode.RESTING:
            assert bool(self.loop.reason) == (self.loop.mode is Mode.STOPPED)
        if self.runs[-1] != self.loop.run:
            self.runs.append(self.loop.run)

    def check_following(self, stamp: int) -> None:
        """Check what is followed after an answer of the law."""
        mode, number = self.loop.mode, self.worlds[0].find_number()
        if mode is Mode.REFERENCE:
            assert number is not None
            assert number not in self.over
            route = self.routes[number]
            acts = stamp + self.setup.delay * PERIOD
            is_new = number not in self.begins
            if is_new:
                begin = self.begins[number] = self.worlds[0].get_begin(number)
                assert begin == route.begin or route.begin is None
                assert begin <= acts or self.is_behind
            if (is_new or self.is_unjudged) and route.is_judged and not self.setup.delay:
                wanted = route.place((acts - self.begins[number]) * 1e-9)
                assert all(low - 1e-6 <= a - b <= high + 1e-6 for a, b, (low, high) in zip(
                    self.x, wanted, ALLOWED, strict=True))
        elif mode in FOLLOWING and number is not None:   # its end is held
            assert number in {*self.over, self.followed} or number not in self.begins
            begin, duration = self.worlds[0].get_begin(number), self.routes[number].duration
            longest = 2 * PERIOD   # the delay may have been reduced since then
            assert stamp + longest >= begin + round(duration * S) or self.is_behind
        assert mode is not Mode.PLAN or self.has_plan
        now = number if mode is Mode.REFERENCE else None
        if self.followed not in (None, now) and mode is not Mode.RESTING:
            self.over.add(self.followed)
        if mode is not Mode.RESTING:
            self.followed = now
            self.is_unjudged = False
