# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Switching times of bang-bang inputs to a linear system, by Newton's method.

Let tau = T - t be the time to go and s_j(tau) = nu' C e^(A tau) b_j the switching functions. The
unknowns are the switching times tau_i, the multipliers nu, and T. The equations are

    C x(T) = d,   s_j(tau_i) = 0,   1 + nu' C f(x(T), u(T)) = 0  (H = 0 at T).

Newton's method solves them together. If x(0) lies on a switching curve, arcs vanish and nu is not
unique: a least squares step solves the consistent equations, and a linear programme then finds a
nu with the right signs.

Inputs whose switching function vanishes identically are singular: T does not depend on them, and
any input that meets the other terminal constraints is optimal. The one returned is bang-bang at
the lowest level, |v_j| = level <= 1. It solves the same equations with the level in place of T.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index, optimize
from obc_ros.core.solver.exact.reachable_set import compute_exponential, Reach

Unknown = Literal['time', 'level', 'abnormal']


@dataclass(frozen=True, eq=False)
class BangBang:
    """
    Inputs v_j(tau) = +-level_j that change sign at tau_i.

    :ivar nu: (q,), multipliers of C x(T) - d for the cost T; abnormal ones with |nu| = 1 unless
        `normal`.
    :ivar tau, owner: (k,), switching times to go [s], increasing for each input, and the input
        that switches.
    :ivar sign, level: (m,), v_j at T and |v_j|.
    """

    T: float
    nu: Array
    tau: Array
    owner: Index
    sign: Array
    level: Array
    normal: bool = True

    def v(self, tau: Array) -> Array:
        """Return the inputs at times to go, shape (N, m)."""
        v = np.tile(self.sign * self.level, (len(tau), 1))
        for tau_i, j in zip(self.tau, self.owner, strict=True):
            v[tau > tau_i, j] *= -1
        return v

    def jumps(self) -> Array:
        """Return the difference of v before and after each switch in tau, shape (k,)."""
        count = np.tril(self.owner[:, None] == self.owner).sum(axis=1)
        return np.asarray(-2 * (self.sign * self.level)[self.owner] * (-1.0)**count)


def find_extreme_inputs(reach: Reach, T: float, eta: Array) -> BangBang:
    """Return the inputs that maximise eta' C x(T), to the accuracy of a grid."""
    tau = reach.times(T, finer=4)
    s = eta @ reach.switching(reach.table(tau))
    found, owner, sign = [np.zeros(0)], [], np.ones(s.shape[1])
    for j, column in enumerate(s.T):
        # Grid points with s = 0, up to rounding, are left out: the zero then lies between their
        # neighbours.
        k = np.flatnonzero(np.abs(column) > 1e-9 * np.abs(column).max())
        times, values = tau[k], column[k]
        i = np.flatnonzero(values[:-1] * values[1:] < 0)
        found.append(times[i] + np.diff(times)[i] * values[i] / (values[i] - values[i + 1]))
        owner += [j] * len(i)
        sign[j] = np.sign(values[0]) if len(values) else 1.0
    return BangBang(T, -eta, np.concatenate(found), np.array(owner, int), sign,
                    np.ones(s.shape[1]))


def polish(reach: Reach, guess: BangBang, unknown: Unknown = 'time') -> BangBang | None:
    """
    Return the solution of Pontryagin's conditions near a guess, or None.

    With `unknown` = 'level', T is given and the common level of the inputs is found instead, with
    x0 = 0, c = 0 and nu' d = -1 in place of H = 0. 'abnormal' is 'time' with nu' C f(T) = 0 and
    |nu| = 1 in place of H = 0, which no finite nu satisfies. None is also returned if there are
    no terminal constraints or no inputs.
    """
    if not len(reach.d) or not reach.B.shape[1]:
        return None
    scaled, back = _scaled(reach, guess.T)
    nu = np.linalg.solve(back.T, guess.nu)
    guess = replace(guess, nu=nu / np.linalg.norm(nu), normal=unknown != 'abnormal')
    if guess.normal:
        normal = _equations(scaled, guess, unknown)[0][len(nu) + len(guess.tau)]
        # So that nu' C f(T) = -1, or nu' d = -1.
        guess = replace(guess, nu=guess.nu / (1 - normal) if normal < 1 else guess.nu)
    for _ in range(len(guess.tau) + 1):
        found, converged = _newton(scaled, guess, unknown)
        guess = drop_short_arcs(found)
        if len(guess.tau) == len(found.tau):
            break
    if not converged:
        return None
    right = _with_right_signs(scaled, found, unknown)
    if right is None and unknown == 'time':
        right = _with_right_signs(scaled, replace(found, normal=False), 'abnormal')
    return None if right is None else replace(right, nu=back.T @ right.nu)


