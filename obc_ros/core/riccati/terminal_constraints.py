# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The optimal path of a linear quadratic problem with affine terms and terminal constraints.

The state is extended to z = (x, 1, nu) with the multipliers nu of C x(T) = d, which are constant.
Affine terms and terminal constraints are then quadratic in z, and one matrix P(t) contains the
value function z'P z / 2, which is minimal in u and stationary in nu:

    -dP/dt = P A + A'P - P G P + Q, P(T) = [[P1, p1, C'], [p1', 0, -d'], [C, -d, 0]]
    P_nunu nu = -(P_nux x0 + P_nu1)

The terminal weight c_i (C x(T) - d)_i^2 / 2 is added. It vanishes where C x(T) = d, but makes the
feedback stabilising before T, so that no digits are lost over a long horizon.
"""

import math

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.numerics.arrays import Array, integrate, lapack, linalg
from obc_ros.core.numerics.rounding import norm, TINY
from obc_ros.core.ocp.solution import Optimality, Solution, Status
from obc_ros.core.ocp.wording import describe_sum
from obc_ros.core.riccati import propagation
from obc_ros.core.riccati.care import compute_balancing
from obc_ros.core.riccati.first_order_hold import (
    evaluate_hamiltonian,
    evaluate_running_cost,
    Extended,
    Feedback,
    follow_feedback,
    LqForm,
)

Places = NDArray[np.intp]
SampledPath = tuple[Array, Array, Array, Array, Array, float]

_UNREACHED = 1e-12  # relative controllability below which a direction is uncontrollable
_MISSED = 1e-8      # relative residual at which a terminal constraint counts as met
_ROUNDING = 1e-9    # relative size below which a product may be rounding error
_DEFECT = 3e-7      # of the dynamics with piecewise linear u, after growth until T, all intervals
_LARGEST_DEFECT = 6e-7  # before growth; accepted at the largest number of samples
_MOST_GROWTH = 30.0  # of a defect until T that is accounted for
_FEWEST, _MOST = 64, 32768  # samples of the optimal path: in a block, in all blocks
_MOST_HALVINGS = 24
_LARGEST_TABLE = 4e5        # samples times entries of P(t); beyond it `follow_feedback` is used
_MOST_STEPS = 20000         # of the search for a conjugate point


class _NoAnswerError(Exception):
    """No optimal path was found; `solution` reports the reason."""

    def __init__(self, status: Status, message: str) -> None:
        super().__init__(message)
        self.solution = Solution(status, message, method='riccati')


def solve_form(form: LqForm, x0: Array, T: float, names: tuple[str, ...]) -> Solution:
    """
    Return the optimal path from x0 over T seconds, or the reason why there is none.

    :param names: names of the states, for messages.
    :return: its status is SOLVED; INFEASIBLE if the input does not affect a terminal constraint
        that is not met; NOT_CONVERGED if the cost has no minimum or rounding hides the effect of
        the input on the terminal constraints.
    """
    try:
        with np.errstate(over='ignore', invalid='ignore'):
            extended = _extended(form, T)
        _require_finite(extended.A, extended.G, extended.Q, extended.P1)
        P1, unit = _terminal_weight(extended, T)
        x, u, lam, t, nu, value = _path(extended, P1, unit, x0, T, names)
    except _NoAnswerError as no_answer:
        return no_answer.solution
    return Solution(
        Status.SOLVED, 'the closed form by the Riccati differential equation',
        objective=value, t=t, x=x, u=u, lam=lam,
        hamiltonian=evaluate_hamiltonian(form, x, u, lam)[1], nu=nu, method='riccati',
        optimality=Optimality('global', 'linear quadratic'))


def _require_finite(*arrays: Array) -> None:
    if not all(np.isfinite(each).all() for each in arrays):
        raise _NoAnswerError(Status.NOT_CONVERGED, (
            'the closed form overflows: choose units in which the numbers are closer to 1'))


def _extended(form: LqForm, T: float) -> Extended:
    n, q = len(form.A), len(form.C)
    right = np.linalg.solve(form.R, np.column_stack([form.N.T, form.r]))
    A = form.A - form.B @ right[:, :n]
    a = form.a - form.B @ right[:, n]
    Q = form.Q - form.N @ right[:, :n]
    linear = form.q - form.N @ right[:, n]
    L = lapack.dpotrf(form.R, lower=1)[0]
    F = lapack.dtrtrs(L, form.B.T, lower=1)[0].T
    d = compute_balancing(A, F, Q)
    A, F, Q, C = A * (d / d[:, None]), F / d[:, None], Q * (d * d[:, None]), form.C * d
    G = F @ F.T
    row = np.linalg.norm(C, axis=1)
    row[row == 0.0] = 1.0
    # Without a time constant of the plant, as for an integrator, that of the horizon counts.
    speed = max(norm(A) + math.sqrt(norm(G) * norm(Q)), 1.0 / T)
    one = max(norm(a / d), norm(linear * d)) / speed or 1.0
    A_z, G_z, Q_z, P1 = np.zeros((4, n + 1 + q, n + 1 + q))
    A_z[:n, :n], A_z[:n, n] = A, a / d / one
    G_z[:n, :n] = G
    Q_z[:n, :n] = 0.5 * (Q + Q.T)
    Q_z[:n, n] = Q_z[n, :n] = linear * d / one
    P1[:n, :n] = form.P1 * (d * d[:, None])
    P1[:n, n] = P1[n, :n] = form.p1 * d / one
    rows = P1[n + 1:]
    rows[:, :n], rows[:, n] = C / row[:, None], -form.d / row / one
    P1[:, n + 1:] = rows.T
    return Extended(form, A_z, G_z, Q_z, P1, C=rows, scale=d, one=one, row=row)


def _terminal_weight(extended: Extended, T: float) -> tuple[Array, Array]:
    """
    Return P(T) with the weights c of the terminal constraints, and the square roots of c.

    A weight is the inverse of the controllability Gramian of its constraint over a short time. A
    problem that is not convex may be convex on C x(T) = d; larger weights then make it convex.
    """
    A, G, Q, P1 = extended.x_block
    C = extended.C[:, :extended.n]
    short = min(T, 3.0 / (norm(A) + math.sqrt(norm(G) * norm(Q)) + TINY))
    reached = np.zeros(len(C))
    while len(C):
        spread = propagation.build_stretch(A, G, np.zeros_like(Q), short)[1]
        share = np.einsum('ij,jk,ik->i', C, spread, C) / max(norm(spread), TINY)
        reached = np.where(share > _UNREACHED, share * norm(spread), 0.0)
        if share.min() > 1e-6 or short >= T:
            break
        short = min(T, 2.0 * short)
    c = np.divide(1.0, reached, out=np.zeros(len(C)), where=reached > 0.0)
    convex = _is_semidefinite(Q) and _is_semidefinite(P1)
    for _ in range(6):
        if convex or _has_minimum(A, G, Q, P1 + C.T @ (c[:, None] * C), T):
            full = extended.C
            return extended.P1 + full.T @ (c[:, None] * full), np.sqrt(c)
        if not c.any():
            break
        c = 100.0 * c
    raise _NoAnswerError(Status.NOT_CONVERGED, (
        'the cost has no minimum: the horizon contains a conjugate point, beyond which the cost '
        'is unbounded below'))


def _is_semidefinite(M: Array) -> bool:
    return bool(np.linalg.eigvalsh(M)[0] >= -1e-12 * norm(M))


def _has_minimum(A: Array, G: Array, Q: Array, P: Array, T: float) -> bool:
    """Return whether P is finite from T to 0: the eigenvalues of I + G P remain positive."""
    speed = norm(A) + norm(G) + norm(Q)
    steps = max(1, min(_MOST_STEPS, math.ceil(4.0 * T * speed)))
    stretch = propagation.build_stretch(A, G, Q, T / steps)
    sizes, vectors = np.linalg.eigh(stretch[1])
    root = vectors * np.sqrt(np.maximum(sizes, 0.0))
    for _ in range(steps):
        if np.linalg.eigvalsh(np.eye(len(A)) + root.T @ P @ root)[0] <= 1e-12:
            return False
        P = propagation.propagate_back(stretch, P[None])[0]
    return True


def _path(extended: Extended, P1: Array, unit: Array, x0: Array, T: float,
          names: tuple[str, ...]) -> SampledPath:
    """
    Return x, u, lam, t, nu and the cost.

    They are samples of the optimal path, dense enough for linear interpolation of u. If that needs
    too many samples, as for stiff plants, they are samples of the path under a piecewise linear u.
    """
    form, blocks = extended.form, _blocks(extended, T)
    start = np.append(x0 / extended.scale, extended.one)
    feedback = Feedback(extended, P1, blocks)
    P0 = feedback.costs(0)[0]
    _require_finite(P0)
    nu = _multipliers(extended, P0, unit, start, T, names)
    z = np.append(start, nu)
    most = min(_MOST, _LARGEST_TABLE / len(P1)**2) / len(blocks)
    count, largest = _FEWEST, 2 ** int(math.log2(max(most, _FEWEST)))
    while most >= _FEWEST:
        path, error, defect = _samples(feedback, z, count)
        if error <= _DEFECT or count == largest and defect <= _LARGEST_DEFECT:
            return path
        # Halving the steps divides both the error and the defect by 4.
        wanted = count * 2 ** max(1, math.ceil(0.5 * math.log2(max(error / _DEFECT, 1.0))))
        finer = min(wanted, largest)
        if count == largest or defect * (count / finer)**2 > _LARGEST_DEFECT:
            break
        count = finer
    held = follow_feedback(feedback, start[:-1], nu)
    if held is None:
        return _samples(feedback, z, largest)[0]
    rest = form.cost - 0.5 * float(form.r @ np.linalg.solve(form.R, form.r))
    value = 0.5 * float(z @ P0 @ z) + rest * T + form.terminal_cost
    return held.x, held.u, held.lam, held.t, held.nu / extended.row, value


def _spent(form: LqForm, t: Array, x: Array, u: Array) -> float:
    """
    Return the cost of the sampled optimal path, by Romberg integration in each block.

    z'P z / 2 is equal to the cost, but suffers from cancellation: where little is spent to meet
    the terminal constraints, it is a difference of terms that are larger by orders of magnitude.
    """
    L = evaluate_running_cost(form, x, u)
    running = np.array([
        integrate.romb(*block) for block in zip(L, t[:, 1] - t[:, 0], strict=True)])
    end = x[-1, -1]
    return float(running.sum() + 0.5 * end @ form.P1 @ end + form.p1 @ end + form.terminal_cost)


def _samples(feedback: Feedback, z: Array, count: int) -> tuple[SampledPath, float, float]:
    """Return samples of the optimal path, of `count` in each block, and `_thinned`'s errors."""
    extended, form = feedback.extended, feedback.extended.form
    t, path, costates = feedback.samples(z, round(math.log2(count)))
    x = path[..., :extended.n] * extended.scale
    lam = costates[..., :extended.n] / extended.scale
    right = lam @ form.B + x @ form.N + form.r
    u = -np.linalg.solve(form.R, right.reshape(-1, form.B.shape[1]).T).T
    u = np.asarray(u, np.float64).reshape(right.shape)
    kept, error, defect = _thinned(form, t, x, u)
    nu = z[extended.n + 1:] / extended.row
    return (x[kept], u[kept], lam[kept], t[kept], nu, _spent(form, t, x, u)), error, defect


