# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The terminal set: an ellipsoid in which the sampled regulator keeps all limits, with its proof.

docs/receding_horizon_theory.md has the proof, with its names, and what it assumes. It is one about
real numbers: what is not an interval is a sum of products of matrices, whose rounding errors are
less than a part `rounding` of the sum of their absolute values. This part is added. In V(e+),
decrease is at least the norm of the linear loop in that of P, and offset is due to r.
"""

from dataclasses import dataclass
import math

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, linalg
from obc_ros.core.numerics.enclosures.interval_arithmetic import enclose_outputs
from obc_ros.core.numerics.instructions import Instructions, separate_numbers
from obc_ros.core.numerics.rounding import EPS
from obc_ros.core.receding.formulation import RecedingProblem
from obc_ros.core.text.errors import RefusedDesignError

_PART = 0.01           # least decrease at the boundary, relative to that of the linear loop
_BISECTIONS = 20
_GROWTHS = 12          # of the box of a period
_BOXES = 8             # nested ones, for the mean of a Jacobian
_LARGEST = 1e12        # level that is taken for no limit at all
_SMALLEST = 1e-12
_LONGEST = 100.0       # norm of the exponent of a series
_EXTREME = 200.0       # logarithm of V of a unit of a state: no underflow matters below it


@dataclass(frozen=True, eq=False)
class TerminalSet:
    """
    The set {e'P e <= level} of errors e about the set point (n,), with its proof.

    :ivar limit: what determines the level: a limit by its name, or 'decrease of V'.
    :ivar decrease, offset: sqrt(V(e+)) <= decrease sqrt(V(e)) + offset for all e of the set, with
        decrease < 1. The offset is 0 if f at the set point is proved to be exactly 0 (or its
        drift).
    """

    P: Array
    level: float
    limit: str
    decrease: float
    offset: float
    words: str

    def measure(self, e: Array) -> float:
        """Return V over the level at an error e (n,): at most 1 in the set."""
        return float(e @ self.P @ e) / self.level


@np.errstate(all='ignore')   # an overflow proves nothing
def find_terminal_set(problem: RecedingProblem) -> TerminalSet:
    """
    Return the largest set that can be proved to be invariant under the regulator.

    If the set point moves, the errors are those about the moving one.

    :raises RefusedDesignError: if there is no such set: a limit is reached at the set point or by
        its motion, V does not decrease in any ellipsoid that is not tiny, or P is too
        ill-conditioned for a proof.
    """
    _check_motion(problem)
    bounds = _PeriodBounds(problem)
    levels = _list_linear_levels(problem, bounds)
    limit, linear = min(levels.items(), key=lambda each: each[1], default=('none', math.inf))
    if linear <= _SMALLEST:
        raise RefusedDesignError(f'terminal set: the set point is at the limit of {limit}')
    low = top = min(linear, _LARGEST)
    found = bounds.prove(top)
    if found is not None:
        return _state(problem, top, limit if linear < _LARGEST else 'none', found)
    while found is None and low > _SMALLEST:
        high, low = low, low / 4.0
        found = bounds.prove(low)
    if found is None:
        raise RefusedDesignError(
            'terminal set: the decrease of V cannot be proved in any ellipsoid about the set '
            f'point, where its rate is only known to be below {bounds.residual.max():.2g}; '
            'wanted a higher rate, or other weights')
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        better = bounds.prove(middle)
        low, high, found = (low, middle, found) if better is None else (middle, high, better)
    why = 'path constraints' if bounds.paths_reached(high) else 'decrease of V'
    return _state(problem, low, why, found)


def _list_linear_levels(problem: RecedingProblem, bounds: '_PeriodBounds') -> dict[str, float]:
    """
    Return for each input bound, state bound and angle a level up to which it is kept.

    For c'e <= b it is b^2 / (c'P^-1 c), rounded down.
    """
    limits, unit = problem.limits, np.eye(problem.limits.n)
    rows = [(name, row, min(at - low, high - at)) for name, row, at, low, high in (
        *zip(limits.inputs, problem.K, problem.ue, limits.u_lower, limits.u_upper, strict=True),
        *zip(limits.states, unit, problem.xe, limits.x_lower, limits.x_upper, strict=True))]
    rows += [(f'half a turn of {signal.name}', row, math.pi) for signal, row in zip(
        problem.system.states, unit, strict=True) if signal.angle]
    return {name: (max(b, 0.0) / bounds.bound_functionals(row[None])[0])**2 / bounds.above
            for name, row, b in rows if math.isfinite(b) and row.any()}


class _Rates:
    """Bounds of f less the drift, and of its Jacobian, in boxes about the set point."""

    def __init__(self, problem: RecedingProblem) -> None:
        system, drift = problem.system, ca.SX.sym('drift', problem.system.n)
        z, p = ca.vertcat(system.x, system.u), ca.vertcat(system.p, drift)
        f, numbers, values = separate_numbers(system.xdot - drift, [z, p])
        self._centre = np.concatenate([problem.xe, problem.ue])
        self._numbers = np.concatenate([system.p_value, problem.drift, values])
        self._f, self._jacobian = (
            Instructions(ca.Function('of_f', [z, ca.vertcat(p, numbers)], [ca.densify(each)]))
            for each in (f, ca.jacobian(f, z)))
        self.jumps = self._f.have(ca.OP_ATAN2)   # its derivatives do not show that

    def bound_residual(self) -> Array:
        """Return bounds of |f - drift| (n,) at the set point."""
        low, high = self._enclose(self._f, 0.0 * self._centre)
        return np.maximum(np.abs(low), np.abs(high))

    def enclose_jacobian(self, size: Array) -> tuple[Array, Array]:
        """Return bounds of df/dz (n, n + m) in the box |z - centre| <= size."""
        low, high = self._enclose(self._jacobian, size)
        k = len(size)
        return low.reshape(k, -1).T, high.reshape(k, -1).T

    def bound_slopes(self, size: Array, middle: Array) -> Array:
        """
        Return bounds of |S - middle| (n, n + m) for all z of the box.

        The part of S between (i - 1) / k and i / k of the way to z is in the box i size / k.
        """
        ends = (self.enclose_jacobian(i * size / _BOXES) for i in range(1, _BOXES + 1))
        return np.asarray(sum(np.maximum(high - middle, middle - low)
                              for low, high in ends)) / _BOXES

    def _enclose(self, program: Instructions, size: Array) -> tuple[Array, Array]:
        found = enclose_outputs(program, [self.surround(size), (self._numbers, self._numbers)])
        low, high = np.array(found).T
        return low, high

    def surround(self, size: Array) -> tuple[Array, Array]:
        """Return a box with the set point +- size inside, without a width where size is 0."""
        low, high = self._centre - size, self._centre + size
        return (np.where(size > 0.0, np.nextafter(low, -np.inf), low),
                np.where(size > 0.0, np.nextafter(high, np.inf), high))


class _PeriodBounds:
    """
    Bounds of the loop over a period, for all errors of an ellipsoid.

    :ivar residual: (n,), bound of the rate of the error at the set point.
    :ivar above: 1 + the part of a number that exceeds its rounding errors.
    """

    def __init__(self, problem: RecedingProblem) -> None:
        P, K, limits = problem.P, problem.K, problem.limits
        m, n = K.shape
        # Less than 2000 (n + m + 1) roundings follow each other, each of a part EPS / 2.
        self._rounding = 1e4 * (n + m + 1) * EPS
        self.above = 1.0 + self._rounding
        self._rates, self._h, self._P = _Rates(problem), problem.period, 0.5 * (P + P.T)
        size = 1.0 / np.sqrt(P.diagonal())
        self._size = np.concatenate([size, np.abs(K) @ size, [0.0]])
        self.residual = self._rates.bound_residual()
        low, high = self._rates.enclose_jacobian(np.zeros(n + m))
        self._slopes = 0.5 * low + 0.5 * high
        G = self._fill(self._slopes, np.zeros(n))
        loop = self._propagate(G, np.concatenate([np.eye(n), -K, np.zeros((1, n))]))[:n]
        if self._rates.jumps or not (
                np.isfinite(loop).all() and np.isfinite(self.residual).all()):
            raise RefusedDesignError(
                'terminal set: the rate of the state at the set point or its derivatives cannot '
                f'be bounded over a period of {self._h:g} s; wanted a higher rate, and dynamics '
                'without jumps or kinks (atan2, abs)')
        self._Z, self._least, self._contraction = _certify(self._P, loop, self._rounding)
        self._w = self.bound_functionals(np.concatenate([np.eye(n), K]))
        # |z(0)| per sqrt(V), its last entry, and the absolute values whose sums are rounded.
        self._start = np.zeros((n + m + 1, 3))
        self._start[:-1, 0], self._start[-1, 1] = self._w, 1.0
        self._start[:-1, 2] = np.concatenate([self._w[:n], np.abs(K) @ self._w[:n]])
        self._absolute, self._M = np.abs(G), np.abs(G)
        np.fill_diagonal(self._M, G.diagonal())
        self._linear = self._propagate(self._M, self._start)
        self._paths = Instructions(ca.Function(
            'paths', [ca.vertcat(limits.x, limits.u), limits.p], [ca.densify(limits.path)]))
        self._p_box = limits.p_value, limits.p_value
        self._path_box = limits.path_lower, limits.path_upper

    def bound_functionals(self, C: Array) -> Array:
        """Return bounds w (r,) with |c'e| <= w sqrt(V(e)) for each row c of C (r, n)."""
        image = np.abs(C @ self._Z) + self._rounding * (np.abs(C) @ np.abs(self._Z))
        return np.asarray(np.sqrt((image * image).sum(axis=1) / self._least) * self.above)

    def prove(self, level: float) -> tuple[float, float] | None:
        """Return decrease and offset if they prove the level."""
        s = math.sqrt(level) * self.above
        R = self._bound_rates(s)
        if R is None or self.paths_reached(level):
            return None
        n, ahead = len(self._P), self._propagate(self._M + R, self._start)
        apart = (ahead - self._linear)[:n, :2] + self._rounding * ahead[:n, [2, 1]]
        wider, offset = np.sqrt((apart * (np.abs(self._P) @ apart)).sum(axis=0)) * self.above
        decrease = (self._contraction + wider) * self.above
        least = 1.0 - _PART * (1.0 - self._contraction)
        proved = (decrease + offset / math.sqrt(level)) * self.above <= least < 1.0
        return (float(decrease), float(offset)) if proved else None

    def paths_reached(self, level: float) -> bool:
        """Return whether a path constraint is not proved to hold in the ellipsoid."""
        box = self._rates.surround(math.sqrt(level) * self.above * self._w)
        found = enclose_outputs(self._paths, [box, self._p_box])
        return any(not (low <= each.low and each.high <= high)
                   for each, low, high in zip(found, *self._path_box, strict=True))

    def _bound_rates(self, s: float) -> Array | None:
        """Return R for sqrt(V(e)) <= s; None if no box is found that z does not leave."""
        size = 1.05 * s * self._w
        for _ in range(_GROWTHS):
            R = self._fill(self._rates.bound_slopes(size, self._slopes), self.residual)
            reached = self._propagate(self._absolute + R, self._start)[:-1] @ [s, 1.0, 0.0]
            if (reached * self.above <= size).all():
                return R
            size = 1.02 * reached
        return None

    def _fill(self, slopes: Array, rest: Array) -> Array:
        """Return h F (n + m + 1, n + m + 1) for its rows of e, (n, n + m) and (n,)."""
        n, k = slopes.shape
        F = np.zeros((k + 1, k + 1))
        F[:n] = self._h * np.column_stack([slopes, rest])
        return F

    def _propagate(self, F: Array, start: Array) -> Array:
        """
        Return exp(F) start (n + m + 1, k) by a series; infinite if F is too large for it.

        exp(F) = exp(-c) exp(F + c I). With c >= 0 for which the diagonal is not negative, terms
        cancel only as far as F has negative entries beside it.
        """
        n, c = len(self._P), max(0.0, -float(F.diagonal().min()))
        F = F + c * np.eye(len(F))
        # |F| size <= norm size: the rest of the series is below 1e-20 of its first terms.
        norm = max(c, float((np.abs(F[:n]) @ self._size / self._size[:n]).max()))
        if not norm <= _LONGEST:
            return np.full_like(start, np.inf)
        total = term = start
        for j in range(1, 25 + 5 * int(norm)):
            term = F @ term / j
            total = total + term
        return total * math.exp(-c)


