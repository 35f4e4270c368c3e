# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Parameters of lqr_node, and the control that they specify.

The rows that mpc_node has too are in `controller_settings`.
"""

from dataclasses import dataclass, replace
import functools
import math
from typing import Any

from obc_ros.core.closed_loop.control import Control, Horizon, Leg, Rules
from obc_ros.core.closed_loop.feedback import convert_rows, Vector
from obc_ros.core.lqr.design.design import Design, design, Sampling
from obc_ros.core.lqr.design.reference_checks import compute_allowed_error
from obc_ros.core.lqr.design.reference_tracking import (
    compute_horizon_law,
    compute_tracking_law,
    Course,
)
from obc_ros.core.lqr.design.set_point import check_set_point
from obc_ros.core.lqr.weights import count, square
from obc_ros.core.riccati.checks import check_semidefinite
from obc_ros.core.text.errors import StatementError
from obc_ros.msg import LqrWeights
from obc_ros.nodes.control.controller_settings import (
    check_messages,
    ControllerSettings,
    fill_weights,
    linearize_system,
    make_input_limits,
    make_key,
    make_rules,
)
from obc_ros.nodes.lqr.gain_schedule import make_schedule
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
        if settings.schedule:
            words.append(make_schedule(self.design, settings)[1])
        return '; '.join(words)


def judge_lqr_settings(settings: Settings, courses: tuple[Course, ...] = ()) -> LqrCandidate:
    """
    Return the design and the control for a set of parameters.

    :param settings: the parameters.
    :param courses: the references to follow, in the order of their beginnings.
    :raises ObcError: if a parameter or a reference is rejected; the message names the parameter.
    """
    found = _design(*(make_key(getattr(settings, name)) for name in _DESIGN))
    check_messages(settings, found.plant)
    check_set_point(found.plant, settings.setpoint, settings.setpoint_input)
    if settings.P1:
        n = found.plant.system.n
        check_semidefinite('P1', square('P1', settings.P1, n), n)
    if settings.horizon and settings.schedule:
        raise StatementError('horizon and schedule: wanted one or the other')
    names = found.plant.system.state_names
    rules = make_rules(settings, settings.rate, names)
    _check_size('start_tolerance', settings.start_tolerance, names)
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
    """
    Describe what happens at the end of a reference.

    :param course: the reference.
    :param candidate: the settings that follow it.
    :return: a clause.
    """
    return _leg(course, candidate.design, candidate.settings.P1)[1]


def apply_request(weights: LqrWeights, now: Settings) -> dict[str, Any]:
    """
    Return the settings that a message specifies; its empty fields change nothing.

    :param weights: the message.
    :param now: the present settings.
    :return: changed settings by name.
    :raises StatementError: if a given field is not used with the kind of the weights.
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


@functools.lru_cache(maxsize=4)  # a design in use is not computed again
def _design(*values: Any) -> Design:
    given = dict(zip(_DESIGN, values, strict=True))
    held = linearize_system(*(given[name] for name in _PLANT))
    fill_weights(given, held)
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


def _check_size(name: str, given: Vector, names: tuple[str, ...]) -> None:
    if len(given) not in (0, len(names)):
        raise StatementError(
            f'{name} has {count(len(given))}; wanted {len(names)} ({", ".join(names)})')
