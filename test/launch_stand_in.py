# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What launch files import, as far as those of this package use it: launch is in no wheel.

A launch file is read with it to the nodes that it describes; see `launched`.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
import importlib.util
import os
from pathlib import Path
import sys
from types import ModuleType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Started:
    """A node that a launch file starts: files and values of its parameters, what is set for it."""

    executable: str
    name: str
    namespace: str
    files: tuple[Path, ...]
    values: dict[str, Any]
    environment: dict[str, str]
    respawn: bool


class _Given:
    """Whatever is called with arguments, and keeps them."""

    def __init__(self, *args: Any, **named: Any) -> None:
        self.args, self.named = args, named

    def perform(self, context: Mapping[str, str]) -> str:
        """Return the text that it stands for."""
        if type(self).__name__ == 'EnvironmentVariable':
            return os.environ.get(self.args[0], str(self.named['default_value']))
        return context[self.args[0]]

    def evaluate(self, context: Mapping[str, str]) -> bool:
        """Return whether an IfCondition holds."""
        text = self.args[0].perform(context).strip().lower()
        if text not in ('true', '1', 'false', '0'):
            raise ValueError(f"wanted 'true' or 'false', got '{text}'")
        return text in ('true', '1')


def arguments_of(file: str) -> tuple[Any, ...]:
    """Return the table of the arguments of a launch file: name, default, text, choices if any."""
    with _imported():
        return tuple(_module(file).ARGUMENTS)


def nodes(file: str, **arguments: str) -> list[Started]:
    """Return the nodes that a launch file of this package starts with some arguments."""
    with _imported() as made:
        entities = _module(file).generate_launch_description().args[0]
    context: dict[str, str] = {}
    variables: dict[str, str] = {}
    found: list[Started] = []
    for each in entities:
        kind = made[type(each)]
        if kind == 'DeclareLaunchArgument':
            name = each.args[0]
            context[name] = arguments.get(name) or _text(each.named['default_value'], context)
            choices = each.named['choices']
            if choices is not None and context[name] not in choices:
                raise ValueError(f'Argument "{name}" provided value "{context[name]}" is not '
                                 f'valid. Valid options are: {choices}')
        elif kind == 'SetEnvironmentVariable':
            variables[each.args[0]] = each.args[1].perform(context)
        elif kind == 'OpaqueFunction':
            found += [_started(node, context, variables)
                      for node in each.named['function'](context)]
    assert set(arguments) <= set(context), f'{file} takes {sorted(context)}'
    return found


def _module(file: str) -> Any:
    spec = importlib.util.spec_from_file_location('launch_file', ROOT / 'launch' / file)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _started(node: _Given, context: Mapping[str, str], variables: dict[str, str]) -> Started:
    files, values = [], {}
    for each in node.named['parameters']:
        if isinstance(each, dict):
            values.update({name: _value(value, context) for name, value in each.items()})
        else:
            files.append(Path(_text(each.args[0], context)))
    return Started(
        node.named['executable'], node.named['name'], _text(node.named['namespace'], context),
        tuple(files), values, variables, node.named['respawn'])


def _text(value: Any, context: Mapping[str, str]) -> str:
    """Return the text of a string, a substitution, or a list of both."""
    if isinstance(value, list):
        return ''.join(_text(each, context) for each in value)
    return value if isinstance(value, str) else str(value.perform(context))


def _value(value: Any, context: Mapping[str, str]) -> Any:
    if not isinstance(value, _Given):
        return value
    text, wanted = value.args[0].perform(context), value.named['value_type']
    return text == 'true' if wanted is bool else wanted(text)


@contextmanager
def _imported() -> Iterator[dict[type, str]]:
    """Let the modules of launch be imported; yields what each class stands for."""
    made: dict[type, str] = {}

    def get(name: str) -> type:
        if name.startswith('__'):
            raise AttributeError(name)
        found = next((each for each, called in made.items() if called == name), None)
        if found is None:
            found = type(name, (_Given,), {})
            made[found] = name
        return found

    names = ('launch', 'launch.actions', 'launch.conditions', 'launch.substitutions', 'launch_ros',
             'launch_ros.actions', 'launch_ros.parameter_descriptions', 'launch_ros.substitutions')
    before = {name: sys.modules.get(name) for name in names}
    for name in names:
        module = ModuleType(name)
        module.__getattr__ = get  # type: ignore[method-assign] # PEP 562
        module.__path__ = []
        sys.modules[name] = module
    try:
        yield made
    finally:
        for name, module_before in before.items():
            if module_before is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module_before
