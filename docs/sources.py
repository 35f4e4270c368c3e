# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What the sources say of interfaces, parameters and modules.

Modules are parsed, not imported: there need be no ROS where the site is built.
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

PARTS = {'msg': ('',), 'srv': ('Request', 'Response'), 'action': ('Goal', 'Result', 'Feedback')}
# The module whose `Settings` are a node's parameters.
TABLES = {
    'estimator_node': 'obc_ros.nodes.estimator_settings',
    'lqr_node': 'obc_ros.nodes.lqr.settings',
    'mpc_node': 'obc_ros.nodes.mpc.settings',
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
    """A parameter; `default` and `choices` are Python values, the others as in `ParameterRow`."""

    name: str
    default: Any
    description: str
    unit: str = ''
    lower: float = -math.inf
    upper: float = math.inf
    choices: tuple[str, ...] = ()
    read_only: bool = False
    used_when: tuple[tuple[Any, ...], ...] = ()
    default_given: tuple[str, Any] | None = None


@dataclass(frozen=True)
class Member:
    """A public function or class of a module, and the first paragraph of its docstring."""

    kind: str
    name: str
    parameters: str
    summary: str


@dataclass(frozen=True)
class Module:
    """A module of the package, the first paragraph of its docstring, and its members."""

    name: str
    summary: str
    members: tuple[Member, ...]


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
            case ast.JoinedStr():
                return _pattern(node)
        return ast.literal_eval(node)  # type: ignore[arg-type] # an expression


def parameters(root: Path, module: str) -> list[Row]:
    """Return the rows of the dataclass `Settings` of a module, in order."""
    return list(_rows(*Source(root, module).definition('Settings')).values())


def _rows(source: Source, settings: ast.AST) -> dict[str, Row]:
    """Return the rows of a dataclass by name, after those that it inherits."""
    assert isinstance(settings, ast.ClassDef)
    rows: dict[str, Row] = {}
    for base in settings.bases:
        assert isinstance(base, ast.Name)
        rows |= _rows(*source.definition(base.id))
    for node in settings.body:
        match node:
            case ast.AnnAssign(target=ast.Name(id=name), value=ast.Call(
                    func=ast.Name(id='declare_field')) as call):
                rows[name] = _row(source, name, call)
            case ast.AnnAssign(target=ast.Name(id=name), value=ast.Call(
                    func=ast.Name(id='group'), args=[members])):
                rows |= {each.name: each for each in _group(source, name, members)}
    return rows


def _row(source: Source, field: str, call: ast.Call) -> Row:
    given: dict[str, Any] = dict(zip(
        ('default', 'description', 'unit'), map(source.value, call.args), strict=False))
    given |= {each.arg: source.value(each.value) for each in call.keywords
              if each.arg in Row.__annotations__}
    return Row(**{'name': field, **given})


def _group(source: Source, field: str, members: ast.expr) -> Iterator[Row]:
    """Yield what a group's generator yields; STATE and NAME stand for what a system decides."""
    if not isinstance(members, ast.Name) or members.id == 'list_system_parameters':
        yield Row(f'{field}.NAME', None, 'parameters and construction options of the system')
        return
    source, function = source.definition(members.id)
    for node in ast.walk(function):
        match node:
            case ast.Call(func=ast.Name(id='ParameterRow'),
                          args=[name, default, description, *rest]):
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


def modules(root: Path, folder: str) -> Iterator[Module]:
    """Yield the modules of a folder of the package that have public members, by their names."""
    for path in sorted((root / folder).rglob('*.py')):
        parts = path.relative_to(root).with_suffix('').parts
        tree = ast.parse(path.read_text(encoding='utf-8'))
        public = {node.name: node for node in tree.body  # the last of several is no overload
                  if isinstance(node, (ast.FunctionDef, ast.ClassDef))
                  and not node.name.startswith('_')}
        if members := tuple(map(_member, public.values())):
            yield Module('.'.join(part for part in parts if part != '__init__'), _summary(tree),
                         members)


def _member(node: ast.FunctionDef | ast.ClassDef) -> Member:
    if isinstance(node, ast.ClassDef):
        return Member('class', node.name, '', _summary(node))
    for each in ast.walk(node.args):
        if isinstance(each, ast.arg):
            each.annotation = None
    return Member('function', node.name, f'({ast.unparse(node.args)})', _summary(node))


def _summary(node: ast.Module | ast.FunctionDef | ast.ClassDef) -> str:
    return ' '.join((ast.get_docstring(node) or '').split('\n\n')[0].split())
