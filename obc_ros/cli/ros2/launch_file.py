# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Read a launch file, and find the nodes that it starts.

The package `launch` is in no wheel. The classes that the launch files of this package use are
defined here, with the same names, arguments and methods.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
import importlib.util
import os
from pathlib import Path
import sys
from types import ModuleType
from typing import Any

from obc_ros.core.text.errors import ObcError, quote


@dataclass(frozen=True)
class Started:
    """A node that a launch file starts, with its parameters and environment variables."""

    package: str
    executable: str
    name: str
    namespace: str
    files: tuple[Path, ...]
    values: dict[str, Any]
    environment: dict[str, str]
    remappings: tuple[tuple[str, str], ...] = ()
    respawn: bool = False
    respawn_delay: float = 0.0


class LaunchContext(dict[str, str]):
    """The values of the arguments."""


class LaunchConfiguration:
    """The value of an argument."""

    def __init__(self, name: str) -> None:
        self._name = name

    def perform(self, context: Mapping[str, str]) -> str:
        """Return the value."""
        return context[self._name]


class EnvironmentVariable:
    """The value of an environment variable."""

    def __init__(self, name: str, *, default_value: str = '') -> None:
        self._name, self._default = name, default_value

    def perform(self, context: Mapping[str, str]) -> str:
        """Return the value."""
        return os.environ.get(self._name, self._default)


class IfCondition:
    """A condition that holds if a text is true."""

    def __init__(self, text: Any) -> None:
        self._text = text

    def evaluate(self, context: Mapping[str, str]) -> bool:
        """Return whether the condition holds."""
        return _truth(_perform(self._text, context))


class DeclareLaunchArgument:
    """An argument of the launch file."""

    def __init__(self, name: str, *, default_value: Any = None, description: str = '',
                 choices: Sequence[str] | None = None) -> None:
        self.name, self.default_value = name, default_value
        self.description, self.choices = description, choices

    def value(self, given: Mapping[str, str], context: Mapping[str, str]) -> str:
        """Return the given value, or else the default."""
        if self.name not in given and self.default_value is None:
            raise ObcError(f'{self.name}:= has no default: {self.description}')
        value = given[self.name] if self.name in given else _perform(self.default_value, context)
        if self.choices is not None and value not in self.choices:
            raise ObcError(f'Argument "{self.name}" provided value "{quote(value)}" is not valid. '
                           f'Valid options are: {self.choices}')
        return value


class SetEnvironmentVariable:
    """An environment variable for the nodes that are started after it."""

    def __init__(self, name: str, value: Any) -> None:
        self.name, self.value = name, value


class OpaqueFunction:
    """A function that returns entities for given arguments."""

    def __init__(self, *, function: Callable[[LaunchContext], Sequence[Any]]) -> None:
        self.function = function


class ParameterFile:
    """A file of parameters."""

    def __init__(self, path: Any) -> None:
        self.path = path


class ParameterValue:
    """The value of a parameter of a given type."""

    def __init__(self, value: Any, *, value_type: type) -> None:
        self._value, self._type = value, value_type

    def evaluate(self, context: Mapping[str, str]) -> Any:
        """Return the value."""
        text = _perform(self._value, context)
        return _truth(text) if self._type is bool else self._type(text)


@dataclass(frozen=True, kw_only=True)
class Node:
    """A node to start; `output` is always the screen."""

    package: str
    executable: str
    name: str
    namespace: Any = ''
    parameters: Sequence[Any] = ()
    remappings: Sequence[tuple[str, str]] | None = None
    output: str = 'screen'
    respawn: bool = False
    respawn_delay: float = 0.0
    condition: IfCondition | None = None

    def started(self, context: Mapping[str, str], variables: Mapping[str, str]) -> Started:
        """Return the node with the values of the arguments."""
        files, values = [], {}
        for each in self.parameters:
            if isinstance(each, ParameterFile):
                files.append(Path(_perform(each.path, context)))
            else:
                values.update({name: value.evaluate(context)
                               if isinstance(value, ParameterValue) else value
                               for name, value in each.items()})
        return Started(
            package=self.package, executable=self.executable, name=self.name,
            namespace=_perform(self.namespace, context), files=tuple(files), values=values,
            remappings=tuple(self.remappings or ()),
            environment=dict(variables), respawn=self.respawn, respawn_delay=self.respawn_delay)


