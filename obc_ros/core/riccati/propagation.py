# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Riccati propagation: solutions over intervals of time, joined by doubling.

A stretch is an interval of time of a linear quadratic problem, given by three matrices (A, G, H).
The state x at its start and the costate y at its end determine the state A x - G y at its end and
the costate H x + A'y at its start. With the terminal weight P, y = P x(end), and the minimum cost
is half of x'(H + A'P (I + G P)^-1 A) x. Two consecutive stretches are one stretch again, so that
each join doubles the horizon. With G, H and P positive semidefinite, the eigenvalues of I + G H
and I + G P are at least 1, however long the horizon and however unstable the plant.
"""

import numpy as np
from obc_ros.core.numerics.arrays import Array, linalg
from obc_ros.core.numerics.rounding import EPS, norm

Stretch = tuple[Array, Array, Array]

_LONGEST = 60  # doublings, which are 1e18 steps
_MOST_GROWTH = 30.0  # of the state over a joined stretch; rounding errors grow by its square
_SHORT = 0.5  # largest norm of the Hamiltonian matrix times the length of which expm is taken


def build_stretch(A: Array, G: Array, Q: Array, length: float) -> Stretch:
    """
    Return the stretch of dx/dt = A x - G y, dy/dt = -Q x - A'y over a length of time [s].

    The exponential of this Hamiltonian matrix is taken over a time so short that neither x nor y
    grows much; the result is doubled until the length is reached.
    """
    n = len(A)
    H = np.empty((2 * n, 2 * n))
    H[:n, :n], H[:n, n:], H[n:, :n], H[n:, n:] = A, -G, -Q, -A.T
    doublings = max(0, int(np.ceil(np.log2(max(norm(H) * length, 1e-300) / _SHORT))))
    flow = linalg.expm(H * (length * 0.5**doublings))
    back = np.linalg.inv(flow[n:, n:])
    stretch = (back.T, _symmetric(-flow[:n, n:] @ back), _symmetric(-back @ flow[n:, :n]))
    identity = np.eye(n)
    for _ in range(doublings):
        stretch = join_stretches(stretch, stretch, identity)
    return stretch


def join_stretches(first: Stretch, second: Stretch, identity: Array) -> Stretch:
    """Return the stretch of `first` followed by `second`; leading axes are batches."""
    A1, G1, H1 = first
    A2, G2, H2 = second
    n = len(identity)
    W = np.linalg.solve(identity + G1 @ H2, np.concatenate([A1, G1], axis=-1))
    moved, spread = W[..., :n], W[..., n:]
    G = G2 + A2 @ spread @ np.swapaxes(A2, -1, -2)
    H = H1 + np.swapaxes(A1, -1, -2) @ H2 @ moved
    return A2 @ moved, _symmetric(G), _symmetric(H)


def propagate_back(stretch: Stretch, P: Array) -> Array:
    """Return the cost matrices (N, n, n) at the start of a stretch for those at its end."""
    A, G, H = stretch
    count, n, _ = P.shape
    rows = P.reshape(-1, n)  # one matrix product for the whole batch
    inner = (rows @ G).reshape(count, n, n)
    inner.reshape(count, -1)[:, ::n + 1] += 1.0
    Y = np.linalg.solve(inner, (rows @ A).reshape(count, n, n))
    moved = (np.swapaxes(Y, 1, 2).reshape(-1, n) @ A).reshape(count, n, n)
    return _symmetric(moved + H)


def build_doublings(stretch: Stretch, steps: int) -> list[Stretch]:
    """
    Return the stretches of 1, 2, 4, ... steps, at most `steps`.

    Doubling ends before digits would be lost: with unstable modes that are unobservable in the
    cost, and near a conjugate point if H is indefinite.
    """
    found, identity, convex = [stretch], np.eye(len(stretch[0])), is_convex(stretch)
    while 2**len(found) <= steps and (convex or is_apart(found[-1])):
        longer = join_stretches(found[-1], found[-1], identity)
        if not is_accurate_join(longer):
            break
        found.append(longer)
    return found


def propagate_steps_back(levels: list[Stretch], P: Array, steps: int) -> Array:
    """
    Return the cost matrices 0, 1, ..., `steps` steps before the end, shape (steps+1, n, n).

    Each of the `levels` from `build_doublings` propagates all matrices found so far at once.
    """
    found = np.empty((steps + 1, *P.shape))
    found[0] = P
    count = 1
    while count <= steps:
        level = min(count.bit_length(), len(levels)) - 1
        reach = 1 << level
        more = min(reach, steps + 1 - count)
        found[count:count + more] = propagate_back(
            levels[level], found[count - reach:count - reach + more])
        count += more
    return found


def is_convex(stretch: Stretch) -> bool:
    """Return whether the cost on a stretch, and thus on all joins of it, is convex."""
    return bool(np.linalg.eigvalsh(stretch[2])[0] >= 0.0)


def is_apart(stretch: Stretch) -> bool:
    """Return whether two consecutive such stretches are far from a conjugate point."""
    _, G, H = stretch
    return bool(np.linalg.eigvals(np.eye(len(H)) + G @ H).real.min() > 0.5)


def is_accurate_join(stretch: Stretch) -> bool:
    """Return whether the state grows by less than `_MOST_GROWTH` over a joined stretch."""
    return norm(stretch[0]) < _MOST_GROWTH * len(stretch[0])


def solve_inside(levels: list[Stretch], x: Array, P: Array, steps: int) -> tuple[Array, Array]:
    """
    Return states and costates along the optimal path, each of shape (steps + 1, n).

    A stretch joined from two stretches (A, G, H) has the state x at its start and the costate y''
    at its end. In its middle, x' = A x - G y' and y' = H x' + A'y''. The matrices are the same for
    all stretches of one length.

    :param levels: from `build_doublings`.
    :param x: (n,), state at the start.
    :param P: (n, n), terminal weight; the costate at the end is P x.
    :param steps: a multiple of those of the last level.
    """
    (A, G, H), identity = levels[-1], np.eye(len(x))
    reach = 1 << (len(levels) - 1)
    weights = propagate_steps_back(levels[-1:], P, steps // reach - 1)[::-1]
    X, Y = np.empty((2, steps + 1, len(x)))
    X[0] = x
    for k, weight in zip(range(reach, steps + 1, reach), weights, strict=True):
        X[k] = x = np.linalg.solve(identity + G @ weight, A @ x)
        Y[k] = weight @ x
    Y[0] = H @ X[0] + A.T @ Y[reach]
    halves = np.array(levels[:-1], np.float64).reshape(-1, 3, *P.shape)
    A, G, H = halves[:, 0], halves[:, 1], halves[:, 2]
    ahead = np.linalg.solve(identity + G @ H, np.concatenate([A, G @ np.swapaxes(A, 1, 2)], 2))
    for k in range(len(halves) - 1, -1, -1):
        half = reach // 2
        both = np.hstack([X[:-1:reach], -Y[reach::reach]])
        X[half::reach] = both @ ahead[k].T
        Y[half::reach] = X[half::reach] @ H[k] + Y[reach::reach] @ A[k]
        reach = half
    return X, Y


def double_horizon(A: Array, G: Array, H: Array) -> Array | None:
    """
    Return the limit of the minimum cost matrix as the horizon is doubled.

    The first horizon is the stretch (A, G, H). None if the matrix grows without bound or does not
    converge.
    """
    identity = np.eye(len(A))
    for _ in range(_LONGEST):
        A, G, H_next = join_stretches((A, G, H), (A, G, H), identity)
        step = norm(H_next - H)
        if not step < np.inf:
            return None
        H = H_next
        if step <= EPS * norm(H):
            return H
    return None


def _symmetric(M: Array) -> Array:
    half: Array = 0.5 * M
    return half + np.swapaxes(half, -1, -2)


def evaluate_before_end(A: Array, G: Array, Q: Array, P1: Array, to_go: Array) -> Array:
    """
    Return P (N, n, n) of -dP/dt = P A + A'P - P G P + Q, P = P1 at the end, at times before it.

    :param to_go: (N,), times before the end [s], decreasing, not negative.
    """
    P = P1 if to_go[-1] == 0.0 else propagate_back(build_stretch(A, G, Q, to_go[-1]), P1[None])[0]
    steps = len(to_go) - 1
    if not steps:
        return P[None].copy()
    lengths = -np.diff(to_go)[::-1]
    length = (to_go[0] - to_go[-1]) / steps
    if np.abs(lengths - length).max() <= 1e-12 * to_go[0]:
        return propagate_steps_back(build_doublings(build_stretch(A, G, Q, length), steps), P,
                                    steps)[::-1]
    found = np.empty((steps + 1, *P.shape))
    found[steps] = P
    known: dict[float, Stretch] = {}
    for k, length in enumerate(lengths.tolist()):
        if length not in known:
            known[length] = build_stretch(A, G, Q, length)
        found[steps - 1 - k] = propagate_back(known[length], found[steps - k][None])[0]
    return found
