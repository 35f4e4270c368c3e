# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Solutions with boundary arcs, on which state constraints are active, from a path that shows them.

A transcription on a fine mesh approximates such a solution, but on boundary arcs its inputs and
multipliers oscillate. Here the arcs are detected on it, the phases are solved for with their
junctions (`phase_program`), and the arcs are detected again until they do not change.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
import math

import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.numerics.collocation import build_collocation
from obc_ros.core.numerics.samples import find_runs
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Condition, Solution, Verdict
from obc_ros.core.solver.adjoint.mesh_refinement import is_below
from obc_ros.core.solver.arcs.bang_arcs import cut_at_bounds, cut_at_ends
from obc_ros.core.solver.arcs.constraint_orders import BoundRates, find_sliding
from obc_ros.core.solver.arcs.control_discontinuities import (
    cut_at_jumps,
    sharpen_steps,
    SLIGHT_JUMP,
)
from obc_ros.core.solver.arcs.input_arcs import (
    Arc,
    find_arcs,
    get_signature,
    open_arcs,
    Signature,
    tidy_arcs,
)
from obc_ros.core.solver.arcs.mixed_constraints import find_active, hold_constraints
from obc_ros.core.solver.arcs.phase_program import PhasedProgram
from obc_ros.core.solver.arcs.phases import (
    DEGREE,
    Grazing,
    Phased,
    spread_as_wanted,
    spread_by_error,
    spread_like,
)
from obc_ros.core.solver.arcs.state_contacts import add_contacts, find_contacts, StateContact
from obc_ros.core.solver.bench import Bench, Candidate, State
from obc_ros.core.solver.improve.phase_samples import BY_SAMPLES, certify_samples, join_phases
from obc_ros.core.solver.options import BoundaryOptions
from obc_ros.core.solver.trace import judge_path
from obc_ros.core.solver.transcription.local_minima import ANOTHER, CHEAPER
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh, Path
from obc_ros.core.solver.transcription.program import Nearby, ProblemScales, TranscriptionOutcome

_VANISHING = 1e-4     # length, as part of T, up to which a phase has vanished
_NEAR = 1e-5          # relative distance from a bound up to which a constraint is active
_VAIN = 'no solution with these arcs was certified'


def _read_spans(bench: Bench, program: PhasedProgram, outcome: TranscriptionOutcome, value: Array,
                gap: float) -> list[Arc]:
    """
    Detect the arcs of an outcome, boundary arcs among them.

    :param value: (N + 1, n + l), x and the path constraints at its mesh points.
    :param gap: part of T up to which an oscillating path may leave a bound within a contact, and a
        switching input may be between its bounds.
    """
    problem, switching = bench.problem, bench.programs.switching
    arcs = find_arcs(problem, outcome.path, (True,) * problem.m)
    bounds, T = program.bounds, outcome.path.t[-1]
    mixed, following = bounds.orders == 0, bounds.following
    found = _merged(find_contacts(problem, outcome, value, bench.margin, bounds.orders > 0,
                                  near=_NEAR) + find_active(problem, outcome, program), gap * T)
    found = [each for each in found if not _implied(each, arcs, bounds.deciding[each.row])
             and (each.end - each.start > each.beside / 2
                  or bounds.orders[each.row] and each.end < T)]
    if found:
        arcs = add_contacts(arcs, found, bounds.deciding, following)
        arcs = [_without_implied_levels(problem, program, arc, outcome.path) for arc in arcs]
    jumping = bounds.deciding[mixed].any(axis=0) & switching
    arcs = cut_at_jumps(arcs, outcome.path, jumping.tolist(), mixed.tolist(),
                        bench.options.bangs.jump)
    return tidy_arcs(_without_smears(arcs, switching, gap * T), _VANISHING)


def _without_implied_levels(problem: Problem, program: PhasedProgram, arc: Arc, path: Path) -> Arc:
    """Return an arc with inputs free at bounds that follow from a constraint held on it."""
    lower, upper = program.implied(problem, arc, path)
    levels = np.array(arc.levels)
    at = lower & (levels == problem.u_lower) | upper & (levels == problem.u_upper)
    return replace(arc, levels=tuple(np.where(at, np.nan, levels).tolist())) if at.any() else arc


