# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Systems by name: those of the book, those of other packages and those in files.

Another package registers a system by an entry point (docs/systems.md), a callable that returns a
`System`, or an object that has one as its `model`.
"""

from collections.abc import Callable, Mapping
from importlib import metadata
import inspect
from pathlib import Path
from typing import Any

from obc_ros.core.systems import textbook, vehicles
from obc_ros.core.systems.file import evaluate_parameters, load_system
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import DynamicsError, ObcError, quote, suggest_name

__all__ = ['find_registered', 'get_options', 'get_registered', 'get_system', 'is_file',
           'list_systems', 'load_system']

GROUP = 'obc_ros.systems'

_OWN: dict[str, Callable[..., System]] = {
    'aircraft': vehicles.define_aircraft,
    'vehicle': vehicles.define_vehicle,
    'vehicle_lateral': vehicles.define_lateral,
    'two_wheeled': vehicles.define_two_wheeled,
    'double_integrator': textbook.define_double_integrator,
    'scalar': textbook.define_scalar,
    'cubic': textbook.define_cubic,
    'nonholonomic_integrator': textbook.build_nonholonomic_integrator,
    'brockett': textbook.define_brockett,
    'linear': textbook.define_linear,
}
# Errors that code of another package may raise; the message quotes their type and text.
_FAULTS = (ArithmeticError, AssertionError, AttributeError, ImportError, LookupError, NameError,
           OSError, RuntimeError, SyntaxError, TypeError, ValueError)


def list_systems() -> tuple[str, ...]:
    """Return the names of all registered systems; no other package is imported."""
    return (*_OWN, *sorted(set(_entry_points()) - set(_OWN)))


def get_system(name: str, parameters: Mapping[str, Any] | None = None, **options: Any) -> System:
    """
    Return a system by its registered name or by the path of its YAML file.

    :param name: a name that ends in ``.yaml`` or ``.yml`` is a path; see `load_system`. Use
        `get_registered` for a name in a request: a client must not be able to read files.
    :param parameters: values of parameters other than the defaults; it may contain options too.
    """
    if not is_file(name):
        return get_registered(name, parameters, **options)
    if options:
        raise DynamicsError(f"{name}: a file has no option '{next(iter(options))}'")
    return load_system(name).with_parameters(parameters or {})


def get_registered(name: str, parameters: Mapping[str, Any] | None = None,
                   **options: Any) -> System:
    """Return a system by its registered name, as `get_system` but never from a file."""
    factory = _factory(name)
    known = inspect.signature(factory).parameters
    unknown = [option for option in options if option not in known]
    if unknown:
        raise DynamicsError(f"{name} has no option '{unknown[0]}'")
    given = dict(parameters or {})
    chosen = {option: given.pop(option) for option in known if option in given}
    try:
        system = factory(**chosen, **options)
    except ObcError:
        raise
    except _FAULTS as error:
        raise DynamicsError(f"system '{name}' cannot be built: {_words(error)}") from error
    system = getattr(system, 'model', system)   # that of the public interface has one
    if not isinstance(system, System):
        raise DynamicsError(f"system '{name}' cannot be built: its entry point returned an "
                            f'object of type {type(system).__name__}, not a System')
    return system.with_parameters(given)


def find_registered(name: str, parameters: Mapping[str, Any]) -> System:
    """
    Build a registered system with parameters.

    :param name: registered name, not that of a file.
    :param parameters: by name: a number or an expression without names; for an option also a list
        of rows.
    :raises StatementError, DynamicsError: if the name is not registered, or a parameter is not
        valid.
    """
    return get_registered(name, {
        key: int(value) if isinstance(value, float) and value.is_integer() else value
        for key, value in evaluate_parameters(parameters).items()})


def get_options(name: str) -> dict[str, Any]:
    """Return the arguments that define a system, with their defaults; none for a file."""
    if is_file(name):
        return {}
    return {option.name: option.default
            for option in inspect.signature(_factory(name)).parameters.values()}


def is_file(name: str) -> bool:
    """Return whether a system's name is the path of a file."""
    return Path(name).suffix in ('.yaml', '.yml')


def _entry_points() -> dict[str, metadata.EntryPoint]:
    return {each.name: each for each in metadata.entry_points(group=GROUP)}


def _factory(name: str) -> Callable[..., System]:
    if name in _OWN:
        return _OWN[name]
    others = _entry_points()
    if name not in others:
        known = (*_OWN, *sorted(others))
        raise DynamicsError(f"unknown system '{quote(name)}'{suggest_name(name, known)}; known "
                            f"systems: {', '.join(known)} (or the path of a YAML file, except in "
                            'a request)')
    entry = others[name]
    try:
        factory = entry.load()
    except _FAULTS as error:
        raise DynamicsError(f"system '{name}' cannot be loaded from {entry.value}"
                            f'{_origin(entry)}: {_words(error)}') from error
    if not callable(factory):
        raise DynamicsError(f"system '{name}': {entry.value}{_origin(entry)} is of type "
                            f'{type(factory).__name__}, not a function that returns a System')
    made: Callable[..., System] = factory
    return made


def _origin(entry: metadata.EntryPoint) -> str:
    return f' of {entry.dist.name}' if entry.dist else ''


def _words(error: BaseException) -> str:
    return f'{type(error).__name__}: {error}'
