# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What searches from several starts led to, and when further ones bring nothing new."""

import numpy as np

ANOTHER = 1e-3   # relative cost: what is another minimum on a coarse mesh
_SAME = 2e-4     # likewise: the same, found twice with an error of half of it
_MET = 1e-5      # infeasibility


class Familiar:
    """
    The costs of minima that were found, and the iterates of the searches.

    A search is to be ended that comes to an iterate of another, for it goes on like that one, or
    that is feasible at the cost of a minimum that is known.
    """

    def __init__(self) -> None:
        self._costs = list[float]()
        self._iterates = set[tuple[str, str]]()
        self._now = list[tuple[str, str]]()

    def again(self, cost: float, infeasibility: float) -> bool:
        """Return whether an iterate of the present search shows that it brings nothing new."""
        place = f'{cost:.7e}', f'{infeasibility:.4e}'
        self._now.append(place)
        return place in self._iterates or self._knows(cost, infeasibility)

    def ended(self, cost: float, infeasibility: float, converged: bool) -> None:
        """Take note of where the present search ended."""
        self._iterates.update(self._now)
        self._now = []
        if converged or self._knows(cost, infeasibility):
            self._costs.append(cost)

    def _knows(self, cost: float, infeasibility: float) -> bool:
        return infeasibility <= _MET and any(
            abs(cost - known) <= _SAME * abs(known) for known in self._costs)

    def enough(self) -> bool:
        """
        Return whether no other minimum is to be expected after so many searches.

        After n that led to w minima, w (n - 1) / (n - w - 2) is expected of how many there are:
        C. G. E. Boender, A. H. G. Rinnooy Kan, Bayesian stopping rules for multistart global
        optimization methods, Math. Program. 37 (1987).
        """
        n, ordered = len(self._costs), np.sort(self._costs)
        w = 1 + int(np.count_nonzero(np.diff(ordered) > ANOTHER * np.abs(ordered[1:])))
        return n > w + 2 and w * (n - 1) / (n - w - 2) <= w + 0.5
