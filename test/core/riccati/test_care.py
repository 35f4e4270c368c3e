# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The Riccati solver on the collection of Benner, Laub and Mehrmann.

P. Benner, A. J. Laub, V. Mehrmann, A collection of benchmark examples for the numerical solution
of algebraic Riccati equations I: continuous-time case, Technical Report SPC 95-22, TU Chemnitz,
1995. Numbers and exact solutions are the report's.
"""


import numpy as np
from obc_ros.core.lqr.lqr import lqr
from obc_ros.core.text.errors import RefusedDesignError, StatementError
import pytest
from riccati_collection import EXACT, example_20, OTHERS, REFUSED


@pytest.mark.parametrize('name', EXACT)
def test_solutions_of_the_collection_equal_the_exact_ones(name):
    *data, P = EXACT[name]
    design = lqr(*data)
    gap = np.linalg.norm(design.P - P) / np.linalg.norm(P)
    # The bound holds in scaled coordinates; in the original ones, within their ratio.
    assert gap <= max(10 * design.error, 1e-13)
    if not name.startswith('10'):  # condition number 1 / d^2
        assert gap <= 1e-12


@pytest.mark.parametrize('name', OTHERS)
def test_solutions_of_the_collection_have_small_residuals(name):
    A, B, Q, R = (np.array(M, dtype=float) for M in OTHERS[name])
    design = lqr(A, B, Q, R)
    assert np.linalg.eigvals(A - B @ design.K).real.max() < 0
    P = design.P.astype(np.longdouble)
    terms = [A.T @ P, P @ A, -(P @ B) @ np.linalg.solve(R, B.T @ design.P), Q]
    size = max(float(np.linalg.norm(term)) for term in terms)
    assert float(np.linalg.norm(sum(terms))) <= 1e-8 * size
    if name.startswith('17'):
        assert design.P[0, -1] == pytest.approx(1.0, rel=100 * design.error)


@pytest.mark.parametrize('name', REFUSED)
def test_solutions_that_cannot_be_verified_are_rejected(name):
    data, words = REFUSED[name]
    with pytest.raises(RefusedDesignError) as caught:
        lqr(*data)
    assert any(each in str(caught.value) for each in words.split('|'))


def test_problems_above_the_size_limit_are_rejected():
    """Example 20 of the collection has 211 disks."""
    with pytest.raises(StatementError, match='421 states or inputs: at most 400 are taken'):
        lqr(*example_20(211))
