# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Pacing of a simulated plant: when it advances, when its state is published, which commands count.

The caller passes the time: `now` is a steady time [s], `wall` is the time of the node's clock at
that moment [ns]. States are published on an absolute time grid. A plant that was delayed omits no
state and gives the controller its time for each: it continues where it was and reduces the delay a
little with each state. In lockstep each state waits for its command; after one that comes later
than the next state was due, a whole period passes until that state.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
import math

from obc_ros.core.numerics.arrays import Array
from obc_ros.core.simulation.simulator import Simulator
from obc_ros.core.text.errors import DynamicsError, StatementError

LATE = 0.5      # of a period: after a later state the controller has too little time for the next
REGAIN = 0.1    # of a period: reduction of the delay with each state
HELD_UP = 0.25  # [s] a larger delay is not reduced
MOST_STEPS = 100_000
ANSWERED = 'stale: the last state already has a command'
OLDER = 'stale: older than the previous command'
BEFORE = 'stale: older than the first state'
RESEND = 0.25   # [s] after which a state without a command is published again


@dataclass(frozen=True)
class Pacing:
    """
    How a plant is advanced; see the parameters of plant_simulator in docs/parameters.md.

    :ivar steps: steps of the simulator from one published state to the next.
    :ivar simulated_stamps: whether stamps are simulated time instead of the caller's.
    :ivar command_timeout, pause_at: simulated time [s]; 0: never.
    """

    steps: int
    speed: float = 1.0
    lockstep: bool = False
    simulated_stamps: bool = False
    command_timeout: float = 0.0
    pause_at: float = 0.0
    hold_until_command: bool = False


def choose_step(dt: float, publish_rate: float) -> tuple[float, int]:
    """Return the step [s], at most dt, and the number of steps in a publishing period."""
    steps = max(1, math.ceil(1.0 / (publish_rate * dt) - 1e-9))
    if steps > MOST_STEPS:
        raise StatementError(f'dt = {dt:g} s requires {steps} steps per published state at '
                             f'{publish_rate:g} Hz; the maximum is {MOST_STEPS}')
    return 1.0 / publish_rate / steps, steps


