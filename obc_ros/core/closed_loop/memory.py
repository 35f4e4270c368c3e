# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The memory of a loop: its gate of commands, those that have not acted yet, its integral."""

from collections.abc import Sequence
import math
from operator import mul, sub

from obc_ros.core.closed_loop.clock import NS
from obc_ros.core.closed_loop.control import Prediction
from obc_ros.core.closed_loop.feedback import InputLimits, Rows


class CommandGate:
    """
    The last thing before a command leaves: finite, within the limits in force, without a jump.

    Every command passes it: those of a law, the input at rest, a held command, the last one.
    The sum of the jumps is added to the command of the law. Each decays on its own, so that a
    change during a transition begins at the command that was sent and does not slow the decay of
    an earlier one. Their clock is the time that has passed between states, so that a jump of the
    stamps is none of the transition.

    :ivar sent: the last command (m,); None: there was none.
    :ivar is_entering: whether a law has begun and its transition has not ended.
    """

    def __init__(self) -> None:
        self.sent: list[float] | None = None
        self.is_entering = False
        self._jumps: list[tuple[float, float, list[float]]] = []   # begin, duration, size
        self._time = 0.0

    def advance(self, dt: float) -> None:
        """Let the time [s] between two states pass."""
        self._time += dt

    def settle(self) -> None:
        """Forget the transitions: the next command may jump."""
        self._jumps.clear()
        self.is_entering = False

    def enter(self, before: Sequence[float], after: Sequence[float], time: float) -> None:
        """Begin at the command `before` with a law that commands `after`, both (m,)."""
        self.settle()
        self.leave(before, after, time)
        self.is_entering = bool(self._jumps)

    def leave(self, before: Sequence[float], after: Sequence[float], time: float) -> None:
        """Add the jump from `before` to `after`, which decays within a time [s]; 0: it stays."""
        jump = list(map(sub, before, after))
        if time and any(jump) and all(map(math.isfinite, jump)):
            self._jumps.append((self._time, time, jump))

    def smooth(self, u: Sequence[float]) -> list[float]:
        """Return a command (m,) with the rest of the jumps."""
        smooth = list(u)
        if self._jumps:
            self._jumps = [each for each in self._jumps if self._time - each[0] < each[1]]
        if not self._jumps:
            self.is_entering = False
            return smooth
        for began, time, jump in self._jumps:
            s = (self._time - began) / time
            left = 1.0 - s * s * (3.0 - 2.0 * s)   # zero slope at both ends
            for j, size in enumerate(jump):
                smooth[j] += left * size
        return smooth

    def let_through(self, u: Sequence[float], limits: InputLimits) -> list[float] | None:
        """Return the command to send, within the limits; None: it is not finite."""
        if not all(map(math.isfinite, u)):
            return None
        command = list(u)
        limits.clip(command)
        self.sent = command
        return command.copy()


class SentCommands:
    """The commands that have not acted yet, and the prediction over the delay with them."""

    def __init__(self) -> None:
        self._past: list[list[float]] = []   # the last one first, one more than act
        self._stamp: int | None = None

    def forget(self) -> None:
        """Forget the commands."""
        self._past, self._stamp = [], None

    def predict(self, prediction: Prediction, e: Sequence[float], ur: Sequence[float], p: int,
                stamp: int) -> tuple[list[float], Sequence[float]]:
        """Return the error after the delay, and the growth of the p integrals until then."""
        whole = [*e, *[0.0] * p]
        for u in self._recall(prediction, stamp)[:len(prediction.Gammas)]:
            whole += map(sub, u, ur)
        # Before the first command the input was at rest: `map` ends with the shorter one.
        ahead = [sum(map(mul, row, whole)) for row in prediction.rows]
        return ahead[:len(e)], ahead[len(e):]

    def remember(self, prediction: Prediction, u: list[float], stamp: int) -> None:
        """Keep the command for a stamp [ns], in place of another one for the same state."""
        self._past = [u, *self._recall(prediction, stamp)][:len(prediction.Gammas) + 1]
        if self._stamp is None or _count_periods(prediction, self._stamp, stamp):
            self._stamp = stamp

    def _recall(self, prediction: Prediction, stamp: int) -> list[list[float]]:
        """Return the commands before a stamp [ns]; in a missed period the last one still acts."""
        if self._stamp is None:
            return []
        periods = _count_periods(prediction, self._stamp, stamp)
        if periods == 0:
            return self._past[1:]
        return self._past[:1] * min(periods - 1, len(prediction.Gammas)) + self._past

    def list_earlier(self, prediction: Prediction) -> list[tuple[int, list[float]]]:
        """Return the commands before the last one, oldest first, with their stamps [ns]."""
        stamp = self._stamp
        earlier = [] if stamp is None else [
            (stamp - k * prediction.period, u) for k, u in enumerate(self._past)][1:]
        return earlier[::-1]


class Integral:
    """
    The part -w of the input, with dw/dt = Ki C e by the trapezoidal rule.

    The integral of an output is held while an input exceeds a limit and the output would increase
    the excess (conditional anti-windup).

    :ivar w: (m,).
    """

    def __init__(self, m: int) -> None:
        self.w = [0.0] * m
        self._last: tuple[int, Sequence[float]] | None = None   # stamp and error
        self._excess: Sequence[float] = ()

    def pause(self) -> None:
        """Do not integrate from the last state to the next one."""
        self._last = None

    def note(self, raw: Sequence[float], command: Sequence[float]) -> None:
        """Store by how much inputs (m,) exceed their limits; empty: they are not known."""
        self._excess = list(map(sub, raw, command))

    def advance(self, C: Rows, Ki: Rows, error: Sequence[float], stamp: int) -> None:
        """Integrate up to the error (n,) at a stamp [ns]."""
        last, self._last = self._last, (stamp, error)
        if last is None:
            return
        dt = (stamp - last[0]) * NS
        for k, row in enumerate(C):
            now = sum(map(mul, row, error))
            if not any(-gains[k] * now * excess > 0.0
                       for gains, excess in zip(Ki, self._excess, strict=False)):
                dz = 0.5 * dt * (now + sum(map(mul, row, last[1])))
                for j, gains in enumerate(Ki):
                    self.w[j] += gains[k] * dz


def _count_periods(prediction: Prediction, last: int, stamp: int) -> int:
    return round((stamp - last) / prediction.period)