def _blocks(extended: Extended, T: float) -> list[tuple[float, float]]:
    """Divide the horizon into blocks, halved towards both ends down to layers of 1 / speed."""
    A, G, Q, _ = extended.x_block
    speed = norm(A) + math.sqrt(norm(G) * norm(Q))
    halvings = min(_MOST_HALVINGS, max(0, math.ceil(math.log2(max(T * speed / 4.0, 1.0)))))
    ends = [T * 0.5**k for k in range(halvings, 0, -1)]
    times = [0.0, *ends, *(T - end for end in reversed(ends[:-1])), T]
    return list(zip(times[:-1], times[1:], strict=True))


def _multipliers(extended: Extended, P0: Array, unit: Array, start: Array, T: float,
                 names: tuple[str, ...]) -> Array:
    """Solve P_nunu nu = -(P_nux x0 + P_nu1)."""
    n1 = extended.n + 1
    if len(P0) == n1:
        return np.zeros(0)
    miss = P0[n1:, :n1] @ start
    size = np.abs(P0[n1:, :n1]) @ np.abs(start)
    unit = np.where(unit > 0.0, unit, 1.0 / np.maximum(size, TINY))
    reach = -P0[n1:, n1:] * (unit * unit[:, None])
    reach[unit == 0.0] = 0.0
    shares, ways = np.linalg.eigh(reach)
    for share, way in zip(shares, ways.T, strict=True):
        if share > _UNREACHED:
            continue
        if abs(way @ (unit * miss)) > _MISSED * (np.abs(way) @ (unit * size)):
            if _is_moved(extended, way * unit):
                raise _NoAnswerError(Status.NOT_CONVERGED, (
                    f'within T = {T:g} the effect of the input on the terminal constraints is '
                    'below the rounding error: choose T, or the unit of time, closer to the time '
                    'constants of the system'))
            raise _NoAnswerError(Status.INFEASIBLE, _out_of_reach(
                extended, way * unit, float(way @ (unit * miss)), T, names))
    open_ways = ways[:, shares > _UNREACHED]
    inner = open_ways.T @ (unit * miss) / shares[shares > _UNREACHED]
    nu: Array = unit * (open_ways @ inner)
    return nu


