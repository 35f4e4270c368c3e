# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Record of the local minima found by multistart, with a stopping rule."""

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.solver.options import CoarseOptions, DEFAULTS
from obc_ros.core.solver.transcription.mesh import Path

ANOTHER = 1e-3   # relative difference of two costs above which they are of different minima
CHEAPER = 1e-6   # relative difference that counts of two costs on fine meshes
SAME = 2e-4      # relative difference up to which a coarse cost is that of a known minimum
MET = 1e-5       # infeasibility of a feasible path


class LocalMinima:
    """
    The costs of the local minima found from several starts, and the iterates of the solves.

    A solve can end early at an iterate of another one, since it continues like that one, or at a
    feasible iterate with the cost of a known minimum.
    """

    def __init__(self, options: CoarseOptions = DEFAULTS.coarse) -> None:
        self._options = options
        self._seen: tuple[Array, Array] | None = None
        self._part = 1.0
        self._costs, self._regular, self._failed = list[float](), list[float](), 0
        self._iterates = set[tuple[str, str]]()
        self._now = list[tuple[str, str]]()

    def record_iterate(self, cost: float, infeasibility: float) -> bool:
        """Record an iterate of the present solve; return whether it leads to a known minimum."""
        place = f'{cost:.7e}', f'{infeasibility:.4e}'
        self._now.append(place)
        return place in self._iterates or self._knows(cost, infeasibility)

    def record_end(self, cost: float, infeasibility: float, path: Path | None, *,
                   rollout: bool = False) -> None:
        """
        Record the end of the present solve, with its path if it converged.

        `rollout`: whether it began at a rollout of random inputs, see `Path`.
        """
        self._iterates.update(self._now)
        self._now = []
        dear = rollout and self._far(cost)
        if path is not None and not dear:   # an expensive rollout would enlarge all guesses
            x, u = path.x, np.vstack([path.ua, path.ub])
            new = np.ptp(x, axis=0), np.maximum(np.ptp(u, axis=0), np.abs(u).max(axis=0))
            known = self._seen or new
            self._seen = np.maximum(known[0], new[0]), np.maximum(known[1], new[1])
        if path is None and not (infeasibility < self._options.wild or rollout):
            self._part /= 2
        if path is not None or self._knows(cost, infeasibility):
            self._costs.append(cost)
            self._regular += [] if rollout else [cost]
        else:
            self._failed += not rollout

    @property
    def spans(self) -> tuple[Array, Array] | None:
        """
        Return the ranges of states (n,) and inputs (m,) for guesses, None without a path.

        They are those of the paths found, reduced after each start from which states diverged.
        """
        return self._seen and (self._part * self._seen[0], self._part * self._seen[1])

    def _far(self, cost: float) -> bool:
        least = min(self._costs, default=cost)
        return cost - least > abs(least)

    def _knows(self, cost: float, infeasibility: float) -> bool:
        return infeasibility <= MET and any(
            abs(cost - known) <= SAME * abs(known) for known in self._costs)

    @property
    def rough(self) -> bool:
        """Return whether more than a quarter of the solves failed or ended at twice the cost."""
        far = sum(map(self._far, self._regular))
        return 4 * (self._failed + far) > self._failed + len(self._regular)

    @property
    def minima(self) -> int:
        """Return the number of different minima found."""
        ordered = np.sort(self._costs)
        apart = int(np.count_nonzero(np.diff(ordered) > ANOTHER * np.abs(ordered[1:])))
        return min(len(ordered), 1) + apart

    def enough(self) -> bool:
        """
        Return whether no further minimum is expected.

        After n solves that led to w minima the expected number of minima is
        w (n - 1) / (n - w - 2): C. G. E. Boender, A. H. G. Rinnooy Kan, Bayesian stopping rules
        for multistart global optimization methods, Math. Program. 37 (1987).
        """
        n, w = len(self._costs), self.minima
        return n > w + 2 and w * (n - 1) / (n - w - 2) <= w + 0.5
