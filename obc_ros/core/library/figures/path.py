# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The path of an answer and its conditions over time."""

from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.library.figures.panels import draw_lines, group_columns, PANEL, widen_limits
from obc_ros.core.library.figures.style import new_figure, STYLE, THIN
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.augmentation import hide_added_states, restore_added_states
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution


def draw_path(problem: Problem, solution: Solution, title: str) -> Any:
    """
    Draw states, inputs, costates, the switching function and the Hamiltonian of a solution.

    Parameters
    ----------
    problem : Problem
        The problem, with its bounds.
    solution : Solution
        With a path; costates may be missing.
    title : str
        Above the figure.

    Returns
    -------
    matplotlib.figure.Figure
        A notebook shows it; ``savefig`` writes it into a file.

    """
    import matplotlib
    with matplotlib.rc_context(STYLE):
        figure = _draw_panels(problem, solution)
        figure.suptitle(title)
    return figure


def _slopes(problem: Problem, x: Array, u: Array, lam: Array) -> tuple[Array, Array]:
    """
    Return dH/du = dL/du + lam' df/du (N, m), and the sum of the magnitudes of its terms (N, m).

    dH/du vanishes strictly inside the bounds of an input. At the minimum of H it is positive only
    at the lower bound, and negative only at the upper bound.
    """
    costate = ca.SX.sym('lam', problem.n)
    L_u, f_u = ca.jacobian(problem.L, problem.u), ca.jacobian(problem.f, problem.u)
    slopes = ca.Function('slopes', [problem.x, problem.u, costate, problem.p], [
        ca.densify(L_u + costate.T @ f_u).T,
        ca.densify(ca.fabs(L_u) + ca.fabs(costate).T @ ca.fabs(f_u)).T])
    N = len(x)
    values, sizes = slopes.map(N)(x.T, u.T, lam.T, ca.repmat(problem.p_value, 1, N))
    return values.full().T, sizes.full().T


def _draw_panels(problem: Problem, path: Solution) -> Any:
    shown = hide_added_states(problem, path)
    path = restore_added_states(problem, path)
    t, x, u, lam = shown.t, shown.x, shown.u, shown.lam
    names, whole = problem.shown_states, problem.phases is None   # H has one phase
    states, inputs = group_columns(x), group_columns(u)
    costates = group_columns(lam) if lam.size else []
    panels = len(states) + len(inputs) + len(costates) + 2 * bool(lam.size and whole)
    figure = new_figure(1.0 + PANEL * panels)
    axes = figure.subplots(panels, 1, sharex=True)
    waiting = iter(axes)
    for group in states:
        panel = next(waiting)
        draw_lines(panel, 'states', t, x, '{}', names, group)
        if whole:
            _bounds(panel, x[:, group], problem.x_lower[group], problem.x_upper[group])
    steps = 'steps-post' if path.interpolation == 'zoh' else 'default'
    for group in inputs:
        panel = next(waiting)
        draw_lines(panel, 'inputs', t, u, '{}', problem.shown_inputs, group, drawstyle=steps)
        if whole:
            _bounds(panel, u[:, group], problem.u_lower[group], problem.u_upper[group])
    for group in costates:
        draw_lines(next(waiting), 'costates', t, lam, r'\lambda_{{{}}}', names, group)
    if lam.size and whole:
        _conditions(next(waiting), next(waiting), problem, (t, path.x, u, path.lam),
                    shown.hamiltonian)
    for panel in axes:
        for time in shown.switching_times:
            panel.axvline(time, **THIN)
    axes[-1].set_xlabel('time [s]')
    axes[-1].set_xlim(t[0], t[-1])
    figure.align_ylabels()
    return figure


def _conditions(above: Any, below: Any, problem: Problem, path: tuple[Array, ...],
                hamiltonian: Array) -> None:
    """Draw the switching function and the Hamiltonian."""
    t, x, u, lam = path
    values, sizes = _slopes(problem, x, u, lam)
    draw_lines(above, 'switching function', t, values, r'\partial H/\partial {}', problem.inputs)
    above.axhline(0.0, **THIN)
    # Where the terms of dH/du cancel, the axis must not magnify their rounding errors.
    widen_limits(above, values, float(sizes.max()))
    draw_lines(below, 'Hamiltonian', t, hamiltonian[:, None], '{}', ['H'])
    if problem.final_time.free and not problem.has_clock:
        below.axhline(0.0, **THIN)
    widen_limits(below, hamiltonian, 1.0)


def _bounds(axes: Any, values: Array, lower: Array, upper: Array) -> None:
    """Draw the bounds that are at most a tenth of the range of the values outside it."""
    for bound in np.unique(np.concatenate([lower, upper])):
        low, high = values.min(), values.max()
        if abs(bound - np.clip(bound, low, high)) <= 0.1 * (high - low):
            axes.axhline(bound, **THIN)
