# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Conversion of a statement, from a file or a request, to a valid Problem.

An error names the key, what was found and what is wanted. All errors that do not follow from
others are raised together. A valid statement of a problem without a solution is accepted.

The module is long because each key of a statement has its own check and message.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
import hashlib
import math
from pathlib import Path
import re
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.augmentation import Augmentation
from obc_ros.core.ocp.data_tables import DataTables, read_tables
from obc_ros.core.ocp.guess import Guess
from obc_ros.core.ocp.method_names import get_accepted, get_method
from obc_ros.core.ocp.phases import state_as_one_phase, state_each_phase
from obc_ros.core.ocp.problem import FinalTime, FreeStart, Problem
from obc_ros.core.systems import registry
from obc_ros.core.systems.file import FOR_PEOPLE, OF_A_PLANT
from obc_ros.core.systems.file_kinds import FileKind, refuse_others
from obc_ros.core.systems.system import System
from obc_ros.core.text import expressions
from obc_ros.core.text.comparisons import state_comparisons
from obc_ros.core.text.errors import (
    DependentError,
    describe_type,
    Faults,
    ObcError,
    quote,
    restate,
    StatementError,
    suggest_name,
)
from obc_ros.core.text.expressions import check_name, Names, parse_number
from obc_ros.core.text.fields import (
    check_keys,
    evaluate_limits,
    Given,
    list_of,
    NamedValues,
    read_bounds,
    read_list,
    read_mapping,
    read_names,
    read_section,
    suggest_line,
    UnknownValues,
)
from obc_ros.core.text.recorded_functions import record_function, RecordedFunction
from obc_ros.core.text.stated_functions import (
    call_functions,
    STATED_FUNCTIONS,
)
from obc_ros.core.text.yaml_files import read_entries

FOR_THE_SOLVER = (
    'name', 'system', 'states', 'inputs', 'parameters', 'free_parameters', 'tables', 'dynamics',
    'running_cost', 'terminal_cost', 'initial_cost', 'initial_state', 'initial_constraints',
    'terminal_constraints', 'boundary_constraints', 'periodic', 'input_bounds', 'state_bounds',
    'path_constraints', 'final_time', 'phases', 'initial_guess', 'starts', 'method', 'accept')

HELD = '(none)'   # the input of a problem without inputs, which is 0; users have no such name
FIRST = '_0'   # ends the name of x(0) in boundary_constraints
END = 'T'   # name of the final time in expressions, unless the statement gives it another meaning
TIME = 't'   # name of the time in expressions, unless the statement gives it another meaning

MAX_TEXT = 200_000     # characters of all expressions together
MAX_VALUES = 10_000    # values of a guess
LONGEST_UNIT = 40      # characters

_Symbols = dict[str, ca.SX]
_Margin = tuple[ca.SX, float, float]   # the value of an expression at an end, and its bounds


@dataclass(frozen=True)
class _Plant:
    """The system of a statement: names, symbols, numbers and dx/dt."""

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    angles: tuple[bool, ...]
    x: dict[str, ca.SX]
    u: dict[str, ca.SX]
    p: dict[str, ca.SX]
    values: dict[str, float]
    f: ca.SX
    u_lower: Array
    u_upper: Array
    free: dict[str, ca.SX]
    time: ca.SX | None
    tables: DataTables
    end: ca.SX | None = field(default_factory=lambda: ca.SX.sym(END))
    units: dict[str, str] = field(default_factory=dict)

    @property
    def arguments(self) -> tuple[dict[str, ca.SX], dict[str, ca.SX], dict[str, ca.SX],
                                 ca.SX | None]:
        """Return the symbols that functions of the statement are called with."""
        return self.x, self.u, self.p | self.free, self.time

    @property
    def known(self) -> Names:
        return _name_symbols(self.tables, self.x, self.u, self.p, self.free, self.time, self.end)


def _name_symbols(tables: DataTables, x: _Symbols, u: _Symbols, p: _Symbols, free: _Symbols,
                  time: ca.SX | None, end: ca.SX | None) -> Names:
    """Return what expressions may contain; a name of the statement hides t and T."""
    found = Names(x | u | p | free | ({} if time is None else {TIME: time}))
    if end is not None:
        found.setdefault(END, end)
    found.functions = tables.functions
    return found


def build_problem(mapping: object) -> Problem:
    """
    Build a problem from a mapping with the keys of a problem file.

    :param mapping: a mapping of keys to values; see docs/problems.md. Keys that only a plant file
        has, such as angles, are ignored, so that one file can be both. Dynamics, costs and
        constraints may be Python functions (`stated_functions`), and `system` may be a System.
    :return: parameters are symbols, and so are the numbers in terminal constraints (except
        exponents), which follow the named parameters in `p`. Hence problems that differ only in
        parameters, initial state, goal, bounds or final time have the same `structure`.
    """
    given = read_mapping(mapping, 'problem')
    with Faults(given) as faults:
        faults.attempt(check_keys, given, FOR_THE_SOLVER, OF_A_PLANT + FOR_PEOPLE)
        units = faults.attempt(_read_units, given)
        problem: Problem = faults.attempt(_build_stated, given)
    return replace(problem, units={**problem.units, **units})


