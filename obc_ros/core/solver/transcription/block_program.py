# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A nonlinear program composed of many copies of a few small functions.

Minimise the sum of the costs of the blocks subject to bounds of the rows of the blocks. Only the
small functions are differentiated. Their derivatives are scattered into sparse matrices by index,
so that the time to build the program hardly depends on the number of copies.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Index
from obc_ros.core.numerics.vectorized import VectorizedFunction

# A function, and the rows and columns of the entries of its result.
Derivative = tuple[ca.Function, Index, Index]


class Piece:
    """
    Rows g and a cost, functions of local variables v and constants, with their derivatives.

    :param v, own, shared: local variables (nv,), constants of one copy, constants of all copies.
    :param g, cost: rows (r,) and cost (1,).
    """

    def __init__(self, v: ca.SX, own: ca.SX, shared: ca.SX, g: ca.SX, cost: ca.SX) -> None:
        self._arguments, self._g, self._cost = [v, own, shared], g, cost
        self.r = int(g.numel())

    @cached_property
    def _symbols(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
        """Return factor, lam, slope, J, H, and the gradient of factor cost + lam' g."""
        v, factor, lam = self._arguments[0], ca.SX.sym('factor'), ca.SX.sym('lam', self.r)
        H, both = ca.hessian(factor * self._cost + ca.dot(lam, self._g), v)
        # Row by row: there are fewer rows than columns.
        J = ca.jacobian(self._g, v, {'helper_options': {'ad_weight': 1.0}})
        return (factor, lam, ca.sparsify(ca.gradient(self._cost, v)), ca.sparsify(J),
                ca.sparsify(H), both)

    @cached_property
    def values(self) -> ca.Function:
        """Return the function to g and the cost."""
        return ca.Function('rows', self._arguments, [self._g, self._cost])

    @cached_property
    def slope(self) -> Derivative:
        """Return the gradient of the cost."""
        return self._sparse('slope', self._arguments, self._symbols[2])

    @cached_property
    def jacobian(self) -> Derivative:
        """Return the derivative of g."""
        return self._sparse('jacobian_g', self._arguments, self._symbols[3])

    @cached_property
    def curvature(self) -> Derivative:
        """Return the second derivative of factor cost + lam' g."""
        factor, lam, _, _, H, _ = self._symbols
        return self._sparse('curvature', [*self._arguments, factor, lam], H)

    @cached_property
    def whole(self) -> 'Whole':
        """Return values and derivatives as one function of numpy arrays."""
        values = VectorizedFunction(self._arguments, [self._g, self._cost], 8)
        factor, lam, slope, J, H, both = self._symbols
        return Whole(self.r, np.array(slope.row(), dtype=np.int64), _places(J), _places(H),
                     VectorizedFunction([*self._arguments, factor, lam],
                                        [self._g, self._cost, slope.nz[:], both, J.nz[:], H.nz[:]],
                                        8), values)

    @staticmethod
    def _sparse(name: str, arguments: list[ca.SX], value: ca.SX) -> Derivative:
        return (ca.Function(name, arguments, [value]), *_places(value))


def _places(value: ca.SX) -> tuple[Index, Index]:
    rows, columns = value.sparsity().get_triplet()
    return np.array(rows, dtype=np.int64), np.array(columns, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Whole:
    """
    A piece and its derivatives for many rows of local variables at once.

    :ivar r: number of rows of g.
    :ivar slope, jacobian, curvature: rows, or rows and columns, of the entries of the derivatives.
    :ivar batch: from v, own, shared, factor and lam to g, the cost, its gradient, the gradient of
        factor cost + lam' g, and the entries of the Jacobian of g and of the Hessian.
    :ivar values: from v, own and shared to g and the cost.
    """

    r: int
    slope: Index
    jacobian: tuple[Index, Index]
    curvature: tuple[Index, Index]
    batch: VectorizedFunction
    values: VectorizedFunction


@dataclass(frozen=True, eq=False)
class Block:
    """
    K copies of a piece.

    :ivar index: (K, nv), place of each local variable in [w; c], the unknowns and then the
        constants.
    :ivar own_index: (K, number of own), places of the constants of each copy in c.
    """

    piece: Piece
    index: Index
    own_index: Index


@dataclass(frozen=True, eq=False)
class BlockProgram:
    """A nonlinear program in unknowns w and constants c, with its exact derivatives."""

    nlp: dict[str, ca.MX]
    derivatives: dict[str, ca.Function]
    rows: tuple[int, ...]


class _Sum:
    """A sparse matrix whose entries are sums of entries of block matrices."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self._shape = shape
        self._rows: list[Index] = []
        self._columns: list[Index] = []
        self._parts: list[ca.MX] = []

    def add(self, rows: Index, columns: Index, entries: ca.MX) -> None:
        self._rows.append(rows.ravel())
        self._columns.append(columns.ravel())
        self._parts.append(entries)

    def matrix(self) -> ca.MX:
        if not self._parts:
            return ca.MX(*self._shape)
        rows, columns = np.concatenate(self._rows), np.concatenate(self._columns)
        kept = np.flatnonzero((rows >= 0) & (columns >= 0))
        key = columns[kept] * self._shape[0] + rows[kept]
        places, inverse = np.unique(key, return_inverse=True)
        sparsity = ca.Sparsity.triplet(
            *self._shape, (places % self._shape[0]).tolist(), (places // self._shape[0]).tolist())
        entries = ca.vertcat(*self._parts)
        if len(places) == len(kept):
            return ca.MX(sparsity, entries[kept[np.argsort(inverse)].tolist()])
        gather = ca.Sparsity.triplet(len(places), len(rows), inverse.tolist(), kept.tolist())
        return ca.MX(sparsity, ca.densify(ca.mtimes(ca.DM.ones(gather), entries)))


def _mapped(derivative: Derivative, arguments: Sequence[ca.MX]) -> ca.MX:
    """Return the entries of a derivative for all columns of its arguments."""
    function, _, _ = derivative
    return ca.vec(function.map(arguments[0].size2())(*arguments).nz[:])


def assemble(blocks: Sequence[Block], unknowns: int, shared: int, constants: int) -> BlockProgram:
    """
    Assemble the program of all blocks.

    :param blocks: in the order of their rows.
    :param unknowns: length of w.
    :param shared, constants: number of constants shared by all copies, which come first in c, and
        length of c.
    """
    w, c = ca.MX.sym('w', unknowns), ca.MX.sym('c', constants)
    both = ca.vertcat(w, c)
    multiplier = ca.MX.sym('lam_f')
    lengths = tuple(block.piece.r * len(block.index) for block in blocks)
    lam = ca.MX.sym('lam_g', sum(lengths))
    cost = ca.MX(0)
    rows: list[ca.MX] = []
    gradient = _Sum((unknowns, 1))
    jacobian = _Sum((sum(lengths), unknowns))
    hessian = _Sum((unknowns, unknowns))
    first = 0
    for block, length in zip(blocks, lengths, strict=True):
        copies, r = len(block.index), block.piece.r
        where = np.where(block.index < unknowns, block.index, -1)
        args = [ca.reshape(both[block.index.ravel().tolist()], -1, copies),
                ca.reshape(c[block.own_index.ravel().tolist()], -1, copies),
                ca.repmat(c[:shared], 1, copies)]
        g, part = block.piece.values.map(copies)(*args)
        cost, rows = cost + ca.sum2(part), [*rows, ca.vec(g)]
        _, i, _ = block.piece.slope
        gradient.add(where[:, i], np.zeros((copies, len(i)), dtype=np.int64),
                     _mapped(block.piece.slope, args))
        _, i, j = block.piece.jacobian
        at = first + r * np.arange(copies, dtype=np.int64)[:, None] + i
        jacobian.add(at, where[:, j], _mapped(block.piece.jacobian, args))
        _, i, j = block.piece.curvature
        if len(i):
            args += [ca.repmat(multiplier, 1, copies),
                     ca.reshape(lam[first:first + length], r, copies)]
            upper = where[:, i] <= where[:, j]
            hessian.add(np.where(upper, where[:, i], -1), where[:, j],
                        _mapped(block.piece.curvature, args))
        first += length
    g = ca.vertcat(*rows)
    return BlockProgram(
        {'x': w, 'p': c, 'f': cost, 'g': g},
        {'grad_f': ca.Function('grad_f', [w, c], [cost, ca.densify(gradient.matrix())],
                               ['x', 'p'], ['f', 'grad_f_x']),
         'jac_g': ca.Function('jac_g', [w, c], [g, jacobian.matrix()],
                              ['x', 'p'], ['g', 'jac_g_x']),
         'hess_lag': ca.Function('hess_lag', [w, c, multiplier, lam], [hessian.matrix()],
                                 ['x', 'p', 'lam_f', 'lam_g'], ['triu_hess_gamma_x_x'])},
        lengths)
