# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Answers with arcs along bounds of the state, from a path that shows where these are.

A transcription on a fine mesh comes near such a path, but its inputs oscillate on arcs where a
bound fixes them, and its multipliers with them. Here what holds in each phase is read off it,
the phases are solved for with their junctions (`phase_program`), and read off again until nothing
changes.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
import math

import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.numerics.collocation import build_collocation
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Condition, Solution
from obc_ros.core.solver.adjoint.costates import CostateIntegrator
from obc_ros.core.solver.adjoint.mesh_refinement import is_below
from obc_ros.core.solver.arcs.bang_arcs import cut_at_bounds, cut_at_ends
from obc_ros.core.solver.arcs.constraint_orders import BoundRates
from obc_ros.core.solver.arcs.control_discontinuities import cut_at_jumps, sharpen_steps
from obc_ros.core.solver.arcs.input_arcs import Arc, find_arcs, get_signature, open_arcs, Signature
from obc_ros.core.solver.arcs.mixed_constraints import find_active, hold_constraints
from obc_ros.core.solver.arcs.phase_mesh import spread_as_wanted, spread_by_error, spread_like
from obc_ros.core.solver.arcs.phase_program import PhasedProgram
from obc_ros.core.solver.arcs.phases import DEGREE, Grazing, Phased
from obc_ros.core.solver.arcs.state_contacts import add_contacts, find_contacts, StateContact
from obc_ros.core.solver.bench import Bench
from obc_ros.core.solver.improve.phase_samples import BY_SAMPLES, certify_samples, join_phases
from obc_ros.core.solver.nlp.progress import ProgressMonitor
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh, Path
from obc_ros.core.solver.transcription.program import ProblemScales, TranscriptionOutcome

_ROUNDS = 6
_VANISHING = 1e-4     # of T: a phase that is not there
_GAPS = 0.06, 0.01    # of T: how long what oscillates may be off a bound
_INTERVALS = 24       # of all phases together, about
_LEAST = 3            # of a phase
_COARSE = 1e-4        # residual of the dynamics
_STIFF = 0.1          # times what twice as long steps err by: these err elsewhere
_STEADY = 0.7         # likewise: it is worth going on
_WORSE = 1.5          # times what was off before: no finer mesh will do
_SLOWLY = 0.1         # likewise: steps that resolve a path err less when they are halved
_FINEST = 8           # times as many, at most
_GRADED = 3           # times that intervals are cut where costates change, and not all of them
_NEAR = 1e-5          # of its size: how near its bound a constraint is met
_HARDLY = 1e-3        # likewise: how little it leaves its bound between two arcs along it
_MOST = 0.8           # of a contact, for all of it
_WEIGHS = 1e-5        # beside the costates: what a bound does where it is touched
_SAME = 1e-5          # relative cost of a path that leaves bounds a little more smoothly
_DEARER = 1e-3        # relative: by how much an answer may cost more than the path it is read off
_NO_DEARER = 1e-6     # likewise, than an answer that is known
_ITERATIONS = 150
_LIMIT = 1e-3         # of what may go at once: a phase so near its least length is at it
_NO_JUMP = 0.05       # of its size: less of an input than what a coarse path shows as a jump
_NEARLY = 0.1         # relative rate inwards at a junction, at which there may be none
_AT_ONCE = 45_000     # work, as in `search`, on what a coarse mesh shows
_PATIENCE = 100_000   # likewise, at least, on what any mesh shows
_FINER = 4, 2         # times as many intervals, on which that is tried again