def _build_stated(given: Given) -> Problem:
    """Build a problem with or without phases."""
    given = state_comparisons(given)
    if given.get('phases') is None:
        problem = _build_problem(_state_short_forms(given))
        given = problem.statement
    else:
        given = name_initial_state(given, read_names(given, 'states'))
        problem = _build_with_phases(given)
    return replace(problem, statement=name_initial_state(given, problem.shown_states))


def _state_short_forms(given: Given) -> dict[Any, Any]:
    """
    Return a statement without phases in the form that the rest of the package reads.

    A final time that is a number is given. Constraints at the end in which initial values occur
    are boundary constraints.
    """
    found, value = dict(given), given.get('final_time')
    if isinstance(value, (int, float, str)) and not isinstance(value, bool) and value != 'free':
        found['final_time'] = {'free': False, 'value': value}
    rows, between = map(given.get, ('terminal_constraints', 'boundary_constraints'))
    names = {str(name) for key in ('states', 'inputs', 'parameters', 'free_parameters')
             if isinstance(given.get(key), (list, tuple, Mapping)) for name in given[key]}
    firsts = {name + FIRST for name in names} - names
    if not isinstance(rows, (list, tuple)) or not isinstance(between, (list, tuple, type(None))):
        return found
    for row in rows:
        text = row.get('expr') if isinstance(row, Mapping) else row
        if isinstance(text, str) and firsts & set(re.findall(r'\w+', text)):
            found['terminal_constraints'] = [
                each for each in found['terminal_constraints'] if each is not row]
            found['boundary_constraints'] = [*(found.get('boundary_constraints') or ()), row]
    return found


def _build_with_phases(given: Given) -> Problem:
    joined, layout = state_as_one_phase(given)
    try:
        problem = replace(_build_problem(joined), phases=layout)
    except StatementError as error:
        _check_each_phase(given)
        raise restate(error, layout.name_phases) from None
    _check_durations(given['phases'], problem)
    return problem


def replace_functions(mapping: Mapping[str, Any]) -> dict[str, Any]:
    """Return a valid statement in which what its functions return is recorded as plain data."""
    given = dict(mapping)
    if any(callable(value) for value in given.values()):
        with Faults(given) as faults:
            plant = (_own_plant if given.get('system') is None else _registered_plant)(
                given, faults)
            called = _call_each(given, plant, faults)
        given = _record_functions(given, called, plant)
    return given


def _check_each_phase(given: Given) -> None:
    """Raise the errors of the phases, and links, that are invalid by themselves."""
    failed: list[Given] = []
    with Faults() as faults:
        for part, rename in state_each_phase(given):
            if any(all(part.get(key) is value for key, value in each.items()
                       if not key.startswith('terminal')) for each in failed):
                continue   # it has the same errors
            try:
                _build_problem(part)
            except StatementError as error:
                failed.append(part)
                faults.note(restate(error, rename))


def _read_units(given: Given) -> dict[str, str]:
    """Return the units of a statement; those of names that it does not have change nothing."""
    units = read_section(given, 'units')
    for name, unit in units.items():
        if not isinstance(unit, str) or len(unit) > LONGEST_UNIT:
            raise StatementError(f'units.{_short(name)}: wanted a short text such as m/s, found '
                                 f'{describe_type(unit)}')
    return {str(name): unit for name, unit in units.items()}


