# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Input arcs: spans of time on which each input that occurs linearly in H is at a bound or free.

Between switching times such an input is held at a bound (bang) or free (singular, or on a state
bound). The switching times become unknown lengths of phases, so that a jump is not smeared over
an interval. The arcs are detected on a path found before, and again on the path found with them,
until they do not change.

The module is long because detection and correction of arcs share their thresholds.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
import math

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index, Mask
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.structure import find_mixed_equalities
from obc_ros.core.solver.transcription.mesh import HELD, Layout, LINEAR, Mesh, Path, Phase

# For each arc the level of each input, None where it is free, and the bounds it is on or touches.
Signature = tuple[tuple[float | None, ...], ...]

_LOWER, _INSIDE, _UPPER = -1, 0, 1


@dataclass(frozen=True)
class Arc:
    """
    A span of time with known inputs at bounds and known active constraints.

    :ivar start, end: times [s].
    :ivar levels: length m, values of the inputs at bounds; nan where the input is free.
    :ivar on: length n + l, for each row of (x, c) the bound that is active on the arc: 1 upper, -1
        lower, 0 none; empty: none at all.
    :ivar met: length n + l, the bounds that are touched where the arc begins, in the same form.
    :ivar jump: whether the arc begins only because an input may jump there.
    """

    start: float
    end: float
    levels: tuple[float, ...]
    on: tuple[int, ...] = ()
    met: tuple[int, ...] = ()
    jump: bool = False


@dataclass(frozen=True)
class _Span:
    start: float
    end: float
    level: float


def find_jumping_inputs(problem: Problem, path: Path) -> tuple[bool, ...]:
    """Return which inputs go from bound to bound within one or two intervals, length m."""
    jumps = []
    for i in range(problem.m):
        lower, upper = problem.u_lower[i], problem.u_upper[i]
        if not math.isfinite(upper - lower):
            jumps.append(False)
            continue
        u = np.append(path.ua[:, i], path.ub[-1, i])
        low, high = (u <= lower + 1e-3 * (upper - lower)), (u >= upper - 1e-3 * (upper - lower))
        near = np.zeros(len(u), dtype=bool)
        for shift in (1, 2):
            near[:-shift] |= low[:-shift] & high[shift:] | high[:-shift] & low[shift:]
        jumps.append(bool(near.any()))
    return tuple(jumps)


def find_arcs(problem: Problem, path: Path, switching: Sequence[bool],
              curved: Sequence[bool] | None = None) -> list[Arc]:
    """
    Detect the arcs of a path.

    :param switching: length m, inputs that may be held at bounds; the others are free.
    :param curved: length m, optional, inputs in which H is not linear. Such an input meets a bound
        without a jump: a span at a bound next to a free span becomes free.
    :return: in order of time, without gaps.
    """
    spans = []
    t = np.column_stack([path.t[:-1], path.t[1:]]).ravel()
    u = np.stack([path.ua, path.ub], axis=1).reshape(-1, problem.m)
    span = problem.u_upper - problem.u_lower
    near = 1e-3 * np.where(np.isfinite(span), span, np.maximum(1e-9, np.ptp(u, axis=0)))
    status = np.where(u <= problem.u_lower + near, _LOWER,
                      np.where(u >= problem.u_upper - near, _UPPER, _INSIDE))
    for inputs in find_mixed_equalities(problem):
        _free_farthest(status, u, problem, np.flatnonzero(inputs))
    for i, switches in enumerate(switching):
        bounded = math.isfinite(problem.u_lower[i]) or math.isfinite(problem.u_upper[i])
        if switches and bounded:
            row = _spans(t, u[:, i], status[:, i], problem.u_lower[i], problem.u_upper[i])
            spans.append(_unheld(row) if curved is not None and curved[i] else row)
        else:
            spans.append([_Span(0.0, path.t[-1], math.nan)])
    return join(spans)


def _unheld(spans: list[_Span]) -> list[_Span]:
    """Return spans with those next to a free one free, too; the boundaries stay."""
    free = [math.isnan(span.level) for span in spans]
    kept: list[_Span] = []
    for k, span in enumerate(spans):
        beside = any(free[max(k - 1, 0):k + 2])
        level = math.nan if beside else span.level
        joins = kept and math.isnan(level) and math.isnan(kept[-1].level) and (
            free[k] or free[k - 1])
        start = kept.pop().start if joins else span.start
        kept.append(_Span(start, span.end, level))
    return kept


