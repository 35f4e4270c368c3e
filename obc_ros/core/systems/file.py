# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Systems in YAML files.

A system file has the keys of a problem file. Keys of the task (costs, initial state, constraints,
final time) are ignored, so that a problem file is a system file too. docs/systems.md has the keys
that belong to a system only.
"""

from collections.abc import Mapping, Sequence
from functools import partial
import math
from pathlib import Path
from typing import Any

import casadi as ca
from obc_ros.core.systems.file_kinds import FileKind, refuse_others
from obc_ros.core.systems.system import define, Parameter, Signal, System
from obc_ros.core.text import expressions
from obc_ros.core.text.errors import (
    describe_type,
    Faults,
    ObcError,
    quote,
    restate,
    StatementError,
    suggest_name,
)
from obc_ros.core.text.expressions import check_name, parse_number
from obc_ros.core.text.fields import (
    check_keys,
    check_unique,
    Given,
    NamedValues,
    read_bounds,
    read_mapping,
    read_names,
    read_section,
)
from obc_ros.core.text.recorded_functions import record_function
from obc_ros.core.text.stated_functions import call_functions
from obc_ros.core.text.yaml_files import read_yaml

OF_A_PLANT = ('units', 'angles', 'setpoint', 'setpoint_input', 'parameter_bounds', 'plane',
              'description', 'outputs', 'ros')
PLANT_KEYS = ('name', 'states', 'inputs', 'parameters', 'dynamics', 'input_bounds', 'state_bounds',
         *OF_A_PLANT)
TASK = (
    'running_cost', 'terminal_cost', 'initial_cost', 'initial_state', 'initial_constraints',
    'terminal_constraints', 'boundary_constraints', 'periodic', 'path_constraints', 'final_time',
    'initial_guess', 'starts', 'method', 'accept', 'tables')
FOR_PEOPLE = ('title', 'source', 'tags', 'notes', 'difficulty', 'kind', 'expected')
PLANES = ('horizontal', 'vertical')

Values = Mapping[str, float]
Limits = dict[str, tuple[float, float]]


def load_system(path: str | Path) -> System:
    """
    Read a system from a YAML file.

    Limits and the set point may be expressions of the parameters, and a parameter may be an
    expression of earlier ones. They are evaluated again when a parameter changes.

    :raises StatementError: if the file cannot be read, a key is unknown, or a value is malformed.
        The message begins with the file and the key.
    """
    return _load(path)[0]


def load_plant(path: str | Path) -> dict[str, Any]:
    """Read the keys of a system, without those of a task, for `build_system` elsewhere."""
    system, given = _load(path)
    return {key: given[key] for key in PLANT_KEYS if key in given} | {'name': system.name}


def _load(path: str | Path) -> tuple[System, Given]:
    given = read_yaml(path)
    if isinstance(given, list) and len(given) == 1:
        given = given[0]
    try:
        if not isinstance(given, Mapping):
            raise StatementError(f'wanted one mapping of keys, found {describe_type(given)}')
        refuse_others(given, (FileKind.PROBLEM, FileKind.PLANT), path)
        return _system(given, Path(path).stem, {}), given
    except ObcError as error:
        raise restate(error, lambda line: f'{path}: {line}') from None


def build_system(statement: object) -> System:
    """Return the system of a mapping with the keys of a system file; see `stated_functions`."""
    return _system(read_mapping(statement, 'system'), 'system', {})


def build_plant(plant: Mapping[str, Any], parameters: Mapping[str, Any]) -> System:
    """
    Build the system of a file with parameters.

    :param plant: as `load_plant` returns it.
    :param parameters: by name: a number or an expression without names.
    :raises StatementError, DynamicsError: if a parameter is not valid.
    """
    return build_system(plant).with_parameters(evaluate_parameters(parameters))


def evaluate_parameters(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return given values of parameters as numbers; lists remain."""
    return {key: value if isinstance(value, list) else parse_number(
        value, {}, f'parameters.{quote(key)}') for key, value in parameters.items()}


