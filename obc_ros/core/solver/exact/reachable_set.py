# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Reachable set of a linear system with bounded inputs.

dx/dt = A x + B v + c, |v_j| <= 1, x(0) = x0. `least_time` looks for the minimum T with C x(T) = d.

With tau = T - t the time to go, the input must supply

    g(T) = d - C e^(A T) x0 - integral of C e^(A tau) c

by T. It can if and only if for all eta

    eta' g(T) <= integral of sum_j |eta' C e^(A tau) b_j| over [0, T].

An eta that violates this inequality at T proves that T is too short. Every later time up to the
first at which the same eta no longer violates it is too short as well. The search continues from
that time and therefore never passes the minimum time, for any x0, d and c (L. W. Neustadt, 1960;
J. H. Eaton, 1962). The eta comes from a linear programme: the largest multiple of g(T) that the
inputs reach. Close to the minimum time `bang_bang` takes over.
"""

from dataclasses import dataclass
from functools import cached_property
from math import ceil, log2, pi

import numpy as np
from obc_ros.core.numerics.arrays import Array, Complex, csgraph, Index, linalg, optimize
from obc_ros.core.ocp.least_time_form import Affine
from obc_ros.core.ocp.problem import Problem

_PARTS = 32     # parts of the horizon for which rounding errors are bounded separately


@dataclass(frozen=True, eq=False)
class Reach:
    """
    The linear system, its initial state and the target C x(T) = d.

    Shapes: A (n, n), B (n, m), c (n,), x0 (n,), C (q, n), d (q,). The inputs must act on every
    direction of C: see `least_time.split_directions`.
    """

    A: Array
    B: Array
    c: Array
    x0: Array
    C: Array
    d: Array

    @cached_property
    def Z(self) -> Array:
        """Return the generator of (x, v, 1): e^(Z t) contains e^(A t) and its integrals."""
        n, m = self.B.shape
        Z = np.zeros((n + m + 1, n + m + 1))
        Z[:n, :n], Z[:n, n:n + m], Z[:n, -1] = self.A, self.B, self.c
        return Z

    @cached_property
    def poles(self) -> Complex:
        """Return the eigenvalues of A."""
        return np.asarray(np.linalg.eigvals(self.A), dtype=complex)

    def times(self, T: float, finer: int = 1) -> Array:
        """Return times to go in [0, T], dense enough for every mode, denser at stiff ends."""
        period_cells = 24 * np.abs(self.poles.imag).max(initial=0) * T / (2 * pi)   # the fastest
        cells = finer * min(max(256, ceil(period_cells)), 8192)
        stiffness = np.abs(self.poles.real).max(initial=0) * T
        if stiffness < cells / 8:
            return np.linspace(0, T, cells + 1)
        levels = T * 0.5**np.arange(1, min(ceil(log2(stiffness)), 40) + 1)
        edges = np.unique(np.concatenate(([0, T], levels, T - levels)))
        part = max(32 * finer, ceil(cells / len(edges)))
        pieces = [np.linspace(a, b, part, endpoint=False)
                  for a, b in zip(edges[:-1], edges[1:], strict=True)]
        return np.append(np.concatenate(pieces), T)

    def table(self, tau: Array) -> Array:
        """Return C [e^(A tau), integrals of e^(A s) B and of e^(A s) c], shape (N, q, n+m+1)."""
        rows = np.empty((len(tau), len(self.d), len(self.Z)))
        rows[0] = 0
        rows[0, :, :len(self.A)] = self.C
        rows[0] = rows[0] @ compute_exponential(self.Z * tau[0])
        done = 1
        steps = np.diff(tau)
        while done < len(tau):
            # Rows for a run of equal steps are computed by doubling.
            first, h, have = done - 1, steps[done - 1], 1
            differ = np.abs(steps[first:] - h) > 1e-9 * h
            end = first + int(np.argmax(differ)) if differ.any() else len(steps)
            power = compute_exponential(self.Z * h)
            while first + have <= end:
                take = min(have, end - first - have + 1)
                rows[first + have:first + have + take] = rows[first:first + take] @ power
                have += take
                power = power @ power
            done = end + 1
        return rows

    def sizes(self, T: float) -> Array:
        """
        Return bounds (n,) of the terms of x(t), t <= T, including intermediate terms.

        The bounds are the largest |e^(A (t - s))| |e^(A s)| (|x0|, 1, 1). A rounding error
        relative to a term at s grows to at most this value. Times are resolved to 1/32 of T.
        """
        tau = self.times(T)
        whole = Reach(self.A, self.B, self.c, self.x0, np.eye(len(self.A)), self.x0)
        table, (n, m) = np.abs(whole.table(tau)), self.B.shape
        flow = np.zeros((len(tau), n + m + 1, n + m + 1))
        flow[:, :n], flow[:, n:, n:] = table, np.eye(m + 1)
        part = np.minimum(_PARTS * tau / T, _PARTS - 1).astype(int)
        most = np.array([flow[np.abs(part - k) <= 1].max(axis=0) for k in range(_PARTS)])
        start = np.concatenate([np.abs(self.x0), np.ones(m + 1)])
        first = most @ start
        found: Array = np.max([(most[:_PARTS - k] @ first[k]).max(axis=0)
                               for k in range(_PARTS)], axis=0)
        return found[:n]

    def gap(self, table: Array) -> Array:
        """Return g at the times of a table, shape (N, q)."""
        n = len(self.A)
        return np.asarray(self.d - table[:, :, :n] @ self.x0 - table[:, :, -1])

    def switching(self, table: Array) -> Array:
        """Return C e^(A tau) B at the times of a table, shape (N, q, m)."""
        return np.asarray(table[:, :, :len(self.A)] @ self.B)

    def margin(self, eta: Array, tau: Array, tolerance: float) -> tuple[Array, Array]:
        """
        Return eta' g(T) minus the most that the inputs reach along eta, and its derivative.

        Both are given for each T of tau. A positive margin proves that T is too short.
        `tolerance` times the terms is subtracted.
        """
        table = self.table(tau)
        wanted, reached = self.gap(table) @ eta, self._reached(eta, tau, table)
        along = eta @ table[:, :, :len(self.A)]
        slope = -along @ (self.A @ self.x0 + self.c) - np.abs(along @ self.B).sum(axis=1)
        return wanted - reached - tolerance * (np.abs(wanted) + reached), slope

    def reached(self, T: float, eta: Array) -> float:
        """Return the largest contribution of the inputs to eta' C x(T)."""
        tau = self.times(T, finer=4)
        return float(self._reached(eta, tau, self.table(tau))[-1])

    def _reached(self, eta: Array, tau: Array, table: Array) -> Array:
        n, m = self.B.shape
        s = eta @ self.switching(table)
        cells = np.abs(np.diff(eta @ table[:, :, n:n + m], axis=0))
        a, b = np.abs(s[:-1]), np.abs(s[1:])
        crossing = s[:-1] * s[1:] < 0
        total = np.where(crossing, a + b, 1.0)
        h = np.diff(tau)[:, None]
        cells = np.where(crossing, h * (a * a + b * b) / (2 * total), cells)
        return np.concatenate(([0.0], np.cumsum(cells.sum(axis=1))))

    def largest_multiple(self, T: float) -> tuple[float, Array]:
        """
        Return the largest multiple of g(T) that the inputs reach at T, and the eta that proves it.

        The multiple is at least 1 if T is long enough; eta is scaled such that eta' g(T) = 1. The
        multiple is inf, which proves nothing, if g(T) is 0 or a term overflows.
        """
        n, m = self.B.shape
        table = self.table(self.times(T))
        columns = np.diff(table[:, :, n:n + m], axis=0).transpose(1, 0, 2).reshape(len(self.d), -1)
        g = self.gap(table)[-1]
        if not g.any() or not np.isfinite(columns).all():
            return np.inf, g
        U, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        open_, shut = U[:, sizes > 1e-13 * sizes[0]], U[:, sizes <= 1e-13 * sizes[0]]
        if shut.size and np.linalg.norm(shut.T @ g) > 1e-9 * np.linalg.norm(g):
            eta = shut @ (shut.T @ g)
            return 0.0, eta / (eta @ g)
        scale = open_ / sizes[:open_.shape[1]]
        left, right = scale.T @ columns, scale.T @ g
        size = np.linalg.norm(right)
        cost = np.zeros(left.shape[1] + 1)
        cost[-1] = -1
        found = optimize.linprog(
            cost, A_eq=np.column_stack((left, -right / size)), b_eq=np.zeros(len(right)),
            bounds=np.array([(-1, 1)] * left.shape[1] + [(0, np.inf)]), method='highs')
        eta = scale @ found.eqlin.marginals
        return float(found.x[-1] / size), eta / (eta @ g)


