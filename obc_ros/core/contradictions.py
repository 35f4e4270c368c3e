# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Parts of a problem that exclude each other, found without solving it.

Each finding is a proof: the initial state against its bounds and path constraints; terminal
constraints against each other, against state bounds and against path constraints; what the
inputs cannot influence (states that no input enters, modes of a linear system out of reach)
against what is demanded of it; and the least time of a linear system with bounded inputs against
the time that there is.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.least_time_form import affine
from obc_ros.core.problem import FinalTime, Problem
from obc_ros.core.replay import Integrator, Intervals
from obc_ros.core.solution import Status

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Relative size of what counts as a contradiction: far above rounding, far below intention.
_SLACK = 1e-9
_TIMES = 100
_VALUES = 1001   # of a state between its ends


def contradiction(problem: Problem) -> str:
    """Return a sentence that says which parts of a problem exclude each other, or ''."""
    for check in (_at_start, _at_end, _path_at_end, _beyond_control, _beyond_reach, _too_soon,
                  _too_far, _not_conserved):
        for sentence in check(problem):
            return sentence
    return ''


def number(value: float) -> str:
    """Return a number as a person writes it."""
    return f'{value:.6g}' if abs(value) > 1e-12 else '0'


def terminal(problem: Problem, row: int) -> str:
    """Return a terminal constraint in words, ``x = 2`` where it is that simple."""
    rows = _affine_rows(problem)
    if rows is None or not rows.affine[row]:
        return f'terminal_constraints[{row}]'
    names = [(name, a) for name, a in zip(problem.states, rows.A[row], strict=True) if a]
    if len(names) == 1:
        return f'{names[0][0]} = {number(-rows.b[row] / names[0][1])}'
    return f'{_sum(names)} = {number(-rows.b[row])}'


def state_bound(problem: Problem, index: int, upper: bool) -> str:
    """Return a state bound in words, ``v <= 1``."""
    bound = (problem.x_upper if upper else problem.x_lower)[index]
    return f'{problem.states[index]} {"<=" if upper else ">="} {number(bound)}'


@dataclass(frozen=True, eq=False)
class _Rows:
    """Terminal constraints A x + b = 0 where they are affine; shapes (q, n), (q,), (q,)."""

    A: Array
    b: Array
    affine: Mask


def _sum(terms: list[tuple[str, float]]) -> str:
    text = ''
    for name, a in terms:
        factor = '' if abs(a) == 1 else f'{number(abs(a))}*'
        text += f' {"-" if a < 0 else "+"} {factor}{name}'
    return text[3:] if text.startswith(' + ') else '-' + text[3:]


def _affine_rows(problem: Problem) -> _Rows | None:
    if not problem.q:
        return None
    slope = ca.jacobian(problem.psi, problem.x)
    bent = np.array([ca.depends_on(slope[row, :], problem.x) for row in range(problem.q)])
    at_zero = ca.Function('rows', [problem.x, problem.p], [ca.densify(slope), problem.psi])
    A, b = (value.full() for value in at_zero(np.zeros(problem.n), problem.p_value))
    good = ~bent & np.isfinite(A).all(axis=1) & np.isfinite(b[:, 0])
    return _Rows(A, b[:, 0], good)


def _at_start(problem: Problem) -> Iterator[str]:
    for index, name in enumerate(problem.states):
        value = problem.x0[index]
        slack = _SLACK * (1 + abs(value))
        for upper, excess in ((True, value - problem.x_upper[index]),
                              (False, problem.x_lower[index] - value)):
            if excess > slack:
                yield (f'initial state {name} = {number(value)} and state bound '
                       f'{state_bound(problem, index, upper)} exclude each other')
    yield from _path_at(problem, problem.x0, 'at the initial state', np.ones(problem.n, bool))


