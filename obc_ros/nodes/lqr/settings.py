# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Parameters of lqr_node, and the control that they specify.

The module is long because each parameter has its bounds, its meaning and its check here.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
import functools
import math
from typing import Any

from obc_ros.core.closed_loop.control import (
    Control,
    ENVELOPE,
    Horizon,
    Leg,
    Rules,
    Schedule,
    STALE,
)
from obc_ros.core.closed_loop.feedback import (
    convert_rows,
    convert_vector,
    Gains,
    InputLimits,
    Vector,
)
from obc_ros.core.lqr.design.design import (
    Design,
    design,
    linearize_plant,
    LinearizedPlant,
    Sampling,
    schedule_gains,
)
from obc_ros.core.lqr.design.input_limits import (
    check_all_limited,
    resolve_input_limits,
    translate_former_limits,
)
from obc_ros.core.lqr.design.reference_checks import compute_allowed_error
from obc_ros.core.lqr.design.reference_tracking import (
    compute_horizon_law,
    compute_tracking_law,
    Course,
)
from obc_ros.core.lqr.design.set_point import check_set_point, describe_set_point
from obc_ros.core.lqr.weights import count, square, WEIGHT_KINDS
from obc_ros.core.riccati.checks import check_semidefinite
from obc_ros.core.text.errors import quote, StatementError
from obc_ros.msg import LqrWeights
from obc_ros.nodes.lqr.topics import ROBOTS, Sink, SINKS
from obc_ros.ros.conversions import choose_system, list_system_parameters
from obc_ros.ros.hardware_id import HARDWARE
from obc_ros.ros.parameters.conditions import is_used
from obc_ros.ros.parameters.node_parameters import declare_field, group, Value
from obc_ros.ros.state_sources import SOURCES, STATE_SOURCE
from obc_ros.ros.subscription_thread import PRIORITY

DESIGNS = ('continuous', 'sampled')


@dataclass(frozen=True)
class Settings:
    """The parameters of lqr_node."""

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
    cross: Vector = declare_field((),
                                  "cross weight N of 2 x'N u: n*m numbers row by row; empty: none")
    x_max: Vector = declare_field(
        (), 'acceptable error of each state, in its unit; empty: 1 each', finite=False,
        used_when=(('weights', 'bryson'),))
    u_max: Vector = declare_field(
        (), 'acceptable deviation of each input, in its unit; a scale, not a limit (see '
        'u_limits); empty: 1 each', finite=False, used_when=(('weights', 'bryson'),))
    H: Vector = declare_field(
        (), "output matrix of z = H x in the cost z'z + rho u'u: p*n numbers row by row",
        used_when=(('weights', 'output'),))
    rho: float = declare_field(
        1.0, "weight of u'u relative to z'z", lower=0.0, used_when=(('weights', 'output'),))
    stability: float = declare_field(
        0.0, 'prescribed degree of stability: the real parts of all poles are below its negative',
        '1/s', lower=0.0)
    integral: tuple[str, ...] = declare_field(
        (), 'names of the states with integral action', texts=True)
    Qi: Vector = declare_field(
        (), 'weights of the integral states; empty: 1 each', used_when=(('integral',),))
    design: str = declare_field('continuous', 'time domain of the design', choices=DESIGNS)
    rate: float = declare_field(
        0.0, 'maximum rate of commands, by the stamps of the states; 0: one for every state',
        'Hz', lower=0.0)
    sample_time: float = declare_field(
        0.0, 'sampling period of the design, if design is sampled or delay is set; 0: 1/rate', 's',
        lower=0.0, used_when=(('design', 'sampled'), ('delay',)))
    delay: float = declare_field(
        0.0, 'known time from a command to its effect', 's', lower=0.0)
    horizon: float = declare_field(
        0.0, 'time to reach the set point with a time-varying gain, from a change of the set '
        'point or a start; then the constant gain is used. 0: always the constant gain', 's',
        lower=0.0, upper=1e6)
    P1: Vector = declare_field(
        (), 'terminal weight of the horizon or of a reference: n numbers (diagonal) or n*n '
        'numbers row by row; empty: the infinite-horizon cost matrix P at the final set point')
    schedule: str = declare_field(
        '', 'scheduling variable of the gain: an input (such as v of the vehicle), from odom or '
        'from the last command, or a parameter of the system that odom measures as the forward '
        'speed (v of vehicle_lateral); empty: none')
    schedule_range: Vector = declare_field(
        (), 'minimum and maximum of the scheduling variable; outside, the nearest gain is used',
        used_when=(('schedule',),))
    state_timeout: float = declare_field(
        0.5, 'age of the last valid state at which on_stale acts; 0: never', 's', lower=0.0)
    stamp_timeout: float = declare_field(
        0.5, "maximum difference of a state's stamp and the node's clock; other states are "
        "dropped. 0: no check. There is no check in simulated time, and for differences above one "
        'hour', 's', lower=0.0)
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
        False, 'true: the inputs of a robot need no limits',
        used_when=(('command_sink', *ROBOTS),))
    x_limits: Vector = declare_field(
        (), 'maximum absolute error of each state (n numbers), or lower and upper limit of each '
        '(2 n numbers), outside which on_envelope acts; empty: none', finite=False)
    on_envelope: str = declare_field(
        'stop', 'action outside x_limits: stop until ~/start, or one of those of on_stale',
        choices=ENVELOPE, used_when=(('x_limits',),))
    start_tolerance: Vector = declare_field(
        (), 'maximum distance of each state from a reference, in its unit (n numbers), at the '
        'start and when its inputs are applied; other references are rejected. If it is exceeded '
        'when states return after state_timeout, the node stops until ~/start. Empty: x_limits, '
        'else a tenth of the range of the state along the reference (a range below 1 counts as 1)',
        lower=0.0, finite=False)
    state_source: str = declare_field(
        'state', STATE_SOURCE, choices=tuple(SOURCES), read_only=True)
    command_sink: str = declare_field(
        'command', 'topic of the commands, with its type: command (Command), cmd_vel '
        '(TwistStamped, the vehicle) or wrench (WrenchStamped, the aircraft)',
        choices=tuple(SINKS), read_only=True)
    cmd_vel_stamped: bool = declare_field(
        True, 'true: cmd_vel is a TwistStamped; false: a Twist, which has no stamp',
        read_only=True, used_when=(('command_sink', 'cmd_vel'),))
    transition_time: float = declare_field(
        0.0, 'time in which the jump of the command after a change decays, and the time from rest '
        'to the first command of a robot; 0: the command jumps', 's', lower=0.0,
        default_when=(('command_sink', *ROBOTS), 1.0))
    frame_id: str = declare_field(
        '', 'frame_id of the states; empty: that of the first state')
    hardware_id: str = declare_field('', HARDWARE)
    priority: int = declare_field(0, PRIORITY, lower=0, upper=99, read_only=True)
    autostart: bool = declare_field(
        True, 'true: the node configures and activates itself; false: it waits for the lifecycle '
        'services', read_only=True)