class PacedPlant:
    """
    A simulator that a node polls; the first state must be published at once.

    :ivar stamp: its stamp [ns].
    :ivar epoch: the stamp [s] of simulated time 0 as long as the plant keeps its pace.
    :ivar answered: whether a command for it has arrived.
    :ivar behind: delay of the published states after their stamps [s].
    :ivar published, resent, unanswered: numbers of states: published, published again, and
        replaced by the next one before their command arrived (from the first command on).
    :ivar accepted, repeated, rests, held_up: numbers of accepted commands, of further commands for
        the same state, of time-outs of the commands, and of delays of the plant.
    """

    def __init__(self, simulator: Simulator, pacing: Pacing, now: float, wall: int) -> None:
        self.simulator = simulator
        self.pacing = pacing
        self.paused = False
        self.published = self.resent = self.unanswered = 0
        self.accepted = self.repeated = self.rests = self.held_up = 0
        self.dropped: Counter[str] = Counter()
        self.answered = False
        self._anchored, self._last_stamp = (now, 0), 0
        self.reset(now, wall)

    def reset(self, now: float, wall: int, x0: Sequence[float] | None = None) -> None:
        """Return to the initial state, or to another one; time and noise restart."""
        self.simulator.reset(x0)
        self.fault = ''
        self._pauses = True   # whether the pause at a given time is still to come
        self._due = 0  # [steps] of the next state to be published
        self._last_command, self._resting = 0.0, True
        self._is_commanded = False   # since it began
        self._anchor(now)
        self._publish(now, wall)
        self._last_stamp = self.stamp - 1

    def pause(self, paused: bool, now: float, wall: int) -> None:
        """Pause or resume; time does not pass in between."""
        self._catch_up(now)
        self.paused = paused
        self._anchor(now)
        if not self.pacing.simulated_stamps:
            self.epoch = 1e-9 * wall - self.simulator.time
        self._sent = now

    def adopt(self, pacing: Pacing, now: float) -> None:
        """Use another speed, time-out or time of the pause from now on."""
        self._catch_up(now)
        self._pauses |= pacing.pause_at != self.pacing.pause_at
        self.pacing = pacing
        self._anchor(now)

    def check_pause(self, pacing: Pacing) -> None:
        """Raise a StatementError if the time of the pause is a new one and has passed."""
        if pacing.pause_at != self.pacing.pause_at and self._steps_to(pacing.pause_at) <= 0:
            raise StatementError(f'pause_at = {pacing.pause_at:g} s: the simulated time is '
                                 f'already {self.simulator.time:.9g} s')

    def step(self, now: float, wall: int) -> str:
        """Advance a paused plant to the next published state; return why not, or ''."""
        if not self.paused:
            return 'the plant is not paused'
        if self.pacing.lockstep and not self.answered:
            return f'no command has arrived for the state of t = {self.simulator.time:.9g} s'
        if not self.fault and self._advance(self._due):
            self._publish(now, wall)
        return self.fault

    def poll(self, now: float, wall: int) -> bool:
        """Advance to the present time; return whether `sample` must be published."""
        if self.fault:
            return False
        if self._waits_for_answer():  # also while paused, because `step` needs the command
            again = now - self._sent >= RESEND
            if again:
                self.resent += 1
                self._sent = now
            return again
        if self.paused:
            return False
        if now < self._anchored[0]:  # the clock was set back
            self._anchor(now)
        if now < self._due_time():
            return False
        self._look(now)
        late = self.behind + now - self._due_time()
        if not self._advance(self._due):
            return False
        self._publish(now, wall - round(late * 1e9))
        if self.behind:   # publish the next state a little earlier
            gain = min(self.behind, REGAIN * self._period())
            self.behind -= gain
            self._anchored = self._anchored[0] - gain, self._anchored[1]
        return True

    def wait(self, now: float) -> float:
        """Return the time [s] until the next poll; inf: none is needed before another call."""
        if self.fault:
            return math.inf
        if self._waits_for_answer():
            return max(0.0, self._sent + RESEND - now)
        if self.paused:
            return math.inf
        return max(0.0, self._due_time() - now)

    @property
    def contested(self) -> int:
        """Return the number of commands for states that have one, or for older states."""
        return self.repeated + self.dropped[ANSWERED] + self.dropped[OLDER]

    def command(self, stamp: int, u: Sequence[float] | Array, now: float) -> str:
        """
        Receive a command; return why it is dropped, or ''.

        :param stamp: stamp of the state that the command is for [ns]; 0: none.
        """
        reason = self._stale(stamp)
        if reason:
            self.dropped[reason] += 1
            return reason
        self._catch_up(now)
        try:
            self.simulator.command(u)
        except StatementError as error:
            self.dropped['malformed'] += 1
            return f'malformed: {error}'
        self.accepted += 1
        self.repeated += 0 < stamp == self._last_stamp
        self.answered = self.answered or stamp >= self.stamp or stamp == 0
        if self.pacing.lockstep and now > self._due_time():
            self._anchor(now)   # time stood still: the next state is due a period from now
        self._last_stamp = min(stamp, self.stamp)
        self._last_command, self._resting = self.simulator.time, False
        self._is_commanded = True
        return ''

    @property
    def held(self) -> bool:
        """Return whether the state stays as it is until the first command."""
        return self.pacing.hold_until_command and not self._is_commanded

    def _stale(self, stamp: int) -> str:
        if self.pacing.lockstep:
            if stamp != self.stamp:
                return 'stale: not for the last state'
            return ANSWERED if self.answered else ''
        if self.pacing.simulated_stamps:
            if stamp > self.stamp:
                return 'stale: stamped later than the last state'
        elif stamp == 0:  # typed on the command line
            return ''
        if stamp < self._last_stamp:
            return OLDER if self._is_commanded else BEFORE
        timeout = self.pacing.command_timeout
        if timeout and self.stamp - stamp > timeout * 1e9:
            return 'stale: older than command_timeout'
        return ''

    def _waits_for_answer(self) -> bool:
        return self.pacing.lockstep and not self.answered

    def _anchor(self, now: float) -> None:
        """Assign the present state to the time `now`."""
        self._anchored = now, self.simulator.steps
        self.behind = 0.0

    def _look(self, now: float) -> None:
        """Assign the due state to the time `now` if the plant was delayed."""
        late = now - self._due_time()
        if self.pacing.lockstep or not self.pacing.speed:
            held_up = late > 0.0
        else:
            held_up = late > LATE * self._period()
            self.held_up += held_up
            self.behind += late if held_up else 0.0
            if self.behind > HELD_UP:
                self.behind = 0.0
        if held_up:
            self._anchored = now, self._due

    def _period(self) -> float:
        """Return the time [s] from one state to the next."""
        return self.pacing.steps * self.simulator.conditions.dt / self.pacing.speed

    def _due_time(self) -> float:
        """Return the steady time [s] of the next state to be published."""
        now, steps = self._anchored
        if self.pacing.speed == 0.0:
            return now
        return now + (self._due - steps) * self.simulator.conditions.dt / self.pacing.speed

    def _steps_at(self, now: float) -> int:
        then, steps = self._anchored
        elapsed = (now - then) * self.pacing.speed / self.simulator.conditions.dt
        return steps + math.floor(elapsed + 1e-6)

    def _catch_up(self, now: float) -> None:
        """Advance to `now`, but not beyond a state that must be published."""
        if not (self.pacing.lockstep or self.paused or self.fault):
            self._look(now)
            self._advance(max(self.simulator.steps, min(self._steps_at(now), self._due)))

    def _advance(self, until: int) -> bool:
        timeout, simulator = self.pacing.command_timeout, self.simulator
        if self.held:
            simulator.hold(until - simulator.steps)
            return True
        if timeout and not self._resting and simulator.time - self._last_command >= timeout:
            simulator.command(simulator.rest)
            self._resting = True
            self.rests += 1
        try:
            simulator.advance(until - simulator.steps)
        except DynamicsError as error:
            self.fault = str(error)
        return not self.fault

    def _steps_to(self, moment: float) -> float:
        """Return the number of steps to a simulated time [s]; inf for 0, which is no time."""
        if not moment:
            return math.inf
        return math.ceil(moment / self.simulator.conditions.dt - 1e-6) - self.simulator.steps

    def _publish(self, now: float, wall: int) -> None:
        self.unanswered += bool(self.accepted and not self.answered)
        self.sample: Array = self.simulator.measure()
        self.stamp = (round(self.simulator.time * 1e9) if self.pacing.simulated_stamps else wall)
        self.epoch = 1e-9 * self.stamp - self.simulator.time
        self._last_stamp = min(self._last_stamp, self.stamp - 1)   # the clock may be set back
        self.answered = False
        self.published += 1
        self._due += self.pacing.steps
        self._sent = now
        if self._pauses and self._steps_to(self.pacing.pause_at) <= 0:
            self.paused, self._pauses = True, False   # once: it may be resumed