def _scaled(reach: Reach, T: float) -> tuple[Reach, Array]:
    """Return the problem with rows of C combined so that the reachable set is nearly round."""
    n, m = reach.B.shape
    columns = np.diff(reach.table(reach.times(T))[:, :, n:n + m], axis=0).transpose(0, 2, 1)
    _, R = np.linalg.qr(columns.reshape(-1, len(reach.d)) * np.sqrt(len(columns)))
    back = np.linalg.inv(R.T)
    return replace(reach, C=back @ reach.C, d=back @ reach.d), back


def _newton(reach: Reach, guess: BangBang, unknown: Unknown) -> tuple[BangBang, bool]:
    """Return the last iterate of Newton's method, and whether it solves the equations."""
    now, size = guess, np.inf
    for _ in range(40):
        residual, J = _equations(reach, now, unknown)
        k = len(now.tau)
        columns = np.full(k + 1 + len(now.nu), now.T)
        columns[k] = 1.0 if unknown == 'level' else now.T
        columns[k + 1:] = np.linalg.norm(now.nu)
        if not (np.isfinite(J).all() and np.isfinite(residual).all()):
            return now, False
        # `_scaled` has given the rows of C x(T) = d one size; T may have no influence on them.
        rows = np.maximum(np.linalg.norm(J * columns, axis=1), 1e-300)
        rows[:len(now.nu)] = 1
        step = columns * np.linalg.lstsq(J * columns / rows[:, None], -residual / rows,
                                         rcond=1e-11)[0]
        now, factor = _moved(now, step, unknown)
        size = np.abs(step / columns).max()
        if not (size < 1e6 and now.T < 4 * guess.T):   # it diverges
            return now, False
        if factor == 1 and size < 1e-13:
            break
    # If steps shrink slowly the limit is an abnormal extremal and the equations have no solution;
    # otherwise the last one is below 1e-8.
    return now, size < 1e-8 and _solved(reach, now, unknown)


def _solved(reach: Reach, now: BangBang, unknown: Unknown) -> bool:
    """Return whether the equations hold, each relative to the size of its terms."""
    residual, J = _equations(reach, now, unknown)
    q, k = len(now.nu), len(now.tau)
    start = np.abs(reach.C) @ np.abs(compute_exponential(reach.A * now.T)) @ np.abs(reach.x0)
    size = np.abs(J[q:, k + 1:]) @ np.abs(now.nu)
    return bool((np.abs(residual[:q]) < 1e-10 + 1e-12 * start).all()
                and (np.abs(residual[q:]) < 1e-10 * (1 + size)).all())


def _equations(reach: Reach, now: BangBang, unknown: Unknown) -> tuple[Array, Array]:
    """Return the residuals (C x(T) - d, s(tau), H) and their Jacobian in (tau, T, nu)."""
    n, m = reach.B.shape
    k, q = len(now.tau), len(reach.d)
    E = compute_exponential(reach.Z * np.append(now.tau, now.T)[:, None, None])[:, :n]
    jumps, end = now.jumps(), now.v(np.array([now.T]))[0]
    b = reach.B[:, now.owner]
    moved = np.einsum('iab,bi->ai', E[:-1, :, :n], b)
    G = np.take_along_axis(E[:-1, :, n:], now.owner[:, None, None], axis=2)[:, :, 0]
    x = jumps @ G + E[-1, :, n:n + m] @ end
    v = now.sign * now.level
    if unknown == 'level':
        # The column of the Jacobian belongs to the level, not to T.
        column, rate, xdot = x / now.level[0], reach.d, None
    else:
        x = x + E[-1, :, :n] @ reach.x0 + E[-1, :, -1]
        column = E[-1, :, :n] @ (reach.A @ reach.x0 + reach.B @ end + reach.c)
        xdot = reach.A @ x + reach.B @ v + reach.c
        rate = reach.C @ xdot
    Cb = reach.C @ moved
    abnormal = unknown == 'abnormal'
    last = [now.nu @ rate, (now.nu @ now.nu - 1) / 2] if abnormal else [1 + now.nu @ rate]
    residual = np.concatenate((reach.C @ x - reach.d, now.nu @ Cb, last))
    J = np.zeros((len(residual), k + 1 + q))
    J[:q, :k], J[:q, k] = Cb * jumps, reach.C @ column
    J[range(q, q + k), range(k)] = now.nu @ reach.C @ reach.A @ moved
    J[q:q + k, k + 1:] = Cb.T
    J[q + k, k + 1:] = rate
    if unknown != 'level':
        slope = now.nu @ reach.C @ reach.A
        J[q + k, :k], J[q + k, k] = slope @ (moved * jumps), slope @ column
    if abnormal:
        J[-1, k + 1:] = now.nu
    return residual, J