def join(spans: Sequence[Sequence[_Span]]) -> list[Arc]:
    """Return arcs that end at each end of a span of any input."""
    ends = sorted({span.end for row in spans for span in row})
    arcs, start = [], 0.0
    for end in ends:
        middle = (start + end) / 2
        levels = tuple(next((s.level for s in row if s.end > middle), row[-1].level)
                       for row in spans)
        if end > start:
            arcs.append(Arc(start, end, levels))
            start = end
    return arcs


def _free_farthest(status: Array, u: Array, problem: Problem, of: Index) -> None:
    """Set one input of an equality inside where all of them seem to be at bounds."""
    lower, upper = problem.u_lower[of], problem.u_upper[of]
    distance = np.minimum(u[:, of] - lower, upper - u[:, of])
    held = np.flatnonzero((status[:, of] != _INSIDE).all(axis=1))
    status[held, of[np.argmax(distance[held], axis=1)]] = _INSIDE


def _spans(t: Array, u: Array, status: Array, lower: float, upper: float) -> list[_Span]:
    """Return the spans of an input at bounds and free, with steep slopes replaced by jumps."""
    edges = np.flatnonzero(np.diff(status)) + 1
    runs = [(int(part[0]), int(part[-1])) for part in np.split(np.arange(len(t)), edges)]
    level = {_LOWER: lower, _UPPER: upper, _INSIDE: math.nan}
    found: list[_Span] = []
    for first, last in runs:
        here = level[int(status[first])]
        if status[first] != _INSIDE:
            found.append(_Span(t[first], t[last], here))
            continue
        before, after = max(first - 1, 0), min(last + 1, len(t) - 1)
        if len(np.unique(t[first:last + 1])) > 2 or not math.isfinite(upper - lower):
            start, end = t[first], t[last]
            if before < first and t[before] < start:
                start = _leaves(t[before:last + 1], u[before:last + 1])
                found[-1] = _Span(found[-1].start, start, found[-1].level)
            if after > last and t[after] > end:
                end = -_leaves(-t[first:after + 1][::-1], u[first:after + 1][::-1])
            found.append(_Span(start, end, here))
            continue
        window = slice(before, after + 1)
        found.extend(_jump(t[window], u[window], lower, upper, status[before], status[after]))
    return _tidy(found, t[-1])


def _leaves(t: Array, u: Array) -> float:
    """Return the time of a jump with the same integral as the slope by which an input leaves."""
    times = np.unique(t)
    end = times[min(2, len(times) - 1)]
    inside = t <= end
    later = u[np.flatnonzero(inside)[-1]]
    if u[0] == later:
        return float(end)
    area = np.trapezoid(u[inside], t[inside]) - later * (end - t[0])
    return float(np.clip(t[0] + area / (u[0] - later), t[0], end))


def _jump(t: Array, u: Array, lower: float, upper: float, before: int, after: int
          ) -> list[_Span]:
    """Return spans at bounds with the same integral as a short slope between bounds."""
    a, b = t[0], t[-1]
    part = (np.trapezoid(u, t) / max(b - a, 1e-300) - lower) / (upper - lower)
    if before == _INSIDE:
        before = -after
    if after == _INSIDE:
        after = -before
    if before == _LOWER and after == _UPPER:
        return [_Span(a, b - part * (b - a), lower), _Span(b - part * (b - a), b, upper)]
    if before == _UPPER and after == _LOWER:
        return [_Span(a, a + part * (b - a), upper), _Span(a + part * (b - a), b, lower)]
    base, pulse = (lower, upper) if before == _LOWER else (upper, lower)
    width = (part if before == _LOWER else 1 - part) * (b - a)
    if width < 0.1 * (b - a):
        return [_Span(a, b, base)]
    middle = (a + b) / 2
    return [_Span(a, middle - width / 2, base),
            _Span(middle - width / 2, middle + width / 2, pulse),
            _Span(middle + width / 2, b, base)]