def _build_problem(given: Given) -> Problem:
    """Build a problem without phases."""
    _bounded_text(given)
    with Faults(given) as faults:
        name = faults.attempt(_name, given)
        method = faults.attempt(get_method, given.get('method'))
        accept = faults.attempt(get_accepted, given.get('accept'))
        plant = faults.attempt(
            _own_plant if given.get('system') is None else _registered_plant, given, faults)
        if not plant:
            faults.attempt(_final_time, given, UnknownValues())
            raise DependentError('the plant is malformed')
        stated, given = given, _call_each(given, plant, faults)
        L = faults.attempt(_cost, given, plant, 'running_cost')
        V = faults.attempt(_terminal_cost, given, plant)
        end = faults.attempt(_end_constraints, given, plant, 'terminal_constraints')
        along = faults.attempt(_path_constraints, given, plant)
        x_bounds = faults.attempt(_bounds, given, 'state_bounds', plant.states, plant.values)
        u_bounds = faults.attempt(_bounds, given, 'input_bounds', plant.inputs, plant.values,
                                  plant.u_lower, plant.u_upper)
        final_time = faults.attempt(_final_time, given, plant.values)
        more = faults.attempt(_Start, given, replace(plant, end=None))
        guess = faults.attempt(_guess, given.get('initial_guess'), plant, final_time)
        starts = [faults.attempt(_guess, each, plant, final_time, f'starts[{k}]') for k, each in
                  enumerate(faults.attempt(read_list, given, 'starts') or ())]
        if final_time:
            T = [] if plant.end is None or final_time.free else [(plant.end, final_time.value)]
            breaks = faults.attempt(
                plant.tables.find_breaks, plant.time,
                _column([*plant.p.values(), *(symbol for symbol, _ in T)]),
                np.array([*plant.values.values(), *(value for _, value in T)]), final_time)
    (psi, literals, margins), (path, path_lower, path_upper) = end, along
    (x_lower, x_upper), (u_lower, u_upper) = x_bounds, u_bounds
    plant, (L, V, path, *psi), held = _insert_end(plant, [L, V, path, *psi], final_time)
    margins = margins + held
    time = plant.time if plant.time is not None and (held or ca.depends_on(
        ca.vertcat(plant.f, L, V, path, *psi), plant.time)) else None
    added = more.augment(time, guess, margins)
    # A free T is t at the end.
    stops = [] if plant.time is None else [plant.time - end for end, *_ in held]
    ends = (*(f'terminal_constraints[{k}]' for k in range(len(psi))), *more.keys,
            *('final_time' for _ in stops))
    V, psi, literals = V + more.cost, [*psi, *more.rows, *stops], [*literals, *more.literals]
    unlimited = np.full(added.count, np.inf)
    x, u = _column(added.x.values()), _column(plant.u.values() or [ca.SX.sym(HELD)])
    p = _column([*plant.p.values(), *(symbol for symbol, _ in literals)])
    f, rows = ca.vertcat(plant.f, added.rates), _column(psi)
    functions = ca.Function('problem', [x, u, p], [f, L, path, V, rows])
    bounds = (np.append(x_lower, -unlimited), np.append(x_upper, unlimited), u_lower, u_upper,
              path_lower, path_upper)
    problem = Problem(
        name=name, states=tuple(added.x), inputs=plant.inputs or (HELD,),
        parameters=(*plant.p, *(symbol.name() for symbol, _ in literals)),
        x=x, u=u, p=p, f=f, L=L, V=V, psi=rows, path=path, x_lower=bounds[0], x_upper=bounds[1],
        u_lower=u_lower, u_upper=u_upper, path_lower=path_lower, path_upper=path_upper,
        p_value=np.array([*plant.values.values(), *(value for _, value in literals)]),
        x0=np.array(added.x0), start=added.start, added=added.count,
        free_parameters=tuple(plant.free), has_clock=time is not None, final_time=final_time,
        held=int(not plant.inputs), guess=guess, starts=tuple(starts),
        angles=plant.angles + (False,) * added.count, method=method, accept=accept,
        units=plant.units, ends=ends, breaks=breaks[0], edges=breaks[1],
        statement=_record_functions(stated, given, plant),
        structure=_structure(functions, bounds, final_time, added.start))
    _defined_at_start(problem, functions)
    return problem


def _insert_end(plant: _Plant, expressions: list[ca.SX], final: FinalTime
                ) -> tuple[_Plant, list[ca.SX], list[_Margin]]:
    """Return a plant and expressions with T: a number, or a free value and its bounds."""
    if plant.end is None or not ca.depends_on(ca.vertcat(plant.f, *expressions), plant.end):
        return plant, expressions, []
    if final.free:
        if plant.time is None:
            raise StatementError("final_time: T is free, but the statement gives the name 't' "
                                 'another meaning, so that T cannot be in expressions')
        return plant, expressions, [(plant.end, final.lower, final.upper)]
    f, *found = ca.substitute([plant.f, *expressions], [plant.end], [ca.SX(final.value)])
    return replace(plant, f=f), found, []


def _call_each(given: Given, plant: _Plant, faults: Faults) -> Given:
    """Return a statement without functions; one that fails counts as absent."""
    for key in STATED_FUNCTIONS:
        if callable(given.get(key)) or isinstance(given.get(key), RecordedFunction):
            given = faults.attempt(call_functions, given, (key,), *plant.arguments) or {
                **given, key: None}
    return given


def _record_functions(given: Given, called: Given, plant: _Plant) -> dict[str, Any]:
    """Return a statement with records of what its functions returned."""
    values = {**called, 'dynamics': dict(zip(plant.states, ca.vertsplit(plant.f), strict=True))}
    return {**given, **{key: record_function(key, values[key], plant.known)
                        for key in ('dynamics', *STATED_FUNCTIONS) if callable(given.get(key))}}


def load_file(path: str | Path) -> list[dict[str, Any]]:
    """Read the mappings in a YAML file, one or a list of them, all of them valid entries."""
    mappings = []
    for _, entry in read_entries(path):
        if isinstance(entry, StatementError):
            raise entry
        refuse_others(entry, (FileKind.PROBLEM,), path)
        mappings.append(entry)
    return mappings


def _short(value: object) -> str:
    return quote(str(value))


def _column(rows: Iterable[ca.SX]) -> ca.SX:
    return ca.vertcat(ca.SX(0, 1), *rows)


def _name(given: Given) -> str:
    name = given.get('name', 'problem')
    if not isinstance(name, str) or len(name) > 200 or not name.isprintable():
        raise StatementError(f'name: wanted a short text, found {describe_type(name)}')
    return name or 'problem'


