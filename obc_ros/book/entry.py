# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Entries of the gallery: rows that compare a result with its reference, and panels."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import ArrayLike, NDArray
from obc_ros.api.figures.style import EXACT_LINE, LINE_COLOURS, THIN, WIDTH
from obc_ros.book.runner import Desk

TOLERANCE = 1e-6
HEIGHT = 3.5  # [in] of one row


@dataclass(frozen=True, eq=False)
class ComparedRow:
    """
    A quantity as computed by the nodes, and its reference.

    :ivar what: name and unit, in the markup of `page`.
    :ivar by: source of the reference: a formula, or an independent computation.
    :ivar relative: whether errors are relative for references below 1, too.
    """

    what: str
    measured: ArrayLike
    exact: ArrayLike
    by: str
    relative: bool = False
    tolerance: float = TOLERANCE

    @property
    def errors(self) -> NDArray[np.float64]:
        """Return each difference divided by the reference, or by 1 if that is below 1."""
        measured, exact = (np.asarray(each, dtype=float) for each in (self.measured, self.exact))
        if measured.shape != exact.shape or not measured.size:
            return np.array([np.inf])
        scale = np.maximum(0.0 if self.relative else 1.0, np.abs(exact))
        with np.errstate(divide='ignore', invalid='ignore'):
            errors = np.abs(measured - exact) / scale
        return np.where(np.isfinite(errors), errors, np.inf).ravel()

    @property
    def error(self) -> float:
        """Return the largest error."""
        return float(self.errors.max())

    @property
    def holds(self) -> bool:
        """Return whether the error is within the tolerance."""
        return self.error <= self.tolerance

    def as_json(self) -> dict[str, Any]:
        """Return the row of ``gallery.json``, with the value that has the largest error."""
        measured, exact = (np.asarray(each, dtype=float).ravel()
                           for each in (self.measured, self.exact))
        worst = int(np.argmax(self.errors))
        return {'what': self.what, 'measured': float(measured[worst]),
                'exact': float(exact[worst]), 'values': int(measured.size), 'error': self.error,
                'relative': self.relative, 'tolerance': self.tolerance, 'by': self.by,
                'holds': self.holds}


@dataclass(frozen=True, eq=False)
class EntryResult:
    """
    The result of an entry.

    `notes` are sentences on the figure; `finding` has the numbers that show an erratum of the
    book. Both are in the markup of `page`. `more` has further figures, by the ending of their
    names: 'inputs' is ``NAME-inputs.png``.
    """

    rows: Sequence[ComparedRow]
    figure: Figure
    notes: Sequence[str] = ()
    finding: str = ''
    more: Mapping[str, Figure] = field(default_factory=dict)


@dataclass(frozen=True)
class GalleryEntry:
    """
    An example, a theorem or an exercise, as on the command line: 'example-2.5', 'theorem-2.1'.

    :ivar source: place in the book, or a publication.
    :ivar statement: paragraphs, in the markup of `page`.
    :ivar erratum: what the book prints and what is correct; empty if the book is correct.
    """

    name: str
    title: str
    source: str
    statement: tuple[str, ...]
    run: Callable[[Desk], EntryResult]
    erratum: str = ''
    in_book: bool = True


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
