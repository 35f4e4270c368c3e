# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Values of a solution between its samples, as the certificate computes them.

States and costates are integrated from the sample before a time, under the input that the
solution returns (`ocp/certificate/replay.py`). Where the costates then miss the next sample,
because their equation is unstable in this direction, they are integrated from there.
"""

from dataclasses import replace

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.ocp.augmentation import restore_added_states
from obc_ros.core.ocp.certificate.certificate import REPLAY_ERROR
from obc_ros.core.ocp.certificate.replay import build_intervals, Intervals, ReplayIntegrator
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution
from obc_ros.core.text.errors import ObcError

_MISSED = 1e-6    # relative to the largest costate: a sample that costates miss
_AT_ONCE = 4096   # times, so that the memory of an integration stays below some 100 MB


def interpolate(problem: Problem, solution: Solution, times: Array
                ) -> tuple[Array, Array, Array]:
    """
    Return states (M, n), inputs (M, m) and costates of a solution at times (M,) of its path [s].

    At a sample these are its values, at a jump those after it. Between samples, they are those of
    the integration from the sample before.
    """
    if problem.phases is not None:
        raise ObcError('at: a problem with phases has values at the samples `t` only')
    shown, solution, t = solution, restore_added_states(problem, solution), solution.t
    inside = (t[0] <= times) & (times <= t[-1])
    if not inside.all():
        raise ObcError(f'at: {times[~inside][0]:g} s is not a time of the path; wanted times from '
                       f'{t[0]:g} s to {t[-1]:g} s')
    k = np.searchsorted(t, times, side='right') - 1
    n, without = shown.x.shape[1], not solution.lam.size
    if without:
        solution = replace(solution, lam=np.zeros_like(solution.x))
    x, u, lam = solution.x[k], solution.u[k], solution.lam[k]
    between = np.flatnonzero(times > t[k])   # the last sample has no interval
    integrator = ReplayIntegrator(problem) if between.size else None
    for part in np.array_split(between, -(-len(between) // _AT_ONCE) or 1):
        if integrator is not None:
            x[part], u[part], lam[part] = _integrate(
                integrator, problem, solution, times[part], k[part])
    return x[:, :n], u, lam[:, :0 if without else n]


def _integrate(integrator: ReplayIntegrator, problem: Problem, solution: Solution, times: Array,
               k: Index) -> tuple[Array, Array, Array]:
    """Return x, u and lam within the intervals that begin at the samples `k`."""
    whole = build_intervals(problem, solution, k)
    part = ((times - solution.t[k]) / whole.h)[:, None]
    ahead, rest = _split(whole, part)
    scale = np.maximum(np.abs(np.hstack([solution.x, solution.lam])).max(axis=0), 1e-300)
    run = problem.p_value, scale, REPLAY_ERROR / len(solution.t)
    end, middle = integrator.replay(whole, *run), integrator.replay(ahead, *run)
    x, u, lam = middle.x[:, -1], middle.u[:, -1], middle.lam[:, -1]
    missed = end.lam[:, -1] - solution.lam[k + 1]
    with np.errstate(invalid='ignore'):
        bad = np.flatnonzero(~(np.abs(missed) <= _MISSED * scale[problem.n:]).all(axis=1))
    # As in the certificate, costates pass through their samples.
    lam = lam - part * missed
    if bad.size:
        rest = Intervals(**{**vars(rest.some(bad)), 'x': x[bad]})
        _, defect = integrator.there_and_back(
            integrator.replay(rest, *run), rest, solution.lam[k[bad] + 1], *run, back=True)
        lam[bad] = rest.lam - defect   # at the starts of the intervals
    return x, u, lam


def restore_added_costates(problem: Problem, solution: Solution) -> Solution:
    """
    Return a solution with all states and costates of the problem, and H of all states.

    The costates of additional states, the time and constants, follow from the others: nothing
    depends on them, so that dlam/dt = -dH/dx is a quadrature, and at T they are
    dV/dx + nu' dpsi/dx.

    :param solution: with the states of the statement, and costates; nu is found by least squares
        if it is missing.
    """
    n, found = problem.stated, restore_added_states(problem, solution)
    if not problem.added or solution.x.shape[1] == problem.n:
        return found
    at_end = ca.Function('end', [problem.x, problem.p], [
        ca.gradient(problem.V, problem.x), ca.jacobian(problem.psi, problem.x)])
    V_x, psi_x = (value.full() for value in at_end(found.x[-1], problem.p_value))
    nu = found.nu if found.nu.size else np.linalg.lstsq(
        psi_x[:, :n].T, found.lam[-1, :n] - V_x[:n, 0], rcond=None)[0]
    k = np.flatnonzero(np.diff(found.t) > 0)
    scale = np.maximum(np.abs(np.hstack([found.x, found.lam])).max(axis=0), 1.0)
    course = ReplayIntegrator(problem).replay(
        build_intervals(problem, found, k), problem.p_value, scale, REPLAY_ERROR / len(k))
    growth = np.zeros((len(found.t), problem.added))
    growth[k + 1] = course.lam[:, -1, n:]
    last = (V_x[:, 0] + psi_x.T @ nu)[n:]
    lam = found.lam.copy()
    lam[:, n:] = last + np.cumsum(growth, axis=0) - growth.sum(axis=0)
    H = found.hamiltonian + lam[:, n] if problem.has_clock else found.hamiltonian
    return replace(found, lam=lam, nu=nu, hamiltonian=H)


def _split(whole: Intervals, part: Array) -> tuple[Intervals, Intervals]:
    """Return the intervals before and after a part of each, (K, 1); x and lam are the first."""
    middle = {name: (1 - part) * getattr(whole, f'{name}a') + part * getattr(whole, f'{name}b')
              for name in 'usm'}
    h = whole.h
    ahead = Intervals(**{**vars(whole), 'h': part[:, 0] * h,
                         **{f'{name}b': value for name, value in middle.items()}})
    return ahead, Intervals(**{**vars(whole), 'h': (1 - part[:, 0]) * h,
                               **{f'{name}a': value for name, value in middle.items()}})
