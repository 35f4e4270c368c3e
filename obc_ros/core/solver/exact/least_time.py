# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Minimum time in which a linear system with bounded inputs meets its target, with a lower bound.

The method of `reachable_set` is iterated. Newton's method (`bang_bang`) solves the last step.
"""

from dataclasses import dataclass, replace
from math import inf

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.ocp.certificate.certificate import COUNTS_AS_MET
from obc_ros.core.solver.exact.bang_bang import (
    BangBang,
    drop_short_arcs,
    find_extreme_inputs,
    polish,
)
from obc_ros.core.solver.exact.reachable_set import compute_exponential, Reach

_ROUNDING = 1e-10
_NEAR = 1e-8   # relative gap between a lower bound and a solution that counts as none
_MOST_GROWTH = 300.0   # of a pole times T: beyond it e^(A T) overflows or has no correct digits


@dataclass(frozen=True, eq=False)
class FirstTime:
    """
    Bounds of the minimum time, and the inputs that meet the target in it if they were found.

    :ivar too_short: the target is met at no time before this [s]. It is the upper bound of T if no
        time is long enough, and less if the search ended undecided.
    :ivar at_once: whether the target can be met at the lower bound of T.
    """

    answer: BangBang | None
    too_short: float
    at_once: bool = False


def find_first_time(reach: Reach, lower: float, upper: float) -> FirstTime:
    """
    Return the minimum time within [lower, upper] at which C x(T) = d can hold.

    The inputs must act on every row of C. If the target is a single state at rest the problem is
    solved in reversed time: then the direction of g(T) hardly changes and one eta excludes many T.
    """
    back = _backwards(reach, upper)
    if back is not None:
        found = _search(back, lower, upper)
        if found.answer is not None:
            return replace(found, answer=_forwards(reach, found.answer))
        if found.at_once or found.too_short >= upper:
            return found
    return _search(reach, lower, upper)


def _backwards(reach: Reach, upper: float) -> Reach | None:
    """Return the problem in reversed time if the target is a single state at rest, else None."""
    n = len(reach.x0)
    if len(reach.d) < n or -reach.poles.real.min() * upper > _MOST_GROWTH:
        return None
    xf = np.linalg.solve(reach.C, reach.d)
    moving, start = (np.linalg.norm(reach.A @ x + reach.c) for x in (xf, reach.x0))
    # |f| at the target, inputs in their middle, relative to |f| at x(0): it is not at rest.
    if moving > 0.1 * start:
        return None
    return Reach(-reach.A, -reach.B, -reach.c, np.asarray(xf, dtype=float), np.eye(n), reach.x0)


def _forwards(reach: Reach, answer: BangBang) -> BangBang:
    """Return the solution of the problem, given that of the problem in reversed time."""
    sign = answer.v(np.array([answer.T]))[0] / np.where(answer.level > 0, answer.level, 1.0)
    lam = compute_exponential(-reach.A.T * answer.T) @ -answer.nu
    order = np.argsort(-answer.tau)
    nu = np.asarray(np.linalg.solve(reach.C.T, lam), dtype=float)
    turned = replace(answer, nu=nu, tau=(answer.T - answer.tau)[order],
                     owner=answer.owner[order], sign=np.where(answer.level > 0, sign, 1.0))
    if (answer.level < 1).any() or not answer.normal:
        return turned
    return polish(reach, turned) or turned


def _search(reach: Reach, lower: float, upper: float) -> FirstTime:
    upper = min(upper, _MOST_GROWTH / max(float(reach.poles.real.max()), 1e-300))
    T = lower
    if lower > 0:
        multiple, eta = reach.largest_multiple(T)
        if multiple >= 1:
            return FirstTime(None, T, at_once=True)
    else:
        eta = reach.d - reach.C @ reach.x0
        if np.abs(eta).max() <= 1e-14 * (np.abs(reach.d).max() + np.abs(reach.C @ reach.x0).max()):
            return FirstTime(None, 0.0, at_once=True)
    # A proof is evaluated up to this time at first, then 4 times as far.
    horizon = min(upper, max(4 * lower, 1e-5 * upper))
    candidate: BangBang | None = None
    # Newton's method is tried once half of the gap is left, then at every half of that. Below the
    # gap `touching` an abnormal extremal is also looked for, and the target may be met for an
    # instant only.
    left, missed, touching = 0.5, inf, 1e-3
    for _ in range(100):
        later = _no_longer_proved(reach, eta, T, horizon)
        if later is None:
            if horizon >= upper:
                return FirstTime(None, min(upper, missed))
            T, horizon = horizon, min(upper, 4 * horizon)
            continue
        multiple, eta, part = _direction(reach, later, eta, warm=candidate is not None)
        if 1 - multiple < left and not (candidate is not None and candidate.normal):
            left = (1 - multiple) / 2
            found = _polished(part, later, abnormal=1 - multiple < touching)
            candidate = found if found and T <= found.T <= upper else candidate
        if candidate is not None and (
                later >= candidate.T * (1 - _NEAR) or _proved(reach, candidate, T)
                or abs(1 - multiple) < 1e-5):   # a tangency keeps the bound from rising
            return FirstTime(candidate, candidate.T)
        if multiple >= 1 or later <= T * (1 + 1e-13):
            break
        if multiple > 1 - touching and candidate is None:
            missed = min(missed, later)
        T = later
        horizon = min(upper, max(2 * T, min(horizon, 8 * T)))
    return FirstTime(None, T)


def _no_longer_proved(reach: Reach, eta: Array, T: float, horizon: float) -> float | None:
    """Return the first time after T that eta does not prove too short, None if there is none."""
    tau = T + reach.times(horizon - T)
    narrowed = 0
    for _ in range(12):   # divisions of an interval between whose ends the proof may fail
        grid = np.append(reach.times(T), tau[1:]) if T else tau
        margin, slope = (values[-len(tau):] for values in reach.margin(eta, grid, COUNTS_AS_MET))
        k = np.flatnonzero(margin[1:] <= 0)
        end = int(k[0]) + 1 if len(k) else len(tau)
        cell = _dip(tau[:end], margin[:end], slope[:end])
        if cell is None:
            if end == len(tau) or narrowed == 2:   # divisions of the one that contains its end
                break
            cell, narrowed = end - 1, narrowed + 1
        tau = np.concatenate((tau[:cell], np.linspace(tau[cell], tau[cell + 1], 33),
                              tau[cell + 2:]))
    if end == len(tau):
        return None
    a, b = margin[end - 1:end + 1]
    if a <= 0:
        return float(tau[end - 1])
    # Whether the margin is convex or concave, its root is not before the nearer of the roots of
    # chord and tangent.
    chord = a / (a - b) * (tau[end] - tau[end - 1])
    return float(tau[end - 1] + min(chord, a / max(-slope[end - 1], a / chord)))


def _dip(tau: Array, margin: Array, slope: Array) -> int | None:
    """Return the first interval whose tangents at both ends intersect below zero, or None."""
    down, up, h = slope[:-1], slope[1:], np.diff(tau)
    falls = (down < 0) & (up > 0)
    steepness = np.where(falls, up - down, 1.0)
    meeting = (margin[:-1] * up - margin[1:] * down + h * down * up) / steepness
    k = np.flatnonzero(falls & (meeting <= 0) & (h > _ROUNDING * tau[1:]))
    return int(k[0]) if len(k) else None


def _proved(reach: Reach, answer: BangBang, T: float) -> bool:
    """Return whether nu proves all times from T to shortly before the solution's too short."""
    tau = np.linspace(T, answer.T, 64, endpoint=False)
    tau = np.append(reach.times(T), tau[1:]) if T else tau
    margin, _ = reach.margin(-answer.nu, tau, -_ROUNDING)
    return bool((margin[(tau >= T) & (tau < (1 - _NEAR) * answer.T)] > 0).all())