def normalize_inputs(problem: Problem, plant: Affine, C: Array, d: Array) -> tuple[Reach, Index]:
    """Return a problem with inputs between -1 and 1, and which of all inputs these are."""
    half = (problem.u_upper - problem.u_lower) / 2
    c = plant.c + plant.B @ (problem.u_lower + half)
    driven = np.flatnonzero(half > 0)
    return Reach(plant.A, (plant.B * half)[:, driven], c, problem.x0, C, d), driven


def compute_exponential(matrix: Array) -> Array:
    """
    Return the matrix exponential, accurate for states in units of any size.

    The matrix is first scaled by powers of 2, which causes no rounding (`_balance`). Without it,
    an entry many orders of magnitude above the others would spoil all digits of the others.

    :param matrix: (..., n, n); nan is returned if an entry is not finite.
    """
    sizes = np.abs(matrix).reshape(-1, *matrix.shape[-2:]).max(axis=0)
    if not np.isfinite(sizes).all():
        return np.full_like(matrix, np.nan)
    unit = _balance(sizes)
    found = linalg.expm(matrix * unit / unit[:, None]) * unit[:, None] / unit
    # An entry (i, j) is exactly 0 if no chain of nonzero entries leads from i to j.
    linked = (sizes > 0) | np.eye(len(sizes), dtype=bool)
    for _ in range(len(sizes).bit_length()):
        linked = linked @ linked
    return np.asarray(np.where(linked, found, 0.0), dtype=float)


