# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Questions of an exercise sheet that a formula, a number or a matrix answers.

An answer is compared with a closed form by its values, so that it may be written in any way. A
wrong answer is compared with typical mistakes: those of the question, and those that any answer
may have, such as a sign.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import math
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import describe_type, StatementError
from obc_ros.core.text.expressions import parse_expression

Formula = str | float
FormulaRows = Sequence[Sequence[Formula]]

POINTS = 64        # at which formulas are compared
SAME_FORMULA = 1e-9        # relative difference of formulas that are equal
TOLERANCE = 2e-3   # relative, of a number: three digits are asked for
MOST_ENTRIES = 100  # of an answer
DEGREES = 180.0 / math.pi
ANY = (   # what any answer may be of the right one
    (-1.0, 'it has the opposite sign'),
    (2.0, 'it is twice the right answer: look for a factor 1/2 of the cost or of a derivative'),
    (0.5, 'it is half of the right answer: look for a factor 2 of the cost or of a derivative'),
    (-2.0, 'it has the opposite sign, and a factor of 2 too much'),
    (-0.5, 'it has the opposite sign, and a factor of 2 is missing'),
    (DEGREES, 'it is in degrees; wanted radians'),
    (1.0 / DEGREES, 'it was converted from degrees, but is in radians already'))


@dataclass(frozen=True)
class SheetQuestion(ABC):
    """
    A question of a sheet.

    :ivar name: key of the answer, such as ``2.4-a-input``.
    :ivar text: the question, as a lecturer asks it.
    :ivar form: what to write.
    """

    name: str
    text: str
    form: str

    @abstractmethod
    def check(self, answer: Any) -> str:
        """
        Return why an answer is wrong, '' if it is right.

        :raises ObcError: if the answer cannot be read.
        """


@dataclass(frozen=True)
class FormulaQuestion(SheetQuestion):
    """
    A question that a formula, a number, or a matrix of them answers.

    :ivar reference: a closed form, as rows if the answer is a matrix.
    :ivar names: names that may be in the answer, with the interval in which values are compared.
    :ivar mistakes: typical wrong answers, in any shape, each with the words for a student.
    :ivar advice: what an answer that is wrong in another way has to fulfil.
    """

    reference: Formula | FormulaRows
    names: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    mistakes: Sequence[tuple[Formula | Sequence[Formula] | FormulaRows, str]] = ()
    advice: str = ''

    def check(self, answer: Any) -> str:
        """Return why an answer is wrong, '' if it is right."""
        given = self.evaluate(answer)
        right = self.evaluate(self.reference)
        if self.agree(given, right):
            return ''
        for wrong, why in self.mistakes:
            if self.agree(given, self.evaluate(wrong)):
                return why
        if given.shape == right.shape:
            for factor, why in ANY:
                if self.agree(given, factor * right):
                    return why
        if self.agree(given.swapaxes(1, 2), right):
            return 'it is the transpose: rows and columns are exchanged'
        if given.shape != right.shape:
            return (f'it has {given.shape[1]} x {given.shape[2]} entries; wanted '
                    f'{right.shape[1]} x {right.shape[2]}')
        if not np.all(np.isfinite(given)):
            return 'it has no finite value for some numbers that are allowed'
        return self.advice or 'it is not right'

    def evaluate(self, answer: Any) -> Array:
        """
        Return the values of an answer at points drawn from the intervals of the names.

        :raises StatementError: if it is not a number, a formula of the names, or rows of them.
        """
        rows = _arrange(self.name, answer)
        symbols = {name: ca.SX.sym(name) for name in self.names}
        found = ca.vertcat(*(ca.horzcat(*(
            parse_expression(entry, symbols, self.name) for entry in row)) for row in rows))
        function = ca.Function('answer', [ca.vertcat(*symbols.values())], [found])
        drawn = np.random.default_rng(1)
        lower, upper = np.array([*self.names.values(), (0.0, 0.0)])[:-1].reshape(-1, 2).T
        points = drawn.uniform(lower, upper, size=(POINTS if symbols else 1, len(symbols)))
        return np.stack([np.array(function(point)) for point in points])

    def agree(self, given: Array, right: Array) -> bool:
        """Return whether values are equal: formulas to rounding, numbers to three digits."""
        if given.shape != right.shape or not np.all(np.isfinite(given)):
            return False
        allowed = SAME_FORMULA if self.names else TOLERANCE
        scale = np.abs(right).max()
        # An entry is compared with itself, a vanishing one with the largest.
        size = np.where(np.abs(right) > SAME_FORMULA * scale, np.abs(right), scale or 1.0)
        return bool(np.all(np.abs(given - right) <= allowed * size))


def _arrange(name: str, answer: Any) -> Sequence[Sequence[Any]]:
    """Return an answer as rows; a list of entries is one row."""
    rows = answer if isinstance(answer, (list, tuple)) else [[answer]]
    if rows and not any(isinstance(row, (list, tuple)) for row in rows):
        rows = [rows]
    if not rows or not all(isinstance(row, (list, tuple)) and row for row in rows):
        raise StatementError(f'{name}: wanted rows of numbers or formulas, found '
                             f'{describe_type(answer)}')
    if len({len(row) for row in rows}) > 1:
        raise StatementError(f'{name}: the rows have different lengths')
    if sum(map(len, rows)) > MOST_ENTRIES:
        raise StatementError(f'{name}: more than {MOST_ENTRIES} entries')
    return rows
