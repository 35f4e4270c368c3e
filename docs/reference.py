# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The reference, read from the sources whenever the site is built.

Two directives::

    ```{interfaces} msg
    ```
    ```{parameters} lqr_node
    ```

The first makes a section for each file of a folder of interfaces, from its fields and their
comments. The second makes the table of a node's parameters from the dataclass `Settings` of its
module. Modules are parsed, not imported: there need be no ROS where the site is built.
"""

import ast
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive

PARTS = {'msg': ('',), 'srv': ('Request', 'Response'), 'action': ('Goal', 'Result', 'Feedback')}
# The module whose `Settings` are a node's parameters.
TABLES = {
    'lqr_node': 'obc_ros.nodes.lqr_settings',
    'plant_simulator': 'obc_ros.nodes.plant_simulator',
    'trajectory_server': 'obc_ros.nodes.trajectory_server'}


@dataclass(frozen=True)
class Field:
    """A field of an interface."""

    type: str
    name: str
    comment: str


@dataclass(frozen=True)
class Interface:
    """An interface: its name, what its first comment says, and its fields by part."""

    name: str
    about: str
    parts: tuple[tuple[str, tuple[Field, ...]], ...]


@dataclass(frozen=True)
class Row:
    """A parameter; `default` and `choices` are Python values, the others as in `Entry`."""

    name: str
    default: Any
    description: str
    unit: str = ''
    lower: float = -math.inf
    upper: float = math.inf
    choices: tuple[str, ...] = ()
    read_only: bool = False


def interface(file: Path) -> Interface:
    """
    Return what an interface file says.

    Raises
    ------
    ValueError
        If a line is neither a comment nor a field with a comment.

    """
    about: list[str] = []
    parts: list[list[Field]] = [[]]
    for number, line in enumerate(file.read_text(encoding='utf-8').splitlines(), start=1):
        statement, _, comment = (text.strip() for text in line.partition('#'))
        if statement == '---':
            parts.append([])
        elif statement:
            words = statement.split()
            if len(words) != 2 or not comment:
                raise ValueError(f'{file.name}:{number}: wanted TYPE NAME # COMMENT')
            parts[-1].append(Field(*words, comment))
        elif comment and not any(parts):
            about.append(comment)
    names = PARTS[file.parent.name]
    return Interface(f'{file.parent.name}/{file.stem}', ' '.join(about), tuple(
        (name, tuple(fields)) for name, fields in zip(names, parts, strict=True)))


class Source:
    """A module of the package, by its syntax tree."""

    def __init__(self, root: Path, module: str) -> None:
        """Parse `module` below `root`."""
        path = root / Path(*module.split('.')).with_suffix('.py')
        if not path.is_file():
            path = path.with_suffix('') / '__init__.py'
        self.root = root
        self.tree = ast.parse(path.read_text(encoding='utf-8'))

    def definition(self, name: str) -> 'tuple[Source, ast.AST]':
        """Return where a name of the module is defined: a class, a function or a value."""
        for node in self.tree.body:
            match node:
                case ast.ClassDef(name=found) | ast.FunctionDef(name=found) if found == name:
                    return self, node
                case ast.Assign(targets=[ast.Name(id=found)], value=value) if found == name:
                    return self, value
                case ast.ImportFrom(module=module, names=names) if module:
                    for alias in names:
                        if (alias.asname or alias.name) == name:
                            return Source(self.root, module).definition(alias.name)
        raise ValueError(f'{name} is not defined')

    def value(self, node: ast.AST) -> Any:
        """Return the value of an expression of literals, names, `math.inf` and `tuple`."""
        match node:
            case ast.Name(id=name):
                source, found = self.definition(name)
                return source.value(found)
            case ast.Attribute(value=ast.Name(id='math'), attr='inf'):
                return math.inf
            case ast.Call(func=ast.Name(id='tuple'), args=[argument]):
                return tuple(self.value(argument))
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return -self.value(operand)
            case ast.Tuple(elts=elements):
                return tuple(value for element in elements for value in (
                    self.value(element.value) if isinstance(element, ast.Starred) else
                    (self.value(element),)))
            case ast.Dict(keys=keys):
                # what counts of a dictionary of choices
                return [self.value(key) for key in keys if key is not None]
        return ast.literal_eval(node)  # type: ignore[arg-type] # an expression


def parameters(root: Path, module: str) -> list[Row]:
    """Return the rows of the dataclass `Settings` of a module, in order."""
    source, settings = Source(root, module).definition('Settings')
    assert isinstance(settings, ast.ClassDef)
    rows: list[Row] = []
    for node in settings.body:
        match node:
            case ast.AnnAssign(target=ast.Name(id=name), value=ast.Call(
                    func=ast.Name(id='parameter')) as call):
                rows.append(_row(source, name, call))
            case ast.AnnAssign(target=ast.Name(id=name), value=ast.Call(
                    func=ast.Name(id='group'), args=[members])):
                rows += _group(source, name, members)
    return rows


def _row(source: Source, field: str, call: ast.Call) -> Row:
    given: dict[str, Any] = dict(zip(
        ('default', 'description', 'unit'), map(source.value, call.args), strict=False))
    given |= {each.arg: source.value(each.value) for each in call.keywords}
    given = {key: given[key] for key in Row.__annotations__ if key in given}
    return Row(**{'name': field, **given})


def _group(source: Source, field: str, members: ast.expr) -> Iterator[Row]:
    """Yield what a group's generator yields; STATE and NAME stand for what a system decides."""
    if not isinstance(members, ast.Name) or members.id == 'system_parameters':
        yield Row(f'{field}.NAME', None, 'constants of the system, and what it is built of')
        return
    source, function = source.definition(members.id)
    for node in ast.walk(function):
        match node:
            case ast.Call(func=ast.Name(id='Entry'), args=[name, default, description, *rest]):
                unit = rest[0].value if rest and isinstance(rest[0], ast.Constant) else ''
                bounds = {each.arg: source.value(each.value) for each in node.keywords}
                yield Row(f'{field}.{_pattern(name)}', source.value(default),
                          source.value(description), unit, **bounds)


def _pattern(name: ast.expr) -> str:
    match name:
        case ast.Constant(value=text):
            return str(text)
        case ast.JoinedStr(values=values):
            return ''.join(map(_pattern, values))
    return 'STATE'


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
        rows = parameters(self.root, TABLES[self.arguments[0]])
        return [table(('parameter', 'default', 'meaning'), (24, 16, 60), [
            (nodes.literal('', row.name), *_shown(row.default), nodes.Text(meaning(row)))
            for row in rows])]


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
    return text + ('; fixed at the start' if row.read_only else '')


def _shown(default: Any) -> tuple[nodes.Node]:
    if default is None:
        return (nodes.Text('of the system'),)
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
    for name, directive in (('interfaces', Interfaces), ('parameters', Parameters)):
        app.add_directive(name, type(directive.__name__, (directive,), {'root': root}))
    return {'parallel_read_safe': True}