class LaunchDescription:
    """The entities of a launch file, in order."""

    def __init__(self, entities: Sequence[Any]) -> None:
        self.entities = entities


MODULES: Mapping[str, tuple[type, ...]] = {
    'launch': (LaunchContext, LaunchDescription),
    'launch.actions': (DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable),
    'launch.conditions': (IfCondition,),
    'launch.substitutions': (EnvironmentVariable, LaunchConfiguration),
    'launch_ros': (),
    'launch_ros.actions': (Node,),
    'launch_ros.parameter_descriptions': (ParameterFile, ParameterValue),
}


class LaunchFile:
    """A launch file; ObcError if it uses a class of `launch` that is missing here."""

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise ObcError(f'there is no launch file {path}')
        with _imported():
            spec = importlib.util.spec_from_file_location('launch_file', path)
            if spec is None or spec.loader is None:
                raise ObcError(f'{path} is no launch file in Python')
            module = importlib.util.module_from_spec(spec)
            try:
                spec.loader.exec_module(module)
                self._entities: Sequence[Any] = module.generate_launch_description().entities
            except (ImportError, AttributeError, TypeError, SyntaxError) as error:
                raise ObcError(f'{path} is for `ros2 launch`: {error}') from error
        self.path = path
        self.arguments = tuple(
            each for each in self._entities if isinstance(each, DeclareLaunchArgument))

    def nodes(self, given: Mapping[str, str]) -> list[Started]:
        """Return the nodes that are started; ObcError if an argument or its value is invalid."""
        names = [each.name for each in self.arguments]
        for name in given:
            if name not in names:
                raise ObcError(f"{self.path.name} has no argument '{quote(name)}'; "
                               f'it has {", ".join(names)}')
        context, variables = LaunchContext(), dict[str, str]()
        try:
            return list(_nodes(self._entities, given, context, variables))
        except ObcError:
            raise
        except ValueError as error:
            raise ObcError(str(error)) from error


def _nodes(entities: Sequence[Any], given: Mapping[str, str], context: LaunchContext,
           variables: dict[str, str]) -> Iterator[Started]:
    """Yield the nodes of entities, which are evaluated in order."""
    for each in entities:
        if isinstance(each, DeclareLaunchArgument):
            context[each.name] = each.value(given, context)
        elif isinstance(each, SetEnvironmentVariable):
            variables[each.name] = _perform(each.value, context)
        elif isinstance(each, OpaqueFunction):
            yield from _nodes(each.function(context), given, context, variables)
        elif each.condition is None or each.condition.evaluate(context):
            yield each.started(context, variables)


def _perform(value: Any, context: Mapping[str, str]) -> str:
    """Return the text of a string, a substitution, or a list of both."""
    if isinstance(value, (list, tuple)):
        return ''.join(_perform(each, context) for each in value)
    return str(value.perform(context)) if hasattr(value, 'perform') else str(value)


def _truth(text: str) -> bool:
    """Return the truth value of true, false, 1 or 0."""
    if text.strip().lower() not in ('true', '1', 'false', '0'):
        raise ObcError(f"wanted 'true' or 'false', got '{quote(text)}'")
    return text.strip().lower() in ('true', '1')


@contextmanager
def _imported() -> Iterator[None]:
    """Let launch files import the classes of this module."""
    before = {name: sys.modules.get(name) for name in MODULES}
    for name, classes in MODULES.items():
        module = ModuleType(name)
        vars(module).update({each.__name__: each for each in classes}, __path__=[])
        sys.modules[name] = module
    try:
        yield
    finally:
        for name, module_before in before.items():
            if module_before is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module_before
