# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Explicit Runge-Kutta methods: their tableaus, and one step of dx/ds = f(x, s) in CasADi."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import casadi as ca

Slope = Callable[[ca.SX, ca.SX], ca.SX]
StageWeights = tuple[float, ...]


@dataclass(frozen=True)
class Tableau:
    """
    The coefficients of an explicit method with s stages.

    :ivar A: row i has the weights of the slopes before stage i.
    :ivar b, c: StageWeights of the step, and nodes as parts of it, (s,).
    :ivar error: StageWeights (s,) of the difference from a step of lower order; empty without one.
    :ivar middle: StageWeights (s,) of the part of degree 4 of the values within a step; empty
        without them.
    """

    A: tuple[StageWeights, ...]
    b: StageWeights
    c: StageWeights
    error: StageWeights = ()
    middle: StageWeights = ()


def _read(A: Sequence[str], b: str, lower: str = '', middle: str = '') -> Tableau:
    """Return a tableau from fractions as text; `lower`: the weights of lower order."""
    rows, weights, others, within = (
        [[Fraction(number) for number in row.split()] for row in part]
        for part in (A, [b], [lower], [middle]))
    error = [high - low for high, low in zip(weights[0], others[0], strict=True)] if lower else []
    return Tableau(tuple(_floats(row) for row in rows), _floats(weights[0]),
                   tuple(float(sum(row)) for row in rows), _floats(error), _floats(within[0]))


def _floats(row: Sequence[Fraction]) -> StageWeights:
    return tuple(map(float, row))


RK4 = _read(('', '1/2', '0 1/2', '0 0 1'), '1/6 1/3 1/3 1/6')
# J. C. Butcher, On Runge-Kutta processes of high order, J. Austral. Math. Soc. 4 (1964): order 6.
BUTCHER = _read((
    '', '1/3', '0 2/3', '1/12 1/3 -1/12', '-1/16 9/8 -3/16 -3/8', '0 9/8 -3/8 -3/4 1/2',
    '9/44 -9/11 63/44 18/11 0 -16/11'), '11/120 0 27/40 27/40 -4/15 -4/15 11/120')
# J. R. Dormand, P. J. Prince, A family of embedded Runge-Kutta formulae, J. Comput. Appl. Math. 6
# (1980), RK5(4)7M. Values within a step: E. Hairer, S. Norsett, G. Wanner, Solving Ordinary
# Differential Equations I, II.6.
DORMAND_PRINCE = _read(
    ('', '1/5', '3/40 9/40', '44/45 -56/15 32/9',
     '19372/6561 -25360/2187 64448/6561 -212/729',
     '9017/3168 -355/33 46732/5247 49/176 -5103/18656',
     '35/384 0 500/1113 125/192 -2187/6784 11/84'),
    '35/384 0 500/1113 125/192 -2187/6784 11/84 0',
    '5179/57600 0 7571/16695 393/640 -92097/339200 187/2100 1/40',
    '-12715105075/11282082432 0 87487479700/32700410799 -10690763975/1880347072 '
    '701980252875/199316789632 -1453857185/822651844 69997945/29380423')


def take_step(tableau: Tableau, f: Slope, x: ca.SX, s: ca.SX, h: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return x at s + h, and its difference from the step of lower order, 0 without one."""
    slopes: list[ca.SX] = []
    for row, c in zip(tableau.A, tableau.c, strict=True):
        slopes.append(f(x + _moved(row, slopes, h), s + c * h))
    return x + _moved(tableau.b, slopes, h), _moved(tableau.error, slopes, h)


def _moved(weights: StageWeights, slopes: Sequence[ca.SX], h: ca.SX) -> ca.SX:
    """Return h times the weighted sum of the slopes."""
    return sum(((h * weight) * slope for weight, slope in zip(weights, slopes, strict=False)
                if weight), ca.SX(0))