def _implied(contact: StateContact, arcs: list[Arc], deciding: Mask) -> bool:
    """Return whether inputs at their bounds along a contact imply it."""
    most = 0.8 * (contact.end - contact.start)
    return any(min(arc.end, contact.end) - max(arc.start, contact.start) > most
               and not np.isnan(np.array(arc.levels)[deciding]).any() for arc in arcs)


def _merged(found: list[StateContact], gap: float) -> list[StateContact]:
    """Return contacts, with those of one bound merged if the gap between them is short."""
    merged: list[StateContact] = []
    for each in sorted(found, key=lambda c: (c.row, c.sign, c.start)):
        last = merged[-1] if merged else None
        if last and (last.row, last.sign) == (each.row, each.sign) and (
                each.start - last.end < gap):
            merged[-1] = replace(last, end=each.end)
        else:
            merged.append(each)
    return merged


def _without_smears(arcs: list[Arc], switching: tuple[bool, ...], gap: float) -> list[Arc]:
    """Return arcs without short ones in which a switching input is between its bounds."""
    kept: list[Arc] = []
    for k, arc in enumerate(arcs):
        smeared = not any(arc.on) and arc.end - arc.start < gap and any(
            switches and np.isnan(level)
            for switches, level in zip(switching, arc.levels, strict=True))
        before = kept[-1] if kept else None
        if smeared and before and not any(before.on):
            kept[-1] = replace(before, end=arc.end)
        elif smeared and k + 1 < len(arcs):
            arcs[k + 1] = replace(arcs[k + 1], start=arc.start)
        else:
            kept.append(arc)
    return kept


def settle_arcs(bench: Bench, program: PhasedProgram, arcs: list[Arc], guess: Path,
                sizes: ProblemScales, fine: float, spread: tuple[Array, Array]) -> Phased | None:
    """
    Solve on phases with the given arcs, and again without those that vanish.

    :param fine: factor of the number of intervals.
    :param spread: distribution of the intervals, as returned by `spread_like`.
    :return: None without convergence, or if the mesh is too large.
    """
    meter, options = bench.meter, bench.options
    for _ in range(options.bangs.solves):
        meshes = _meshes(arcs, spread, fine, options.boundary)
        K = sum(len(mesh) for mesh in meshes)
        if meter.stopped or not meter.allows(K):
            return None
        meter.limit(options.coarse.iterations, K * DEGREE)
        found = program.solve(bench.problem, arcs, meshes, guess, sizes, bench.pinned, meter)
        smooth = tidy_arcs([replace(arc, jump=False) for arc in arcs], _VANISHING)
        if not found.converged and len(smooth) < len(arcs):
            arcs = smooth
            continue
        lengths, shortest = np.array([arc.end - arc.start for arc in arcs]), program.shortest(arcs)
        # Up to here a phase counts as being at its least length.
        short = shortest + np.where(shortest > 0, 1e-3 * (lengths - shortest), 0.0)
        arcs = found.arcs
        kept = tidy_arcs(_shrunk(_that_jump(found), program.bounds), _VANISHING)
        if len(kept) == len(arcs) and np.all(found.durations >= short):
            return (_grazing(bench, program, found, sizes, found.grazing())
                    if found.converged else None)
        arcs, guess = kept, join_phases(found)
    return None


def _shrunk(arcs: list[Arc], bounds: BoundRates) -> list[Arc]:
    """Return arcs with touch points in place of boundary arcs that have vanished."""
    none = (0,) * bounds.count
    new = list(arcs)
    for k, (arc, after) in enumerate(pairwise(arcs)):
        on = np.where(bounds.orders > 0, arc.on or none, 0) * (np.array(after.on or none) == 0)
        if arc.end - arc.start < _VANISHING * arcs[-1].end and on.any():
            met = np.where(on, on, after.met or none)
            new[k + 1] = replace(after, met=tuple(met.tolist()))
    return new


def _that_jump(found: Phased) -> list[Arc]:
    """
    Return the arcs that were found, with `jump` only where an input does jump.

    If nothing changes at the start of a phase its time is not determined.
    """
    path, size = join_phases(found), np.maximum(np.abs(found.u).max(axis=(0, 1)), 1e-300)
    first = np.cumsum([0] + [len(mesh) for mesh in found.meshes])
    return [replace(arc, jump=bool(arc.jump and np.any(
        np.abs(path.ua[k] - path.ub[k - 1]) > SLIGHT_JUMP * size)))
        for arc, k in zip(found.arcs, first[:-1], strict=True)]


