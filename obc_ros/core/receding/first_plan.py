# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Checks of a first plan before a receding horizon becomes active.

The plan is checked against the problem alone: its model, the bounds, the limits at each sample and
its end. Only the residual of the optimality conditions is that of the step.
"""

from collections.abc import Mapping

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.receding.formulation import RecedingProblem
from obc_ros.core.receding.step_solver import STEP_TOLERANCE, StepResult
from obc_ros.core.receding.terminal_set import TerminalSet
from obc_ros.core.text.errors import DynamicsError

_GAP = 1e-8    # relative gap of the model that rounding may leave
_REFUSED = 'no plan from the present state keeps all limits'
_KEPT = 1e-6   # excess that an optimal plan may have, relative to 1 + the size of the limit


def check_first_plan(problem: RecedingProblem, result: StepResult, terminal: TerminalSet,
                     present: Mapping[str, float] | None = None) -> str:
    """
    Check the first plan of a receding horizon; return what was found, in words.

    It is accepted if it is a motion of the model with admissible inputs that exceeds no limit,
    optimal to the tolerance. If it ends in the terminal set, the plan and the regulator keep all
    limits for all time.

    :param present: by how much the plan that is followed exceeds limits, by their names. The new
        plan may exceed them as much, or as the state at its beginning, which no plan changes.
        None: it may not exceed any.
    :raises DynamicsError: with the reasons for which the plan is refused.
    """
    plan = result.plan
    if plan is None or not plan.is_finite:
        raise DynamicsError(f'{_REFUSED}: {result.words}')
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
    if not result.residual <= STEP_TOLERANCE:
        reasons.append(f'it is not optimal: {result.words} (residual {result.residual:.2g})')
    if reasons:
        raise DynamicsError(f'{_REFUSED}: {"; ".join(reasons)}')
    end = terminal.measure(E[-1])
    return ('the first plan is a motion of the model within all limits, optimal to '
            f'{result.residual:.1e}, and ends {"inside" if end <= 1.0 else "outside"} of the set '
            f'in which the regulator is proved to keep all limits, V(x_N)/level = {end:.3g}')


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
