# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The indirect method: Pontryagin's boundary value problem from an answer of the transcription.

Its costates and switching times are exact to rounding; the input returned with them is the best
piecewise linear one on a fine mesh with points where they say.
"""

from dataclasses import replace

import numpy as np
from obc_ros.core.arcs import Arc, arc_mesh, find_arcs
from obc_ros.core.indirect import BoundaryValues, Indirect
from obc_ros.core.mesh import split
from obc_ros.core.refine import aligned
from obc_ros.core.search import Search
from obc_ros.core.solution import Solution

_INTERVALS = 120


def polished(search: Search, answer: Solution) -> Solution:
    """Return the indirect answer near one found by a search, or that one with the reason."""
    problem, last = search.stated, search.last
    if last is None:
        return answer
    if search.bounded or search.kit.twin:
        return replace(answer, message='answered by transcription: indirect does without state '
                                       'bounds, path constraints and absolute values')
    arcs = find_arcs(problem, last.outcome.path, (True,) * problem.m)
    course = search.course(last.outcome)
    sizes = search.sizes(last.outcome)
    found = Indirect(problem).solve(problem, arcs, course, last.outcome.path.t, sizes)
    if found is None:
        return replace(answer, message='answered by transcription: no extremal was found from it '
                                       'on which the inputs are at bounds or make dH/du zero')
    better = _refitted(search, arcs, found)
    if better is None or not (better.certificate and better.certificate.holds):
        return answer
    return better


def _refitted(search: Search, arcs: list[Arc], found: BoundaryValues) -> Solution | None:
    """Return the answer on a mesh with points at the ends of the arcs that were found."""
    assert search.last is not None
    problem, path = search.stated, search.last.outcome.path
    ends = np.cumsum(found.lengths)
    exact = [replace(arc, start=float(end - length), end=float(end))
             for arc, end, length in zip(arcs, ends, found.lengths, strict=True)]
    jumps = [b for b, (one, other) in enumerate(zip(exact[:-1], exact[1:], strict=True))
             if any(np.isfinite([u, v]).all() and u != v
                    for u, v in zip(one.levels, other.levels, strict=True))]
    spans = []
    for first, last in zip([0, *(b + 1 for b in jumps)], [*jumps, len(exact) - 1], strict=True):
        group = exact[first:last + 1]
        levels = tuple(values[0] if len(set(values)) == 1 else np.nan
                       for values in zip(*(arc.levels for arc in group), strict=True))
        spans.append(Arc(group[0].start, group[-1].end, levels))
    before = search.last.outcome.mesh
    if len(before.layout.phases) == len(spans):
        mesh = split(before, np.full(before.layout.intervals, 2))
        durations = np.array([arc.end - arc.start for arc in spans])
    else:
        mesh, durations = arc_mesh(problem, spans, search.stages, _INTERVALS / ends[-1], (8, 8))
    t = np.append(0.0, np.cumsum(mesh.fractions * durations[mesh.layout.phase_of]))
    mesh = aligned(mesh, t, ends[:-1])
    if not search.monitor.allows(mesh.layout.intervals):
        return None
    outcome = search.collocate(mesh, path, durations, near=True,
                               sizes=search.sizes(search.last.outcome))
    if not outcome.converged:
        return None
    course = search.course(outcome)
    scale = found.t[-1] / course.t[-1]
    answer = search.solution(outcome, replace(
        course, lam=found.costates_at(course.t[:-1] * scale),
        lam_end=found.costates_at(course.t[1:] * scale), nu=found.nu))
    return replace(answer, switching_times=ends[:-1])
