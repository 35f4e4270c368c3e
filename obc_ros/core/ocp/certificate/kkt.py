# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The conditions for a minimum of F(x) with G(x) = 0, g(x) <= 0 and x in a box (section 2.1).

With l = F + lam'G + mu'g, a regular minimum satisfies

    grad l = 0 inside the box, >= 0 at a lower and <= 0 at an upper bound,
    mu >= 0, mu_j g_j = 0,
    and d'(Hess l) d >= 0 for all d that keep the active constraints.

The minimum is a stationary point of l, not always a minimum of l: for F = x1^2 - x2^2, G = x2 the
origin is a saddle of l.
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask, optimize
from obc_ros.core.numerics.newton import take_damped_steps
from obc_ros.core.ocp.solution import Certificate


class KktCondition(StrEnum):
    """A condition that a certificate holds a minimum of finitely many variables to."""

    STATIONARITY = 'stationarity'
    FEASIBILITY = 'feasibility'
    SIGNS = 'signs'
    COMPLEMENTARITY = 'complementarity'
    SECOND_ORDER = 'second_order'
    ATTAINED = 'attained'

    __str__ = str.__str__


TOLERANCES: dict[str, float] = {
    KktCondition.STATIONARITY: 1e-6, KktCondition.FEASIBILITY: 1e-7, KktCondition.SIGNS: 1e-6,
    KktCondition.COMPLEMENTARITY: 1e-6, KktCondition.SECOND_ORDER: 1e-6,
    KktCondition.ATTAINED: 1e-5}
# A constraint or bound this close to its limit may be active, relative to its size.
_ACTIVE = 1e-6
# Singular values below this, relative to the largest, count as 0.
_DEPENDENT = 1e-9
# Terms of multipliers larger than this, relative to grad F: the gradients of the constraints are
# nearly linearly dependent.
_STRAINED = 1e5
# A gradient vanishes if it changes sign within this distance, relative to 1 + |x|.
_FLAT = 1e-4
_NEWTON_STEPS = 60


@dataclass(frozen=True, eq=False)
class StaticProgram:
    """
    A static problem: symbols and expressions.

    :ivar F, G, g: cost, equalities (k, 1) and inequalities (l, 1).
    :ivar lower, upper: (n,), the box; -inf and inf for none.
    """

    x: ca.SX
    F: ca.SX
    G: ca.SX
    g: ca.SX
    lower: Array
    upper: Array

    @property
    def k(self) -> int:
        """Return the number of equalities."""
        return int(self.G.numel())

    @property
    def l(self) -> int:  # noqa: E743 - the letter of the message's documentation
        """Return the number of inequalities."""
        return int(self.g.numel())

    @cached_property
    def _values(self) -> ca.Function:
        c = ca.vertcat(self.G, self.g)
        return ca.Function('values', [self.x], [
            self.F, c, ca.gradient(self.F, self.x), ca.densify(ca.jacobian(c, self.x))])

    @cached_property
    def _hessian(self) -> ca.Function:
        multipliers = ca.SX.sym('multipliers', self.k + self.l)
        lagrangian = self.F + ca.dot(multipliers, ca.vertcat(self.G, self.g))
        return ca.Function('hessian', [self.x, multipliers],
                           [ca.densify(ca.hessian(lagrangian, self.x)[0])])

    def values(self, x: Array) -> tuple[float, Array, Array, Array]:
        """Return F, (G, g), grad F and the Jacobian of (G, g), shape (k + l, n)."""
        F, c, gradient, J = self._values(x)
        return float(F), c.full().ravel(), ca.DM(gradient).full().ravel(), J.full()

    def hessian(self, x: Array, multipliers: Array) -> Array:
        """Return the Hessian of F + multipliers'(G, g), shape (n, n)."""
        return np.asarray(self._hessian(x, multipliers).full())


@dataclass(frozen=True, eq=False)
class KktPoint:
    """
    A point with multipliers.

    :ivar x, lam, mu: (n,), (k,), (l,).
    :ivar dependent: whether the gradients of the active constraints are linearly dependent (LICQ
        fails), so that multipliers are not unique, or do not exist.
    :ivar saddle: whether the Hessian of the Lagrangian has a negative eigenvalue.
    """

    x: Array
    lam: Array
    mu: Array
    dependent: bool = False
    saddle: bool = False


def polish_minimum(program: StaticProgram, x: Array) -> KktPoint:
    """
    Return a stationary point near x by Newton's method on the active constraints.

    :return: its multipliers are fitted by least squares, with mu >= 0. A step that does not reduce
        the residual is not taken.
    """
    def step(at: KktPoint, _: float) -> Array | None:
        way = _newton_step(program, at)
        small = way is None or np.abs(way).max(initial=0) <= 1e-15 * (1 + np.abs(at.x).max())
        return None if small else way

    return take_damped_steps(
        fit_multipliers(program, x), step, lambda at, way, _: fit_multipliers(
            program, np.clip(at.x + way, program.lower, program.upper)),
        lambda at: _error(program, at), (1.0,), _NEWTON_STEPS)