def _meshes(arcs: list[Arc], spread: tuple[Array, Array], fine: float,
            options: BoundaryOptions) -> list[Array]:
    """Return the lengths of the intervals of each phase, as parts of it; see `settle_arcs`."""
    (t, share), meshes = spread, []
    t = t * (arcs[-1].end / t[-1])
    for arc in arcs:
        first, last = np.interp([arc.start, arc.end], t, share)
        wanted = math.ceil(options.intervals * (last - first))
        count = math.ceil(fine * max(3, wanted))   # also in a short phase
        points = np.interp(np.linspace(first, last, count + 1), share, t)
        meshes.append(np.diff(points) / (points[-1] - points[0]))
    return meshes


def _grazing(bench: Bench, program: PhasedProgram, found: Phased, sizes: ProblemScales,
             where: Grazing) -> Phased:
    """Solve again with tangential junctions; return the former path if that costs more."""
    meter, room = bench.meter, bench.options.bangs.room
    if not where or meter.stopped:
        return found
    meter.limit(bench.options.coarse.iterations, len(found.h) * DEGREE)
    new = program.solve(bench.problem, found.arcs, found.meshes, join_phases(found), sizes,
                        bench.pinned, meter, where)
    whole = new.converged and len(tidy_arcs(new.arcs, _VANISHING)) == len(new.arcs)
    return new if whole and not is_below(found.cost, new.cost, room) else found


def may_have_arcs(state: State) -> bool:
    """Return whether boundary arcs may be used: there are state constraints."""
    bench = state.bench
    return bench.stated.constrained and bench.may_hold and not (
        bench.quick or bench.programs.twin or bench.meter.stopped)


def solve_along_bounds(state: State) -> State | str:
    """
    Find a certified solution with the boundary arcs that are detected on the outcome.

    It must not cost more than a candidate that is certified.
    """
    bench, outcome, known = state.bench, state.outcome, state.best
    options, problem = bench.options.boundary, bench.problem
    value = bench.programs.fitter(problem).at(problem, outcome.path.x, outcome.path.u)
    bounds = bench.programs.phased.bounds
    contacts = find_contacts(problem, outcome, value, bench.margin, bounds.orders == 1, near=_NEAR)
    program = bench.programs.phased.slid(find_sliding(problem, bounds, outcome.path, contacts))
    allowed = outcome.objective + ANOTHER * abs(outcome.objective)
    if known is not None and known.certified:
        cost = known.solution.objective
        allowed = cost + CHEAPER * abs(cost)
    seen: set[tuple[Signature, float, int]] = set()
    bench = replace(bench, meter=bench.meter.part(max(options.work, bench.whole.effort)))
    for gap in options.gaps:
        arcs = _read_spans(bench, program, outcome, value, gap)
        if (get_signature(arcs), 1.0, 0) in seen:
            continue
        with bench.trace.attempt('phases', f'{len(arcs)} arcs at first') as attempt:
            answer = _settled_on(bench, program, outcome, arcs, allowed, seen)
            if answer is not None:
                attempt.end(*judge_path(answer), cost=answer.objective)
                return replace(state, best=Candidate(answer, bench.record(outcome)))
            attempt.end(Verdict.REJECTED, _VAIN)
    return _VAIN


