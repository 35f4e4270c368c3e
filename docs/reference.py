# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The reference, read from the sources whenever the site is built.

Three directives::

    ```{interfaces} msg
    ```
    ```{parameters} lqr_node
    ```
    ```{modules} obc_ros/core
    ```

The first makes a section for each file of a folder of interfaces, from its fields and their
comments. The second makes the table of a node's parameters from the dataclass `Settings` of its
module. The third makes a section for each module of a folder, from the docstrings. All of them add
to the index.
"""

from collections.abc import Mapping
import math
from pathlib import Path
import re
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sources import Interface, interface, Module, modules, parameters, Row, TABLES
from sphinx import addnodes

KINDS = {'msg': 'message', 'srv': 'service', 'action': 'action'}


class Interfaces(Directive):
    """A section for each file of the folder that is named."""

    required_arguments = 1
    root = Path()

    def run(self) -> list[nodes.Node]:
        """Return the sections."""
        folder = self.root / self.arguments[0]
        self.state.document.settings.env.note_reread()
        return [self._section(interface(file)) for file in sorted(folder.iterdir())]

    def _section(self, found: Interface) -> nodes.section:
        section = nodes.section(ids=[nodes.make_id(found.name)], names=[found.name.lower()])
        section += nodes.title('', found.name.partition('/')[2])
        name = found.name.partition('/')[2]
        names = [f'{name} ({KINDS[self.arguments[0]]})', *(
            f'{each.name} (field of {name})' for _, fields in found.parts for each in fields)]
        section += addnodes.index(entries=[entry(section['ids'][0], each) for each in names])
        section += nodes.paragraph('', found.about)
        for part, fields in found.parts:
            if part:
                section += nodes.paragraph('', '', nodes.strong('', part))
            if not fields:
                section += nodes.paragraph('', 'empty')
                continue
            section += table(('field', 'type', 'meaning'), (24, 24, 52), [
                (nodes.literal('', each.name), nodes.literal('', each.type),
                 nodes.Text(each.comment)) for each in fields])
        return section


class Parameters(Directive):
    """The table of the parameters of the node that is named."""

    required_arguments = 1
    root = Path()

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        self.state.document.settings.env.note_reread()
        node = self.arguments[0]
        rows = parameters(self.root, TABLES[node])
        ids = {row.name: nodes.make_id(f'parameter-{node}-{row.name}') for row in rows}
        entries = [entry(ids[row.name], f'{row.name} (parameter of {node})') for row in rows]
        cells = [(nodes.literal('', row.name, ids=[ids[row.name]]), *_shown(row),
                  nodes.Text(meaning(row))) for row in rows]
        return [addnodes.index(entries=entries),
                table(('parameter', 'default', 'meaning'), (24, 16, 60), cells)]


class Modules(Directive):
    """A section for each module of the folder that is named."""

    required_arguments = 1
    root = Path()

    def run(self) -> list[nodes.Node]:
        """Return the sections."""
        self.state.document.settings.env.note_reread()
        return [self._section(module) for module in modules(self.root, self.arguments[0])]

    def _section(self, module: Module) -> nodes.section:
        section = nodes.section(ids=[nodes.make_id(f'of-{module.name}')], names=[module.name])
        section += nodes.title('', '', nodes.literal('', module.name))
        lines = [f'.. py:module:: {module.name}', '', restructured(module.summary), '']
        for each in module.members:
            lines += [f'.. py:{each.kind}:: {each.name}{each.parameters}', '',
                      f'   {restructured(each.summary)}', '']
        self.state.nested_parse(StringList(lines, module.name), 0, section)
        return section


def restructured(text: str) -> str:
    """Return a text of a docstring as reStructuredText in which only backquotes have a meaning."""
    parts = re.split('`+([^`]*)`+', text)
    return ''.join(f'``{part}``' if number % 2 else re.sub(r'([*_|\\])', r'\\\1', part)
                   for number, part in enumerate(parts))


def entry(target: str, text: str) -> tuple[str, str, str, str, None]:
    """Return an entry of the index that points to the element with the id `target`."""
    return 'single', text, target, '', None


def meaning(row: Row) -> str:
    """Return what a row means, its unit, and what it may be."""
    text = f'{row.description} [{row.unit}]' if row.unit else row.description
    if row.choices:
        text += f'; one of {", ".join(row.choices)}'
    elif math.isfinite(row.lower) and math.isfinite(row.upper):
        text += f'; between {row.lower:g} and {row.upper:g}'
    elif math.isfinite(row.lower):
        text += f'; at least {row.lower:g}'
    elif math.isfinite(row.upper):
        text += f'; at most {row.upper:g}'
    if row.used_when:
        text += f'; used with {" or ".join(map(condition, row.used_when))}'
    return text + ('; read at the start only' if row.read_only else '')


def condition(given: tuple[Any, ...]) -> str:
    """Return a condition on another parameter, in words; see `ros.parameters.table`."""
    name, *wanted = given
    if not wanted:
        return f'one of {name}' if name.endswith('*') else str(name)
    return f'{name} = {" or ".join(str(each).lower() for each in wanted)}'


def _shown(row: Row) -> tuple[nodes.Node]:
    if row.default_given:
        other, value = row.default_given
        words = [str(each).lower() for each in (row.default, value)]
        return (nodes.Text(f'{words[1]} if {other} is given, else {words[0]}'),)
    default = row.default
    if default is None:
        return (nodes.Text('that of the system'),)
    if default in ((), ''):
        return (nodes.Text('empty'),)
    text = str(default).lower() if isinstance(default, bool) else str(default)
    return (nodes.literal('', text),)


def table(head: tuple[str, ...], widths: tuple[int, ...],
          rows: list[tuple[nodes.Node, ...]]) -> nodes.table:
    """Return a table of cells that are inline nodes."""
    group = nodes.tgroup(cols=len(head))
    group += [nodes.colspec(colwidth=width) for width in widths]
    titles = tuple(nodes.Text(text) for text in head)
    group += nodes.thead('', _cells(titles))
    group += nodes.tbody('', *map(_cells, rows))
    return nodes.table('', group, classes=['reference-table'])


def _cells(cells: tuple[nodes.Node, ...]) -> nodes.row:
    return nodes.row('', *(nodes.entry('', nodes.paragraph('', '', cell)) for cell in cells))


def setup(app: Any, root: Path) -> Mapping[str, bool]:
    """Add the directives; they read below `root`."""
    for name, directive in (
            ('interfaces', Interfaces), ('parameters', Parameters), ('modules', Modules)):
        app.add_directive(name, type(directive.__name__, (directive,), {'root': root}))
    return {'parallel_read_safe': True}