def read_spans(problem: Problem, program: PhasedProgram, outcome: TranscriptionOutcome,
               value: Array,
               margin: Array, switching: tuple[bool, ...], gap: float) -> list[Arc]:
    """
    Return what holds in each span of time of an outcome, `value` (N + 1, n + l) of (x, c).

    `gap`: as a part of T, for which a path that oscillates may leave a bound or an input that
    switches may be between its bounds.
    """
    arcs = find_arcs(problem, outcome.path, (True,) * problem.m)
    bounds, T = program.bounds, outcome.path.t[-1]
    mixed = bounds.orders == 0
    found = _merged(find_contacts(problem, outcome, value, margin, bounds.orders > 0, near=_NEAR)
                    + find_active(problem, outcome, program), gap * T)
    found = [each for each in found if not _implied(each, arcs, bounds.deciding[each.row])
             and (each.end - each.start > each.beside / 2
                  or bounds.orders[each.row] and each.end < T)]
    if found:
        arcs = add_contacts(arcs, found, bounds.deciding, mixed)
    jumping = bounds.deciding[mixed].any(axis=0) & switching
    arcs = cut_at_jumps(arcs, outcome.path, jumping.tolist(), mixed.tolist())
    return tidy_arcs(_without_smears(arcs, switching, gap * T))


def _implied(contact: StateContact, arcs: list[Arc], deciding: Mask) -> bool:
    """Return whether inputs stay at their bounds along a contact, which then follows."""
    for arc in arcs:
        common = min(arc.end, contact.end) - max(arc.start, contact.start)
        if common > _MOST * (contact.end - contact.start) and not np.any(
                np.isnan(np.array(arc.levels)[deciding])):
            return True
    return False


def _merged(found: list[StateContact], gap: float) -> list[StateContact]:
    """Return contacts, those of one bound that are next to each other as one."""
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
    """Return arcs without short ones in which an input that switches seems to be between."""
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


def tidy_arcs(arcs: list[Arc]) -> list[Arc]:
    """Return arcs without the shortest, joined where neighbours are the same."""
    T = arcs[-1].end
    kept: list[Arc] = []
    for arc in arcs:
        if arc.end - arc.start < _VANISHING * T:
            continue
        if kept and not (arc.met or arc.jump) and kept[-1].on == arc.on and np.array_equal(
                kept[-1].levels, arc.levels, equal_nan=True):
            kept[-1] = replace(kept[-1], end=arc.end)
        else:
            kept.append(replace(arc, start=kept[-1].end if kept else 0.0))
    kept[-1] = replace(kept[-1], end=T)
    return kept


def settle_arcs(problem: Problem, program: PhasedProgram, arcs: list[Arc], guess: Path,
                sizes: ProblemScales, pinned: Mask, monitor: ProgressMonitor, fine: float,
                spread: tuple[Array, Array]) -> Phased | None:
    """
    Return the path with arcs, without those that vanish.

    It has `fine` times as many intervals as usual, `spread` over time as `spread_like` says.
    """
    for _ in range(_ROUNDS):
        meshes = _meshes(arcs, spread, fine)
        K = sum(len(mesh) for mesh in meshes)
        if monitor.stopped or not monitor.allows(K):
            return None
        monitor.limit(_ITERATIONS, K * DEGREE)
        found = program.solve(problem, arcs, meshes, guess, sizes, pinned, monitor)
        smooth = tidy_arcs([replace(arc, jump=False) for arc in arcs])
        if not found.converged and len(smooth) < len(arcs):
            arcs = smooth
            continue
        lengths, shortest = np.array([arc.end - arc.start for arc in arcs]), program.shortest(arcs)
        short = shortest + np.where(shortest > 0, _LIMIT * (lengths - shortest), 0.0)
        arcs = found.arcs
        kept = tidy_arcs(_shrunk(_that_jump(found), program.bounds))
        if len(kept) == len(arcs) and np.all(found.durations >= short):
            return _grazing(problem, program, found, sizes, pinned, monitor, found.grazing()
                            ) if found.converged else None
        arcs, guess = kept, join_phases(found)
    return None


