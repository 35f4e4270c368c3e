# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Solution of linear quadratic problems with a fixed horizon by the Riccati equation (2.7)."""

from dataclasses import replace

import numpy as np
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution, Status
from obc_ros.core.riccati.problem_matrices import find_lq_form
from obc_ros.core.riccati.terminal_constraints import solve_form
from obc_ros.core.solver.proofs.contradictions import explain_contradiction


def solve_lq(problem: Problem) -> Solution | None:
    """
    Solve a linear quadratic problem with a fixed horizon.

    :return: None if the problem is not linear quadratic (affine terms are allowed, the cost must
        be strictly convex in u), has path constraints, or a bound may be active. Status
        'infeasible' if exact arithmetic proves that no input meets the terminal constraints;
        'not_converged' if that is not proved, or if the cost has no minimum (a conjugate point).
    """
    if problem.final_time.free or problem.path.numel() or problem.start is not None:
        return None
    form = find_lq_form(problem)
    if form is None:
        return None
    solution = solve_form(form, problem.x0, problem.final_time.value, problem.states)
    if solution.status is Status.INFEASIBLE and not explain_contradiction(problem):
        # In floating point a target within reach may look out of reach.
        solution = replace(solution, status=Status.NOT_CONVERGED, message=(
            f'no path was found; infeasibility has not been proved ({solution.message})'))
    if not solution.t.size:
        bounds = problem.x_lower, problem.x_upper, problem.u_lower, problem.u_upper
        return solution if np.isinf(np.concatenate(bounds)).all() else None
    return solution if _is_within(problem, solution) else None


def _is_within(problem: Problem, solution: Solution) -> bool:
    """Return whether a path is inside its bounds by its largest change between two samples."""
    for values, lower, upper in ((solution.x, problem.x_lower, problem.x_upper),
                                 (solution.u, problem.u_lower, problem.u_upper)):
        room = np.abs(np.diff(values, axis=0)).max(axis=0, initial=0.0)
        if (values.min(axis=0) - room < lower).any() or (values.max(axis=0) + room > upper).any():
            return False
    return True