def _system(given: Given, stem: str, chosen: Values) -> System:
    with Faults(given) as faults:
        faults.attempt(check_keys, given, PLANT_KEYS, TASK + FOR_PEOPLE)
        with Faults() as names:
            states = names.attempt(read_names, given, 'states')
            inputs = names.attempt(read_names, given, 'inputs')
        values = _parameters(given, (*states, *inputs), chosen, faults)
        outputs = faults.attempt(_outputs, given, states, (*inputs, *values)) or {}
        named = tuple(dict.fromkeys((*states, *inputs, *values, *outputs)))
        units = faults.attempt(_texts, given, 'units', named)
        angles = faults.attempt(
            _chosen, given, 'angles', tuple(dict.fromkeys((*states, *outputs))))
        ranges: Limits = faults.attempt(_bounds, given, 'parameter_bounds', tuple(values), values)
        x_limits: Limits = faults.attempt(_bounds, given, 'state_bounds', states, values)
        u_limits: Limits = faults.attempt(_bounds, given, 'input_bounds', inputs, values)
        setpoint = faults.attempt(_numbers, given, 'setpoint', states, values)
        setpoint_input = faults.attempt(_numbers, given, 'setpoint_input', inputs, values)
        name = faults.attempt(_text, given, 'name', stem)
        description = faults.attempt(
            lambda: _text(given, 'description', _text(given, 'title', '')))
        plane = faults.attempt(_plane, given)
        ros = faults.attempt(read_section, given, 'ros')
        if faults:   # `define` is not reached, which would call these
            symbols = [[ca.SX.sym(each) for each in some] for some in (states, inputs, values)]
            faults.attempt(_dynamics, given, {}, (states, inputs, tuple(values)), *symbols)
            faults.attempt(_measured, outputs, (*states, *inputs, *values), *symbols)
    kept = dict(given)   # without functions, which do not pickle
    return define(
        name,
        [Signal(name, units.get(name, ''), *x_limits[name], angle=name in angles)
         for name in states],
        [Signal(name, units.get(name, ''), *u_limits[name]) for name in inputs],
        [Parameter(name, value, units.get(name, ''), *ranges[name])
         for name, value in values.items()],
        partial(_dynamics, given, kept, (states, inputs, tuple(values))),
        setpoint=setpoint, setpoint_input=setpoint_input, description=description, plane=plane,
        rebuild=partial(_rebuild, kept, stem, chosen),
        outputs=[Signal(name, units.get(name, ''), angle=name in angles) for name in outputs],
        output_map=partial(_measured, outputs, (*states, *inputs, *values)), ros=ros)


def _dynamics(given: Given, kept: dict[Any, Any], names: tuple[Sequence[str], ...],
              x: list[ca.SX], u: list[ca.SX], p: list[ca.SX]) -> list[ca.SX]:
    """
    Return dx/dt for symbols of the states, inputs and parameters with some names.

    :param kept: takes the equations in place of a function.
    """
    by_name = [dict(zip(*each, strict=True)) for each in zip(names, (x, u, p), strict=True)]
    called = call_functions(given, ('dynamics',), by_name[0], by_name[1], by_name[2], None)
    symbols = by_name[0] | by_name[1] | by_name[2]
    with Faults() as faults:
        equations = _by_name(called, 'dynamics', names[0])
        for missing in (name for name in names[0] if name not in equations):
            faults.note(StatementError(f"dynamics: no equation for the state '{missing}'"))
        rows = [faults.attempt(
            expressions.parse_expression, equations[name], symbols, f'dynamics.{name}')
            for name in names[0] if name in equations]
    if callable(given.get('dynamics')):
        kept['dynamics'] = record_function(
            'dynamics', dict(zip(names[0], rows, strict=True)), symbols)
    return rows


