# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Figures of an answer: its path and conditions, and the costs that its search has found.

matplotlib is imported when a figure is drawn.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
import io
import re
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.augmentation import hide_added_states, restore_added_states
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Attempt, Solution, Verdict

# Okabe and Ito's colours, distinct with any colour vision; after them, dashes differ.
LINE_COLOURS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', '#56B4E9', '#000000')
DASHES = ('-', '--', ':', '-.')
STYLE = {'font.size': 9, 'axes.grid': True, 'grid.alpha': 0.3, 'axes.spines.top': False,
         'axes.spines.right': False, 'lines.linewidth': 1.5, 'legend.frameon': False,
         'axes.axisbelow': True}
THIN: dict[str, Any] = {'color': 'grey', 'linewidth': 0.8, 'linestyle': (0, (4, 3)), 'zorder': 1.5}
GREEK = ('alpha', 'beta', 'gamma', 'delta', 'epsilon', 'zeta', 'eta', 'theta', 'kappa', 'lambda',
         'mu', 'nu', 'xi', 'rho', 'sigma', 'tau', 'phi', 'chi', 'psi', 'omega')
FEW = 12  # largest number of names in a legend
_SEARCH_MARKS = (('initial guess, coarse mesh', 'o', LINE_COLOURS[0]),
                 ('finer mesh', '.', LINE_COLOURS[1]), ('certified', 'D', LINE_COLOURS[2]))
_CONTRAST = 50.0  # ratio of magnitudes above which lines get panels of their own


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
        figure = new_figure(7.5, 3.8)
        _draw_costs(figure.subplots(), solution)
        figure.suptitle(f'{title}\ncosts that the search has found')
    return figure


def draw_columns(t: Array, groups: Mapping[str, tuple[Sequence[str], Array]], title: str
                 ) -> Any:
    """
    Draw columns of values over time, those of similar magnitude in one panel.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times [s].
    groups : mapping
        Names and values (N, k) of the columns, by the label of their panels.
    title : str
        Above the figure.

    Returns
    -------
    matplotlib.figure.Figure
        A notebook shows it; ``savefig`` writes it into a file.

    """
    import matplotlib
    panels = [(label, *columns, group) for label, columns in groups.items()
              for group in _alike(columns[1])]
    with matplotlib.rc_context(STYLE):
        figure = new_figure(7.5, 1.0 + 1.75 * len(panels))
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for panel, (label, names, values, group) in zip(axes, panels, strict=True):
            _lines(panel, label, t, values, '{}', names, group)
        axes[-1].set_xlabel('time [s]')
        axes[-1].set_xlim(t[0], t[-1])
        figure.align_ylabels()
        figure.suptitle(title)
    return figure


def new_figure(width: float, height: float) -> Any:
    """Return an empty figure of a size [inch] in `STYLE`, which a notebook shows."""
    return _figure_class()(figsize=(width, height), layout='constrained')