def _shrunk(arcs: list[Arc], bounds: BoundRates) -> list[Arc]:
    """Return arcs with touches of bounds where arcs along them have vanished."""
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
    Return the arcs that were found, of which none begins with a jump where inputs do not.

    When nothing else changes, where such a phase begins would be undetermined.
    """
    path, size = join_phases(found), np.maximum(np.abs(found.u).max(axis=(0, 1)), 1e-300)
    first = np.cumsum([0] + [len(mesh) for mesh in found.meshes])
    return [replace(arc, jump=bool(arc.jump and np.any(
        np.abs(path.ua[k] - path.ub[k - 1]) > _NO_JUMP * size)))
        for arc, k in zip(found.arcs, first[:-1], strict=True)]


def _meshes(arcs: list[Arc], spread: tuple[Array, Array], fine: float) -> list[Array]:
    """Return the lengths of the intervals of each phase, as parts of it, as `settle_arcs` says."""
    (t, share), meshes = spread, []
    t = t * (arcs[-1].end / t[-1])
    for arc in arcs:
        first, last = np.interp([arc.start, arc.end], t, share)
        count = math.ceil(fine * max(_LEAST, math.ceil(_INTERVALS * (last - first))))
        points = np.interp(np.linspace(first, last, count + 1), share, t)
        meshes.append(np.diff(points) / (points[-1] - points[0]))
    return meshes


def _grazing(problem: Problem, program: PhasedProgram, found: Phased, sizes: ProblemScales,
             pinned: Mask, monitor: ProgressMonitor, where: Grazing) -> Phased:
    """Return a path that was found, made to come to bounds and leave them smoothly `where`."""
    if not where or monitor.stopped:
        return found
    monitor.limit(_ITERATIONS)
    new = program.solve(
        problem, found.arcs, found.meshes, join_phases(found), sizes, pinned, monitor, where)
    same = new.converged and len(tidy_arcs(new.arcs)) == len(new.arcs) and not is_below(
        found.cost, new.cost, _SAME)
    return new if same else found


def _may_have_arcs(search: Bench) -> bool:
    """Return whether arcs along bounds are to be looked for."""
    return search.bounded and search.may_hold and not (
        search.quick or search.kit.twin or search.monitor.stopped)


def solve_along_bounds(search: Bench, outcome: TranscriptionOutcome, known: Solution | None = None
                       ) -> Solution | None:
    """
    Return an answer with arcs along bounds near an outcome, if one is certified.

    If one is `known` that is, only one that costs no more.
    """
    problem = search.problem
    if not _may_have_arcs(search):
        return None
    program = search.kit.phased
    value = search.kit.fitter(problem).at(
        problem, outcome.path.x, np.vstack([outcome.path.ua, outcome.path.ub[-1:]]))
    allowed = outcome.objective + _DEARER * abs(outcome.objective)
    if known is not None and known.certified:
        allowed = known.objective + _NO_DEARER * abs(known.objective)
    seen: set[tuple[Signature, float, int]] = set()
    whole, search.monitor = search.monitor, search.monitor.part(max(_PATIENCE, search.work))
    try:
        for gap in _GAPS:
            arcs = read_spans(problem, program, outcome, value, search.margin,
                              search.kit.switching, gap)
            if (answer := _settled_on(search, outcome, arcs, allowed, seen)) is not None:
                search.last = search.answered(outcome)
                return answer
        return None
    finally:
        search.monitor = whole


@dataclass
class _Turn:
    """What is tried next: arcs, on a mesh `fine` times as fine as usual, from a path nearby."""

    arcs: list[Arc]
    guess: Path
    spread: tuple[Array, Array]   # of the intervals
    fine: float = 1.0
    graded: int = 0               # how often the mesh was cut where costates change
    off: float = math.inf         # by how much the worst residual was over its tolerance
    erred: float = math.inf       # and that of the dynamics
    led_to: Signature = ()        # arcs, by steps that erred

    @property
    def key(self) -> tuple[Signature, float, int]:
        return get_signature(self.arcs), self.fine, self.graded

    def like(self, found: Phased, arcs: list[Arc]) -> None:
        """Go on with other arcs than those that were found."""
        self.arcs, self.guess, self.off = arcs, sharpen_steps(join_phases(found), arcs), math.inf

    def finer(self, found: Phased, erred: float, monitor: ProgressMonitor) -> None:
        """Go on with shorter steps, where those that were taken err."""
        self.fine *= 2
        again, self.led_to = get_signature(found.arcs) == self.led_to, get_signature(found.arcs)
        if again and erred < _STEADY * self.erred:
            monitor.extend(_AT_ONCE)
        if again or erred > _STIFF * self.erred:
            self.spread = spread_by_error(found)
            if again or len(found.arcs) == len(self.arcs):
                self.arcs, self.guess = found.arcs, join_phases(found)
        self.erred = erred


def _settled_on(search: Bench, outcome: TranscriptionOutcome, arcs: list[Arc], allowed: float,
                seen: set[tuple[Signature, float, int]]) -> Solution | None:
    """
    Return an answer with arcs like those given, read anew until it is certified; else None.

    It costs what is `allowed` at most. What was `seen` before is not tried again.
    """
    problem, monitor, pinned = search.problem, search.monitor, search.pinned
    program, judge, fitter = search.kit.phased, search.kit.judge, search.kit.fitter(problem)
    turn, sizes = _Turn(arcs, sharpen_steps(outcome.path, arcs), spread_like(outcome.path)), (
        search.sizes(outcome))
    for number in range(_ROUNDS + _GRADED):
        if number and turn.key in seen:
            turn.fine *= 2   # what a coarse mesh shows goes to and fro
        if turn.fine > _FINEST or turn.key in seen:
            break
        seen.add(turn.key)
        found = settle_arcs(problem, program, turn.arcs, turn.guess, sizes, pinned, monitor,
                            turn.fine, turn.spread)
        if found is None or found.cost > allowed:
            break
        answer = certify_samples(problem, program, judge, fitter, found)
        assert answer.certificate is not None
        if answer.certificate.holds:
            return answer
        value = fitter.at(problem, answer.x, answer.u)
        erred = answer.certificate.residuals[Condition.DYNAMICS]
        if erred > _COARSE:
            # Steps that err so much say nothing of arcs, but where a bound weighs.
            touched = add_touching_arcs(problem, found.arcs, found, program.bounds, answer.t,
                                        value)
            if get_signature(touched) != get_signature(found.arcs) and (
                    get_signature(touched), turn.fine, turn.graded) not in seen:
                turn.like(found, touched)
            else:
                turn.finer(found, erred, monitor)
            continue
        new = reread_arcs(problem, program, judge, found, answer, value)
        if get_signature(new) != get_signature(found.arcs):
            turn.like(found, new)
            continue
        # When a path comes to a bound smoothly its cost hardly depends on when it does.
        smooth = _grazing(problem, program, found, sizes, pinned, monitor,
                          found.grazing(_NEARLY, touched=True))
        if smooth is not found and (
                better := certify_samples(problem, program, judge, fitter, smooth)).certified:
            return better
        turn.arcs, turn.guess = new, sharpen_steps(join_phases(found), new)
        if not _resolved(turn, problem, program, judge, found, answer, seen):
            break
    return None


def _resolved(turn: _Turn, problem: Problem, program: PhasedProgram, judge: CostateIntegrator,
              found: Phased, answer: Solution, seen: set[tuple[Signature, float, int]]) -> bool:
    """Go on where arcs stay what they are and the certificate lacks something; or do not."""
    assert answer.certificate is not None
    worst = answer.certificate.worst
    turn.off, before = (answer.certificate.residuals[worst]
                        / answer.certificate.tolerances[worst]), turn.off
    if turn.off > _SLOWLY * before:
        _, Hu, _ = judge.hamiltonian(problem, answer.x, answer.u, answer.lam,
                                     answer.path_multipliers)
        ended = cut_at_ends(problem, program, found, answer.t, answer.x, answer.u, Hu)
        if (get_signature(ended), turn.fine, turn.graded) not in seen:
            turn.like(found, ended)
            return True
    # The costates may change within a small part of T.
    if worst == Condition.COSTATE and turn.graded < _GRADED:
        turn.spread, count = spread_as_wanted(found)
        turn.graded, turn.fine = turn.graded + 1, max(turn.fine, count / _INTERVALS)
        return True
    turn.fine *= 2
    if worst in BY_SAMPLES:
        turn.spread = spread_by_error(found)
    return turn.off <= _WORSE * before


def solve_at_once(search: Bench, start: TranscriptionOutcome) -> Solution | None:
    """
    Return an answer with arcs along bounds near a coarse outcome, if it shows them.

    Where a path only touches a bound, or turns for a short time, a finer mesh may show it.
    """
    if not (start.converged and any(search.switching) and _may_have_arcs(search)):
        return None
    whole, outcome, problem = search.monitor, start, search.problem
    try:
        for finer in (1, *_FINER):
            search.monitor = whole.part(_AT_ONCE)
            mesh = build_uniform_mesh(problem, finer * start.mesh.layout.intervals, search.stages)
            if finer > 1 and whole.allows(mesh.layout.intervals):
                new = search.collocate(mesh, outcome.path, near=True, sizes=search.sizes(outcome))
                outcome = new if new.converged else outcome
            if (answer := solve_along_bounds(search, outcome)) is not None:
                return answer
        return None
    finally:
        search.monitor = whole


def reread_arcs(problem: Problem, program: PhasedProgram, integrator: CostateIntegrator,
                found: Phased,
                answer: Solution, value: Array) -> list[Arc]:
    """
    Return the arcs of a path that was found, changed where it shows that they are not right.

    Inputs whose bound is the wrong one are moved or, where H is not linear in them, free; bounds
    of the state are touched, or held where the path, at whose samples (x, c) is `value`
    (N, n + l), stays on them anyway.
    """
    rows = np.flatnonzero(np.diff(answer.t) > 0)
    x, u, lam = ((values[rows] + values[rows + 1]) / 2 for values in (
        answer.x, answer.u, answer.lam))
    mu = answer.path_multipliers
    _, Hu, _ = integrator.hamiltonian(
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
    return add_touching_arcs(problem, hold_constraints(tidy_arcs(cut), found, bounds), found,
                             bounds, answer.t, value)


def add_touching_arcs(problem: Problem, arcs: list[Arc], found: Phased, bounds: BoundRates,
                      times: Array,
                      value: Array) -> list[Arc]:
    """
    Return arcs near those found, which touch bounds, or stay on them, where these weigh.

    `value` (N, n + l): (x, c) at the given times.
    """
    near = np.stack([
        value - np.append(problem.x_lower, problem.path_lower),
        np.append(problem.x_upper, problem.path_upper) - value]) <= _HARDLY * np.abs(
            value).max(axis=0)
    d = DEGREE
    met = [(arc.start, int(row), arc.met[row]) for phase, arc in enumerate(found.arcs)
           for row in np.flatnonzero(arc.met) if (phase, int(row)) not in found.astray]
    held = [(arc.start, arc.end, int(row), arc.on[row]) for arc in found.arcs
            for row in np.flatnonzero(arc.on)]
    held += [(time, time, row, sign) for time, row, sign in met]
    t = np.append(0.0, np.cumsum(found.h))
    t = (t[:-1, None] + found.h[:, None] * build_collocation(d, 'radau')[0]).ravel()
    longer = []
    for row in np.flatnonzero(np.abs(found.pushed).max(axis=(0, 1)) > _WEIGHS).tolist():
        for sign in (1, -1):
            weight = np.maximum(sign * found.pushed[:, :, row].ravel(), 0.0)
            places = np.flatnonzero(weight > _WEIGHS)
            for run in np.split(places, np.flatnonzero(np.diff(places) > d) + 1):
                if not run.size:
                    continue
                first, last, h = t[run[0]], t[run[-1]], found.h[run // d].max()
                if any((row, sign) == (r, s) and start - h < last and first < end + h
                       for start, end, r, s in held):
                    continue
                if run[-1] - run[0] > 2 * d:
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
        arcs = add_contacts(arcs, longer, bounds.deciding)
    for time, row, sign in met:
        arcs = _met(arcs, time, row, sign, bounds.count)
    return arcs


def _met(arcs: list[Arc], time: float, row: int, sign: int, count: int) -> list[Arc]:
    """Return arcs of which one begins by touching a bound at about a time."""
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
