# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""CasADi functions of scalars, instruction by instruction: other arithmetics, and structure."""

from collections.abc import Callable, Sequence
import math
from typing import TypeVar

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask

Number = TypeVar('Number')

_NOTHING = 1e-300   # added to a sum of squares: changes no result that is not 0


class Instructions:
    """The instructions of a function of SX."""

    def __init__(self, function: ca.Function) -> None:
        self._lengths = [function.nnz_out(i) for i in range(function.n_out())]
        self._steps = [(k, function.instruction_id(k), function.instruction_input(k),
                        function.instruction_output(k)) for k in range(function.n_instructions())]
        self._constants = {k: float(function.instruction_constant(k))
                           for k, operation, *_ in self._steps if operation == ca.OP_CONST}

    def evaluate(self, read: Callable[[int, int], Number], constant: Callable[[float], Number],
                 apply: Callable[[int, list[Number]], Number]) -> list[list[Number]]:
        """
        Evaluate the function in another arithmetic.

        :param read: returns the value of entry k of input i; called as read(i, k), where it is
            used.
        :param apply: returns the result of an operation of CasADi; called as apply(operation,
            operands).
        :return: the nonzero entries of each output.
        """
        work: dict[int, Number] = {}
        results: list[dict[int, Number]] = [{} for _ in self._lengths]
        for k, operation, inputs, outputs in self._steps:
            if operation == ca.OP_INPUT:
                work[outputs[0]] = read(inputs[0], inputs[1])
            elif operation == ca.OP_CONST:
                work[outputs[0]] = constant(self._constants[k])
            elif operation == ca.OP_OUTPUT:
                results[outputs[0]][outputs[1]] = work[inputs[0]]
            else:
                work[outputs[0]] = apply(operation, [work[index] for index in inputs])
        return [[found[k] for k in range(length)]
                for found, length in zip(results, self._lengths, strict=True)]

    def have(self, *operations: int) -> bool:
        """Return whether one of some operations occurs."""
        return any(operation in operations for _, operation, *_ in self._steps)


def apply_to_expressions(operation: int, operands: list[ca.SX]) -> ca.SX:
    """Return the result of an operation of CasADi on expressions."""
    return (ca.SX.binary if len(operands) == 2 else ca.SX.unary)(operation, *operands)


def find_dependence(expressions: ca.SX, symbols: ca.SX) -> Mask:
    """Return which of k symbols appear in which of r expressions, (r, k)."""
    found: Mask = np.zeros((expressions.numel(), symbols.numel()), dtype=bool)
    found[ca.jacobian_sparsity(expressions, symbols).get_triplet()] = True
    return found


def has_jumps(expressions: ca.SX, symbols: ca.SX) -> bool:
    """Return whether a step may occur, or a sign: CasADi takes its derivative as 0."""
    return Instructions(ca.Function('expressions', [symbols], [ca.densify(expressions)], {
        'allow_free': True})).have(ca.OP_LT, ca.OP_LE, ca.OP_SIGN)


def separate_numbers(expressions: ca.SX, arguments: Sequence[ca.SX]
                     ) -> tuple[ca.SX, ca.SX, Array]:
    """
    Return expressions with symbols in place of their numbers.

    While it differentiates, CasADi combines numbers in double precision, but no symbols. Powers of
    2 and 0 remain, since their products are exact.

    :return: the expressions (r,), the symbols (k,) and their numbers (k,).
    """
    symbols: dict[float, ca.SX] = {}

    def name(value: float) -> ca.SX:
        if value == 0.0 or math.frexp(abs(value))[0] == 0.5:
            return ca.SX(value)
        return symbols.setdefault(value, ca.SX.sym(f'number_{len(symbols)}'))

    function = ca.Function('expressions', list(arguments), [ca.densify(expressions)])
    found = Instructions(function).evaluate(
        lambda i, k: arguments[i][k], name, apply_to_expressions)[0]
    return ca.vertcat(*found), ca.vertcat(ca.SX(0, 1), *symbols.values()), np.array([*symbols])


def make_norms_differentiable(expressions: Sequence[ca.SX], arguments: Sequence[ca.SX],
                              but: ca.SX) -> list[ca.SX]:
    """
    Return expressions in which square roots of sums of squares have derivatives at 0.

    CasADi's derivative of sqrt(a^2 + b^2) at a = b = 0 is 0/0. Here it is 0, as that of |a|: the
    derivative of sqrt(a^2 + b^2) a, and one of Clarke's generalized gradients of the root. A
    root of anything else, as sqrt(a), remains.

    :param but: symbols whose roots remain as they are.
    :return: the same objects if no such root occurs.
    """
    found = Instructions(ca.Function('expressions', list(arguments), [
        ca.densify(each) for each in expressions]))
    if not found.have(ca.OP_SQRT):
        return list(expressions)
    roots = 0

    def apply(operation: int, operands: list[ca.SX]) -> ca.SX:
        nonlocal roots
        if operation == ca.OP_SQRT and _is_sum_of_squares(operands[0]) and not ca.depends_on(
                operands[0], but):
            roots += 1
            return ca.sqrt(operands[0] + _NOTHING)
        return apply_to_expressions(operation, operands)

    new = found.evaluate(lambda i, k: arguments[i].nz[k], ca.SX, apply)
    return [ca.vertcat(ca.SX(0, 1), *each) for each in new] if roots else list(expressions)


def _is_sum_of_squares(scalar: ca.SX) -> bool:
    """Return whether a scalar is written as a sum of squares, with positive factors or without."""
    if scalar.is_constant() or scalar.is_symbolic():
        return False
    parts = [scalar.dep(k) for k in range(scalar.n_dep())]
    if scalar.op() == ca.OP_SQ:
        return True
    if scalar.op() == ca.OP_ADD:
        return all(map(_is_sum_of_squares, parts))
    return scalar.op() == ca.OP_MUL and any(
        a.is_constant() and float(a) > 0 and _is_sum_of_squares(b)
        for a, b in (parts, parts[::-1]))