@dataclass(frozen=True, eq=False)
class LqrCandidate:
    """The design and control of a valid set of parameters."""

    settings: Settings
    design: Design
    control: Control

    @property
    def gains(self) -> tuple[Any, ...]:
        """Return the objects that determine the gain; they are identical if it is unchanged."""
        return self.design, self.control.horizon, self.control.schedule

    @property
    def note(self) -> str:
        """Describe horizon and schedule; empty without both."""
        words, settings = [], self.settings
        if self.control.horizon is not None:
            words.append(f'time-varying gain over a horizon of {settings.horizon:g} s')
        if self.control.schedule is not None:
            low, high = settings.schedule_range
            words.append(f'the gain follows {settings.schedule} from {low:g} to {high:g}: '
                         f'{_table(settings, self.design)[1]}')
        return '; '.join(words)


def judge_lqr_settings(settings: Settings, courses: tuple[Course, ...] = ()) -> LqrCandidate:
    """
    Return the design and the control for a set of parameters.

    Parameters
    ----------
    settings : Settings
        The parameters.
    courses : tuple of Course
        The references to follow, in the order of their beginnings.

    Returns
    -------
    LqrCandidate

    Raises
    ------
    ObcError
        If a parameter or a reference is rejected; the message names the parameter.

    """
    found = _design(*(_key(getattr(settings, name)) for name in _DESIGN))
    Sink(settings.command_sink, found.plant.system)  # raises if it does not carry the inputs
    check_set_point(found.plant, settings.setpoint, settings.setpoint_input)
    if settings.P1:
        n = found.plant.system.n
        check_semidefinite('P1', square('P1', settings.P1, n), n)
    if settings.horizon and settings.schedule:
        raise StatementError('horizon and schedule: wanted one or the other')
    rules = _rules(settings, found.plant.system.state_names)
    return LqrCandidate(settings, found, Control(
        regulator=found.regulator,
        limits=_limits(settings, found.plant),
        rest=found.plant.rest,
        names=found.plant.system.state_names,
        rules=rules,
        legs=tuple(_judged(each, found, settings, rules) for each in courses),
        C=convert_rows(found.C),
        prediction=found.prediction,
        horizon=_horizon(found, settings.horizon, settings.P1) if settings.horizon else None,
        schedule=_table(settings, found)[0] if settings.schedule else None))


