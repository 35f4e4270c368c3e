# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Functions in a shared memory: closed forms, repetition, and arrays of a wrong size."""

import casadi as ca
import numpy as np
from obc_ros.core.receding.buffered_function import BufferedFunction
import pytest


def make_function(name: str, given: str, found: str, factor: float) -> ca.Function:
    """Return the function that multiplies three numbers by a factor."""
    x = ca.SX.sym('x', 3)
    return ca.Function(name, [x], [factor * x], [given], [found])


def test_an_output_is_the_input_of_the_next_function() -> None:
    """Both work on one array; a change of the first input arrives at the end."""
    memory: dict[str, np.ndarray] = {}
    first = BufferedFunction(make_function('first', 'a', 'b', 2.0), memory)
    second = BufferedFunction(make_function('second', 'b', 'c', -3.0), memory)
    for a in ([1.0, 2.0, 3.0], [0.5, 0.0, -7.0]):
        memory['a'][:] = a
        first.run()
        second.run()
        np.testing.assert_array_equal(memory['c'], -6.0 * np.array(a))


def test_a_quadratic_program_has_the_same_answer_each_time() -> None:
    """HPIPM uses the addresses of its outputs for itself: they are given to it again."""
    # One stage: minimise 1/2 (x0^2 + u0^2 + x1^2) with x1 = x0 + u0 and x0 = 2, hence u0 = -1.
    memory: dict[str, np.ndarray] = {}
    solver = BufferedFunction(ca.conic('qp', 'hpipm', {
        'h': ca.Sparsity.diag(3), 'a': ca.Sparsity.dense(1, 3)}, {
            'N': 1, 'nx': [1, 1], 'nu': [1, 0], 'ng': [0, 0], 'print_time': False}), memory)
    memory['h'][:] = 1.0
    memory['a'][:] = 1.0, 1.0, -1.0
    memory['lbx'][:], memory['ubx'][:] = (2.0, -9.0, -9.0), (2.0, 9.0, 9.0)
    for _ in range(3):
        memory['x'][:] = np.nan
        solver.run()
        np.testing.assert_allclose(memory['x'], [2.0, -1.0, 1.0], atol=1e-6)


def test_an_array_of_another_size_is_refused() -> None:
    """Otherwise the function would write outside of it."""
    with pytest.raises(ValueError, match='b of first: 2 numbers; wanted 3'):
        BufferedFunction(make_function('first', 'a', 'b', 1.0), {'b': np.zeros(2)})