def _certify(P: Array, loop: Array, rounding: float) -> tuple[Array, float, float]:
    """
    Return Z with Z'P Z >= least I, least > 0, and a bound of the norm of a matrix in that of P.

    Z may be any matrix. The one that diagonalises P and loop'P loop gives tight bounds.
    """
    image = loop.T @ P @ loop
    try:
        Z = linalg.eigh(0.5 * (image + image.T), P)[1]
    except (np.linalg.LinAlgError, ValueError):   # not definite, or not finite
        Z = np.zeros_like(P)
    Y, size, length = loop @ Z, np.abs(Z), np.abs(loop) @ np.abs(Z)
    # Row sums of a symmetric matrix bound its eigenvalues.
    off, most = (
        float((np.abs(form) + rounding * terms).sum(axis=1).max()) for form, terms in (
            (Z.T @ P @ Z - np.eye(len(P)), size.T @ np.abs(P) @ size),
            (Y.T @ P @ Y, length.T @ np.abs(P) @ length)))
    if not (off < 0.5 and (np.abs(np.log(P.diagonal())) < _EXTREME).all()):
        raise RefusedDesignError(
            'terminal set: P cannot be proved to be positive definite in double precision: it is '
            'singular or too ill-conditioned; wanted weights of all states, and of more similar '
            'effect')
    least = (1.0 - off) * (1.0 - rounding)
    return Z, least, math.sqrt(most / least) * (1.0 + rounding)