@dataclass(frozen=True, eq=False)
class _Part:
    """
    The part of a problem that determines T: without singular inputs and the directions they move.

    :ivar eta: (r,), direction, for the rows of `part`.
    :ivar columns, singular: inputs of `part`, and the others.
    :ivar tied, free: (q, r) and (q, q - r), combinations of the terminal constraints on which the
        singular inputs do not act, and act.
    """

    whole: Reach
    part: Reach
    eta: Array
    columns: Index
    singular: Index
    tied: Array
    free: Array


def _deciding_part(reach: Reach, T: float, eta: Array) -> _Part:
    s = np.abs(eta @ reach.switching(reach.table(reach.times(T)))).max(axis=0)
    singular = s <= 1e-6 * s.max()   # such inputs do not determine T
    columns = np.flatnonzero(~singular)
    free, tied = split_directions(reach.A, reach.B[:, singular], reach.C)
    part = replace(reach, B=reach.B[:, columns], C=tied.T @ reach.C, d=tied.T @ reach.d)
    return _Part(reach, part, tied.T @ eta, columns, np.flatnonzero(singular), tied, free)


def _direction(reach: Reach, T: float, eta: Array, warm: bool) -> tuple[float, Array, _Part]:
    """
    Return the largest multiple of g(T) reached, its eta, and the part that determines it.

    The switching times are exact unless Newton's method fails. With `warm`, eta is a good guess
    and the linear programme is tried only after it.
    """
    multiple = inf
    for start in (eta, None) if warm else (None,):
        if start is None:
            multiple, start = reach.largest_multiple(T)
        part = _deciding_part(reach, T, start)
        gap = part.part.gap(part.part.table(np.array([0.0, T])))[-1]
        direction = part.eta / (part.eta @ gap)
        level = _level(part.part, T, gap, direction)
        if level is not None:
            return float(1 / level.level[0]), part.tied @ -level.nu, part
    return multiple, part.tied @ direction, part


