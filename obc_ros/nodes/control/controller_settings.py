# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Parameters that lqr_node and mpc_node share, and what they specify: plant, limits, rules.

Any robot is protected: if `system` is given, the inputs need limits (`unlimited`), and the command
starts from rest (`transition_time`). Without `system`, the plant is the aircraft of
plant_simulator, which needs neither. Parameter files of simulated plants decline both.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import functools
from typing import Any

from obc_ros.core.closed_loop.control import Control, ENVELOPE, Rules, STALE
from obc_ros.core.closed_loop.feedback import InputLimits, Vector
from obc_ros.core.lqr.design.design import (
    Design,
    design,
    linearize_plant,
    LinearizedPlant,
    Sampling,
)
from obc_ros.core.lqr.design.set_point import (
    check_all_limited,
    describe_set_point,
    resolve_input_limits,
    translate_former_limits,
)
from obc_ros.core.lqr.weights import count, WEIGHT_KINDS
from obc_ros.core.text.errors import StatementError
from obc_ros.nodes.control.command_sinks import Sink, SINKS
from obc_ros.ros.conversions import make_state_reader
from obc_ros.ros.diagnostics import HARDWARE
from obc_ros.ros.execution.subscription_thread import PRIORITY
from obc_ros.ros.parameters.node_parameters import declare_field, group, Value
from obc_ros.ros.parameters.system_parameters import (
    choose_node_system,
    choose_system,
    list_system_parameters,
)
from obc_ros.ros.state_sources import SOURCES, STATE_SOURCE

LEAST_TIMEOUT = 1e-3   # [s] no source of states is faster


@dataclass(frozen=True)
class ControllerSettings:
    """The parameters that both controllers have."""

    system: str = declare_field(
        'aircraft', 'name of a registered system, or path of a YAML file', read_only=True)
    system_parameters: Mapping[str, Value] = group(list_system_parameters)
    setpoint: Vector = declare_field(
        (), 'state to hold: n numbers in SI units and radians; empty: the default of the system, '
        'if that is an equilibrium')
    setpoint_input: Vector = declare_field(
        (), 'input at the set point, if the state does not determine it: m numbers; empty: the '
        'default of the system, if the set point does not move with it')
    weights: str = declare_field('matrices', 'how the weights are given', choices=WEIGHT_KINDS)
    Qx: Vector = declare_field(
        (), 'state weight: n numbers (diagonal) or n*n numbers row by row; empty: identity',
        used_when=(('weights', 'matrices'),))
    Qu: Vector = declare_field(
        (), 'input weight: m numbers (diagonal) or m*m numbers row by row; empty: identity',
        used_when=(('weights', 'matrices'),))
    x_max: Vector = declare_field(
        (), 'acceptable error of each state, in its unit; empty: 1 each', finite=False,
        used_when=(('weights', 'bryson'),))
    u_max: Vector = declare_field(
        (), 'acceptable deviation of each input, in its unit; a scale, not a limit (see '
        'u_limits); empty: 1 each', finite=False, used_when=(('weights', 'bryson'),))
    H: Vector = declare_field(
        (), "output matrix of z = H x in the cost z'z + rho u'u: p*n numbers row by row; empty: "
        'all states',
        used_when=(('weights', 'output'),))
    rho: float = declare_field(
        1.0, "weight of u'u relative to z'z", lower=0.0, used_when=(('weights', 'output'),))
    cross: Vector = declare_field((),
                                  "cross weight N of 2 x'N u: n*m numbers row by row; empty: none")
    state_timeout: float = declare_field(
        0.5, 'age of the last valid state at which on_stale acts, at least 0.001; 0: never, and '
        'states may be any time apart', 's', lower=0.0)
    stamp_timeout: float = declare_field(
        0.5, "maximum difference of a state's stamp and the node's clock; other states are "
        'dropped, at any age. 0: no check, for clocks that are not synchronised. With '
        'use_sim_time there is no check', 's', lower=0.0)
    on_stale: str = declare_field(
        'equilibrium', 'command while no state arrives: the input at rest (equilibrium), the last '
        'command (hold) or none (silent)', choices=STALE,
        used_when=(('state_timeout',),))
    u_limits: Vector = declare_field(
        (), 'limits of the inputs, in their units: the maximum absolute value of each (m '
        'numbers), within the limits of the system; or lower and upper limit of each (2 m '
        'numbers), in place of those. Infinite: the limit of the system; empty: the limits of the '
        'system', finite=False)
    unlimited: bool = declare_field(
        True, 'true: the inputs need no limits', default_given=('system', False))
    x_limits: Vector = declare_field(
        (), 'maximum absolute error of each state (n numbers), or lower and upper limit of each '
        '(2 n numbers), outside which on_envelope acts; empty: none', finite=False)
    on_envelope: str = declare_field(
        'stop', 'action outside x_limits, and when states are too far apart for the gain: stop '
        'until ~/start, or one of those of on_stale', choices=ENVELOPE)
    state_source: str = declare_field(
        'state', STATE_SOURCE, choices=tuple(SOURCES), read_only=True)
    command_sink: str = declare_field(
        'command', 'topic of the commands, with its type: command (Command), cmd_vel '
        '(TwistStamped) or wrench (WrenchStamped), of a system that states their fields',
        choices=tuple(SINKS), read_only=True)
    cmd_vel_stamped: bool = declare_field(
        True, 'true: cmd_vel is a TwistStamped; false: a Twist, which has no stamp',
        read_only=True, used_when=(('command_sink', 'cmd_vel'),))
    transition_time: float = declare_field(
        0.0, 'time in which the jump of the command after a change decays, and the time from rest '
        'to the first command; 0: the command jumps', 's', lower=0.0,
        default_given=('system', 1.0))
    frame_id: str = declare_field(
        '', 'frame_id of the states; empty: that of the first state')
    hardware_id: str = declare_field('', HARDWARE)
    priority: int = declare_field(0, PRIORITY, lower=0, upper=99, read_only=True)
    autostart: bool = declare_field(
        True, 'true: the node configures and activates itself; false: it waits for the lifecycle '
        'services', read_only=True)


