# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The terminal set: an ellipsoid in which the sampled regulator keeps all limits, with its proof.

In the error e about the set point, V(e) = e'P e, and over a period h with v = -K e held,

    e+ = Acl e + r(e),   r(e) = integral over tau of exp(A (h - tau)) (rho(e(tau), v) + r0),

where r0 is f at the set point less its drift, which double precision seldom makes 0, and rho is
the remainder of f after its linear part. Let s = sqrt(V(e)) and S = sqrt(alpha). In {V <= alpha},
|e| <= s w0 with w0_i^2 = (P^-1)_ii, and |v| <= s wv likewise. The Jacobian of f, bounded by
interval arithmetic over a box, bounds the motion during the period, |(e(tau), v)| <= s a + b, if
S a + b stays in the box; b is due to r0. The bounded Hessians then give |r|_P <= s^2 d + offset,
and

    sqrt(V(e+)) <= s (c + S d) + offset < S,   c the norm of Acl in the norm of P.

The numbers are those of double precision, the proof is one about real numbers. A, B and r0 are
enclosed by interval arithmetic, matrices by balls, c and w by a certificate that does not rely on
its computation (`definite_norm`), and each bound is rounded up. It assumes that the plant is f
with these parameters, that the input is -K e exactly and is held for exactly h, and what
`interval_arithmetic` and `matrix_balls` assume of the machine.
"""

from dataclasses import dataclass
import math

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.enclosures.definite_norm import DefiniteNorm
from obc_ros.core.numerics.enclosures.interval_arithmetic import (
    add_intervals,
    enclose_outputs,
    Interval,
    multiply_intervals,
)
from obc_ros.core.numerics.enclosures.linear_motion import bound_motion, enclose_transition
from obc_ros.core.numerics.enclosures.matrix_balls import add_up, MatrixBall, multiply_up
from obc_ros.core.numerics.instructions import Instructions, separate_numbers
from obc_ros.core.numerics.rounding import TINY
from obc_ros.core.receding.formulation import RecedingProblem
from obc_ros.core.text.errors import RefusedDesignError

_PART = 0.01           # least decrease at the boundary, relative to that of the linear loop
_BISECTIONS = 40
_GROWTHS = 12          # of the box of a period
_LARGEST = 1e12        # level that is taken for no limit at all
_SMALLEST = 1e-12


@dataclass(frozen=True)
class TerminalProof:
    """
    The numbers of a proof.

    Attributes
    ----------
    limit : str
        What determines the level: a limit by its name, or 'decrease of V'.
    linear_level : float
        The largest level in which the linear limits hold.
    contraction : float
        Norm c of the linear loop in the norm of P.
    remainder, offset : float
        |r(e)|_P <= remainder V(e) + offset for all e of the set. The remainder is 0 for an affine
        system, the offset if f at the set point is proved to be exactly 0 (or its drift).
    decrease : float
        sqrt(V(e+)) <= decrease sqrt(V(e)) + offset for all e of the set; below 1.
    words : str
        The result in a sentence.

    """

    limit: str
    linear_level: float
    contraction: float
    remainder: float
    offset: float
    decrease: float
    words: str


@dataclass(frozen=True, eq=False)
class TerminalSet:
    """The set {e'P e <= level} of errors e about the set point (n,), with its proof."""

    P: Array
    level: float
    proof: TerminalProof

    def measure(self, e: Array) -> float:
        """Return V over the level at an error e (n,): at most 1 in the set."""
        return float(e @ self.P @ e) / self.level


@np.errstate(all='ignore')   # an overflow proves nothing
def find_terminal_set(problem: RecedingProblem) -> TerminalSet:
    """
    Return the largest set that can be proved to be invariant under the regulator.

    In it the input bounds, the state bounds and the path constraints hold at every sample, and V
    decreases from sample to sample, down to the rounding of the set point.

    Parameters
    ----------
    problem : RecedingProblem
        The problem. If its set point moves, the errors are those about the moving set point.

    Returns
    -------
    TerminalSet

    Raises
    ------
    RefusedDesignError
        If there is no such set: a limit is reached at the set point or by its motion, V does not
        decrease in any ellipsoid that is not tiny, or P is too ill-conditioned for a proof.

    """
    _check_motion(problem)
    bounds = _PeriodBounds(problem)
    levels = _list_linear_levels(problem, bounds.norm)
    limit, linear = min(levels.items(), key=lambda each: each[1], default=('none', math.inf))
    if linear <= _SMALLEST:
        raise RefusedDesignError(f'terminal set: the set point is at the limit of {limit}')
    top = min(linear, _LARGEST)
    found = bounds.prove(top)
    if found is not None:
        return _state(problem, top, limit if linear < _LARGEST else 'none', linear, found)
    low, high, best = 0.0, top, None
    while high > _SMALLEST and best is None:
        high /= 4.0
        best = bounds.prove(high)
    if best is None:
        raise RefusedDesignError(
            'terminal set: the decrease of V cannot be proved in any ellipsoid about the set '
            f'point, where its rate is only known to be below {bounds.residual.max():.2g}; '
            'wanted a higher rate, or other weights')
    low, high = high, min(4.0 * high, top)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        found = bounds.prove(middle)
        if found is None:
            high = middle
        else:
            low, best = middle, found
        if high - low < 1e-6 * high:
            break
    why = 'path constraints' if bounds.paths_reached(high) else 'decrease of V'
    return _state(problem, low, why, linear, best)


def _list_linear_levels(problem: RecedingProblem, norm: DefiniteNorm) -> dict[str, float]:
    """
    Return for each input bound, state bound and angle a level up to which it is kept.

    For c'e <= b it is b^2 / (c'P^-1 c), rounded down.
    """
    limits = problem.limits
    unit = np.eye(limits.n)
    rows = [(name, row, _room(at, low, high)) for name, row, at, low, high in (
        *zip(limits.inputs, problem.K, problem.ue, limits.u_lower, limits.u_upper, strict=True),
        *zip(limits.states, unit, problem.xe, limits.x_lower, limits.x_upper, strict=True))]
    # pi is rounded down.
    rows += [(f'half a turn of {signal.name}', row, math.pi) for signal, row in zip(
        problem.system.states, unit, strict=True) if signal.angle]
    rows = [(name, row, b) for name, row, b in rows if math.isfinite(b) and row.any()]
    extents = norm.bound_functionals(np.array([row for _, row, _ in rows]).reshape(-1, limits.n))
    levels = {}
    for (name, _, b), w in zip(rows, extents.tolist(), strict=True):
        ratio = max(math.nextafter(b / w, -math.inf), 0.0)
        levels[name] = max(math.nextafter(ratio * ratio, -math.inf), 0.0)
    return levels


def _room(at: float, low: float, high: float) -> float:
    """Return the distance to the nearer bound, rounded down; 0 if one is exceeded."""
    below = add_intervals(Interval(at, at), Interval(-low, -low)).low
    above = add_intervals(Interval(high, high), Interval(-at, -at)).low
    return max(min(below, above), 0.0)


@dataclass(frozen=True)
class _Found:
    """Bounds that prove a level."""

    contraction: float
    remainder: float
    offset: float
    decrease: float


class _Derivatives:
    """Bounds of f and its derivatives with respect to z = (x, u), in boxes about the set point."""

    def __init__(self, problem: RecedingProblem) -> None:
        system = problem.system
        f, numbers, values = separate_numbers(system.xdot, [system.x, system.u, system.p])
        z, p = ca.vertcat(system.x, system.u), ca.vertcat(system.p, numbers)
        self._n, self._centre = system.n, np.concatenate([problem.xe, problem.ue])
        self._numbers = np.concatenate([system.p_value, values])
        self._drift = problem.drift
        J = ca.jacobian(f, z)
        self.is_affine = not ca.depends_on(J, z)
        curved = ca.vertcat(*(ca.vec(ca.densify(ca.jacobian(J[i, :], z)))
                              for i in range(self._n)))
        self._f, self._jacobian, self._hessians = (
            Instructions(ca.Function('of_f', [z, p], [ca.densify(each)]))
            for each in (f, J, curved))

    def bound_residual(self) -> Array:
        """Return bounds of |f - drift| (n,) at the set point."""
        low, high = self._enclose(self._f, np.zeros_like(self._centre))
        rest = [add_intervals(Interval(*ends), Interval(-rate, -rate)) for *ends, rate in zip(
            low.tolist(), high.tolist(), self._drift.tolist(), strict=True)]
        return np.array([max(-each.low, each.high) for each in rest])

    def enclose_plant(self) -> tuple[MatrixBall, MatrixBall]:
        """Return balls of A (n, n) and B (n, m) at the set point."""
        low, high = (each.reshape(-1, self._n).T for each in self._enclose(
            self._jacobian, np.zeros_like(self._centre)))
        n = self._n
        return (MatrixBall.enclose(low[:, :n], high[:, :n]),
                MatrixBall.enclose(low[:, n:], high[:, n:]))

    def bound_jacobian(self, size: Array) -> Array:
        """Return bounds of |df/dz| (n, n + m) in the box |z - centre| <= size."""
        return self._largest(self._jacobian, size).reshape(-1, self._n).T

    def bound_hessians(self, size: Array) -> Array:
        """Return symmetric bounds of the second derivatives (n, n + m, n + m) in the box."""
        k = len(self._centre)
        H = self._largest(self._hessians, size).reshape(self._n, k, k)
        return np.minimum(H, H.transpose(0, 2, 1))

    def _largest(self, program: Instructions, size: Array) -> Array:
        low, high = self._enclose(program, size)
        return np.maximum(np.abs(low), np.abs(high))

    def _enclose(self, program: Instructions, size: Array) -> tuple[Array, Array]:
        found = enclose_outputs(program, [
            _surround(self._centre, size), (self._numbers, self._numbers)])
        low, high = np.array(found).T
        return low, high


def _surround(centre: Array, size: Array) -> tuple[Array, Array]:
    """Return a box with centre +- size strictly inside, in directions in which size > 0."""
    low, high = centre - size, centre + size
    return (np.where(size > 0.0, np.nextafter(low, -np.inf), low),
            np.where(size > 0.0, np.nextafter(high, np.inf), high))


class _PeriodBounds:
    """
    Bounds of the loop over a period, for all errors of an ellipsoid.

    Attributes
    ----------
    norm : DefiniteNorm
        That of P.
    residual : ndarray, shape (n,)
        Bound of the rate of the error at the set point.

    """

    def __init__(self, problem: RecedingProblem) -> None:
        self._f, self._h = _Derivatives(problem), problem.period
        K, n = problem.K, len(problem.P)
        self._sizes = 1.0 / np.sqrt(np.maximum(problem.P.diagonal(), TINY))
        self._n, self._centre = n, np.concatenate([problem.xe, problem.ue])
        A, B = self._f.enclose_plant()
        self.residual = self._f.bound_residual()
        self._is_inexact = bool(self.residual.any())
        majorant = A.size
        np.fill_diagonal(majorant, A.high.diagonal())
        sampled = enclose_transition(A, self._h, self._sizes)
        gathered = enclose_transition(MatrixBall.exact(majorant), self._h, self._sizes)
        if sampled is None or gathered is None or not (
                B.is_finite and np.isfinite(self.residual).all()):
            raise RefusedDesignError(
                'terminal set: the rate of the state at the set point or its derivatives cannot '
                f'be bounded over a period of {self._h:g} s; wanted a higher rate, and dynamics '
                'without jumps or kinks (atan2, abs)')
        loop = sampled[0] - sampled[1] @ B @ MatrixBall.exact(K)
        try:
            self.norm = DefiniteNorm(problem.P, loop.middle)
        except RefusedDesignError as error:
            raise RefusedDesignError(f'terminal set: {error}') from error
        self._contraction = self.norm.bound_map(loop)
        self._gather = gathered[1].high
        self._w = self.norm.bound_functionals(np.concatenate([np.eye(n), K]))
        limits = problem.limits
        self._paths = Instructions(ca.Function(
            'paths', [ca.vertcat(limits.x, limits.u), limits.p], [ca.densify(limits.path)]))
        self._p_box = limits.p_value, limits.p_value
        self._path_box = limits.path_lower, limits.path_upper

    def prove(self, level: float) -> _Found | None:
        """Return the bounds that prove a level; None if they do not."""
        if self.paths_reached(level):
            return None
        s = math.nextafter(math.sqrt(level), math.inf)
        remainder, rest = 0.0, self.residual
        if not self._f.is_affine:
            motion = self._bound_motion(s)
            if motion is None:
                return None
            a, b = motion
            H = self._f.bound_hessians(_add_scaled(s, a, b))
            # |rho| <= (s a + b)'H (s a + b) / 2, in powers of s; s'a'H b <= s a'H b for s' <= s.
            Ha, Hb = multiply_up(H, a), multiply_up(H, b)
            remainder = self.norm.bound_box(multiply_up(self._gather, 0.5 * multiply_up(Ha, a)))
            rest = add_up(rest, _add_scaled(s, multiply_up(Ha, b), 0.5 * multiply_up(Hb, b)))
        offset = ratio = 0.0
        if self._is_inexact:
            offset = self.norm.bound_box(multiply_up(self._gather, rest))
            ratio = math.nextafter(offset / math.nextafter(math.sqrt(level), 0.0), math.inf)
        c = self._contraction
        decrease = _combine(c, s, remainder)
        least = 1.0 - _PART * (1.0 - c)
        proved = _combine(decrease, 1.0, ratio) <= least < 1.0
        return _Found(c, remainder, offset, decrease) if proved else None

    def paths_reached(self, level: float) -> bool:
        """Return whether a path constraint is not proved to hold in the ellipsoid."""
        if not len(self._path_box[0]):
            return False
        s = math.nextafter(math.sqrt(level), math.inf)
        box = _surround(self._centre, _add_scaled(s, self._w, 0.0 * self._w))
        found = enclose_outputs(self._paths, [box, self._p_box])
        return any(not (low <= each.low and each.high <= high)
                   for each, low, high in zip(found, *self._path_box, strict=True))

    def _bound_motion(self, s: float) -> tuple[Array, Array] | None:
        """
        Return a, b with |(e(tau), v)| <= s' a + b during the period from all e of norm s' <= s.

        It is None if no box is found that the motion cannot leave.
        """
        n = self._n
        size = 1.05 * s * self._w
        start = np.stack([self._w[:n], np.zeros(n)], axis=1)
        for _ in range(_GROWTHS):
            J = self._f.bound_jacobian(size)
            forcing = np.stack([multiply_up(J[:, n:], self._w[n:]), self.residual], axis=1)
            moved = bound_motion(J[:, :n], start, forcing, self._h, self._sizes)
            if moved is None or not np.isfinite(moved).all():
                return None
            a = np.concatenate([moved[:, 0], self._w[n:]])
            b = np.zeros_like(a)
            if self._is_inexact:
                b[:n] = moved[:, 1]
            reached = _add_scaled(s, a, b)
            if (reached <= size).all():
                return a, b
            size = 1.02 * np.maximum(reached, s * self._w)
        return None


def _add_scaled(s: float, a: Array, b: Array) -> Array:
    """Return an upper bound of s a + b for nonnegative numbers."""
    return add_up(s * a, b)


def _combine(c: float, s: float, d: float) -> float:
    """Return an upper bound of c + s d."""
    return add_intervals(Interval(c, c), multiply_intervals(Interval(s, s), Interval(d, d))).high


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


def _state(problem: RecedingProblem, level: float, limit: str, linear: float, found: _Found
           ) -> TerminalSet:
    """Return the set with its sentence."""
    about = 'the moving set point' if problem.drift.any() else 'the set point'
    but = f', but for {found.offset:.1g}, since the set point is rounded' if found.offset else ''
    words = (f"in e'P e <= {level:.4g} about {about} the regulator keeps all limits at every "
             f'sample, and sqrt(V) falls by at least {1.0 - found.decrease:.2g} of itself in each '
             f'period of {problem.period:g} s{but}')
    if limit != 'none':
        words += f'; the level is determined by {limit}'
    return TerminalSet(problem.P, level, TerminalProof(
        limit, linear, found.contraction, found.remainder, found.offset, found.decrease, words))
