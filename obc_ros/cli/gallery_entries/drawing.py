# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of the gallery: one size, one way of marking what is exact."""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

WIDTH = 9.6  # [in]
HEIGHT = 3.6  # [in] of one row
# Closed forms are drawn on top, so that a difference would show.
EXACT = {'color': 'black', 'linestyle': (0, (1, 2.5)), 'linewidth': 1.6, 'zorder': 5}


def panels(rows: int, columns: int, height: float = HEIGHT, **options: Any
           ) -> tuple[Figure, Any]:
    """Return a figure and its axes, an array (rows, columns)."""
    figure = Figure(figsize=(WIDTH, height * rows), layout='constrained')
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def describe(axes: Axes, title: str, x: str, y: str, *, legend: bool | str = False) -> None:
    """Give axes their title, labels and legend (or its place)."""
    axes.set(title=title, xlabel=x, ylabel=y)
    if legend:
        axes.legend(loc=legend if isinstance(legend, str) else 'best')


def legend_below(figure: Figure, axes: Axes, columns: int = 4) -> None:
    """Put the legend of axes below the figure."""
    figure.legend(*axes.get_legend_handles_labels(), loc='outside lower center', ncols=columns)


def arrow(axes: Axes, start: Any, direction: Any, **style: Any) -> None:
    """Draw a vector."""
    begin, by = np.asarray(start, dtype=float), np.asarray(direction, dtype=float)
    axes.annotate('', begin + by, begin, arrowprops={'arrowstyle': '-|>', 'linewidth': 1.6,
                                                     'shrinkA': 0, 'shrinkB': 0, **style})
