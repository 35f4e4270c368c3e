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
        Return the function (E, V, shifts, lam, mu) to matrix, numbers, Hessian of the Lagrangian.

        E (n, N+1), V (m, N), shifts (n, N+1), multipliers of the model lam (n, N) and of the soft
        rows mu (r, N). The numbers are, column-major: the right sides of
        the model (n, N) and of the soft rows (r, N), the values of these (r, N), both at the end,
        and the gaps of the model (n, N).
        """
        N, n, m, _, _ = self.sizes
        soft = self.problem.soft
        e, v, shift = soft.e, soft.v, soft.shift
        F = self.problem.model(e, v)
        (A, B), (C, D) = ([ca.densify(ca.jacobian(f, at)) for at in (e, v)]
                          for f in (F, soft.rows))
        lam, mu = ca.SX.sym('lam', n), ca.SX.sym('mu', len(soft.names))
        z = ca.vertcat(e, v)
        curved = ca.densify(ca.hessian(lam.T @ F + mu.T @ soft.rows, z)[0])
        stage = ca.Function('stage', [e, v, shift, lam, mu], [
            A, B, C, D, A @ e + B @ v - F, C @ e + D @ v - soft.rows, soft.rows, F,
            curved + ca.DM(2.0 * self.hessian)])
        rows = soft.rows[list(soft.of_states)] if soft.of_states else ca.SX(0, 1)
        slope = ca.densify(ca.jacobian(rows, e))
        end = ca.Function('end', [e, shift], [slope, slope @ e - rows, rows])
        E, V, S = ca.MX.sym('E', n, N + 1), ca.MX.sym('V', m, N), ca.MX.sym('S', n, N + 1)
        L, M = ca.MX.sym('L', n, N), ca.MX.sym('M', len(soft.names), N)
        found = stage.map(N)(E[:, :N], V, S[:, :N], L, M)
        last = end(E[:, N], S[:, N])
        sparsity, places = self.pattern
        flat = ca.vertcat(*(ca.vec(each) for each in (*found[:4], last[0])), 1.0, -1.0)
        numbers = ca.vertcat(*(ca.vec(each) for each in (
            *found[4:7], last[1], last[2], E[:, 1:] - found[7])))
        H = ca.vertcat(ca.vec(found[8]), ca.DM(2.0 * self.problem.P).reshape((-1, 1)))
        return ca.Function('linearize', [E, V, S, L, M], [
            ca.MX(sparsity, flat[places.tolist()]), numbers,
            ca.MX(self.full_hessian.sparsity(), H)])

    @cached_property
    def multiply(self) -> ca.Function:
        """Return the function (A, z, lam, H) to W z, A' lam, H z and A z; W: of the cost."""
        A = ca.MX.sym('A', self.pattern[0])
        z, lam = ca.MX.sym('z', A.size2()), ca.MX.sym('lam', A.size1())
        H = ca.MX.sym('H', self.full_hessian.sparsity())
        return ca.Function('multiply', [A, z, lam, H], [ca.vertcat(
            ca.MX(self.full_hessian) @ z, A.T @ lam, H @ z, A @ z)])

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

    def split(self, numbers: Array) -> list[Array]:
        """Return the parts of the numbers of `linearize`: (N, n), (N, r), (N, r), ..., (N, n)."""
        N, n, _, r, last = self.sizes
        shapes = (N, n), (N, r), (N, r), (last,), (last,), (N, n)
        ends = np.cumsum([math.prod(shape) for shape in shapes])
        return [part.reshape(shape) for part, shape in zip(
            np.split(numbers, ends[:-1]), shapes, strict=True)]

    @cached_property
    def rollout(self) -> ca.Function:
        """
        Return the function (e0, V, E) to the motion (n, N + 1) and the inputs (m, N) applied.

        They are v_k - K (e_k - E_k), within the bounds.
        """
        N, n, m, _, _ = self.sizes
        lower, upper = self.problem.input_box
        e, v, ref = ca.SX.sym('e', n), ca.SX.sym('v', m), ca.SX.sym('ref', n)
        applied = ca.fmin(ca.fmax(v - ca.DM(self.problem.K) @ (e - ref), ca.DM(lower)),
                          ca.DM(upper))
        step = ca.Function('step', [e, v, ref], [self.problem.model(e, applied), applied])
        e0, V, E = ca.MX.sym('e0', n), ca.MX.sym('V', m, N), ca.MX.sym('E', n, N)
        moved, inputs = step.mapaccum(N)(e0, V, E)
        return ca.Function('rollout', [e0, V, E], [ca.horzcat(e0, moved), inputs])

    @cached_property
    def hessian(self) -> Array:
        """Return the blocks of the Hessian: of (e, v), shape (n + m, n + m)."""
        weights = self.problem.weights
        cross = np.zeros_like(self.problem.design.plant.B) if weights.cross is None \
            else weights.cross
        return np.block([[weights.Qx, cross], [cross.T, weights.Qu]])

    @cached_property
    def full_hessian(self) -> ca.DM:
        """Return the Hessian of the program."""
        N, n, m, r, last = self.sizes
        block = ca.diagcat(ca.densify(ca.DM(2.0 * self.hessian)), ca.DM(r, r))
        return ca.diagcat(*[block] * N, ca.DM(last, last),
                          ca.densify(ca.DM(2.0 * self.problem.P)), ca.DM(last, last))

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
