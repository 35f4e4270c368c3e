# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Measure the layout of the package: folders, imports, names (`make house`).

The rules are those of docs/development/architecture.md. Imports are read from the syntax trees,
those inside functions and under TYPE_CHECKING included. Nothing is imported but Python's own
library.
"""

import ast
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
import sys

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = 'obc_ros'
# From the top. A room imports from the rows below it and from the other rooms of its row.
ROWS = (('book', 'view'), ('cli', 'nodes'), ('ros',), ('api',), ('sweep',), ('workers',),
        ('core.receding', 'core.tasks'), ('core.solver',),
        ('core.closed_loop', 'core.simulation', 'core.estimation', 'core.lqr', 'core.riccati',
         'core.ocp'),
        ('core.systems',), ('core.numerics',), ('core.text',))
ROOMS = tuple(room for row in ROWS for room in row)
CERTIFICATE = 'core.ocp.certificate'
UNDER_CERTIFICATE = ('core.ocp', 'core.numerics')   # all that the certificate imports
# Where start-up is waited for: rclpy, CasADi and matplotlib load when needed.
LAZY = ('book', 'view', 'cli', 'nodes', 'api')
DISPATCHER = 'cli.obc'   # it names the commands above it
CONSTANT = 'core.solver'   # where an object is changed by itself only
MOST = 12   # files of a folder, without `__init__` and the folders in it
# Public names that several modules define because others look for them by that name.
SHARED_NAMES = {
    'add_arguments': ('book', 'view', 'cli'),   # of a subcommand
    'run': ('book', 'view', 'cli'),             # of a subcommand
    'main': ('cli', 'nodes', 'workers'),   # of an executable
    'answer': ('sweep', 'workers'),   # of a module that a pool's workers import
    'Settings': ('nodes',),      # the parameters of a node; docs/sources.py reads them
    'system': ('core.systems',),   # of a module with one registered system
    # Names of the public interface, which wrap what has this name below.
    **dict.fromkeys(('Problem', 'System', 'solve', 'certify', 'lqr', 'dlqr', 'lqe', 'dlqe',
                     'minimize'),
                    ('api',)),
}
# Names of modules that say nothing to a reader who knows the field.
RETIRED = (
    'ways', 'rollouts', 'lengthening', 'natural', 'uneven', 'scarce', 'nearest', 'undefined',
    'settling', 'bangs', 'jumps', 'aligned', 'stages', 'blocks', 'pieces', 'orders', 'limits',
    'extremal', 'refine', 'shadowing', 'kit', 'familiar', 'horizons', 'conserved', 'bent',
    'outgrown', 'ill_posed', 'sweeps', 'contacts', 'branches', 'saddles', 'spread', 'stretches',
    'crowds', 'guards', 'desk', 'pilot', 'questions', 'cases', 'parts', 'unreachable')

Edges = Counter[tuple[str, str]]


@dataclass(frozen=True)
class Import:
    """One module that another one imports; names without `obc_ros.`."""

    source: str
    target: str
    where: str   # '', 'function', 'TYPE_CHECKING', or 'text': by its name

    def __str__(self) -> str:
        """Return the import in words."""
        place = {'': '', 'function': ' (in a function)', 'text': ' (by its name)'}.get(
            self.where, f' (under {self.where})')
        return f'{self.source} imports {self.target}{place}'


@dataclass(frozen=True)
class House:
    """
    The modules of the package and what they import of it.

    Attributes
    ----------
    modules : dict
        The file of each module, by its name without `obc_ros.`; a folder is its `__init__.py`.
    trees : dict
        The syntax tree of each module.
    imports : tuple of Import
        Sorted; every pair of modules and place once.

    """

    modules: dict[str, Path]
    trees: dict[str, ast.Module]
    imports: tuple[Import, ...]

    @cached_property
    def files(self) -> dict[str, list[str]]:
        """Return the modules of each folder, `__init__` not counted."""
        found = defaultdict(list)
        for name in self.modules:
            if not self.is_folder(name):
                found[self.folder(name)].append(name)
        return dict(found)

    @cached_property
    def sentences(self) -> dict[str, str]:
        """Return the first line of the docstring of each folder."""
        return {name: (ast.get_docstring(self.trees[name]) or '').partition('\n')[0]
                for name in self.modules if self.is_folder(name)}

    def is_folder(self, name: str) -> bool:
        """Return whether a module is a folder."""
        return self.modules[name].name == '__init__.py'

    def folder(self, name: str) -> str:
        """Return the folder of a module; of a folder itself."""
        return name if self.is_folder(name) else name.rpartition('.')[0]

    def edges(self, group: Callable[[str], str | None]) -> Edges:
        """Return how many imports lead from one group of folders to another."""
        pairs = ((group(self.folder(each.source)), group(self.folder(each.target)))
                 for each in self.imports)
        return Counter((a, b) for a, b in pairs if a and b and a != b)


def read_house(root: Path = ROOT) -> House:
    """Read all modules of the package below `root`."""
    base = root / PACKAGE
    modules = {}
    for path in sorted(base.rglob('*.py')):
        parts = path.relative_to(base).with_suffix('').parts
        modules['.'.join(parts[:-1] if parts[-1] == '__init__' else parts)] = path
    modules.pop('', None)
    trees = {name: ast.parse(path.read_text(encoding='utf-8')) for name, path in modules.items()}
    imports = {each for name, tree in trees.items() for each in _imports(name, tree, modules)}
    return House(modules, trees, tuple(sorted(
        imports, key=lambda each: (each.source, each.target, each.where))))


def room(name: str) -> str | None:
    """Return the room that a module or folder is in."""
    return next((each for each in ROOMS if within(name, each)), None)


def row(name: str) -> int | None:
    """Return the row of a room, 0 at the top."""
    return next((index for index, rooms in enumerate(ROWS) if room(name) in rooms), None)


def within(name: str, folder: str) -> bool:
    """Return whether a module is a folder or in it."""
    return name == folder or name.startswith(f'{folder}.')


def part_ways(one: str, other: str) -> tuple[str, str]:
    """Return the two of one folder that two modules are or are in."""
    first, second = one.split('.'), other.split('.')
    same = next((k for k, pair in enumerate(zip(first, second, strict=False))
                 if pair[0] != pair[1]), min(len(first), len(second)))
    return '.'.join(first[:same + 1]), '.'.join(second[:same + 1])


def _imports(name: str, tree: ast.Module, modules: dict[str, Path]) -> Iterator[Import]:
    waiting: list[tuple[ast.AST, str]] = [(tree, '')]
    while waiting:
        node, where = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            where = where or 'function'
        elif isinstance(node, ast.If) and 'TYPE_CHECKING' in ast.unparse(node.test):
            where = 'TYPE_CHECKING'
        for full in _targets(node):
            target = full.removeprefix(f'{PACKAGE}.')
            while target and target not in modules:
                target = target.rpartition('.')[0]
            if target and target != name:
                yield Import(name, target, where)
        waiting += [(child, where)
                    for field in ('body', 'orelse', 'finalbody', 'handlers', 'cases')
                    for child in getattr(node, field, ())
                    if isinstance(child, ast.stmt | ast.ExceptHandler | ast.match_case)]
    texts = {node.value for node in ast.walk(tree)
             if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    yield from (Import(name, target, 'text') for target in modules
                if f'{PACKAGE}.{target}' in texts and name != DISPATCHER)


def _targets(node: ast.AST) -> list[str]:
    """Return the names, of modules or of what is in them, that a statement imports."""
    if isinstance(node, ast.Import):
        names = [alias.name for alias in node.names]
    elif isinstance(node, ast.ImportFrom):
        if node.level:
            raise ValueError(f'line {node.lineno}: relative imports are not read')
        names = [f'{node.module}.{alias.name}' for alias in node.names]
    else:
        names = []
    return [each for each in names if each.startswith(f'{PACKAGE}.')]


# The rules: each returns the cases that break it, in words


def find_module_circles(house: House) -> list[str]:
    """Return the circles of modules."""
    return [' <-> '.join(part) for part in find_circles(
        (each.source, each.target) for each in house.imports)]


def find_folder_circles(house: House) -> list[str]:
    """Return the circles between what lies in one folder, files and folders alike."""
    return [' <-> '.join(part) for part in find_circles(
        part_ways(each.source, each.target) for each in house.imports
        if not (within(each.source, each.target) or within(each.target, each.source)))]


def find_upward(house: House) -> list[str]:
    """Return the imports that do not point down the rows."""
    return [str(each) for each in house.imports if not _points_down(each)]


def find_type_checking(house: House) -> list[str]:
    """Return the imports under TYPE_CHECKING: they hide circles."""
    return [str(each) for each in house.imports if each.where == 'TYPE_CHECKING']


def find_hidden(house: House) -> list[str]:
    """Return the imports inside functions, where these save no time."""
    return [str(each) for each in house.imports if each.where == 'function' and not any(
        within(each.source, folder) for folder in LAZY)]


def find_large(house: House) -> list[str]:
    """Return the folders with too many files."""
    return [f'{folder or PACKAGE} has {len(files)} files' for folder, files in
            sorted(house.files.items()) if len(files) > MOST]


def find_silent(house: House) -> list[str]:
    """Return the folders that do not say in a sentence what they are."""
    folders = set(house.sentences) | set(house.files)
    return sorted(folder or PACKAGE for folder in folders
                  if not house.sentences.get(folder, '').endswith('.'))


def find_ambiguous(house: House) -> list[str]:
    """Return the public names that more than one module defines."""
    where = defaultdict(list)
    for module, tree in house.trees.items():
        for name in set(_public(tree)):   # overloads are one
            if not any(within(module, folder) for folder in SHARED_NAMES.get(name, ())):
                where[name].append(module)
    used = _used(house)
    return [f'{name}: {", ".join(modules)}' for name, modules in sorted(where.items())
            if len(modules) > 1 and (not name.isupper() or any(
                (module, name) in used for module in modules))]


def find_retired(house: House) -> list[str]:
    """Return the modules whose names are not the field's."""
    return [name for name in house.modules if name.rpartition('.')[2] in RETIRED]


