# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Arcs on which mixed constraints c(x, u) are active, found from their multipliers.

The distance from the bound is not a reliable criterion: a linear input leaves a circle on which it
should be between mesh points, or at them. The multiplier vanishes where the constraint is
inactive.
"""

from dataclasses import replace

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.collocation import build_collocation
from obc_ros.core.numerics.samples import find_runs
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.arcs.constraint_orders import BoundRates
from obc_ros.core.solver.arcs.input_arcs import Arc
from obc_ros.core.solver.arcs.phase_program import PhasedProgram
from obc_ros.core.solver.arcs.phases import DEGREE, drop_negligible, Phased
from obc_ros.core.solver.arcs.state_contacts import add_contacts, StateContact
from obc_ros.core.solver.transcription.program import TranscriptionOutcome

_WEIGHS = 1e-4   # density, relative to the largest one, from which on a constraint is active


def compute_densities(outcome: TranscriptionOutcome, slopes: Array, u: Array) -> Array:
    """
    Return the multiplier densities of path constraints of a transcription.

    :param slopes: (K, l, m), derivatives of the constraints by the inputs, at K points.
    :param u: (K, m), the inputs there.
    :return: (N, points, l), > 0 at upper bounds. Values that are negligible relative to the cost,
        which an interior-point method leaves on inactive constraints, are set to 0.
    """
    h = np.maximum(np.diff(outcome.path.t), 1e-300)
    found = np.concatenate([outcome.inner_path, outcome.sides_path], axis=1) / h[:, None, None]
    return drop_negligible(found, outcome.objective / h.sum(), slopes, u)


def find_active(problem: Problem, outcome: TranscriptionOutcome,
                program: PhasedProgram) -> list[StateContact]:
    """Find the intervals on which multipliers show that path constraints of inputs are active."""
    path, n, bounds, t = outcome.path, problem.n, program.bounds, outcome.path.t
    slopes = program.input_slopes(problem, path.x[:-1], path.ua)[:, n:]
    weights = compute_densities(outcome, slopes, path.ua)
    found = []
    for row in np.flatnonzero(bounds.orders[n:] == 0).tolist():
        least = _WEIGHS * np.abs(weights[:, :, row]).max(initial=0.0)
        for sign in (1, -1):
            for first, last in find_runs(np.max(sign * weights[:, :, row], axis=1) > least):
                found.append(StateContact(n + row, sign, t[first], t[last + 1], 0.0))
    return found


def hold_constraints(arcs: list[Arc], found: Phased, bounds: BoundRates) -> list[Arc]:
    """
    Update the arcs on constraints that depend on inputs from the multipliers of a path on phases.

    `arcs` itself is returned if no constraint was added or removed.
    """
    rows = np.flatnonzero(bounds.orders == 0)
    points = np.append(0.0, np.cumsum(found.h))
    t = points[:-1, None] + found.h[:, None] * build_collocation(DEGREE, 'radau')[0]
    new: list[StateContact] = []
    changed = False
    for row in rows.tolist():
        largest = float(np.abs(found.eta[:, :, row]).max())
        for phase, arc in enumerate(found.arcs):
            of = found.phase_of == phase
            eta, times, h = found.eta[of, :, row].ravel(), t[of].ravel(), found.h[of].max()
            now = arc.on[row] if arc.on else 0
            for sign in (now,) if now else (1, -1):
                # An arc that is held is kept up to a slightly wrong sign.
                heavy = sign * eta > (-1e-6 if now else _WEIGHS) * largest
                if now and heavy.all():
                    new.append(StateContact(row, sign, arc.start, arc.end, 0.0))
                    continue
                for first, last in find_runs(heavy):
                    if last - first >= DEGREE:
                        new.append(StateContact(row, sign, max(times[first] - h / 2, arc.start),
                                                min(times[last] + h / 2, arc.end), 0.0))
                        changed = changed or not now
                changed = changed or bool(now)
    if not changed:
        return arcs
    off = [replace(arc, on=tuple(0 if row in rows else on for row, on in enumerate(arc.on)))
           for arc in arcs]
    return add_contacts(off, new, bounds.deciding, bounds.orders == 0) if new else off


def move_onto_constraints(problem: Problem, program: PhasedProgram, found: Phased, x: Array,
                          u: Array) -> Array:
    """
    Project samples of inputs onto the constraint that is active in each phase.

    The polynomials satisfy it at the collocation points only.

    :param x, u: (K, s, n), (K, s, m), s samples in each of its K intervals.
    :return: (K, s, m), inputs; unchanged in phases with no or several such constraints.
    """
    bounds, u = program.bounds, u.copy()
    for phase, arc in enumerate(found.arcs):
        rows = [row for row, on in enumerate(arc.on) if on and bounds.orders[row] == 0]
        here = np.flatnonzero(found.phase_of == phase)
        if len(rows) != 1:
            continue
        row, free = rows[0], np.isnan(arc.levels)
        limit = problem.row_bounds[int(arc.on[row] > 0)][row]
        points, inputs = x[here].reshape(-1, problem.n), u[here].reshape(-1, problem.m)
        value, slopes = (each.map(len(points)) for each in (program.rows, program.rows_u))
        for _ in range(3):   # Newton steps
            off = value(points.T, inputs.T, problem.p_value).full()[row] - limit
            slope = slopes(points.T, inputs.T, problem.p_value).full()[row].reshape(
                -1, problem.m) * free
            size = np.maximum(np.sum(slope**2, axis=1), 1e-300)
            inputs = inputs - np.where(size > 1e-12 * size.max(), off / size, 0.0)[:, None] * slope
        u[here] = inputs.reshape(len(here), -1, problem.m)
    return u
