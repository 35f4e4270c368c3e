# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Controlled systems as a user states them, and python-control's systems as such."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Protocol, Unpack

import casadi as ca
import numpy as np
from obc_ros.api.given import (
    as_input,
    as_state,
    choose_given,
    convert_numbers,
    Expression,
    KeysOfTask,
    NAMED_AT_MOST,
    StatedFunction,
    StateLike,
    UNSET,
)
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp import problem as ocp
from obc_ros.core.systems import registry
from obc_ros.core.systems import system as plant
from obc_ros.core.systems.equilibrium import Equilibrium, find_equilibrium, linearize
from obc_ros.core.systems.file import build_system, OF_A_PLANT
from obc_ros.core.text.errors import describe_type, DynamicsError, quote, StatementError
from obc_ros.core.text.expressions import check_name, parse_number
from obc_ros.core.text.fields import read_bounds
from obc_ros.core.text.stated_functions import call_with_symbols
from obc_ros.core.text.tables import format_table, Tabulated

# Errors of a function that was written for numbers and is called with symbols.
_FAULTS = (ArithmeticError, AttributeError, LookupError, NotImplementedError, RuntimeError,
           TypeError, ValueError)


_KEYS = ('name', 'states', 'inputs', 'parameters', 'dynamics', 'input_bounds', 'state_bounds',
         *OF_A_PLANT)
_OF_PROBLEMS = 'system', 'free_parameters', 'phases'   # keys that a system ignores
_SIZES = 0.1, 1.0, 1.0, 10.0   # of states and inputs at which functions are compared
_TIMES = 0.0, 0.1, 1.0, 10.0, 100.0   # at which they are compared [s]


class HasModel(Protocol):
    """An object with the system that it is about: a System, a Problem."""

    @property
    def model(self) -> plant.System:
        """Return the system with its CasADi expressions."""


SystemLike = HasModel | plant.System | ocp.Problem | str | Path | Mapping[str, Any]


