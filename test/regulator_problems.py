# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Random problems of the linear quadratic regulator, and their cost."""

from hypothesis import strategies as st
import numpy as np
from scipy.linalg import solve_continuous_are


@st.composite
def problems(draw, largest_spread=6.0):
    """Draw a plant and weights over many decades, both well and ill-conditioned."""
    n, m = draw(st.integers(1, 7)), draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    spread = draw(st.sampled_from([0.0, 1.0, 3.0, largest_spread]))
    A = rng.standard_normal((n, n)) * 10 ** rng.uniform(-spread, spread, (n, n))
    B = rng.standard_normal((n, m)) * 10 ** rng.uniform(-spread, spread, m)
    A[rng.random((n, n)) < draw(st.sampled_from([0.0, 0.5]))] = 0.0
    rank = draw(st.integers(0, n))
    H = rng.standard_normal((rank, n)) * 10 ** rng.uniform(-spread, spread, n)
    Qu = np.diag(10 ** rng.uniform(-spread, spread, m))
    return A, B, H.T @ H, Qu


def cost_of(K, A, B, Qx, Qu):
    """Return P of M'P + P M + Qx + K'Qu K = 0 by a Kronecker product in scaled coordinates."""
    d = 1.0 / np.sqrt(np.abs(K.T @ Qu @ K + Qx).diagonal() + 1e-300)
    M, Q = (A - B @ K) * (d / d[:, None]), (Qx + K.T @ Qu @ K) * (d * d[:, None])
    n = len(A)
    kronecker = np.kron(M.T, np.eye(n)) + np.kron(np.eye(n), M.T)
    P = np.linalg.solve(kronecker, -Q.ravel()).reshape(n, n)
    return P / (d * d[:, None])


def is_hard(A, B, Qx, Qu):
    """
    Return whether the design may be impossible to verify.

    A mode is (nearly) uncontrollable or undetectable, the Hamiltonian matrix has an eigenvalue
    near the imaginary axis, or the data determine P only to a few digits.
    """
    n = len(A)
    H = np.block([[A, -B @ np.linalg.solve(Qu, B.T)], [-Qx, -A.T]])
    if abs(np.linalg.eigvals(H).real).min() <= 1e-4 * abs(H).max():
        return True
    for s in np.linalg.eigvals(A):
        if s.real > -1e-4 * abs(A).max():
            for M in (np.vstack([A - s * np.eye(n), Qx]), np.vstack([(A - s * np.eye(n)).T, B.T])):
                values = np.linalg.svd(M, compute_uv=False)
                if values[-1] <= 1e-4 * values[0]:
                    return True
    rng = np.random.default_rng(0)
    try:
        P = solve_continuous_are(A, B, Qx, Qu)
        near = solve_continuous_are(A * (1 + 1e-12 * rng.standard_normal(A.shape)), B, Qx, Qu)
    except np.linalg.LinAlgError:
        return True
    return abs(near - P).max() > 1e-10 * abs(P).max()