def _bounded_text(given: Given) -> None:
    """Raise an error if the expressions are too long in total, before any of them is parsed."""
    total = 0
    for key in ('dynamics', 'parameters', 'terminal_constraints', 'initial_constraints',
                'boundary_constraints', 'path_constraints'):
        value = given.get(key)
        parts = value.values() if isinstance(value, Mapping) else (
            value if isinstance(value, (list, tuple)) else ())
        for part in parts:
            part = part.get('expr') if isinstance(part, Mapping) else part
            total += len(part) if isinstance(part, str) else 0
    if total > MAX_TEXT:
        raise StatementError(f'problem: its expressions have {total} characters in total; '
                             f'at most {MAX_TEXT} are allowed')


def _unknown(name: object, known: tuple[str, ...], where: str, what: str) -> StatementError:
    return StatementError(f"{where}: '{_short(name)}' is not {what}"
                          f"{suggest_name(str(name), known)}; "
                          f"there {'is' if len(known) == 1 else 'are'} "
                          f"{_short(', '.join(known)) or 'none'}")


def _check_states(given: Given, states: tuple[str, ...], key: str, what: str) -> None:
    """Raise an error unless the keys of a mapping are the states."""
    with Faults() as faults:
        for name in given:
            if name not in states:
                faults.note(_unknown(name, states, f'{key}.{_short(name)}', 'a state'))
        for name in states:
            if name not in given:
                faults.note(StatementError(f"{key}: no {what} for the state '{name}'"))


def _own_plant(given: Given, faults: Faults) -> _Plant:
    """Return the plant; errors that leave its names known go to `faults`."""
    with Faults() as names:
        states = names.attempt(read_names, given, 'states')
        inputs = names.attempt(_input_names, given)
        parameters = names.attempt(read_section, given, 'parameters')
        signals = (*(states or ()), *(inputs or ()))
        free_names = names.attempt(_free_names, given, signals, parameters or ())
        for name in inputs or ():
            if name in (states or ()):
                names.note(StatementError(f"inputs: '{name}' is both a state and an input"))
        for name in parameters or ():
            names.attempt(_parameter, name, states or (), inputs or ())
    x = {name: ca.SX.sym(name) for name in states}
    u = {name: ca.SX.sym(name) for name in inputs}
    values = NamedValues()
    for name, value in parameters.items():
        values.read(name, value, faults)
    p = {name: ca.SX.sym(name) for name in values}
    free = {name: ca.SX.sym(name) for name in free_names}
    time = _time((*states, *inputs, *p))
    tables = read_tables(given, (*x, *u, *p, *free), _column((x | u | free).values()), faults)
    end = ca.SX.sym(END)
    known = _name_symbols(tables, x, u, p, free, time, end)
    equations = faults.attempt(_equations, given, x, u, p | free, time)
    if equations is None:
        equations = {}
    else:
        faults.attempt(_check_states, equations, states, 'dynamics', 'equation')
    rows = [faults.attempt(expressions.parse_expression, equations[name], known,
                           f'dynamics.{name}') for name in states if name in equations]
    f = _column(row for row in rows if row is not None)
    unlimited = np.full(len(inputs), np.inf) if inputs else np.zeros(1)   # of HELD
    return _Plant(
        states=states, inputs=inputs, angles=(False,) * len(states), x=x, u=u, p=p,
        values=values, f=f, u_lower=-unlimited, u_upper=unlimited, free=free, time=time,
        tables=tables, end=end)


def _input_names(given: Given) -> tuple[str, ...]:
    return () if given.get('inputs') in ([], ()) else read_names(given, 'inputs')


def _equations(given: Given, x: dict[str, ca.SX], u: dict[str, ca.SX], p: dict[str, ca.SX],
               time: ca.SX | None) -> Given:
    if given.get('dynamics') is None:
        raise StatementError('dynamics: missing; wanted an equation for each state')
    return read_mapping(call_functions(given, ('dynamics',), x, u, p, time)['dynamics'],
                        'dynamics', names=tuple(x))


def _parameter(name: object, states: tuple[str, ...], inputs: tuple[str, ...]) -> str:
    name = check_name(name, 'parameters')
    if name in states or name in inputs:
        raise StatementError(f"parameters: '{name}' is both a parameter and "
                             f"{'a state' if name in states else 'an input'}")
    return name


def _time(names: Collection[str]) -> ca.SX | None:
    """Return the symbol of the time, None if a statement gives its name another meaning."""
    return None if TIME in names else ca.SX.sym(TIME)


def _free_names(given: Given, signals: Collection[str],
                parameters: Collection[str]) -> list[str]:
    def check(name: object) -> str:
        name = check_name(name, 'free_parameters')
        if name == TIME:
            raise StatementError(f"free_parameters: '{TIME}' is the time; choose another name")
        if name in signals:
            raise StatementError(f"free_parameters: '{name}' is a state or an input; to find the "
                                 'initial value of a state, write null or [lower, upper] in '
                                 'initial_state')
        if name in parameters:
            raise StatementError(f"free_parameters: '{name}' has a value in parameters; give one "
                                 'of the two')
        return name

    with Faults() as faults:
        return [faults.attempt(check, name) for name in read_section(given, 'free_parameters')]