def _path_at(problem: Problem, x: Array, where: str, known: Mask) -> Iterator[str]:
    """Yield what path constraints no input meets at a state of which so much is known."""
    rate = ca.jacobian(problem.path, problem.u)
    at = ca.Function('path', [problem.x, problem.u, problem.p],
                     [problem.path, ca.densify(rate)])
    middle = np.clip(np.zeros(problem.m), problem.u_lower, problem.u_upper)
    c, slopes = (value.full() for value in at(x, middle, problem.p_value))
    for row in range(problem.path.numel()):
        uses = ca.jacobian_sparsity(problem.path[row], problem.x).get_triplet()[1]
        if ca.depends_on(rate[row, :], problem.u) or not known[uses].all():
            continue
        low, high = _range(slopes[row], float(c[row, 0]) - slopes[row] @ middle,
                           problem.u_lower, problem.u_upper)
        slack = _SLACK * (1 + abs(c[row, 0]))
        fixed = not slopes[row].any()
        for excess, sign, bound, value in (
                (low - problem.path_upper[row], '<=', problem.path_upper[row], low),
                (problem.path_lower[row] - high, '>=', problem.path_lower[row], high)):
            if excess > slack:
                extent = 'is' if fixed else 'is at least' if sign == '<=' else 'is at most'
                yield (f'path_constraints[{row}] {extent} {number(value)} {where} and has to be '
                       f'{sign} {number(bound)}')


def _range(a: Array, b: float, lower: Array, upper: Array) -> tuple[float, float]:
    """Return the least and the largest value of a'z + b over a box."""
    part = a != 0
    ends = np.array([a[part]*lower[part], a[part]*upper[part]])
    return float(b + ends.min(axis=0).sum()), float(b + ends.max(axis=0).sum())


def _at_end(problem: Problem) -> Iterator[str]:
    rows = _affine_rows(problem)
    if rows is None:
        return
    for row in np.flatnonzero(rows.affine):
        a, b = rows.A[row], float(rows.b[row])
        low, high = _range(a, b, problem.x_lower, problem.x_upper)
        slack = _SLACK * (1 + abs(b))
        if low > slack or high < -slack:
            yield _against_bounds(problem, int(row), a, low > slack)
    yield from _against_each_other(problem, rows)
    yield from _where_pinned(problem, rows)
    yield from _together_against_bounds(problem, rows)


def _against_bounds(problem: Problem, row: int, a: Array, over: bool) -> str:
    blamed = [state_bound(problem, index, bool((a[index] < 0) == over))
              for index in map(int, np.flatnonzero(a))]
    plural = 's' * (len(blamed) > 1)
    return (f'state bound{plural} {", ".join(blamed)} and terminal constraint '
            f'{terminal(problem, row)} exclude each other')


def _against_each_other(problem: Problem, rows: _Rows) -> Iterator[str]:
    kept = [int(row) for row in np.flatnonzero(rows.affine)]
    for count, row in enumerate(kept):
        before = kept[:count]
        if not before:
            if not rows.A[row].any() and abs(rows.b[row]) > _SLACK:
                yield f'terminal_constraints[{row}] holds at no state'
            continue
        weights = np.linalg.lstsq(rows.A[before].T, rows.A[row], rcond=None)[0]
        left = rows.A[row] - weights @ rows.A[before]
        gap = rows.b[row] - weights @ rows.b[before]
        if np.abs(left).max() <= _SLACK * (1 + np.abs(rows.A[row]).max()) and (
                abs(gap) > _SLACK * (1 + np.abs(rows.b[[*before, row]]).max())):
            involved = [k for k, w in zip(before, weights, strict=True) if abs(w) > 1e-9]
            names = [terminal(problem, k) for k in (*involved, row)]
            yield (f'terminal constraints {", ".join(names[:-1])} and {names[-1]} '
                   'exclude each other')


def _where_pinned(problem: Problem, rows: _Rows) -> Iterator[str]:
    """Yield curved terminal constraints that do not hold where the affine ones hold."""
    end = None if rows.affine.all() else _pinned(rows.A[rows.affine], rows.b[rows.affine])
    if end is None:
        return
    x, pinned = end
    psi = ca.Function('psi', [problem.x, problem.p], [problem.psi])(x, problem.p_value).full()
    for row in map(int, np.flatnonzero(~rows.affine)):
        used = np.zeros(problem.n, dtype=bool)
        used[ca.jacobian_sparsity(problem.psi[row], problem.x).get_triplet()[1]] = True
        value, size = float(psi[row, 0]), 1 + np.abs(x).max()
        if pinned[used].all() and abs(value) > 1e-6 * size**2:
            where = ', '.join(f'{name} = {number(float(x[index]))}' for index, name in enumerate(
                problem.states) if used[index])
            yield (f'terminal_constraints[{row}] is {number(value)} and not 0 where the other '
                   f'terminal constraints hold ({where})')


