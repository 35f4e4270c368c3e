# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What searches from several starts led to, and when further ones bring nothing new."""

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.solver.transcription.mesh import Path

ANOTHER = 1e-3   # relative cost: what is another minimum on a coarse mesh
_SAME = 2e-4     # likewise: the same, found twice with an error of half of it
_MET, _WILD = 1e-5, 1e6   # infeasibility: of a path, and of a start that states explode from
_CALMER, _CALMEST = 0.5, 0.1   # parts of spans that starts go, after each of those


class Familiar:
    """
    The costs of minima that were found, and the iterates of the searches.

    A search is to be ended that comes to an iterate of another, for it goes on like that one, or
    that is feasible at the cost of a minimum that is known. `daring`: whether the present search
    started where inputs drawn at random lead; that it leads astray says little.
    """

    def __init__(self) -> None:
        self._seen: tuple[Array, Array] | None = None
        self._part = 1.0
        self.daring = False
        self._costs, self._sober, self._astray = list[float](), list[float](), 0
        self._iterates = set[tuple[str, str]]()
        self._now = list[tuple[str, str]]()

    def again(self, cost: float, infeasibility: float) -> bool:
        """Return whether an iterate of the present search shows that it brings nothing new."""
        place = f'{cost:.7e}', f'{infeasibility:.4e}'
        self._now.append(place)
        return place in self._iterates or self._knows(cost, infeasibility)

    def ended(self, cost: float, infeasibility: float, path: Path | None) -> None:
        """Take note of where the present search ended, with the path if one was found."""
        self._iterates.update(self._now)
        self._now = []
        dear = self.daring and self._far(cost)
        if path is not None and not dear:   # else all bends would be as wild
            x, u = path.x, np.vstack([path.ua, path.ub])
            new = np.ptp(x, axis=0), np.maximum(np.ptp(u, axis=0), np.abs(u).max(axis=0))
            known = self._seen or new
            self._seen = np.maximum(known[0], new[0]), np.maximum(known[1], new[1])
        if path is None and not (infeasibility < _WILD or self.daring):
            self._part = max(_CALMER * self._part, _CALMEST)
        if path is not None or self._knows(cost, infeasibility):
            self._costs.append(cost)
            self._sober += [] if self.daring else [cost]
        else:
            self._astray += not self.daring

    @property
    def spans(self) -> tuple[Array, Array] | None:
        """
        Return how far states (n,) and inputs (m,) of a start may go, None without a path.

        As far as on the paths found; less after starts from which states exploded.
        """
        return self._seen and (self._part * self._seen[0], self._part * self._seen[1])

    def _far(self, cost: float) -> bool:
        least = min(self._costs, default=cost)
        return cost - least > abs(least)

    def _knows(self, cost: float, infeasibility: float) -> bool:
        return infeasibility <= _MET and any(
            abs(cost - known) <= _SAME * abs(known) for known in self._costs)

    @property
    def rough(self) -> bool:
        """Return whether more than a quarter of the searches led nowhere, or to twice the cost."""
        far = sum(map(self._far, self._sober))
        return 4 * (self._astray + far) > self._astray + len(self._sober)

    @property
    def minima(self) -> int:
        """Return how many minima were found."""
        ordered = np.sort(self._costs)
        apart = int(np.count_nonzero(np.diff(ordered) > ANOTHER * np.abs(ordered[1:])))
        return min(len(ordered), 1) + apart

    def enough(self) -> bool:
        """
        Return whether no other minimum is to be expected after so many searches.

        After n that led to w minima, w (n - 1) / (n - w - 2) is expected of how many there are:
        C. G. E. Boender, A. H. G. Rinnooy Kan, Bayesian stopping rules for multistart global
        optimization methods, Math. Program. 37 (1987).
        """
        n, w = len(self._costs), self.minima
        return n > w + 2 and w * (n - 1) / (n - w - 2) <= w + 0.5
