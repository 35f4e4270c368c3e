# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of an answer: its path in the plane and over time, and the costs of its search."""

from collections.abc import Callable, Iterator
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.api.figures.marks import draw_marks, find_marks
from obc_ros.api.figures.panels import draw_panel, Panel, place_panels, set_title, split_columns
from obc_ros.api.figures.plane import draw_plane, find_plane, PLANE_HEIGHT
from obc_ros.api.figures.style import LINE_COLOURS, new_figure, STYLE, THIN
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.augmentation import hide_added_states, restore_added_states
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Attempt, Solution, Verdict
from obc_ros.core.text.errors import ObcError

NEGLIGIBLE = 1e-4   # of the magnitude of its terms: a quantity below it is drawn as 0
_SEARCH_MARKS = (('initial guess, coarse mesh', 'o', LINE_COLOURS[0]),
                 ('finer mesh', '.', LINE_COLOURS[1]), ('certified', 'D', LINE_COLOURS[2]))


def draw_path(problem: Problem, solution: Solution, title: str, into: Any = None) -> Any:
    """
    Return a figure of a solution: in the plane, and states, inputs, costates, H over time.

    The panel in the plane is drawn for problems with positions or with constraints on two states.
    The switching function and the Hamiltonian are left out, and the title says so, where they are
    0 throughout. Contacts of state constraints, jumps of costates and switching times are marked.

    :param into: as for `place_panels`.
    """
    import matplotlib
    shown, path = hide_added_states(problem, solution), restore_added_states(problem, solution)
    marks, plane = find_marks(problem, path), find_plane(problem)
    panels, zero = list(_list_panels(problem, shown)), []
    if shown.lam.size and problem.phases is None:
        for name, panel in _list_conditions(problem, path, shown.hamiltonian):
            if panel.group:
                panels.append(panel)
            else:
                zero.append(f'${name} = 0$')
    with matplotlib.rc_context(STYLE):
        figure, axes, above = place_panels(len(panels), PLANE_HEIGHT if plane else 0.0, into)
        if plane:
            draw_plane(above, problem, plane, path, marks)
        for place, panel in zip(axes, panels, strict=False):
            draw_panel(place, shown.t, panel)
        handles = draw_marks(axes, marks)
        if figure and handles:
            figure.legend(handles=handles, loc='outside lower center', ncols=2)
        if figure:
            set_title(figure, title + (f'\n{" and ".join(zero)} throughout' if zero else ''))
    return (above or axes[0]).figure.figure


def _list_panels(problem: Problem, shown: Solution) -> Iterator[Panel]:
    whole = problem.phases is None   # the phases have bounds of their own
    n = len(problem.shown_states)
    steps = 'steps-post' if shown.interpolation == 'zoh' else 'default'
    for label, names, values, lower, upper, style in (
            ('states', problem.shown_states, shown.x, problem.x_lower[:n], problem.x_upper[:n],
             'default'),
            ('inputs', problem.shown_inputs, shown.u, problem.u_lower, problem.u_upper, steps)):
        for group in split_columns(names, values, problem.units):
            yield Panel(label, names, values, group, problem.units, drawstyle=style,
                        lower=lower if whole else None, upper=upper if whole else None)
    if shown.lam.size:
        for group in split_columns(problem.shown_states, shown.lam, {}):
            yield Panel('costates', problem.shown_states, shown.lam, group,
                        template=r'\lambda_{{{}}}')


def _list_conditions(problem: Problem, path: Solution, hamiltonian: Array
                     ) -> Iterator[tuple[str, Panel]]:
    """Yield switching function and Hamiltonian; a panel without columns is 0 throughout."""
    values, sizes = compute_slopes(problem, path.x, path.u, path.lam)
    group = [k for k in range(problem.m)
             if np.abs(values[:, k]).max() > NEGLIGIBLE * sizes[:, k].max()]
    # Where the terms of dH/du cancel, the axis must not magnify their rounding errors.
    if not problem.held:
        yield (r'\partial H/\partial u', Panel(
            'switching\nfunctions', problem.inputs, values, group, zero=True,
            template=r'\partial H/\partial {}', size=float(sizes.max())))
    size = _size_hamiltonian(problem, path)
    group = [0] if np.abs(hamiltonian).max() > NEGLIGIBLE * size else []
    yield 'H', Panel('Hamiltonian', ['H'], hamiltonian[:, None], group, size=1.0,
                     zero=problem.final_time.free and not problem.has_clock)


