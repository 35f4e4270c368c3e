# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Boundary arcs: contacts of a path with state constraints whose derivative inputs can hold at zero.

Such an arc is a phase that begins and ends on its bound, which fixes its times between arcs with
inputs at their bounds. Within a longer phase inputs would be linear across the jumps at its ends.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.numerics.samples import find_runs
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.arcs.input_arcs import Arc, tidy_arcs
from obc_ros.core.solver.transcription.program import TranscriptionOutcome

AT_BOUND = 1e-6   # relative distance from a bound up to which a constraint is active


@dataclass(frozen=True)
class StateContact:
    """
    A row of (x, c) at a bound in a span of time.

    :ivar row, sign: row, and 1 at its upper bound, -1 at its lower one.
    :ivar start, end: times [s].
    :ivar beside: length [s] next to it over which a jump may be smeared.
    """

    row: int
    sign: int
    start: float
    end: float
    beside: float


def find_contacts(problem: Problem, outcome: TranscriptionOutcome, value: Array, margin: Array,
                  decided: Mask, *, perhaps: bool = False,
                  near: float = AT_BOUND) -> list[StateContact]:
    """
    Find the contacts of a path with bounds of (x, c), from its mesh points.

    A phase that was held on a bound before is a contact as a whole.

    :param value: (N + 1, n + l), x and the path constraints at the mesh points.
    :param margin: (n + l,), tightening of the bounds.
    :param decided: (n + l,), rows that are considered: those that inputs can hold at a bound.
    :param perhaps: also return points at which a path turns back within an interval's change of a
        bound.
    :param near: relative distance up to which a bound is active.
    """
    found = []
    t, N = outcome.path.t, len(outcome.path.t) - 1
    on = np.zeros((N, value.shape[1]), dtype=np.int64) if outcome.mesh.on is None else (
        outcome.mesh.on[outcome.mesh.layout.phase_of])
    lower, upper = problem.row_bounds
    lower, upper = lower + margin, upper - margin
    for row in np.flatnonzero(decided & (lower < upper)):
        for sign, bound in ((1, upper[row]), (-1, lower[row])):
            if not math.isfinite(bound):
                continue
            size = max(float(np.abs(value[:, row]).max()), abs(bound))
            room = sign * (bound - value[:, row])
            close = room <= near * (size or 1.0)
            close[:-1] |= on[:, row] == sign
            close[1:] |= on[:, row] == sign
            if perhaps:
                step = np.diff(room)
                close[1:-1] |= (step[:-1] <= 0) & (step[1:] >= 0) & (
                    room[1:-1] <= np.maximum(-step[:-1], step[1:]))
            for first, last in find_runs(close):
                if last == 0 or first == N:
                    continue
                h = max(t[first] - t[max(first - 1, 0)], t[min(last + 1, N)] - t[last])
                wide = 0.25 * h if first == last else 0.0
                # A jump at the end of a contact may be smeared over 2.5 intervals.
                found.append(StateContact(int(row), sign, max(t[first] - wide, 0.0),
                                          min(t[last] + wide, t[-1]), 2.5 * h))
    return found


def add_contacts(arcs: Sequence[Arc], found: Sequence[StateContact], free: Mask,
                 mixed: Mask | None = None) -> list[Arc]:
    """
    Cut arcs at the ends of contacts, and set their bounds active between these.

    The rest of an arc between a contact and the next arc, if it is short, is a jump smeared by a
    coarse mesh: its inputs take the levels of the arc beside it.

    :param free: (n + l, m), inputs that follow from the bound of each row, and become free on it.
    :param mixed: (n + l,), optional, rows that depend on inputs: inputs at bounds stay there. If
        all of a row do, it does not become active.
    """
    T = arcs[-1].end
    times = np.unique([0.0, T] + [arc.end for arc in arcs]
                      + [time for each in found for time in (each.start, each.end)])
    times = times[np.append(True, np.diff(times) > 1e-7 * T)]
    times[-1] = T
    cut = []
    for start, end in zip(times[:-1], times[1:], strict=True):
        middle = 0.5 * (start + end)
        arc = next(arc for arc in arcs if middle < arc.end)
        levels, on = list(arc.levels), list(arc.on or [0] * len(free))
        for each in found:
            if each.start < middle < each.end:
                follow = np.flatnonzero(free[each.row]).tolist()
                if mixed is not None and mixed[each.row]:
                    follow = [i for i in follow if math.isnan(levels[i])]
                    if not follow:
                        continue
                on[each.row] = each.sign
                for i in follow:
                    levels[i] = math.nan
        cut.append(Arc(float(start), float(end), tuple(levels), tuple(on)))
    for step in (1, -1):
        cut = _unsmeared(cut[::step], found, free)[::step]
    return tidy_arcs(cut)


def _unsmeared(arcs: list[Arc], found: Sequence[StateContact], free: Mask) -> list[Arc]:
    """Return arcs, in either order, with the levels before a smeared jump kept up to a contact."""
    beside = max(each.beside for each in found)
    result = arcs[:1]
    for k in range(1, len(arcs)):
        arc, before = arcs[k], result[-1]
        after = arcs[k + 1] if k + 1 < len(arcs) else None
        levels = list(arc.levels)
        if after and any(after.on) and not any(arc.on) and not any(before.on) and (
                arc.end - arc.start < beside):
            for i in np.flatnonzero(free[np.flatnonzero(after.on)].any(axis=0)):
                if math.isnan(levels[i]):
                    levels[i] = before.levels[i]
        result.append(Arc(arc.start, arc.end, tuple(levels), arc.on))
    return result