def _moved(now: BangBang, step: Array, unknown: Unknown) -> tuple[BangBang, float]:
    """Return the next iterate and the factor of the step: each arc keeps 1/10 of its length."""
    k = len(now.tau)
    T = now.T if unknown == 'level' else now.T + step[k]
    factor = 1.0
    for j in range(len(now.sign)):
        mine = now.owner == j
        before = np.diff(now.tau[mine], prepend=0, append=now.T)
        after = np.diff((now.tau + step[:k])[mine], prepend=0, append=T)
        shrinking = (after < 0.1 * before) & (before > 0)
        if shrinking.any():
            ratio = 0.9 * before[shrinking] / (before - after)[shrinking]
            factor = min(factor, float(ratio.min()))
    moved = replace(now, tau=now.tau + factor * step[:k], nu=now.nu + factor * step[k + 1:])
    if unknown == 'level':
        level = max(now.level[0] + factor * step[k], 0.1 * now.level[0])
        return replace(moved, level=np.full(len(now.level), level)), factor
    return replace(moved, T=now.T + factor * step[k]), factor


def drop_short_arcs(now: BangBang, shortest: float = 1e-9) -> BangBang:
    """Return the inputs without arcs that are shorter than `shortest` T."""
    keep = np.ones(len(now.tau), dtype=bool)
    sign = now.sign.copy()
    for j in range(len(sign)):
        mine = np.flatnonzero(now.owner == j)
        gaps = np.diff(now.tau[mine], prepend=0, append=now.T) < shortest * now.T
        for i in np.flatnonzero(gaps):
            ends = [mine[e] for e in (i - 1, i) if 0 <= e < len(mine)]
            if ends and keep[ends].all():
                keep[ends] = False
                sign[j] *= -1 if i == 0 else 1
    return replace(now, tau=now.tau[keep], owner=now.owner[keep], sign=sign)


def _with_right_signs(reach: Reach, found: BangBang, unknown: Unknown) -> BangBang | None:
    """Return the inputs with a nu whose switching functions have the right signs, or None."""
    tau = reach.times(found.T, finer=4)
    s = reach.switching(reach.table(tau)) * np.sign(found.v(tau))[:, None, :]

    def hold(nu: Array) -> bool:
        values = nu @ s
        return bool(values.max() <= 1e-7 * np.abs(values).max())

    if hold(found.nu):
        return found
    nu = _other_multiplier(reach, found, unknown, tau, s)
    return replace(found, nu=nu) if nu is not None and hold(nu) else None


def _other_multiplier(reach: Reach, found: BangBang, unknown: Unknown, tau: Array,
                      s: Array) -> Array | None:
    """Return the nu that maximises the distance of the switching functions from 0 on the arcs."""
    q, k = len(found.nu), len(found.tau)
    J = _equations(reach, found, unknown)[1][q:q + k + 1, k + 1:]
    weight = np.ones((len(tau), len(found.sign)))
    for tau_i, j in zip(found.tau, found.owner, strict=True):
        weight[:, j] = np.minimum(weight[:, j], np.abs(tau - tau_i) / found.T)
    rows = s.transpose(0, 2, 1).reshape(-1, q)
    rows /= np.abs(rows).max()
    best = optimize.linprog(
        np.append(np.zeros(q), -1), np.column_stack((rows, weight.ravel())), np.zeros(len(rows)),
        np.column_stack((J, np.zeros(k + 1))), np.append(np.zeros(k), -1.0 if found.normal else 0),
        [(None, None) if found.normal else (-1, 1)] * q + [(None, None)], method='highs')
    if best.x is None:
        return None
    nu = np.asarray(best.x[:q], dtype=float)
    return nu if found.normal or not nu.any() else nu / np.linalg.norm(nu)


def describe_switches(T: float, switches: int, singular: Sequence[str] = (), normal: bool = True
                      ) -> str:
    """Return the message of a solution."""
    text = f'minimum time {T:.10g}, bang-bang with {switches} switch{"es" * (switches != 1)}'
    if singular:
        text += f'; singular: {", ".join(singular)}, at the smallest sufficient constant magnitude'
    if not normal:
        text += '; abnormal: no finite costate satisfies H = 0, a very large one nearly does'
    return text
