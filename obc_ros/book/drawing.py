# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Panels of the gallery: sizes, labels, legends, arrows and poles."""

from collections.abc import Iterable
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray
from obc_ros.api.figures.style import EXACT_LINE, LINE_COLOURS, THIN, WIDTH

HEIGHT = 3.5  # [in] of one row


def create_panels(rows: int, columns: int, height: float = HEIGHT, **options: Any
                  ) -> tuple[Figure, Any]:
    """Return a figure and its panels (rows, columns); the height is that of a row [in]."""
    figure = Figure(figsize=(WIDTH, height * rows), layout='constrained')
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def label_axes(axes: Axes, title: str, x: str, y: str, *, legend: bool | str = False) -> None:
    """Set title, labels and legend of a panel; `legend` may be its place."""
    axes.set(title=title, xlabel=x, ylabel=y)
    if legend:
        axes.legend(loc=legend if isinstance(legend, str) else 'best')


def place_legend_below(figure: Figure, axes: Axes, columns: int = 4) -> None:
    """Put the legend of a panel below the figure, which has a constrained layout."""
    figure.legend(*axes.get_legend_handles_labels(), loc='outside lower center', ncols=columns)


def draw_arrow(axes: Axes, start: Any, direction: Any, **style: Any) -> None:
    """Draw a vector in the coordinates of the data; `style` is for `arrowprops` of `annotate`."""
    (x, y), (along, across) = np.asarray([start, direction], dtype=float)
    axes.annotate('', (x + along, y + across), (x, y), arrowprops={
        'arrowstyle': '-|>', 'linewidth': 1.8, 'shrinkA': 0, 'shrinkB': 0, **style})


def draw_pole_pairs(axes: Axes, pairs: Iterable[tuple[NDArray[np.complex128], str]], title: str
                    ) -> None:
    """
    Draw pairs of complex poles of the damping ratio 1/sqrt(2), and the rays on which they are.

    :param pairs: the poles (2,) [rad/s] of each pair, and the text beside the upper one; empty:
        none.
    """
    ray = np.array([-2.6, 0.0])
    for sign in (1, -1):
        axes.plot(ray, sign * ray, **EXACT_LINE)
    for poles, text in pairs:
        axes.plot(poles.real, poles.imag, 'o', color=LINE_COLOURS[0])
        upper = poles[np.argmax(poles.imag)]
        axes.annotate(text, (upper.real, upper.imag), (7, 2), textcoords='offset points')
    axes.axhline(0, **THIN)
    axes.axvline(0, color='black', linewidth=1)
    axes.set(xlim=(-2.7, 1.2), ylim=(-2.7, 2.7))
    label_axes(axes, title, 'real part [rad/s]', 'imaginary part [rad/s]')