def _level(reach: Reach, T: float, gap: Array, eta: Array) -> BangBang | None:
    """Return the bang-bang inputs of the lowest level that close a gap by T."""
    n = len(reach.x0)
    rest = Reach(reach.A, reach.B, np.zeros(n), np.zeros(n), reach.C, gap)
    guess = find_extreme_inputs(rest, T, eta)
    reached = rest.reached(T, eta)
    if not reached > 0:   # in double precision the inputs do not act along this direction
        return None
    level = np.full(len(guess.level), max(1 / reached, 1e-12))
    return polish(rest, replace(guess, level=level), 'level')


def _polished(part: _Part, T: float, abnormal: bool) -> BangBang | None:
    """Return the solution near T with singular inputs at the lowest sufficient level, or None."""
    guess = find_extreme_inputs(part.part, T, part.eta)
    found = polish(part.part, guess)
    # If |lam'B| is far above the running cost 1 the extremal may be abnormal. Its short arcs are
    # left out.
    if abnormal and (found is None or part.part.reached(T, found.nu) > 1e4 * T):
        found = polish(part.part, drop_short_arcs(guess, 0.02), 'abnormal') or found
    found = found and _fill_singular(part, found)
    return found if found is not None and found.level.max() <= 1 + 1e-9 else None


def _fill_singular(part: _Part, answer: BangBang, small: float = 0.0) -> BangBang | None:
    """Return the inputs of a part, and singular ones at the lowest levels that meet the target."""
    reach, (n, m) = part.whole, part.whole.B.shape
    nothing = replace(answer, nu=part.tied @ answer.nu, tau=np.zeros(0), owner=np.zeros(0, int),
                      sign=np.ones(m), level=np.zeros(m))
    found = _joined(nothing, answer, part.columns)
    if not len(part.singular):
        return found
    x = compute_final_state(reach, found)
    left = Reach(reach.A, reach.B[:, part.singular], np.zeros(n), np.zeros(n),
                 part.free.T @ reach.C, part.free.T @ (reach.d - reach.C @ x))
    rest = _lowest(left, found.T, small or 1e-12 * (np.abs(reach.d).max() + np.abs(x).max()))
    return rest and _joined(found, rest, part.singular)


def _lowest(reach: Reach, T: float, small: float) -> BangBang | None:
    """
    Return bang-bang inputs from zero to d at T, each at the lowest sufficient level, or None.

    The inputs that determine the highest level are found first; the others close what is left.
    """
    if not len(reach.d) or np.abs(reach.d).max() <= small:
        m = reach.B.shape[1]
        return BangBang(T, np.zeros(len(reach.d)), np.zeros(0), np.zeros(0, int), np.ones(m),
                        np.zeros(m))
    part = _deciding_part(reach, T, reach.largest_multiple(T)[1])
    level = _level(part.part, T, part.part.d, part.eta / (part.eta @ part.part.d))
    return level and _fill_singular(part, level, small)


def _joined(found: BangBang, more: BangBang, columns: Index) -> BangBang:
    """Return the inputs with some columns taken from another solution."""
    sign, level = found.sign.copy(), found.level.copy()
    sign[columns], level[columns] = more.sign, more.level
    return replace(found, sign=sign, level=level, tau=np.concatenate((found.tau, more.tau)),
                   owner=np.concatenate((found.owner, columns[more.owner])))


def compute_final_state(reach: Reach, inputs: BangBang) -> Array:
    """Return x(T), shape (n,)."""
    n, m = reach.B.shape
    tau = np.concatenate(([0.0], np.sort(inputs.tau), [inputs.T]))
    whole = replace(reach, C=np.eye(n), d=np.zeros(n)).table(tau)
    v = inputs.v((tau[:-1] + tau[1:]) / 2)
    driven = np.einsum('kij,kj->i', np.diff(whole[:, :, n:n + m], axis=0), v)
    return np.asarray(whole[-1, :, :n] @ reach.x0 + whole[-1, :, -1] + driven)


def split_directions(A: Array, B: Array, C: Array) -> tuple[Array, Array]:
    """
    Return the directions of y = C x on which the inputs act, and those on which they do not.

    :return: moved, fixed: (q, r) and (q, q - r), orthonormal bases; fixed' C A^i B = 0 for all i.
    """
    block, blocks = C.copy(), []
    size = max(float(np.linalg.norm(A, 2)), 1e-300)
    for _ in range(len(A)):
        blocks.append(block @ B)
        block = block @ A / size
    K = np.hstack(blocks)
    norms = np.linalg.norm(C, axis=1)
    U, sizes, _ = np.linalg.svd(K / np.where(norms > 0, norms, 1.0)[:, None])
    rank = int(np.sum(sizes > 1e-10 * sizes.max(initial=0.0)))
    U = U / np.where(norms > 0, norms, 1.0)[:, None]
    fixed = np.linalg.qr(U[:, rank:])[0]
    moved = np.linalg.svd(fixed.T)[2][fixed.shape[1]:].T if fixed.shape[1] else np.eye(len(C))
    return moved, fixed
