# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Checks of a first plan before a receding horizon becomes active.

The plan is checked against the problem alone: its model, the bounds, the limits at each sample and
its end. Only the residual of the optimality conditions is that of the step.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.receding.formulation import RecedingProblem
from obc_ros.core.receding.step_solver import STEP_TOLERANCE, StepResult
from obc_ros.core.receding.terminal_set import TerminalSet

_GAP = 1e-8    # relative gap of the model that rounding may leave
_KEPT = 1e-6   # excess that an optimal plan may have, relative to 1 + the size of the limit


@dataclass(frozen=True)
class FirstPlanReport:
    """
    What was checked of a first plan.

    :ivar accepted: whether the controller may become active.
    :ivar reasons: why not; empty if it may.
    :ivar words: the result in a sentence.
    :ivar end: V(x_N) over the level of the terminal set: at most 1 if the plan ends in it; None
        without a set.
    """

    accepted: bool
    reasons: tuple[str, ...]
    words: str
    end: float | None


def check_first_plan(problem: RecedingProblem, result: StepResult,
                     terminal: TerminalSet | None = None, *, must_end_in_set: bool = True,
                     present: Mapping[str, float] | None = None) -> FirstPlanReport:
    """
    Check the first plan of a receding horizon.

    It is accepted if it is a motion of the model with admissible inputs that exceeds no limit,
    optimal to the tolerance, and ends in the terminal set if it must. From there the regulator is
    proved to keep all limits, so that the plan and the regulator keep them for all time.

    :param result: the step that found the plan.
    :param terminal: the set of `find_terminal_set`.
    :param must_end_in_set: whether a plan that ends outside of the set is refused.
    :param present: by how much the plan that is followed exceeds limits, by their names. The new
        plan may exceed them as much, or as the state at its beginning, which no plan changes.
        None: it may not exceed any.
    """
    plan = result.plan
    if plan is None or not plan.is_finite:
        return FirstPlanReport(False, (result.words,), f'refused: {result.words}', None)
    reasons = []
    times = plan.stamp + plan.period * np.arange(len(plan.x))
    E = plan.x - problem.xe - np.outer(times, problem.drift)
    V = plan.u - problem.ue
    moved = problem.model.map(len(V))(E[:-1].T, V.T).full().T
    gap = float((np.abs(moved - E[1:]) / (1.0 + np.abs(E[1:]))).max())
    if not gap <= _GAP:
        reasons.append(f'it departs from the model by {gap:.2g}')
    low, high = problem.limits.u_lower, problem.limits.u_upper
    if not ((plan.u >= low).all() and (plan.u <= high).all()):
        reasons.append('an input is outside its bounds')
    reasons += _find_exceeded(problem, plan.stamp, E, V, present)
    if not plan.residual <= STEP_TOLERANCE:
        reasons.append(f'it is not optimal: {result.words} (residual {plan.residual:.2g})')
    end = None if terminal is None else terminal.measure(E[-1])
    if end is not None and must_end_in_set and not end <= 1.0:
        reasons.append(f'it {_describe_end(end)}: wanted a longer horizon or a start nearer by')
    words = (f'refused: {"; ".join(reasons)}' if reasons else
             f'the first plan is a motion of the model within all limits, optimal to '
             f'{plan.residual:.1e}' + ('' if end is None else f', and {_describe_end(end)}'))
    return FirstPlanReport(not reasons, tuple(reasons), words, end)


def _find_exceeded(problem: RecedingProblem, stamp: float, E: Array, V: Array,
                   present: Mapping[str, float] | None) -> list[str]:
    """Return the limits that errors (N + 1, n) and inputs (N, m) exceed by more than `present`."""
    soft = problem.soft
    rows = ca.Function('rows', [soft.e, soft.v, soft.shift], [soft.rows])
    shifts = np.outer(stamp + problem.period * np.arange(len(E)), problem.drift)
    values = rows.map(len(V))(E[:-1].T, V.T, shifts[:-1].T).full()
    last = rows(E[-1], V[-1], shifts[-1]).full()
    found = []
    for i, (name, low, high) in enumerate(zip(soft.names, soft.lower, soft.upper, strict=True)):
        at = np.append(values[i], last[i]) if i in soft.of_states else values[i]
        excess = np.maximum(low - at, at - high)
        over, allowed = float(excess.max()), 0.0
        if present is not None:
            allowed = max(present.get(name, 0.0), float(excess[0]) if i in soft.of_states else 0.0)
        size = 1.0 + max(abs(each) for each in (low, high) if np.isfinite(each))
        if not over <= allowed + _KEPT * size:
            found.append(f'{name} is exceeded by {over:.3g}')
    return found


def _describe_end(end: float) -> str:
    """Return where a plan ends, with V(x_N) over the level of the terminal set."""
    return (f'ends {"inside" if end <= 1.0 else "outside"} of the set in which the regulator is '
            f'proved to keep all limits, V(x_N)/level = {end:.3g}')
