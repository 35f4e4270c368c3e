# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Entries of the gallery, and rows that compare an answer with its reference."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from numpy.typing import ArrayLike, NDArray
from obc_ros.cli.gallery.runner import Desk

TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class ComparedRow:
    """
    A quantity as the nodes answered it, and its reference.

    Attributes
    ----------
    what : str
        Its name, with the unit; in the markup of `page`.
    measured, exact : array_like
        Of one shape.
    by : str
        Where `exact` comes from: a formula, or an independent computation.
    relative : bool
        Whether errors are taken over exact values below 1, too.
    tolerance : float
        That the error must not exceed.

    """

    what: str
    measured: ArrayLike
    exact: ArrayLike
    by: str
    relative: bool = False
    tolerance: float = TOLERANCE

    @property
    def errors(self) -> NDArray[np.float64]:
        """Return each difference over the exact value, or over 1 if that is less."""
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
        """Return what ``gallery.json`` holds of it; of many values the worst one."""
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
    What an entry came to.

    `notes` are sentences on what the figure shows; `finding` is what was found where the book is
    wrong. Both are in the markup of `page`.
    """

    rows: Sequence[ComparedRow]
    figure: Figure
    notes: Sequence[str] = ()
    finding: str = ''


@dataclass(frozen=True)
class GalleryEntry:
    """
    An example, a theorem or an exercise of the chapter.

    Attributes
    ----------
    name : str
        As on the command line: '2.5', 'theorem-2.1', 'exercise-2.4'.
    title : str
    source : str
        Where it stands in the book.
    statement : tuple of str
        Paragraphs, in the markup of `page`.
    run : callable
        Takes a `Desk` and returns the `EntryResult`.
    erratum : str
        What the book prints and what is right; empty if it is right.

    """

    name: str
    title: str
    source: str
    statement: tuple[str, ...]
    run: Callable[[Desk], EntryResult]
    erratum: str = ''
