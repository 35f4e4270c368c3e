# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Panels of quantities over time: those of similar magnitude share a panel."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from obc_ros.core.library.figures.style import get_line, new_figure, STYLE, typeset_symbol
from obc_ros.core.numerics.arrays import Array

FEW = 12  # largest number of names in a legend
PANEL = 1.9  # [in] height
_CONTRAST = 50.0  # ratio of magnitudes above which lines get panels of their own


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
              for group in group_columns(columns[1])]
    with matplotlib.rc_context(STYLE):
        figure = new_figure(1.0 + PANEL * len(panels))
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for panel, (label, names, values, group) in zip(axes, panels, strict=True):
            draw_lines(panel, label, t, values, '{}', names, group)
        axes[-1].set_xlabel('time [s]')
        axes[-1].set_xlim(t[0], t[-1])
        figure.align_ylabels()
        figure.suptitle(title)
    return figure


def group_columns(values: Array) -> list[list[int]]:
    """Return the columns in groups of similar magnitude, in their order."""
    sizes = np.abs(values).max(axis=0)
    sizes[sizes == 0.0] = sizes.max()
    groups: list[list[int]] = []
    for index in np.argsort(-sizes, kind='stable').tolist():
        if not groups or sizes[index] * _CONTRAST < sizes[groups[-1][0]]:
            groups.append([])
        groups[-1].append(index)
    return sorted(sorted(group) for group in groups)


def draw_lines(axes: Any, label: str, t: Array, values: Array, template: str,
           names: Sequence[str], group: Sequence[int] | None = None, **style: Any) -> None:
    """Draw the columns of a group, or all; a name has the same colour in every panel."""
    shown = range(len(names)) if group is None else group
    for index in shown:
        axes.plot(t, values[:, index], label=f'${template.format(typeset_symbol(names[index]))}$',
                  **get_line(index), **style)
    axes.set_ylabel(label)
    if len(shown) <= FEW:
        axes.legend(loc='center left', bbox_to_anchor=(1.0, 0.5), ncols=1 + (len(shown) > 6))


def widen_limits(axes: Any, values: Array, size: float) -> None:
    """Widen the limits of an axis: variations far below `size` are rounding errors."""
    middle, half = (values.max() + values.min()) / 2, (values.max() - values.min()) / 2
    half = max(half * 1.1, 0.05 * max(size, abs(middle)) or 0.05)
    axes.set_ylim(middle - half, middle + half)
