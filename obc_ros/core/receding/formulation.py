# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The problem of a receding horizon about a set point: see docs/receding_horizon_theory.md.

State bounds and path constraints are softened: s_i are their excesses, sigma_i their penalties.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
import math
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.lqr.design.design import Design, design, linearize_plant, Sampling
from obc_ros.core.lqr.held_loop import discretize_plant
from obc_ros.core.lqr.sampled import discretize_cost
from obc_ros.core.lqr.weights import Weights
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.runge_kutta import BUTCHER, take_step
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import DynamicsError, StatementError

LONGEST = 1000         # periods of a horizon
_LIMITS = ('state_bounds', 'input_bounds', 'path_constraints')
_ACCURACY = 1e-10      # relative error of a period of the model, by halving its steps
_MOST_STEPS = 64       # of a period


@dataclass(frozen=True, eq=False)
class RecedingProblem:
    """
    A receding horizon about a set point.

    :ivar design: the sampled regulator, whose weights, gain and cost-to-go are used.
    :ivar limits: bounds and path constraints, in its symbols and with its numbers.
    :ivar horizon: number N of periods.
    """

    design: Design
    limits: Problem
    horizon: int

    @property
    def system(self) -> System:
        """Return the system."""
        return self.design.plant.system

    @property
    def period(self) -> float:
        """Return the time for which an input is held [s]."""
        return self.design.sampling.period

    @property
    def xe(self) -> Array:
        """Return the state of the set point at t = 0, shape (n,)."""
        return self.design.plant.equilibrium.x

    @property
    def ue(self) -> Array:
        """Return the input of the set point, shape (m,)."""
        return self.design.plant.equilibrium.u

    @property
    def drift(self) -> Array:
        """Return the rate of the set point, shape (n,)."""
        return self.design.plant.equilibrium.drift

    @property
    def K(self) -> Array:
        """Return the gain of the regulator, shape (m, n)."""
        return self.design.K

    @property
    def P(self) -> Array:
        """Return the cost-to-go of the regulator, shape (n, n)."""
        return self.design.lqr.P

    @cached_property
    def weights(self) -> Weights:
        """Return the weights of a sample, with their cross term."""
        plant = self.design.plant
        return discretize_cost(plant.A, plant.B, self.design.cost, self.period)[2]

    @property
    def input_box(self) -> tuple[Array, Array]:
        """Return the lower and upper bounds of v = u - ue, shape (m,) each."""
        return self.limits.u_lower - self.ue, self.limits.u_upper - self.ue

    @cached_property
    def soft(self) -> 'SoftLimits':
        """Return the softened limits."""
        problem = self.limits
        bounded = np.flatnonzero(np.isfinite(problem.x_lower) | np.isfinite(problem.x_upper))
        rows = ca.vertcat(*(problem.x[int(i)] for i in bounded), problem.path)
        rows = ca.substitute(rows, problem.p, ca.DM(problem.p_value))
        e, v, shift = (ca.SX.sym('e', problem.n), ca.SX.sym('v', problem.m),
                       ca.SX.sym('shift', problem.n))
        at = ca.substitute(rows, ca.vertcat(problem.x, problem.u),
                           ca.vertcat(e + shift + self.xe, v + self.ue))
        names = (*(problem.states[i] for i in bounded),
                 *(f'path_constraints[{k}]' for k in range(problem.path.numel())))
        return SoftLimits(
            names, ca.densify(at), e, v, shift,
            np.concatenate([problem.x_lower[bounded], problem.path_lower]),
            np.concatenate([problem.x_upper[bounded], problem.path_upper]))

    @cached_property
    def model(self) -> ca.Function:
        """Return F(e, v), one period of the error, shape (n, 1)."""
        system, h = self.system, self.period
        e, v = ca.SX.sym('e', system.n), ca.SX.sym('v', system.m)
        f = ca.substitute(
            ca.substitute(system.xdot, system.p, ca.DM(system.p_value)),
            ca.vertcat(system.x, system.u), ca.vertcat(e + self.xe, v + self.ue)
        ) - ca.DM(self.drift)
        z = ca.vertcat(e, v)
        if not ca.symvar(ca.jacobian(f, z)):
            Ad, Bd = discretize_plant(self.design.plant.A, self.design.plant.B, h)
            return ca.Function('model', [e, v], [ca.DM(Ad) @ e + ca.DM(Bd) @ v])
        rate = ca.Function('rate', [e, v], [f])
        return self._integrate(rate, e, v)

    def _integrate(self, rate: ca.Function, e: ca.SX, v: ca.SX) -> ca.Function:
        """Return F with the fewest steps of order 6 whose halving changes little."""
        def build(steps: int) -> ca.Function:
            h, at = ca.SX(self.period / steps), e
            for _ in range(steps):
                at = take_step(BUTCHER, lambda x, _: rate(x, v), at, ca.SX(0), h)[0]
            return ca.Function('model', [e, v], [at])

        points = self._samples()
        coarse, steps = build(1), 1
        while steps < _MOST_STEPS:
            fine = build(2 * steps)
            error = max(float(np.abs((coarse(*p) - fine(*p)).full() / (1.0 + np.abs(
                fine(*p).full()))).max()) for p in points)
            if error <= _ACCURACY:
                return coarse
            coarse, steps = fine, 2 * steps
        raise DynamicsError(
            f'period = {self.period:g}: the motion within a period cannot be computed in '
            f'{_MOST_STEPS} steps; wanted a higher rate')

    def _samples(self) -> list[tuple[Array, Array]]:
        """Return errors and inputs at which the accuracy of the model is measured."""
        random = np.random.default_rng(0)
        lower, upper = (np.where(np.isfinite(bound), bound, sign) for bound, sign in zip(
            self.input_box, (-1.0, 1.0), strict=True))
        return [(random.uniform(-1.0, 1.0, len(self.xe)), lower + part * (upper - lower))
                for part in (0.0, 0.25, 0.5, 0.75, 1.0)]

    def error(self, x: Array, t: float = 0.0) -> Array:
        """Return x - xe - drift t, shape (n,), with angles in [-pi, pi]."""
        e = np.asarray(x, dtype=float) - self.xe - self.drift * t
        for i, angle in enumerate(self.system.angles):
            if angle:
                e[i] = math.remainder(e[i], math.tau)
        return e


