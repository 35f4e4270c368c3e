# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Which modes of a plant stand in the way of a regulator, and the words for it."""

import math

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.rounding import EPS, TINY
from obc_ros.core.riccati.care import compute_balancing
from scipy.linalg import lapack

Modes = NDArray[np.complex128]

LARGEST_ERROR = 1e-4  # of P; one in the fourth digit of the gain
TOO_FAR_APART = 'A, B, Qx and Qu are too far apart in size for double precision'

_UNSEEN = 1e-14  # relative distance to an unobservable pair at which a mode counts as unseen


def explain_no_gain(A: Array, F: Array, Q: Array, *, stability: float = 0.0, period: float = 0.0,
                    error: float = math.nan) -> str:
    """
    Say why there is no stabilising gain that can be proved.

    Parameters
    ----------
    A, F, Q : ndarray, shape (n, n), (n, m), (n, n)
        dx/dt = A x + F u (or x+ = A x + F u) with the cost x'Q x + u'u; `stability` is in A and F.
    stability : float
        The degree of stability wanted [1/s].
    period : float
        Sampling period [s]; 0: continuous time.
    error : float
        Relative error of the solution of the Riccati equation; nan when there is none.

    """
    alike = A, F / np.maximum(np.linalg.norm(F, axis=0), TINY), Q  # inputs that cost the same
    A, F, Q = _balanced(A, F, Q)
    if not np.isfinite(np.array([np.linalg.norm(M) for M in (A, F @ F.T, Q)])).all():
        return TOO_FAR_APART
    lost = _out_of_reach(A, F, period)
    if lost.size:
        near = not _out_of_reach(*_balanced(*alike)[:2], period).size
        return _clause(lost, 'all but out of reach of the inputs at these weights; bring those of '
                       'Qu closer together' if near else 'out of reach of the inputs',
                       stability, period)
    unseen = _lost(A, Q, 1e-8, period)
    if unseen.size:
        return _clause(unseen, 'not seen by Qx; give it a weight', stability, period)
    if error > LARGEST_ERROR:
        return (f'the Riccati equation is too ill-conditioned: rounding leaves P uncertain by '
                f'{min(error, 1.0):.1g} of its size; bring the weights closer together')
    return ('no gain can be proved to stabilise: rounding alone may put a mode of the closed loop '
            'on the border of stability; bring the weights closer together'
            + (', or ask for less than this degree of stability' if stability else ''))


def name_undetectable_modes(A: Array, F: Array, Q: Array, *, stability: float = 0.0,
                            period: float = 0.0) -> str:
    """
    Name the modes of A that do not decay and that the cost does not see; empty when there is none.

    The parameters are those of `explain_no_gain`.
    """
    A, _, Q = _balanced(A, F, Q)
    modes = _lost(A, Q, _UNSEEN, period)
    if not modes.size:
        return ''
    return _clause(modes, 'not seen by Qx: the least cost leaves it as it is; give it a weight',
                   stability, period)


def _balanced(A: Array, F: Array, Q: Array) -> tuple[Array, Array, Array]:
    d = compute_balancing(A, F, Q)
    return A * (d / d[:, None]), F / d[:, None], Q * (d * d[:, None])


def _out_of_reach(A: Array, F: Array, period: float) -> Modes:
    return _lost(A.T, F.T, 1e-8, period)


def _lost(A: Array, C: Array, tolerance: float, period: float) -> Modes:
    """
    Return the modes of A that do not decay and that C does not see.

    A mode s is seen when the smallest singular value of [A - s I; C], C scaled to the norm of A,
    is above `tolerance` times that norm (the test of Popov, Belevitch and Hautus). Only the
    invariant subspace of such modes is looked at.
    """
    n = len(A)
    size = max(float(np.linalg.norm(A)), 1e-300)
    slack = n * EPS * size

    def lasts(re: float, im: float) -> bool:
        return math.hypot(re, im) >= 1.0 - slack if period else re >= -slack

    T, k, wr, wi, U, _, _ = lapack.dgees(lasts, A, sort_t=1)
    T = T[:k, :k] / size
    seen = np.asarray(np.linalg.qr(C @ U[:, :k], mode='r'))
    seen = seen / max(float(np.linalg.norm(C)), 1e-300)
    modes = (wr + 1j * wi)[:k]
    distances = [np.linalg.svd(np.vstack([T - mode / size * np.eye(k), seen]), compute_uv=False)
                 for mode in modes]
    lost: Modes = modes[[values[-1] < tolerance for values in distances]]
    return lost


def _clause(modes: Modes, text: str, stability: float, period: float) -> str:
    """Say something of modes of A, named once each without `stability`; of a pair one is named."""
    names: list[str] = []
    for mode in modes:
        shifted = mode * math.exp(-stability * period) if period else mode - stability
        re, im = shifted.real + 0.0, abs(shifted.imag)
        if abs(re) < 1e-12 * abs(mode):
            re = 0.0
        name = f'{re:+.4g}' if im == 0.0 else f'{re:+.4g} +- {im:.4g}j'
        if name not in names:
            names.append(name)
    what = 'mode' if len(names) == 1 else 'modes'
    verb = 'is' if len(names) == 1 else 'are'
    of = 'the sampled A' if period else 'A'
    wanted = f' and a degree of stability of {stability:g} is wanted' if stability else ''
    return f'the {what} at {" and ".join(names)} of {of} {verb} {text}{wanted}'
