# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The terminal set: an ellipsoid in which the sampled regulator keeps all limits, with its proof.

In the error e about the set point, V(e) = e'P e, and over a period h with v = -K e held,

    e+ = Acl e + r(e),   r(e) = integral over tau of exp(A (h - tau)) rho(e(tau), v),

where rho is the remainder of f after its linear part. Let s = sqrt(V(e)). In {V <= alpha},
|e| <= s w0 with w0_i^2 = (P^-1)_ii, and |v| <= s wv likewise. The Jacobian of f, bounded by
interval arithmetic over a box, bounds the motion during the period, |e(tau)| <= s w, if s w stays
in the box. The bounded Hessians then give |rho| <= s^2 q and |r| <= s^2 d, and V decreases if

    |Acl e + r|_P <= s (c + s |d|_P) < s,   c the norm of Acl in the norm of P.

Matrices are computed in double precision, and each bound is enlarged by a relative 1e-9, far above
their rounding errors.
"""

from dataclasses import dataclass
import math

import casadi as ca
import numpy as np
from obc_ros.core.lqr.sampled import discretize_plant
from obc_ros.core.numerics.arrays import Array, linalg
from obc_ros.core.numerics.enclosures.interval_arithmetic import enclose_outputs
from obc_ros.core.numerics.instructions import Instructions
from obc_ros.core.receding.formulation import RecedingProblem
from obc_ros.core.text.errors import RefusedDesignError

_MORE = 1.0 + 1e-9     # each computed bound times this
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
    remainder : float
        Bound of |r(e)|_P / V(e); 0 for an affine system.
    decrease : float
        Bound of sqrt(V(e+) / V(e)) for all e of the set; below 1.
    words : str
        The result in a sentence.

    """

    limit: str
    linear_level: float
    contraction: float
    remainder: float
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


def find_terminal_set(problem: RecedingProblem) -> TerminalSet:
    """
    Return the largest set that can be proved to be invariant under the regulator.

    In it the input bounds, the state bounds and the path constraints hold at every sample, and V
    decreases from sample to sample.

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
        If there is no such set: a limit is reached at the set point or by its motion, or V does
        not decrease in any ellipsoid that is not tiny.

    """
    _check_motion(problem)
    levels = list_linear_levels(problem)
    limit, linear = min(levels.items(), key=lambda each: each[1], default=('none', math.inf))
    if linear <= _SMALLEST:
        raise RefusedDesignError(f'terminal set: the set point is at the limit of {limit}')
    bounds = _PeriodBounds(problem)
    top = min(linear / _MORE, _LARGEST)
    found = bounds.judge(top)
    if found is not None:
        return _state(problem, top, limit if linear < _LARGEST else 'none', linear, found)
    low, high, best = 0.0, top, None
    while high > _SMALLEST and best is None:
        high /= 4.0
        best = bounds.judge(high)
    if best is None:
        raise RefusedDesignError('terminal set: the decrease of V cannot be proved in any '
                                 'ellipsoid about the set point; wanted a higher rate, or other '
                                 'weights')
    low, high = high, min(4.0 * high, top)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        found = bounds.judge(middle)
        if found is None:
            high = middle
        else:
            low, best = middle, found
        if high - low < 1e-6 * high:
            break
    why = 'path constraints' if bounds.paths_reached(high) else 'decrease of V'
    return _state(problem, low, why, linear, best)


def list_linear_levels(problem: RecedingProblem) -> dict[str, float]:
    """
    Return for each input bound, state bound and angle the level at which it is reached.

    For c'e <= b it is b^2 / (c'P^-1 c).

    Parameters
    ----------
    problem : RecedingProblem
        The problem.

    """
    limits = problem.limits
    inverse = np.linalg.inv(problem.P)
    low_v, high_v = problem.input_box
    rows = [(name, K, min(-low, high)) for name, K, low, high in zip(
        limits.inputs, problem.K, low_v, high_v, strict=True)]
    unit = np.eye(limits.n)
    rows += [(name, row, min(at - low, high - at)) for name, row, at, low, high in zip(
        limits.states, unit, problem.xe, limits.x_lower, limits.x_upper, strict=True)]
    rows += [(f'half a turn of {signal.name}', row, math.pi) for signal, row in zip(
        problem.system.states, unit, strict=True) if signal.angle]
    return {name: float(max(b, 0.0)**2 / (c @ inverse @ c)) for name, c, b in rows
            if math.isfinite(b) and c.any()}


@dataclass(frozen=True)
class _Found:
    """Bounds that prove a level."""

    contraction: float
    remainder: float
    decrease: float


