# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numbers as text, and tables as plain text and as HTML."""

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

from obc_ros.core.text.errors import quote

MOST_DIGITS = 17   # with which two doubles that differ are printed differently
# Smaller values are printed as 0, or as 'below' it: they are rounding errors. The tolerances of
# certificates and of the gallery are at least 1e-9.
ZERO = 1e-9
MOST_ROWS = 36   # of an object as text: it fits a screen
FEW_NUMBERS = 16   # of an array that is printed, others by their shape
_LONGEST = 100   # characters of a cell


class Tabulated:
    """An object that Python and a notebook show as a table, by default of its fields."""

    _HEADER: tuple[str, ...] = ('', 'value')

    def _title(self) -> str:
        """Return the line above the table."""
        return type(self).__name__

    def _rows(self) -> Sequence[tuple[str, ...]]:
        """Return the rows under `_HEADER`."""
        return [(name, format_entry(getattr(self, name)))
                for name in getattr(self, '__dataclass_fields__', ())]

    def __str__(self) -> str:
        """Return title and table, at most a screen."""
        rows = list(self._rows())
        if len(rows) > MOST_ROWS:
            left_out = f'... {len(rows) - MOST_ROWS + 1} more'
            rows[MOST_ROWS - 1:] = [(left_out, *[''] * (len(self._HEADER) - 1))]
        title = quote(self._title(), 200)
        return f'{title}\n{format_table(self._HEADER, rows)}' if rows else title

    def __repr__(self) -> str:
        return Tabulated.__str__(self)

    def _repr_html_(self) -> str:
        return format_html_table(self._HEADER, self._rows(), self._title())


def format_entry(value: Any) -> str:
    """Return a value in a cell of a table: ``1.5``, ``[1, 2]``, ``array (201, 2)``, ``p, v``."""
    if isinstance(value, Tabulated):
        return value._title()
    if hasattr(value, 'numel'):   # of CasADi
        return 'expressions {} x {}'.format(*value.shape)
    if hasattr(value, 'tolist'):   # of NumPy
        small = value.size and value.size <= FEW_NUMBERS and value.ndim <= 2
        return _format_numbers(value.tolist()) if small or value.ndim == 0 else (
            f'array {value.shape}')
    if isinstance(value, Mapping):
        listed = ', '.join(f'{key} = {format_entry(each)}' for key, each in value.items())
        return _shorten(listed) or 'none'
    if isinstance(value, (list, tuple)) and all(
            isinstance(each, (str, int, float)) for each in value):
        return _shorten(', '.join(map(format_entry, value))) or 'none'
    if isinstance(value, (list, tuple)):
        return f'{len(value)} x {type(value[0]).__name__}'
    if isinstance(value, (bool, int, float, complex)):
        return str(value) if isinstance(value, (bool, int)) else _format_numbers(value)
    return 'none' if value is None else _shorten(str(value)) if isinstance(value, str) else (
        f'a {type(value).__name__}')


def _format_numbers(value: Any) -> str:
    if isinstance(value, list):
        return f'[{", ".join(map(_format_numbers, value))}]'
    if isinstance(value, complex):
        return f'{value.real:.6g}{value.imag:+.6g}j' if value.imag else f'{value.real:.6g}'
    return f'{value:.6g}' if isinstance(value, float) else str(value)


def _shorten(text: str) -> str:
    return quote(text, _LONGEST)


def format_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table as aligned columns of text, with what is not printable escaped."""
    cells = [[quote(cell, None) for cell in row] for row in (header, *rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    cells.insert(1, ['-' * width for width in widths])
    return '\n'.join('  '.join(cell.ljust(width) for cell, width in zip(
        row, widths, strict=True)).rstrip() for row in cells)


def format_html_table(header: Sequence[str], rows: Iterable[Sequence[str]],
                      caption: str = '') -> str:
    """Return a table as HTML, with a caption above it; all texts are escaped."""
    head = ''.join(f'<th>{_clean(name)}</th>' for name in header)
    body = ''.join('<tr>' + ''.join(f'<td>{_clean(cell)}</td>' for cell in row) + '</tr>'
                   for row in rows)
    title = f'<caption>{_clean(caption)}</caption>' if caption else ''
    return f'<table>{title}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>'


def format_value(value: float, digits: int = 10, scale: float = 1.0) -> str:
    """Return a number for a table: '0' if it is below `ZERO` times a scale."""
    return '0' if abs(value) < ZERO * scale else f'{value:.{digits}g}'


def format_residual(value: float) -> str:
    """Return an error or a residual with two digits, in words if it is below `ZERO`."""
    return f'below {ZERO:.0e}' if 0.0 < value < ZERO else f'{value:.2g}'


def format_distinct(*values: float, digits: int = 4, unit: str = '') -> list[str]:
    """Return numbers with as many digits as show which of them differ."""
    while True:
        texts = [f'{value:.{digits}g}' for value in values]
        if len(set(texts)) >= len(set(values)) or digits >= MOST_DIGITS:
            return [f'{text} {unit}'.rstrip() for text in texts]
        digits += 1


def _clean(text: str) -> str:
    return escape(quote(text, None))