def _together_against_bounds(problem: Problem, rows: _Rows) -> Iterator[str]:
    index = np.flatnonzero(rows.affine)
    finite = np.isfinite(problem.x_lower) | np.isfinite(problem.x_upper)
    if len(index) < 2 or not finite.any() or np.any(problem.x_lower >= problem.x_upper):
        return
    # Imported where used: no node that only asks for a problem waits for it.
    from scipy.optimize import lsq_linear
    A, b = rows.A[index], rows.b[index]
    nearest = lsq_linear(A, -b, (problem.x_lower, problem.x_upper), tol=1e-12)
    miss = A @ nearest.x + b
    if np.abs(miss).max() > 1e-6 * (1 + np.abs(b).max() + np.abs(A).max()):
        names = ', '.join(terminal(problem, int(row)) for row in index[np.abs(miss) > 1e-7])
        bounds = ', '.join(
            state_bound(problem, i, bool(nearest.active_mask[i] > 0))
            for i in map(int, np.flatnonzero(nearest.active_mask)))
        yield f'state bounds {bounds} and terminal constraints {names} exclude each other'


def _path_at_end(problem: Problem) -> Iterator[str]:
    rows = _affine_rows(problem)
    if rows is None or not problem.path.numel():
        return
    A, b = rows.A[rows.affine], rows.b[rows.affine]
    end = _pinned(A, b)
    if end is None:
        return
    x, pinned = end
    yield from _path_at(
        problem, x, 'at the state that the terminal constraints demand', pinned)
    yield from _in_between(problem, x, pinned)


def _pinned(A: Array, b: Array) -> tuple[Array, Mask] | None:
    """Return a state with A x + b = 0 (n,), and which parts of it all such states share."""
    if not len(A):
        return None
    found, _, rank, _ = np.linalg.lstsq(A, -b, rcond=None)
    x = np.asarray(found, dtype=np.float64)
    if np.abs(A @ x + b).max() > 1e-9 * (1 + np.abs(b).max()):
        return None
    pinned: Mask = np.abs(np.linalg.svd(A)[2][rank:]).max(axis=0, initial=0.0) < 1e-9
    return x, pinned


def _in_between(problem: Problem, end: Array, pinned: Mask) -> Iterator[str]:
    """Yield constraints on one state that do not hold at a value which it has to pass."""
    path = ca.Function('path', [problem.x, problem.u, problem.p], [problem.path])
    uses = np.zeros((problem.path.numel(), problem.n + problem.m), dtype=bool)
    uses[ca.jacobian_sparsity(
        problem.path, ca.vertcat(problem.x, problem.u)).get_triplet()] = True
    for row in np.flatnonzero(uses.sum(axis=1) == 1):
        index = int(np.argmax(uses[row]))
        if index >= problem.n or not pinned[index]:
            continue
        x = np.tile(problem.x0, (_VALUES, 1))
        x[:, index] = np.linspace(problem.x0[index], end[index], _VALUES)
        c = path.map(_VALUES)(x.T, np.zeros((problem.m, _VALUES)), ca.repmat(
            problem.p_value, 1, _VALUES)).full()[row]
        excess = np.maximum(c - problem.path_upper[row], problem.path_lower[row] - c)
        worst = int(np.argmax(excess))
        if excess[worst] > 1e-6 * (1 + np.abs(c).max()):
            sign, bound = (('<=', problem.path_upper[row]) if c[worst] > problem.path_upper[row]
                           else ('>=', problem.path_lower[row]))
            name = problem.states[index]
            yield (f'path_constraints[{row}] is {number(float(c[worst]))} at {name} = '
                   f'{number(float(x[worst, index]))} and has to be {sign} {number(bound)}, but '
                   f'{name} has to pass there from {number(problem.x0[index])} to '
                   f'{number(float(end[index]))}')


def _times(problem: Problem) -> Array:
    """Return the times at which the end may be."""
    final = problem.final_time
    if not final.free:
        return np.array([final.value])
    return np.linspace(final.lower, final.upper, _TIMES + 1)


