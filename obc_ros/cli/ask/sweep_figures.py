# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of a sweep: value function, switching surfaces, success; curves or maps."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
import numpy as np
from obc_ros.api.figures.files import save_figure
from obc_ros.api.figures.style import LINE_COLOURS, STYLE, THIN
from obc_ros.core.numerics.arrays import Array
from obc_ros.sweep.axes import SAMPLE

WIDTH, HEIGHT = 6.4, 4.8   # [in]
LEVELS = 10
MOST_CURVES = 6            # inputs or switching times in one panel
MARKERS = 'os^Dv*'         # of these
# Okabe and Ito's colours, for 'not solved yet' and then the flags of the status.
STATUS_COLOURS = ('#FFFFFF', '#56B4E9', '#000000', '#E69F00', '#D55E00', '#999999', '#CC79A7',
                  '#009E73')


def draw_sweep(dataset: Any, folder: Path, formats: Sequence[str] = ('png',)) -> list[Path]:
    """Draw ``value`` and ``success``; return the files, none for over two axes or mixed ones."""
    keys = list(dataset['status'].dims)
    if keys == [SAMPLE]:
        keys = [name for name, each in dataset.coords.items() if each.dims == (SAMPLE,)][:2]
        draw_value, draw_success = _SCATTERED[len(keys)]
    elif len(keys) <= 2 and SAMPLE not in keys:
        draw_value, draw_success = _GRIDDED[len(keys)]
    else:
        return []
    paths = []
    with rc_context(STYLE):
        for name, draw in (('value', draw_value), ('success', draw_success)):
            figure = Figure(figsize=(WIDTH, HEIGHT), layout='constrained')
            figure.suptitle(dataset.attrs['title'])
            draw(figure, dataset, keys)
            paths += save_figure(figure, folder / name, formats)
    return paths


def _draw_curves(figure: Figure, dataset: Any, keys: list[str], style: str = '.-') -> None:
    """Draw along one number cost, inputs at 0 and switching times, or overshoot and decay."""
    order = np.argsort(dataset[keys[0]].values, kind='stable')
    x, of_loops = dataset[keys[0]].values[order], 'decay' in dataset
    which, what, label = (('state', 'overshoot', 'overshoot') if of_loops
                          else ('input', 'inputs', 'inputs at t = 0'))
    third = 'decay' if of_loops else 'switching_times'
    panels = figure.subplots(
        3 if of_loops or np.isfinite(dataset[third].values).any() else 2, 1, sharex=True)
    panels[0].plot(x, _solved(dataset, 'J')[order], style, color=LINE_COLOURS[0], markersize=5)
    panels[0].set_ylabel(_label(dataset, 'J', 'cost J'))
    names = dataset[which].values[:MOST_CURVES]
    for k, name in enumerate(names):
        panels[1].plot(x, dataset[what].values[order, k], MARKERS[k] + style[1:],
                       color=LINE_COLOURS[k % 7], markersize=5, label=str(name))
    panels[1].set_ylabel(label)
    if of_loops or len(names) > 1:
        panels[1].legend()
    if of_loops:
        panels[2].plot(x, _solved(dataset, third)[order], style, color=LINE_COLOURS[0],
                       markersize=5)
        panels[2].axhline(0.0, **THIN)
        panels[2].set_ylabel(_label(dataset, third))
    elif len(panels) > 2:
        panels[2].plot(x, dataset[third].values[order, :MOST_CURVES], '.', color=LINE_COLOURS[0],
                       markersize=5)
        panels[2].set_ylabel('switching times [s]')
    panels[-1].set_xlabel(_label(dataset, keys[0]))


def _draw_statuses(figure: Figure, dataset: Any, keys: list[str]) -> None:
    """Draw along one number how the points ended."""
    axes = figure.subplots()
    codes = dataset['status'].values
    found = np.unique(codes)
    for level, code in enumerate(found):
        x = dataset[keys[0]].values[codes == code]
        axes.plot(x, np.full(len(x), level), '|', color=_colour(code), markersize=14)
    axes.set_yticks(range(len(found)), [_name(dataset, code) for code in found])
    axes.set_ylim(-0.6, len(found) - 0.4)
    axes.set_xlabel(_label(dataset, keys[0]))


def _draw_value_map(figure: Figure, dataset: Any, keys: list[str]) -> None:
    """Draw the cost with level lines, and the switching surfaces."""
    axes = figure.subplots()
    x, y = (dataset[key].values for key in keys)
    cost = _solved(dataset, 'J').T
    mesh = axes.pcolormesh(x, y, cost, shading='nearest', cmap='viridis', rasterized=True)
    figure.colorbar(mesh, label=_label(dataset, 'J', 'cost J'))
    if _spread(cost) and min(cost.shape) > 1:
        lines = axes.contour(x, y, cost, levels=LEVELS, colors='white', linewidths=0.8)
        axes.clabel(lines, fontsize=12)
        (_draw_limit if 'decay' in dataset else _draw_surfaces)(axes, dataset, x, y)
    _label_plane(axes, dataset, keys)


