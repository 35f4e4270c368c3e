# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A simulated plant in time: when it is advanced, when its state is published, what it listens to.

Time is told by the caller: `now` is a steady time [s], `wall` what the node's clock says at that
moment [ns]. States are published at the instants of a grid, which are absolute. A plant that was
held up leaves no state out and gives the controller its time for each: it goes on where it was,
and regains what it is behind little by little. In lockstep each state waits for the command that
answers it.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
import math

from obc_ros.core.closed_loop.simulator import Simulator
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import DynamicsError, StatementError

LATE = 0.5      # of a period: a state so late leaves its controller too little time for the next
REGAIN = 0.1    # of a period: regained with each state by a plant that is behind
HELD_UP = 0.25  # [s] so far behind, time is not regained
MOST_STEPS = 100_000
ANSWERED = 'stale: the last state is answered already'
OLDER = 'stale: older than the command before'
RESEND = 0.25   # [s] after which an unanswered state is published again


@dataclass(frozen=True)
class Pacing:
    """
    How a plant moves on.

    Attributes
    ----------
    steps : int
        Steps of the simulator from one published state to the next.
    speed : float
        Simulated seconds a second; 0: as fast as it can.
    lockstep : bool
        Whether each published state waits for its command.
    simulated_stamps : bool
        Whether stamps are simulated time, else the caller's.
    command_timeout : float
        Simulated time [s] without a command after which the plant rests; 0: never.

    """

    steps: int
    speed: float = 1.0
    lockstep: bool = False
    simulated_stamps: bool = False
    command_timeout: float = 0.0


def choose_step(dt: float, publish_rate: float) -> tuple[float, int]:
    """
    Return the step [s], at most dt, and how many make the period of publishing.

    Raises
    ------
    StatementError
        If they are more than `MOST_STEPS`.

    """
    steps = max(1, math.ceil(1.0 / (publish_rate * dt) - 1e-9))
    if steps > MOST_STEPS:
        raise StatementError(f'dt = {dt:g} s makes {steps} steps from one state to the next at '
                             f'{publish_rate:g} Hz; at most {MOST_STEPS} are taken')
    return 1.0 / publish_rate / steps, steps