def _beyond_control(problem: Problem) -> Iterator[str]:
    """Yield what is demanded of states that no input enters, directly or through others."""
    driven = _driven(problem)
    uses = np.zeros((problem.q, problem.n), dtype=bool)
    uses[ca.jacobian_sparsity(problem.psi, problem.x).get_triplet()] = True
    bounded = np.isfinite(problem.x_lower) | np.isfinite(problem.x_upper)
    decided = ~uses[:, driven].any(axis=1)
    if driven.all() or not (bounded[~driven].any() or decided.any()):
        return
    t = np.unique(np.append(0.0, _times(problem)))
    x = _course(problem, t, driven)
    if not np.isfinite(x[:, ~driven]).all():
        return
    latest = _times(problem)[0]
    nothing = 'no input' if _movable(problem).all() else 'no input that may change'
    for index in map(int, np.flatnonzero(~driven)):
        for upper, excess in ((True, x[:, index] - problem.x_upper[index]),
                              (False, problem.x_lower[index] - x[:, index])):
            bad = np.flatnonzero(excess > 1e-6 * (1 + np.abs(x[:, index]).max()))
            if bad.size and t[bad[0]] <= latest:
                yield (f'{nothing} enters {problem.states[index]}: it leaves state bound '
                       f'{state_bound(problem, index, upper)} by t = {number(t[bad[0]])}')
    psi = ca.Function('psi', [problem.x, problem.p], [problem.psi]).map(len(t))(
        x.T, ca.repmat(problem.p_value, 1, len(t))).full()
    for row in map(int, np.flatnonzero(decided)):
        names = ', '.join(problem.states[index] for index in np.flatnonzero(uses[row]))
        yield from _missed(problem, f'{nothing} enters {names}', terminal(problem, row),
                           psi[row, np.isin(t, _times(problem))], x[-1, uses[row]])


def _missed(problem: Problem, reason: str, wanted: str, values: Array,
            there: Array | None = None) -> Iterator[str]:
    """Yield a sentence if values over the admissible final times keep away from zero."""
    size = 1e-6 * (1 + np.abs(values).max())
    if not (np.all(values > size) or np.all(values < -size)):
        return
    final = problem.final_time
    if final.free:
        yield (f'{reason}: {wanted} holds at no T from {number(final.lower)} to '
               f'{number(final.upper)}')
    elif there is not None and len(there) == 1:
        yield (f'{reason}: at T = {number(final.value)} it is {number(there[0])}, and the '
               f'terminal constraint {wanted} cannot be met')
    else:
        yield (f'{reason}: at T = {number(final.value)} the terminal constraint {wanted} is '
               f'missed by {number(abs(float(values[-1])))}')


def _movable(problem: Problem) -> Mask:
    """Return which inputs have a choice, shape (m,)."""
    movable: Mask = problem.u_lower < problem.u_upper
    return movable


def _driven(problem: Problem) -> Mask:
    """Return which states an input enters, directly or through other states."""
    def pattern(symbols: ca.SX) -> Mask:
        found = np.zeros((problem.n, symbols.numel()), dtype=bool)
        found[ca.jacobian_sparsity(problem.f, symbols).get_triplet()] = True
        return found

    driven = pattern(problem.u)[:, _movable(problem)].any(axis=1)
    through = pattern(problem.x)
    for _ in range(problem.n):
        driven = driven | (through & driven).any(axis=1)
    return np.asarray(driven)


def _course(problem: Problem, t: Array, driven: Mask) -> Array:
    """Return x at times t, shape (K, n); the states that inputs enter are of no account."""
    n, empty = problem.n, np.zeros((1, problem.path.numel()))
    u, none = np.clip(np.zeros((1, problem.m)), problem.u_lower, problem.u_upper), np.zeros((1, n))
    # Without a cost, whose integral may be undefined where the states themselves are not.
    integrator = Integrator(replace(problem, L=ca.SX(0)))
    scale = np.append(np.where(driven, np.inf, 1 + np.abs(problem.x0)), np.full(n, np.inf))
    found = [problem.x0]
    for h in np.diff(t):
        course = integrator.replay(Intervals(
            np.array([h]), found[-1][None], none, u, u, none, none, empty, empty),
            problem.p_value, scale, 1e-10)
        found.append(course.x[0, -1])
    return np.array(found)