def _balance(sizes: Array) -> Array:
    """
    Return powers of 2 d (n,) for which no entry of sizes_ij d_j / d_i is needlessly large.

    LAPACK balances entries that lie on a cycle of the graph of the matrix. An entry between two
    strongly connected components lies on none and can be scaled to any size: here to at most the
    largest entry within a component, or 1.
    """
    unit = linalg.matrix_balance(sizes, permute=False, separate=True)[1][0]
    scaled = sizes * unit / unit[:, None]
    count, part = csgraph.connected_components(sizes > 0, directed=True, connection='strong')
    inside = part[:, None] == part
    largest = max(float(scaled[inside].max(initial=0.0)), 1.0)
    rows, columns = np.nonzero((scaled > 0) & ~inside)
    excess = np.ceil(np.log2(scaled[rows, columns] / largest))
    power = np.zeros(count)
    for _ in range(count):   # the longest chain of components has fewer links
        np.maximum.at(power, part[rows], power[part[columns]] + excess)
    return np.asarray(unit * 2.0**power[part])


def bound_first_reach(A: Array, B: Array, T: float) -> Array:
    """
    Return the largest contribution of constant inputs of the size 1 to each state within T.

    It is the largest |A^k B T^(k + 1) / (k + 1)!| over the inputs and over k < n.
    """
    moved, found = B * T, np.zeros(len(A))
    for k in range(len(A)):
        found = np.maximum(found, np.abs(moved).max(axis=1, initial=0.0))
        moved = A @ moved * (T / (k + 2))
    return found


def bound_reach(A: Array, B: Array, T: float) -> Array:
    """Return the largest change of each state within T by inputs of the size 1, from x(0) = 0."""
    n, m = B.shape
    Z = np.zeros((n + m, n + m))
    Z[:n, :n], Z[:n, n:] = A, B
    step = compute_exponential(Z * (T / _PARTS))
    moved, found = step[:n, n:], np.zeros(n)
    for _ in range(_PARTS):
        found += np.abs(moved).sum(axis=1)
        moved = step[:n, :n] @ moved
    return found
