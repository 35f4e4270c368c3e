# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Inputs that are at their bounds for a part of a phase in which they are free.

A polynomial that comes to a bound and stays there bends where it does, which steps do not follow:
the part at the bound is an arc of its own.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.arcs import Arc
from obc_ros.core.phased import Phased
from obc_ros.core.problem import Problem

_AT = 1e-6        # of its span: how near its bound an input is at it


def at_bounds(problem: Problem, found: Phased, switching: NDArray[np.bool_],
              deciding: NDArray[np.bool_]) -> list[Arc]:
    """
    Return the arcs of a path that was found, cut where inputs come to their bounds in them.

    Of the inputs in `switching`, shape (m,); where a bound of (x, c) is held, those which it
    decides (`deciding`, shape (n + l, m)) are left alone.
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
            here = np.all(np.abs(u - bound) <= _AT * span, axis=1) & free
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
