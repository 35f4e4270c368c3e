# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The layout of the package, read from the sources whenever the site is built.

Two directives::

    ```{house} picture
    ```
    ```{house} folders
    ```

The first is the picture of the rooms and the imports between them. The second is the table of the
folders, each with the sentence of its ``__init__.py``.
"""

from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from house import House, read_house, ROOMS, within
from house_figure import draw
from reference import table


class Rooms(Directive):
    """The picture or the table of the folders."""

    required_arguments = 1
    root = Path()

    def run(self) -> list[nodes.Node]:
        """Return the picture or the table."""
        self.state.document.settings.env.note_reread()
        house = read_house(self.root)
        if self.arguments[0] == 'picture':
            return [nodes.raw('', draw(house), format='html')]
        if self.arguments[0] == 'folders':
            return [_folders(house)]
        raise self.error(f"wanted 'picture' or 'folders', found '{self.arguments[0]}'")


def _folders(house: House) -> nodes.table:
    """Return the table of the folders from the top row down."""
    names = [name for room in ROOMS for name in sorted(house.sentences) if within(name, room)]
    return table(('folder', 'files', 'contents'), (30, 8, 62), [
        (nodes.literal('', name.replace('.', '/')),
         nodes.Text(str(len(house.files.get(name, ())))),
         nodes.Text(house.sentences[name].replace('`', ''))) for name in names])


def setup(app: Any, root: Path) -> None:
    """Add the directive; it reads below `root`."""
    app.add_directive('house', type('Rooms', (Rooms,), {'root': root}))