class System(Tabulated):
    """
    A controlled system dx/dt = f(x, u) with named states, inputs and parameters.

    ``System(states=['q', 'v'], inputs=['F'], parameters={'m': 2}, dynamics={'q': 'v',
    'v': 'F/m'})`` has the keys of a system file (docs/systems.md). `dynamics` may be a function of
    named CasADi symbols: ``lambda x, u, p: {'q': x.v, 'v': u.F / p.m}``.

    Parameters
    ----------
    name, states, inputs, parameters, dynamics, input_bounds, state_bounds, units, angles, \
    setpoint, setpoint_input, parameter_bounds, plane, description, outputs, ros
        The keys of a system file.
    **others
        Keys of a problem file, which are ignored.

    Raises
    ------
    StatementError
        If the statement is invalid; the message begins with the key at fault.

    Attributes
    ----------
    name : str
        Name of the system.
    states, inputs : tuple of str
        Names, in order.
    units : dict
        Units by name, of those that have one.

    """

    def __init__(
            self, *, name: str = UNSET, states: Sequence[str] = UNSET,
            inputs: Sequence[str] = UNSET, parameters: Mapping[str, Any] = UNSET,
            dynamics: Mapping[str, Expression] | StatedFunction = UNSET,
            input_bounds: Mapping[str, Any] = UNSET, state_bounds: Mapping[str, Any] = UNSET,
            units: Mapping[str, str] = UNSET, angles: Sequence[str] = UNSET,
            setpoint: Mapping[str, Any] = UNSET, setpoint_input: Mapping[str, Any] = UNSET,
            parameter_bounds: Mapping[str, Any] = UNSET, plane: str = UNSET,
            description: str = UNSET, outputs: Mapping[str, Expression] = UNSET,
            ros: Mapping[str, Mapping[str, Any]] = UNSET, **others: Unpack[KeysOfTask]) -> None:
        keys = choose_given(locals(), _KEYS)
        self._set(build_system(convert_numbers({**keys, **others})))

    def _set(self, model: plant.System | None, name: str = '', states: tuple[str, ...] = (),
             inputs: tuple[str, ...] = (),
             rates: Callable[[Array, Array], Array] | None = None) -> System:
        self._model, self._rates = model, rates
        self.name = name if model is None else model.name
        self.states = states if model is None else model.state_names
        self.inputs = inputs if model is None else model.input_names
        self.units = {} if model is None else model.units
        return self

    @classmethod
    def _of(cls, model: plant.System) -> System:
        return cls.__new__(cls)._set(model)

    @classmethod
    def from_name(cls, name: str, **parameters: Any) -> System:
        """
        Return a registered system, such as 'aircraft'; `obc_ros.core.systems()` lists them.

        Parameters
        ----------
        name : str
            Its name.
        **parameters
            Values of its parameters, and options, such as A and B of 'linear'.

        Raises
        ------
        DynamicsError
            If the system or a parameter is unknown, or a value is out of its range.

        """
        return cls._of(registry.get_registered(name, convert_numbers(parameters)))

    @classmethod
    def from_dict(cls, statement: Mapping[str, Any]) -> System:
        """Return the system of a mapping with the keys of a system file."""
        return cls._of(build_system(convert_numbers(statement)))

    @classmethod
    def from_file(cls, path: str | Path) -> System:
        """Return the system of a YAML file; StatementError if it is invalid."""
        return cls._of(registry.load_system(path))

    @classmethod
    def from_control(cls, system: Any) -> System:
        """
        Return a system of python-control.

        Parameters
        ----------
        system : control.StateSpace or control.NonlinearIOSystem
            In continuous time. Of a StateSpace, A and B are used. The function of a
            NonlinearIOSystem is called with CasADi symbols; if it does not accept them, the
            system can be simulated, and nothing else. States have the names of `system`; those
            that are no names of a problem become x1, x2, ...

        Raises
        ------
        DynamicsError
            If it is something else, or in discrete time.

        """
        if not is_of_control(system) or not any(
                hasattr(system, name) for name in ('A', 'updfcn')):
            raise DynamicsError('from_control: wanted a StateSpace or a NonlinearIOSystem of '
                                f'python-control, found {describe_type(system)}')
        if system.dt:
            raise DynamicsError(f'from_control: {quote(str(system.name))} is in discrete time')
        states = choose_names(system.state_labels, 'x')
        inputs = choose_names(system.input_labels, 'u')
        if len(states) == 0 or len(inputs) == 0:
            raise DynamicsError(f'from_control: {quote(str(system.name))} has no '
                                f'{"inputs" if len(states) else "states"}')
        x_signals, u_signals = ([plant.Signal(name) for name in names]
                                for names in (states, inputs))
        if hasattr(system, 'A'):
            A, B = np.array(system.A), np.array(system.B)
            return cls._of(plant.define(
                str(system.name), x_signals, u_signals, [], lambda x, u, p: ca.vertsplit(
                    ca.mtimes(ca.DM(A), ca.vertcat(*x)) + ca.mtimes(ca.DM(B), ca.vertcat(*u)))))

        rates = partial(_compute_rates, system)

        def symbolic(x: list[ca.SX], u: list[ca.SX], p: list[ca.SX]) -> list[Any]:
            x_, u_ = (np.empty(len(each), dtype=object) for each in (x, u))
            x_[:], u_[:] = x, u
            return [ca.SX(each) for each in call_with_symbols(rates, x_, u_)]

        numeric = cls.__new__(cls)._set(None, str(system.name), states, inputs, rates)
        if _depends_on_time(numeric, system):
            raise DynamicsError(f'from_control: dx/dt of {quote(str(system.name))} depends on the '
                                'time; state it as a problem, in which t is the time')
        try:
            found = cls._of(plant.define(str(system.name), x_signals, u_signals, [], symbolic))
        except _FAULTS:   # it was written for numbers
            return numeric
        return found if _is_equal(found, numeric) else numeric

    @property
    def model(self) -> plant.System:
        """Return the system with its CasADi expressions; DynamicsError if it has none."""
        if self._model is None:
            raise DynamicsError(f'{self.name}: its function does not accept CasADi symbols, so '
                                'that it can only be simulated; state it with System(...)')
        return self._model

    @property
    def parameters(self) -> dict[str, float]:
        """Return the values of the parameters by name."""
        return {} if self._model is None else {
            each.name: each.value for each in self._model.parameters}

    def with_parameters(self, **values: float) -> System:
        """Return the system with other values of parameters; DynamicsError if one is invalid."""
        return System._of(self.model.with_parameters(convert_numbers(values)))

    def f(self, x: StateLike, u: StateLike) -> Array:
        """Return dx/dt, shape (n,), at a state (n,) and an input (m,), in order or by name."""
        return self.evaluate(as_state(x, self.states, 'x'), as_input(u, self.inputs, 'u'))

    def evaluate(self, x: Array, u: Array) -> Array:
        """Return dx/dt as `f`, of arrays that are not checked."""
        return (np.asarray(self._rates(x, u), dtype=np.float64) if self._rates else
                self.model.f(x, u))

    @cached_property
    def limits(self) -> tuple[Array, Array]:
        """Return the lower and upper limits of the inputs, (m,) each."""
        if self._model is None:
            return np.full(len(self.inputs), -np.inf), np.full(len(self.inputs), np.inf)
        return self._model.u_min, self._model.u_max

    def linearize(self, x: StateLike | None = None, u: StateLike | None = None
                  ) -> tuple[Array, Array]:
        """Return A = df/dx and B = df/du at the equilibrium of a set point, as `equilibrium`."""
        at = equilibrium(self, x, u)
        return linearize(self.model, at.x, at.u)

    def to_control(self) -> Any:
        """
        Return the system as a NonlinearIOSystem of python-control.

        It has the names of states and inputs, the states as outputs, and the parameters as
        `params`. Limits of inputs are not part of it.
        """
        import control
        if self._model is None:
            def update(t: float, x: Array, u: Array, params: Mapping[str, float]) -> Array:
                return self.evaluate(x, u)
        else:
            model = self._model
            f = ca.Function('f', [model.x, model.u, model.p], [model.xdot])

            def update(t: float, x: Array, u: Array, params: Mapping[str, float]) -> Array:
                p = [params.get(name, value) for name, value in self.parameters.items()]
                if np.asarray(x).dtype != object:
                    return np.asarray(f(x, u, p).full().ravel())
                found = np.empty(len(self.states), dtype=object)   # of symbols, by `from_control`
                found[:] = ca.vertsplit(f(ca.vertcat(*x), ca.vertcat(*u), p))
                return found
        return control.NonlinearIOSystem(
            update, None, states=list(self.states), inputs=list(self.inputs),
            outputs=list(self.states), params=self.parameters, name=self.name or 'system')

    def __repr__(self) -> str:
        """Return name, states and inputs."""
        states, inputs = (quote(', '.join(names), NAMED_AT_MOST)
                          for names in (self.states, self.inputs))
        return f'<System {quote(self.name)}: states {states}; inputs {inputs}>'

    __str__ = __repr__

    def _title(self) -> str:
        return f'System {self.name}'

    def _repr_html_(self) -> str:
        """Return signals and parameters for a notebook."""
        return super()._repr_html_() if self._model is None else self._model._repr_html_()

    def _rows(self) -> list[tuple[str, ...]]:
        return [('states', ', '.join(self.states)), ('inputs', ', '.join(self.inputs))]


