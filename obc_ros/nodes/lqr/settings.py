# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Parameters of lqr_node, and the control that they specify, with its gain schedule.

The rows that mpc_node has too are in `controller_settings`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
import functools
import math
from typing import Any

from obc_ros.core.closed_loop.control import Control, Horizon, Leg, Rules, Schedule
from obc_ros.core.closed_loop.feedback import convert_rows, convert_vector, Gains, Vector
from obc_ros.core.lqr.design.design import (
    Design,
    linearize_plant,
    LinearizedPlant,
    Sampling,
    schedule_gains,
)
from obc_ros.core.lqr.design.reference_checks import compute_allowed_error
from obc_ros.core.lqr.design.reference_tracking import (
    compute_horizon_law,
    compute_tracking_law,
    Course,
)
from obc_ros.core.lqr.design.set_point import check_set_point
from obc_ros.core.lqr.weights import count, square
from obc_ros.core.riccati.checks import check_semidefinite
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import quote, StatementError
from obc_ros.msg import LqrWeights
from obc_ros.nodes.control.controller_settings import (
    check_messages,
    ControllerCandidate,
    ControllerSettings,
    design_regulator_of,
    make_input_limits,
    make_rules,
)
from obc_ros.ros.parameters.node_parameters import declare_field
from obc_ros.ros.parameters.table import is_used

DESIGNS = ('continuous', 'sampled')


@dataclass(frozen=True)
class Settings(ControllerSettings):
    """The parameters of lqr_node."""

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
        (), 'minimum and maximum of the scheduling variable; outside, the nearest gain is used. '
        'Empty: the constant gain',
        used_when=(('schedule',),))
    start_tolerance: Vector = declare_field(
        (), 'maximum distance of each state from a reference, in its unit (n numbers), at the '
        'start and when its inputs are applied; other references are rejected. If it is exceeded '
        'when states return after state_timeout, the node stops until ~/start. Empty: x_limits, '
        'else a tenth of the range of the state along the reference (a range below 1 counts as 1)',
        lower=0.0, finite=False)


@dataclass(frozen=True, eq=False)
class LqrCandidate(ControllerCandidate):
    """The design and control of a valid set of parameters."""

    @property
    def gains(self) -> tuple[Any, ...]:
        """Return the objects that determine the gain."""
        return self.design, self.control.horizon, self.control.schedule

    @property
    def note(self) -> str:
        """Describe horizon and schedule; empty without both."""
        words, settings = [], self.settings
        if self.control.horizon is not None:
            words.append(f'time-varying gain over a horizon of {settings.horizon:g} s')
        if settings.schedule:
            words.append(make_schedule(self.design, settings)[1])
        return '; '.join(words)


def judge_lqr_settings(settings: Settings, courses: tuple[Course, ...] = ()) -> LqrCandidate:
    """Return design and control for parameters and references, in order; ObcError: rejected."""
    found = design_regulator_of(settings, _DESIGN, _find_sampling)
    check_messages(settings, found.plant)
    check_set_point(found.plant, settings.setpoint, settings.setpoint_input)
    if settings.P1:
        n = found.plant.system.n
        check_semidefinite('P1', square('P1', settings.P1, n), n)
    if settings.horizon and settings.schedule:
        raise StatementError('horizon and schedule: wanted one or the other')
    names = found.plant.system.state_names
    rules = make_rules(settings, settings.rate, names)
    if len(settings.start_tolerance) not in (0, len(names)):
        raise StatementError(f'start_tolerance has {count(len(settings.start_tolerance))}; wanted '
                             f'{len(names)} ({", ".join(names)})')
    return LqrCandidate(settings, found, Control(
        regulator=found.regulator,
        limits=make_input_limits(settings, found.plant),
        rest=found.plant.rest,
        names=names,
        rules=rules,
        legs=tuple(_judged(each, found, settings, rules) for each in courses),
        C=convert_rows(found.C),
        prediction=found.prediction,
        horizon=_horizon(found, settings.horizon, settings.P1) if settings.horizon else None,
        schedule=make_schedule(found, settings)[0],
        longest_period=math.inf if settings.schedule else found.longest_period))


