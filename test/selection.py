# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Which tests need ROS 2 and are left out where there is none.

These are the tests in `FOLDERS`, those in a file that imports ROS 2, itself or through other files
of the repository, and those that carry ``nodes`` or ``ros``. An import inside a function does not
count: a test that runs into one carries ``ros``.
"""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]
# In package.xml the names of ROS packages are those of modules; other names contain a hyphen.
ROS = {str(each.text) for each in ElementTree.parse(ROOT / 'package.xml').getroot()
       if each.tag.endswith('depend') and '-' not in str(each.text)}
GENERATED = tuple(f'obc_ros.{kind}' for kind in ('msg', 'srv', 'action'))
RECORDING = 'mcap'  # comes with ROS 2 only
FOLDERS = tuple(ROOT / 'test' / folder for folder in ('nodes', 'ros', 'cli/ros2'))
MARKERS = ('nodes', 'ros')


def needs_ros(path: Path) -> bool:
    """Return whether a file of tests needs ROS 2."""
    return any(path.is_relative_to(folder) for folder in FOLDERS) or imports_ros(path)


def imports_ros(path: Path) -> bool:
    """Return whether a Python file imports ROS 2, itself or through files of the repository."""
    return any(map(_is_ros, list_reached(path)))


def list_reached(path: Path) -> set[str]:
    """Return what a Python file imports, itself or through files of the repository."""
    reached: set[str] = set()
    seen: set[Path] = set()
    waiting = [path]
    while waiting:
        file = waiting.pop()
        if file not in seen:
            seen.add(file)
            reached.update(list_imports(file))
            waiting += [found for module in list_imports(file) for found in _files(module)]
    return reached


def _is_ros(module: str) -> bool:
    """Return whether a module comes with ROS 2."""
    return module.split('.')[0] in {*ROS, RECORDING} or any(
        module == kind or module.startswith(f'{kind}.') for kind in GENERATED)


@cache
def list_imports(path: Path) -> tuple[str, ...]:
    """
    Return the modules, or names in modules, that a file imports when it is imported.

    Those that it imports on some systems only do not count.
    """
    return tuple(_walk(ast.parse(path.read_text(encoding='utf-8'))))


def _walk(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        yield from (f'{node.module}.{alias.name}' for alias in node.names)
    elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not (
            isinstance(node, ast.If) and 'sys.platform' in ast.unparse(node.test)):
        for child in ast.iter_child_nodes(node):
            yield from _walk(child)


@cache
def _files(module: str) -> tuple[Path, ...]:
    """Return the files that are imported with a module, or with a name in a module."""
    parts = module.split('.')
    if parts[0] == 'obc_ros':
        places = [ROOT.joinpath(*parts[:length]) for length in range(1, len(parts) + 1)]
        paths = [path for place in places
                 for path in (place / '__init__.py', place.with_suffix('.py'))]
    else:
        paths = [ROOT / folder / f'{parts[0]}.py' for folder in ('test', 'benchmarks')]
    return tuple(filter(Path.is_file, paths))
