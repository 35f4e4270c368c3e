# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The values of an answer beside those of the right one: whether they agree, and how they differ.

Values are arrays (points, rows, columns); a number has one point.
"""

import math

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.tables import format_value

SAME_FORMULA = 1e-9        # relative difference of formulas that are equal
THREE_DIGITS = 2e-3   # relative, of a number: three digits are asked for
VANISHING = 1e-6   # of the largest entry, or of 1: a number that is computed as 0
NEAR = 3e-2        # relative, of a rounded number
DEGREES = 180.0 / math.pi
ANY = (   # what any answer may be of the right one
    (-1.0, 'it has the opposite sign'),
    (2.0, 'it is twice the right answer: look for a factor 1/2 of the cost or of a derivative'),
    (0.5, 'it is half of the right answer: look for a factor 2 of the cost or of a derivative'),
    (-2.0, 'it has the opposite sign, and a factor of 2 too much'),
    (-0.5, 'it has the opposite sign, and a factor of 2 is missing'),
    (DEGREES, 'it is in degrees; wanted radians'),
    (1.0 / DEGREES, 'it was converted from degrees, but is in radians already'))


def agree(given: Array, right: Array, formula: bool) -> bool:
    """
    Return whether values are equal: formulas to rounding, numbers to three digits.

    An entry is compared with itself, a vanishing one with the largest.
    """
    if given.shape != right.shape or not np.all(np.isfinite(given) & np.isfinite(right)):
        return False
    return bool(np.all(np.abs(given - right) <= _get_tolerance(right, formula)))


def describe_difference(given: Array, right: Array, formula: bool) -> str:
    """
    Return what a wrong answer is of the right one, '' if neither a factor nor an entry tells.

    :param formula: whether it has names; then values are of several points.
    """
    if given.shape != right.shape or not np.all(np.isfinite(given)):
        return ''
    return (_describe_factor(given, right, formula) or _describe_rounding(given, right, formula)
            or _describe_entries(given, right, formula))


def _describe_factor(given: Array, right: Array, formula: bool) -> str:
    """Return by which known or constant factor an answer is wrong."""
    for factor, why in ANY:
        if agree(given, factor * right, formula):
            return why
    largest = np.unravel_index(np.argmax(np.abs(right)), right.shape)
    if not formula or not right[largest] or np.ptp(right, axis=0).max() <= SAME_FORMULA:
        return ''   # any number is a constant factor of another one
    constant = float(given[largest] / right[largest])
    if abs(constant - 1.0) <= NEAR or not constant or not agree(given, constant * right, formula):
        return ''
    return (f'it is the right answer with a constant factor of {format_value(constant, 4)} too '
            'much')


def _describe_rounding(given: Array, right: Array, formula: bool) -> str:
    near = np.maximum(NEAR * np.abs(right), _get_tolerance(right, formula))
    if not np.all(np.abs(given - right) <= near):
        return ''
    return ('near: write numbers such as sqrt(2) as a formula; formulas are compared to 1e-9'
            if formula else 'near: three significant digits are asked for')


def _describe_entries(given: Array, right: Array, formula: bool) -> str:
    """Return which entry is wrong, and how, if others are right."""
    wrong = np.argwhere(np.any(np.abs(given - right) > _get_tolerance(right, formula), axis=0))
    rows, columns = right.shape[1:]
    if len(wrong) == rows * columns:
        return ''
    row, column = wrong[0]
    place = str(max(row, column) + 1) if 1 in (rows, columns) else f'({row + 1}, {column + 1})'
    one = np.s_[:, row:row + 1, column:column + 1]
    how = (_describe_factor(given[one], right[one], formula)
           or _describe_rounding(given[one], right[one], formula))
    if len(wrong) > 1:
        return f'{len(wrong)} of {rows * columns} entries are wrong; the first is entry {place}'
    return f'only the entry {place} is wrong{f": {how}" if how else ""}'


def _get_tolerance(right: Array, formula: bool) -> Array:
    """Return how far each entry may be off."""
    scale = float(np.abs(right).max())
    vanishes = np.abs(right) <= SAME_FORMULA * scale
    size = np.where(vanishes, scale or 1.0, np.abs(right))
    if formula:
        return np.asarray(SAME_FORMULA * size)
    third_digit = 10.0**(np.floor(np.log10(size)) - 2.0)
    # Half of the third digit, as 1.41 is off from sqrt(2), and some rounding.
    return np.where(vanishes, VANISHING * size,
                    np.maximum(THREE_DIGITS * size, 0.501 * third_digit))