def _compute_rates(system: Any, x: Any, u: Any, t: float = 0.0) -> Any:
    """Return dx/dt of a NonlinearIOSystem, shape (n,); also of symbols."""
    return np.atleast_1d(system.updfcn(t, x, u, system.params)).ravel()


def _depends_on_time(numeric: System, system: Any) -> bool:
    """Return whether dx/dt at random points differs between some times."""
    chance = np.random.default_rng(1)
    x, u = (chance.standard_normal(len(names)) for names in (numeric.states, numeric.inputs))
    try:
        here, *others = (np.asarray(_compute_rates(system, x, u, t), dtype=np.float64)
                         for t in _TIMES)
    except _FAULTS:   # it is undefined there
        return False
    return not all(np.array_equal(here, other, equal_nan=True) for other in others)


def _is_equal(one: System, other: System) -> bool:
    """Return whether the rates of two systems are equal; math.sin of a symbol is nan."""
    chance = np.random.default_rng(1)
    for size in _SIZES:
        x, u = (size * chance.standard_normal(len(names)) for names in (one.states, one.inputs))
        if not np.allclose(one.f(x, u), other.f(x, u), rtol=1e-9, atol=1e-12, equal_nan=False):
            return False
    return True


class SystemNames(Mapping[str, System]):
    """The registered systems by name; called, they are returned with what they are."""

    def __call__(self) -> dict[str, str]:
        """Return a line about each system by its name."""
        return {name: _describe(name) for name in self}

    def __getitem__(self, name: str) -> System:
        """Return a system with its default parameters; KeyError if it is unknown."""
        if name not in registry.list_systems():
            raise KeyError(f'{quote(str(name))}: there are {", ".join(self)}')
        return System.from_name(name)

    def __iter__(self) -> Iterator[str]:
        """Yield the names."""
        return iter(registry.list_systems())

    def __len__(self) -> int:
        """Return the number of systems."""
        return len(registry.list_systems())

    def __repr__(self) -> str:
        """Return a table of names and what they are."""
        return format_table(('system', 'description'), self().items())