def _registered_plant(given: Given, faults: Faults) -> _Plant:
    """Return the plant of the key `system`, a name or a System, with its own parameters."""
    for key in ('states', 'inputs', 'dynamics'):
        if given.get(key):
            raise StatementError(f'{key}: the system defines it already; '
                                 "give either 'system' or 'states', 'inputs' and 'dynamics'")
    name = getattr(given['system'], 'model', given['system'])
    if not isinstance(name, str | System):
        raise StatementError(f'system: wanted a name, found {describe_type(name)}')
    section = read_section(given, 'parameters')
    free = read_section(given, 'free_parameters')
    options: dict[str, object] = {}
    try:
        if isinstance(name, str):
            options = {key: _option(section[key], f'parameters.{key}')
                       for key in registry.get_options(name) if key in section}
            system = registry.get_registered(name, options)
        else:
            system = name
    except ObcError as error:
        raise StatementError(f'system: {error}') from None
    values = NamedValues({parameter.name: parameter.value for parameter in system.parameters})
    own = tuple(values)
    waiting = set(section)
    for key, value in section.items():
        if key not in options:
            if faults.attempt(_parameter, key, system.state_names, system.input_names):
                values.read(key, value, faults, waiting)
            waiting.discard(key)
    try:
        system = system.with_parameters({
            key: values[key] for key in own if key in section and not values.is_malformed(key)})
    except ObcError as error:
        raise StatementError(f'parameters: {error}') from None
    p = dict(zip(own, ca.vertsplit(system.p), strict=True))
    p |= {key: ca.SX.sym(key) for key in values if key not in p}
    # A free parameter of the system replaces its value.
    replaced = {key: p.pop(key) for key in own if key in free and key not in section}
    values = values.select(p)
    signals = (*system.state_names, *system.input_names)
    found = {key: replaced[key] if key in replaced else ca.SX.sym(key)
             for key in _free_names(given, signals, p)}
    return _Plant(
        states=system.state_names, inputs=system.input_names, angles=system.angles,
        x=dict(zip(system.state_names, ca.vertsplit(system.x), strict=True)),
        u=dict(zip(system.input_names, ca.vertsplit(system.u), strict=True)), p=p, values=values,
        f=system.xdot, u_lower=system.u_min, u_upper=system.u_max, free=found,
        time=_time((*signals, *p)), units=system.units, tables=read_tables(
            given, (*signals, *p, *found), ca.vertcat(system.x, system.u, *found.values()),
            faults))


def _option(value: object, where: str) -> object:
    """Return an option of a system: rows of numbers, an integer or a float."""
    if isinstance(value, (list, tuple)):
        return value
    plain = parse_number(value, {}, where)
    return int(plain) if plain.is_integer() else plain


def _states_only(expression: ca.SX, plant: _Plant, where: str) -> None:
    for name, symbol in plant.u.items():
        if ca.depends_on(expression, symbol):
            raise StatementError(f"{where}: '{name}' is an input; only states and parameters may "
                                 'appear in terminal costs and constraints')


def _terminal_cost(given: Given, plant: _Plant) -> ca.SX:
    V = _cost(given, plant, 'terminal_cost')
    _states_only(V, plant, 'terminal_cost')
    return V


def _cost(given: Given, plant: _Plant, key: str) -> ca.SX:
    value = given.get(key)
    return expressions.parse_expression(0 if value is None else value, plant.known, key)


def _end_constraints(given: Given, plant: _Plant, key: str,
                     first: dict[str, ca.SX] | None = None
                     ) -> tuple[list[ca.SX], list[tuple[ca.SX, float]], list[_Margin]]:
    """
    Return constraints, with numbers that are symbols, their values, and values within bounds.

    `first`: symbols of x(0), besides those of the states.
    """
    firsts = first or {}
    names = plant.known
    names |= firsts

    def read(index: int, text: object) -> tuple[ca.SX, list[tuple[ca.SX, float]], list[_Margin]]:
        where, limits = f'{key}[{index}]', list[float]()
        if isinstance(text, Mapping):
            text, *limits = _limited_row(text, plant, where)
        early = {name + FIRST: name for name in plant.states} if not firsts else {}
        for name in re.findall(r'\w+', text) if isinstance(text, str) else ():
            if name in early and name not in names:
                raise StatementError(f"{where}: '{name}' is the initial value of '{early[name]}'; "
                                     f'write this constraint under boundary_constraints')
        row = expressions.parse_expression(text, names, where)
        _states_only(row, plant, where)
        if not ca.depends_on(row, _column((plant.x | plant.free | firsts).values())):
            raise StatementError(f"{where}: '{_short(text)}' does not depend on any state")
        row, literals = expressions.parse_lifted(text, names, where)
        if not limits:
            return row, literals, []
        value = ca.SX.sym(where)
        if limits[0] == limits[1]:
            return row - value, [*literals, (value, limits[0])], []
        return row - value, literals, [(value, limits[0], limits[1])]

    with Faults() as faults:
        found = [faults.attempt(read, *each) for each in enumerate(read_list(given, key))]
    return ([row for row, *_ in found], [each for _, literals, _ in found for each in literals],
            [each for *_, margins in found for each in margins])


