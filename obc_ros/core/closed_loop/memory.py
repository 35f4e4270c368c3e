# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The memory of a control law: its integral, and the commands that have not acted yet."""

from collections import deque
from collections.abc import Sequence
from operator import mul, sub

from obc_ros.core.closed_loop.clock import NS
from obc_ros.core.closed_loop.control import Prediction
from obc_ros.core.closed_loop.feedback import Rows


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
        while len(self._past) > len(prediction.Gammas) + 1:   # the one that acts now stays
            self._past.pop()

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

    Attributes
    ----------
    w : list of float
        (m,)

    """

    def __init__(self, m: int) -> None:
        self.w = [0.0] * m
        self._last: tuple[int, Sequence[float]] | None = None   # stamp and error
        self._excess: Sequence[float] = ()

    def pause(self) -> None:
        """Do not integrate from the last state to the next one."""
        self._last = None

    def clear_excess(self) -> None:
        """Forget by how much inputs exceeded their limits."""
        self._excess = ()

    def note(self, raw: Sequence[float], command: Sequence[float]) -> None:
        """Store by how much inputs (m,) exceed their limits."""
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