def certify_minimum(program: StaticProgram, point: KktPoint) -> Certificate:
    """
    Return the residuals of the conditions at the head of this file.

    :return: stationarity and signs are relative to the largest term of grad l, complementarity to
        this term and the size of g, second_order to the Hessian. attained is the Newton step
        relative to 1 + |x|; it is large where F decreases towards an infimum that is not attained.
    """
    F, c, gradient, J = program.values(point.x)
    k = program.k
    every = np.concatenate((point.lam, point.mu))
    if not (np.isfinite(F) and np.isfinite(c).all() and np.isfinite(gradient).all()
            and np.isfinite(J).all() and np.isfinite(every).all()):
        return Certificate(dict.fromkeys(TOLERANCES, np.inf), dict(TOLERANCES))
    slope = gradient + every @ J
    size = max(float(np.abs(gradient).max()), float(np.abs(every[:, None] * J).max(initial=0)),
               1e-8 * (1 + abs(F)))
    at_lower, at_upper = _at_bounds(program, point.x)
    wrong = np.where(at_lower & at_upper, 0, np.where(
        at_lower, np.minimum(slope, 0), np.where(at_upper, np.maximum(slope, 0), 0)))
    free = ~(at_lower | at_upper)
    steepness = np.abs(J[k:]).max(axis=1, initial=0)
    far = 1 + float(np.abs(point.x).max())
    step = _newton_step(program, point)
    curvature, scale = _tangent_curvature(program, point)
    residuals: dict[str, float] = {
        KktCondition.STATIONARITY: float(np.abs(slope[free]).max(initial=0)) / size,
        KktCondition.FEASIBILITY: measure_violation(program, point.x, c, J),
        KktCondition.SIGNS: max(float(np.abs(wrong).max()),
                                float((-point.mu * steepness).max(initial=0))) / size,
        KktCondition.COMPLEMENTARITY: (
            float(np.abs(point.mu * c[k:]).max(initial=0)) / (size * far)),
        KktCondition.SECOND_ORDER: max(-curvature, 0.0) / scale,
        KktCondition.ATTAINED: (
            np.inf if step is None else float(np.abs(step).max(initial=0)) / far)}
    return Certificate(residuals, dict(TOLERANCES))


def measure_violation(program: StaticProgram, x: Array, c: Array, J: Array) -> float:
    """Return the largest violation of a constraint or bound, relative to the size of its terms."""
    k = program.k
    excess = np.concatenate((np.abs(c[:k]), np.maximum(c[k:], 0))) / _sizes(x, J)
    outside = np.maximum(program.lower - x, x - program.upper) / (1 + np.abs(x))
    return max(float(excess.max(initial=0)), float(outside.max()), 0.0)


def _sizes(x: Array, J: Array) -> Array:
    return np.asarray(1 + np.abs(J) @ np.abs(x))


def fit_multipliers(program: StaticProgram, x: Array) -> KktPoint:
    """Return x with the multipliers that minimise |grad l|, mu >= 0, and 0 if inactive."""
    _, c, gradient, J = program.values(x)
    k = program.k
    vanishing = _vanishing(program, x, J)
    active = _active(program, x, c, J)
    dependent = bool((active & vanishing).any())
    rows = np.flatnonzero(active & ~vanishing)
    at_lower, at_upper = _at_bounds(program, x)
    bounds = np.flatnonzero(at_lower | at_upper)
    every = np.zeros(len(c))
    A = np.vstack((J[rows], np.eye(len(x))[bounds]))
    if len(A) and np.isfinite(A).all() and np.isfinite(gradient).all():
        fixed = (at_lower & at_upper)[bounds]
        low = np.concatenate((np.where(rows < k, -np.inf, 0.0),
                              np.where(at_upper[bounds] & ~fixed, 0.0, -np.inf)))
        high = np.concatenate((np.full(len(rows), np.inf),
                               np.where(at_lower[bounds] & ~fixed, 0.0, np.inf)))
        sizes = np.maximum(np.linalg.norm(A, axis=1), 1e-300)
        unit = (A / sizes[:, None]).T
        found, _, rank, _ = np.linalg.lstsq(unit, -gradient, rcond=_DEPENDENT)
        if ((found < low) | (found > high)).any():
            # Large multipliers must not fit what linearly dependent gradients do not span.
            left, values, right = np.linalg.svd(unit, full_matrices=False)
            unit = (left[:, :rank] * values[:rank]) @ right[:rank]
            found = optimize.lsq_linear(unit, -gradient, (low, high), method='bvls').x
        every[rows] = (found / sizes)[:len(rows)]
        dependent = dependent or bool(rank < len(A))
    return KktPoint(x, every[:k], every[k:], dependent, _has_descent(program.hessian(x, every)))


