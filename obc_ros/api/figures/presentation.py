# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figures for users: made through pyplot and shown, or drawn into axes of the user."""

from collections.abc import Callable
from typing import Any

import numpy as np
from obc_ros.api.figures.style import FIGURES, is_inline
from obc_ros.core.text.errors import describe_type, ObcError


def present(draw: Callable[[Any], Any], ax: Any, show: bool | None) -> Any:
    """
    Return a figure that is drawn for a user, and show it.

    :param draw: draws into None, which is a new figure, a FigureBase, or a list of Axes.
    :param ax: where the user wants it: None, Axes, a sequence of them, a SubFigure or a Figure.
    :param show: whether to show it now; None: if it is new and windows can be opened. A notebook
        shows the figures of pyplot at the end of a cell, once. With False, pyplot, which keeps its
        figures open, does not have it.
    """
    from matplotlib import pyplot  # for users only: commands and nodes do without it
    from matplotlib.figure import FigureBase
    place = ax if ax is None or isinstance(ax, FigureBase) else _list_axes(ax)
    token = FIGURES.set(pyplot.figure if place is None and show is not False else None)
    try:
        figure = draw(place)
    finally:
        FIGURES.reset(token)
    window = figure.canvas.required_interactive_framework is not None
    if (show or show is None and place is None and window) and not is_inline():
        pyplot.show()
    return figure


def _list_axes(ax: Any) -> list[Any]:
    """Return Axes of the user as a list."""
    from matplotlib.axes import Axes
    found = np.asarray(ax, dtype=object).ravel().tolist()
    for each in found:
        if not isinstance(each, Axes):
            raise ObcError('ax: wanted Axes of matplotlib, a sequence of them or a SubFigure, '
                           f'found {describe_type(each)}')
    if not found:
        raise ObcError('ax: wanted Axes of matplotlib, found an empty list')
    return found
