# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Time-optimal control of linear systems with bounded inputs (Example 2.3).

Minimise the integral of L over [0, T] for a constant L > 0 subject to x' = A x + B u + c,
x(0) = x0, C x(T) = d, u in a box, T free. The inputs are bang-bang, u = -sgn(B'lam) about the
middle of the box, except where a switching function vanishes identically.

The double integrator is solved in closed form (`double_integrator`). For other systems a lower
bound of T rises until the target is met (`least_time`). Inputs that do not determine T are
singular; they are given the lowest constant magnitude that meets the target. An abnormal extremal
satisfies the conditions with H = lam'f only; its costate is a large multiple of the abnormal one,
so that the residuals of H = L + lam'f are small relative to its size.
"""

from dataclasses import replace
from math import inf
from time import perf_counter
from typing import Literal

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.ocp.certificate.certificate import COUNTS_AS_MET
from obc_ros.core.ocp.least_time_form import (
    Affine,
    find_affine_dynamics,
    find_target,
    get_final_time,
    Target,
)
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution, Status
from obc_ros.core.ocp.wording import describe_sum
from obc_ros.core.solver.exact.bang_bang import BangBang, describe_switches
from obc_ros.core.solver.exact.double_integrator import solve_by_two_arcs
from obc_ros.core.solver.exact.least_time import (
    compute_final_state,
    find_first_time,
    split_directions,
)
from obc_ros.core.solver.exact.reachable_set import (
    bound_first_reach,
    compute_exponential,
    normalize_inputs,
    Reach,
)
from obc_ros.core.solver.exact.weak_duality import is_never_met

_METHOD = 'time_optimal'
_SAMPLES = 17   # of an arc, at least
_ACCURACY = 1e-9   # relative accuracy of eigenvectors and of comparisons that use them


def solve_time_optimal(problem: Problem) -> Solution | None:
    """
    Return the minimum-time solution of a linear problem.

    :return: None if the problem is not of this form (L a constant > 0, V constant, f affine, psi
        affine, T free, u bounded, x free), if the lower bound of T is active, or if the minimum
        time is not found. The status is ``infeasible`` if it is proved that the target is met at
        no T between the bounds (`weak_duality`), and ``not_converged`` if no such T is found
        without proof; the message gives the reason. Inputs are constant between samples ('zoh');
        the time of a switch appears twice.
    """
    began = perf_counter()
    aim = find_target(problem) if problem.start is None else None
    plant = find_affine_dynamics(problem) if aim else None
    if aim is None or plant is None:
        return None
    found, bounds = solve_by_two_arcs(problem, aim, plant), problem.final_time
    if found is None or found.t[-1] < bounds.lower:
        found = _general(problem, aim, plant)
    elif found.t[-1] > bounds.upper:
        scaled = _scaled(normalize_inputs(problem, plant, aim.C, aim.d)[0], bounds.upper)[0]
        found = _none(_out_of_time(bounds.upper, found.t[-1]),
                      is_never_met(scaled, bounds.lower, bounds.upper))
    return found and replace(found, method=_METHOD, solve_time=perf_counter() - began)


def _general(problem: Problem, aim: Target, plant: Affine) -> Solution | None:
    """Return the solution for any linear system with bounded inputs."""
    stated, driven = normalize_inputs(problem, plant, aim.C, aim.d)
    scaled, size, unit = _scaled(stated, get_final_time(problem))
    bounds = problem.final_time

    def none(reason: str) -> Solution:
        return _none(reason, is_never_met(scaled, bounds.lower, bounds.upper))

    rows, contradiction = _independent(scaled)
    if contradiction:
        return none('the terminal constraints contradict each other')
    whole = replace(scaled, C=rows.T @ scaled.C, d=rows.T @ scaled.d)
    moved, fixed = split_directions(whole.A, whole.B, whole.C)

    def in_words(part: Reach) -> str | None:
        return _explain_mode(problem.states, replace(stated, C=part.C / size, d=part.d))

    if fixed.shape[1]:
        meets = _meets_by_itself(whole, fixed, bounds.upper)
        if meets == 'never':
            return none(in_words(whole) or (
                'the inputs do not act on a combination of states that the terminal constraints '
                'determine, and without inputs it does not meet them by T = '
                f'{bounds.upper:.10g}'))
        if meets == 'passing' or not moved.shape[1]:
            return None
    reach = replace(whole, C=moved.T @ whole.C, d=moved.T @ whole.d)
    found = find_first_time(reach, bounds.lower, bounds.upper)
    if found.answer is None:
        return none(_why_not(bounds.upper, reach, in_words(reach))
                    ) if found.too_short >= bounds.upper else None
    nu = rows @ moved @ _multiplier(reach, found.answer) / unit
    return _solution(problem, stated, replace(found.answer, nu=nu), aim, driven)


def _scaled(stated: Reach, T: float) -> tuple[Reach, Array, Array]:
    """
    Return the problem with scaled states and constraints, and both scales.

    The unit of a state is its largest change by the inputs within T. All scales are powers of 2.
    Because of the scaling, ranks do not depend on the units in which a problem is stated.
    """
    size = bound_first_reach(stated.A, stated.B, T)
    for other in (np.abs(stated.x0), T * np.abs(stated.c), np.ones(len(size))):
        size = np.where(size > 0, size, other)
    size = np.exp2(np.round(np.log2(np.clip(size, 1e-100, 1e100))))
    norms = np.linalg.norm(stated.C * size, axis=1)
    unit = np.exp2(np.round(np.log2(np.where(norms > 0, norms, 1.0))))
    return Reach(stated.A * size / size[:, None], stated.B / size[:, None], stated.c / size,
                 stated.x0 / size, stated.C * size / unit[:, None], stated.d / unit), size, unit


def _independent(aim: Reach) -> tuple[Array, bool]:
    """Return independent combinations of the terminal constraints, and whether all contradict."""
    U, sizes, _ = np.linalg.svd(aim.C)
    rank = int(np.sum(sizes > 1e-12 * max(sizes[0], 1e-300)))
    if rank == len(aim.d):
        return np.eye(rank), False
    left = U[:, rank:].T @ aim.d
    return U[:, :rank], bool(np.abs(left).max() > COUNTS_AS_MET * (1 + np.abs(aim.d).max()))


def _meets_by_itself(reach: Reach, fixed: Array,
                     upper: float) -> Literal['always', 'passing', 'never']:
    """Return when the directions on which no input acts meet the target, for T up to upper."""
    gap = reach.gap(reach.table(reach.times(upper))) @ fixed
    size = 1 + np.abs(reach.d).max() + np.abs(reach.x0).max()
    if np.abs(gap).max() <= 1e-9 * size:
        return 'always'
    clear = np.abs(gap).min(axis=0) > COUNTS_AS_MET * size
    one_sided = clear & (np.abs(np.sign(gap).sum(axis=0)) == len(gap))
    return 'never' if one_sided.any() else 'passing'


def _why_not(upper: float, reach: Reach, reason: str | None) -> str:
    """Return why the target is not met by the upper bound of T, as far as is known."""
    if reason:
        return reason
    later = find_first_time(reach, upper, 64 * upper).answer   # for the message
    return _out_of_time(upper, later.T) if later is not None else (
        f'the terminal constraints cannot be met by T = {upper:.10g}: the bounded inputs do not '
        'reach that far')


def _out_of_time(upper: float, least: float) -> str:
    return (f'the terminal constraints cannot be met by T = {upper:.10g}: '
            f'the minimum time is {least:.10g}')


def _none(reason: str, proved: bool) -> Solution:
    """Return the result for an infeasible problem, or for one without a path found."""
    return Solution(Status.INFEASIBLE, reason, method=_METHOD) if proved else Solution(
        Status.NOT_CONVERGED, f'no path was found; infeasibility has not been proved ({reason})',
        method=_METHOD)


def _multiplier(reach: Reach, answer: BangBang) -> Array:
    """Return nu; for an abnormal extremal a large multiple of it, plus a nu with H = 0 at T."""
    if answer.normal:
        return answer.nu
    x, v = compute_final_state(reach, answer), answer.sign * answer.level
    rate = reach.C @ (reach.A @ x + reach.B @ v + reach.c)
    balance = -rate / max(float(rate @ rate), 1e-300)
    # An abnormal costate is large relative to the one that balances L.
    return balance + 1e7 * max(float(np.linalg.norm(balance)), 1.0) * answer.nu


def _solution(problem: Problem, reach: Reach, answer: BangBang, aim: Target,
              driven: Index) -> Solution:
    """Return states, inputs and costates for the inputs found."""
    n, T = problem.n, float(answer.T)
    switches = np.sort(T - answer.tau)
    switches = switches[(switches > 1e-12 * T) & (switches < (1 - 1e-12) * T)]
    switches = switches[np.diff(switches, prepend=-T) > 1e-12 * T]   # without duplicates
    edges = np.concatenate(([0.0], switches, [T]))
    per_arc = int(np.clip(40 * np.abs(reach.poles).max(initial=0) * np.diff(edges).max() / np.pi,
                          _SAMPLES, 200))   # by the fastest mode
    v = answer.v(T - (edges[:-1] + edges[1:]) / 2)
    grid = np.arange(per_arc) / (per_arc - 1)
    t = (edges[:-1, None] + np.diff(edges)[:, None] * grid).ravel()
    courses, costates = [np.append(problem.x0, 1.0)[None]], [(aim.C.T @ answer.nu)[None]]
    for k, duration in enumerate(np.diff(edges)):
        rate = np.zeros((n + 1, n + 1))
        rate[:n, :n], rate[:n, n] = reach.A, reach.B @ v[k] + reach.c
        step = compute_exponential(rate * (duration / (per_arc - 1)))
        courses.append(_repeat(step, courses[-1][-1], per_arc))
    for duration in np.diff(edges)[::-1]:
        back = compute_exponential(reach.A.T * duration / (per_arc - 1))
        costates.append(_repeat(back, costates[-1][-1], per_arc))
    x, lam = np.vstack(courses[1:])[:, :n], aim.rate * np.vstack(costates[1:])[::-1]
    u = np.tile((problem.u_lower + problem.u_upper) / 2, (len(t), 1))
    half = (problem.u_upper - problem.u_lower)[driven] / 2
    u[:, driven] += np.repeat(v * half, per_arc, axis=0)
    u = np.clip(u, problem.u_lower, problem.u_upper)
    v_all = np.repeat(v, per_arc, axis=0)
    hamiltonian = aim.rate + np.sum(lam * (x @ reach.A.T + v_all @ reach.B.T + reach.c), axis=1)
    singular = [problem.inputs[driven[j]] for j in np.flatnonzero(answer.level < 1)]
    return Solution(
        status=Status.SOLVED, message=describe_switches(T, len(switches), singular, answer.normal),
        objective=aim.rate * T + aim.V, t=t, x=x, u=u, lam=lam, hamiltonian=hamiltonian,
        nu=aim.rate * answer.nu, interpolation='zoh', switching_times=switches)


def _repeat(step: Array, z: Array, count: int) -> Array:
    """Return z, step z, step^2 z, ..., (count, n)."""
    found = [z]
    for _ in range(count - 1):
        found.append(step @ found[-1])
    return np.array(found)


def _explain_mode(states: tuple[str, ...], reach: Reach) -> str | None:
    """
    Return a sentence if a real mode of A keeps the terminal constraints from ever being met.

    For a left eigenvector w of A with real eigenvalue sigma, y = w'x satisfies the scalar equation
    y' = sigma y + gamma + rho v, |v| <= 1. If y cannot rise at t = 0 it never rises above y(0). If
    sigma < 0, y stays below its equilibrium for v = 1. The same holds downwards.

    The rows of `reach.C` are independent.
    """
    for sigma, w in _modes(reach.A, reach.B):
        y, *_ = np.linalg.lstsq(reach.C.T, w, rcond=None)
        if np.abs(reach.C.T @ y - w).max() > _ACCURACY:
            continue
        name = describe_sum(((name, weight) for name, weight in zip(states, w, strict=True)
                             if abs(weight) > _ACCURACY), ' ')
        if sentence := _limit_mode(name, sigma, w, reach, float(y @ reach.d)):
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


def _limit_mode(name: str, sigma: float, w: Array, reach: Reach, wanted: float) -> str | None:
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