def is_strained(program: StaticProgram, point: KktPoint) -> bool:
    """Return whether terms of grad l much larger than grad F cancel in it."""
    _, _, gradient, J = program.values(point.x)
    terms = np.abs(np.concatenate((point.lam, point.mu))[:, None] * J)
    return bool(terms.max(initial=0) > _STRAINED * np.abs(gradient).max())


def _vanishing(program: StaticProgram, x: Array, J: Array) -> Mask:
    """Return which constraints have a gradient that a small step changes by its own size."""
    if not len(J):
        return np.zeros(0, dtype=bool)
    step = _FLAT * (1 + np.abs(x)) * np.resize((1.0, -0.7, 0.4), len(x))
    change = np.abs(program.values(x + step)[3] - program.values(x - step)[3]).max(axis=1)
    return np.asarray(np.abs(J).max(axis=1) <= change)


def _has_descent(H: Array) -> bool:
    if not np.isfinite(H).all():
        return False
    values = np.linalg.eigvalsh((H + H.T) / 2)
    return bool(values[0] < -1e-9 * max(np.abs(values).max(), 1e-300))


def _at_bounds(program: StaticProgram, x: Array) -> tuple[Mask, Mask]:
    size = _ACTIVE * (1 + np.abs(x))
    return x - program.lower <= size, program.upper - x <= size


def _active(program: StaticProgram, x: Array, c: Array, J: Array) -> Mask:
    """Return which of (G, g) hold with equality."""
    active = c >= -_ACTIVE * _sizes(x, J)
    active[:program.k] = True
    return np.asarray(active)


def _kept(program: StaticProgram, point: KktPoint) -> tuple[Array, Array]:
    """Return the values and gradients of the active constraints, then of the active bounds."""
    _, c, _, J = program.values(point.x)
    active = _active(program, point.x, c, J)
    at_lower, at_upper = _at_bounds(program, point.x)
    rows = np.eye(len(point.x))
    bounds = at_lower | at_upper
    nearest = np.where(at_lower, program.lower, program.upper)
    gap = (point.x - nearest)[bounds] if bounds.any() else np.zeros(0)
    return np.concatenate((c[active], gap)), np.vstack((J[active], rows[bounds]))


def _newton_step(program: StaticProgram, point: KktPoint) -> Array | None:
    """Return the step to the stationary point of the model; None where it is not defined."""
    every = np.concatenate((point.lam, point.mu))
    _, _, gradient, J = program.values(point.x)
    H = program.hessian(point.x, every)
    c, rows = _kept(program, point)
    if not (np.isfinite(H).all() and np.isfinite(rows).all() and np.isfinite(gradient).all()):
        return None
    k, scale = len(rows), max(float(np.abs(H).max()), 1e-300)
    sizes = np.maximum(np.linalg.norm(rows, axis=1), 1e-300)
    rows = rows / sizes[:, None]
    matrix = np.block([[H / scale, rows.T], [rows, np.zeros((k, k))]])
    right = -np.concatenate(((gradient + every @ J) / scale, c / sizes))
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-13)[0][:len(point.x)], dtype=float)


def _error(program: StaticProgram, point: KktPoint) -> float:
    """Return how far the point is from stationary and feasible."""
    _, c, gradient, J = program.values(point.x)
    if not (np.isfinite(c).all() and np.isfinite(gradient).all() and np.isfinite(J).all()):
        return np.inf
    slope = gradient + np.concatenate((point.lam, point.mu)) @ J
    at_lower, at_upper = _at_bounds(program, point.x)
    kept, _ = _kept(program, point)
    return float(np.linalg.norm(slope[~(at_lower | at_upper)]) + np.abs(kept).sum()
                 + np.maximum(c[program.k:], 0).sum())


def _tangent_curvature(program: StaticProgram, point: KktPoint) -> tuple[float, float]:
    """Return the smallest curvature of the Lagrangian along the active constraints; its scale."""
    H = program.hessian(point.x, np.concatenate((point.lam, point.mu)))
    _, rows = _kept(program, point)
    if not (np.isfinite(H).all() and np.isfinite(rows).all()):
        return -np.inf, 1.0
    scale = max(float(np.abs(H).max()), 1e-300)
    tangent = np.eye(len(point.x))
    if len(rows):
        _, sizes, V = np.linalg.svd(rows)
        tangent = V[int(np.sum(sizes > _DEPENDENT * max(sizes[0], 1e-300))):].T
    if not tangent.shape[1]:
        return 0.0, scale
    return float(np.linalg.eigvalsh(tangent.T @ (H + H.T) @ tangent / 2)[0]), scale
