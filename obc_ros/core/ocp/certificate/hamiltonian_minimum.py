# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The gap of an input: H = L + lam' f less its minimum over the whole input set.

H is a sum of terms in separate groups of inputs. The groups follow from the inputs on which each
dH/du_j depends. In a group where H is affine or quadratic, the minimum over the box is computed.
In any other group it is searched for on a grid of the inputs that enter nonlinearly, over the box,
or over a window where the box is unbounded. The other inputs of the group are optimal at each grid
point. Inputs that share a path constraint are one group, see docs/certificate.md.
"""

from dataclasses import dataclass
from functools import cached_property
import itertools

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.numerics.instructions import find_dependence, Instructions
from obc_ros.core.numerics.vectorized import VectorizedFunction
from obc_ros.core.ocp.problem import Problem

_KINKED = (ca.OP_FABS, ca.OP_SIGN)
_GRID = {1: 41, 2: 15, 3: 7, 4: 5}   # number of axes: points along each; 2 for more axes
_MOST_AXES = 8                       # for which all vertices of the box are tried
_WINDOW = 5.0                        # times the input's scale, beyond the path, if unbounded
_SWEEPS = 60                         # of a descent over one input at a time


@dataclass(frozen=True)
class _Group:
    """
    Inputs, by index, that enter H together.

    `searched` are the inputs of the grid. Given them, H is a sum of quadratics in each of the
    others. If there are none, H is a quadratic in all. `rows` are the path constraints that the
    inputs share.
    """

    inputs: tuple[int, ...]
    searched: tuple[int, ...]
    rows: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Points:
    """
    H, its terms and its derivatives at K points.

    `x`, `lam`, `f` (K, n), `u` (K, m), `mu`, `c` (K, l), `L`, `H`, `size` (K,) with
    size = |L| + |lam|'|f|, and of H + mu' c with respect to u `slope` (K, m) and `curvature`
    (K, m, m).
    """

    x: Array
    u: Array
    lam: Array
    mu: Array
    f: Array
    c: Array
    L: Array
    H: Array
    size: Array
    slope: Array
    curvature: Array

    def some(self, rows: Index) -> 'Points':
        """Return the points with these indices."""
        return Points(**{name: values[rows] for name, values in vars(self).items()})


@dataclass(frozen=True, eq=False)
class HamiltonianScales:
    """Scaling factors: `u` (m,) of the inputs, `H` of the Hamiltonian."""

    u: Array
    H: float


class InputMinimum:
    """H of a problem and its minimum over the input set, for any values of its numbers."""

    def __init__(self, problem: Problem) -> None:
        x, u, p, lam = problem.x, problem.u, problem.p, ca.SX.sym('lam', problem.n)
        mu = ca.SX.sym('mu', problem.path.numel())
        H = problem.L + ca.dot(lam, problem.f)
        augmented = ca.gradient(H + ca.dot(mu, problem.path), u)
        curvature = ca.jacobian(augmented, u)
        size = ca.fabs(problem.L) + ca.dot(ca.fabs(lam), ca.fabs(problem.f))
        self._points = VectorizedFunction([x, u, lam, mu, p], [
            problem.f, problem.path, problem.L, H, size, augmented, curvature])
        self._problem, self._lam, self._H = problem, lam, H

    @cached_property
    def _groups(self) -> list[_Group]:
        problem, m, u = self._problem, self._problem.m, self._problem.u
        Huu = ca.jacobian(ca.gradient(self._H, u), u)
        # The sparsity has an entry wherever dH/du_i depends on u_j, also through |u|.
        linked = np.eye(m, dtype=bool)
        linked[Huu.sparsity().get_triplet()] = True
        rows = find_dependence(problem.path, u)
        groups = linked | ((rows.T.astype(int) @ rows.astype(int)) > 0)
        groups |= groups.T
        for k in range(m):
            groups |= np.outer(groups[:, k], groups[k])
        entries = list(zip(*Huu.sparsity().get_triplet(), strict=True))
        varies = ca.jacobian_sparsity(Huu.nz[:], u)
        bent = np.zeros((m, m, m), dtype=bool)
        for entry, j in zip(*varies.get_triplet(), strict=True):
            bent[(*entries[entry], j)] = True
        kinked = Instructions(ca.Function('H', [problem.x, u, problem.p], [
            problem.L, problem.f])).have(*_KINKED)
        result = []
        for members in sorted({tuple(int(j) for j in np.flatnonzero(row)) for row in groups}):
            shared = tuple(int(j) for j in np.flatnonzero(rows[:, members].any(axis=1)))
            if shared or kinked:
                searched = members
            elif not bent[np.ix_(members, members, members)].any():
                searched = ()
            else:
                easy: list[int] = []
                for j in members:
                    apart = not (linked[j, easy].any() or linked[easy, j].any())
                    if apart and not bent[j, j, j]:
                        easy.append(j)
                searched = tuple(j for j in members if j not in easy)
            result.append(_Group(members, searched, shared))
        return result

    @cached_property
    def _beside(self) -> list[int]:
        """Return the inputs whose minimisers follow from those that are searched."""
        return [j for group in self._groups if group.searched
                for j in group.inputs if j not in group.searched]

    @cached_property
    def _few(self) -> VectorizedFunction:
        """Return H, the path constraints, and dH/du, d2H/du2 of inputs that are not searched."""
        problem = self._problem
        u = problem.u[self._beside]
        H_u = ca.gradient(self._H, u) if self._beside else ca.SX(0, 1)
        return VectorizedFunction([problem.x, problem.u, self._lam, problem.p], [
            self._H, problem.path, H_u, ca.diag(ca.jacobian(H_u, u))])

    def points(self, problem: Problem, x: Array, u: Array, lam: Array, mu: Array) -> Points:
        """Return H, its terms and its derivatives at K points."""
        f, c, L, H, size, slope, curvature = self._points(x, u, lam, mu, problem.p_value)
        return Points(
            x=x, u=u, lam=lam, mu=mu, f=f, c=c, L=L[:, 0], H=H[:, 0], size=size[:, 0],
            slope=slope, curvature=curvature.reshape(-1, problem.m, problem.m))

    def gap(self, problem: Problem, at: Points, searched: Index,
            scales: HamiltonianScales) -> Array:
        """
        Return H less its minimum over the input set.

        :param at: with path constraints on inputs, the gap of the quadratic model of H + mu' c
            plus mu' (b - c) counts if it is larger.
        :param searched: the points at which groups without closed form are searched over the whole
            input set. At the other points they are compared with a better input nearby.
        :param scales: an unbounded input in which H is affine counts with a change by its scale.
        :return: (K,), at least 0, in units of H.
        """
        total = np.zeros(len(at.x))
        for group in self._groups:
            index = list(group.inputs)
            box = _Box(problem.u_lower[index], problem.u_upper[index], scales.u[index], scales.H)
            Q = at.curvature[:, index][:, :, index]
            if group.rows:
                Q = Q * (np.eye(len(index)) * (Q > 0))
            step, value = _descend(at.slope[:, index], Q, at.u[:, index], box)
            gap = -value
            if group.rows:
                gap = gap + _slack(problem, at, list(group.rows))
            elif group.searched:
                moved = at.u.copy()
                moved[:, index] += np.clip(step, -1e6*box.scale, 1e6*box.scale)
                gap = at.H - self._value(problem, at.x, moved, at.lam)
            if group.searched:
                gap[searched] = np.maximum(gap[searched], self._search(
                    problem, group, at.some(searched), scales))
            total += np.maximum(gap, 0.0)
        return total

    def _value(self, problem: Problem, x: Array, u: Array, lam: Array) -> Array:
        """Return H, infinite where it or a path constraint is undefined."""
        H, c, _, _ = self._few(x, u, lam, problem.p_value)
        return self._where_met(problem, H[:, 0], c, np.inf)

    def _where_met(self, problem: Problem, H: Array, c: Array, slack: float) -> Array:
        """Return H where it is finite and the path constraints are met, else infinity."""
        if not c.shape[1]:
            return np.where(np.isfinite(H), H, np.inf)
        outside = np.maximum(problem.path_lower - c, c - problem.path_upper)
        met = np.all(outside <= slack * np.maximum(1.0, np.abs(c)), axis=1)
        return np.where(np.isfinite(H) & met, H, np.inf)

    def _search(self, problem: Problem, group: _Group, at: Points,
                scales: HamiltonianScales) -> Array:
        """Return H less the smallest value found from a grid, shape (K,)."""
        index = list(group.searched)
        box = _Box(problem.u_lower[index], problem.u_upper[index], scales.u[index], scales.H)
        grid = _grid(at.u[:, index], box)
        K, G = len(at.x), len(grid)
        u = np.repeat(at.u, G, axis=0)
        u[:, index] = np.tile(grid, (K, 1))
        H, c, slopes, curvatures = self._few(np.repeat(at.x, G, axis=0), u,
                                             np.repeat(at.lam, G, axis=0), problem.p_value)
        value = self._where_met(problem, H[:, 0], c, 1e-6 if group.rows else np.inf)
        for k, j in enumerate(self._beside):
            if j not in group.inputs:
                continue
            slope, curvature = slopes[:, k], curvatures[:, k]
            step = _line(slope, curvature, problem.u_lower[j] - u[:, j],
                         problem.u_upper[j] - u[:, j], float(scales.u[j]), scales.H)
            u[:, j] += step
            value += slope*step + 0.5*curvature*step**2
        value = np.where(np.isnan(value), np.inf, value).reshape(K, G)
        best = np.argmin(value, axis=1)
        least = value[np.arange(K), best]
        if group.rows:
            return np.asarray(at.H - least)
        # A point far from u that is nearly as good on the grid may be better beside the grid.
        start = u.reshape(K, G, -1)[np.arange(K), best]
        spacing = (grid.max(axis=0) - grid.min(axis=0)) / (_GRID.get(len(index), 2) - 1)
        far = np.any(np.abs(start - at.u)[:, index] > 1.5*spacing, axis=1)
        rows = np.flatnonzero(far & (least < at.H + 0.05*scales.H))
        if rows.size:
            least[rows] = np.minimum(least[rows], self._polish(
                problem, group, at.some(rows), start[rows], scales))
        return np.asarray(at.H - least)

    def _polish(self, problem: Problem, group: _Group, at: Points, u: Array,
                scales: HamiltonianScales) -> Array:
        """Return the value of H after a few damped Newton steps from `u` within the box."""
        index = list(group.inputs)
        box = _Box(problem.u_lower[index], problem.u_upper[index], scales.u[index], scales.H)
        none = np.zeros(problem.path.numel())
        best = np.full(len(u), np.inf)
        for _ in range(4):
            there = self.points(problem, at.x, u, at.lam, none)
            best = np.fmin(best, there.H)
            step, _ = _descend(np.nan_to_num(there.slope[:, index]),
                               np.nan_to_num(there.curvature[:, index][:, :, index]),
                               u[:, index], box)
            for part in (1.0, 0.2):
                trial = u.copy()
                trial[:, index] += part * np.clip(step, -1e6*box.scale, 1e6*box.scale)
                value = self._value(problem, at.x, trial, at.lam)
                better = value < best
                best, u = np.where(better, value, best), np.where(better[:, None], trial, u)
        return best


@dataclass(frozen=True, eq=False)
class _Box:
    lower: Array
    upper: Array
    scale: Array
    H: float


def _slack(problem: Problem, at: Points, rows: list[int]) -> Array:
    """Return mu' (b - c) of some path constraints, (K,); b are the bounds of the sign of mu."""
    mu, c = at.mu[:, rows], at.c[:, rows]
    room = np.where(mu > 0, problem.path_upper[rows] - c, c - problem.path_lower[rows])
    return np.asarray(np.sum(np.abs(mu) * np.where(mu == 0, 0.0, np.maximum(room, 0.0)), axis=1))


