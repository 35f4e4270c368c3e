# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Stabilisability and detectability of a plant, and the error messages."""

import math

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array, lapack
from obc_ros.core.numerics.rounding import EPS, TINY
from obc_ros.core.riccati.care import compute_balancing
from obc_ros.core.text.errors import RefusedDesignError

Modes = NDArray[np.complex128]

LARGEST_ERROR = 1e-4  # relative error of P; the gain then has four digits
TOO_FAR_APART = 'the entries of A, B, Qx and Qu differ too much in size for double precision'

# Distances to an unobservable pair, relative to the norm of A.
_LOST = 1e-8     # a mode is numerically unobservable
_EXACT = 1e-12   # the message does not say "numerically"
_UNSEEN = 1e-14  # an optimal gain is rejected, because it leaves the mode as it is


def explain_no_gain(A: Array, F: Array, Q: Array, *, stability: float = 0.0, period: float = 0.0,
                    error: float = math.nan, has_cross: bool = False) -> str:
    """
    Explain why no gain with verified stability was found.

    :param A, F, Q: (n, n), (n, m), (n, n), dx/dt = A x + F u (or x+ = A x + F u) with the cost x'Q
        x + u'u; A and F contain the shift by `stability`.
    :param error: relative error of the Riccati solution; nan: there is no solution.
    :param has_cross: whether the cost has a cross term N, so that A is A - B Qu^-1 N'.
    """
    unit = A, F / np.maximum(np.linalg.norm(F, axis=0), TINY), Q  # without the weights of inputs
    A, F, Q = _balanced(A, F, Q)
    if not np.isfinite(np.array([np.linalg.norm(M) for M in (A, F @ F.T, Q)])).all():
        return TOO_FAR_APART
    modes, word = _find_lost(A.T, F.T, period)
    if modes.size:
        A, F, _ = _balanced(*unit)
        by_weights = not _unobservable(A.T, F.T, _LOST, period).size
        word = 'numerically ' if by_weights else word
        return _explain(modes, '(A, B)', f'{word}not stabilisable'
                        + ' at these weights' * by_weights, f'is {word}uncontrollable',
                        stability, period) + (
            '; use entries of Qu of more similar size' if by_weights else '')
    modes, word = _find_lost(A, Q, period)
    if modes.size:
        return _explain(modes, _pair(has_cross), f'{word}not detectable',
                        'does not appear in the cost', stability, period) + '; add a weight'
    if error > LARGEST_ERROR:
        return (f'the Riccati equation is too ill-conditioned: the estimated relative rounding '
                f'error of P is {min(error, 1.0):.1g}; use weights of more similar size')
    return ('stability of the closed loop cannot be verified: rounding errors alone may make a '
            'mode unstable; use weights of more similar size'
            + (', or a smaller degree of stability' if stability else ''))


def check_detectable(A: Array, F: Array, Q: Array, *, stability: float = 0.0,
                     period: float = 0.0, has_cross: bool = False) -> None:
    """
    Raise RefusedDesignError if a mode of A that does not decay is not in the cost.

    The parameters are those of `explain_no_gain`.
    """
    A, _, Q = _balanced(A, F, Q)
    modes = _unobservable(A, Q, _UNSEEN, period)
    if modes.size:
        raise RefusedDesignError(_explain(
            modes, _pair(has_cross), 'not detectable', 'does not appear in the cost', stability,
            period) + '; add a weight')


def explain_no_estimator(A: Array, C: Array, Qw: Array, outputs: tuple[str, ...], *,
                         period: float = 0.0) -> str:
    """
    Name the modes that no estimator follows; empty if there are none.

    :param A, C, Qw: (n, n), (q, n), (n, n), dx/dt = A x + w (or x+ = A x + w), y = C x + v; Qw is
        the covariance of w.
    """
    rows = C / np.maximum(np.linalg.norm(C, axis=1), TINY)[:, None]
    A, F, Q = _balanced(A.T, rows.T, Qw)   # the dual plant
    A, C = A.T, F.T
    modes, word = _find_lost(A, C, period)
    if modes.size:
        return _explain(modes, '(A, C)', f'{word}not detectable',
                        f'cannot be seen in {", ".join(outputs)}', 0.0, period) + (
            '; measure another output')
    modes = _unobservable(A.T, Q.T, _UNSEEN, period)
    if modes.size:
        return _explain(modes, '(A, Qw)', 'not stabilisable', 'is not driven by Qw', 0.0,
                        period) + '; add process noise to it'
    return ''


def _pair(has_cross: bool) -> str:
    # With N the pair is (A - B Qu^-1 N', Qx - N Qu^-1 N'), which nobody has written down.
    return 'the plant with this cost' if has_cross else '(A, Qx)'


def _balanced(A: Array, F: Array, Q: Array) -> tuple[Array, Array, Array]:
    d = compute_balancing(A, F, Q)
    return A * (d / d[:, None]), F / d[:, None], Q * (d * d[:, None])


def _find_lost(A: Array, C: Array, period: float) -> tuple[Modes, str]:
    """Return `_unobservable` modes, and the word for those that are so only numerically."""
    modes = _unobservable(A, C, _LOST, period)
    is_exact = not modes.size or _unobservable(A, C, _EXACT, period).size == modes.size
    return modes, '' if is_exact else 'numerically '


def _unobservable(A: Array, C: Array, tolerance: float, period: float) -> Modes:
    """
    Return the modes of A that do not decay and are unobservable through C (docs/regulator.md).

    The test is restricted to the invariant subspace of the modes that do not decay. C is scaled to
    the norm of A, and `tolerance` is relative to that norm.
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


def _explain(modes: Modes, pair: str, verdict: str, reason: str, stability: float, period: float
             ) -> str:
    """Return the verdict on a pair with the modes, each named once, without the shift."""
    names: list[str] = []
    for mode in modes:
        shifted = mode * math.exp(-stability * period) if period else mode - stability
        re, im = shifted.real + 0.0, abs(shifted.imag)
        if abs(re) < 1e-12 * abs(mode):
            re = 0.0
        name = ('z = ' if period else 's = ') + (f'{re:+.4g}' if re else '0')
        if im:
            name += f' +- {im:.4g}j'
        if name not in names:
            names.append(name)
    what = 'mode'
    if len(names) > 1:
        what, reason = 'modes', reason.replace('is ', 'are ', 1).replace('does ', 'do ', 1)
    if period:
        pair = f'the sampled {pair.removeprefix("the ")}'
    degree = f' with the degree of stability {stability:g} 1/s' if stability else ''
    return f'{pair} is {verdict}{degree}: the {what} {" and ".join(names)} {reason}'
