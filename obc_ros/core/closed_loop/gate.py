# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The last thing before a command leaves: finite, within the limits in force, without a jump.

Every command passes it: those of a law, the input at rest, a held command, the last one.
"""

from collections.abc import Sequence
import math
from operator import sub

from obc_ros.core.closed_loop.feedback import InputLimits


class CommandGate:
    """
    What was sent last, and the jumps of changes that have not decayed yet.

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