def _line(slope: Array, curvature: Array, lower: Array, upper: Array, scale: float,
          H: float) -> Array:
    """Return the step that minimises slope d + curvature d^2 / 2 for lower <= d <= upper."""
    flat = np.abs(curvature) * scale**2 <= 1e-9 * H
    # Without curvature or bound there is no minimum: a step of one scale is taken.
    edge = np.where(flat, scale, 1e150)
    low = np.where(np.isfinite(lower), lower, -edge)
    high = np.where(np.isfinite(upper), upper, edge)
    with np.errstate(all='ignore'):
        inner = np.clip(-slope / curvature, low, high)
        bent = np.where(flat, 0.0, 0.5*curvature)
        end = np.where((slope + bent*low)*low <= (slope + bent*high)*high, low, high)
    return np.where(flat & (slope == 0), 0.0, np.where(~flat & (curvature > 0), inner, end))


def _descend(slope: Array, Q: Array, u: Array, box: _Box) -> tuple[Array, Array]:
    """
    Return the step d, shape (K, r), that minimises slope'd + d'Q d / 2 in the box; the minimum.

    It is exact for one input, and for two in a finite box. Otherwise it sweeps over one input at a
    time, which converges for Q >= 0; for another Q it starts from the vertices of the box as well.
    """
    K, r = slope.shape
    low, high = box.lower - u, box.upper - u
    if r == 1:
        step = _line(slope[:, 0], Q[:, 0, 0], low[:, 0], high[:, 0], float(box.scale[0]), box.H)
        with np.errstate(over='ignore'):
            return step[:, None], slope[:, 0]*step + 0.5*Q[:, 0, 0]*step**2
    finite = bool(np.all(np.isfinite([box.lower, box.upper])))
    if r == 2 and finite:
        return _of_two(slope, Q, low, high, box)
    starts = [np.zeros((K, r))]
    if r <= _MOST_AXES and finite and np.any(np.linalg.eigvalsh(np.nan_to_num(Q))[:, 0] < 0):
        starts += [np.array(vertex) - u
                   for vertex in itertools.product(*zip(box.lower, box.upper, strict=True))]
    best, least = starts[0], np.zeros(K)
    for d in starts:
        for _ in range(_SWEEPS):
            before = d.copy()
            for j in range(r):
                g = slope[:, j] + np.einsum('ki,ki->k', Q[:, j], d) - Q[:, j, j]*d[:, j]
                d[:, j] = _line(g, Q[:, j, j], low[:, j], high[:, j], float(box.scale[j]), box.H)
            if np.all(np.abs(d - before) <= 1e-12 * box.scale):
                break
        value = np.einsum('kj,kj->k', slope, d) + 0.5*np.einsum('ki,kij,kj->k', d, Q, d)
        better = value < least
        best = np.where(better[:, None], d, best)
        least = np.where(better, value, least)
    return best, least


