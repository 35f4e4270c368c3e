# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Checks of a first plan before a receding horizon becomes active.

The plan is checked against the problem alone: its model, the bounds, the optimality conditions and
its end. Nothing of the search is used but the multipliers in the residual.
"""

from dataclasses import dataclass

import numpy as np
from obc_ros.core.receding.formulation import RecedingProblem
from obc_ros.core.receding.step_solver import STEP_TOLERANCE, StepResult
from obc_ros.core.receding.terminal_set import TerminalSet

_GAP = 1e-8   # relative gap of the model that rounding may leave


@dataclass(frozen=True)
class FirstPlanReport:
    """
    What was checked of a first plan.

    Attributes
    ----------
    accepted : bool
        Whether the controller may become active.
    reasons : tuple of str
        Why not; empty if it may.
    words : str
        The result in a sentence.
    ends_in_set : bool or None
        Whether the plan ends in the terminal set; None without a set.

    """

    accepted: bool
    reasons: tuple[str, ...]
    words: str
    ends_in_set: bool | None


def check_first_plan(problem: RecedingProblem, result: StepResult,
                     terminal: TerminalSet | None = None) -> FirstPlanReport:
    """
    Check the first plan of a receding horizon.

    It is accepted if it is a motion of the model with admissible inputs that exceeds no limit,
    optimal to the tolerance, and ends in the terminal set if there is one.

    Parameters
    ----------
    problem : RecedingProblem
        The problem.
    result : StepResult
        The step that found the plan.
    terminal : TerminalSet, optional
        The set of `find_terminal_set`.

    Returns
    -------
    FirstPlanReport

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
    reasons += [f'{name} is exceeded by {value:.3g}' for name, value in plan.slack.items()]
    if not plan.residual <= STEP_TOLERANCE:
        reasons.append(f'it is not optimal: {result.words} (residual {plan.residual:.2g})')
    ends = None
    if terminal is not None:
        ends = terminal.contains(E[-1])
        if not ends:
            reasons.append(
                f"it ends at e'P e = {plan.terminal_value:.3g}, outside the terminal set "
                f'({terminal.level:.3g}): wanted a longer horizon or a start nearer by')
    words = (f'refused: {"; ".join(reasons)}' if reasons else
             f'the first plan is a motion of the model within all limits, optimal to '
             f'{plan.residual:.1e}' + (', and ends in the terminal set' if ends else ''))
    return FirstPlanReport(not reasons, tuple(reasons), words, ends)
