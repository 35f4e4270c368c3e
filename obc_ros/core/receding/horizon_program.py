# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The quadratic program of a horizon about a plan, in the order of its stages.

The unknowns are e_0, v_0, s_0, e_1, ..., e_N, s_N, where s is the excess of the softened limits.
The solvers have no inputs at the end, so that s_N is a state there, which an additional input of
the last stage determines: it comes before e_N.
The rows of stage k are the model and then the softened limits,

    A_k e_k + B_k v_k - e_(k+1) = A_k ebar_k + B_k vbar_k - F(ebar_k, vbar_k),
    C_k e_k + D_k v_k - s_k <= upper - c(ebar_k, vbar_k) + C_k ebar_k + D_k vbar_k,

and likewise from below. The Hessian is that of the Lagrangian at given multipliers; at zero it is
that of the cost (Gauss-Newton).
"""

from dataclasses import dataclass
from functools import cached_property
import math
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.receding.formulation import RecedingProblem

RowPlaces = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class HorizonProgram:
    """The structure of the quadratic program of a problem, and the functions that fill it."""

    problem: RecedingProblem

    @cached_property
    def sizes(self) -> tuple[int, int, int, int, int]:
        """Return N, n, m, the number of soft rows of a stage and of the last one."""
        soft = self.problem.soft
        return (self.problem.horizon, len(self.problem.xe), len(self.problem.ue),
                len(soft.names), len(soft.of_states))

    @cached_property
    def sides(self) -> tuple[RowPlaces, RowPlaces, RowPlaces, RowPlaces]:
        """Return the rows with an upper and a lower limit, of a stage and of the last one."""
        soft = self.problem.soft
        high, low = np.isfinite(soft.upper), np.isfinite(soft.lower)
        last = np.array(soft.of_states, dtype=int)
        return (np.flatnonzero(high), np.flatnonzero(low), np.flatnonzero(high[last]),
                np.flatnonzero(low[last]))

    @cached_property
    def options(self) -> dict[str, Any]:
        """Return the sizes of the stages for a solver that uses them."""
        N, n, m, r, last = self.sizes
        up, down, up_last, down_last = map(len, self.sides)
        return {'N': N, 'nx': [n] * N + [n + last], 'nu': [m + r] * (N - 1) + [m + r + last, 0],
                'ng': [up + down] * N + [up_last + down_last]}

    @cached_property
    def linearize(self) -> ca.Function:
        """
        Return the function that states the program about an iterate, and judges the iterate.

        Inputs: E (n, N+1), V (m, N), shifts (n, N+1), e0 (n, 1); the multipliers in the Hessian,
        of the model lam (n, N) and of the soft rows mu (r, N); the penalties sigma (r, 1); the
        multipliers of the program before, lam_a and lam_x.

        Outputs: the program by the names of CasADi, with its start x0; with the program before and
        the linearization of the iterate the gradient of the Lagrangian, the part of the cost in it
        and the products of the multipliers with the distances from their limits; the gaps of the
        model (n, N); the cost with its penalty.
        """
        N, n, m, r, last = self.sizes
        sparsity, places = self.pattern
        given = {name: ca.MX.sym(name, *shape) for name, shape in (
            ('E', (n, N + 1)), ('V', (m, N)), ('shifts', (n, N + 1)), ('e0', (n, 1)),
            ('lam', (n, N)), ('mu', (r, N)), ('sigma', (r, 1)), ('lam_a', (sparsity.size1(), 1)),
            ('lam_x', (sparsity.size2(), 1)))}
        E, V, S, e0, lam, mu, sigma, lam_a, lam_x = given.values()
        A, B, C, D, low, high, excess, gaps, H, bend, steep = self._stage.map(N)(
            E[:, :N], V, S[:, :N], lam, mu, E[:, 1:])
        slope, low_last, high_last, excess_last, steep_last = self._end(E[:, N], S[:, N])
        pieces = ca.vertcat(*map(ca.vec, (A, B, C, D, slope)), 1.0, -1.0)
        a, none = ca.MX(sparsity, pieces[places.tolist()]), ca.DM.zeros(last, 1)
        z = ca.vertcat(ca.vec(ca.vertcat(E[:, :N], V, excess)), excess_last, E[:, N], excess_last)
        cost = ca.vertcat(ca.vec(steep), none, steep_last, none)
        penalty = self.penalized @ sigma
        lower, upper = self._insert_rows(low, low_last), self._insert_rows(high, high_last)
        lowest, highest = (ca.vertcat(e0, np.where(np.isfinite(each), each, 0.0)[n:])
                           for each in self.box)
        found = {
            'h': ca.MX(self.hessian_pattern, ca.vertcat(
                ca.vec(H), ca.DM(2.0 * self.problem.P).reshape((-1, 1)))),
            'g': penalty - ca.vertcat(ca.vec(bend), ca.DM.zeros(2 * last + n, 1)), 'a': a,
            'lba': lower + ca.DM(np.where(self.one_sided > 0, -np.inf, 0.0)),
            'uba': upper + ca.DM(np.where(self.one_sided < 0, np.inf, 0.0)), 'x0': z,
            'slope': cost + penalty + a.T @ lam_a + lam_x, 'steep': cost,
            'products': ca.vertcat(_multiply_distances(a @ z, lower, upper, lam_a),
                                   _multiply_distances(z, lowest, highest, lam_x)),
            'gaps': gaps, 'value': 0.5 * ca.dot(z, cost) + ca.dot(z, penalty)}
        return ca.Function('linearize', {**given, **found}, list(given), list(found))

    @cached_property
    def _stage(self) -> ca.Function:
        """Return the parts of `linearize` that belong to a stage, which ends at the last input."""
        _, n, m, r, _ = self.sizes
        up, down = (each.tolist() for each in self.sides[:2])
        soft = self.problem.soft
        e, v, shift, after = soft.e, soft.v, soft.shift, ca.SX.sym('after', n)
        lam, mu = ca.SX.sym('lam', n), ca.SX.sym('mu', r)
        F, z, W = self.problem.model(e, v), ca.vertcat(e, v), ca.DM(2.0 * self.hessian)
        (A, B), (C, D) = ([ca.densify(ca.jacobian(f, at)) for at in (e, v)]
                          for f in (F, soft.rows))
        curved = ca.densify(ca.hessian(lam.T @ F + mu.T @ soft.rows, z)[0])
        moved, rest = A @ e + B @ v - F, C @ e + D @ v - soft.rows
        no_up, no_down, no_excess = (ca.SX.zeros(k, 1) for k in (len(up), len(down), r))
        return ca.Function('stage', [e, v, shift, lam, mu, after], [
            A, B, C, D,
            ca.densify(ca.vertcat(moved, no_up, _move(rest, soft.lower, down))),
            ca.densify(ca.vertcat(moved, _move(rest, soft.upper, up), no_down)),
            _exceed(soft.rows, soft.lower, soft.upper), ca.densify(after - F), curved + W,
            ca.densify(ca.vertcat(curved @ z, no_excess)),
            ca.densify(ca.vertcat(W @ z, no_excess))])

    @cached_property
    def _end(self) -> ca.Function:
        """Return the parts of `linearize` that belong to the end of the horizon."""
        up, down = (each.tolist() for each in self.sides[2:])
        e, shift, rows, lower, upper = self._last_rows
        slope = ca.densify(ca.jacobian(rows, e))
        rest = slope @ e - rows
        return ca.Function('end', [e, shift], [
            slope, ca.densify(ca.vertcat(ca.SX.zeros(len(up), 1), _move(rest, lower, down))),
            ca.densify(ca.vertcat(_move(rest, upper, up), ca.SX.zeros(len(down), 1))),
            _exceed(rows, lower, upper), ca.densify(ca.DM(2.0 * self.problem.P) @ e)])

    @property
    def _last_rows(self) -> tuple[ca.SX, ca.SX, ca.SX, Array, Array]:
        """Return e, shift and the soft rows at the end of the horizon with their limits."""
        soft = self.problem.soft
        kept = list(soft.of_states)
        return (soft.e, soft.shift, soft.rows[kept] if kept else ca.SX(0, 1), soft.lower[kept],
                soft.upper[kept])

    def _insert_rows(self, stages: ca.MX, end: ca.MX) -> ca.MX:
        """Return rows (k, N) and those at the end, with the rows of the additional inputs."""
        N, n, _, _, last = self.sizes
        rows, place = ca.vec(stages), (N - 1) * stages.size1() + n
        # A slice without rows of a 1 x 1 matrix would be 1 x 0.
        before, after = ca.vertsplit(rows, [0, place, rows.numel()])
        return ca.vertcat(before, ca.DM.zeros(last, 1), after, end)

    @cached_property
    def multiplier_rows(self) -> tuple[RowPlaces, RowPlaces, RowPlaces]:
        """Return the rows of the model (N, n), and the rows (N, k) of the soft rows listed."""
        N, n, _, _, last = self.sizes
        up, down = self.sides[:2]
        width = n + len(up) + len(down)
        starts = np.arange(N)[:, None] * width
        soft = starts + n + np.arange(len(up) + len(down))
        soft[-1] += last
        return starts + np.arange(n), soft, np.concatenate([up, down])

    @cached_property
    def follow(self) -> ca.Function:
        """
        Return the function that applies inputs to the model.

        Inputs: e0 (n, 1), V (m, N), E (n, N+1), shifts (n, N+1). Outputs: the motion
        moved (n, N+1), the inputs applied (m, N), which are v_k - K (e_k - E_k) within the bounds,
        the cost, and the excesses of the soft rows (r, N) and at the end.
        """
        N, n, m, _, _ = self.sizes
        soft = self.problem.soft
        e, v, ref, S = soft.e, ca.SX.sym('v', m), ca.SX.sym('ref', n), ca.MX.sym('S', n, N + 1)
        lower, upper = self.problem.input_box
        applied = ca.fmin(ca.fmax(v - ca.DM(self.problem.K) @ (e - ref), ca.DM(lower)),
                          ca.DM(upper))
        z = ca.vertcat(e, applied)
        excess = ca.substitute(_exceed(soft.rows, soft.lower, soft.upper), soft.v, applied)
        step = ca.Function('step', [e, v, ref, soft.shift], [
            self.problem.model(e, applied), applied, z.T @ ca.DM(self.hessian) @ z, excess])
        _, _, rows, low, high = self._last_rows
        end = ca.Function('end', [e, soft.shift], [
            e.T @ ca.DM(self.problem.P) @ e, _exceed(rows, low, high)])
        e0, V, E = ca.MX.sym('e0', n), ca.MX.sym('V', m, N), ca.MX.sym('E', n, N + 1)
        moved, inputs, costs, excesses = step.mapaccum(N)(e0, V, E[:, :N], S[:, :N])
        last = end(moved[:, N - 1], S[:, N])
        given = {'e0': e0, 'V': V, 'E': E, 'shifts': S}
        found = {'moved': ca.horzcat(e0, moved), 'applied': inputs,
                 'cost': ca.sum2(costs) + last[0], 'excess': excesses, 'excess_last': last[1]}
        return ca.Function('follow', {**given, **found}, list(given), list(found))

    @cached_property
    def penalized(self) -> ca.DM:
        """Return the matrix that gives the unknowns their penalties, from those of the rows."""
        N, n, m, r, last = self.sizes
        stage = ca.vertcat(ca.DM(n + m, r), ca.DM.eye(r))
        end = [ca.DM.eye(r)[i, :] for i in self.problem.soft.of_states]
        return ca.vertcat(ca.repmat(stage, N, 1), ca.DM(last + n, r), *end)

    @cached_property
    def box(self) -> tuple[Array, Array]:
        """Return the bounds of the unknowns; those of e_0 are to be set."""
        N, n, m, r, last = self.sizes
        ends = (-np.inf, 0.0), (np.inf, np.inf)   # of an error, and of an excess
        return tuple(np.concatenate([
            np.tile(np.concatenate([np.full(n, free), bound, np.full(r, excess)]), N),
            np.full(last + n, free), np.full(last, excess)])
            for bound, (free, excess) in zip(
                self.problem.input_box, ends, strict=True))  # type: ignore[return-value]

    @cached_property
    def one_sided(self) -> Array:
        """Return 1 for each row with an upper limit alone, -1 with a lower one, 0 with both."""
        N, n, _, _, last = self.sizes
        up, down, up_last, down_last = map(len, self.sides)
        stage = np.concatenate([np.zeros(n), np.ones(up), -np.ones(down)])
        return np.concatenate([np.insert(np.tile(stage, N), (N - 1) * len(stage) + n,
                                         np.zeros(last)),
                               np.ones(up_last), -np.ones(down_last)])

    @cached_property
    def hessian(self) -> Array:
        """Return the blocks of the Hessian: of (e, v), shape (n + m, n + m)."""
        weights = self.problem.weights
        cross = np.zeros_like(self.problem.design.plant.B) if weights.cross is None \
            else weights.cross
        return np.block([[weights.Qx, cross], [cross.T, weights.Qu]])

    @cached_property
    def hessian_pattern(self) -> ca.Sparsity:
        """Return the sparsity of the Hessian of the program."""
        N, n, m, r, last = self.sizes
        block = ca.diagcat(ca.Sparsity.dense(n + m, n + m), ca.Sparsity(r, r))
        return ca.diagcat(*[block] * N, ca.Sparsity(last, last), ca.Sparsity.dense(n, n),
                          ca.Sparsity(last, last))

    @cached_property
    def pattern(self) -> tuple[ca.Sparsity, RowPlaces]:
        """
        Return the sparsity of the rows, and where each nonzero is in the pieces.

        The pieces are A, B, C, D (column-major, stage after stage), C at the end, 1, -1.
        """
        N, n, m, r, last = self.sizes
        up, down, up_last, down_last = self.sides
        sizes = np.array([n * n, n * m, r * n, r * m]) * N
        starts = np.concatenate([[0], np.cumsum(sizes)])
        one = int(starts[4]) + last * n
        rows: list[RowPlaces] = []
        columns: list[RowPlaces] = []
        values: list[RowPlaces] = []

        def put(row: int, column: int, block: RowPlaces) -> None:
            i, j = np.indices(block.shape)
            rows.append(i.ravel() + row)
            columns.append(j.ravel() + column)
            values.append(block.ravel())

        def piece(kind: int, k: int, height: int, width: int) -> RowPlaces:
            first = starts[kind] + k * height * width
            return np.arange(first, first + height * width).reshape(width, height).T

        def diagonal(row: int, chosen: RowPlaces, column: int, value: int) -> None:
            for i, which in enumerate(chosen):
                put(row + i, column + int(which), np.array([[value]]))

        row = column = 0
        for k in range(N):
            put(row, column, piece(0, k, n, n))
            put(row, column + n, piece(1, k, n, m))
            after = column + n + m + r + (last if k == N - 1 else 0)
            diagonal(row, np.arange(n), after, one + 1)
            row += n
            if k == N - 1:
                diagonal(row, np.arange(last), column + n + m + r, one)
                for i in range(last):
                    put(row + i, after + n + i, np.array([[one + 1]]))
                row += last
            C, D = piece(2, k, r, n), piece(3, k, r, m)
            for chosen, sign in ((up, one + 1), (down, one)):
                if len(chosen):
                    put(row, column, C[chosen])
                    put(row, column + n, D[chosen])
                    diagonal(row, chosen, column + n + m, sign)
                    row += len(chosen)
            column = after
        C = piece(4, 0, last, n)
        for chosen, sign in ((up_last, one + 1), (down_last, one)):
            if len(chosen):
                put(row, column, C[chosen])
                diagonal(row, chosen, column + n, sign)
                row += len(chosen)
        lines, places, entries = (np.concatenate(each) for each in (rows, columns, values))
        order = np.lexsort((lines, places))
        sparsity = ca.Sparsity.triplet(row, column + n + last, lines[order].tolist(),
                                       places[order].tolist())
        return sparsity, entries[order]


def _exceed(rows: ca.SX, lower: Array, upper: Array) -> ca.SX:
    """Return by how much rows (k, 1) are outside of their limits; NaN if they are not numbers."""
    found = ca.SX.zeros(len(lower), 1)
    for i, (low, high) in enumerate(zip(lower.tolist(), upper.tolist(), strict=True)):
        for side in ([low - rows[i]] if math.isfinite(low) else []) + (
                [rows[i] - high] if math.isfinite(high) else []):
            found[i] += 0.5 * (side + ca.fabs(side))   # fmax would hide a NaN
    return found


def _move(rows: ca.SX, limits: Array, chosen: list[int]) -> ca.SX:
    """Return chosen rows with their limits added, (k, 1)."""
    return ca.vertcat(ca.SX(0, 1), *(rows[i] + limits[i] for i in chosen))


def _multiply_distances(values: ca.MX, lower: ca.MX, upper: ca.MX, lam: ca.MX) -> ca.MX:
    """Return the products of multipliers with the distances from the limits they belong to."""
    return 0.5 * ((lam + ca.fabs(lam)) * (upper - values)
                  + (ca.fabs(lam) - lam) * (values - lower))