def _limited_row(entry: Given, plant: _Plant, where: str) -> tuple[Any, float, float]:
    """Return the expression of a constraint, unread, and its bounds."""
    check_keys(entry, ('expr', 'lower', 'upper'), where=where)
    if entry.get('expr') is None:
        raise StatementError(f'{where}: expr is missing')
    low, high = evaluate_limits(entry.get('lower'), entry.get('upper'), plant.values, where)
    if math.isinf(low) and math.isinf(high):
        raise StatementError(f'{where}: wanted a lower or an upper bound, found neither')
    return entry['expr'], low, high


def _bounds(given: Given, key: str, names: tuple[str, ...],
            values: Mapping[str, float], lower: Array | None = None,
            upper: Array | None = None) -> tuple[Array, Array]:
    low = np.full(len(names), -np.inf) if lower is None else lower.copy()
    high = np.full(len(names), np.inf) if upper is None else upper.copy()

    def read(name: str, value: object) -> None:
        where = f'{key}.{_short(name)}'
        if name not in names:
            raise _unknown(name, names, where, f'a{"n" * (key == "input_bounds")} '
                                               f'{key.removesuffix("_bounds")}')
        if value is not None:
            index = names.index(name)
            low[index], high[index] = read_bounds(value, values, where)

    with Faults() as faults:
        for each in read_section(given, key, names=names).items():
            faults.attempt(read, *each)
    return low, high


def _path_constraints(given: Given, plant: _Plant) -> tuple[ca.SX, Array, Array]:
    names = _column((plant.x | plant.u | plant.free).values())

    def read(index: int, entry: object) -> tuple[ca.SX, float, float]:
        where = f'path_constraints[{index}]'
        entry = read_mapping(entry, where, 'a mapping such as {expr: v, upper: 1}, or a '
                             'comparison, v <= 1')
        text, low, high = _limited_row(entry, plant, where)
        row = expressions.parse_expression(text, plant.known, f'{where}.expr')
        if not ca.depends_on(row, names):
            raise StatementError(f'{where}.expr: depends on no state and no input')
        return row, low, high

    with Faults() as faults:
        found = [faults.attempt(read, *each)
                 for each in enumerate(read_list(given, 'path_constraints'))]
    rows, lower, upper = zip(*found, strict=True) if found else ((), (), ())
    return _column(rows), np.array(lower), np.array(upper)


class _Start:
    """
    What a statement says of x(0), and of free parameters.

    `cost`, `rows`, `literals`: additional terminal cost and constraints, after `augment`; `keys`:
    those of the rows.
    """

    def __init__(self, given: Given, plant: _Plant) -> None:
        self._given, self._plant = given, plant
        at_start = replace(plant, time=None)
        with Faults() as faults:
            self._x0: list[tuple[float, float]] = faults.attempt(_initial_state, given, plant)
            self._free: dict[str, tuple[float, float]] = {name: faults.attempt(
                _box, value, plant.values, f'free_parameters.{name}')
                for name, value in read_section(given, 'free_parameters').items()}
            self._cost = faults.attempt(_initial_cost, given, at_start)
            start = faults.attempt(_end_constraints, given, at_start, 'initial_constraints')
            self._periodic = faults.attempt(_periodic, given, plant)
            self._first = {} if given.get('boundary_constraints') is None else _first_symbols(
                plant)
            between = faults.attempt(
                _end_constraints, given, plant, 'boundary_constraints', self._first)
        self._rows, self._between = start[0], between[0]
        self.literals, self._margins = start[1] + between[1], start[2] + between[2]
        self.cost, self.rows = ca.SX(0), list[ca.SX]()
        self.keys = (*(f'initial_constraints[{k}]' for k in range(len(self._rows))),
                     *(f'boundary_constraints[{k}]' for k in range(len(self._between))),
                     *(f'periodic: {name}' for name in self._periodic))

    def augment(self, time: ca.SX | None, guess: Guess, margins: list[_Margin]) -> Augmentation:
        """
        Return the states with the additional ones.

        :param time: its symbol, if it occurs.
        :param margins: of the terminal constraints.
        """
        plant, firsts = self._plant, {name: float(x[0]) for name, x in guess.x.items()}
        start = [_guessed(*box, firsts.get(name))
                 for name, box in zip(plant.states, self._x0, strict=True)]
        added = Augmentation(dict(plant.x), *(list(each) for each in zip(*start, strict=True)))
        if time is not None:
            added.add(TIME, time, (0.0, 0.0, 0.0), 1.0)
        for name, box in self._free.items():
            added.add(name, plant.free[name], _guessed(*box, firsts.get(name)))
        for symbol, lower, upper in margins + self._margins:
            added.add(symbol.name(), symbol, _guessed(lower, upper, None))
        used = [name for name, symbol in self._first.items()
                if any(ca.depends_on(row, symbol) for row in self._between)]
        first = added.keep_initial([self._cost, *self._rows, *(
            plant.x[name.removesuffix(FIRST)] for name in used), *(
                plant.x[name] for name in self._periodic)])
        self.cost, a = first[0], 1 + len(self._rows)
        b = a + len(used)
        between = ca.substitute(self._between, [self._first[name] for name in used],
                                first[a:b]) if used else self._between
        self.rows = [*first[1:a], *between, *(plant.x[name] - kept for name, kept in zip(
            self._periodic, first[b:], strict=True))]
        return added


