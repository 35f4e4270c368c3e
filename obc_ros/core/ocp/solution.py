# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Solution of an optimal control problem, its certificate and its optimality.

The costates have the sign of H = L + lam' f; dlam/dt = -dH/dx, and at T
lam = dV/dx + nu' dpsi/dx.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
import math

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.tables import format_residual, format_table, Tabulated

MOST_MINIMA = 8       # costs of local minima in a solution, at most
MOST_ATTEMPTS = 300   # attempts in a solution, at most
MAX_INTERVALS = 2000  # intervals of a mesh, default maximum

# Called as report(phase, iteration, cost, infeasibility) while a solver works; True stops it.
Report = Callable[[str, int, float, float], bool]


class Status(StrEnum):
    """How a request ended."""

    SOLVED = 'solved'
    FEASIBLE = 'feasible'   # a path that meets all constraints, without certificate of optimality
    INFEASIBLE = 'infeasible'
    NOT_CONVERGED = 'not_converged'
    TIMED_OUT = 'timed_out'
    CANCELLED = 'cancelled'
    MALFORMED = 'malformed'


class Condition(StrEnum):
    """A necessary condition that a certificate holds an answer to; see `certificate`."""

    DYNAMICS = 'dynamics'
    START = 'start'
    END = 'end'
    BOUNDS = 'bounds'
    COSTATE = 'costate'
    MINIMUM = 'minimum'
    TRANSVERSALITY = 'transversality'
    HAMILTONIAN = 'hamiltonian'
    FINAL_TIME = 'final_time'
    COST = 'cost'

    __str__ = str.__str__


# The conditions for being a path of the problem, extremal or not.
_FEASIBLE = (Condition.DYNAMICS, Condition.START, Condition.END, Condition.BOUNDS, Condition.COST)


@dataclass(frozen=True, repr=False)
class Certificate(Tabulated):
    """
    One scaled residual for each necessary condition, and its tolerance.

    `residuals` and `tolerances` share their keys: each `Condition` (FINAL_TIME for a free T
    only, MINIMUM only if there are inputs), or each `KktCondition` for a minimum of finitely many
    variables. A residual that cannot be computed is infinite. Both have no unit.

    :ivar excess: estimate of how far the cost is above that of the nearest local minimum, in units
        of the cost; see `certificate`. nan: there is none.
    """

    residuals: Mapping[str, float]
    tolerances: Mapping[str, float]
    excess: float = math.nan

    @property
    def holds(self) -> bool:
        """Return whether every residual is within its tolerance."""
        return all(self.residuals[key] <= self.tolerances[key] for key in self.tolerances)

    @property
    def feasible(self) -> bool:
        """Return whether the path keeps to the problem, extremal or not."""
        return not self.fault

    @property
    def worst(self) -> str:
        """Return the condition with the largest residual relative to its tolerance."""
        return max(self.tolerances, key=self._size)

    @property
    def fault(self) -> str:
        """Return the worst condition for being a path of the problem that fails; '' for none."""
        return max(self.faults, key=self._size, default='')

    @property
    def faults(self) -> tuple[str, ...]:
        """Return the conditions for being a path of the problem that fail."""
        return tuple(key for key in _FEASIBLE if not self.residuals[key] <= self.tolerances[key])

    @property
    def unmet(self) -> tuple[str, ...]:
        """Return the conditions that fail."""
        return tuple(key for key in self.tolerances
                     if not self.residuals[key] <= self.tolerances[key])

    @property
    def largest_violation(self) -> str:
        """Return the condition for being a path that is nearest to its tolerance, in words."""
        key = max(_FEASIBLE, key=self._size)
        return f'{key}, {self.residuals[key]:.1e} of {self.tolerances[key]:.0e}'

    @property
    def sentence(self) -> str:
        """Return the verdict in words, with the condition that is nearest to its tolerance."""
        worst = self.worst
        residual, tolerance = self.residuals[worst], self.tolerances[worst]
        if self.holds:
            return (f'all {len(self.tolerances)} conditions hold; nearest to its tolerance: '
                    f'{worst}, {residual:.2g} of {tolerance:.2g}')
        if not math.isfinite(residual):
            return f'{worst} is not shown to hold: its residual could not be computed'
        return f'{worst} does not hold: its residual is {residual:.2g}, over {tolerance:.2g}'

    _HEADER = ('condition', 'residual', 'tolerance', 'verdict')

    def rows(self) -> list[tuple[str, str, str, str]]:
        """Return condition, residual, tolerance and verdict of each condition, as text."""
        return [(str(key), format_residual(self.residuals[key]), f'{tolerance:.2g}',
                 'holds' if self.residuals[key] <= tolerance else 'does not hold')
                for key, tolerance in self.tolerances.items()]

    def _title(self) -> str:
        return f'Certificate: {self.sentence}' if self.tolerances else 'Certificate: none'

    def _rows(self) -> list[tuple[str, ...]]:
        return [*self.rows()]

    def __str__(self) -> str:
        return format_table(self._HEADER, self.rows())

    def _size(self, key: str) -> float:
        return self.residuals[key] / self.tolerances[key]


