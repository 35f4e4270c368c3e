# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Parameters of mpc_node, and the problem and the control that they specify.

The rows that lqr_node has too are in `controller_settings`.
"""

from dataclasses import asdict, dataclass, replace
import math
from typing import Any

import numpy as np
from obc_ros.core.closed_loop.control import Control, UNPLANNED
from obc_ros.core.closed_loop.feedback import convert_rows, InputLimits, Region, Vector
from obc_ros.core.lqr.design.design import Design, Sampling
from obc_ros.core.lqr.design.set_point import check_set_point
from obc_ros.core.lqr.weights import count
from obc_ros.core.receding.formulation import add_limits
from obc_ros.core.text.errors import StatementError
from obc_ros.nodes.control.controller_settings import (
    check_messages,
    ControllerCandidate,
    ControllerSettings,
    design_regulator_of,
    make_input_limits,
    make_rules,
)
from obc_ros.ros.parameters.node_parameters import declare_field, StartValues
from obc_ros.ros.parameters.system_parameters import choose_node_system, list_system_parameters
from obc_ros.workers.steps.step_supervisor import StepLink
from obc_ros.workers.wire import Packet

FEWEST_STEPS, MOST_STEPS = 2, 1000
SHARE = 0.8   # of a period: the time of a solve without `deadline`


def _read_problem(name: str) -> StartValues:
    from obc_ros.core.receding.restatement import check_restatable, restate_problem
    from obc_ros.ros.parameters.problem_files import list_plant_values, read_problem_file
    found = read_problem_file(name)
    check_restatable(found.problem, found.statement)
    values: dict[str, Any] = list_plant_values(found)
    taken = asdict(restate_problem(found.problem, found.statement, choose_node_system(values)))
    replaced = taken.pop('replaced')
    values |= taken
    given = ', '.join(name for name, value in values.items() if value != ())
    return StartValues(values, f'it gives {given}{"; " * bool(replaced)}{replaced}')


@dataclass(frozen=True)
class Settings(ControllerSettings):
    """The parameters of mpc_node."""

    rate: float = declare_field(
        50.0, 'rate of commands and plans, by the stamps of the states; 0 is not allowed', 'Hz',
        lower=0.0, upper=1000.0, read_only=True)
    horizon: float = declare_field(
        1.0, 'length of a plan; rounded to whole periods', 's', lower=0.0, upper=1e3)
    x_bounds: Vector = declare_field(
        (), 'lower and upper bound of each state (2 n numbers, in its unit), held along the plan '
        'and exceeded only if nothing else is possible; infinite: none; empty: none',
        finite=False)
    path_constraints: tuple[str, ...] = declare_field(
        (), 'expressions of states and inputs that are at most 0 along the plan, such as an '
        "obstacle: '0.25 - (px - 2)**2 - py**2'; exceeded only if nothing else is possible",
        texts=True)
    deadline: float = declare_field(
        0.0, 'time that a solve may take; 0: 0.8 of the period', 's', lower=0.0, upper=10.0)
    on_unplanned: str = declare_field(
        'regulator', 'command while states arrive and there is no plan, outside the terminal set: '
        'the regulator with the limits, or one of those of on_stale', choices=UNPLANNED)
    plan_rate: float = declare_field(
        10.0, 'maximum rate of ~/plan; 0: none is published', 'Hz', lower=0.0)
    problem: str = declare_field(
        '', 'problem file, or name of an example, that gives system, system_parameters, setpoint, '
        'setpoint_input, Qx, Qu, cross, u_limits, x_bounds, path_constraints and horizon; values '
        'that are given besides override it. Empty: none', read_only=True, gives=_read_problem)


@dataclass(frozen=True, eq=False)
class MpcCandidate(ControllerCandidate):
    """
    The problem and the control of a valid set of parameters.

    :ivar design: the sampled regulator behind the plan.
    :ivar control: the control without a plan.
    :ivar problem: what the solver process solves.
    :ivar link: the process that was started for this problem; None before that.
    :ivar ready: the terminal set: array P (n, n), ``level`` and ``sentence``; None before it is
        known.
    """

    problem: Packet
    link: StepLink | None = None
    ready: Packet | None = None

    @property
    def gains(self) -> tuple[Any, ...]:
        """Return the objects that determine the gain."""
        return self.design, self.control.regulator.region

    @property
    def note(self) -> str:
        """Describe plan and terminal set."""
        known = self.ready.plain['sentence'] if self.ready else 'the terminal set is not known yet'
        return (f'plans of {self.problem.plain["steps"]} steps at {self.settings.rate:g} Hz; '
                f'{known}')

    def with_terminal_set(self, ready: Packet) -> 'MpcCandidate':
        """Return the candidate with the terminal set of a prepared process."""
        region = Region(convert_rows(ready.arrays['P']), float(ready.plain['level']))
        regulator = replace(self.control.regulator, region=region)
        return replace(self, control=replace(self.control, regulator=regulator), ready=ready)


def find_solver_priority(priority: int) -> int:
    """Return the real-time priority of the solver process for that of the node; 0: none."""
    return max(1, priority - 2) if priority else 0   # the threads of the node have one less


def judge_mpc_settings(settings: Settings) -> MpcCandidate:
    """Return what parameters specify, without a process and a terminal set; ObcError: rejected."""
    if not settings.rate:
        raise StatementError('rate = 0: wanted the rate of the plans')
    found = design_regulator_of(settings, ('rate',), _find_sampling)
    system = found.plant.system
    check_messages(settings, found.plant)
    check_set_point(found.plant, settings.setpoint, settings.setpoint_input)
    limits = make_input_limits(settings, found.plant)
    # Without a terminal set nothing is known to be safe but the set point itself.
    nowhere = Region(convert_rows(found.lqr.P), 0.0)
    return MpcCandidate(settings, found, Control(
        regulator=replace(found.regulator, region=nowhere), limits=limits,
        rest=found.plant.rest, names=system.state_names,
        rules=replace(make_rules(settings, settings.rate, system.state_names),
                      on_unplanned=settings.on_unplanned),
        longest_period=found.longest_period),
        _state_problem(settings, found, limits))


def _find_sampling(given: dict[str, Any]) -> Sampling:
    return Sampling(1.0 / given['rate'], 0.0, True)


def _state_problem(settings: Settings, found: Design, limits: InputLimits) -> Packet:
    steps = round(settings.horizon * settings.rate)
    if not FEWEST_STEPS <= steps <= MOST_STEPS:
        raise StatementError(
            f'horizon = {settings.horizon:g} s: {steps} periods at {settings.rate:g} Hz; wanted '
            f'{FEWEST_STEPS} to {MOST_STEPS}')
    lower, upper = _bounds(settings.x_bounds, found.plant.system.state_names)
    # The solver process reads them as well, but an inactive node does not wait for its words.
    add_limits(found, steps, {'path_constraints': [
        {'expr': each, 'upper': 0.0} for each in settings.path_constraints]})
    equilibrium = found.plant.equilibrium
    declared = {row.name: row.default
                for row in list_system_parameters({'system': settings.system})}
    return Packet(
        {'system': settings.system, 'parameters': {
             name: value for name, value in settings.system_parameters.items()
             if value != declared.get(name)},
         'setpoint': list(settings.setpoint), 'setpoint_input': list(settings.setpoint_input),
         'period': 1.0 / settings.rate, 'steps': steps,
         'path_constraints': list(settings.path_constraints),
         'deadline': settings.deadline or SHARE / settings.rate},
        {'Qx': found.weights.Qx, 'Qu': found.weights.Qu,
         'cross': np.zeros(0) if found.weights.cross is None else found.weights.cross,
         'xe': np.array(equilibrium.x),
         'ue': np.array(equilibrium.u), 'u_lower': np.array(limits.lower),
         'u_upper': np.array(limits.upper), 'x_lower': np.array(lower),
         'x_upper': np.array(upper)})


def _bounds(given: Vector, names: tuple[str, ...]) -> tuple[Vector, Vector]:
    n = len(names)
    if not given:
        return (-math.inf,) * n, (math.inf,) * n
    if len(given) != 2 * n:
        raise StatementError(f'x_bounds has {count(len(given))}; wanted {2 * n}: lower and upper '
                             f'bound of {", ".join(names)}')
    for name, low, high in zip(names, given[::2], given[1::2], strict=True):
        if not low < high:
            raise StatementError(f'x_bounds of {name}: [{low:g}, {high:g}]; wanted a lower bound '
                                 'below the upper one')
    return given[::2], given[1::2]
