# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Small systems of the book: scalar, cubic, and double, nonholonomic and Brockett integrators."""

from itertools import combinations
from typing import Any

import casadi as ca
from obc_ros.core.systems.system import define, Parameter, Signal, System
from obc_ros.core.text.errors import DynamicsError

MAX_M = 50


def define_scalar() -> System:
    """Return x' = a x + b u (Example 2.2; Exercise 2.9; with -a for a, Exercise 2.4)."""
    return define(
        'scalar',
        states=(Signal('x'),),
        inputs=(Signal('u'),),
        parameters=(Parameter('a', 1.0, '1/s'), Parameter('b', 1.0)),
        dynamics=lambda x, u, p: (p[0] * x[0] + p[1] * u[0],),
        description='linear system with one state (Example 2.2)')


def define_cubic() -> System:
    """Return x' = -a x^3 + b u (Exercise 2.5)."""
    return define(
        'cubic',
        states=(Signal('x'),),
        inputs=(Signal('u'),),
        parameters=(Parameter('a', 1.0), Parameter('b', 1.0)),
        dynamics=lambda x, u, p: (-p[0] * x[0]**3 + p[1] * u[0],),
        description='cubic system with one state (Exercise 2.5)')


def define_double_integrator() -> System:
    """Return the double integrator x1' = x2, x2' = u (Examples 2.3 and 2.4)."""
    return define(
        'double_integrator',
        states=(Signal('x1', 'm', description='position'),
                Signal('x2', 'm/s', description='velocity')),
        inputs=(Signal('u', 'm/s^2', description='acceleration'),),
        parameters=(),
        dynamics=lambda x, u, _: (x[1], u[0]),
        description='double integrator (Examples 2.3 and 2.4)')


def build_nonholonomic_integrator() -> System:
    """Return x1' = u1, x2' = u2, x3' = x2 u1 with limits 1 of both inputs (Example 2.6)."""
    return define(
        'nonholonomic_integrator',
        states=(Signal('x1'), Signal('x2'), Signal('x3')),
        inputs=(Signal('u1', '1/s', -1.0, 1.0), Signal('u2', '1/s', -1.0, 1.0)),
        parameters=(),
        dynamics=lambda x, u, _: (u[0], u[1], x[1] * u[0]),
        description='nonholonomic integrator (Example 2.6)')


def define_brockett(m: int = 3) -> System:
    """
    Return Brockett's system q' = u, Y' = q u' - u q', q and u in R^m, Y skew-symmetric.

    The states are q1 .. qm and the entries of Y above its diagonal, row by row: y1_2, y1_3, ...

    Book, Exercise 2.2, with Y' = -Y.
    """
    if isinstance(m, bool) or not isinstance(m, int) or not 2 <= m <= MAX_M:
        raise DynamicsError(f'brockett.m = {m}: wanted a whole number from 2 to {MAX_M}')
    pairs = list(combinations(range(m), 2))

    def dynamics(x: list[ca.SX], u: list[ca.SX], _: list[ca.SX]) -> tuple[Any, ...]:
        return (*u, *(x[i] * u[j] - u[i] * x[j] for i, j in pairs))

    return define(
        'brockett',
        states=(*(Signal(f'q{i + 1}') for i in range(m)),
                *(Signal(f'y{i + 1}_{j + 1}') for i, j in pairs)),
        inputs=tuple(Signal(f'u{i + 1}', '1/s') for i in range(m)),
        parameters=(),
        dynamics=dynamics,
        description="Brockett's system (Exercise 2.2)")
