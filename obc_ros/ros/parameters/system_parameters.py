# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The parameters of a node's system, and the system that they choose."""

from collections.abc import Iterator, Mapping
from typing import Any

from obc_ros.core.systems import registry
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import DynamicsError
from obc_ros.ros.parameters.table import ParameterRow

SYSTEM_PARAMETERS = 'system_parameters.'   # begins their names


def list_system_parameters(values: Mapping[str, Any]) -> Iterator[ParameterRow]:
    """
    Yield the parameters and construction options of a system, for `parameters.table.group`.

    :param values: with the name of the system under ``system``.
    :yield: named without a prefix.
    :raises ObcError: if there is no such system.
    """
    name = str(values['system'])
    options = registry.get_options(name)
    for option, default in options.items():
        yield ParameterRow(
            name=option,
            default=tuple(default) if isinstance(default, (tuple, list)) else default,
            description=f'construction option of {name}')
    try:
        system = registry.get_system(name)
    except DynamicsError:
        if not options:
            raise
        return  # the system needs values of its options
    for each in system.parameters:
        yield ParameterRow(
            name=each.name, default=each.value, description=each.description, unit=each.unit,
            lower=each.lower, upper=each.upper)


def choose_system(name: str, values: Mapping[str, Any]) -> System:
    """
    Return a system with given values of parameters and options.

    Only values that differ from the declared ones are passed on: a default that a system file
    gives as an expression of other parameters follows these.

    :raises ObcError: if there is no such system, or a value is invalid.
    """
    declared = {entry.name: entry.default for entry in list_system_parameters({'system': name})}
    return registry.get_system(name, {key: value for key, value in values.items()
                                      if value != declared.get(key)})


def choose_node_system(values: Mapping[str, Any]) -> System:
    """Return the system of a node, chosen by its parameters by name; ObcError: there is none."""
    return choose_system(str(values['system']), {
        name.removeprefix(SYSTEM_PARAMETERS): value for name, value in values.items()
        if name.startswith(SYSTEM_PARAMETERS)})