def _tidy(spans: list[_Span], T: float) -> list[_Span]:
    """Return spans without gaps, with equal neighbours merged, none shorter than 1e-7 T."""
    kept: list[_Span] = []
    for span in spans:
        start = kept[-1].end if kept else 0.0
        if span.end - start <= 1e-7 * T:
            continue
        same = kept and (kept[-1].level == span.level
                         or math.isnan(kept[-1].level) and math.isnan(span.level))
        if same:
            kept[-1] = _Span(kept[-1].start, span.end, span.level)
        else:
            kept.append(_Span(start, span.end, span.level))
    kept[-1] = _Span(kept[-1].start, T, kept[-1].level)
    return kept


def build_arc_mesh(problem: Problem, arcs: Sequence[Arc], stages: int, density: float
                   ) -> tuple[Mesh, Array]:
    """
    Build a mesh with one phase for each arc.

    :param stages: Gauss points in each interval.
    :param density: intervals per second.
    :return: mesh; durations: lengths of the arcs [s].
    """
    phases = []
    for arc in arcs:
        free = [math.isnan(level) for level in arc.levels]
        fewest = 8 if any(free) else 3
        count = max(fewest, math.ceil(density * (arc.end - arc.start)))
        phases.append(Phase(count, tuple(LINEAR if f else HELD for f in free)))
    layout = Layout(tuple(phases), stages, problem.final_time.free)
    fractions = np.concatenate([np.full(p.intervals, 1.0 / p.intervals) for p in phases])
    held = np.array([[0.0 if math.isnan(v) else v for v in arc.levels] for arc in arcs])
    on = np.array([arc.on or (0,) * (problem.n + int(problem.path.numel())) for arc in arcs])
    return Mesh(layout, fractions, held, on), np.array([arc.end - arc.start for arc in arcs])


def close_gaps(arcs: Sequence[Arc], T: float) -> list[Arc]:
    """Return arcs over [0, T] without gaps or active constraints, equal neighbours merged."""
    rows = [_tidy([_Span(arc.start, arc.end, arc.levels[i]) for arc in arcs], T)
            for i in range(len(arcs[0].levels))]
    return join(rows)


def tidy_arcs(arcs: Sequence[Arc], shortest: float = 0.0) -> list[Arc]:
    """Return arcs without those shorter than a part of T, with equal neighbours merged."""
    T = arcs[-1].end
    kept: list[Arc] = []
    for arc in arcs:
        if arc.end - arc.start < shortest * T:
            continue
        if kept and not (arc.met or arc.jump) and kept[-1].on == arc.on and np.array_equal(
                kept[-1].levels, arc.levels, equal_nan=True):
            kept[-1] = replace(kept[-1], end=arc.end)
        else:
            kept.append(replace(arc, start=kept[-1].end if kept else 0.0))
    kept[-1] = replace(kept[-1], end=T)
    return kept


def free_shared_inputs(arcs: Sequence[Arc], shared: Mask) -> list[Arc]:
    """
    Free the inputs of an equality with states on arcs on which it would have no free input.

    :param shared: (k, m), the inputs of each of k equalities, one at least. Inputs at bounds may
        satisfy an equality of inputs alone.
    """
    freed = []
    for arc in arcs:
        held = ~np.isnan(arc.levels)
        stuck = shared[(held | ~shared).all(axis=1)].any(axis=0)
        freed.append(replace(arc, levels=tuple(np.where(stuck, np.nan, arc.levels).tolist())))
    return freed


def limit_shortening(arcs: Sequence[Arc], curved: Mask, least: float) -> Array:
    """
    Return lower bounds of the lengths of arcs in the next solve [s].

    They are the part `least` of the present lengths. The end of an arc at the bound of a `curved`
    input (m,), in which H is not linear, next to a free one hardly changes the cost, so that it
    may move only a little.
    """
    lengths = np.array([arc.end - arc.start for arc in arcs])
    kept = least * lengths
    for k, pair in enumerate(pairwise(arcs)):
        held = ~np.isnan([arc.levels for arc in pair])
        for at, beside in ((0, 1), (1, 0)):
            if np.any(curved & held[at] & ~held[beside]) and not any(pair[beside].on):
                of = lengths[k + at]
                kept[k + at] = max(kept[k + at], of - min(of, lengths[k + beside]) / 2)
    return kept


def get_signature(arcs: Sequence[Arc]) -> Signature:
    """Return the levels of arcs and the bounds they are on or touch, without their times."""
    return tuple(tuple(None if math.isnan(v) else v for v in arc.levels) + (
        arc.on if any(arc.on) else ()) + ((None, *arc.met) if any(arc.met) else ())
        for arc in arcs)