def _describe(name: str) -> str:
    """Return what a registered system is; of one that needs options, their names."""
    needed = [key for key, value in registry.get_options(name).items() if value == ()]
    return f'needs {", ".join(needed)}' if needed else System.from_name(name).model.description


systems = SystemNames()


def equilibrium(system: SystemLike, x: StateLike | None = None, u: StateLike | None = None
                ) -> Equilibrium:
    """
    Find the state and the input at which a system rests, or drifts evenly.

    Parameters
    ----------
    system : System, str, Path, mapping, Problem, StateSpace or NonlinearIOSystem
        The system, the name of a registered one, a file, the keys of one, the plant of a problem,
        or a system of python-control.
    x : array_like, shape (n,), or mapping, optional
        Set point, in the order of the states or by name; default: that of the system.
    u : array_like, shape (m,), or mapping, optional
        Initial guess of the input. Inputs that the set point does not determine keep it.

    Returns
    -------
    Equilibrium
        ``x`` (n,), ``u`` (m,) and ``drift`` (n,), f(x, u) of states that f does not depend on.

    Raises
    ------
    StatementError
        If an argument is invalid.
    DynamicsError
        If no input within the limits holds the system there.

    """
    plant = as_system(system)
    return find_equilibrium(
        plant.model, None if x is None else as_state(x, plant.states, 'x'),
        None if u is None else as_input(u, plant.inputs, 'u'))


def as_system(value: object) -> System:
    """
    Return the system that a function was called with.

    :param value: a System; anything that has one as its `model`, such as a Problem; the name of a
        registered system; a file; a mapping with the keys of a system file or of a problem; or a
        system of python-control.
    :raises StatementError, DynamicsError: if it is something else, or is not valid.
    """
    if isinstance(value, System):
        return value
    if isinstance(value, plant.System):
        return System._of(value)
    if isinstance(value, Path) or isinstance(value, str) and registry.is_file(value):
        return System.from_file(value)
    if isinstance(value, str):
        return System.from_name(value)
    if isinstance(value, Mapping):
        return System._of(_take_plant(convert_numbers(value)))
    if isinstance(value, ocp.Problem):
        return System._of(_take_plant(value.statement))
    if is_of_control(value):
        return System.from_control(value)
    if isinstance(model := getattr(value, 'model', None), plant.System):
        return System._of(model)
    raise StatementError('system: wanted a System, a name, a file, a mapping, a Problem or a '
                         f'system of python-control, found {describe_type(value)}')


def _take_plant(statement: Mapping[Any, Any]) -> plant.System:
    """Return the system of a statement: its own, or the one that it names with its numbers."""
    named = statement.get('system')
    if named is None:
        return build_system({key: statement[key] for key in statement if key not in _OF_PROBLEMS})
    section = statement.get('parameters') or {}
    options = registry.get_options(named) if isinstance(named, str) else {}
    model = as_system(named).model if not options else registry.find_registered(
        named, {key: section[key] for key in options if key in section})
    own = {each.name: each.value for each in model.parameters}
    numbers = dict[str, float]()
    for key in section:
        if key not in options:
            numbers[key] = parse_number(section[key], {**own, **numbers}, f'parameters.{key}')
    model = model.with_parameters({key: numbers[key] for key in own if key in numbers})
    limits = {name: read_bounds(pair, {**own, **numbers}, f'input_bounds.{name}')
              for name, pair in (statement.get('input_bounds') or {}).items()}
    return replace(model, inputs=tuple(
        replace(each, lower=limits[each.name][0], upper=limits[each.name][1])
        if each.name in limits else each for each in model.inputs))


def is_of_control(value: object) -> bool:
    """Return whether an object is one of python-control; it is not imported."""
    return type(value).__module__.partition('.')[0] == 'control'


def choose_names(labels: Sequence[str], letter: str) -> tuple[str, ...]:
    """Return labels if all are names of a statement, otherwise x1, x2, ... of a letter."""
    try:
        return tuple(check_name(label, 'from_control') for label in labels)
    except StatementError:
        return tuple(f'{letter}{k + 1}' for k in range(len(labels)))