def find_changed(house: House) -> list[str]:
    """Return the places in the solver that set an attribute of another object."""
    return [f'{module}:{node.lineno} {ast.unparse(node)}'
            for module, tree in house.trees.items() if within(module, CONSTANT)
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)
            and not (isinstance(node.value, ast.Name) and node.value.id == 'self')]


RULES: dict[str, Callable[[House], list[str]]] = {
    'circles of modules': find_module_circles,
    'circles of folders': find_folder_circles,
    'imports upwards': find_upward,
    'imports under TYPE_CHECKING': find_type_checking,
    f'imports inside functions, outside {", ".join(LAZY)}': find_hidden,
    f'folders with more than {MOST} files': find_large,
    'folders without a sentence': find_silent,
    'public names with two meanings': find_ambiguous,
    'modules with a name that is not of the field': find_retired,
    'attributes of another object set in the solver': find_changed,
}


def _points_down(each: Import) -> bool:
    if within(each.source, CERTIFICATE):
        return any(within(each.target, folder) for folder in UNDER_CERTIFICATE)
    source, target = row(each.source), row(each.target)
    return source is not None and target is not None and source <= target


def _public(tree: ast.Module) -> Iterator[str]:
    """Yield the names that a module defines, without those that begin with `_`."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names = [node.name]
        elif isinstance(node, ast.Assign):
            names = [each.id for each in node.targets if isinstance(each, ast.Name)]
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names = [node.target.id]
        else:
            names = []
        yield from (name for name in names if not name.startswith('_'))


def _used(house: House) -> set[tuple[str, str]]:
    """Return (module, name) of what modules import by name or take from an imported module."""
    found = set()
    for tree in house.trees.values():
        known: dict[str, str] = {}   # local name -> module
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                module = node.module.removeprefix(f'{PACKAGE}.')
                for alias in node.names:
                    found.add((module, alias.name))
                    known[alias.asname or alias.name] = f'{module}.{alias.name}'
        found |= {(known[node.value.id], node.attr) for node in ast.walk(tree) if isinstance(
            node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in known}
    return found


def find_circles(edges: Iterable[tuple[str, str]]) -> list[list[str]]:
    """Return the strongly connected parts of a graph that have more than one node (Tarjan)."""
    graph = defaultdict(set)
    for source, target in edges:
        graph[source].add(target)
    order: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found = []

    def visit(node: str) -> None:
        order[node] = low[node] = len(order)
        stack.append(node)
        for other in sorted(graph.get(node, ())):
            if other not in order:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], order[other])
        if low[node] == order[node]:
            part: list[str] = []
            while not part or part[-1] != node:
                part.append(stack.pop())
            if len(part) > 1:
                found.append(sorted(part))

    for node in sorted(graph):
        if node not in order:
            visit(node)
    return found


def main(root: Path = ROOT) -> int:
    """Print the measures; return 1 where a rule is broken, else 0."""
    house = read_house(root)
    for folder, files in sorted(house.files.items()):
        print(f'{len(files):3}  {folder or PACKAGE:28} {house.sentences.get(folder, "")}')
    largest = max(house.files, key=lambda folder: len(house.files[folder]))
    print(f'\n{sum(map(len, house.files.values()))} files in {len(house.files)} folders; '
          f'the largest is {largest} with {len(house.files[largest])}')
    broken = {rule: find(house) for rule, find in RULES.items()}
    for rule, cases in broken.items():
        print(f'{rule}: {len(cases)}')
        for case in cases:
            print(f'    {case}')
    return 1 if any(broken.values()) else 0


if __name__ == '__main__':
    sys.exit(main(*map(Path, sys.argv[1:2])))
