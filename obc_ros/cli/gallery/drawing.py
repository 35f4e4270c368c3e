# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of the gallery: one size, one way of marking what is exact."""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from obc_ros.cli import figures

WIDTH = 8.4  # [in]
HEIGHT = 3.1  # [in] of one row
# Type and letters of a printed page; a legend hides what is behind it.
AXES_STYLE = {**figures.STYLE, 'font.family': 'STIXGeneral', 'mathtext.fontset': 'stix',
              'font.size': 10, 'axes.titlesize': 11, 'axes.labelsize': 10.5,
              'legend.fontsize': 9.5,
              'legend.frameon': True, 'legend.framealpha': 0.85, 'legend.edgecolor': 'none',
              'legend.borderpad': 0.15, 'legend.labelspacing': 0.3, 'legend.handlelength': 1.6,
              'lines.linewidth': 1.4, 'figure.constrained_layout.w_pad': 0.08,
              'figure.constrained_layout.h_pad': 0.06}
DPI = 200
# Closed forms are drawn on top, so that a difference would show.
EXACT = {'color': 'black', 'linestyle': (0, (1, 2.5)), 'linewidth': 1.6, 'zorder': 5}


def create_panels(rows: int, columns: int, height: float = HEIGHT, **options: Any
                  ) -> tuple[Figure, Any]:
    """Return a figure and its axes, an array (rows, columns)."""
    figure = Figure(figsize=(WIDTH, height * rows), layout='constrained')
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def label_axes(axes: Axes, title: str, x: str, y: str, *, legend: bool | str = False) -> None:
    """Give axes their title, labels and legend (or its place)."""
    axes.set(title=title, xlabel=x, ylabel=y)
    if legend:
        axes.legend(loc=legend if isinstance(legend, str) else 'best')


def place_legend_below(figure: Figure, axes: Axes, columns: int = 4) -> None:
    """Put the legend of axes below the figure."""
    figure.legend(*axes.get_legend_handles_labels(), loc='outside lower center', ncols=columns)


def draw_arrow(axes: Axes, start: Any, direction: Any, **style: Any) -> None:
    """Draw a vector."""
    begin, by = np.asarray(start, dtype=float), np.asarray(direction, dtype=float)
    axes.annotate('', begin + by, begin, arrowprops={'arrowstyle': '-|>', 'linewidth': 1.6,
                                                     'shrinkA': 0, 'shrinkB': 0, **style})