@cache
def _figure_class() -> type[Any]:
    """Return a class of figures that keep `STYLE` and need no pyplot to be shown."""
    import matplotlib
    from matplotlib.backend_bases import RendererBase
    from matplotlib.figure import Figure

    class StyledFigure(Figure):
        def draw(self, renderer: RendererBase) -> None:
            with matplotlib.rc_context(STYLE):   # ticks are made when they are drawn
                super().draw(renderer)

        def _repr_png_(self) -> bytes:
            stream = io.BytesIO()
            self.savefig(stream, format='png', dpi=100)
            return stream.getvalue()

    return StyledFigure


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
    axes.legend(loc='upper left', bbox_to_anchor=(1.0, 1.0))


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
    states, inputs = _alike(x), _alike(u)
    costates = _alike(lam) if lam.size else []
    panels = len(states) + len(inputs) + len(costates) + 2 * bool(lam.size and whole)
    figure = new_figure(7.5, 1.0 + 1.75 * panels)
    axes = figure.subplots(panels, 1, sharex=True)
    waiting = iter(axes)
    for group in states:
        panel = next(waiting)
        _lines(panel, 'states', t, x, '{}', names, group)
        if whole:
            _bounds(panel, x[:, group], problem.x_lower[group], problem.x_upper[group])
    steps = 'steps-post' if path.interpolation == 'zoh' else 'default'
    for group in inputs:
        panel = next(waiting)
        _lines(panel, 'inputs', t, u, '{}', problem.shown_inputs, group, drawstyle=steps)
        if whole:
            _bounds(panel, u[:, group], problem.u_lower[group], problem.u_upper[group])
    for group in costates:
        _lines(next(waiting), 'costates', t, lam, r'\lambda_{{{}}}', names, group)
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
    _lines(above, 'switching function', t, values, r'\partial H/\partial {}', problem.inputs)
    above.axhline(0.0, **THIN)
    # Where the terms of dH/du cancel, the axis must not magnify their rounding errors.
    _widen(above, values, float(sizes.max()))
    _lines(below, 'Hamiltonian', t, hamiltonian[:, None], '{}', ['H'])
    if problem.final_time.free and not problem.has_clock:
        below.axhline(0.0, **THIN)
    _widen(below, hamiltonian, 1.0)


def _alike(values: Array) -> list[list[int]]:
    """Return the columns in groups of similar magnitude, in their order."""
    sizes = np.abs(values).max(axis=0)
    sizes[sizes == 0.0] = sizes.max()
    groups: list[list[int]] = []
    for index in np.argsort(-sizes, kind='stable').tolist():
        if not groups or sizes[index] * _CONTRAST < sizes[groups[-1][0]]:
            groups.append([])
        groups[-1].append(index)
    return sorted(sorted(group) for group in groups)


def _lines(axes: Any, label: str, t: Array, values: Array, template: str,
           names: Sequence[str], group: Sequence[int] | None = None, **style: Any) -> None:
    """Draw the columns of a group, or all; a name has the same colour in every panel."""
    shown = range(len(names)) if group is None else group
    for index in shown:
        axes.plot(t, values[:, index], label=f'${template.format(typeset_symbol(names[index]))}$',
                  color=LINE_COLOURS[index % len(LINE_COLOURS)],
                  linestyle=DASHES[index // len(LINE_COLOURS) % len(DASHES)], **style)
    axes.set_ylabel(label)
    if len(shown) <= FEW:
        axes.legend(loc='center left', bbox_to_anchor=(1.0, 0.5), ncols=1 + (len(shown) > 6))


def typeset_symbol(name: str) -> str:
    r"""
    Return a name in the notation of mathtext: theta as the letter, x1 with an index.

    Parameters
    ----------
    name : str
        Of a state or an input.

    Returns
    -------
    str
        Without dollar signs: ``\theta``, ``x_{1}``, ``\mathrm{speed}``.

    """
    word, index = re.findall(r'^(.*?)_?(\d*)\Z', name)[0]
    letter = (f'\\{word}' if word in GREEK else word if len(word) == 1 else
              rf'\mathrm{{{word}}}'.replace('_', r'\_'))
    return f'{letter}_{{{index}}}' if index else letter


def _bounds(axes: Any, values: Array, lower: Array, upper: Array) -> None:
    """Draw the bounds that are at most a tenth of the range of the values outside it."""
    for bound in np.unique(np.concatenate([lower, upper])):
        low, high = values.min(), values.max()
        if abs(bound - np.clip(bound, low, high)) <= 0.1 * (high - low):
            axes.axhline(bound, **THIN)


def _widen(axes: Any, values: Array, size: float) -> None:
    """Widen the limits of an axis: variations far below `size` are rounding errors."""
    middle, half = (values.max() + values.min()) / 2, (values.max() - values.min()) / 2
    half = max(half * 1.1, 0.05 * max(size, abs(middle)) or 0.05)
    axes.set_ylim(middle - half, middle + half)