def _check_motion(problem: RecedingProblem) -> None:
    """Raise RefusedDesignError if the motion of the set point reaches a limit."""
    soft, drift = problem.soft, problem.drift
    for i, name in enumerate(soft.names):
        moving = [str(problem.limits.states[j]) for j in np.flatnonzero(drift)
                  if ca.depends_on(soft.rows[i], soft.shift[int(j)])]
        if moving:
            raise RefusedDesignError(
                f'terminal set: the set point moves along {", ".join(moving)}, so that the limit '
                f'of {name} cannot hold for all time; the horizon works without a terminal set')


def _state(problem: RecedingProblem, level: float, limit: str, found: tuple[float, float]
           ) -> TerminalSet:
    """Return the set with its sentence."""
    decrease, offset = found
    about = 'the moving set point' if problem.drift.any() else 'the set point'
    but = f', but for {offset:.1g}, since the set point is rounded' if offset else ''
    words = (f"in e'P e <= {level:.4g} about {about} the regulator keeps all limits at every "
             f'sample, and sqrt(V) falls by at least {1.0 - decrease:.2g} of itself in each '
             f'period of {problem.period:g} s{but}')
    if limit != 'none':
        words += f'; the level is determined by {limit}'
    return TerminalSet(problem.P, level, limit, decrease, offset, words)