class _PeriodBounds:
    """Bounds of the loop over a period, for all errors of an ellipsoid."""

    def __init__(self, problem: RecedingProblem) -> None:
        plant, system = problem.design.plant, problem.system
        self._P, self._h = problem.P, problem.period
        inverse = np.linalg.inv(problem.P)
        spread = np.einsum('ij,jk,ik->i', problem.K, inverse, problem.K)
        self._w = np.sqrt(np.concatenate([np.diag(inverse), spread])) * _MORE
        self._n, self._m = plant.B.shape
        self._centre = np.concatenate([problem.xe, problem.ue])
        Ad, Bd = discretize_plant(plant.A, plant.B, self._h)
        root = np.linalg.cholesky(problem.P).T
        loop = root @ (Ad - Bd @ problem.K) @ np.linalg.inv(root)
        self.contraction = float(np.linalg.norm(loop, 2)) * _MORE
        majorant = np.abs(plant.A)
        np.fill_diagonal(majorant, np.diag(plant.A))
        self._gather = _integrate_exponential(majorant, self._h) * _MORE
        z = ca.vertcat(system.x, system.u)
        f = ca.substitute(system.xdot, system.p, ca.DM(system.p_value))
        J = ca.jacobian(f, z)
        self._affine = not ca.symvar(J)
        self._jacobian = Instructions(ca.Function('J', [z], [ca.densify(J)]))
        curved = [ca.densify(ca.jacobian(J[i, :], z)) for i in range(self._n)]
        self._hessians = Instructions(ca.Function('H', [z], [ca.vertcat(
            *(ca.vec(each) for each in curved))]))
        soft = problem.soft
        paths = list(range(len(soft.names) - problem.limits.path.numel(), len(soft.names)))
        rows = soft.rows[paths] if paths else ca.SX(0, 1)
        self._paths = Instructions(ca.Function('paths', [ca.vertcat(soft.e, soft.v), soft.shift],
                                               [rows]))
        self._path_box = soft.lower[paths], soft.upper[paths]

    def judge(self, level: float) -> _Found | None:
        """Return the bounds that prove a level; None if they do not."""
        if self.paths_reached(level):
            return None
        if self._affine:
            c = self.contraction
            return _Found(c, 0.0, c) if c < 1.0 else None
        s = math.sqrt(level)
        w = self._bound_motion(s)
        if w is None:
            return None
        H = self._largest(self._hessians, s * w).reshape(self._n, len(w), len(w))
        q = 0.5 * np.einsum('ijk,j,k->i', H, w, w) * _MORE
        d = self._gather @ q * _MORE
        remainder = math.sqrt(float(d @ np.abs(self._P) @ d)) * _MORE
        decrease = (self.contraction + s * remainder) * _MORE
        least = 1.0 - _PART * (1.0 - self.contraction)
        return _Found(self.contraction, remainder, decrease) if decrease <= least < 1.0 else None

    def paths_reached(self, level: float) -> bool:
        """Return whether a path constraint is not proved to hold in the ellipsoid."""
        if not len(self._path_box[0]):
            return False
        box = math.sqrt(level) * self._w
        zero = np.zeros(self._n)
        found = enclose_outputs(self._paths, [(-box, box), (zero, zero)])
        return any(not (low <= each.low and each.high <= high)
                   for each, low, high in zip(found, *self._path_box, strict=True))

    def _bound_motion(self, s: float) -> Array | None:
        """Return w with |(e(tau), v)| <= s w during the period, None if no box is found."""
        n, w = self._n, 1.05 * self._w
        for _ in range(_GROWTHS):
            J = self._largest(self._jacobian, s * w).reshape(-1, n).T
            if not np.isfinite(J).all():
                return None
            motion = np.zeros((n + self._m,) * 2)
            motion[:n] = J
            reached: Array = linalg.expm(motion * self._h) @ self._w * _MORE
            if not np.isfinite(reached).all():
                return None
            if (reached <= w).all():
                return reached
            w = 1.02 * np.maximum(reached, self._w)
        return None

    def _largest(self, program: Instructions, size: Array) -> Array:
        """Return bounds of the absolute values of a function in a box about the set point."""
        box = np.nextafter(self._centre - size, -np.inf), np.nextafter(self._centre + size, np.inf)
        return np.array([max(abs(each.low), abs(each.high))
                         for each in enclose_outputs(program, [box])])


def _integrate_exponential(A: Array, h: float) -> Array:
    """Return the integral of exp(A tau) from 0 to h."""
    n = len(A)
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n], block[:n, n:] = A, np.eye(n)
    integral: Array = linalg.expm(block * h)[:n, n:]
    return integral


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
    words = (f"in e'P e <= {level:.4g} about {about} the regulator keeps all limits at every "
             f'sample, and sqrt(V) falls by at least {1.0 - found.decrease:.2g} of itself in each '
             f'period of {problem.period:g} s')
    if limit != 'none':
        words += f'; the level is determined by {limit}'
    return TerminalSet(problem.P, level, TerminalProof(
        limit, linear, found.contraction, found.remainder, found.decrease, words))
