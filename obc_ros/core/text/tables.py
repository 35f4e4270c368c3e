# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numbers as text, and tables as plain text and as HTML."""

from collections.abc import Iterable, Sequence
from html import escape

from obc_ros.core.text.errors import quote

MOST_DIGITS = 17   # with which two doubles that differ are printed differently
# Smaller values are printed as 0, or as 'below' it: they are rounding errors. The tolerances of
# certificates and of the gallery are at least 1e-9.
ZERO = 1e-9


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
