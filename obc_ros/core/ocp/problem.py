# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The optimal control problem of section 2.2: see docs/certificate.md.

Beyond the book: x in a box, path constraints, T given or free, x(0) in a box. The time, parameters
to be found and conditions on x(0) are stated with additional states, which are the last ones
(`augmentation`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Generic, TypeVar

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.ocp.guess import Guess
from obc_ros.core.ocp.phases import PhaseLayout
from obc_ros.core.text.packed_expressions import pack_expressions, PackedExpressions
from obc_ros.core.text.tables import Tabulated

Kept = TypeVar('Kept')

SYMBOLIC = 'x', 'u', 'p', 'f', 'L', 'V', 'psi', 'path'   # fields that one structure determines


@dataclass(frozen=True)
class FinalTime:
    """The final time T [s]: `value` if given; in [lower, upper], initially `guess`, if free."""

    free: bool
    value: float = np.nan
    lower: float = np.nan
    upper: float = np.nan
    guess: float | None = None

    @property
    def earliest(self) -> float:
        """Return the first admissible T [s]."""
        return self.lower if self.free else self.value

    @property
    def latest(self) -> float:
        """Return the last admissible T [s]."""
        return self.upper if self.free else self.value

    def place_end(self, t: Array) -> Array:
        """Return times (N,) with the given T exactly in place of the rounded sum of intervals."""
        return t if self.free else np.where(t < t[-1], np.minimum(t, self.value), self.value)


@dataclass(frozen=True, eq=False)
class FreeStart:
    """
    Where x(0) may be, if it is not given.

    :ivar lower, upper: (n,), bounds of x(0); equal for a state whose x(0) is given, -inf and inf
        for none.
    :ivar linked: pairs (i, j) of states that are equal at t = 0. No j is in two of them.
    """

    lower: Array
    upper: Array
    linked: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class Problem(Tabulated):
    """
    A valid optimal control problem: symbols, expressions in them, and numbers.

    Numbers that a user would vary (parameters, x0, bounds, T) do not appear in the expressions,
    so that two problems with the same `structure` can share compiled programs.

    :ivar states, inputs, parameters: names, in the order of x (n,), u (m,) and p (k,).
    :ivar x, u, p: symbols, columns.
    :ivar f, L, V, psi: dx/dt (n, 1), running cost, terminal cost (of x), terminal constraints (q,
        1) (of x).
    :ivar path: path constraints c(x, u), shape (l, 1), path_lower <= c <= path_upper.
    :ivar p_value, x0: values of p (k,) and of x(0) (n,); where x(0) is not given, an initial guess
        of it.
    :ivar x_lower, x_upper, u_lower, u_upper, path_lower, path_upper: bounds; -inf and inf for
        none.
    :ivar starts: further initial guesses, which a search tries besides its own.
    :ivar angles: for each state, whether it wraps; used for guesses only.
    :ivar structure: equal for two problems that differ only in numbers.
    :ivar method: method to solve it with, one of `method_names.NAMES`.
    :ivar accept: answer that ends the search, one of `method_names.ACCEPTED`.
    :ivar start: None if x(0) = x0.
    :ivar added: number of the states, the last ones, that the statement does not have: the time,
        free parameters, initial values. See `augmentation`.
    :ivar held: number of the inputs, the last ones, that the statement does not have: one, which
        is 0, in a problem without inputs.
    :ivar free_parameters: names of those of the added states that are parameters to be found.
    :ivar has_clock: whether the first of the added states is the time.
    :ivar phases: what the states and the inputs are if the statement has phases; T is 1 then.
    :ivar ends: the keys of the statement that the rows of psi are from.
    :ivar breaks: times in (0, T) of mesh points between which expressions are smooth, sorted [s].
    :ivar edges: (K, 2), spans between two of `breaks`, too short to count, in which expressions
        have a kink or jump, sorted [s].
    :ivar units: units by name, of states, inputs and parameters; for figures only.
    :ivar statement: the keys that it was built from, with the initial state by name and
        records of what functions returned.
    """

    name: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    x: ca.SX
    u: ca.SX
    p: ca.SX
    f: ca.SX
    L: ca.SX
    V: ca.SX
    psi: ca.SX
    path: ca.SX
    p_value: Array
    x0: Array
    x_lower: Array
    x_upper: Array
    u_lower: Array
    u_upper: Array
    path_lower: Array
    path_upper: Array
    final_time: FinalTime
    guess: Guess = field(default_factory=Guess)
    starts: tuple[Guess, ...] = ()
    angles: tuple[bool, ...] = ()
    structure: str = ''
    method: str = 'auto'
    accept: str = 'certified'
    start: FreeStart | None = None
    added: int = 0
    held: int = 0
    free_parameters: tuple[str, ...] = ()
    has_clock: bool = False
    phases: PhaseLayout | None = None
    ends: tuple[str, ...] = ()
    breaks: Array = field(default_factory=lambda: np.zeros(0))
    edges: Array = field(default_factory=lambda: np.zeros((0, 2)))
    units: Mapping[str, str] = field(default_factory=dict)
    statement: Mapping[Any, Any] = field(default_factory=dict, repr=False)

    def _title(self) -> str:
        return f'Problem {self.name}'

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how another process makes the problem, with symbols of its own."""
        packed = pack_expressions(*([getattr(self, name) for name in names] for names in (
            SYMBOLIC[:3], SYMBOLIC[3:])))
        return _unpack_problem, (packed, {
            each.name: getattr(self, each.name) for each in fields(self)
            if each.name not in SYMBOLIC})

    @property
    def n(self) -> int:
        """Return the number of states."""
        return len(self.states)

    @property
    def stated(self) -> int:
        """Return the number of states of the statement, the first ones."""
        return self.n - self.added

    @property
    def shown_states(self) -> tuple[str, ...]:
        """Return the names of the states in answers."""
        return self.states[:self.stated] if self.phases is None else self.phases.states

    @property
    def shown_inputs(self) -> tuple[str, ...]:
        """Return the names of the inputs in answers."""
        return self.inputs[:self.m - self.held] if self.phases is None else self.phases.inputs

    @property
    def m(self) -> int:
        """Return the number of inputs."""
        return len(self.inputs)

    @property
    def q(self) -> int:
        """Return the number of terminal constraints."""
        return int(self.psi.numel())

    @property
    def boxed(self) -> Mask:
        """Return which inputs have both bounds, shape (m,)."""
        return np.asarray(np.isfinite(self.u_lower) & np.isfinite(self.u_upper))

    @property
    def constrained(self) -> bool:
        """Return whether there are state bounds or path constraints."""
        return bool(self.path.numel() or np.isfinite([self.x_lower, self.x_upper]).any())

    @property
    def row_bounds(self) -> tuple[Array, Array]:
        """Return the lower and the upper bounds of x and of the path constraints, (n + l,)."""
        return (np.append(self.x_lower, self.path_lower),
                np.append(self.x_upper, self.path_upper))

    @property
    def start_box(self) -> tuple[Array, Array]:
        """Return the bounds of x(0), (n,) each."""
        return (self.x0, self.x0) if self.start is None else (self.start.lower, self.start.upper)

    @property
    def given_at_start(self) -> Mask:
        """Return for which states x(0) is given, shape (n,)."""
        lower, upper = self.start_box
        return np.asarray(lower == upper)

    def edges_in(self, t: Array) -> Mask:
        """Return which intervals between times (N + 1,) are parts of `edges`."""
        middle, (starts, ends) = 0.5 * (t[:-1] + t[1:]), self.edges.T
        k = np.searchsorted(starts, middle) - 1
        length = np.append(ends - starts, 0.0)[k]   # the middle of a long interval may be in one
        return (k >= 0) & (middle <= np.append(ends, 0.0)[k]) & (np.diff(t) < 2 * length)

    def pin_start(self, x: Array) -> 'Problem':
        """Return the problem whose x(0) is given: where it is free, that of a path, x (n,)."""
        if self.start is None:
            return self
        return replace(self, start=None, x0=np.where(self.given_at_start, self.x0, x))


def _unpack_problem(packed: PackedExpressions, numbers: Mapping[str, Any]) -> Problem:
    columns, expressions = packed.unpack()
    symbolic: dict[str, Any] = dict(zip(SYMBOLIC, columns + expressions, strict=True))
    return Problem(**numbers, **symbolic)


class ByStructure(Generic[Kept]):
    """What is built for a problem and serves all of its structure."""

    def __init__(self, build: Callable[[Problem], Kept], most: int) -> None:
        self._build, self._most = build, most
        self._kept: dict[str, Kept] = {}   # the one used last is at the end

    def __call__(self, problem: Problem) -> Kept:
        """Return what is kept for the structure of a problem, or build it; keep the last ones."""
        found = self._kept.pop(problem.structure, None) or self._build(problem)
        if problem.structure:
            self._kept[problem.structure] = found
            if len(self._kept) > self._most:
                self._kept.pop(next(iter(self._kept)), None)
        return found
