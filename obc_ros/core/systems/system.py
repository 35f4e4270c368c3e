# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A controlled system dx/dt = f(x, u; p) as named CasADi expressions.

Every plant is a `System`: the registered ones, those in files and those in requests.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
import math
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems.robot_fields import read_robot_fields, RobotFields
from obc_ros.core.text.errors import DynamicsError
from obc_ros.core.text.packed_expressions import pack_expressions, PackedExpressions
from obc_ros.core.text.tables import Tabulated

# Of the symbols of states, inputs and parameters: expressions.
_Equations = Callable[[list[ca.SX], list[ca.SX], list[ca.SX]], Sequence[Any]]


@dataclass(frozen=True)
class Signal:
    """A state or an input: name, unit, limits, and whether it is an angle modulo 2 pi."""

    name: str
    unit: str = ''
    lower: float = -math.inf
    upper: float = math.inf
    angle: bool = False
    description: str = ''


@dataclass(frozen=True)
class Parameter:
    """A constant of a system: name, value, unit and admissible range."""

    name: str
    value: float
    unit: str = ''
    lower: float = -math.inf
    upper: float = math.inf
    description: str = ''


@dataclass(frozen=True, eq=False, repr=False)
class System(Tabulated):
    """
    A system dx/dt = f(x, u; p).

    :ivar states, inputs: in the order of x (n,) and u (m,). The limits of an input are those of
        the actuator.
    :ivar parameters: in the order of p, with the values in use.
    :ivar x, u, p: symbols, columns of length n, m and number of parameters.
    :ivar setpoint, setpoint_input: default set point (n,) and initial guess of the input there
        (m,).
    :ivar plane: plane of px, py and theta: 'horizontal' (seen from above, py to the left of px) or
        'vertical' (py up); theta counter-clockwise from px to py. Empty: not a rigid body.
    :ivar rebuild: returns this system with other parameter values. It is needed if limits or the
        set point depend on parameters; None: only `p_value` changes.
    :ivar outputs: what sensors measure, in the order of y (q,). Empty: all states.
    :ivar y: h(x, u; p), shape (q, 1). Without `outputs` it is x.
    """

    _HEADER = ('kind', 'name', 'unit', 'range', 'value')

    name: str
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    parameters: tuple[Parameter, ...]
    x: ca.SX
    u: ca.SX
    p: ca.SX
    xdot: ca.SX
    setpoint: tuple[float, ...]
    setpoint_input: tuple[float, ...]
    description: str = ''
    plane: str = ''
    rebuild: 'Callable[[Mapping[str, float]], System] | None' = None
    outputs: tuple[Signal, ...] = ()
    y: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    robot: RobotFields = RobotFields()

    def __post_init__(self) -> None:
        if not self.outputs:
            object.__setattr__(self, 'outputs', self.states)
            object.__setattr__(self, 'y', self.x)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how another process makes the system, with symbols of its own."""
        commands = self.robot.commands
        packed = pack_expressions((self.x, self.u, self.p), (
            self.xdot, self.y, *(each for message in commands.values()
                                 for each in message.values())))
        numbers = {each.name: getattr(self, each.name) for each in fields(self)
                   if each.name not in ('x', 'u', 'p', 'xdot', 'y', 'robot')}
        return _unpack_system, (packed, numbers, replace(self.robot, commands={}), {
            name: tuple(message) for name, message in commands.items()})

    def _title(self) -> str:
        return f'System {self.name}: {self.description}'.rstrip(': ')

    def _rows(self) -> list[tuple[str, ...]]:
        groups: tuple[tuple[str, Sequence[Signal | Parameter]], ...] = (
            ('state', self.states), ('input', self.inputs), ('parameter', self.parameters),
            ('output', self.outputs))
        return [(kind, each.name, each.unit, f'[{each.lower:g}, {each.upper:g}]', (
            f'{each.value:g}' if isinstance(each, Parameter) else ''))
            for kind, signals in groups for each in signals]

    @property
    def n(self) -> int:
        """Return the number of states."""
        return len(self.states)

    @property
    def m(self) -> int:
        """Return the number of inputs."""
        return len(self.inputs)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Return the names of the states, in order."""
        return tuple(signal.name for signal in self.states)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Return the names of the inputs, in order."""
        return tuple(signal.name for signal in self.inputs)

    @property
    def output_names(self) -> tuple[str, ...]:
        """Return the names of the outputs, in order."""
        return tuple(signal.name for signal in self.outputs)

    @property
    def angles(self) -> tuple[bool, ...]:
        """Return for each state whether it is an angle modulo 2 pi."""
        return tuple(signal.angle for signal in self.states)

    @property
    def units(self) -> dict[str, str]:
        """Return the units of all signals and parameters that have one, by name."""
        named: list[Signal | Parameter] = [
            *self.states, *self.inputs, *self.parameters, *self.outputs]
        return {each.name: each.unit for each in named if each.unit}

    @property
    def u_min(self) -> Array:
        """Return the lower limits of the inputs, shape (m,)."""
        return np.array([signal.lower for signal in self.inputs])

    @property
    def u_max(self) -> Array:
        """Return the upper limits of the inputs, shape (m,)."""
        return np.array([signal.upper for signal in self.inputs])

    @property
    def p_value(self) -> Array:
        """Return the values of the parameters, in order."""
        return np.array([parameter.value for parameter in self.parameters], dtype=float)

    @cached_property
    def _f(self) -> ca.Function:
        return ca.Function('f', [self.x, self.u, self.p], [self.xdot])

    @cached_property
    def _jacobians(self) -> ca.Function:
        fx, fu = ca.jacobian(self.xdot, self.x), ca.jacobian(self.xdot, self.u)
        return ca.Function('jacobians', [self.x, self.u, self.p], [
            ca.densify(each) for each in (fx, fu)])

    @cached_property
    def _h(self) -> ca.Function:
        hx = ca.densify(ca.jacobian(self.y, self.x))
        return ca.Function('h', [self.x, self.u, self.p], [ca.densify(self.y), hx])

    def f(self, x: Array, u: Array) -> Array:
        """Return dx/dt, shape (n,), at state x (n,) and input u (m,)."""
        xdot: Array = self._f(x, u, self.p_value).full().ravel()
        return xdot

    def rates(self, x: Array, u: Array) -> Array:
        """Return dx/dt, shape (N, n), at states x (N, n) and inputs u (N, m)."""
        xdot: Array = self._f.map(len(x))(x.T, u.T, np.tile(self.p_value[:, None], len(x))).full()
        return xdot.T

    def jacobians(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Return (df/dx, df/du), shapes (n, n) and (n, m), at state x and input u."""
        fx, fu = self._jacobians(x, u, self.p_value)
        return fx.full(), fu.full()

    def measure(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Return y = h(x, u), shape (q,), and dh/dx, shape (q, n), at state x and input u."""
        y, hx = self._h(x, u, self.p_value)
        return y.full().ravel(), hx.full()

    def with_parameters(self, values: Mapping[str, float]) -> 'System':
        """Return this system with other values of some parameters."""
        known = {parameter.name: parameter for parameter in self.parameters}
        for name in values:
            if name not in known:
                has = f'it has {", ".join(known)}' if known else 'it has none'
                raise DynamicsError(f"{self.name} has no parameter '{name}'; {has}")
        checked = {name: _in_range(self.name, known[name], value)
                   for name, value in values.items()}
        if self.rebuild is not None:
            return self.rebuild(checked) if checked else self
        return replace(self, parameters=tuple(
            replace(parameter, value=checked.get(parameter.name, parameter.value))
            for parameter in self.parameters))


def _unpack_system(packed: PackedExpressions, numbers: Mapping[str, Any], robot: RobotFields,
                   messages: Mapping[str, Sequence[str]]) -> System:
    (x, u, p), (xdot, y, *rest) = packed.unpack()
    left = iter(rest)
    commands = {name: {each: next(left) for each in message}
                for name, message in messages.items()}
    return System(**numbers, x=x, u=u, p=p, xdot=xdot, y=y,
                  robot=replace(robot, commands=commands))


def define(name: str, states: Sequence[Signal], inputs: Sequence[Signal],
           parameters: Sequence[Parameter], dynamics: _Equations, *,
           setpoint: Sequence[float] | None = None, setpoint_input: Sequence[float] | None = None,
           description: str = '', plane: str = '',
           rebuild: Callable[[Mapping[str, float]], System] | None = None,
           outputs: Sequence[Signal] = (), output_map: _Equations | None = None,
           ros: Mapping[str, Mapping[str, Any]] | None = None) -> System:
    """
    Return the system dx/dt = f(x, u; p) whose f is `dynamics`.

    :param name, description, plane, rebuild: as in `System`.
    :param dynamics: returns the n expressions dx/dt.
    :param output_map: returns the q expressions y. An output that is a state with an angle is an
        angle.
    :param ros: which fields of messages the states and inputs are, as for `read_robot_fields`. The
        state that is the heading of a body in a plane is an angle.
    """
    x, u, p = (ca.vertcat(*(ca.SX.sym(each.name) for each in signals)) if signals else ca.SX(0, 1)
               for signals in (states, inputs, parameters))
    symbols = [ca.vertsplit(each) if each.numel() else [] for each in (x, u, p)]
    xdot: Sequence[ca.SX] = dynamics(*symbols)
    if len(xdot) != len(states):
        raise DynamicsError(
            f'{name}: {len(states)} states but {len(xdot)} derivatives')
    robot = read_robot_fields(
        ros or {}, plane, _by_name(states, symbols[0]), _by_name(inputs, symbols[1]),
        _by_name(parameters, symbols[2]),
        {each.name: each.unit for each in (*states, *inputs) if each.unit})
    states = [replace(each, angle=each.angle or index == robot.heading)
              for index, each in enumerate(states)]
    y = list(output_map(*symbols)) if output_map is not None else []
    if len(y) != len(outputs):
        raise DynamicsError(f'{name}: {len(outputs)} outputs but {len(y)} expressions')
    for parameter in parameters:
        _in_range(name, parameter, parameter.value)
    return System(
        name=name, states=tuple(states), inputs=tuple(inputs), parameters=tuple(parameters),
        x=x, u=u, p=p, xdot=ca.densify(ca.vertcat(*xdot)),
        setpoint=tuple(setpoint or [0.0] * len(states)),
        setpoint_input=tuple(setpoint_input or [0.0] * len(inputs)),
        description=description, plane=robot.plane, rebuild=rebuild, robot=robot,
        outputs=tuple(_describe_output(signal, expression, states, symbols[0])
                      for signal, expression in zip(outputs, y, strict=True)),
        y=ca.vertcat(*y) if y else ca.SX(0, 1))


def _by_name(signals: Sequence[Signal | Parameter], symbols: Sequence[ca.SX]) -> dict[str, ca.SX]:
    return {each.name: symbol for each, symbol in zip(signals, symbols, strict=True)}


def _describe_output(output: Signal, expression: Any, states: Sequence[Signal],
                     symbols: Sequence[ca.SX]) -> Signal:
    """Return an output with unit and angle of the state that it is, if it is one."""
    for state, symbol in zip(states, symbols, strict=True):
        if ca.is_equal(ca.SX(expression), symbol):
            return replace(output, unit=output.unit or state.unit,
                           angle=output.angle or state.angle)
    return output


def _in_range(system: str, parameter: Parameter, value: Any) -> float:
    wanted = f'wanted a number in [{parameter.lower:g}, {parameter.upper:g}] {parameter.unit}'
    if not isinstance(value, (int, float, np.integer)) or isinstance(value, bool):
        raise DynamicsError(f'{system}.{parameter.name} is a {type(value).__name__}: {wanted}')
    if not (math.isfinite(value) and parameter.lower <= value <= parameter.upper):
        raise DynamicsError(f'{system}.{parameter.name} = {value:g}: {wanted}'.rstrip())
    return float(value)
