# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Real modes of a linear system with bounded inputs that never meet a target.

For a left eigenvector w of A with real eigenvalue sigma, y = w'x satisfies the scalar equation
y' = sigma y + gamma + rho v, |v| <= 1. If y cannot rise at t = 0 it never rises above y(0). If
sigma < 0, y stays below its equilibrium for v = 1. The same holds downwards.
"""

from math import inf

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.wording import describe_sum
from obc_ros.core.solver.exact.reachable_set import Reach

_ACCURACY = 1e-9   # relative accuracy of eigenvectors and of comparisons that use them


def explain_unreachable_mode(states: tuple[str, ...], reach: Reach) -> str | None:
    """
    Return a sentence if a real mode of A keeps the terminal constraints from ever being met.

    The rows of `reach.C` are independent; `states` are the names of the states.
    """
    for sigma, w in _modes(reach.A, reach.B):
        y, *_ = np.linalg.lstsq(reach.C.T, w, rcond=None)
        if np.abs(reach.C.T @ y - w).max() > _ACCURACY:
            continue
        sentence = _mode(_combination(states, w), sigma, w, reach, float(y @ reach.d))
        if sentence:
            return sentence
    return None


def _modes(A: Array, B: Array) -> list[tuple[float, Array]]:
    """Return real eigenvalues and left eigenvectors, first those on which no input acts."""
    values = np.linalg.eigvals(A)
    real = [float(v.real) for v in values if abs(v.imag) <= _ACCURACY * (1 + abs(v))]
    n = len(A)
    found = []
    for blocks in (B.T, np.zeros((0, n))):
        for sigma in dict.fromkeys(real):
            _, sizes, V = np.linalg.svd(np.vstack((A.T - sigma * np.eye(n), blocks)))
            null = V[sizes <= _ACCURACY * max(1.0, sizes[0])]
            found += [(sigma, w / w[np.argmax(np.abs(w) > 0.99 * np.abs(w).max())]) for w in null]
    return found


def _mode(name: str, sigma: float, w: Array, reach: Reach, wanted: float) -> str | None:
    start = float(w @ reach.x0)
    gamma, rho = float(w @ reach.c), float(np.abs(w @ reach.B).sum())
    small = _ACCURACY * (abs(sigma) * abs(start) + abs(gamma) + rho + 1e-300)
    for sign, verb in ((1.0, 'rise above'), (-1.0, 'fall below')):
        y, drift, goal = sign * start, sign * gamma, sign * wanted
        limit = y if sigma * y + drift + rho <= small else -(drift + rho) / sigma if (
            sigma < 0) else inf
        if goal > limit + _ACCURACY * (abs(y) + abs(limit) + abs(goal)) or (
                limit < inf and limit != y and goal >= limit):
            reason = (f'the unstable mode of eigenvalue {sigma:.6g} grows faster than the '
                      'inputs can counteract' if sigma > 0 and limit == y else
                      'the inputs are too weak' if rho > 0 else 'no input acts on it')
            return (f'{name} cannot {verb} {sign * limit:.6g} but must be {wanted:.6g} at T: '
                    f'{reason}')
    return None


def _combination(states: tuple[str, ...], w: Array) -> str:
    """Return w'x as text; its largest coefficient is 1."""
    return describe_sum(((name, weight) for name, weight in zip(states, w, strict=True)
                         if abs(weight) > _ACCURACY), ' ')
