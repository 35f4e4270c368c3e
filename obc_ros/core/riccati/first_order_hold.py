# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The path of a linear quadratic problem under the optimal feedback, its input linear in between.

Lines through samples of the optimal input do not lead where the optimal path does: the error is
that of the lines times how fast the plant is. Here the states are those that the lines lead to,
and the feedback u = F(t) (x, 1, nu) holds at the samples: what this gives away is of second order
in the cost, however stiff the plant. The multipliers nu are those for which the path under the
lines meets C x(T) = d.

The horizon is cut into blocks of T 2^-k, each cut into 2^c equal steps, so that every step is T
times a power of 1/2, and what belongs to it is what belongs to its half, doubled.
"""

from collections.abc import Callable
from dataclasses import dataclass
import math
from typing import TypeVar

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.numerics.rounding import norm, TINY
from obc_ros.core.riccati import propagation
from obc_ros.core.riccati.problem_matrices import LqForm
from scipy.linalg import expm

Of = TypeVar('Of')

_FEWEST = 3             # halvings of a block
_MOST_AT_ONCE = 3       # halvings added in one round
_ROUNDS = 12
_LARGEST_TABLE = 2e7    # numbers of P(t) at all steps (160 MB)
_MOST_STEPS = 2**18     # of all blocks; with few states these bound time and memory
_MOST_GROWTH = 20.0     # of the states over a step, on the average of the rows: e^3
_SHORT = 0.5            # norm of a rate times a step of which the exponential is taken
_ALLOWED = 1e-5         # a tenth of what the certificate allows; all intervals, as in `_errors`
_OF_THE_COST = 100.0    # a cost is to be right to 1e-7


@dataclass(frozen=True, eq=False)
class Extended:
    """
    A problem in z, with the units `scale` (n,) of x, `one` of the constant, `row` (q,) of psi.

    A, G, Q, P1 are (n+1+q, n+1+q), C (q, n+1+q) holds psi = C z.
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
        """Return the parts of A, G, Q, P1 that belong to x."""
        n = self.n
        return self.A[:n, :n], self.G[:n, :n], self.Q[:n, :n], self.P1[:n, :n]


@dataclass(frozen=True, eq=False)
class Held:
    """A path: t (N,), x, lam (N, n), u (N, m), nu (q,); `errors` (N-1,) is what lines leave."""

    t: Array
    x: Array
    u: Array
    lam: Array
    nu: Array
    errors: Array


class Feedback:
    """P(t) and what belongs to the steps of a horizon, from 0 to T in blocks."""

    def __init__(self, extended: Extended, P1: Array, blocks: list[tuple[float, float]]) -> None:
        self.extended, self.P1, self.blocks, self.T = extended, P1, blocks, blocks[-1][1]
        self.halvings = [_FEWEST] * len(blocks)
        self._costs: dict[int, Array] = {}
        self._laws: dict[int, Array] = {}
        self._inputs: dict[int, Array] = {}
        self._stretches: dict[int, propagation.Stretch] = {}
        self._joined: dict[int, bool] = {}
        self._flows: dict[int, Array] = {}

    def times(self, block: int) -> Array:
        """Return the ends of the steps of a block."""
        return np.linspace(*self.blocks[block], 2**self.halvings[block] + 1)

    def refine(self, block: int, more: int) -> None:
        """Halve the steps of a block, so many times."""
        self.halvings[block] += more
        for known in (self._costs, self._laws, self._inputs):
            known.pop(block, None)

    def may_refine(self, more: Index) -> bool:
        """Return whether steps and memory allow for so many halvings of each block."""
        steps = sum(1 << int(each) for each in self.halvings + more)
        return steps <= min(_MOST_STEPS, _LARGEST_TABLE / self.P1.size)

    def costs(self, block: int) -> Array:
        """Return P at the ends of the steps of a block, (2^c + 1, n+1+q, n+1+q)."""
        if block not in self._costs:
            last = block == len(self.blocks) - 1
            end = self.P1 if last else self.costs(block + 1)[0]
            halvings = self.halvings[block]
            self._costs[block] = propagation.propagate_steps_back(
                self._levels(block, halvings), end, 2**halvings)[::-1]
        return self._costs[block]

    def law(self, block: int) -> Array:
        """Return F of u = F z at the ends of the steps of a block, (2^c + 1, m, n+1+q)."""
        if block not in self._laws:
            form, scale, n = self.extended.form, self.extended.scale, self.extended.n
            P, B = self.costs(block), np.zeros((len(self.P1), form.B.shape[1]))
            B[:n] = form.B / scale[:, None]
            right = np.swapaxes((P.reshape(-1, len(B)) @ B).reshape(*P.shape[:2], -1), 1, 2)
            right[:, :, :n] += form.N.T * scale
            right[:, :, n] += form.r / self.extended.one
            self._laws[block] = -np.linalg.inv(form.R) @ right
        return self._laws[block]

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
        level = self._level(block)
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
            last = block == len(self.blocks) - 1
            x[block], y[block] = propagation.solve_inside(
                self._levels(block, halvings), z,
                self.P1 if last else self.costs(block + 1)[0], steps)
            z = x[block, -1]
        return np.array([np.linspace(*block, steps + 1) for block in self.blocks]), x, y

    def _levels(self, block: int, halvings: int) -> list[propagation.Stretch]:
        """Return the stretch of a block's 2^`halvings` steps, and those of more, as a ladder."""
        level = self._length(block) + halvings
        found = [self._stretch(level)]
        while len(found) <= halvings and self._joins(level - len(found)):
            found.append(self._stretch(level - len(found)))
        return found

    def _joins(self, level: int) -> bool:
        """Return whether two stretches may be joined to one of T 2^-`level`."""
        if level not in self._joined:
            half = self._stretch(level + 1)
            self._joined[level] = (propagation.is_convex(half) or propagation.is_apart(half)
                                   ) and propagation.is_accurate_join(self._stretch(level))
        return self._joined[level]

    def _length(self, block: int) -> int:
        """Return k, a block being T 2^-k long."""
        low, high = self.blocks[block]
        return round(math.log2(self.T / (high - low)))

    def _level(self, block: int) -> int:
        """Return k, the steps of a block being T 2^-k."""
        return self._length(block) + self.halvings[block]

    def _stretch(self, level: int) -> propagation.Stretch:
        e = self.extended
        identity, speed = np.eye(len(e.A)), norm(e.A) + math.sqrt(norm(e.G) * norm(e.Q))
        return _doubled(
            self._stretches, level, self.T, speed,
            lambda step: propagation.build_stretch(e.A, e.G, e.Q, step),
            lambda half: propagation.join_stretches(half, half, identity))

    def _flow(self, level: int) -> Array:
        """Return what becomes of (x, one, u, du/dt) over a step."""
        form, scale, one = self.extended.form, self.extended.scale, self.extended.one
        n, m = form.B.shape
        rate = np.zeros((n + 1 + 2*m, n + 1 + 2*m))
        rate[:n, :n] = form.A * (scale / scale[:, None])
        rate[:n, n] = form.a / scale / one
        rate[:n, n + 1:n + 1 + m] = form.B / scale[:, None]
        rate[n + 1:n + 1 + m, n + 1 + m:] = np.eye(m)
        return _doubled(self._flows, level, self.T, norm(rate),
                        lambda step: np.asarray(expm(rate * step)), lambda half: half @ half)


