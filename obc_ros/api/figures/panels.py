# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Panels of quantities over time: those of the same unit and of similar magnitude share one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import textwrap
from typing import Any

import numpy as np
from obc_ros.api.figures.style import (
    get_line,
    label_unit,
    LINE_COLOURS,
    new_figure,
    STYLE,
    THIN,
    typeset_symbol,
)
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import ObcError

FEW = 12  # largest number of names in a legend
PANEL = 1.95  # [in] height
TITLE = 0.9  # [in] title, time axis and legend of the marks
LONGEST = 8.8  # [in] height of a figure with one column of panels; higher ones get two
MOST_LINES = 6  # in a panel
LINE = 88  # characters of a line of a title
ROUNDING = 1e-9  # of the largest magnitude: what is below it is drawn beside it
_CONTRAST = 50.0  # ratio of magnitudes above which lines get panels of their own


@dataclass(frozen=True, eq=False)
class Panel:
    """
    Columns of values that share a panel.

    :ivar label: of the axis.
    :ivar names, values: of all columns; (N, k).
    :ivar group: the columns that are drawn.
    :ivar units: by name.
    :ivar template: of a symbol in a legend.
    :ivar lower, upper: (k,), bounds of the columns; they are drawn where the values come near.
    :ivar size: variations far below this are rounding errors. 0: the axis fits the values.
    :ivar zero: whether zero has a line.
    """

    label: str
    names: Sequence[str]
    values: Array
    group: Sequence[int]
    units: Mapping[str, str] = field(default_factory=dict)
    template: str = '{}'
    lower: Array | None = None
    upper: Array | None = None
    size: float = 0.0
    zero: bool = False
    drawstyle: str = 'default'


def draw_columns(t: Array, groups: Mapping[str, tuple[Sequence[str], Array]], title: str,
                 units: Mapping[str, str], into: Any = None) -> Any:
    """
    Return a figure of columns of values over time.

    :param groups: names and values (N, k) of the columns, by the label of their panels.
    :param units: by name.
    :param into: as for `place_panels`.
    """
    import matplotlib
    panels = [Panel(label, names, values, group, units) for label, (names, values) in
              groups.items() for group in split_columns(names, values, units)]
    with matplotlib.rc_context(STYLE):
        figure, axes, _ = place_panels(len(panels), into=into)
        for place, panel in zip(axes, panels, strict=False):
            draw_panel(place, t, panel)
        if figure:
            set_title(figure, title)
    return axes[0].figure.figure


def split_columns(names: Sequence[str], values: Array, units: Mapping[str, str]
                  ) -> list[list[int]]:
    """
    Return the columns of each panel: those of one unit and of similar magnitude, in their order.

    A panel has at most `MOST_LINES`; above `FEW` panels the lines are not counted.
    """
    known = [units.get(name, '') for name in names]
    groups = [[columns[k] for k in group] for unit in dict.fromkeys(known)
              for columns in [[k for k, each in enumerate(known) if each == unit]]
              for group in group_columns(values[:, columns])]
    split = [group[k:k + MOST_LINES] for group in groups
             for k in range(0, len(group), MOST_LINES)]
    return sorted(split if len(split) <= FEW else groups)


def group_columns(values: Array) -> list[list[int]]:
    """Return the columns in groups of similar magnitude, in their order."""
    sizes = np.abs(values).max(axis=0)
    sizes[sizes <= ROUNDING * sizes.max()] = sizes.max()
    groups: list[list[int]] = []
    for index in np.argsort(-sizes, kind='stable').tolist():
        if not groups or sizes[index] * _CONTRAST < sizes[groups[-1][0]]:
            groups.append([])
        groups[-1].append(index)
    return sorted(sorted(group) for group in groups)


