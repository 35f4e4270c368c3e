# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A running server verifies every gain: a published collection and random systems."""

from collections.abc import Callable
from typing import Any

from hypothesis import given, settings
from lqr_bench import matrix
import numpy as np
from numpy.typing import NDArray
from obc_ros.msg import LqrWeights
from obc_ros.srv import DesignLqr
import pytest
from regulator_problems import cost_of, is_hard, problems
from riccati_collection import EXACT, OTHERS, REFUSED

pytestmark = pytest.mark.nodes

Array = NDArray[np.float64]


@pytest.fixture
def design(spawn: Any, probe: Any) -> Callable[..., Any]:
    """Return a function that requests a design of A, B, Qx, Qu from a running server."""
    spawn('trajectory_server', {'workers': 1})

    def ask(A: Any, B: Any, Qx: Any, Qu: Any) -> Any:
        A, B, Qx, Qu = (np.asarray(each, dtype=float).ravel().tolist() for each in (
            A, B, Qx, Qu))
        return probe.call(DesignLqr, '/trajectory_server/design_lqr', DesignLqr.Request(
            a=A, b=B, weights=LqrWeights(qx=Qx, qu=Qu)))

    return ask


def check(answer: Any, *problem: Any) -> Array:
    """
    Check the Riccati residual of an accepted design in extended precision; return P.

    To round each entry of A, B, Qx and Qu^-1 changes it by up to EPS of the sum of the terms
    without signs. Within this sum P B may cancel: the residual relative to the terms with signs
    may be larger.
    """
    A, B, Qx, Qu = (np.asarray(each, dtype=float) for each in problem)
    K, P = matrix(answer.design.k, B.shape[1]), matrix(answer.design.p, len(A))
    assert np.linalg.eigvals(A - B @ K).real.max() < 0.0 > max(answer.design.poles_real)
    A_, B_, P_, weight = (M.astype(np.longdouble) for M in (A, B, P, np.linalg.inv(Qu)))
    residual = A_.T @ P_ + P_ @ A_ - P_ @ B_ @ weight @ B_.T @ P_ + Qx
    A_, B_, P_, weight = (np.abs(M) for M in (A_, B_, P_, weight))
    size = A_.T @ P_ + P_ @ A_ + P_ @ B_ @ weight @ B_.T @ P_ + np.abs(Qx)
    assert np.linalg.norm(residual) <= len(A) * np.finfo(float).eps * np.linalg.norm(size)
    assert answer.design.residual <= 1e-8
    assert 'spectral abscissa' in answer.message
    return P


def test_ill_conditioned_problems_are_solved_or_refused(design: Any) -> None:
    """The collection of Benner, Laub and Mehrmann (CAREX): no accepted design is wrong."""
    for name, (*data, exact) in EXACT.items():
        P = check(design(*data), *data)
        if not name.startswith('10'):  # example 10 has the condition number 1 / d^2
            assert np.linalg.norm(P - exact) <= 1e-12 * np.linalg.norm(exact), name
    for data in OTHERS.values():
        check(design(*data), *data)
    for data, words in REFUSED.values():
        answer = design(*data)
        assert not answer.success
        assert not answer.design.k
        assert any(each in answer.message for each in words.split('|')), answer.message


def test_random_systems_are_solved_or_refused(design: Any) -> None:
    """Accepted gains stabilise and are optimal; refused problems are hard; both cases occur."""
    accepted = []

    @settings(max_examples=150, deadline=None)
    @given(problems())
    def check_one(problem: Any) -> None:
        A, B, Qx, Qu = problem
        answer = design(*problem)
        accepted.append(answer.success)
        if not answer.success:
            assert answer.message.startswith('refused: '), answer.message
            assert is_hard(*problem), answer.message
            return
        P = check(answer, *problem)
        cost = cost_of(matrix(answer.design.k, B.shape[1]), A, B, Qx, Qu)
        assert np.abs(cost - P).max() <= 1e-2 * np.abs(P).max()

    check_one()
    assert 20 < sum(accepted) < len(accepted) - 20