def _initial_cost(given: Given, plant: _Plant) -> ca.SX:
    cost = _cost(given, plant, 'initial_cost')
    _states_only(cost, plant, 'initial_cost')
    return cost


def _box(value: object, values: Mapping[str, float], where: str) -> tuple[float, float]:
    """Return bounds: of null, none."""
    return (-math.inf, math.inf) if value is None else read_bounds(value, values, where)


def _guessed(lower: float, upper: float, guess: float | None) -> tuple[float, float, float]:
    """Return an initial guess within bounds, and the bounds."""
    if guess is None and math.isfinite(upper - lower):
        guess = 0.5 * lower + 0.5 * upper
    elif guess is None and math.isfinite(lower):
        guess = lower + max(1.0, abs(lower))
    elif guess is None and math.isfinite(upper):
        guess = upper - max(1.0, abs(upper))
    return min(max(guess or 0.0, lower), upper), lower, upper


def _first_symbols(plant: _Plant) -> dict[str, ca.SX]:
    """Return symbols of x(0) by their names in boundary constraints."""
    found = {name + FIRST: ca.SX.sym(name + FIRST) for name in plant.states}
    for name in found:
        if name in plant.known:
            raise StatementError(f"boundary_constraints: '{name}' is a name of the statement and "
                                 f"the initial value of '{name.removesuffix(FIRST)}'; rename one")
    return found


def _periodic(given: Given, plant: _Plant) -> tuple[str, ...]:
    if given.get('periodic') is None:
        return ()
    names = read_names(given, 'periodic')
    for name in names:
        if name not in plant.states:
            raise _unknown(name, plant.states, 'periodic', 'a state')
    return names


def name_initial_state(given: Given, states: tuple[str, ...]) -> dict[str, Any]:
    """Return a statement with the initial state by name; a list is in the order of the states."""
    start = given.get('initial_state')
    if isinstance(start, (list, tuple)):
        if len(start) != len(states):
            raise StatementError(f'initial_state: wanted {_example(states)}, found '
                                 f'{describe_type(start)}')
        start = dict(zip(states, start, strict=True))
    return {**given, 'initial_state': start}


def _example(states: tuple[str, ...]) -> str:
    return f"a number for each state: {{{', '.join(f'{name}: 0' for name in states[:9])}}}"


def _initial_state(given: Given, plant: _Plant) -> list[tuple[float, float]]:
    wanted, given = _example(plant.states), name_initial_state(given, plant.states)
    if given['initial_state'] is None:
        raise StatementError(f'initial_state: missing; wanted {wanted}')
    start = read_mapping(given['initial_state'], 'initial_state', wanted)
    with Faults() as faults:
        faults.attempt(_check_states, start, plant.states, 'initial_state', 'value')
        return [faults.attempt(_initial_value, start[name], plant.values, f'initial_state.{name}')
                for name in plant.states if name in start]


def _initial_value(value: object, values: Mapping[str, float], where: str) -> tuple[float, float]:
    """Return the bounds of an initial value: a number, [lower, upper], or null."""
    if value is None or isinstance(value, (list, tuple)):
        return _box(value, values, where)
    number = parse_number(value, values, where)
    return number, number


def _final_time(given: Given, values: Mapping[str, float]) -> FinalTime:
    forms = '{free: false, value: 5} or {free: true, lower: 0.1, upper: 20}'
    if given.get('final_time') is None:
        raise StatementError(f'final_time: missing; wanted {forms}')
    entry = read_mapping(given['final_time'], 'final_time', forms)
    check_keys(entry, ('free', 'value', 'lower', 'upper', 'guess'), where='final_time')
    free = entry.get('free')
    if not isinstance(free, bool):
        value = entry.get('value')
        hint = suggest_line(entry, 'final_time') if entry.keys() & {'lower', 'upper'} else ''
        hint = hint if free is None and hint else '' if free is not None else (
            f'; wanted {forms}' if value is None else
            f'; write {{free: false, value: {quote(str(value), 40)}}}')
        raise StatementError('final_time.free: wanted true or false, found '
                             f'{describe_type(free)}{hint}')
    wanted, unwanted = (('lower', 'upper'), ('value',)) if free else (
        ('value',), ('lower', 'upper', 'guess'))
    for key in wanted:
        if entry.get(key) is None:
            raise StatementError(f'final_time.{key}: missing{suggest_line(entry, "final_time")}')
    for key in unwanted:
        if entry.get(key) is not None:
            raise StatementError(f'final_time.{key}: the final time is '
                                 f'{"free" if free else "given"}; wanted {" and ".join(wanted)}')
    found = {key: parse_number(entry[key], values, f'final_time.{key}')
             for key in (*wanted, 'guess') if entry.get(key) is not None}
    if not free:
        return FinalTime(free=False, value=_positive(found['value'], 'final_time.value'))
    upper = _positive(found['upper'], 'final_time.upper')
    if found['lower'] < 0:
        raise StatementError(f"final_time.lower: {found['lower']:g} is negative")
    if found['lower'] > upper:
        raise StatementError(f"final_time: the bounds cross: lower {found['lower']:g} > "
                             f'upper {upper:g}')
    guess = found.get('guess')
    if guess is not None:
        guess = min(max(_positive(guess, 'final_time.guess'), found['lower']), upper)
    return FinalTime(free=True, lower=found['lower'], upper=upper, guess=guess)