def _draw_surfaces(axes: Axes, dataset: Any, x: Array, y: Array) -> None:
    """Draw where inputs at t = 0 change their sign, and where the number of switches changes."""
    handles = []
    for k, name in enumerate(dataset['input'].values[:MOST_CURVES]):
        signs = np.sign(dataset['inputs'].values[..., k]).T
        if np.nanmin(signs) < 0 < np.nanmax(signs):
            axes.contour(x, y, signs, levels=[0.0], colors=LINE_COLOURS[1], linewidths=1.8,
                         linestyles=('-', '--', ':', '-.')[k % 4])
            handles.append(Line2D([], [], color=LINE_COLOURS[1], linewidth=1.8,
                                  linestyle=('-', '--', ':', '-.')[k % 4],
                                  label=f'{name}(0) changes sign'))
    counts = np.where(_is_solved(dataset), dataset['switches'].values, np.nan).T
    if _spread(counts):
        axes.contour(x, y, counts, levels=np.arange(np.nanmin(counts), np.nanmax(counts)) + 0.5,
                     colors='black', linewidths=1.2, linestyles='--')
        handles.append(Line2D([], [], color='black', linewidth=1.2, linestyle='--',
                              label='number of switches changes'))
    if handles:
        axes.legend(handles=handles, loc='upper right', frameon=True, framealpha=0.9)


def _draw_limit(axes: Axes, dataset: Any, x: Array, y: Array) -> None:
    decay = _solved(dataset, 'decay').T
    if np.nanmin(decay) < 0.0 < np.nanmax(decay):
        axes.contour(x, y, decay, levels=[0.0], colors=LINE_COLOURS[1], linewidths=1.8)
        axes.legend(handles=[Line2D([], [], color=LINE_COLOURS[1], linewidth=1.8,
                                    label='limit of stability')],
                    loc='upper right', frameon=True, framealpha=0.9)


def _draw_success_map(figure: Figure, dataset: Any, keys: list[str]) -> None:
    """Draw how the points of a plane ended."""
    axes = figure.subplots()
    codes = dataset['status'].values.T
    norm = BoundaryNorm(np.arange(-1.5, len(STATUS_COLOURS) - 1), len(STATUS_COLOURS))
    axes.pcolormesh(*(dataset[key].values for key in keys), codes, shading='nearest', norm=norm,
                    cmap=ListedColormap(STATUS_COLOURS), rasterized=True)
    _list_statuses(axes, dataset)
    _label_plane(axes, dataset, keys)


def _draw_value_scatter(figure: Figure, dataset: Any, keys: list[str]) -> None:
    """Draw the cost at samples of two numbers."""
    axes = figure.subplots()
    x, y = (dataset[key].values for key in keys)
    solved = _is_solved(dataset)
    marks = axes.scatter(x[solved], y[solved], 8, dataset['J'].values[solved], cmap='viridis',
                         rasterized=True)
    figure.colorbar(marks, label=_label(dataset, 'J', 'cost J'))
    axes.plot(x[~solved], y[~solved], 'x', color=LINE_COLOURS[1], markersize=4)
    _label_plane(axes, dataset, keys)


def _draw_success_scatter(figure: Figure, dataset: Any, keys: list[str]) -> None:
    """Draw how samples of two numbers ended."""
    axes = figure.subplots()
    codes = dataset['status'].values
    x, y = (dataset[key].values for key in keys)
    axes.scatter(x, y, 8, [_colour(code) for code in codes], rasterized=True)
    _list_statuses(axes, dataset)
    _label_plane(axes, dataset, keys)


_Drawings = dict[int, tuple[Callable[[Figure, Any, list[str]], None], ...]]
# Value and success by the number of keys.
_GRIDDED: _Drawings = {1: (_draw_curves, _draw_statuses), 2: (_draw_value_map, _draw_success_map)}
_SCATTERED: _Drawings = {1: (partial(_draw_curves, style='.'), _draw_statuses),
                         2: (_draw_value_scatter, _draw_success_scatter)}


def _is_solved(dataset: Any) -> Any:
    return dataset['status'].values == 0   # the first flag is 'solved'


def _solved(dataset: Any, name: str) -> Array:
    """Return a quantity at the points that are solved, elsewhere nan."""
    values = np.where(np.isfinite(dataset[name].values), dataset[name].values, np.nan)
    return np.where(_is_solved(dataset), values, np.nan)


def _spread(values: Array) -> bool:
    """Return whether there are several different values."""
    finite = values[np.isfinite(values)]
    return finite.size > 1 and bool(np.ptp(finite) > 0.0)


def _name(dataset: Any, code: int) -> str:
    names = dataset['status'].attrs['flag_meanings'].split()
    return names[code].replace('_', ' ') if code >= 0 else 'not solved yet'


def _colour(code: int) -> str:
    return STATUS_COLOURS[code + 1] if code >= 0 else '#DDDDDD'


def _list_statuses(axes: Axes, dataset: Any) -> None:
    """Add a legend with the statuses that occur and their shares."""
    codes = dataset['status'].values
    axes.legend(handles=[
        Patch(facecolor=STATUS_COLOURS[code + 1], edgecolor='grey',
              label=f'{_name(dataset, code)}: {np.mean(codes == code):.1%}')
        for code in np.unique(codes)], loc='upper right', frameon=True, framealpha=0.9)


def _label_plane(axes: Axes, dataset: Any, keys: list[str]) -> None:
    axes.set_xlabel(_label(dataset, keys[0]))
    axes.set_ylabel(_label(dataset, keys[1]))
    axes.grid(False)


def _label(dataset: Any, name: str, text: str = '') -> str:
    unit = dataset[name].attrs.get('units', '')
    return f'{text or name} [{unit}]' if unit else text or name