class PacedPlant:
    """
    A simulator that a node polls; its first state is to be published at once.

    Parameters
    ----------
    simulator : Simulator
    pacing : Pacing
    now : float
        Steady time [s].
    wall : int
        Time of the node's clock [ns].

    Attributes
    ----------
    sample : ndarray, shape (n,)
        The state last published, noise included.
    stamp : int
        Its stamp [ns].
    answered : bool
        Whether a command for it has come.
    paused : bool
    fault : str
        Why the plant stands still; empty if it does not.
    behind : float
        How much later [s] than their stamps say the states are published.
    published, resent, unanswered : int
        States published, published again, and replaced by the next before a command for them had
        come, from the first command on.
    accepted, repeated, rests, held_up : int
        Commands taken, and those of them that answer a state once more; times that commands
        stayed away too long; times that the plant was held up.
    dropped : Counter
        Commands that were not taken, by reason.

    """

    def __init__(self, simulator: Simulator, pacing: Pacing, now: float, wall: int) -> None:
        self.simulator = simulator
        self.pacing = pacing
        self.paused = False
        self.published = self.resent = self.unanswered = 0
        self.accepted = self.repeated = self.rests = self.held_up = 0
        self.dropped: Counter[str] = Counter()
        self.answered = False
        self._anchored = now, 0
        self.reset(now, wall)

    def reset(self, now: float, wall: int, x0: Sequence[float] | None = None) -> None:
        """Go back to the start, or to another initial state; time and noise begin anew."""
        self.simulator.reset(x0)
        self.fault = ''
        self._due = 0  # [steps] of the next state to be published
        self._last_command, self._last_stamp, self._resting = 0.0, 0, True
        self._anchor(now)
        self._publish(now, wall)

    def pause(self, paused: bool, now: float) -> None:
        """Stop, or go on; time stands still in between."""
        self._catch_up(now)
        self.paused = paused
        self._anchor(now)
        self._sent = now

    def adopt(self, pacing: Pacing, now: float) -> None:
        """Go on with another speed or time-out."""
        self._catch_up(now)
        self.pacing = pacing
        self._anchor(now)

    def step(self, now: float, wall: int) -> str:
        """Advance a paused plant to the next state to be published; return why not, if not."""
        if not self.paused:
            return 'the plant is not paused'
        if self.pacing.lockstep and not self.answered:
            return f'no command has answered the state of t = {self.simulator.time:.9g} s'
        if not self.fault and self._advance(self._due):
            self._publish(now, wall)
        return self.fault

    def poll(self, now: float, wall: int) -> bool:
        """Advance as far as the time has come; return whether `sample` is to be published."""
        if self.fault:
            return False
        if self._waits_for_answer():  # while paused, too: its time can be stepped
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
        self._regain()
        return True

    def wait(self, now: float) -> float:
        """Return how long [s] there is nothing to poll for; inf: until something else happens."""
        if self.fault:
            return math.inf
        if self._waits_for_answer():
            return max(0.0, self._sent + RESEND - now)
        if self.paused:
            return math.inf
        return max(0.0, self._due_time() - now)

    @property
    def contested(self) -> int:
        """Return how many commands answer a state that another has answered, or an older one."""
        return self.repeated + self.dropped[ANSWERED] + self.dropped[OLDER]

    def command(self, stamp: int, u: Sequence[float] | Array, now: float) -> str:
        """
        Let a command arrive; return why it is dropped, empty if it is taken.

        Parameters
        ----------
        stamp : int
            Of the state that it answers [ns].
        u : array, shape (m,)
            The command.
        now : float
            Steady time [s].

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
        self._last_stamp = min(stamp, self.stamp)
        self._last_command, self._resting = self.simulator.time, False
        return ''

    def _stale(self, stamp: int) -> str:
        if self.pacing.lockstep:
            if stamp != self.stamp:
                return 'stale: does not answer the last state'
            return ANSWERED if self.answered else ''
        if self.pacing.simulated_stamps:
            if stamp > self.stamp:
                return 'stale: stamped later than the last state'
        elif stamp == 0:  # typed by hand
            return ''
        if stamp < self._last_stamp:
            return OLDER
        timeout = self.pacing.command_timeout
        if timeout and self.stamp - stamp > timeout * 1e9:
            return 'stale: older than command_timeout'
        return ''

    def _waits_for_answer(self) -> bool:
        return self.pacing.lockstep and not self.answered

    def _anchor(self, now: float) -> None:
        """Let the present state be that of now."""
        self._anchored = now, self.simulator.steps
        self.behind = 0.0

    def _look(self, now: float) -> None:
        """Let the state that is due be that of now, if the plant was held up."""
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

    def _regain(self) -> None:
        """Let the next state come a little sooner, if the plant is behind."""
        if self.behind:
            gain = min(self.behind, REGAIN * self._period())
            self.behind -= gain
            self._anchored = self._anchored[0] - gain, self._anchored[1]

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
        """Return how many steps there should have been by now."""
        then, steps = self._anchored
        elapsed = (now - then) * self.pacing.speed / self.simulator.conditions.dt
        return steps + math.floor(elapsed + 1e-6)

    def _catch_up(self, now: float) -> None:
        """Advance to now, but not beyond a state that is to be published."""
        if not (self.pacing.lockstep or self.paused or self.fault):
            self._look(now)
            self._advance(max(self.simulator.steps, min(self._steps_at(now), self._due)))

    def _advance(self, until: int) -> bool:
        timeout, simulator = self.pacing.command_timeout, self.simulator
        if timeout and not self._resting and simulator.time - self._last_command >= timeout:
            simulator.command(simulator.rest)
            self._resting = True
            self.rests += 1
        try:
            simulator.advance(until - simulator.steps)
        except DynamicsError as error:
            self.fault = str(error)
        return not self.fault

    def _publish(self, now: float, wall: int) -> None:
        self.unanswered += bool(self.accepted and not self.answered)
        self.sample: Array = self.simulator.measure()
        self.stamp = (round(self.simulator.time * 1e9) if self.pacing.simulated_stamps else wall)
        self.answered = False
        self.published += 1
        self._due += self.pacing.steps
        self._sent = now
