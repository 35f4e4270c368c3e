# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of the gallery: sizes, styles, axes and legends."""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from obc_ros.core.library.figures import STYLE

WIDTH = 8.4  # [in]
HEIGHT = 3.1  # [in] of one row
# Fonts of a printed page; legends are nearly opaque.
AXES_STYLE = {**STYLE, 'font.family': 'STIXGeneral', 'mathtext.fontset': 'stix',
              'font.size': 10, 'axes.titlesize': 11, 'axes.labelsize': 10.5,
              'legend.fontsize': 9.5,
              'legend.frameon': True, 'legend.framealpha': 0.85, 'legend.edgecolor': 'none',
              'legend.borderpad': 0.15, 'legend.labelspacing': 0.3, 'legend.handlelength': 1.6,
              'lines.linewidth': 1.4, 'figure.constrained_layout.w_pad': 0.08,
              'figure.constrained_layout.h_pad': 0.06}
DPI = 200
# References are drawn on top: a difference is visible.
EXACT = {'color': 'black', 'linestyle': (0, (1, 2.5)), 'linewidth': 1.6, 'zorder': 5}


def create_panels(rows: int, columns: int, height: float = HEIGHT, **options: Any
                  ) -> tuple[Figure, Any]:
    """
    Return a figure with panels.

    Parameters
    ----------
    rows, columns : int
        Numbers of panels.
    height : float
        Of a row [in].
    **options : object
        For `Figure.subplots`.

    Returns
    -------
    Figure, ndarray of Axes, shape (rows, columns)
        The figure and its panels.

    """
    figure = Figure(figsize=(WIDTH, height * rows), layout='constrained')
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def label_axes(axes: Axes, title: str, x: str, y: str, *, legend: bool | str = False) -> None:
    """
    Set title, labels and legend of a panel.

    Parameters
    ----------
    axes : Axes
        The panel.
    title, x, y : str
        Title, and labels of both axes with their units.
    legend : bool or str
        Whether there is a legend, or its place.

    """
    axes.set(title=title, xlabel=x, ylabel=y)
    if legend:
        axes.legend(loc=legend if isinstance(legend, str) else 'best')


def place_legend_below(figure: Figure, axes: Axes, columns: int = 4) -> None:
    """
    Put the legend of a panel below the figure.

    Parameters
    ----------
    figure : Figure
        With a constrained layout.
    axes : Axes
        Whose labelled lines the legend has.
    columns : int
        Of the legend.

    """
    figure.legend(*axes.get_legend_handles_labels(), loc='outside lower center', ncols=columns)


def draw_arrow(axes: Axes, start: Any, direction: Any, **style: Any) -> None:
    """
    Draw a vector.

    Parameters
    ----------
    axes : Axes
        The panel.
    start, direction : array_like, shape (2,)
        Where the vector begins, and the vector, in the coordinates of the data.
    **style : object
        For `arrowprops` of `Axes.annotate`.

    """
    begin, by = np.asarray(start, dtype=float), np.asarray(direction, dtype=float)
    axes.annotate('', begin + by, begin, arrowprops={'arrowstyle': '-|>', 'linewidth': 1.6,
                                                     'shrinkA': 0, 'shrinkB': 0, **style})
