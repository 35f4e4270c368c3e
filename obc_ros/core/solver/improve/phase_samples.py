# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Conversion of a solution on phases to a path, and to the samples of a solution.

A collocation is more accurate at the ends of its intervals than between them. The states at the
samples are therefore integrated from the start of each interval, with inputs that are linear
between samples.
"""

from dataclasses import replace
from itertools import pairwise
import math

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.numerics.collocation import build_collocation, evaluate_lagrange
from obc_ros.core.ocp.certificate.certificate import certify
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Condition, Solution, Status
from obc_ros.core.solver.adjoint.costates import CostateIntegrator, find_new_samples
from obc_ros.core.solver.arcs.mixed_constraints import move_onto_constraints
from obc_ros.core.solver.arcs.phase_program import PhasedProgram
from obc_ros.core.solver.arcs.phases import DEGREE, Phased
from obc_ros.core.solver.bench import Bench
from obc_ros.core.solver.transcription.mesh import build_path, Path

# The conditions whose residuals more samples may reduce.
BY_SAMPLES = Condition.DYNAMICS, Condition.BOUNDS, Condition.COST, Condition.MINIMUM
_SAMPLES = 1000, 4000, 16_000   # numbers of samples that are tried in turn
_OFF = 1e-4           # relative difference above which the collocation is used, not the steps


def join_phases(found: Phased) -> Path:
    """Return phases as a path on the ends of their intervals."""
    at = np.append(0.0, np.cumsum(found.h))
    points = build_collocation(DEGREE, 'radau')[0]
    first = evaluate_lagrange(points, 0.0)
    x = np.vstack([found.x[:, 0], found.x[-1:, -1]])
    return build_path(at, x, np.einsum('j,kjm->km', first, found.u), found.u[:, -1],
                      found.durations)


def _parts(found: Phased, samples: int) -> Index:
    """Return the number of parts between samples in each interval: more where inputs bend."""
    bends = evaluate_lagrange(
        build_collocation(DEGREE, 'radau')[0], np.linspace(0.0, 1.0, DEGREE), 2)
    size = np.maximum(np.abs(found.u).max(axis=(0, 1)), 1e-300)
    bend = np.sqrt(np.abs(np.einsum('sj,kjm->ksm', bends, found.u) / size).max(axis=(1, 2)))
    # Samples are denser where inputs bend, up to 15 times as dense as on average.
    share = np.minimum(bend / max(bend.mean(), 1e-300), 15.0)
    usual = samples / len(found.h) / 2
    return np.asarray(np.maximum(2, np.rint(usual * (1 + share))), dtype=np.int64)


def sample_phases(problem: Problem, program: PhasedProgram, integrator: CostateIntegrator,
                  found: Phased, samples: int) -> Solution:
    """
    Return phases as about so many samples, with costates and densities of the stated bounds.

    The formulas are those of `phase_program`.
    """
    bounds, points = program.bounds, program.points
    parts = _parts(found, samples)
    most = int(parts.max())
    # Intervals with fewer parts repeat their end.
    tau = np.minimum(np.arange(most + 1) / parts[:, None], 1.0)
    on_x = evaluate_lagrange(points, tau)
    highest = int(bounds.orders.max(initial=0))
    on_u = [evaluate_lagrange(points[1:], tau, order) for order in range(max(highest, 2) + 1)]
    x, lam = (np.einsum('ksj,kjn->ksn', on_x, values) for values in (found.x, found.lam))
    u, bend = (np.einsum('ksj,kjm->ksm', on_u[order], found.u) for order in (0, 2))
    # The interpolation between samples of u has a mean error of h^2 / 12 times its second
    # derivative.
    u = (move_onto_constraints(problem, program, found, x, u)
         - bend / (12 * parts[:, None, None]**2))
    eta = [np.einsum('ksj,kjr->ksr', basis, found.eta) / found.h[:, None, None]**order
           for order, basis in enumerate(on_u)]
    density = np.zeros_like(eta[0])
    for row in np.flatnonzero(np.abs(found.eta).max(axis=(0, 1)) > 0):
        order = int(bounds.orders[row])
        terms = [each[:, :, row] for each in eta]
        if row in bounds.sliding:
            terms[1:] = _slid(problem, program, found, terms, (on_u[0], on_u[1]), int(row))
        density[:, :, row] = (-1)**order * terms[order]
        if order:
            gradients = program.gradients[row].map(x.shape[0] * x.shape[1])(
                x.reshape(-1, problem.n).T, problem.p_value)
            each = gradients.full().T.reshape(len(x), most + 1, order, problem.n)
            for i in range(order):
                lam = lam + (-1)**i * terms[i][:, :, None] * each[:, :, order - 1 - i]
    sign = np.array([arc.on or (0,) * bounds.count for arc in found.arcs])[found.phase_of]
    for row in np.flatnonzero(bounds.orders != 0):
        wanted = sign[:, row][:, None]
        density[:, :, row] = np.where(density[:, :, row] * wanted > 0, density[:, :, row], 0.0)
    u, h = np.clip(u, problem.u_lower, problem.u_upper), found.h[:, None] * np.diff(tau, axis=1)
    x = _replayed(problem, integrator, x, u, h)
    lam = np.where(np.abs(density).max(axis=(1, 2))[:, None, None] > 0, lam,
                   _carried_back(problem, integrator, found, lam, x, u, h))
    t = np.append(0.0, np.cumsum(found.h))[:-1, None] + found.h[:, None] * tau
    return _joined(problem, integrator, found, t, x, u, lam, density)


def _slid(problem: Problem, program: PhasedProgram, found: Phased, terms: list[Array],
          bases: tuple[Array, Array], row: int) -> list[Array]:
    """Return eta'/s and its derivative, (K, s), in place of eta' and eta''."""
    K, count = bases[0].shape[:2]
    factors = program.bounds.factors[row].map(K * count)
    # s is linear in u, so that its derivative is its value for that of u.
    s, ds = (factors(np.zeros((problem.n, K * count)), np.einsum(
        'ksj,kjm->ksm', basis, found.u).reshape(-1, problem.m).T, problem.p_value)[0].full(
            ).reshape(K, count) for basis in bases)
    ds = ds / found.h[:, None]
    s = np.where(np.abs(found.eta[:, :, row]).max(axis=1)[:, None] > 0, s, 1.0)
    with np.errstate(divide='ignore', invalid='ignore'):   # a path may stop on the bound
        return [terms[1] / s, (terms[2] - terms[1] * ds / s) / s]


def certify_samples(bench: Bench, program: PhasedProgram, found: Phased) -> Solution:
    """Return phases as samples with their certificate, on more samples if these may help."""
    problem, integrator = bench.problem, bench.programs.stated_integrator
    free, off = any(np.isnan(arc.levels).any() for arc in found.arcs), math.inf
    for samples in _SAMPLES if free else _SAMPLES[:1]:   # without free inputs a few are exact
        answer = bench.programs.fitter(problem).pressed(
            problem, sample_phases(problem, program, integrator, found, samples))
        certificate = certify(problem, answer)
        answer, worst = replace(answer, certificate=certificate), certificate.worst
        off, before = certificate.residuals[worst] / certificate.tolerances[worst], off
        # More samples are tried while that halves a residual of up to 100 times its tolerance.
        if certificate.holds or worst not in BY_SAMPLES or off > min(100.0, before / 2):
            break
    bench.take(answer)
    return answer


def _replayed(problem: Problem, integrator: CostateIntegrator, x: Array, u: Array,
              h: Array) -> Array:
    """Return states (K, s, n) integrated from the first of each interval by steps (K, s - 1)."""
    new = x.copy()
    for k in range(h.shape[1]):
        new[:, k + 1] = integrator.stepped(problem, new[:, k], u[:, k], u[:, k + 1], h[:, k])
    size = np.maximum(np.abs(x).max(axis=(0, 1)), 1e-300)
    with np.errstate(invalid='ignore'):
        near = (np.abs(new - x) <= _OFF * size).all(axis=(1, 2))
    return np.where(near[:, None, None], new, x)


def _carried_back(problem: Problem, integrator: CostateIntegrator, found: Phased, lam: Array,
                  x: Array, u: Array, h: Array) -> Array:
    """
    Return costates (K, s, n) integrated backward from the first of the next interval.

    At the starts of intervals the costates of a collocation converge with a higher order than
    inside, and lam(T) is known. The collocation is kept where the start of an interval is missed.
    """
    new = lam.copy()
    new[:-1, -1] = lam[1:, 0]
    new[-1, -1] = integrator.at_end(problem, x[-1, -1], found.nu)
    for k in range(h.shape[1] - 1, -1, -1):
        new[:, k] = integrator.stepped_back(
            problem, new[:, k + 1], x[:, k], u[:, k], u[:, k + 1], h[:, k])
    size = np.maximum(np.abs(lam).max(axis=(0, 1)), 1e-300)
    with np.errstate(invalid='ignore'):
        near = (np.abs(new[:, 0] - lam[:, 0]) <= _OFF * size).all(axis=1)
    return np.where(near[:, None, None], new, lam)


def _joined(problem: Problem, integrator: CostateIntegrator, found: Phased, t: Array, x: Array,
            u: Array, lam: Array, density: Array) -> Solution:
    """Return the samples of all intervals in a row, two at a time at which a value jumps."""
    K, s = t.shape
    switches = _switches(found, u)
    t, (x, u, lam, density) = t.ravel(), (
        values.reshape(K * s, -1) for values in (x, u, lam, density))
    t[s::s] = t[s - 1:-1:s]
    u = np.clip(u, problem.u_lower, problem.u_upper)
    new = find_new_samples(t, (u, lam, density), 1e-9)
    t, x, u, lam, density = (values[new] for values in (t, x, u, lam, density))
    t = problem.final_time.place_end(t)
    H, _, _ = integrator.hamiltonian(problem, x, u, lam)
    n = problem.n
    return Solution(
        status=Status.NOT_CONVERGED, message='', objective=found.cost, t=t, x=x, u=u, lam=lam,
        hamiltonian=H, nu=found.nu, state_multipliers=density[:, :n],
        path_multipliers=density[:, n:] if problem.path.numel() else None,
        switching_times=switches)


def _switches(found: Phased, u: Array) -> Array:
    """Return the ends of phases at which active constraints change or an input (K, s, m) jumps."""
    first = np.flatnonzero(np.diff(found.phase_of)) + 1
    # A smaller change of an input between phases is no jump.
    jumps = np.abs(u[first, 0] - u[first - 1, -1]) > 1e-3 * np.abs(u).max(axis=(0, 1))
    none = (0,) * found.eta.shape[2]
    changes = np.array([
        any(after.met) or (before.on or none) != (after.on or none)
        or not np.array_equal(before.levels, after.levels, equal_nan=True)
        for before, after in pairwise(found.arcs)], dtype=bool)
    return np.asarray(np.cumsum(found.durations)[:-1][changes | jumps.any(axis=1)])
