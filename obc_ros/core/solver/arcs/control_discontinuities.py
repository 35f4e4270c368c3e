# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Jumps of inputs that are not at bounds, and arcs that end there.

The direction of a thrust in a disc may jump, and so does an input at a time at which H has two
global minima. On a mesh a jump is a slope over one or two intervals, however fine the mesh is;
between arcs of unknown lengths it is a jump.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.solver.arcs.input_arcs import Arc
from obc_ros.core.solver.transcription.mesh import build_path, LINEAR, Path
from obc_ros.core.solver.transcription.program import TranscriptionOutcome

SLIGHT_JUMP = 0.05   # change of an input, as part of its size, up to which it does not jump
_APART = 1.5        # distance in intervals up to which a jump and an end of an arc are the same


def _find_jumps(path: Path, of: Sequence[bool], jump: float) -> Array:
    """
    Find the times at which inputs jump, or change so steeply that the mesh hides a jump.

    :param of: length m, inputs to consider.
    :param jump: change of an input, as part of its range on the path, that may be a jump.
    :return: times [s], sorted.
    """
    t, chosen = path.t, np.array(of, dtype=bool)
    u = np.stack([path.ua, path.ub])[:, :, chosen]
    size = np.maximum(np.ptp(u, axis=(0, 1)), 1e-300)
    within = np.abs(u[1] - u[0]) / size
    between = np.abs(u[0, 1:] - u[1, :-1]) / size
    found = list(t[1:-1][(between > jump).any(axis=1)])
    # A jump hidden in one or two intervals: compare with the intervals before and after them.
    for count in (1, 2):
        if len(within) < count + 2:
            break
        moved = sum(within[k:len(within) - count - 1 + k] for k in range(1, count + 1))
        beside = np.maximum(within[:len(moved)], within[count + 1:count + 1 + len(moved)])
        steep = (moved > jump) & (beside < 0.25 * moved)   # else a slope of several intervals
        for k in np.flatnonzero(steep.any(axis=1)):
            middle = 0.5 * (t[k + 1] + t[k + 1 + count])
            near = _APART * (t[k + 1 + count] - t[k + 1])
            if all(abs(middle - other) > near for other in found):
                found.append(middle)
    return np.sort(np.array(found))


def cut_at_jumps(arcs: Sequence[Arc], path: Path, of: Sequence[bool],
                 mixed: Sequence[bool], jump: float) -> list[Arc]:
    """
    Cut arcs at the jumps of inputs that are free there.

    :param arcs: without gaps. Those on state bounds are not cut: there inputs follow the bound.
    :param of: length m, inputs to consider.
    :param mixed: length n + l, rows of (x, c) that depend on inputs; arcs on these alone are cut.
    :param jump: as for `_find_jumps`.
    :return: with `jump` where they begin at a jump.
    """
    kept = list[Arc]()
    T, times = path.t[-1], _find_jumps(path, of, jump)
    widths = np.diff(path.t)
    for arc in arcs:
        start = arc.start
        follows = any(on and not (mixed and mixed[row]) for row, on in enumerate(arc.on))
        free = np.isnan(arc.levels) & np.array(of) & (not follows)
        for time in times if free.any() else ():
            width = _APART * widths[min(int(np.searchsorted(path.t, time, 'right')) - 1,
                                        len(widths) - 1)]
            if start + min(width, 0.02 * T) < time < arc.end - min(width, 0.02 * T):
                kept.append(replace(arc, start=start, end=float(time), jump=start > arc.start))
                start = float(time)
        kept.append(replace(arc, start=start, jump=start > arc.start))
    return kept


def sharpen_steps(path: Path, arcs: Sequence[Arc]) -> Path:
    """
    Replace slopes of inputs by steps where arcs begin with a jump.

    Inputs on the slope are poor initial values: an input that is a direction and starts on the
    wrong side of its jump stays there.

    :param arcs: those with `jump` give the times.
    :return: on a finer grid, without inner points.
    """
    times = np.array([arc.start for arc in arcs if arc.jump])
    if not times.size:
        return path
    h = np.diff(path.t)
    width = _APART * h[np.clip(np.searchsorted(path.t, times) - 1, 0, len(h) - 1)]
    t = np.unique(np.concatenate([path.t, times, times - width, times + width]))
    t = t[(t >= 0) & (t <= path.t[-1])]
    t = t[np.append(True, np.diff(t) > 1e-9 * t[-1])]
    ua, ub = t[:-1].copy(), t[1:].copy()
    for time, wide in zip(times, width, strict=True):
        near = 1e-6 * wide
        ua[(ua >= time - near) & (ua < time + wide)] = time + wide
        ua[(ua > time - wide) & (ua < time - near)] = time - wide
        ub[(ub > time - wide) & (ub <= time + near)] = time - wide
        ub[(ub > time + near) & (ub < time + wide)] = time + wide
    return build_path(t, path.states_at(t), path.inputs_at(ua, after=True),
                      path.inputs_at(ub, after=False), path.durations)


def find_switching_times(outcome: TranscriptionOutcome) -> Array:
    """Return the ends of phases [s] at which inputs jump, or meet or leave bounds."""
    mesh, path = outcome.mesh, outcome.path
    ends = np.cumsum(path.durations)[:-1]
    if mesh.on is not None and mesh.on.any():
        return np.asarray(ends)
    first = np.flatnonzero(np.diff(mesh.layout.phase_of)) + 1
    free = np.array([set(phase.modes) == {LINEAR} for phase in mesh.layout.phases])
    size = np.ptp(np.stack([path.ua, path.ub]), axis=(0, 1))
    # A change of up to 1 % of the range is no jump.
    level = np.all(np.abs(path.ua[first] - path.ub[first - 1]) <= 0.01 * size, axis=1)
    return np.asarray(ends[~(level & free[:-1] & free[1:])])
