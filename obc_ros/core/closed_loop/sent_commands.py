# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Commands that were sent and are still to take effect, and the error once they have."""

from collections import deque
from collections.abc import Sequence
from operator import mul, sub

from obc_ros.core.closed_loop.control import Prediction


class Sent:
    """The last commands of a loop, for a plant that they reach a known delay later."""

    def __init__(self) -> None:
        self._past: deque[list[float]] = deque()
        self._stamp: int | None = None

    def forget(self) -> None:
        """Forget the commands."""
        self._past.clear()

    def predict(self, prediction: Prediction, e: Sequence[float], ur: Sequence[float], p: int
                ) -> tuple[list[float], Sequence[float]]:
        """Return the error after the delay, and by how much p integrals grow until then."""
        whole = [*e, *[0.0] * p]
        ahead = [sum(map(mul, row, whole)) for row in prediction.Phi]
        for Gamma, u in zip(prediction.Gammas, tuple(self._past), strict=False):
            du = list(map(sub, u, ur))
            for i, row in enumerate(Gamma):
                ahead[i] += sum(map(mul, row, du))
        return ahead[:len(e)], ahead[len(e):]

    def remember(self, prediction: Prediction, u: list[float], stamp: int) -> None:
        """Keep the command that answers a stamp [ns]; a missed period repeats the last one."""
        periods = 1 if self._stamp is None else round((stamp - self._stamp) / prediction.period)
        if periods == 0 and self._past:
            self._past[0] = u  # the same state was answered again
            return
        for _ in range(min(periods, len(prediction.Gammas)) - 1):
            self._past.appendleft(self._past[0] if self._past else u)
        self._past.appendleft(u)
        self._stamp = stamp
        while len(self._past) > len(prediction.Gammas):
            self._past.pop()
