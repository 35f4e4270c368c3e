# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A nonlinear program made of many copies of a few small functions.

Minimise the sum of the costs of the blocks subject to the rows of the blocks within bounds.
Derivatives are taken once, of the small functions, and scattered into sparse matrices by index:
building the program costs the same for 10 copies as for 1000.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.int64]
# A function, and the rows and columns of the entries of its result.
Derivative = tuple[ca.Function, Index, Index]


class Piece:
    """
    Rows g and a cost, functions of local variables v and constants, with their derivatives.

    Parameters
    ----------
    v, own, shared : casadi.SX
        Local variables (nv,), constants of one copy, constants of all copies.
    g, cost : casadi.SX
        Rows (r,) and cost (1,).

    """

    def __init__(self, v: ca.SX, own: ca.SX, shared: ca.SX, g: ca.SX, cost: ca.SX) -> None:
        arguments = [v, own, shared]
        self.r = int(g.numel())
        self.values = ca.Function('rows', arguments, [g, cost])
        self.slope = self._sparse('slope', arguments, ca.gradient(cost, v))
        self.jacobian = self._sparse('jacobian_g', arguments, ca.jacobian(g, v))
        factor, lam = ca.SX.sym('factor'), ca.SX.sym('lam', self.r)
        self.curvature = self._sparse('curvature', [*arguments, factor, lam],
                                      ca.hessian(factor * cost + ca.dot(lam, g), v)[0])

    @staticmethod
    def _sparse(name: str, arguments: list[ca.SX], value: ca.SX) -> Derivative:
        value = ca.sparsify(value)
        rows, columns = value.sparsity().get_triplet()
        return (ca.Function(name, arguments, [value]), np.array(rows, dtype=np.int64),
                np.array(columns, dtype=np.int64))


@dataclass(frozen=True, eq=False)
class Block:
    """
    K copies of a piece.

    Attributes
    ----------
    piece : Piece
    index : ndarray, shape (K, nv)
        Where each local variable stands in [w; c]: the unknowns first, then the constants.
    own_index : ndarray, shape (K, number of own)
        Where the constants of each copy stand in c.

    """

    piece: Piece
    index: Index
    own_index: Index


@dataclass(frozen=True, eq=False)
class Program:
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
    """Return the entries of the results of a function for all columns of its arguments."""
    function, _, _ = derivative
    return ca.vec(function.map(arguments[0].size2())(*arguments).nz[:])


def assemble(blocks: Sequence[Block], unknowns: int, shared: int, constants: int) -> Program:
    """
    Return the program of all blocks.

    Parameters
    ----------
    blocks : sequence of Block
        In the order of their rows.
    unknowns : int
        Length of w.
    shared, constants : int
        Length of the constants shared by all copies, which come first in c, and of c.

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
    return Program(
        {'x': w, 'p': c, 'f': cost, 'g': g},
        {'grad_f': ca.Function('grad_f', [w, c], [cost, ca.densify(gradient.matrix())],
                               ['x', 'p'], ['f', 'grad_f_x']),
         'jac_g': ca.Function('jac_g', [w, c], [g, jacobian.matrix()],
                              ['x', 'p'], ['g', 'jac_g_x']),
         'hess_lag': ca.Function('hess_lag', [w, c, multiplier, lam], [hessian.matrix()],
                                 ['x', 'p', 'lam_f', 'lam_g'], ['triu_hess_gamma_x_x'])},
        lengths)
