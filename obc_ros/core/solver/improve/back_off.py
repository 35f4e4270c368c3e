# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Constraint tightening (back-off) of a path that only violates its bounds, between mesh points.

A descent tightens bounds by little, since tightening costs, and refines the mesh instead. Where
there is no finer mesh, or no time for one, the path is solved for again on its own mesh, within
bounds that are tightened by the whole violation.
"""

from dataclasses import replace

from obc_ros.core.ocp.solution import Condition
from obc_ros.core.solver.improve.improvement import State
from obc_ros.core.solver.transcription.program import Nearby, SolveEffort


def violates_bounds_only(state: State) -> bool:
    """Return whether the last path violates its bounds, by little, and no other constraint."""
    certificate = state.best.solution.certificate if state.best else None
    return (certificate is not None and certificate.faults == (Condition.BOUNDS,)
            and certificate.residuals[Condition.BOUNDS] < state.bench.options.descent.back_off)


def solve_within_tighter_bounds(state: State) -> State | str:
    """
    Solve on the same mesh within bounds that are tightened by what the path exceeds them.

    The new state has a feasible path as the best candidate. Outcome and tightening of the descent
    stay, since its next mesh has smaller violations.
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
