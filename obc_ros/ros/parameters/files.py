# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Parameter files: which of their sections are for a node.

==================  =================================================================
section             nodes
==================  =================================================================
``lqr_node``        /lqr_node, as ``/lqr_node``
``/robot/lqr_node`` /robot/lqr_node; also written as a mapping in a mapping
``/**/lqr_node``    lqr_node in any namespace; ``/*/lqr_node``: in one of one name
``/**``             all nodes: it may have parameters that one of them does not have
==================  =================================================================
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
import re
from typing import Any

from obc_ros.core.text.errors import quote, StatementError
from obc_ros.core.text.yaml_files import read_yaml

_PARAMETERS = 'ros__parameters'


def has_section(file: str | Path, node: str) -> bool:
    """Return whether a file has a section for a node such as ``/robot/lqr_node``."""
    return any(_is_for(section, node) for section, _ in _list_sections(file))


def check_files(arguments: Sequence[str], node: str) -> frozenset[str]:
    """
    Check that each parameter file in the arguments of a process has a section for its node.

    :param arguments: of the process, with ``--ros-args``.
    :param node: fully qualified name of the node.
    :return: the parameters that only sections without the name of a node, such as ``/**``, give.
    :raises StatementError: if a file has no section for the node.
    """
    shared: set[str] = set()
    own = set(_list_arguments(arguments, ('-p', '--param')))
    own = {each.partition(':=')[0].rpartition(':')[2] for each in own}
    for file in _list_arguments(arguments, ('--params-file',)):
        sections = list(_list_sections(file))
        found = [each for each in sections if _is_for(each[0], node)]
        if not found:
            others = ', '.join(section for section, _ in sections) or 'no section'
            raise StatementError(f'{file} has no section for {node}; it has {quote(others, 300)}')
        for section, names in found:
            (shared if '*' in section.rpartition('/')[2] else own).update(names)
    return frozenset(shared - own)


def _list_arguments(arguments: Sequence[str], options: tuple[str, ...]) -> Iterator[str]:
    """Yield what follows options among the arguments for ROS."""
    is_ros = False
    for option, value in zip(arguments, [*arguments[1:], ''], strict=True):
        is_ros = option == '--ros-args' or (is_ros and option != '--')
        if is_ros and option in options:
            yield value


def _list_sections(file: str | Path) -> Iterator[tuple[str, set[str]]]:
    def walk(above: str, inner: Any) -> Iterator[tuple[str, set[str]]]:
        for key, value in inner.items() if isinstance(inner, Mapping) else ():
            if key == _PARAMETERS:
                yield above or '/', set(_list_names('', value))
            else:
                yield from walk(f'{above}/{str(key).strip("/")}', value)

    yield from walk('', read_yaml(file))


def _list_names(above: str, inner: Any) -> Iterator[str]:
    if not isinstance(inner, Mapping):
        yield above
        return
    for key, value in inner.items():
        yield from _list_names(f'{above}.{key}' if above else str(key), value)


def _is_for(section: str, node: str) -> bool:
    """Return whether a section is for a node, by the rules of ROS."""
    pattern = ''.join({'/**': r'(/\w+)*', '/*': r'/\w+'}.get(part, re.escape(part))
                      for part in re.findall('/[^/]*', section))
    return bool(re.fullmatch(pattern, node))
