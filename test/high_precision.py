# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Riccati solutions with 80 digits, by the textbook formulas that lose digits in double."""

import decimal

import numpy as np

decimal.getcontext().prec = 80


def exact(M):
    """Return a matrix of floats as decimals, digit for digit."""
    return np.array([[decimal.Decimal(float(value)) for value in row] for row in np.atleast_2d(M)])


def solve(M, right):
    """Return M^-1 right by elimination with pivots."""
    rows = np.concatenate([M, right], axis=1)
    n = len(M)
    for k in range(n):
        pivot = k + int(np.argmax([abs(value) for value in rows[k:, k]]))
        rows[[k, pivot]] = rows[[pivot, k]]
        rows[k] = rows[k] / rows[k, k]
        for i in range(n):
            if i != k:
                rows[i] = rows[i] - rows[i, k] * rows[k]
    return rows[:, n:]


def exponential(M):
    """Return exp(M) by its series and squaring."""
    halvings = max(0, int(np.ceil(np.log2(float(max(abs(value) for value in M.ravel())) + 1)))) + 4
    small = M / decimal.Decimal(2**halvings)
    term = total = exact(np.eye(len(M)))
    k = 0
    while max(abs(value) for value in term.ravel()) > decimal.Decimal(10)**-75:
        k += 1
        term = term.dot(small) / k
        total = total + term
    for _ in range(halvings):
        total = total.dot(total)
    return total


def riccati(A, B, Q, R, P1, to_go):
    """Return P(T - to_go) as floats: P = X2 X1^-1 for (X1, X2) = exp(-H to_go) (I, P1)."""
    n = len(A)
    A, B, Q, R, P1 = exact(A), exact(B), exact(Q), exact(R), exact(P1)
    G = B.dot(solve(R, B.T))
    H = np.concatenate([np.concatenate([A, -G], axis=1), np.concatenate([-Q, -A.T], axis=1)])
    X = exponential(-H * decimal.Decimal(float(to_go))).dot(
        np.concatenate([exact(np.eye(n)), P1]))
    return solve(X[:n].T, X[n:].T).T.astype(float)