def _doubled(known: dict[int, Of], level: int, T: float, speed: float,
             begin: Callable[[float], Of], double: Callable[[Of], Of]) -> Of:
    """Return what belongs to a step of T 2^-level: that of a short one, doubled."""
    first = level
    while first not in known and speed * T * 0.5**first > _SHORT:
        first += 1
    if first not in known:
        known[first] = begin(T * 0.5**first)
    for k in range(first - 1, level - 1, -1):
        known[k] = double(known[k + 1])
    return known[level]


def follow_feedback(feedback: Feedback, x0: Array, nu: Array) -> Held | None:
    """
    Return the path from x0 on as fine a grid as lines of the input need, if that is not too fine.

    Lines do not hold states that grow on their own by much within a step.

    Parameters
    ----------
    feedback : Feedback
        Of the problem; blocks are refined where they need it.
    x0 : ndarray, shape (n,)
        In units of `scale`.
    nu : ndarray, shape (q,)
        Multipliers of the optimal path.

    """
    with np.errstate(all='ignore'):
        for block in range(len(feedback.blocks)):
            one = (np.arange(len(feedback.blocks)) == block).astype(np.intp)
            while not norm(feedback.move(block)[:, :len(x0)]) <= _MOST_GROWTH * len(x0):
                if not feedback.may_refine(one):
                    return None
                feedback.refine(block, 1)
        for _ in range(_ROUNDS):
            held = _followed(feedback, x0, nu)
            error = float(held.errors.sum())
            if error <= _ALLOWED:
                return held
            if not math.isfinite(error):
                break
            more = _halvings(held.errors, np.array(feedback.halvings))
            while not feedback.may_refine(more) and more.max() > 1:
                more = np.minimum(more, more.max() - 1)
            if not feedback.may_refine(more):
                break
            for block in np.flatnonzero(more).tolist():
                feedback.refine(block, int(more[block]))
    return held if math.isfinite(error) else None


def _halvings(errors: Array, halvings: Index) -> Index:
    """
    Return how often the steps of each block are to be halved.

    What lines leave in a block is quartered by halving its steps: so that it becomes little
    enough with the fewest steps in all, these grow by (error / number of steps)^(1/3).
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
    """Return the path on the grid as it is, with the nu for which it meets C x(T) = d."""
    extended = feedback.extended
    n, q, blocks = len(x0), len(nu), range(len(feedback.blocks))
    # Columns: the path with nu as given, and what a change of each nu by one makes of it.
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
    t = np.concatenate([feedback.times(block)[block > 0:] for block in blocks])
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
    """Return by how much the input passes by the middle of a line, for each step of a block."""
    second = np.diff(u, 2, axis=0) / 8.0
    before, after = np.vstack([second[:1], second]), np.vstack([second, second[-1:]])
    return np.where(np.abs(before) > np.abs(after), before, after)


def _errors(form: LqForm, t: Array, x: Array, u: Array, lam: Array, bends: Array, pushed: Array
            ) -> Array:
    """
    Return what each line leaves of Pontryagin's conditions and of the cost, without unit.

    `pushed` (N-1, n) is what `bends` make of dlam/dt. Defects of lam and changes of H count as in
    the certificate, what is given away `_OF_THE_COST` times as much as there.
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