def _of_two(slope: Array, Q: Array, low: Array, high: Array, box: _Box) -> tuple[Array, Array]:
    """Return what `_descend` does for two inputs in a finite box: inside, or best on an edge."""
    a, b, c = Q[:, 0, 0], Q[:, 1, 1], Q[:, 0, 1]
    with np.errstate(all='ignore'):
        inner = (np.column_stack([c*slope[:, 1] - b*slope[:, 0], c*slope[:, 0] - a*slope[:, 1]])
                 / (a*b - c*c)[:, None])
        inside = (a > 0) & (a*b > c*c) & np.all((inner >= low) & (inner <= high), axis=1)
        sure = inside & (c*c < (1 - 1e-6)*a*b)
    step = np.where(inside[:, None], inner, 0.0)
    rest = np.flatnonzero(~sure)
    if rest.size:
        step[rest] = _on_edges(step[rest], slope[rest], Q[rest], low[rest], high[rest], box)
    value = (slope[:, 0] + 0.5*a*step[:, 0])*step[:, 0] + (
        slope[:, 1] + 0.5*b*step[:, 1] + c*step[:, 0])*step[:, 1]
    return step, np.where(np.isnan(value), 0.0, value)


def _on_edges(first: Array, slope: Array, Q: Array, low: Array, high: Array, box: _Box) -> Array:
    """Return the best of a first step and those to the edges of the box of two inputs."""
    places = [first]
    for i, edge in itertools.product((0, 1), (low, high)):
        j, place = 1 - i, np.empty_like(slope)
        place[:, i] = edge[:, i]
        place[:, j] = _line(slope[:, j] + Q[:, 0, 1]*edge[:, i], Q[:, j, j], low[:, j],
                            high[:, j], float(box.scale[j]), box.H)
        places.append(place)
    steps = np.stack(places)
    values = (np.einsum('skj,kj->sk', steps, slope)
              + 0.5*np.einsum('ski,kij,skj->sk', steps, Q, steps))
    best = np.argmin(np.where(np.isnan(values), np.inf, values), axis=0)
    return np.asarray(steps[best, np.arange(len(Q))])


def _grid(u: Array, box: _Box) -> Array:
    """Return points over the box, or over a window around the path where it is unbounded."""
    r = u.shape[1]
    low = np.where(np.isfinite(box.lower), box.lower, u.min(axis=0) - _WINDOW*box.scale)
    high = np.where(np.isfinite(box.upper), box.upper, u.max(axis=0) + _WINDOW*box.scale)
    axes = [np.linspace(a, b, _GRID.get(r, 2)) for a, b in zip(low, high, strict=True)]
    # Zero is where |u| has its kink.
    axes = [np.insert(axis, np.searchsorted(axis, 0.0), 0.0)
            if r <= 2 and axis[0] < 0 < axis[-1] and 0.0 not in axis else axis
            for axis in axes[:_MOST_AXES]]
    points = np.array(list(itertools.product(*axes)))
    rest = np.broadcast_to(0.5*(low + high)[_MOST_AXES:], (len(points), r - points.shape[1]))
    return np.hstack([points, rest])