def compute_slopes(problem: Problem, x: Array, u: Array, lam: Array) -> tuple[Array, Array]:
    """
    Return dH/du = dL/du + lam' df/du (N, m), and the sum of the magnitudes of its terms (N, m).

    dH/du vanishes strictly inside the bounds of an input. At the minimum of H it is positive only
    at the lower bound, and negative only at the upper bound.

    :param x, u, lam: (N, n), (N, m) and (N, n), the path.
    """
    costate = ca.SX.sym('lam', problem.n)
    L_u, f_u = ca.jacobian(problem.L, problem.u), ca.jacobian(problem.f, problem.u)
    values, sizes = _evaluate(problem, costate, (x, u, lam), (
        (L_u + costate.T @ f_u).T, (ca.fabs(L_u) + ca.fabs(costate).T @ ca.fabs(f_u)).T))
    return values, sizes


def _size_hamiltonian(problem: Problem, path: Solution) -> float:
    """Return the largest sum of the magnitudes of the terms of H = L + lam' f."""
    costate = ca.SX.sym('lam', problem.n)
    (sizes,) = _evaluate(problem, costate, (path.x, path.u, path.lam), (
        ca.fabs(problem.L) + ca.fabs(costate).T @ ca.fabs(problem.f),))
    return float(sizes.max())


def _evaluate(problem: Problem, costate: ca.SX, path: tuple[Array, ...],
              expressions: tuple[ca.SX, ...]) -> tuple[Array, ...]:
    """Return expressions along a path, shape (N, k) each."""
    N = len(path[0])
    function = ca.Function('along', [problem.x, problem.u, costate, problem.p],
                           [ca.densify(each) for each in expressions])
    found = function.map(N).call([*(each.T for each in path), ca.repmat(problem.p_value, 1, N)])
    return tuple(each.full().T for each in found)


def draw_search(solution: Solution, title: str, into: Any = None) -> Any:
    """Return a figure of the costs that a search has found against its work; `into`: a place."""
    import matplotlib
    if isinstance(into, list) and len(into) > 1:
        raise ObcError(f'ax: {len(into)} Axes, but the figure has 1 panel')
    with matplotlib.rc_context(STYLE):
        if isinstance(into, list):
            [axes] = into
            _draw_costs(axes, solution)
            if axes.get_legend_handles_labels()[1]:
                axes.legend()
        else:
            figure = new_figure(4.2) if into is None else into
            axes = figure.subplots()
            _draw_costs(axes, solution)
            figure.legend(loc='outside lower center', ncols=2)
            figure.suptitle(f'{title}\ncosts that the search has found')
    return axes.figure.figure


def _draw_costs(axes: Any, solution: Solution) -> None:
    """Draw costs of initial guesses, meshes and certified solutions, and the local minima."""
    minima = solution.optimality.minima if solution.optimality else ()
    choices: tuple[Callable[[Attempt], bool], ...] = (
        lambda each: each.method == 'initial guess' and each.verdict is Verdict.CONVERGED,
        lambda each: each.method == 'mesh' and each.verdict is not Verdict.CERTIFIED,
        lambda each: each.verdict is Verdict.CERTIFIED)
    costs = []
    for (label, marker, colour), chosen in zip(_SEARCH_MARKS, choices, strict=True):
        points = np.array([(each.begun + each.work, each.cost) for each in solution.attempts
                           if chosen(each) and np.isfinite(each.cost)]).reshape(-1, 2)
        costs.append(points[:, 1])
        if len(points):
            axes.plot(*points.T, linestyle='none', marker=marker, markersize=6, color=colour,
                      markerfacecolor='none' if marker == 'o' else colour, label=label)
    for number, cost in enumerate(minima):
        axes.axhline(cost, **THIN, label=None if number else 'local minima')
    if np.isfinite(solution.objective):
        axes.axhline(solution.objective, color=LINE_COLOURS[2], linewidth=0.8, zorder=1.4)
    every = np.concatenate([*costs, minima])
    if every.size:   # a poor guess must not flatten the rest
        low, high = every.min(), np.quantile(every, 0.9)
        room = 0.08 * max(high - low, 1e-6 * max(abs(low), 1e-12))
        axes.set_ylim(low - room, high + room)
    axes.set_xlabel('work [iterations x intervals]')
    axes.set_ylabel('cost')