def place_panels(count: int, head: float = 0.0, into: Any = None
                 ) -> tuple[Any, list[Any], Any]:
    """
    Return a figure, its panels over time column by column, and the panel above them or None.

    :param head: height of a panel above them, over the whole width [in]; 0 for none.
    :param into: None for a new figure; a figure or a part of one; or a list of axes, of which the
        first is the panel above, if there is one. With fewer axes than panels the last panels are
        left out, and the figure, which has a title already, is None.
    """
    if isinstance(into, list):
        return _take_axes(count, into, bool(head))
    columns = 1 if TITLE + head + PANEL * count <= LONGEST else 2
    rows = -(-count // columns)
    figure = new_figure(TITLE + head + PANEL * rows) if into is None else into
    grid = figure.add_gridspec(1 + bool(head), columns,
                               height_ratios=[head] * bool(head) + [PANEL * rows])
    above = figure.add_subplot(grid[0, :]) if head else None
    axes: list[Any] = []
    for column in range(columns):
        high = min(rows, count - column * rows)   # fewer panels are higher: no place is empty
        parts = grid[-1, column].subgridspec(high, 1)
        for row in range(high):
            place = figure.add_subplot(parts[row, 0], sharex=axes[0] if axes else None)
            place.tick_params(labelbottom=row == high - 1)
            axes.append(place)
        axes[-1].set_xlabel('time [s]')
        figure.align_ylabels(axes[-high:])
    return figure, axes, above


def _take_axes(count: int, into: list[Any], above: bool) -> tuple[None, list[Any], Any]:
    if len(into) > count + above:
        raise ObcError(f'ax: {len(into)} Axes, but the figure has {count + above} panels')
    axes = into[above:]
    for place in axes:
        place.set_xlabel('time [s]')
    return None, axes, into[0] if above else None


def draw_panel(axes: Any, t: Array, panel: Panel) -> None:
    """Draw a panel. A name has the same colour and dashes in every panel."""
    for index in panel.group:
        axes.plot(t, panel.values[:, index], drawstyle=panel.drawstyle, **get_line(index),
                  label=f'${panel.template.format(typeset_symbol(panel.names[index]))}$')
        if panel.lower is not None and panel.upper is not None:
            for sign, bound in ((r'\geq', panel.lower[index]), (r'\leq', panel.upper[index])):
                _draw_bound(axes, panel, index, sign, float(bound))
    units = {panel.units.get(panel.names[index], '') for index in panel.group}
    axes.set_ylabel(label_unit(panel.label, units.pop() if len(units) == 1 else ''))
    axes.set_xlim(t[0], t[-1])
    if panel.zero:
        axes.axhline(0.0, **THIN)
    if panel.size:
        _widen_limits(axes, panel.values[:, panel.group], panel.size)
    if len(panel.group) <= FEW:
        axes.legend(loc='center left', bbox_to_anchor=(1.0, 0.5),
                    ncols=1 + (len(panel.group) > MOST_LINES))


def set_title(figure: Any, title: str) -> None:
    """Set the title of a figure; long lines of it are wrapped."""
    figure.suptitle('\n'.join(textwrap.fill(line, LINE) for line in title.split('\n')))


def _draw_bound(axes: Any, panel: Panel, index: int, sign: str, bound: float) -> None:
    """Draw a bound in the colour of its quantity, with its name, if the values come near it."""
    values = panel.values[:, index]
    low, high = values.min(), values.max()
    if not abs(bound - np.clip(bound, low, high)) <= 0.1 * (high - low):
        return
    colour = LINE_COLOURS[index % len(LINE_COLOURS)]
    axes.axhline(bound, color=colour, linewidth=0.9, linestyle=(0, (1, 2)), zorder=1.5)
    if len(panel.group) > 1:   # elsewhere it is clear whose bound it is
        below = sign == r'\leq'
        axes.annotate(f'${typeset_symbol(panel.names[index])} {sign} {bound:.4g}$', (0.99, bound),
                      (0, -2 if below else 2), xycoords=('axes fraction', 'data'),
                      textcoords='offset points', ha='right', va='top' if below else 'bottom',
                      color=colour, zorder=4,
                      bbox={'facecolor': 'white', 'alpha': 0.7, 'linewidth': 0, 'pad': 0.5})


def _widen_limits(axes: Any, values: Array, size: float) -> None:
    """Widen the limits of an axis: variations far below `size` are rounding errors."""
    middle, half = (values.max() + values.min()) / 2, (values.max() - values.min()) / 2
    half = max(half * 1.1, 0.05 * max(size, abs(middle)) or 0.05)
    axes.set_ylim(middle - half, middle + half)
