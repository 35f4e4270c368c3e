# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Conversion of user input to Qx, Qu and N, and messages for invalid input."""

import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.lqr import weights
from obc_ros.core.lqr.lqr import lqr
from obc_ros.core.text.errors import StatementError
import pytest


def test_diagonals_and_full_matrices_are_read_row_by_row():
    chosen = weights.choose(2, 1, Qx=[1, 2], Qu=[3])
    assert chosen.Qx.tolist() == [[1.0, 0.0], [0.0, 2.0]]
    assert chosen.Qu.tolist() == [[3.0]]
    assert chosen.Qx.dtype == float
    assert chosen.cross is None
    full = weights.choose(2, 2, Qx=[[1, 2], [2, 5]], Qu=[1, 0.5, 0.5, 1], cross=[1, 2, 3, 4])
    assert full.Qx.tolist() == [[1, 2], [2, 5]]
    assert full.Qu.tolist() == [[1, 0.5], [0.5, 1]]
    assert full.cross.tolist() == [[1, 2], [3, 4]]


def test_brysons_rule_uses_the_acceptable_deviations():
    """Section 2.5: 1 cm, 10 cm and 5 degrees are equally bad; other states have weight zero."""
    inf = math.inf
    chosen = weights.choose(6, 2, weights='bryson', u_max=[1, 2],
                            x_max=[0.01, 0.1, math.radians(5), inf, inf, inf])
    ratio = chosen.Qx.diagonal() / chosen.Qx[1, 1]
    assert ratio == pytest.approx([100, 1, (3.6 / math.pi)**2, 0, 0, 0])
    assert chosen.Qu.diagonal() == pytest.approx([1, 0.25])


def test_output_weighting_is_h_transposed_h_and_rho():
    chosen = weights.choose(3, 2, weights='output', H=[1, 0, 2, 0, 1, 0], rho=4)
    assert chosen.Qx == pytest.approx(np.array([[1, 0, 2], [0, 1, 0], [2, 0, 4]]))
    assert chosen.Qu == pytest.approx(4 * np.eye(2))


@pytest.mark.parametrize('choice, words', [
    ({'Qx': range(5), 'Qu': [1, 1]},
     'Qx has 5 numbers; wanted 6 (a diagonal) or 36 (a full matrix row by row)'),
    ({'Qx': [1] * 6, 'Qu': [1]},
     'Qu has 1 number; wanted 2 (a diagonal) or 4 (a full matrix row by row)'),
    ({'Qx': [], 'Qu': [1, 1]}, 'Qx has no numbers; wanted 6'),
    ({'Qx': [1, 1, 1, math.nan, 1, 1], 'Qu': [1, 1]}, 'Qx[3] = nan: wanted a finite number'),
    ({'Qx': [1] * 6, 'Qu': [1, math.inf]}, 'Qu[1] = inf: wanted a finite number'),
    ({'Qx': ['1'] * 6, 'Qu': [1, 1]}, "Qx: wanted numbers but found ['1', '1'"),
    ({'Qx': [[1, 2], [3]], 'Qu': [1, 1]}, 'Qx: wanted numbers in rows of equal length'),
    ({'Qx': [True] * 6, 'Qu': [1, 1]}, 'Qx: wanted numbers but found [True'),
    ({'Qx': [1j] * 6, 'Qu': [1, 1]}, 'Qx: wanted numbers but found [1j'),
    ({'Qx': [1] * 6, 'Qu': [1, 1], 'cross': [1]},
     'cross has 1 number; wanted 12 (a full matrix row by row)'),
    ({'Qx': [1] * 6, 'Qu': [1, 1], 'stability': -1}, 'stability = -1: wanted 0 or a positive'),
    ({'Qx': [1] * 6, 'Qu': [1, 1], 'stability': math.nan}, 'stability[0] = nan'),
    ({'weights': 'bryson', 'x_max': [1] * 5, 'u_max': [1, 1]}, 'x_max has 5 numbers; wanted 6'),
    ({'weights': 'bryson', 'x_max': [1, 0, 1, 1, 1, 1], 'u_max': [1, 1]},
     'x_max[1] = 0: wanted a positive number'),
    ({'weights': 'bryson', 'x_max': [1] * 6, 'u_max': [1, -2]},
     'u_max[1] = -2: wanted a positive number'),
    ({'weights': 'bryson', 'x_max': [1] * 6, 'u_max': [1, math.inf]},
     'u_max[1] = inf: wanted a finite number'),
    ({'weights': 'bryson', 'x_max': [math.nan] * 6, 'u_max': [1, 1]}, 'x_max[0] = nan: wanted'),
    ({'weights': 'output', 'H': [1] * 7}, 'H has 7 numbers; wanted a multiple of 6 (rows of 6)'),
    ({'weights': 'output', 'H': []}, 'H has no numbers'),
    ({'weights': 'output', 'H': [1] * 6, 'rho': 0}, 'rho = 0: wanted a positive number'),
    ({'weights': 'best'}, "weights = 'best': wanted one of matrices, bryson, output"),
])
def test_invalid_weights_are_rejected_with_a_message(choice, words):
    with pytest.raises(StatementError) as error:
        weights.choose(6, 2, **choice)
    assert str(error.value).startswith(words)


@pytest.mark.slow
@given(st.recursive(st.none() | st.booleans() | st.floats() | st.integers() | st.text(),
                    lambda inner: st.lists(inner, max_size=4), max_leaves=8))
def test_any_value_gives_a_matrix_or_an_error(value):
    try:
        matrix = weights.square('Qx', value, 2)
    except StatementError as error:
        assert 'Qx' in str(error)
        return
    assert matrix.shape == (2, 2)
    assert np.isfinite(matrix).all()


def test_integral_action_rejects_a_constant_disturbance():
    """A double integrator under a constant force settles at its set point."""
    A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    cost = weights.choose(2, 1, Qx=[1, 1], Qu=[1])
    A3, B3, cost3 = weights.with_integrals(A, B, cost, C=[1, 0], Qi=[2])
    design = lqr(A3, B3, cost3.Qx, cost3.Qu)
    # Steady state: A3 z + B3 (-K z) + (0, push, 0) = 0
    z = np.linalg.solve(A3 - B3 @ design.K, -np.array([0.0, 0.7, 0.0]))
    assert z[:2] == pytest.approx([0, 0], abs=1e-12)
    plain = lqr(A, B, cost.Qx, cost.Qu)
    offset = np.linalg.solve(A - B @ plain.K, -np.array([0.0, 0.7]))
    assert abs(offset[0]) > 0.1


def test_integral_action_keeps_cross_terms_and_checks_rows():
    A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    cost = weights.choose(2, 1, Qx=[2, 2], Qu=[1], cross=[0.1, 0.2], stability=0.3)
    _, _, augmented = weights.with_integrals(A, B, cost, C=[1, 0], Qi=[2])
    assert augmented.cross.tolist() == [[0.1], [0.2], [0.0]]
    assert augmented.stability == 0.3
    with pytest.raises(StatementError, match='C has 3 numbers; wanted a multiple of 2'):
        weights.with_integrals(A, B, cost, C=[1, 0, 1], Qi=[2])
    with pytest.raises(StatementError, match='Qi has 2 numbers; wanted 1'):
        weights.with_integrals(A, B, cost, C=[1, 0], Qi=[2, 2])