def _check_durations(phases: Iterable[Given], problem: Problem) -> None:
    """Raise an error if a duration is not valid as a final time."""
    values = dict(zip(problem.parameters, problem.p_value.tolist(), strict=True))
    for k, phase in enumerate(phases):
        value = phase['duration']
        entry = value if isinstance(value, Mapping) else {'free': False, 'value': value}
        try:
            _final_time({'final_time': entry}, values)
        except StatementError as error:
            raise StatementError(str(error).replace('final_time', f'phases[{k}].duration')
                                 ) from None


def _positive(value: float, where: str) -> float:
    if value <= 0:
        raise StatementError(f'{where}: a final time is > 0, found {value:g}')
    return value


def _guess(value: object, plant: _Plant, final_time: FinalTime | None,
           key: str = 'initial_guess') -> Guess:
    entry = _section(value, key)
    check_keys(entry, ('states', 'inputs', 'parameters', 'final_time'), where=key)
    final = entry.get('final_time')
    if final is not None:
        where = f'{key}.final_time'
        final = _positive(parse_number(final, plant.values, where), where)
        if final_time and final_time.free:
            final = min(max(final, final_time.lower), final_time.upper)
    x, parameters, u = (
        _profiles(entry.get(kind), f'{key}.{kind}', names, plant.values) for kind, names in (
            ('states', plant.states), ('parameters', tuple(plant.free)), ('inputs', plant.inputs)))
    return Guess(x | parameters, u, final)


def _section(value: object, key: str) -> Given:
    return {} if value is None else read_mapping(value, key)


def _profiles(entry: object, key: str, names: tuple[str, ...],
              values: Mapping[str, float]) -> dict[str, Array]:
    found = {}
    for name, value in _section(entry, key).items():
        where = f'{key}.{_short(name)}'
        if name not in names:
            raise _unknown(name, names, where, f"one of the {key.rpartition('.')[2]}")
        several = isinstance(value, (list, tuple))
        numbers = list_of(value if several else [value], where, most=MAX_VALUES)
        if not numbers:
            raise StatementError(f'{where}: the list is empty')
        found[name] = np.array([parse_number(item, values, where) for item in numbers])
    return found


def _structure(functions: ca.Function, bounds: tuple[Array, ...], final_time: FinalTime,
               start: FreeStart | None) -> str:
    """Return a hash of the expressions, of which bounds exist, and of what is free."""
    digest = hashlib.sha256(functions.serialize().encode())
    for lower, upper in zip(bounds[::2], bounds[1::2], strict=True):
        digest.update(np.isfinite(lower).tobytes() + np.isfinite(upper).tobytes()
                      + (lower == upper).tobytes())
    digest.update(b'free' if final_time.free else b'given')
    if start is not None:
        digest.update((start.lower == start.upper).tobytes() + repr(start.linked).encode())
    return digest.hexdigest()


def _defined_at_start(problem: Problem, functions: ca.Function) -> None:
    """Raise an error if f, L or path constraints are undefined at x(0) for all trial inputs."""
    worst: list[str] = []
    for u in _trial_inputs(problem):
        f, L, path, _, _ = (value.full().ravel()
                            for value in functions(problem.x0, u, problem.p_value))
        undefined = [f'dynamics.{name}' for name, value in zip(problem.states, f, strict=True)
                     if not np.isfinite(value)]
        undefined += ['running_cost'] * (not np.isfinite(L[0]))
        undefined += [f'path_constraints[{index}]' for index, value in enumerate(path)
                      if not np.isfinite(value)]
        if not undefined:
            return
        worst = worst or undefined
    start = ', '.join(f'{name} = {value:g}'
                      for name, value in zip(problem.states, problem.x0, strict=True))
    if problem.start is not None:
        raise StatementError(f'{worst[0]}: undefined at the initial guess of the initial state '
                             f'({_short(start)}); give one in initial_guess')
    raise StatementError(f'{worst[0]}: undefined at the initial state ({_short(start)}): '
                         'its value there is not a finite number')


def _trial_inputs(problem: Problem) -> list[Array]:
    lower, upper = problem.u_lower, problem.u_upper
    clipped = [np.clip(np.full(problem.m, value), lower, upper) for value in (0.0, 1.0, -1.0)]
    boxed = problem.boxed
    middle = clipped[0].copy()
    middle[boxed] = 0.5 * lower[boxed] + 0.5 * upper[boxed]
    guess = np.array([problem.guess.u[name][0] if name in problem.guess.u else middle[index]
                      for index, name in enumerate(problem.inputs)])
    mixed = np.clip(np.linspace(0.3, 0.9, problem.m), lower, upper)
    return [guess, middle, *clipped, mixed]