@dataclass(frozen=True)
class _Turn:
    """The next attempt: arcs, a mesh `fine` times as fine as usual, and an initial guess."""

    arcs: list[Arc]
    guess: Path
    spread: tuple[Array, Array]   # distribution of the intervals
    fine: float = 1.0
    graded: int = 0               # refinements only where x or lam was not resolved
    off: float = math.inf         # worst residual of the last attempt over its tolerance
    erred: float = math.inf       # residual of the dynamics of the last attempt
    finest: float = 1.0           # `fine` up to which it pays: twice the last one that converged
    led_to: Signature = ()        # arcs found with a large discretisation error

    @property
    def key(self) -> tuple[Signature, float, int]:
        return get_signature(self.arcs), self.fine, self.graded

    def like(self, found: Phased, arcs: list[Arc]) -> '_Turn':
        """Continue with other arcs from a path that was found."""
        return replace(self, arcs=arcs, guess=sharpen_steps(join_phases(found), arcs),
                       off=math.inf)

    def finer(self, found: Phased, erred: float, bench: Bench) -> '_Turn':
        """Continue with shorter intervals, distributed anew after the first time."""
        arcs, guess, spread = self.arcs, self.guess, self.spread
        again = get_signature(found.arcs) == self.led_to
        if erred < self.erred < math.inf:
            bench.meter.extend(round(bench.options.boundary.work * self.fine))
        fewer = len(found.arcs) < len(arcs)
        if again or fewer or self.erred < math.inf:
            spread = spread_by_error(found)
            if again or len(found.arcs) <= len(arcs):
                arcs, guess = found.arcs, join_phases(found)
        return replace(self, arcs=arcs, guess=guess, spread=spread, fine=2 * self.fine,
                       erred=erred, led_to=get_signature(found.arcs))


def _settled_on(bench: Bench, program: PhasedProgram, outcome: TranscriptionOutcome,
                arcs: list[Arc], allowed: float,
                seen: set[tuple[Signature, float, int]]) -> Solution | None:
    """
    Solve with the given arcs, and detect arcs again, until a solution is certified; else None.

    `allowed`: maximum cost. `seen`: arcs and meshes that were tried and are not tried again.
    """
    problem, sizes = bench.problem, bench.sizes(outcome)
    fitter = bench.programs.fitter(problem)
    turn = _Turn(arcs, sharpen_steps(outcome.path, arcs), spread_like(outcome.path))
    for number in range(bench.options.bangs.solves):
        if number and turn.key in seen:
            # On this mesh the detected arcs alternate.
            turn = replace(turn, fine=2 * turn.fine)
        # Three refinements, more only while each halves the residual.
        if turn.fine > max(8.0, turn.finest) or turn.key in seen:
            break
        seen.add(turn.key)
        found = settle_arcs(bench, program, turn.arcs, turn.guess, sizes, turn.fine, turn.spread)
        if found is None or found.cost > allowed:
            break
        answer = certify_samples(bench, program, found)
        assert answer.certificate is not None
        if answer.certificate.holds:
            return answer
        value = fitter.at(problem, answer.x, answer.u)
        erred = answer.certificate.residuals[Condition.DYNAMICS]
        # The signs of dH/du mean nothing while a bound is missing.
        touched = _add_touching_arcs(problem, found.arcs, found, program.bounds, answer.t, value)
        if get_signature(touched) != get_signature(found.arcs) and (
                get_signature(touched), turn.fine, turn.graded) not in seen:
            turn = turn.like(found, touched)
            continue
        if erred > answer.certificate.tolerances[Condition.COSTATE]:
            turn = turn.finer(found, erred, bench)
            continue
        new = _reread_arcs(bench, program, found, answer, value)
        if get_signature(new) == get_signature(found.arcs):
            new = add_exceeded_bounds(problem, new, program.bounds, answer.t, value,
                                      answer.certificate.tolerances[Condition.BOUNDS])
        if get_signature(new) != get_signature(found.arcs):
            turn = turn.like(found, new)
            continue
        # The cost hardly depends on the time of a tangential junction, which is inaccurate. A
        # junction with a relative rate of 0.1 may be one.
        smooth = _grazing(bench, program, found, sizes, found.grazing(0.1, touched=True))
        if smooth is not found and (better := certify_samples(bench, program, smooth)).certified:
            return better
        turn = replace(turn, arcs=new, guess=sharpen_steps(join_phases(found), new))
        turn = _resolve(bench, program, turn, found, answer, seen)
    return None


