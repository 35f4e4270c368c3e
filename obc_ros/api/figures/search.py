# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The costs that a search has found."""

from collections.abc import Callable
from typing import Any

import numpy as np
from obc_ros.api.figures.style import LINE_COLOURS, new_figure, STYLE, THIN
from obc_ros.core.ocp.solution import Attempt, Solution, Verdict

_SEARCH_MARKS = (('initial guess, coarse mesh', 'o', LINE_COLOURS[0]),
                 ('finer mesh', '.', LINE_COLOURS[1]), ('certified', 'D', LINE_COLOURS[2]))


def draw_search(solution: Solution, title: str) -> Any:
    """
    Draw the costs that a search has found against its work.

    Parameters
    ----------
    solution : Solution
        With its attempts.
    title : str
        Above the figure.

    Returns
    -------
    matplotlib.figure.Figure
        A notebook shows it; ``savefig`` writes it into a file.

    """
    import matplotlib
    with matplotlib.rc_context(STYLE):
        figure = new_figure(4.2)
        _draw_costs(figure.subplots(), solution)
        figure.suptitle(f'{title}\ncosts that the search has found')
    return figure


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
    axes.figure.legend(loc='outside lower center', ncols=2)