def _is_moved(extended: Extended, way: Array) -> bool:
    """Return whether the input affects a combination of constraints or a derivative of it."""
    A, G, *_ = extended.x_block
    row = (way @ extended.C)[:extended.n]
    size = np.abs(way) @ np.abs(extended.C)[:, :extended.n]
    for _ in range(extended.n):
        moved, most = np.abs(row @ G), size @ np.abs(G)
        if np.any(moved > _ROUNDING * most):
            return True
        row, size = row @ A, size @ np.abs(A)
        row, size = (part / max(float(size.max()), TINY) for part in (row, size))
    return False


def _out_of_reach(extended: Extended, way: Array, miss: float, T: float, names: tuple[str, ...]
                  ) -> str:
    """Return a message that names the combination of states that the input does not affect."""
    n = extended.n
    along = way @ extended.C
    if abs(along[:n]).max() <= 1e-12 * (abs(way) @ abs(extended.C[:, :n])).max():
        return 'the terminal constraints cannot be met: they contradict each other'
    coefficients = along[:n] / extended.scale
    unit = coefficients[np.abs(coefficients).argmax()]
    wanted = 0.0 - along[n] * extended.one / unit
    there = wanted + miss / unit
    if abs(there) < 1e-12 * abs(wanted):
        there = 0.0
    text = describe_sum(((name, value) for name, value in zip(
        names, coefficients / unit, strict=True) if abs(value) > 1e-9), ' ')
    return (f'the terminal constraints cannot be met: the input does not affect {text}; at '
            f'T = {T:g} it is {there:.6g} for every input, but {wanted:.6g} is required')


