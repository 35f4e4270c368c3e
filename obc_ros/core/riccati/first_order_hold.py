# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The path of a linear quadratic problem under the optimal feedback with a piecewise linear input.

Linear interpolation between samples of the optimal input does not reproduce the optimal path: a
fast plant amplifies the interpolation error. Here the states are integrated exactly under the
piecewise linear input, and the feedback u = F(t) (x, 1, nu) holds at the samples. The excess cost
is then of second order in the interpolation error, however stiff the plant. The multipliers nu are
chosen such that the path under the piecewise linear input meets C x(T) = d.

The horizon is divided into blocks of length T 2^-k, and each block into 2^c equal steps. The
matrices of a step follow from those of half the step by doubling.
"""

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index, linalg
from obc_ros.core.numerics.rounding import norm, TINY
from obc_ros.core.riccati import propagation

_FEWEST = 3             # initial halvings of a block
_MOST_AT_ONCE = 3       # halvings added in one round
_ROUNDS = 12
_LARGEST_TABLE = 2e7    # entries of P(t) at all steps (160 MB)
_MOST_STEPS = 2**18     # of all blocks; with few states this bounds time and memory
_MOST_GROWTH = 20.0     # largest norm of the transition matrix of a step per state, about e^3
_SHORT = 0.5            # largest norm of a rate matrix times the step of which expm is taken
_ALLOWED = 1e-5         # sum of `_errors`, a tenth of the tolerance of the certificate
_OF_THE_COST = 100.0    # weight of the excess cost: its relative tolerance is 1e-7


@dataclass(frozen=True, eq=False)
class LqForm:
    """
    The matrices of a linear quadratic problem.

    dx/dt = A x + B u + a
    L     = x'Q x / 2 + x'N u + u'R u / 2 + q'x + r'u + cost,  R > 0
    V     = x'P1 x / 2 + p1'x + terminal_cost
    psi   = C x - d
    """

    A: Array
    B: Array
    a: Array
    Q: Array
    N: Array
    R: Array
    q: Array
    r: Array
    cost: float
    P1: Array
    p1: Array
    terminal_cost: float
    C: Array
    d: Array


@dataclass(frozen=True, eq=False)
class Extended:
    """
    A problem in the scaled, extended state z = (x, one, nu); psi = C z.

    The units are `scale` (n,) of x, `one` of the constant and `row` (q,) of psi.
    """

    form: LqForm
    A: Array
    G: Array
    Q: Array
    P1: Array
    C: Array
    scale: Array
    one: float
    row: Array

    @property
    def n(self) -> int:
        """Return the number of states."""
        return len(self.scale)

    @property
    def x_block(self) -> tuple[Array, Array, Array, Array]:
        """Return the (n, n) blocks of A, G, Q, P1 that belong to x."""
        n = self.n
        return self.A[:n, :n], self.G[:n, :n], self.Q[:n, :n], self.P1[:n, :n]


class Held(NamedTuple):
    """A path: t (N,), x, lam (N, n), u (N, m), nu (q,); `errors` (N-1,) of the intervals."""

    t: Array
    x: Array
    u: Array
    lam: Array
    nu: Array
    errors: Array


class Feedback:
    """P(t), the feedback and the transition matrices of all steps from 0 to T, by blocks."""

    def __init__(self, extended: Extended, P1: Array, blocks: list[tuple[float, float]]) -> None:
        self.extended, self.P1, self.blocks, self.T = extended, P1, blocks, blocks[-1][1]
        self.halvings = np.full(len(blocks), _FEWEST)
        self._costs: dict[int, Array] = {}
        self._inputs: dict[int, Array] = {}
        self._stretches: dict[int, propagation.Stretch] = {}
        self._joined: dict[int, bool] = {}
        self._flows: dict[int, Array] = {}

    def refine(self, more: Index) -> None:
        """Halve the steps of each block `more` (blocks,) times."""
        self.halvings += more
        for block in np.flatnonzero(more).tolist():
            self._costs.pop(block, None)
            self._inputs.pop(block, None)

    def may_refine(self, more: Index) -> bool:
        """Return whether `more` (blocks,) halvings stay within the limits of steps and memory."""
        steps = np.sum(2.0**(self.halvings + more))
        return bool(steps <= min(_MOST_STEPS, _LARGEST_TABLE / self.P1.size))

    def costs(self, block: int) -> Array:
        """Return P at the ends of the steps of a block, (2^c + 1, n+1+q, n+1+q)."""
        if block not in self._costs:
            halvings = int(self.halvings[block])
            self._costs[block] = propagation.propagate_steps_back(
                self._levels(block, halvings), self._cost_after(block), 2**halvings)[::-1]
        return self._costs[block]

    def _cost_after(self, block: int) -> Array:
        return self.P1 if block == len(self.blocks) - 1 else self.costs(block + 1)[0]

    def law(self, block: int) -> Array:
        """Return F of u = F z at the ends of the steps of a block, (2^c + 1, m, n+1+q)."""
        form, scale, n = self.extended.form, self.extended.scale, self.extended.n
        P, B = self.costs(block), np.zeros((len(self.P1), form.B.shape[1]))
        B[:n] = form.B / scale[:, None]
        right = np.swapaxes((P.reshape(-1, len(B)) @ B).reshape(*P.shape[:2], -1), 1, 2)
        right[:, :, :n] += form.N.T * scale
        right[:, :, n] += form.r / self.extended.one
        return np.asarray(-np.linalg.inv(form.R) @ right)

    def inputs(self, block: int) -> Array:
        """Return K of u+ = K (x, one, nu, u) for the steps of a block, (2^c, m, n+1+q+m)."""
        if block not in self._inputs:
            move, law, n = self.move(block), self.law(block)[1:], self.extended.n
            (steps, m, size), F = law.shape, law[:, :, :n].reshape(-1, n)
            led = (F @ move).reshape(steps, m, -1)
            right = np.zeros((steps, m, size + m))
            right[:, :, :n + 1], right[:, :, size:] = led[:, :, :n + 1], led[:, :, n + 1:n + 1 + m]
            right[:, :, n:size] += law[:, :, n:]
            self._inputs[block] = np.asarray(
                np.linalg.solve(np.eye(m) - led[:, :, n + 1 + m:], right), np.float64)
        return self._inputs[block]

    def move(self, block: int) -> Array:
        """
        Return (Phi, g, G0, G1): x+ = Phi x + g one + G0 u + G1 u+ over a step, (n, n+1+2m).

        States are in units of `scale`; the input goes along a line from u to u+.
        """
        n, m = self.extended.form.B.shape
        level = self._length(block) + int(self.halvings[block])
        flow, step = self._flow(level)[:n], self.T * 0.5**level
        slope = flow[:, n + 1 + m:] / step
        return np.hstack([flow[:, :n + 1], flow[:, n + 1:n + 1 + m] - slope, slope])

    def samples(self, z: Array, halvings: int) -> tuple[Array, Array, Array]:
        """
        Return t, z and P z along the optimal path, at 2^`halvings` equal steps of each block.

        Shapes (blocks, steps + 1) and twice (blocks, steps + 1, n+1+q).
        """
        steps = 2**halvings
        x, y = np.empty((2, len(self.blocks), steps + 1, len(z)))
        for block in range(len(self.blocks)):
            x[block], y[block] = propagation.solve_inside(
                self._levels(block, halvings), z, self._cost_after(block), steps)
            z = x[block, -1]
        return np.array([np.linspace(*block, steps + 1) for block in self.blocks]), x, y

    def _levels(self, block: int, halvings: int) -> list[propagation.Stretch]:
        """Return the stretches of 1, 2, 4, ... of the 2^`halvings` steps of a block."""
        level = self._length(block) + halvings
        found = [self._stretch(level)]
        while len(found) <= halvings and self._joins(level - len(found)):
            found.append(self._stretch(level - len(found)))
        return found

    def _joins(self, level: int) -> bool:
        """Return whether two stretches may be joined to one of length T 2^-`level`."""
        if level not in self._joined:
            half = self._stretch(level + 1)
            self._joined[level] = (propagation.is_convex(half) or propagation.is_apart(half)
                                   ) and propagation.is_accurate_join(self._stretch(level))
        return self._joined[level]

    def _length(self, block: int) -> int:
        """Return k for the length T 2^-k of a block."""
        low, high = self.blocks[block]
        return round(math.log2(self.T / (high - low)))

    def _stretch(self, level: int) -> propagation.Stretch:
        """Return the stretch of a step of T 2^-level, by doubling that of a short one."""
        if level not in self._stretches:
            e, step = self.extended, self.T * 0.5**level
            if (norm(e.A) + math.sqrt(norm(e.G) * norm(e.Q))) * step > _SHORT:
                half = self._stretch(level + 1)
                found = propagation.join_stretches(half, half, np.eye(len(e.A)))
            else:
                found = propagation.build_stretch(e.A, e.G, e.Q, step)
            self._stretches[level] = found
        return self._stretches[level]

    def _flow(self, level: int) -> Array:
        """Return the transition matrix of (x, one, u, du/dt) over a step of T 2^-level."""
        if level not in self._flows:
            form, scale, step = self.extended.form, self.extended.scale, self.T * 0.5**level
            n, m = form.B.shape
            rate = np.zeros((n + 1 + 2*m, n + 1 + 2*m))
            rate[:n, :n] = form.A * (scale / scale[:, None])
            rate[:n, n] = form.a / scale / self.extended.one
            rate[:n, n + 1:n + 1 + m] = form.B / scale[:, None]
            rate[n + 1:n + 1 + m, n + 1 + m:] = np.eye(m)
            self._flows[level] = (
                self._flow(level + 1) @ self._flow(level + 1) if norm(rate) * step > _SHORT
                else np.asarray(linalg.expm(rate * step)))
        return self._flows[level]


def follow_feedback(feedback: Feedback, x0: Array, nu: Array) -> Held | None:
    """
    Return the path from x0 under a piecewise linear input, on a grid that is refined as needed.

    A step over which the free response grows by more than `_MOST_GROWTH` is halved first: a
    piecewise linear input does not stabilise such a step.

    :param feedback: its blocks are refined.
    :param x0: (n,), in units of `scale`.
    :return: None if steps of allowed growth would exceed the limits of steps and memory, or the
        path is not finite. The sum of `errors` is above `_ALLOWED` if a limit has ended the
        refinement.
    """
    with np.errstate(all='ignore'):
        for block in range(len(feedback.blocks)):
            one = np.eye(len(feedback.blocks), dtype=np.intp)[block]
            while not norm(feedback.move(block)[:, :len(x0)]) <= _MOST_GROWTH * len(x0):
                if not feedback.may_refine(one):
                    return None
                feedback.refine(one)
        for _ in range(_ROUNDS):
            held = _followed(feedback, x0, nu)
            error = float(held.errors.sum())
            if error <= _ALLOWED:
                return held
            if not math.isfinite(error):
                break
            more = _halvings(held.errors, feedback.halvings)
            while not feedback.may_refine(more) and more.max() > 1:
                more = np.minimum(more, more.max() - 1)
            if not feedback.may_refine(more):
                break
            feedback.refine(more)
    return held if math.isfinite(error) else None


def _halvings(errors: Array, halvings: Index) -> Index:
    """
    Return how many times the steps of each block should be halved.

    Halving the steps of a block divides its error by 4. The tolerance is met with the minimum
    number of steps if that of each block grows by a factor proportional to
    (error / number of steps)^(1/3).
    """
    sizes = 2**halvings
    of_blocks = np.add.reduceat(errors, np.cumsum(sizes) - sizes) + TINY
    growth = np.cbrt(of_blocks / sizes)
    growth *= math.sqrt(float(np.sum(of_blocks / growth**2)) / _ALLOWED)
    more = np.clip(np.rint(np.log2(growth)), 0, _MOST_AT_ONCE).astype(np.intp)
    worst = int(growth.argmax())
    more[worst] = max(more[worst], 1)
    return more


def _followed(feedback: Feedback, x0: Array, nu: Array) -> Held:
    """Return the path on the present grid, with the nu for which it meets C x(T) = d."""
    extended = feedback.extended
    n, q, blocks = len(x0), len(nu), range(len(feedback.blocks))
    # Columns: the path for the given nu and its derivative with respect to each nu.
    start = np.zeros((n + 1 + q, 1 + q))
    start[:, 0] = np.concatenate([x0, [extended.one], nu])
    start[n + 1:, 1:] = np.eye(q)
    courses = [np.vstack([start, feedback.law(0)[0] @ start])[None]]
    for block in blocks:
        courses.append(_steps(feedback, block, courses[-1][-1]))
    course, change = np.concatenate(courses), np.zeros(q)
    if q:
        missed = extended.C @ course[-1, :n + 1 + q]
        change = np.linalg.lstsq(missed[:, 1:], -missed[:, 0], rcond=1e-12)[0]
    z, u = np.split(course @ np.append(1.0, change), [n + 1 + q], axis=1)
    bends, lam, pushed, first = [], [], [], 0
    to_states = (extended.form.B / extended.scale[:, None]).T
    for block in blocks:
        P = feedback.costs(block)[:, :n]
        last = first + len(P) - 1
        bends.append(_bends(u[first:last + 1]))
        lam.append(_products(P[block > 0:], z[first + (block > 0):last + 1]))
        pushed.append(_products(P[1:, :, :n], bends[-1] @ to_states))
        first = last
    t = np.concatenate([np.linspace(*ends, 2**int(halvings) + 1)[ends[0] > 0:] for
                        ends, halvings in zip(feedback.blocks, feedback.halvings, strict=True)])
    path = (t, z[:, :n] * extended.scale, u, np.concatenate(lam) / extended.scale)
    return Held(*path, nu + change, _errors(
        extended.form, *path, np.concatenate(bends), np.concatenate(pushed) / extended.scale))


def _products(matrices: Array, vectors: Array) -> Array:
    return np.asarray(np.matmul(matrices, vectors[:, :, None])[:, :, 0])


def _steps(feedback: Feedback, block: int, y: Array) -> Array:
    """Return the columns (x, one, nu, u) at the ends of a block's steps, from those before it."""
    move, inputs, (n, m) = (
        feedback.move(block), feedback.inputs(block), feedback.extended.form.B.shape)
    q = len(y) - n - 1 - m
    free = np.hstack([move[:, :n + 1], np.zeros((n, q)), move[:, n + 1:n + 1 + m]])
    held = move[:, n + 1 + m:]
    found = np.empty((len(inputs), *y.shape))
    for k, to_input in enumerate(inputs):
        u = to_input @ y
        found[k, :n], found[k, n:n + 1 + q], found[k, n + 1 + q:] = (
            free @ y + held @ u, y[n:n + 1 + q], u)
        y = found[k]
    return found