def explain_former_limits(given: Mapping[str, Any], values: Mapping[str, Value]) -> str:
    """
    Return an error message if u_min or u_max is given as a limit, as in former versions.

    Parameters
    ----------
    given : mapping
        Given values by name, of any type.
    values : mapping
        All parameters by name.

    Returns
    -------
    str
        Empty: neither is given as a limit.

    """
    names = [name for name in ('u_min', 'u_max') if name in given
             and not (name == 'u_max' and (values['weights'] == 'bryson' or not values['u_max']))]
    if not names:
        return ''
    system = choose_system(str(values['system']), {
        name.partition('.')[2]: value for name, value in values.items()
        if name.startswith('system_parameters.')})
    return translate_former_limits(system, {name: given[name] for name in names})


def describe_opening(candidate: LqrCandidate) -> str:
    """
    Describe what a node is about to do: plant, set point, limits, topics and frame.

    Parameters
    ----------
    candidate : LqrCandidate
        The adopted settings.

    Returns
    -------
    str

    """
    settings, held = candidate.settings, candidate.design.plant
    limits = candidate.control.limits
    bounds = zip(held.system.inputs, limits.lower, limits.upper, strict=True)
    return '; '.join((
        f'system: {held.system.name}', *describe_set_point(held),
        'limits: ' + ', '.join(f'{signal.name} in [{low:g}, {high:g}] {signal.unit}'.rstrip()
                               for signal, low, high in bounds),
        f'source: {settings.state_source}', f'sink: {settings.command_sink}',
        f'frame: {settings.frame_id or "that of the first state"}'))


def describe_ending(course: Course, candidate: LqrCandidate) -> str:
    """
    Describe what happens at the end of a reference.

    Parameters
    ----------
    course : Course
        The reference.
    candidate : LqrCandidate
        The settings that follow it.

    Returns
    -------
    str
        A clause.

    """
    return _leg(course, candidate.design, candidate.settings.P1)[1]


def apply_request(weights: LqrWeights, now: Settings) -> dict[str, Any]:
    """
    Return the settings that a message specifies; its empty fields change nothing.

    Parameters
    ----------
    weights : LqrWeights
        The message.
    now : Settings
        The present settings.

    Returns
    -------
    dict
        Changed settings by name.

    Raises
    ------
    StatementError
        If a given field is not used with the kind of the weights.

    """
    given: dict[str, Any] = {
        'weights': weights.weights, 'rho': weights.rho, 'stability': weights.stability,
        **{name: tuple(getattr(weights, name.lower())) for name in (
            'Qx', 'Qu', 'cross', 'x_max', 'u_max', 'H')}}
    found = {name: value for name, value in given.items() if value not in ('', 0.0, ())}
    kind = {'weights': weights.weights or now.weights}
    for name, row in Settings.__dataclass_fields__.items():
        if name in found and not is_used(row.metadata['entry'].used_when, kind):
            raise StatementError(f'{name} is not used with weights = {kind["weights"]}')
    return found


_PLANT = ('system', 'system_parameters', 'setpoint', 'setpoint_input')
_WEIGHTS = ('weights', 'Qx', 'Qu', 'cross', 'x_max', 'u_max', 'H', 'rho', 'stability')
_DESIGN = (*_PLANT, *_WEIGHTS, 'integral', 'Qi', 'design', 'rate', 'sample_time', 'delay')


def _key(value: Any) -> Any:
    return tuple(sorted(value.items())) if isinstance(value, Mapping) else value


@functools.lru_cache(maxsize=4)
def _plant(system: str, parameters: tuple[tuple[str, Value], ...], setpoint: Vector,
           setpoint_input: Vector) -> LinearizedPlant:
    return linearize_plant(choose_system(system, dict(parameters)), setpoint, setpoint_input)


@functools.lru_cache(maxsize=4)  # a design in use is not computed again
def _design(*values: Any) -> Design:
    given = dict(zip(_DESIGN, values, strict=True))
    held = _plant(*(given[name] for name in _PLANT))
    if given['weights'] == 'bryson':  # It can be set before x_max and u_max.
        given['x_max'] = given['x_max'] or (1.0,) * held.system.n
        given['u_max'] = given['u_max'] or (1.0,) * held.system.m
    return design(held, {name: given[name] for name in _WEIGHTS}, given['integral'], given['Qi'],
                  _sampling(given['design'] == 'sampled', given['rate'], given['sample_time'],
                            given['delay']))


def _sampling(exact: bool, rate: float, sample_time: float, delay: float) -> Sampling:
    period = 1.0 / rate if rate else 0.0
    if sample_time < period * (1.0 - 1e-9) and sample_time:
        raise StatementError(f'sample_time = {sample_time:g}: with rate = {rate:g} commands are '
                             f'{period:g} s apart or more')
    # sample_time has no effect on a continuous design without delay. It can therefore be set
    # before `design`, and `design` before a rate at which the continuous gain is unstable.
    return Sampling(sample_time or period if exact or delay else period, delay, exact)


