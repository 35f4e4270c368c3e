# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The optimal control problem of section 2.2.

Minimise J = integral of L(x, u) over [0, T] + V(x(T))
subject to dx/dt = f(x, u), x(0) = x0, psi(x(T)) = 0, u in a box,
and, beyond the book: x in a box, path constraints, T given or free.
"""

from dataclasses import dataclass, field

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.ocp.guess import Guess

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


@dataclass(frozen=True, eq=False)
class Problem:
    """
    A valid optimal control problem: symbols, expressions in them, and numbers.

    Numbers that a user would vary (parameters, x0, bounds, T) do not appear in the expressions,
    so that two problems with the same `structure` can share compiled programs.

    Attributes
    ----------
    states, inputs, parameters : tuple of str
        Names, in the order of x (n,), u (m,) and p (k,).
    x, u, p : casadi.SX
        Symbols, columns.
    f, L, V, psi : casadi.SX
        dx/dt (n, 1), running cost, terminal cost (of x), terminal constraints (q, 1) (of x).
    path : casadi.SX
        Path constraints c(x, u), shape (l, 1), path_lower <= c <= path_upper.
    p_value, x0 : ndarray
        Values of p (k,) and of x(0) (n,).
    x_lower, x_upper, u_lower, u_upper, path_lower, path_upper : ndarray
        Bounds; -inf and inf for none.
    final_time : FinalTime
        Final time [s].
    guess : Guess
        Initial guess.
    angles : tuple of bool
        For each state, whether it wraps; used for guesses only.
    structure : str
        Equal for two problems that differ only in numbers.
    method : str
        Method to solve it with, one of `method_names.NAMES`.

    """

    name: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    x: ca.SX = field(repr=False)
    u: ca.SX = field(repr=False)
    p: ca.SX = field(repr=False)
    f: ca.SX = field(repr=False)
    L: ca.SX = field(repr=False)
    V: ca.SX = field(repr=False)
    psi: ca.SX = field(repr=False)
    path: ca.SX = field(repr=False)
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
    angles: tuple[bool, ...] = ()
    structure: str = ''
    method: str = 'auto'

    @property
    def n(self) -> int:
        """Return the number of states."""
        return len(self.states)

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
