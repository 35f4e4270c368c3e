# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The values of a sweep: axes of a grid, and random samples.

An axis is written ``KEY=LOWER:UPPER:NUMBER`` or ``KEY=A,B,C``, a random number
``KEY~normal(MEAN,DEVIATION)``, ``KEY~uniform(LOWER,UPPER)`` or ``KEY~lognormal(MEAN,DEVIATION)``,
of the logarithm. Every number may be an expression, such as pi/2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
import re
from typing import Any
import zlib

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import describe_type, quote, StatementError, suggest_name
from obc_ros.core.text.expressions import parse_number

MOST_POINTS = 1_000_000
SAMPLE = 'sample'   # dimension of the random samples
DISTRIBUTIONS = {'normal': ('mean', 'deviation'), 'uniform': ('lower', 'upper'),
                 'lognormal': ('mean', 'deviation')}
_DRAW = re.compile(r'\s*(\w+)\s*\((.*)\)\s*', re.DOTALL)


@dataclass(frozen=True)
class SweepAxis:
    """A number of the problem and the values that it takes, all different."""

    key: str
    values: tuple[float, ...]


@dataclass(frozen=True)
class RandomNumber:
    """A number of the problem with a distribution of `DISTRIBUTIONS` and its two parameters."""

    key: str
    distribution: str
    parameters: tuple[float, float]

    def draw(self, count: int, seed: int) -> Array:
        """Return `count` values; those of one key do not depend on the other keys."""
        generator = np.random.default_rng([seed, zlib.crc32(self.key.encode())])
        drawn: Array = getattr(generator, self.distribution)(*self.parameters, count)
        return drawn


def parse_axes(texts: Sequence[str]) -> dict[str, str]:
    """
    Return keys and values of axes, such as ``x0.p=-2:2:101`` and ``mass=1,2,4``, for `make_axes`.

    :raises StatementError: if a text has another form, or a key occurs twice.
    """
    return _parse(texts, '--over', '=', 'KEY=LOWER:UPPER:NUMBER or KEY=A,B,C')


def parse_draws(texts: Sequence[str]) -> dict[str, str]:
    """
    Return keys and distributions, such as ``x0.v~normal(0,1)``, for `make_draws`.

    :raises StatementError: if a text has another form, or a key occurs twice.
    """
    return _parse(texts, '--sample', '~', 'KEY~normal(MEAN,DEVIATION)')


def _parse(texts: Sequence[str], where: str, mark: str, wanted: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for text in texts:
        key, _, value = map(str.strip, text.partition(mark))
        if not key or not value:
            raise StatementError(f"{where}: wanted {wanted}, found '{quote(text)}'")
        if key in found:
            raise StatementError(f"{where}: '{quote(key)}' is given twice")
        found[key] = value
    return found


def make_axes(over: Mapping[str, Any]) -> tuple[SweepAxis, ...]:
    """
    Return the axes of a grid.

    :param over: the values are a sequence or an array of numbers, one number, or a text:
        ``-2:2:101`` or ``1,2,4``.
    :raises StatementError: if there are no values, or if one is not a finite number or occurs
        twice.
    """
    return tuple(SweepAxis(key, _values(values, key)) for key, values in over.items())


def make_draws(sample: Mapping[str, Any]) -> tuple[RandomNumber, ...]:
    """Return the random numbers of distributions, such as ``normal(0, 1)``."""
    return tuple(_random(key, text) for key, text in sample.items())


def check_count(axes: Sequence[SweepAxis], draws: Sequence[RandomNumber], count: int) -> int:
    """
    Return the number of points of a sweep.

    :param axes, draws: all with different keys.
    :param count: number of samples; every sample is combined with every point of the grid.
    :raises StatementError: if there is nothing to vary, a key occurs twice, the count does not
        fit, or there are more than ``MOST_POINTS`` points.
    """
    keys = [axis.key for axis in axes] + [draw.key for draw in draws]
    if not keys:
        raise StatementError('nothing to vary: wanted an axis (--over) or a random number '
                             '(--sample)')
    for key in keys:
        if keys.count(key) > 1:
            raise StatementError(f"'{quote(key)}' is varied twice")
    if bool(draws) != (count > 0):
        raise StatementError('--count: wanted the number of samples, at least 1' if draws else
                             f'--count {count}: there is no random number (--sample)')
    points = math.prod(len(axis.values) for axis in axes) * (count if draws else 1)
    if points > MOST_POINTS:
        raise StatementError(f'{points} points; at most {MOST_POINTS} are accepted')
    return points


def _values(values: Any, key: str) -> tuple[float, ...]:
    where = f"axis '{quote(key)}'"
    if isinstance(values, str):
        entries: list[Any] = _range(values, where) if ':' in values else values.split(',')
    elif isinstance(values, (int, float)):
        entries = [values]
    else:
        array = np.asarray(values)
        if array.ndim != 1 or array.dtype.kind not in 'iuf':
            raise StatementError(f'{where}: wanted a list of numbers, found '
                                 f'{describe_type(values)}')
        entries = array.tolist()
    if not entries:
        raise StatementError(f'{where}: there are no values')
    if len(entries) > MOST_POINTS:
        raise StatementError(f'{where}: {len(entries)} values; at most {MOST_POINTS} are accepted')
    found = tuple(parse_number(each, {}, where) for each in entries)
    if len(set(found)) < len(found):
        twice = next(each for each in found if found.count(each) > 1)
        raise StatementError(f'{where}: the value {twice:g} occurs twice')
    return found


def _range(text: str, where: str) -> list[float]:
    """Return the equally spaced values of ``LOWER:UPPER:NUMBER``, both ends included."""
    pieces = text.split(':')
    if len(pieces) != 3:
        raise StatementError(f"{where}: wanted LOWER:UPPER:NUMBER, found '{quote(text)}'")
    lower, upper, number = (parse_number(piece, {}, where) for piece in pieces)
    if not number.is_integer() or number < 1:
        raise StatementError(
            f'{where}: wanted a whole number of values, found {quote(pieces[2].strip())}')
    if number > MOST_POINTS:
        raise StatementError(f'{where}: {number:g} values; at most {MOST_POINTS} are accepted')
    if (number == 1) != (lower == upper):
        raise StatementError(f'{where}: {number:g} value(s) from {lower:g} to {upper:g}')
    return list(map(float, np.linspace(lower, upper, int(number))))


def _random(key: str, text: Any) -> RandomNumber:
    where = f"random number '{quote(key)}'"
    wanted = ', '.join(f'{name}({",".join(names)})' for name, names in DISTRIBUTIONS.items())
    matched = _DRAW.fullmatch(text) if isinstance(text, str) else None
    if matched is None:
        raise StatementError(f'{where}: wanted one of {wanted}, found {describe_type(text)}')
    name, inside = matched.groups()
    if name not in DISTRIBUTIONS:
        raise StatementError(f"{where}: there is no distribution '{quote(name)}'"
                             f'{suggest_name(name, tuple(DISTRIBUTIONS))}; wanted one of {wanted}')
    pieces = inside.split(',')
    if len(pieces) != 2:
        raise StatementError(f'{where}: {name} has 2 parameters '
                             f'({", ".join(DISTRIBUTIONS[name])}), found {len(pieces)}')
    first, second = (parse_number(piece, {}, where) for piece in pieces)
    if name == 'uniform' and not first < second:
        raise StatementError(f'{where}: wanted lower < upper, found {first:g} and {second:g}')
    if name != 'uniform' and not second > 0.0:
        raise StatementError(f'{where}: wanted a deviation > 0, found {second:g}')
    return RandomNumber(key, name, (first, second))
