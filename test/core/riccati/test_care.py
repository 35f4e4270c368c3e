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
def test_exact_solutions(name):
    *data, P = EXACT[name]
    design = lqr(*data)
    gap = np.linalg.norm(design.P - P) / np.linalg.norm(P)
    # The bound is made in scaled coordinates; in the problem's own it holds within their ratio.
    assert gap <= max(10 * design.error, 1e-13)
    if not name.startswith('10'):  # whose condition number is 1 / d^2
        assert gap <= 1e-12


@pytest.mark.parametrize('name', OTHERS)
def test_residuals_and_poles(name):
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
def test_what_cannot_be_proved_is_refused(name):
    data, words = REFUSED[name]
    with pytest.raises(RefusedDesignError) as caught:
        lqr(*data)
    assert any(each in str(caught.value) for each in words.split('|'))


def test_what_is_too_large_is_told():
    """The axle of the collection has 211 disks."""
    with pytest.raises(StatementError, match='421 states or inputs: at most 400 are taken'):
        lqr(*example_20(211))
