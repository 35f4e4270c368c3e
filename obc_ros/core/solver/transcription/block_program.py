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

_Places = tuple[Index, Index]   # rows and columns of the entries of a matrix


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
    def places(self) -> tuple[_Places, _Places, _Places]:
        """Return where the gradient of the cost, the Jacobian of g and the Hessian are not 0."""
        _, _, slope, J, H, _ = self._symbols
        return _places(slope), _places(J), _places(H)

    @cached_property
    def functions(self) -> tuple[ca.Function, ...]:
        """
        Return the functions to g and the cost, its gradient, the Jacobian and the Hessian.

        The last one, of factor cost + lam' g, is a function of factor and lam, too.
        """
        factor, lam, slope, J, H, _ = self._symbols
        given = self._arguments
        return (ca.Function('rows', given, [self._g, self._cost]),
                ca.Function('slope', given, [slope]), ca.Function('jacobian_g', given, [J]),
                ca.Function('curvature', [*given, factor, lam], [H]))

    @cached_property
    def values(self) -> VectorizedFunction:
        """Return the function from many v, own and shared at once to g and the cost."""
        return VectorizedFunction(self._arguments, [self._g, self._cost], 8)

    @cached_property
    def batch(self) -> VectorizedFunction:
        """
        Return the same with derivatives, from v, own, shared, factor and lam.

        To g, the cost, its gradient, the gradient of factor cost + lam' g, and the entries of the
        Jacobian and of the Hessian.
        """
        factor, lam, slope, J, H, both = self._symbols
        return VectorizedFunction(
            [*self._arguments, factor, lam],
            [self._g, self._cost, slope.nz[:], both, J.nz[:], H.nz[:]], 8)


def _places(value: ca.SX) -> _Places:
    rows, columns = value.sparsity().get_triplet()
    return np.array(rows, dtype=np.int64), np.array(columns, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Block:
    """
    K copies of a piece.

    :ivar index: (K, nv), place of each local variable in [w; c], the unknowns and then the
        constants.
    :ivar own_index: (K, length of own), places of the constants of each copy in c.
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


def _sum_up(shape: tuple[int, int], parts: Sequence[tuple[Index, Index, ca.MX]]) -> ca.MX:
    """Return the sparse matrix of the sums of entries at the same rows and columns, if >= 0."""
    if not parts:
        return ca.MX(*shape)
    i, j, values = zip(*parts, strict=True)
    rows, columns = (np.concatenate([each.ravel() for each in part]) for part in (i, j))
    kept = np.flatnonzero((rows >= 0) & (columns >= 0))
    places, inverse = np.unique(columns[kept] * shape[0] + rows[kept], return_inverse=True)
    sparsity = ca.Sparsity.triplet(
        *shape, (places % shape[0]).tolist(), (places // shape[0]).tolist())
    entries = ca.vertcat(*values)
    if len(places) == len(kept):
        return ca.MX(sparsity, entries[kept[np.argsort(inverse)].tolist()])
    gather = ca.Sparsity.triplet(len(places), len(rows), inverse.tolist(), kept.tolist())
    return ca.MX(sparsity, ca.densify(ca.mtimes(ca.DM.ones(gather), entries)))


def assemble(blocks: Sequence[Block], unknowns: int, shared: int, constants: int) -> BlockProgram:
    """
    Assemble the program of all blocks.

    :param blocks: in the order of their rows.
    :param shared, constants: number of constants shared by all copies, which come first in c, and
        length of c.
    """
    w, c = ca.MX.sym('w', unknowns), ca.MX.sym('c', constants)
    both = ca.vertcat(w, c)
    multiplier = ca.MX.sym('lam_f')
    lengths = tuple(block.piece.r * len(block.index) for block in blocks)
    lam = ca.MX.sym('lam_g', sum(lengths))
    cost, rows = ca.MX(0), list[ca.MX]()
    gradient, jacobian, hessian = (list[tuple[Index, Index, ca.MX]]() for _ in range(3))
    first = 0
    for block, length in zip(blocks, lengths, strict=True):
        piece, copies = block.piece, len(block.index)
        values, slope, J, H = (function.map(copies) for function in piece.functions)
        (at_slope, _), (i, j), (a, b) = piece.places
        where = np.where(block.index < unknowns, block.index, -1)
        args = [ca.reshape(both[block.index.ravel().tolist()], -1, copies),
                ca.reshape(c[block.own_index.ravel().tolist()], -1, copies),
                ca.repmat(c[:shared], 1, copies)]
        g, part = values(*args)
        cost, rows = cost + ca.sum2(part), [*rows, ca.vec(g)]
        gradient.append((where[:, at_slope], np.zeros((copies, len(at_slope)), dtype=np.int64),
                         ca.vec(slope(*args).nz[:])))
        at = first + piece.r * np.arange(copies, dtype=np.int64)[:, None] + i
        jacobian.append((at, where[:, j], ca.vec(J(*args).nz[:])))
        if len(a):
            args += [ca.repmat(multiplier, 1, copies),
                     ca.reshape(lam[first:first + length], piece.r, copies)]
            upper = where[:, a] <= where[:, b]
            hessian.append((np.where(upper, where[:, a], -1), where[:, b], ca.vec(H(*args).nz[:])))
        first += length
    g = ca.vertcat(*rows)
    return BlockProgram(
        {'x': w, 'p': c, 'f': cost, 'g': g},
        {'grad_f': ca.Function('grad_f', [w, c], [
            cost, ca.densify(_sum_up((unknowns, 1), gradient))], ['x', 'p'], ['f', 'grad_f_x']),
         'jac_g': ca.Function('jac_g', [w, c], [
             g, _sum_up((sum(lengths), unknowns), jacobian)], ['x', 'p'], ['g', 'jac_g_x']),
         'hess_lag': ca.Function('hess_lag', [w, c, multiplier, lam], [
             _sum_up((unknowns, unknowns), hessian)], ['x', 'p', 'lam_f', 'lam_g'],
             ['triu_hess_gamma_x_x'])},
        lengths)