@dataclass(frozen=True, eq=False)
class ControllerCandidate:
    """The regulator at the set point and the control of valid parameters, replaced as a whole."""

    settings: Any
    design: Design
    control: Control

    @property
    def gains(self) -> tuple[Any, ...]:
        """Return the objects that determine the gain; they are identical if it is unchanged."""
        raise NotImplementedError

    @property
    def note(self) -> str:
        """Return text for the sentence of the design; empty: none."""
        raise NotImplementedError


def design_regulator_of(settings: ControllerSettings, more: tuple[str, ...],
                        find_sampling: Callable[[dict[str, Any]], Sampling]) -> Design:
    """
    Return the regulator of a controller; one in use is not computed again.

    :param more: names of further parameters that determine it.
    :param find_sampling: gets these parameters by name.
    :raises ObcError: if a parameter is rejected.
    """
    names = (*_PLANT, *_WEIGHTS, *more)
    values = (getattr(settings, name) for name in names)
    return _design(names, tuple(
        tuple(sorted(each.items())) if isinstance(each, Mapping) else each for each in values),
        find_sampling)


_PLANT = ('system', 'system_parameters', 'setpoint', 'setpoint_input')
_WEIGHTS = ('weights', 'Qx', 'Qu', 'cross', 'x_max', 'u_max', 'H', 'rho')


@functools.lru_cache(maxsize=4)
def _design(names: tuple[str, ...], values: tuple[Any, ...],
            find_sampling: Callable[[dict[str, Any]], Sampling]) -> Design:
    given = dict(zip(names, values, strict=True))
    held = _linearize(*(given[name] for name in _PLANT))
    n, m = held.system.n, held.system.m
    # What is missing for a kind of weights is set, so that `weights` can be set before it.
    if given['weights'] == 'bryson':
        given['x_max'], given['u_max'] = given['x_max'] or (1.0,) * n, given['u_max'] or (1.0,) * m
    elif given['weights'] == 'output':
        given['H'] = given['H'] or tuple(float(i == j) for i in range(n) for j in range(n))
    return design(held, {name: given[name] for name in (*_WEIGHTS, 'stability') if name in given},
                  given.get('integral', ()), given.get('Qi', ()), find_sampling(given))