@dataclass(frozen=True, eq=False)
class SoftLimits:
    """
    The softened limits lower <= rows(e, v, shift) <= upper, with x = xe + shift + e.

    :ivar names: of the states with bounds and the path constraints.
    :ivar rows, e, v, shift: expressions (r, 1) and their symbols.
    :ivar lower, upper: (r,), -inf and inf for none.
    """

    names: tuple[str, ...]
    rows: ca.SX
    e: ca.SX
    v: ca.SX
    shift: ca.SX
    lower: Array
    upper: Array

    @cached_property
    def of_states(self) -> tuple[int, ...]:
        """Return the rows without an input, which hold at the end of the horizon as well."""
        return tuple(i for i in range(len(self.names)) if not ca.depends_on(self.rows[i], self.v))

    @cached_property
    def at_set_point(self) -> Array:
        """Return the rows at the set point at t = 0, shape (r,)."""
        at = ca.Function('at', [self.e, self.v, self.shift], [self.rows])
        return np.array(at(0, 0, 0)).ravel()


def state_receding_problem(system: System, *, horizon: int, period: float,
                           weights: Mapping[str, Any] | None = None,
                           setpoint: Sequence[float] = (), setpoint_input: Sequence[float] = (),
                           limits: Mapping[str, Any] | None = None) -> RecedingProblem:
    """
    State a receding horizon of some periods [s] for a system.

    :param weights: as for the regulator: Qx, Qu, cross, or others of `weights.choose`.
    :param setpoint, setpoint_input: state (n,) and input (m,); empty: those of the system.
    :param limits: `state_bounds`, `input_bounds`, `path_constraints` as in a problem file.
    :raises StatementError: if a number or a key is wrong.
    :raises DynamicsError: if there is no equilibrium at the set point.
    :raises RefusedDesignError: if there is no gain with verified stability.
    """
    given = dict(limits or {})
    for key in given:
        if key not in _LIMITS:
            raise StatementError(f"limits: '{key}' is not one of {', '.join(_LIMITS)}")
    if isinstance(horizon, bool) or not isinstance(horizon, int) or not 1 <= horizon <= LONGEST:
        raise StatementError(f'horizon = {horizon!r}: wanted a number of periods from 1 to '
                             f'{LONGEST}')
    chosen = dict(weights or {})
    if chosen.get('stability'):
        raise StatementError('stability: a receding horizon has no degree of stability; wanted 0')
    plant = linearize_plant(system, setpoint, setpoint_input)
    return add_limits(design(plant, chosen, sampling=Sampling(period, exact=True)), horizon, given)


def add_limits(found: Design, horizon: int, limits: Mapping[str, Any]) -> RecedingProblem:
    """
    Return the receding horizon of a sampled regulator within limits.

    :param limits: `state_bounds`, `input_bounds`, `path_constraints` as in a problem file.
    :raises StatementError: if a limit cannot be read, or the set point violates it.
    """
    system, xe = found.plant.system, found.plant.equilibrium.x.tolist()
    problem = build_problem({
        'system': system, **limits,
        'final_time': {'free': False, 'value': horizon * found.sampling.period},
        'initial_state': dict(zip(system.state_names, xe, strict=True))})
    if problem.has_clock:
        raise StatementError('t: a receding horizon does not depend on the time; remove t')
    made = RecedingProblem(found, problem, horizon)
    _check_set_point(made)
    return made


def _check_set_point(made: RecedingProblem) -> None:
    """Raise StatementError if the set point violates a limit at t = 0."""
    limits, soft = made.limits, made.soft
    for name, value, low, high in zip(limits.inputs, made.ue, limits.u_lower, limits.u_upper,
                                      strict=True):
        if not low <= value <= high:
            raise StatementError(f'input_bounds.{name}: the set point needs {value:.6g}, outside '
                                 f'[{low:g}, {high:g}]')
    for name, value, low, high in zip(soft.names, soft.at_set_point, soft.lower, soft.upper,
                                      strict=True):
        if not low <= value <= high:
            raise StatementError(f'{name}: {value:.6g} at the set point, outside '
                                 f'[{low:g}, {high:g}]')