def _judged(course: Course, found: Design, settings: Settings, rules: Rules) -> Leg:
    """Return the law along a reference, with the bounds of the error at its beginning."""
    system = found.plant.system
    return replace(_leg(course, found, settings.P1)[0],
                   allowed=compute_allowed_error(course, rules.x_limits, settings.start_tolerance),
                   units=tuple(signal.unit for signal in system.states))


@functools.lru_cache(maxsize=4)
def _leg(course: Course, found: Design, P1: Vector) -> tuple[Leg, str]:
    return compute_tracking_law(course, found,
                                square('P1', P1, found.plant.system.n) if P1 else None)


@functools.lru_cache(maxsize=4)
def _horizon(found: Design, time: float, P1: Vector) -> Horizon:
    return compute_horizon_law(found, time, square('P1', P1, found.plant.system.n) if P1 else None)


def _table(settings: Settings, found: Design) -> tuple[Schedule, str]:
    """Return the schedule of a design, and the verified properties as a clause."""
    if len(settings.schedule_range) != 2:
        raise StatementError(f'schedule_range has {count(len(settings.schedule_range))}; wanted '
                             'the lowest and the highest value')
    return _scheduled(found, settings.schedule, settings.schedule_range, settings.setpoint,
                      settings.setpoint_input, settings.state_source == 'odom')


@functools.lru_cache(maxsize=4)
def _scheduled(found: Design, name: str, between: Vector, setpoint: Vector,
               setpoint_input: Vector, is_measured: bool) -> tuple[Schedule, str]:
    system = found.plant.system
    known = {each.name: each for each in (*system.inputs, *system.parameters)}
    if name not in known:
        raise StatementError(f"schedule: {system.name} has no input or parameter '{quote(name)}'; "
                             f'it has {", ".join(known)}')
    index = system.input_names.index(name) if name in system.input_names else -1
    if is_measured and known[name].unit != 'm/s':
        raise StatementError(f'schedule = {name}: odometry measures a speed in m/s only')
    if index < 0 and not is_measured:
        raise StatementError(f'schedule = {name}: a State does not contain this parameter; set '
                             'state_source = odom')
    made = schedule_gains(found, _plant_at(found, name, index, setpoint, setpoint_input), *between)
    changes = ('for any rate of change' if made.rate == math.inf else
               f'for rates of change up to {made.rate:.3g} per second')
    gains = Gains(convert_vector(made.values),
                  tuple(convert_rows(K[:, :system.n]) for K in made.K),
                  tuple(convert_rows(K[:, system.n:]) if len(found.C) else () for K in made.K))
    return (Schedule(gains, index),
            f'{len(made.values)} gains, stability verified on this range {changes}')


def _plant_at(found: Design, name: str, index: int, setpoint: Vector, setpoint_input: Vector
              ) -> Callable[[float], LinearizedPlant]:
    """Return the plant as a function of the value of an input or, below 0, a parameter."""
    system, ue = found.plant.system, found.plant.equilibrium.u

    def at(value: float) -> LinearizedPlant:
        if index < 0:
            return linearize_plant(system.with_parameters({name: value}), setpoint, setpoint_input)
        wanted = (*ue[:index], value, *ue[index + 1:])
        there = linearize_plant(system, setpoint, wanted)
        if there.equilibrium.u[index] != value:
            raise StatementError(f'schedule = {name}: the set point determines this input')
        return there

    return at


def _limits(settings: Settings, held: LinearizedPlant) -> InputLimits:
    angles = tuple(i for i, is_angle in enumerate(held.system.angles) if is_angle)
    lower, upper = resolve_input_limits(held, settings.u_limits)
    if settings.command_sink in ROBOTS and not settings.unlimited:
        check_all_limited(held, settings.u_limits, lower, upper, settings.command_sink)
    return InputLimits(lower, upper, angles)


def _rules(settings: Settings, names: tuple[str, ...]) -> Rules:
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
    _sized('start_tolerance', settings.start_tolerance, names)
    return Rules(
        period=round(min(1e9 / settings.rate, 1e18)) if settings.rate else 0,
        state_timeout=settings.state_timeout, on_stale=settings.on_stale, x_limits=bounds,
        on_envelope=settings.on_envelope, transition_time=settings.transition_time,
        from_rest=settings.command_sink in ROBOTS,
        stamp_timeout=settings.stamp_timeout)


def _sized(name: str, given: Vector, names: tuple[str, ...]) -> Vector:
    if len(given) not in (0, len(names)):
        raise StatementError(
            f'{name} has {count(len(given))}; wanted {len(names)} ({", ".join(names)})')
    return given