def _measured(outputs: Mapping[str, Any], names: Sequence[str], x: list[ca.SX], u: list[ca.SX],
              p: list[ca.SX]) -> list[ca.SX]:
    """Return the outputs for symbols of the states, inputs and parameters."""
    symbols = dict(zip(names, (*x, *u, *p), strict=True))
    with Faults() as faults:
        return [faults.attempt(expressions.parse_expression, text, symbols, f'outputs.{name}')
                for name, text in outputs.items()]


def _rebuild(given: Given, stem: str, chosen: Values, new: Values) -> System:
    return _system(given, stem, {**chosen, **new})


def _outputs(given: Given, states: tuple[str, ...], taken: tuple[str, ...]) -> dict[str, Any]:
    """Return the outputs; the name of a state is that state's, and no other quantity's."""
    section = read_section(given, 'outputs')
    for name, text in section.items():
        check_name(name, 'outputs')
        if name in taken:
            raise StatementError(f"outputs: '{name}' is an input or a parameter; choose another "
                                 f"name, such as {name}_measured: {name}")
        if name in states and text != name:
            raise StatementError(f"outputs.{name}: '{name}' is a state; choose another name for "
                                 'another quantity')
    return dict(section)


def _by_name(given: Given, key: str, known: Sequence[str]) -> dict[str, Any]:
    """Return a section whose keys are known names; it may be absent or empty."""
    section = read_section(given, key)
    for name in section:
        if name not in known:
            raise StatementError(f"{key}: '{quote(str(name))}' is not one of {', '.join(known)}"
                                 f'{suggest_name(str(name), known)}')
    return dict(section)


def _parameters(given: Given, taken: tuple[str, ...], chosen: Values, faults: Faults
                ) -> NamedValues:
    section = read_section(given, 'parameters')
    check_unique((*taken, *(check_name(name, 'parameters') for name in section)),
                  'states, inputs and parameters')
    values = NamedValues()
    for name, text in section.items():
        values.read(name, chosen.get(name, text), faults)
    return values


def _numbers(given: Given, key: str, names: Sequence[str], values: Values) -> list[float]:
    with Faults() as faults:
        section = _by_name(given, key, names)
        return [faults.attempt(parse_number, section.get(name, 0.0), values, f'{key}.{name}')
                for name in names]


def _bounds(given: Given, key: str, names: Sequence[str],
            values: Values) -> Limits:
    with Faults() as faults:
        section = _by_name(given, key, names)
        return {name: (-math.inf, math.inf) if section.get(name) is None else faults.attempt(
            read_bounds, section[name], values, f'{key}.{name}') for name in names}


def _texts(given: Given, key: str, names: Sequence[str]) -> dict[str, str]:
    section = _by_name(given, key, names)
    for name, text in section.items():
        if not isinstance(text, str) or len(text) > 40:
            raise StatementError(f'{key}.{name}: wanted a short text, found {describe_type(text)}')
    return section


def _chosen(given: Given, key: str, names: Sequence[str]) -> tuple[str, ...]:
    chosen = given.get(key) or ()
    if not isinstance(chosen, Sequence) or isinstance(chosen, str):
        raise StatementError(f'{key}: wanted a list of states, found {describe_type(chosen)}')
    for name in chosen:
        if name not in names:
            raise StatementError(f"{key}: '{quote(str(name))}' is not one of {', '.join(names)}")
    return tuple(chosen)


def _text(given: Given, key: str, default: str) -> str:
    text = given.get(key, default)
    if not isinstance(text, str) or len(text) > 2000 or not text.isprintable():
        raise StatementError(f'{key}: wanted one line of text, found {describe_type(text)}')
    return text


def _plane(given: Given) -> str:
    plane = given.get('plane', '')
    if plane and plane not in PLANES:
        raise StatementError(
            f"plane: wanted 'horizontal' or 'vertical', found {describe_type(plane)}")
    return str(plane)