def _thinned(form: LqForm, t: Array, x: Array, u: Array
             ) -> tuple[tuple[Places, ...], float, float]:
    """
    Return the samples (block, place) that linear u needs, and error and defect of all samples.

    The defect is that of the dynamics with linear interpolation of u, relative to the largest
    states and summed over all intervals. The error is the defect after its growth until T. A
    sample is left out if linear interpolation between its neighbours is accurate enough.
    """
    blocks, count = len(t), t.shape[1] - 1
    size = np.abs(x).max(axis=(0, 1))
    size[size == 0.0] = max(float(size.max()), TINY)
    growth = _growth(form.A * (size / size[:, None]), t)
    plain = 0.0
    levels = []  # middles of intervals of 2 * reach samples, and the error of omitting them
    reach = 1
    while reach < count:
        middle = np.arange(reach, count, 2 * reach)
        bend = u[:, middle] - 0.5 * (u[:, middle - reach] + u[:, middle + reach])
        length = 2.0 / 3.0 * (t[:, middle + reach] - t[:, middle - reach])
        defect = np.abs(bend @ form.B.T / size).max(axis=2) * length
        plain = plain or 0.25 * float(defect.sum())
        defect *= growth[:, middle]
        levels.append((reach, middle, defect))
        reach *= 2
    finest = 0.25 * float(levels[0][2].sum())  # halving the length divides the bend by 4
    ends = max(1, count * blocks // _FEWEST)
    for share in (1e-2, 1e-3, 1e-4, 1e-5, 0.0):
        keep = np.zeros((blocks, count + 1), dtype=bool)
        keep[:, ::ends] = keep[:, [0, -1]] = True
        left_out = finest
        for reach, middle, defect in levels:
            half = reach // 2
            children = keep[:, middle - half] | keep[:, middle + half] if half else False
            keep[:, middle] |= (defect > share * _DEFECT) | children
            left_out += float(defect[~keep[:, middle]].sum())
        if left_out <= finest + _DEFECT:  # with `_LARGEST_DEFECT` below the certificate's 1e-6
            break
    keep[1:, 0] = False  # it is the last sample of the preceding block
    return np.nonzero(keep), finest, plain


def _growth(A: Array, t: Array) -> Array:
    """Estimate the growth of solutions of dx/dt = A x until T: 1 to `_MOST_GROWTH`."""
    T = t[-1, -1]
    with np.errstate(all='ignore'):
        step, power, sizes = linalg.expm(A * (T / 64)), np.eye(len(A)), [1.0]
        for _ in range(64):
            power = step @ power if sizes[-1] < _MOST_GROWTH else power
            size = float(np.abs(power).sum(axis=1).max())
            sizes.append(max(1.0, size) if math.isfinite(size) else _MOST_GROWTH)
    grown = np.minimum(np.maximum.accumulate(sizes), _MOST_GROWTH)
    growth: Array = np.interp(T - t, np.linspace(0.0, T, 65), grown)
    return growth
