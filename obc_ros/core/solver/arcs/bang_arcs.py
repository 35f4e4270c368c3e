# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Bang arcs in phases in which an input is free: cuts where it meets or leaves its bound.

An input that meets a bound and stays there has a kink, which the polynomials of the collocation
do not follow: the part at the bound becomes an arc of its own. Next to a singular arc such a part
may be shorter than an interval. It is found from dH/du, which does not vanish on it.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.arcs.input_arcs import Arc, tidy_arcs
from obc_ros.core.solver.arcs.phase_program import PhasedProgram
from obc_ros.core.solver.arcs.phases import Phased


def cut_at_bounds(problem: Problem, found: Phased, switching: Mask, deciding: Mask) -> list[Arc]:
    """
    Cut the arcs of a path where inputs meet or leave their bounds.

    :param switching: (m,), inputs in which H is linear; the others are ignored.
    :param deciding: (n + l, m), inputs that occur in the derivative of each row of (x, c). On an
        arc along the bound of a row these follow from it and are ignored.
    """
    span = problem.u_upper - problem.u_lower
    ends = np.cumsum(found.h)
    arcs: list[Arc] = []
    for phase, arc in enumerate(found.arcs):
        of = np.flatnonzero(found.phase_of == phase)
        free = np.isnan(arc.levels) & switching & np.isfinite(span)
        if arc.on:
            free &= ~deciding[np.flatnonzero(arc.on)].any(axis=0)
        u = found.u[of]
        at = np.full(u.shape[::2], np.nan)
        for bound in (problem.u_lower, problem.u_upper):
            here = np.all(np.abs(u - bound) <= 1e-6 * span, axis=1) & free
            at = np.where(here, bound, at)
        edges = np.flatnonzero(np.any((at[1:] != at[:-1]) & ~(
            np.isnan(at[1:]) & np.isnan(at[:-1])), axis=1))
        start = arc.start
        for part in np.split(np.arange(len(of)), edges + 1):
            end = arc.end if part[-1] == len(of) - 1 else float(ends[of[part[-1]]])
            levels = np.where(np.isnan(at[part[0]]), arc.levels, at[part[0]])
            arcs.append(replace(arc, start=start, end=end, levels=tuple(levels.tolist()),
                                met=arc.met if start == arc.start else (),
                                jump=arc.jump and start == arc.start))
            start = end
    return arcs


def cut_at_ends(problem: Problem, program: PhasedProgram, found: Phased, t: Array, x: Array,
                u: Array, Hu: Array) -> list[Arc]:
    """
    Insert short bang arcs at the ends of the singular arcs of a path.

    dH/du vanishes on a singular arc. If it does not at an end of it, the input should be at a
    bound there, up to the time at which dH/du changes its sign.

    :param t, x, u, Hu: (N,), (N, n), (N, m), (N, m), samples of the path, and dH/du [cost per
        second and unit of the input].
    """
    bounds = program.bounds

    def hold(arc: Arc, j: int, at: int, level: float) -> Arc:
        """Return the arc with the input at its bound, or on a path constraint met before."""
        there = u[at].copy()
        there[j] = level
        value = program.rows(x[at], there, problem.p_value).full().ravel()[problem.n:]
        for row in np.flatnonzero((bounds.orders == 0) & bounds.deciding[:, j]):
            c = value[row - problem.n]
            sign = int(c > problem.path_upper[row - problem.n]) - int(
                c < problem.path_lower[row - problem.n])
            if sign:
                on = arc.on or (0,) * bounds.count
                return replace(arc, on=(*on[:row], sign, *on[row + 1:]))
        return replace(arc, levels=(*arc.levels[:j], level, *arc.levels[j + 1:]))

    return _insert_bangs(problem, found.arcs, program.switching, bounds.deciding, (t, u, Hu), hold)


def close_ends(problem: Problem, arcs: Sequence[Arc], switching: Mask, deciding: Mask,
               samples: tuple[Array, Array, Array]) -> list[Arc]:
    """
    Insert short bang arcs at the ends of the singular arcs of a path on a coarse mesh.

    :param arcs: as detected from the inputs, in which a bang shorter than an interval does not
        show.
    :param switching, deciding: (m,), (n + l, m), as in `cut_at_bounds`.
    :param samples: (K,), (K, m), (K, m), times, inputs, and dH/du there [cost per second and unit
        of the input].
    :return: equal arcs that follow each other are one arc.
    """
    def hold(arc: Arc, j: int, _: int, level: float) -> Arc:
        return replace(arc, levels=(*arc.levels[:j], level, *arc.levels[j + 1:]))

    return tidy_arcs(_insert_bangs(problem, arcs, switching, deciding, samples, hold, hidden=True))


def _insert_bangs(problem: Problem, arcs: Sequence[Arc], switching: Mask, deciding: Mask,
                  samples: tuple[Array, Array, Array],
                  hold: Callable[[Arc, int, int, float], Arc], *, hidden: bool = False
                  ) -> list[Arc]:
    """
    Return arcs with bangs where dH/du does not vanish at an end of a singular arc.

    `samples`: times, inputs and dH/du. `hold` returns an arc with input j at a level, from the
    sample at its outer end. A bang ends where dH/du changes its sign; if it is `hidden`, shorter
    than an interval, at the first sample.
    """
    t, u, Hu = samples
    span = problem.u_upper - problem.u_lower
    worth = np.abs(Hu) * np.where(np.isfinite(span), span, 0.0)
    least = 1e-5 * np.abs(Hu * u).sum(axis=1).max()   # decrease of H by a bang
    result: list[Arc] = []
    for arc in arcs:
        rows = np.flatnonzero((t > arc.start) & (t < arc.end))
        singular = switching & np.isnan(arc.levels) & np.isfinite(span)
        if arc.on:
            singular &= ~deciding[np.flatnonzero(arc.on)].any(axis=0)
        parts = [arc]
        for j in np.flatnonzero(singular) if rows.size else ():
            for at in rows, rows[::-1]:
                slope, first = np.sign(Hu[at, j]), at[0]
                change = t[at[np.argmax(slope * slope[0] <= 0)]]   # t[first] if there is none
                here = parts[0 if first == rows[0] else -1]
                # A bang must gain enough, and take at most a fifth of the phase.
                if worth[first, j] < max(least, 0.3 * worth[rows, j].max()) or not (
                        0 < abs(change - t[first]) < 0.2 * (here.end - here.start)):
                    continue
                change = t[first] if hidden else change
                bang = hold(here, int(j), int(first), float(
                    (problem.u_upper if slope[0] < 0 else problem.u_lower)[j]))
                if first == rows[0]:
                    parts[:1] = [replace(bang, end=float(change)),
                                 replace(here, start=float(change), met=(), jump=False)]
                else:
                    parts[-1:] = [replace(here, end=float(change)),
                                  replace(bang, start=float(change), met=(), jump=False)]
        result.extend(parts)
    return result