def _bends(u: Array) -> Array:
    """Estimate the deviation of the input from its chord at the middle of each step."""
    second = np.diff(u, 2, axis=0) / 8.0
    before, after = np.vstack([second[:1], second]), np.vstack([second, second[-1:]])
    return np.where(np.abs(before) > np.abs(after), before, after)


def _errors(form: LqForm, t: Array, x: Array, u: Array, lam: Array, bends: Array, pushed: Array
            ) -> Array:
    """
    Return for each interval the dimensionless error in Pontryagin's conditions and in the cost.

    `pushed` (N-1, n) is the change of dlam/dt caused by `bends`. Defects of lam and changes of H
    are scaled as in the certificate; the excess cost is multiplied by `_OF_THE_COST`.
    """
    h = np.diff(t)
    size = np.abs(x).max(axis=0)
    size = np.maximum(size, 1e-2 * min(1.0, float(size.max())) + TINY)
    defect = np.abs(pushed * size).max(axis=1) * h / ((np.abs(lam) * size).max() + TINY)
    L, H, terms = evaluate_hamiltonian(form, x, u, lam)
    spent = float(h @ np.abs(L[1:] + L[:-1])) / 2.0 + abs(
        x[-1] @ (0.5 * form.P1 @ x[-1] + form.p1) + form.terminal_cost)
    given_away = h * np.einsum('ki,ij,kj->k', bends, form.R, bends) * (4.0 / 15.0)
    return np.asarray(defect + np.abs(np.diff(H)) / (terms.max() + TINY)
                      + _OF_THE_COST * given_away / (spent + TINY))


def evaluate_hamiltonian(form: LqForm, x: Array, u: Array, lam: Array) -> tuple[Array, Array,
                                                                                Array]:
    """Return L, H = L + lam'f and |L| + |lam|'|f| at each sample."""
    L = evaluate_running_cost(form, x, u)
    terms = lam * (x @ form.A.T + u @ form.B.T + form.a)
    return L, L + terms.sum(axis=1), np.abs(L) + np.abs(terms).sum(axis=1)


def evaluate_running_cost(form: LqForm, x: Array, u: Array) -> Array:
    """Return L at each sample."""
    L: Array = (
        0.5 * np.einsum('...i,...i->...', x @ form.Q, x)
        + np.einsum('...i,...i->...', x @ form.N, u)
        + 0.5 * np.einsum('...i,...i->...', u @ form.R, u)
        + x @ form.q + u @ form.r + form.cost)
    return L