@functools.lru_cache(maxsize=4)
def _linearize(system: str, parameters: tuple[tuple[str, Value], ...], setpoint: Vector,
               setpoint_input: Vector) -> LinearizedPlant:
    return linearize_plant(choose_system(system, dict(parameters)), setpoint, setpoint_input)


def make_input_limits(settings: ControllerSettings, held: LinearizedPlant) -> InputLimits:
    """Return the limits of the inputs; StatementError: wrong size, or missing."""
    angles = tuple(i for i, is_angle in enumerate(held.system.angles) if is_angle)
    lower, upper = resolve_input_limits(held, settings.u_limits)
    if not settings.unlimited:
        check_all_limited(held, settings.u_limits, lower, upper)
    return InputLimits(lower, upper, angles)


def check_messages(settings: ControllerSettings, held: LinearizedPlant) -> None:
    """
    Check that the messages of states and commands are those of a plant, by converting some.

    :raises StatementError: if a message does not determine the state, does not carry an input, or
        is not finite at the set point or at rest.
    """
    make_state_reader(settings.state_source, held.system)
    sink = Sink(settings.command_sink, held.system, settings.cmd_vel_stamped)
    sink.check(held.rest, 'at rest')
    sink.check(held.equilibrium.u, 'of the set point')


def make_rules(settings: ControllerSettings, rate: float, names: tuple[str, ...]) -> Rules:
    """
    Return the rules of a control loop.

    :param rate: maximum rate of the commands [Hz]; 0: a command for every state.
    :raises StatementError: if x_limits are of wrong size or sign, or state_timeout is too short.
    """
    if 0.0 < settings.state_timeout < LEAST_TIMEOUT:
        raise StatementError(f'state_timeout = {settings.state_timeout:g}: wanted 0 (never) or at '
                             f'least {LEAST_TIMEOUT:g} s')
    given, n = settings.x_limits, len(names)
    if len(given) not in (0, n, 2 * n):
        raise StatementError(f'x_limits has {count(len(given))}; wanted {n} or {2 * n}, for '
                             f'{", ".join(names)}')
    bounds = tuple((-each, each) for each in given)
    if len(given) == 2 * n:
        bounds = tuple(zip(given[::2], given[1::2], strict=True))
    for name, (low, high) in zip(names, bounds, strict=False):
        if not low < 0.0 < high:
            raise StatementError(f'x_limits of {name}: [{low:g}, {high:g}]; wanted a negative '
                                 'lower limit and a positive upper limit of the error')
    return Rules(
        period=round(min(1e9 / rate, 1e18)) if rate else 0,
        state_timeout=settings.state_timeout, on_stale=settings.on_stale, x_limits=bounds,
        on_envelope=settings.on_envelope, transition_time=settings.transition_time,
        from_rest=True, stamp_timeout=settings.stamp_timeout)


def explain_former_limits(given: Mapping[str, Any], values: Mapping[str, Value]) -> str:
    """Return an error message if u_min or u_max is given as a limit, as in former versions."""
    names = [name for name in ('u_min', 'u_max') if name in given
             and not (name == 'u_max' and (values['weights'] == 'bryson' or not values['u_max']))]
    if not names:
        return ''
    return translate_former_limits(
        choose_node_system(values), {name: given[name] for name in names})


def describe_opening(candidate: ControllerCandidate) -> str:
    """Describe what a node is about to do: plant, set point, limits, topics and frame."""
    settings, held = candidate.settings, candidate.design.plant
    limits = candidate.control.limits
    bounds = zip(held.system.inputs, limits.lower, limits.upper, strict=True)
    return '; '.join((
        f'system: {held.system.name}', *describe_set_point(held),
        'limits: ' + ', '.join(f'{signal.name} in [{low:g}, {high:g}] {signal.unit}'.rstrip()
                               for signal, low, high in bounds),
        f'source: {settings.state_source}', f'sink: {settings.command_sink}',
        f'frame: {settings.frame_id or "that of the first state"}'))