def describe_ending(course: Course, candidate: LqrCandidate) -> str:
    """Return a clause on what happens at the end of a reference."""
    return _leg(course, candidate.design, candidate.settings.P1)[1]


def apply_request(weights: LqrWeights, now: Settings) -> dict[str, Any]:
    """Return by name the settings that a message changes; empty fields change nothing."""
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


_DESIGN = ('stability', 'integral', 'Qi', 'design', 'rate', 'sample_time', 'delay')


def _find_sampling(given: dict[str, Any]) -> Sampling:
    rate, sample_time, delay = given['rate'], given['sample_time'], given['delay']
    exact, period = given['design'] == 'sampled', 1.0 / rate if rate else 0.0
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
    return compute_tracking_law(
        course, found, square('P1', P1, found.plant.system.n) if P1 else None)


@functools.lru_cache(maxsize=4)
def _horizon(found: Design, time: float, P1: Vector) -> Horizon:
    return compute_horizon_law(found, time, square('P1', P1, found.plant.system.n) if P1 else None)


def make_schedule(found: Design, settings: Settings) -> tuple[Schedule | None, str]:
    """
    Return the schedule of a design, and the verified properties as a clause.

    :param found: the design at the set point.
    :return: schedule: the gains; None: the gain is constant, for want of a variable or its range;
        clause: for the sentence of the design; empty without a variable.
    :raises ObcError: if there is no such schedule.
    """
    if not settings.schedule:
        return None, ''
    is_measured = settings.state_source == 'odom'
    index = _find_variable(found.plant.system, settings.schedule, is_measured)
    if not settings.schedule_range:
        return None, f'the gain does not follow {settings.schedule} without schedule_range'
    if len(settings.schedule_range) != 2:
        raise StatementError(f'schedule_range has {count(len(settings.schedule_range))}; wanted '
                             'the lowest and the highest value')
    return _scheduled(found, settings.schedule, index, settings.schedule_range, settings.setpoint,
                      settings.setpoint_input)


def _find_variable(system: System, name: str, is_measured: bool) -> int:
    """Return the index of the input that is the scheduling variable; -1: a parameter is."""
    units = {each.name: each.unit for each in system.inputs}
    units |= {each.name: each.unit for each in system.parameters}
    if name not in units:
        raise StatementError(f"schedule: {system.name} has no input or parameter '{quote(name)}'; "
                             f'it has {", ".join(units)}')
    index = system.input_names.index(name) if name in system.input_names else -1
    if is_measured and units[name] != 'm/s':
        raise StatementError(f'schedule = {name}: odometry measures a speed in m/s only')
    if index < 0 and not is_measured:
        raise StatementError(f'schedule = {name}: a State does not contain this parameter; set '
                             'state_source = odom')
    return index


@functools.lru_cache(maxsize=4)
def _scheduled(found: Design, name: str, index: int, between: Vector, setpoint: Vector,
               setpoint_input: Vector) -> tuple[Schedule, str]:
    made = schedule_gains(found, _plant_at(found, name, index, setpoint, setpoint_input), *between)
    changes = ('for any rate of change' if made.rate == math.inf else
               f'for rates of change up to {made.rate:.3g} per second')
    n = found.plant.system.n
    gains = Gains(convert_vector(made.values),
                  tuple(convert_rows(K[:, :n]) for K in made.K),
                  tuple(convert_rows(K[:, n:]) if len(found.C) else () for K in made.K))
    low, high = between
    return Schedule(gains, index), (
        f'the gain follows {name} from {low:g} to {high:g}: {len(made.values)} gains, stability '
        f'verified on this range {changes}')


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