class Verdict(StrEnum):
    """How an attempt to solve a problem, or a part of it, ended."""

    CERTIFIED = 'certified'           # the certificate passes
    NOT_CERTIFIED = 'not certified'   # there is a path, but its certificate does not pass
    CONVERGED = 'converged'           # a discretised problem is solved
    NOT_CONVERGED = 'not converged'
    ACCEPTED = 'accepted'             # the search goes on from the result
    REJECTED = 'rejected'             # it goes on without the result
    PROVED = 'proved'                 # what was to be shown
    NOT_PROVED = 'not proved'
    STOPPED = 'stopped'               # before an end

    __str__ = str.__str__


@dataclass(frozen=True)
class Attempt:
    """
    One step of the search for a solution.

    :ivar number: from 1, in the order in which attempts began.
    :ivar parent: number of the attempt that it belongs to; 0: none.
    :ivar method: what kind of step, for example 'initial guess' or 'mesh'.
    :ivar what: what was tried, in words.
    :ivar begun, work: iterations times intervals: of the whole search before it, and of it with
        all attempts that belong to it.
    :ivar cost: nan without a path.
    :ivar loss: Hamiltonian loss relative to |cost|: how far the cost is above the nearest local
        minimum, to first order; nan if it was not measured.
    :ivar why: why the search went on or stopped, in words.
    """

    number: int
    parent: int
    method: str
    what: str
    begun: int
    work: int
    cost: float
    loss: float
    verdict: Verdict
    why: str


@dataclass(frozen=True, repr=False)
class Optimality(Tabulated):
    """
    Optimality of a certified solution among all paths of its problem.

    :ivar kind: 'global': it is proved that no path costs less. 'local': no cheaper path was found.
    :ivar reason: the proof, or the extent of the search, as text.
    :ivar starts: initial guesses of the search; 0 without a search.
    :ivar minima: costs of distinct local minima found, ascending, at most `MOST_MINIMA`. The first
        is that of this solution. The others are accurate to the mesh on which they were found.
    """

    kind: str
    reason: str
    starts: int = 0
    minima: tuple[float, ...] = ()

    def _title(self) -> str:
        return f'Optimality: {self.kind}'


@dataclass(frozen=True, eq=False, repr=False)
class Solution(Tabulated):
    """
    States, inputs and costates on a grid, the cost, and the method of solution.

    :ivar message: the result in a sentence.
    :ivar objective: cost J.
    :ivar t: (N,), times [s], nondecreasing; at a jump a time appears twice (before, after).
    :ivar x, u, lam: (N, n), (N, m), (N, n), states, inputs, costates.
    :ivar hamiltonian: (N,), H = L + lam' f along the path.
    :ivar nu: (q,), multipliers of the terminal constraints.
    :ivar state_multipliers: (N, n), density of the multipliers of the state bounds in
        dlam/dt = -dH/dx - state_multipliers (> 0 at an upper bound, < 0 at a lower one); None
        without state bounds.
    :ivar path_multipliers: (N, l), the same for the path constraints: H is augmented by
        path_multipliers' c(x, u).
    :ivar interpolation: of u between samples: 'linear' or 'zoh' (constant from each sample on).
    :ivar switching_times: times at which an input jumps or changes its arc [s].
    :ivar method: method that found it, one of `method_names.NAMES`.
    :ivar build_time, solve_time: wall-clock times for building and for solving programs [s].
    :ivar first_path_time: wall-clock time after which the first path was found whose certificate
        shows that it meets all constraints [s]; nan if there was none.
    :ivar certificate: None if there is no path.
    :ivar optimality: None for a solution without a certificate that passes.
    :ivar attempts: what was tried, at most `MOST_ATTEMPTS`; the most detailed are left out first.
    :ivar free_parameters: of a solution with the states of the statement only; see
        `augmentation.hide_added_states`.
    :ivar remark: what decided a certified solution, with its number, if that was a bound of the
        search or a missing part of the statement; otherwise empty. The message ends with it.
    """

    status: Status
    message: str
    objective: float = np.nan
    t: Array = field(default_factory=lambda: np.zeros(0))
    x: Array = field(default_factory=lambda: np.zeros((0, 0)))
    u: Array = field(default_factory=lambda: np.zeros((0, 0)))
    lam: Array = field(default_factory=lambda: np.zeros((0, 0)))
    hamiltonian: Array = field(default_factory=lambda: np.zeros(0))
    nu: Array = field(default_factory=lambda: np.zeros(0))
    state_multipliers: Array | None = None
    path_multipliers: Array | None = None
    interpolation: str = 'linear'
    switching_times: Array = field(default_factory=lambda: np.zeros(0))
    method: str = ''
    iterations: int = 0
    build_time: float = 0.0
    solve_time: float = 0.0
    first_path_time: float = math.nan
    certificate: Certificate | None = None
    optimality: Optimality | None = None
    attempts: tuple[Attempt, ...] = ()
    free_parameters: Mapping[str, float] = field(default_factory=dict)
    remark: str = ''

    def _title(self) -> str:
        return f'Solution: {self.status.value}'

    @property
    def certified(self) -> bool:
        """Return whether there is a certificate that passes."""
        return self.certificate is not None and self.certificate.holds

    @property
    def feasible(self) -> bool:
        """Return whether there is a certificate that shows a path, extremal or not."""
        return self.certificate is not None and self.certificate.feasible

    def meets(self, limits: Mapping[Condition, float]) -> bool:
        """Return whether there is a certificate whose residuals are within some limits."""
        certificate = self.certificate
        return certificate is not None and all(
            certificate.residuals.get(key, np.inf) <= limit for key, limit in limits.items())
