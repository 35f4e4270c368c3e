# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The improvements, in the order in which they are tried in their stage.

A new improvement is a file and a line in IMPROVEMENTS. Three strategies are called directly. Mesh
refinement and constraint tightening are the loop itself (`descent`). Negative curvature is a step
of the nonlinear program, which knows no mesh (`nlp`). The indirect method is a method by name
(`refine_indirectly`), which explains why it does not apply.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

from obc_ros.core.ocp.solution import Condition, Verdict
from obc_ros.core.solver.bench import State
from obc_ros.core.solver.improve.arc_iteration import (
    has_jumping_inputs,
    hold_jumping_inputs,
    hold_switching_inputs,
)
from obc_ros.core.solver.improve.indirect import may_have_kinks, solve_on_kinks
from obc_ros.core.solver.improve.state_arcs import may_have_arcs, solve_along_bounds, solve_at_once
from obc_ros.core.solver.transcription.program import Nearby, SolveEffort


class DescentStage(StrEnum):
    """When in a search an improvement is tried."""

    START = 'before a descent'
    FIRST_MESH = 'on the first mesh of a descent'
    STALLED = 'on a mesh that gained little'
    NEXT_MESH = 'before a finer mesh'
    VIOLATED = 'at the end of a descent'
    CERTIFIED = 'on a finer mesh without a certificate'


@dataclass(frozen=True)
class Improvement:
    """
    A change of a path that may lower its cost or lead to its certificate.

    :ivar name: as users see it in the trace, unique.
    :ivar when: when it applies, in one sentence.
    :ivar run: returns the new state, or the reason why there is none.
    """

    name: str
    stage: DescentStage
    when: str
    applies: Callable[[State], bool]
    run: Callable[[State], State | str]


def violates_bounds_only(state: State) -> bool:
    """Return whether the last path violates its bounds, by little, and no other constraint."""
    certificate = state.best.solution.certificate if state.best else None
    return (certificate is not None and certificate.faults == (Condition.BOUNDS,)
            and certificate.residuals[Condition.BOUNDS] < state.bench.options.descent.back_off)


def solve_within_tighter_bounds(state: State) -> State | str:
    """
    Solve on the same mesh within bounds that are tightened by what the path exceeds them.

    A descent tightens bounds by little, since tightening costs, and refines the mesh instead; this
    is for where there is no finer mesh, or no time for one. The new state has a feasible path as
    the best candidate. Outcome and tightening of the descent stay, since its next mesh has smaller
    violations.
    """
    bench, outcome = state.bench, state.outcome
    options = bench.options.descent
    bench, _ = bench.tighten(bench.course(outcome), options.back_off)
    # A path within the bounds is sought, not its optimum.
    outcome = bench.collocate(
        outcome.mesh, outcome.path, near=Nearby(outcome.scales, warm=outcome),
        effort=SolveEffort(options.iterations, rough=options.back_off))
    if not outcome.converged:
        return 'no path within tighter bounds was found'
    found = bench.certify(outcome)
    if not found.feasible:
        return 'the path within tighter bounds exceeds the bounds'
    return replace(state, best=found)


IMPROVEMENTS = (
    Improvement('boundary arcs at once', DescentStage.START,
                'there are state constraints and H is linear in an input',
                lambda state: (state.outcome.converged and any(state.switching)
                               and may_have_arcs(state)), solve_at_once),
    Improvement('bang arcs', DescentStage.FIRST_MESH,
                'H is linear in an input that has bounds',
                lambda state: any(state.switching), hold_switching_inputs),
    Improvement('bang arcs of jumping inputs', DescentStage.STALLED,
                'an input jumps from bound to bound, and none is held',
                has_jumping_inputs, hold_jumping_inputs),
    Improvement('mesh at kinks', DescentStage.NEXT_MESH,
                'there are no state constraints, and no inputs that are held at bounds',
                may_have_kinks, solve_on_kinks),
    Improvement('tighter bounds', DescentStage.VIOLATED,
                'the path violates bounds between mesh points, and nothing else',
                violates_bounds_only, solve_within_tighter_bounds),
    Improvement('boundary arcs', DescentStage.CERTIFIED,
                'there are state constraints',
                may_have_arcs, solve_along_bounds))


def try_improvements(stage: DescentStage, state: State) -> State:
    """Try the improvements of a stage in turn, until one helps; return `state` if none does."""
    for improvement in IMPROVEMENTS:
        if improvement.stage is not stage or not improvement.applies(state):
            continue
        with state.bench.trace.attempt(improvement.name) as attempt:
            new = improvement.run(state)
            if isinstance(new, str):
                attempt.end(Verdict.REJECTED, new)
                continue
            verdict, why, cost = new.judge(state)
            attempt.end(verdict, why, cost=cost, what=new.outcome.mesh.layout.describe())
        return new
    return state
