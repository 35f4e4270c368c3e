# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Expressions as polynomials with rational coefficients, in exact arithmetic.

Two expressions with the same polynomial are equal wherever both are defined. Functions such as
sin, and inverses of sums, are further generators. The identities in use are sin^2 + cos^2 = 1,
sqrt(a)^2 = a and (1/a) a = 1. Other identities are not recognised, so that expressions with
different polynomials may also be equal.

A double is read as its shortest decimal, which is how it was written: 0.1 is 1/10.
"""

from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from math import inf, isfinite
from typing import TypeVar

import casadi as ca
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.instructions import Instructions

# (generator, exponent) for each factor, sorted by generator.
Monomial = tuple[tuple[int, int], ...]
Polynomial = dict[Monomial, Fraction]
RationalRow = dict[int, Fraction]
Key = TypeVar('Key')

_MOST_TERMS = 3000
_MOST_POWER = 12
_ONE: Monomial = ()


class TooHardError(Exception):
    """An expression has a number that is not finite, or too many terms."""


def convert_to_rational(value: float) -> Fraction:
    """Return the rational number of the shortest decimal of a double: of 0.1, 1/10."""
    if not isfinite(value):
        raise TooHardError
    return Fraction(repr(float(value)))


class Algebra:
    """
    The generators of a set of polynomials.

    The first `symbols` generators are symbols; the others are functions and inverses of sums.
    """

    def __init__(self, symbols: int) -> None:
        self._known: dict[object, int] = {}
        self._kinds: dict[int, tuple[int, Polynomial, int]] = {}   # operation, operand, partner
        self._next = symbols

    def generator(self, index: int) -> Polynomial:
        """Return a generator as a polynomial."""
        return {((index, 1),): Fraction(1)}

    def add(self, a: Polynomial, b: Polynomial, factor: Fraction = Fraction(1)) -> Polynomial:
        """Return a + factor b."""
        total = _add_sparse(a, b, factor)
        if len(total) > _MOST_TERMS:
            raise TooHardError
        return total

    def multiply(self, a: Polynomial, b: Polynomial) -> Polynomial:
        """Return a b."""
        if len(a) * len(b) > 10 * _MOST_TERMS:
            raise TooHardError
        total: Polynomial = {}
        for left, x in a.items():
            for right, y in b.items():
                powers = dict(left)
                for generator, exponent in right:
                    powers[generator] = powers.get(generator, 0) + exponent
                term = tuple(sorted((g, e) for g, e in powers.items() if e))
                total = self.add(total, self._reduced(term, x * y))
        return total

    def power(self, a: Polynomial, exponent: int) -> Polynomial:
        """Return a to an integer power."""
        if abs(exponent) > _MOST_POWER:
            raise TooHardError
        base, total = a if exponent >= 0 else self.inverse(a), make_constant(1)
        for _ in range(abs(exponent)):
            total = self.multiply(total, base)
        return total

    def inverse(self, a: Polynomial) -> Polynomial:
        """Return 1 / a."""
        if not a:
            raise TooHardError
        if len(a) == 1:
            [(monomial, value)] = a.items()
            return self._reduced(tuple((g, -e) for g, e in monomial), 1 / value)
        lead = a[max(a)]
        scaled = {monomial: value / lead for monomial, value in a.items()}
        return {((self._atom(ca.OP_INV, scaled), 1),): 1 / lead}

    def apply(self, operation: int, operands: Sequence[Polynomial]) -> Polynomial:
        """Return the result of an operation of CasADi on polynomials."""
        simple = _SIMPLE.get(operation)
        if simple:
            return simple(self, *operands)
        if operation in (ca.OP_POW, ca.OP_CONSTPOW) and set(operands[1]) <= {_ONE}:
            exponent = operands[1].get(_ONE, Fraction(0))
            if exponent.denominator == 1:
                return self.power(operands[0], int(exponent))
            if exponent.denominator == 2 and abs(exponent.numerator) <= _MOST_POWER:
                return self.power(self.apply(ca.OP_SQRT, operands[:1]), exponent.numerator)
        if operation == ca.OP_TAN:
            return self.multiply(self.apply(ca.OP_SIN, operands),
                                 self.inverse(self.apply(ca.OP_COS, operands)))
        if operation in (ca.OP_SIN, ca.OP_COS) and operands[0]:
            [a] = operands
            if a[max(a)] < 0:
                value = self.apply(operation, [negate(a)])
                return value if operation == ca.OP_COS else negate(value)
        if len(operands) == 1:
            return self.generator(self._atom(operation, operands[0]))
        key = (operation, *(frozenset(each.items()) for each in operands))
        return self.generator(self._index(key))

    def cleared(self, polynomials: Sequence[Polynomial]) -> list[Polynomial]:
        """Return the polynomials times a common denominator, free of inverses of sums."""
        found = list(polynomials)
        for generator in sorted(self._kinds, reverse=True):   # later ones contain earlier ones
            operation, operand, _ = self._kinds[generator]
            most = max((dict(term).get(generator, 0) for each in found for term in each),
                       default=0)
            if operation == ca.OP_INV and most > 0:
                found = [self._without(each, generator, operand, most) for each in found]
        return found

    def _without(self, a: Polynomial, generator: int, operand: Polynomial, most: int
                 ) -> Polynomial:
        total: Polynomial = {}
        for term, value in a.items():
            rest = tuple(each for each in term if each[0] != generator)
            missing = most - dict(term).get(generator, 0)
            total = self.add(total, self.multiply({rest: value}, self.power(operand, missing)))
        return total

    def _index(self, key: object) -> int:
        if key not in self._known:
            self._known[key] = self._next
            self._next += 1
        return self._known[key]

    def _atom(self, operation: int, operand: Polynomial) -> int:
        """Return the generator of a function of a polynomial."""
        key = frozenset(operand.items())
        index = self._index((operation, key))
        partner = self._index((ca.OP_COS, key)) if operation == ca.OP_SIN else -1
        if operation == ca.OP_SIN:
            self._kinds.setdefault(partner, (ca.OP_COS, operand, -1))
        self._kinds.setdefault(index, (operation, operand, partner))
        return index

    def _reduced(self, term: Monomial, value: Fraction) -> Polynomial:
        """Return a monomial after the identities for sines, roots and inverses of sums."""
        for k, (generator, exponent) in enumerate(term):
            operation, operand, partner = self._kinds.get(generator, (-1, {}, -1))
            rest: Polynomial = {term[:k] + term[k + 1:]: value}
            if operation == ca.OP_SIN and exponent > 1:
                square = self.add(make_constant(1), {((partner, 2),): Fraction(1)}, Fraction(-1))
                left = self.power(self.generator(generator), exponent - 2)
                return self.multiply(self.multiply(rest, left), square)
            if operation == ca.OP_SQRT and exponent > 1:
                left = self.power(self.generator(generator), exponent - 2)
                return self.multiply(self.multiply(rest, left), operand)
            if operation == ca.OP_INV and exponent < 0:
                return self.multiply(rest, self.power(operand, -exponent))
        return {term: value}


def make_constant(value: int | Fraction) -> Polynomial:
    """Return a number as a polynomial; 0 is the empty one."""
    return {_ONE: Fraction(value)} if value else {}


def negate(a: Polynomial) -> Polynomial:
    """Return -a."""
    return {monomial: -value for monomial, value in a.items()}


_SIMPLE: dict[int, Callable[..., Polynomial]] = {
    ca.OP_ADD: lambda algebra, a, b: algebra.add(a, b),
    ca.OP_SUB: lambda algebra, a, b: algebra.add(a, b, Fraction(-1)),
    ca.OP_MUL: lambda algebra, a, b: algebra.multiply(a, b),
    ca.OP_DIV: lambda algebra, a, b: algebra.multiply(a, algebra.inverse(b)),
    ca.OP_NEG: lambda algebra, a: negate(a),
    ca.OP_TWICE: lambda algebra, a: algebra.add(a, a),
    ca.OP_INV: lambda algebra, a: algebra.inverse(a),
    ca.OP_SQ: lambda algebra, a: algebra.multiply(a, a),
}


def read_polynomials(function: ca.Function, values: Sequence[Sequence[float | None] | Array]
                     ) -> tuple[Algebra, list[Polynomial]]:
    """
    Return the entries of the output of a function of SX as polynomials.

    :param values: the entries of each input: a number, or None for a symbol. Symbols are numbered
        in this order.
    :raises TooHardError: if there are too many terms, or a number is not finite.
    """
    place = {(i, k): number for number, (i, k) in enumerate(
        (i, k) for i, column in enumerate(values) for k, value in enumerate(column)
        if value is None)}
    algebra = Algebra(len(place))

    def read(i: int, k: int) -> Polynomial:
        value = values[i][k]
        return (algebra.generator(place[i, k]) if value is None
                else make_constant(convert_to_rational(value)))

    return algebra, Instructions(function).evaluate(
        read, lambda value: make_constant(convert_to_rational(value)), algebra.apply)[0]


def split_affine(a: Polynomial, symbols: int) -> tuple[list[Fraction], Fraction] | None:
    """Return coefficients of the symbols and the constant; None if `a` is not affine in them."""
    row, rest = [Fraction(0)] * symbols, Fraction(0)
    for monomial, value in a.items():
        if monomial == _ONE:
            rest = value
        elif len(monomial) == 1 and monomial[0][1] == 1 and monomial[0][0] < symbols:
            row[monomial[0][0]] = value
        else:
            return None
    return row, rest


def reduce_rows(rows: Iterable[RationalRow], columns: float = inf
                ) -> tuple[dict[int, RationalRow], list[RationalRow]]:
    """
    Return the reduced row echelon form.

    :param rows: nonzero entries by column.
    :param columns: number of the first columns in which pivots may be.
    :return: echelon: the rows by the columns of their pivots; each pivot is 1, and the only entry
        of that column; rest: what is left of rows without a pivot, each of them less a sum of
        earlier ones.
    """
    found: dict[int, RationalRow] = {}
    rest = []
    for given in rows:
        row = dict(given)
        for pivot in [column for column in row if column in found]:
            row = _add_sparse(row, found[pivot], -row[pivot])
        first = min((column for column in row if column < columns), default=None)
        if first is None:
            rest.append(row)
            continue
        row = {column: value / row[first] for column, value in row.items()}
        for other, each in found.items():
            if first in each:
                found[other] = _add_sparse(each, row, -each[first])
        found[first] = row
    return found, rest


def find_null_space(rows: Iterable[RationalRow], columns: int) -> list[RationalRow]:
    """Return a basis of the null space of the first columns of a matrix."""
    found, _ = reduce_rows(rows, columns)
    return [{free: Fraction(1)} | {pivot: -row[free] for pivot, row in found.items()
                                   if free in row}
            for free in range(columns) if free not in found]


def _add_sparse(a: dict[Key, Fraction], b: dict[Key, Fraction], factor: Fraction
                ) -> dict[Key, Fraction]:
    """Return a + factor b, without entries that are 0."""
    total = dict(a)
    for key, value in b.items():
        new = total.get(key, Fraction(0)) + factor * value
        if new:
            total[key] = new
        else:
            total.pop(key, None)
    return total