def _beyond_reach(problem: Problem) -> Iterator[str]:
    """Yield what is demanded of modes of a linear system that no input reaches."""
    system, rows = affine(problem), _affine_rows(problem)
    if system is None or rows is None or not rows.affine.any():
        return
    movable = _movable(problem)
    V = _reachable(system.A, system.B[:, movable])
    if V.shape[1] == problem.n:
        return
    C = rows.A[rows.affine]
    U, sizes, _ = np.linalg.svd(C @ V)
    rank = int(np.sum(sizes > 1e-9 * max(1.0, float(np.abs(C).max()))))
    combinations = U[:, rank:].T
    if not len(combinations):
        return
    t = _times(problem)
    c = system.c + system.B[:, ~movable] @ problem.u_lower[~movable]
    x = _free_motion(system.A, c, problem.x0, t)
    values = combinations @ (C @ x.T + rows.b[rows.affine][:, None])
    for eta, value in zip(combinations, values, strict=True):
        w = eta @ C
        modes = _modes(system.A, V)
        involved = [terminal(problem, int(row)) for row, e in zip(
            np.flatnonzero(rows.affine), eta, strict=True) if abs(e) > 1e-9]
        if np.abs(w).max() > 1e-9:
            yield from _missed(problem, f'the inputs do not reach {modes} of A',
                               ' with '.join(involved), value)


def _too_soon(problem: Problem) -> Iterator[str]:
    """Yield the least time of a linear system with bounded inputs if there is less time."""
    rows = _affine_rows(problem)
    boxed = np.isfinite(problem.u_lower).all() and np.isfinite(problem.u_upper).all()
    if rows is None or not rows.affine.any() or not boxed or affine(problem) is None:
        return
    # Imported where used: no node that only asks for a problem waits for it.
    from obc_ros.core.time_optimal import solve_time_optimal
    final, unlimited, none = problem.final_time, np.full(problem.n, np.inf), np.zeros(0)
    within = FinalTime(free=True, lower=0.0, upper=final.upper if final.free else final.value)
    found = solve_time_optimal(replace(
        problem, L=ca.SX(1), V=ca.SX(0), psi=problem.psi[np.flatnonzero(rows.affine).tolist()],
        path=ca.SX(0, 1), path_lower=none, path_upper=none, x_lower=-unlimited,
        x_upper=unlimited, final_time=within, structure=''))
    if found is not None and found.status is Status.INFEASIBLE:
        more = (np.isfinite([problem.x_lower, problem.x_upper]).any() or problem.path.numel()
                or not rows.affine.all())
        yield f'{found.message}{", without regard to the other constraints" if more else ""}'


def _too_far(problem: Problem) -> Iterator[str]:
    """Yield what holds nowhere within the bounds, or nowhere within reach."""
    # Imported where used: no node that only asks for a problem waits for it.
    from obc_ros.core.enclosed import nowhere
    yield from nowhere(problem)


def _not_conserved(problem: Problem) -> Iterator[str]:
    """Yield what no input changes and is not the same at the end."""
    if problem.q:
        # Imported where used: no node that only asks for a problem waits for it.
        from obc_ros.core.conserved import changed
        yield from changed(problem)


def _reachable(A: Array, B: Array) -> Array:
    """Return an orthonormal basis, shape (n, r), of the states that inputs reach."""
    V = np.zeros((len(A), 0))
    new = B / max(float(np.abs(B).max(initial=0.0)), 1e-300)
    scale = max(float(np.linalg.norm(A)), 1e-300)
    while new.shape[1]:
        new = new - V @ (V.T @ new)
        new = new - V @ (V.T @ new)
        U, sizes, _ = np.linalg.svd(new, full_matrices=False)
        new = U[:, sizes > 1e-10 * max(1.0, float(sizes[0]))]
        V = np.hstack([V, new])
        new = A @ new / scale
    return V


def _modes(A: Array, V: Array) -> str:
    W = np.linalg.svd(V, full_matrices=True)[0][:, V.shape[1]:]
    values = sorted(np.linalg.eigvals(W.T @ A @ W), key=lambda s: (-s.real, s.imag))
    shown = [f'{s.real + 0.0:+.4g}' + (f' {s.imag:+.4g}j' if abs(s.imag) > 1e-9 else '')
             for s in values]
    if len(shown) == 1:
        return f'the mode at {shown[0]}'
    return f'the modes at {", ".join(shown)}'


def _free_motion(A: Array, c: Array, x0: Array, t: Array) -> Array:
    """Return x at times t, shape (K, n), for dx/dt = A x + c."""
    from scipy.linalg import expm
    n = len(A)
    Z = np.zeros((n + 1, n + 1))
    Z[:n, :n], Z[:n, n] = A, c
    z = np.append(x0, 1.0)
    return np.array([(expm(Z * time) @ z)[:n] for time in t])
