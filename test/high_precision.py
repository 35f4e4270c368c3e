# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Riccati solutions with 80 digits, by formulas that lose accuracy in double precision."""

import decimal

import numpy as np

decimal.getcontext().prec = 80


def exact(M):
    """Return a matrix of floats as decimals, without rounding."""
    return np.array([[decimal.Decimal(float(value)) for value in row] for row in np.atleast_2d(M)])


def solve(M, right):
    """Return M^-1 right by Gaussian elimination with pivoting."""
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
    """Return exp(M) by scaling, series and squaring."""
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
    A, B, Q, R, P1 = exact(A), exact(B), exact(Q), exact(R), exact(P1)
    return _riccati(A, B.dot(solve(R, B.T)), Q, P1, to_go).astype(float)


def _riccati(A, G, Q, P1, to_go):
    n = len(A)
    H = np.concatenate([np.concatenate([A, -G], axis=1), np.concatenate([-Q, -A.T], axis=1)])
    X = exponential(-H * decimal.Decimal(float(to_go))).dot(
        np.concatenate([exact(np.eye(n)), P1]))
    return solve(X[:n].T, X[n:].T).T


def riccati_condition(A, B, Q, P1, to_go):
    """
    Return the mixed condition numbers of P and of K = B'P, Qu = 1 (Gohberg and Koltracht 1993).

    The number c is the minimum for which max|dP| <= c e max|P| to first order, for all relative
    changes up to e of the entries of A, G = BB', Q and P1 (symmetric ones in pairs), and of B
    for K: c = max over P of sum |dP/dd| |d| over the data d, divided by max|P|. Derivatives are
    differences with a step of 1e-25 in 80 digits.
    """
    step, B = decimal.Decimal(10)**-25, exact(B)
    data = [exact(A), B.dot(B.T), exact(Q), exact(P1)]
    P = _riccati(*data, to_go)
    of_P, of_K = np.zeros(P.shape), (abs(B.T)).dot(abs(P)).astype(float)
    for number, M in enumerate(data):
        for i, j in zip(*np.nonzero(M != 0), strict=True):
            if number and i > j:
                continue
            old = M[i, j]
            M[i, j] = old * (1 + step)
            if number:
                M[j, i] = M[i, j]
            change = (_riccati(*data, to_go) - P) / step
            M[i, j] = old
            if number:
                M[j, i] = old
            of_P += abs(change).astype(float)
            of_K += abs(B.T.dot(change)).astype(float)
    return (of_P.max() / abs(P.astype(float)).max(),
            of_K.max() / abs(B.T.dot(P).astype(float)).max())
