# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Files of figures: PNG, PDF and SVG.

The same figure gives the same bytes. A PDF embeds TrueType fonts, which publishers ask for; an SVG
has its text as outlines and looks the same without the fonts.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from obc_ros.api.figures.style import STYLE
from obc_ros.core.text.errors import ObcError, quote

# Formats, and what their files would say about the time at which they were written.
_UNDATED: dict[str, dict[str, None]] = {
    'png': {}, 'pdf': {'CreationDate': None, 'ModDate': None}, 'svg': {'Date': None}}
FORMATS = tuple(_UNDATED)
_IN_FILES = {'pdf.fonttype': 42, 'svg.fonttype': 'path', 'svg.hashsalt': 'obc_ros'}


def parse_formats(text: str) -> tuple[str, ...]:
    """Return the formats that a text names, as ``pdf,svg``, once; ObcError for another name."""
    names = [name.strip().lower().removeprefix('.') for name in text.split(',')]
    for name in names:
        if name not in FORMATS:
            raise ObcError(f"no format '{quote(name)}': wanted one or several of "
                           f'{", ".join(FORMATS)}, with commas between them')
    return tuple(dict.fromkeys(names))


def save_figure(figure: Any, path: Path, formats: Sequence[str] = ('png',)) -> list[Path]:
    """Write a figure into files, the path with the ending of each format; return the files."""
    import matplotlib
    paths = [path.with_name(f'{path.name}.{name}') for name in formats]
    for name, file in zip(formats, paths, strict=True):
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            with matplotlib.rc_context(STYLE | _IN_FILES):
                figure.savefig(file, format=name, metadata=_UNDATED[name])
        except OSError as error:
            raise ObcError(f'{file} cannot be written: {error.strerror}') from error
    return paths