def open_arcs(arcs: Sequence[Arc], t: Array, Hu: Array, problem: Problem,
              judged: Sequence[bool], moving: Sequence[bool]) -> list[Arc]:
    """
    Free inputs, or move them to the other bound, where dH/du has the wrong sign for their bound.

    :param t, Hu: (K + 1,), (K, m), fine times, and dH/du in each part.
    :param judged: inputs that are considered.
    :param moving: inputs that move to their other bound where dH/du is far from zero.
    """
    spans: list[list[_Span]] = []
    middle = (t[:-1] + t[1:]) / 2
    for i in range(problem.m):
        largest = float(np.max(np.abs(Hu[:, i]), initial=0.0))
        row: list[_Span] = []
        for arc in arcs:
            level = arc.levels[i]
            inside = np.flatnonzero((middle > arc.start) & (middle < arc.end))
            if math.isnan(level) or not len(inside) or not judged[i]:
                row.append(_Span(arc.start, arc.end, level))
                continue
            sign = 1.0 if level == problem.u_lower[i] else -1.0
            slope = sign * Hu[inside, i]
            bad = slope < -1e-4 * largest
            edges = np.flatnonzero(np.diff(bad)) + 1
            start = arc.start
            other = problem.u_upper[i] if sign > 0 else problem.u_lower[i]
            for part in np.split(np.arange(len(inside)), edges):
                end = arc.end if part[-1] == len(inside) - 1 else float(t[inside[part[-1]] + 1])
                if bad[part[0]]:
                    level = other if (moving[i] and math.isfinite(other) and np.min(slope[part])
                                      < -1e-3 * largest) else math.nan
                row.append(_Span(start, end, level if bad[part[0]] else arc.levels[i]))
                start = end
        spans.append(_tidy(row, arcs[-1].end))
    return join(spans)


def insert_free_arcs(arcs: Sequence[Arc], t: Array, Hu: tuple[Array, Array], curved: Sequence[bool]
                     ) -> list[Arc]:
    """
    Insert free arcs where an input does not jump but goes from bound to bound continuously.

    :param arcs: as found; slopes that are shorter than an interval look like jumps.
    :param t, Hu: (K,), (K, m), times, and dH/du with the input at its lower and its upper bound.
    :param curved: for each input whether H is not linear in it.
    """
    rows = []
    for i, bends in enumerate(curved):
        row = _tidy([_Span(arc.start, arc.end, arc.levels[i]) for arc in arcs], arcs[-1].end)
        rows.append(_sloped(row, t, Hu[0][:, i], Hu[1][:, i]) if bends else row)
    return join(rows)


def _sloped(row: list[_Span], t: Array, at_lower: Array, at_upper: Array) -> list[_Span]:
    """Return the spans of an input with a free one where dH/du vanishes before the jump."""
    lower = min(span.level for span in row)
    kept, start = [], 0.0
    for span, after in zip(row, row[1:], strict=False):
        kept.append(_Span(start, span.end, span.level))
        start = span.end
        if math.isnan(span.level) or math.isnan(after.level):
            continue
        first, last = (at_lower, at_upper) if span.level == lower else (at_upper, at_lower)
        leaves, comes = _vanishes(t, first, span.end), _vanishes(t, last, span.end)
        if kept[-1].start < leaves < comes < after.end:
            kept[-1] = _Span(kept[-1].start, leaves, span.level)
            kept.append(_Span(leaves, comes, math.nan))
            start = comes
    return [*kept, _Span(start, row[-1].end, row[-1].level)]


def _vanishes(t: Array, values: Array, near: float) -> float:
    """Return the zero of values nearest to a time; nan if there is none."""
    changes = np.flatnonzero(values[:-1] * values[1:] < 0)
    if not len(changes):
        return math.nan
    a, b = values[changes], values[changes + 1]
    zeros = t[changes] + (t[changes + 1] - t[changes]) * a / (a - b)
    return float(zeros[np.argmin(np.abs(zeros - near))])


def have_moved(arcs: Sequence[Arc], durations: Array, least: float) -> bool:
    """Return whether the ends of as many arcs as before differ by more than `least` T."""
    ends = np.cumsum(durations)
    return len(arcs) == len(ends) and bool(np.any(np.abs(
        np.array([arc.end for arc in arcs]) - ends) > least * ends[-1]))