def _resolve(bench: Bench, program: PhasedProgram, turn: _Turn, found: Phased,
             answer: Solution, seen: set[tuple[Signature, float, int]]) -> _Turn:
    """Return the next attempt when the arcs do not change."""
    assert answer.certificate is not None
    problem, options = bench.problem, bench.options.boundary
    worst, before = answer.certificate.worst, turn.off
    turn = replace(turn, off=(answer.certificate.residuals[worst]
                              / answer.certificate.tolerances[worst]))
    if before < math.inf:
        _, Hu, _ = bench.programs.stated_integrator.hamiltonian(
            problem, answer.x, answer.u, answer.lam, answer.path_multipliers)
        ended = cut_at_ends(problem, program, found, answer.t, answer.x, answer.u, Hu)
        if (get_signature(ended), turn.fine, turn.graded) not in seen:
            return turn.like(found, ended)
    # The costates may have a boundary layer.
    if worst == Condition.COSTATE and turn.graded < 3:
        spread, count = spread_as_wanted(found)
        return replace(turn, spread=spread, graded=turn.graded + 1,
                       fine=max(turn.fine, count / options.intervals))
    if turn.off < before:
        bench.meter.extend(round(options.work * turn.fine))
    finest = 2 * turn.fine if turn.off < before / 2 else turn.finest
    spread = spread_by_error(found) if worst in BY_SAMPLES else turn.spread
    return replace(turn, fine=2 * turn.fine, spread=spread, finest=finest)


def solve_at_once(state: State) -> State | str:
    """
    Find a certified solution with boundary arcs from a coarse outcome, before it is refined.

    Short arcs and touch points may be visible on a finer mesh only, so that two are tried, too.
    """
    start, problem, whole = state.outcome, state.bench.problem, state.bench.meter
    options, outcome = state.bench.options.boundary, start
    for finer in (1, *options.finer):
        bench = replace(state.bench, meter=whole.part(options.work))
        mesh = build_uniform_mesh(problem, finer * start.mesh.layout.intervals, bench.stages)
        if finer > 1 and whole.allows(mesh.layout.intervals):
            new = bench.collocate(mesh, outcome.path, near=Nearby(bench.sizes(outcome)))
            outcome = new if new.converged else outcome
        here = replace(state, bench=bench, outcome=outcome)
        if may_have_arcs(here) and isinstance(found := solve_along_bounds(here), State):
            return replace(state, best=found.best)
    return _VAIN


def _reread_arcs(bench: Bench, program: PhasedProgram, found: Phased, answer: Solution,
                 value: Array) -> list[Arc]:
    """
    Correct the arcs of a path on phases by its multipliers.

    Inputs for whose bound dH/du has the wrong sign move to the other bound or, if H is not linear
    in them, become free. Bounds with a multiplier become active or touched. `value` (N, n + l)
    are x and the path constraints at the samples of `answer`.
    """
    problem, rows = bench.problem, np.flatnonzero(np.diff(answer.t) > 0)
    x, u, lam = ((values[rows] + values[rows + 1]) / 2 for values in (
        answer.x, answer.u, answer.lam))
    mu = answer.path_multipliers
    _, Hu, _ = bench.programs.stated_integrator.hamiltonian(
        problem, x, u, lam, None if mu is None else (mu[rows] + mu[rows + 1]) / 2)
    bounds = program.bounds
    new = open_arcs(cut_at_bounds(problem, found, program.switching, bounds.deciding),
                    np.append(answer.t[rows], answer.t[-1]), Hu, problem,
                    (True,) * problem.m, program.switching.tolist())
    times = np.unique([arc.end for arc in (*found.arcs, *new)])
    cut, start = [], 0.0
    for end in times[np.append(np.diff(times) > 1e-9 * times[-1], True)]:
        middle = (start + end) / 2
        level, on = (next(arc for arc in arcs if arc.end > middle) for arcs in (new, found.arcs))
        cut.append(Arc(start, float(end), level.levels, on.on,
                       jump=on.jump and abs(start - on.start) <= 1e-9 * times[-1]))
        start = float(end)
    held = hold_constraints(tidy_arcs(cut, _VANISHING), found, bounds)
    return _add_touching_arcs(problem, held, found, bounds, answer.t, value)


