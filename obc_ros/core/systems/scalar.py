# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The systems with one state of Example 2.2 and Exercises 2.4, 2.5 and 2.9."""

from obc_ros.core.systems.system import define, Parameter, Signal, System


def system() -> System:
    """
    Return x' = a x + b u.

    References
    ----------
    Book, Example 2.2; Exercise 2.9; with -a for a, Exercise 2.4.

    """
    return define(
        'scalar',
        states=(Signal('x'),),
        inputs=(Signal('u'),),
        parameters=(Parameter('a', 1.0, '1/s'), Parameter('b', 1.0)),
        dynamics=lambda x, u, p: (p[0] * x[0] + p[1] * u[0],),
        description='linear system with one state (Example 2.2)')


def cubic() -> System:
    """
    Return x' = -a x^3 + b u.

    References
    ----------
    Book, Exercise 2.5.

    """
    return define(
        'cubic',
        states=(Signal('x'),),
        inputs=(Signal('u'),),
        parameters=(Parameter('a', 1.0), Parameter('b', 1.0)),
        dynamics=lambda x, u, p: (-p[0] * x[0]**3 + p[1] * u[0],),
        description='cubic system with one state (Exercise 2.5)')
