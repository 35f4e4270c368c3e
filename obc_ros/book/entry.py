# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Entries of the gallery, and rows that compare a result with its reference."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from numpy.typing import ArrayLike, NDArray
from obc_ros.book.runner import Desk

TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class ComparedRow:
    """
    A quantity as computed by the nodes, and its reference.

    :ivar what: name and unit, in the markup of `page`.
    :ivar measured, exact: result and reference, of one shape.
    :ivar by: source of the reference: a formula, or an independent computation.
    :ivar relative: whether errors are relative for references below 1, too.
    :ivar tolerance: largest error allowed.
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
    An example, a theorem or an exercise.

    :ivar name: as on the command line: '2.5', 'theorem-2.1', 'exercise-2.4', 'estimation-1'.
    :ivar source: place in the book, or a publication.
    :ivar statement: paragraphs, in the markup of `page`.
    :ivar erratum: what the book prints and what is correct; empty if the book is correct.
    :ivar in_book: whether the entry is of chapter 2 of the book.
    """

    name: str
    title: str
    source: str
    statement: tuple[str, ...]
    run: Callable[[Desk], EntryResult]
    erratum: str = ''
    in_book: bool = True