def _add_touching_arcs(problem: Problem, arcs: list[Arc], found: Phased, bounds: BoundRates,
                       times: Array, value: Array) -> list[Arc]:
    """
    Add touch points and boundary arcs where bounds of the state have multipliers.

    `value` (N, n + l) are x and the path constraints at `times` (N,).
    """
    # Between two boundary arcs a bound that is nearly met stays active.
    lower, upper = problem.row_bounds
    near = np.stack([value - lower, upper - value]) <= 1e-2 * np.abs(value).max(axis=0)
    met = [(arc.start, int(row), arc.met[row]) for phase, arc in enumerate(found.arcs)
           for row in np.flatnonzero(arc.met) if (phase, int(row)) not in found.astray]
    held = [(arc.start, arc.end, int(row), arc.on[row]) for arc in found.arcs
            for row in np.flatnonzero(arc.on)]
    held += [(time, time, row, sign) for time, row, sign in met]
    t = np.append(0.0, np.cumsum(found.h))
    t = (t[:-1, None] + found.h[:, None] * build_collocation(DEGREE, 'radau')[0]).ravel()
    longer, least = [], 1e-5   # multiplier of a touched bound, relative to the costates
    for row in np.flatnonzero(np.abs(found.pushed).max(axis=(0, 1)) > least).tolist():
        for sign in (1, -1):
            weight = np.maximum(sign * found.pushed[:, :, row].ravel(), 0.0)
            places = np.flatnonzero(weight > least)
            for run in np.split(places, np.flatnonzero(np.diff(places) > DEGREE) + 1):
                if not run.size:
                    continue
                first, last, h = t[run[0]], t[run[-1]], found.h[run // DEGREE].max()
                if any((row, sign) == (r, s) and start - h < last and first < end + h
                       for start, end, r, s in held):
                    continue
                if run[-1] - run[0] > 2 * DEGREE:
                    longer.append(StateContact(row, sign, first, last, 0.0))
                else:
                    time = float(t[run] @ weight[run] / weight[run].sum())
                    met.append((time, row, sign))
    for row, sign in {(row, sign) for _, _, row, sign in held}:
        spans = sorted((start, end) for start, end, *of in held if of == [row, sign])
        for (start, left), (again, end) in pairwise(spans):
            between = near[(sign + 1) // 2, (times > left) & (times < again), row]
            if between.size and between.all():
                longer.append(StateContact(row, sign, start, end, 0.0))
                met = [each for each in met if each[1] != row or not start <= each[0] <= end]
    if longer:
        arcs = add_contacts(arcs, longer, bounds.deciding, bounds.following)
    for time, row, sign in met:
        arcs = _met(arcs, time, row, sign, bounds.count)
    return arcs


def add_exceeded_bounds(problem: Problem, arcs: list[Arc], bounds: BoundRates, times: Array,
                        value: Array, allowed: float) -> list[Arc]:
    """
    Add boundary arcs inside of arcs on which a path exceeds a bound between the points.

    A bound may be active for less than an interval, with a multiplier too small to be seen.
    `value` (N, n + l) are x and the path constraints at `times` (N,), `allowed` the violation
    relative to their sizes.
    """
    size = np.maximum(np.abs(value).max(axis=0), 1e-300)
    found = []
    for sign, bound in zip((1, -1), problem.row_bounds[::-1], strict=True):
        over = sign * (value - bound) > allowed * size
        for row in np.flatnonzero(over.any(axis=0) & (bounds.orders > 0)).tolist():
            for first, last in find_runs(over[:, row]):
                start, end = times[max(first - 1, 0)], times[min(last + 1, len(times) - 1)]
                if any(arc.start < start and end < arc.end and not (arc.on and arc.on[row])
                       for arc in arcs):
                    found.append(StateContact(row, sign, float(start), float(end), 0.0))
    return add_contacts(arcs, found, bounds.deciding, bounds.following) if found else arcs


def _met(arcs: list[Arc], time: float, row: int, sign: int, count: int) -> list[Arc]:
    """Return arcs with a touch point of a bound at about a time."""
    near = _VANISHING * arcs[-1].end
    cut = []
    for arc in arcs:
        met = list(arc.met or (0,) * count)
        met[row] = sign
        if abs(arc.start - time) <= near and arc.start > 0:
            cut.append(replace(arc, met=tuple(met)))
        elif arc.start + near < time < arc.end - near and not (arc.on and arc.on[row]):
            cut.append(replace(arc, end=time))
            cut.append(Arc(time, arc.end, arc.levels, arc.on, tuple(
                sign if k == row else 0 for k in range(count))))
        else:
            cut.append(arc)
    return cut
