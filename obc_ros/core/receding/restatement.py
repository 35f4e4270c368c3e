# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What a receding horizon takes of an optimal control problem.

The running cost must be L(z) = (z - ze)'W (z - ze) + constant with z = (x, u). Its minimum ze is
the set point, which the plant must hold, and W has the weights Qx, Qu and cross. If several z are
minima, ze is the one nearest to the set point of the system.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.closed_loop.feedback import Vector
from obc_ros.core.lqr.design.design import linearize_plant
from obc_ros.core.lqr.design.set_point import check_set_point
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.instructions import Instructions
from obc_ros.core.numerics.rounding import EPS
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.systems.system import System
from obc_ros.core.text.comparisons import state_comparisons
from obc_ros.core.text.errors import ObcError, StatementError
from obc_ros.core.text.expressions import insert_numbers

_EXACT = 1e-9       # relative: rounding errors of the cost
_AS_GIVEN = 1e-5    # relative: an input in the cost may be written with six digits
_REMOVED = {
    'initial_cost': 'has no cost of the initial state', 'periodic': 'is not periodic',
    'initial_constraints': 'begins at the measured state',
    'boundary_constraints': 'begins at the measured state'}


@dataclass(frozen=True)
class Restatement:
    """
    A problem as the parameters of a receding horizon.

    :ivar setpoint, setpoint_input: state (n,) and input (m,) at the minimum of the running cost;
        no input if the state determines it.
    :ivar Qx, Qu, cross: weights: a diagonal, or all entries row by row; an empty `cross` is 0.
    :ivar x_bounds, u_limits: lower and upper bound of each state (2 n) and input (2 m) in turn;
        empty: none, and those of the system.
    :ivar path_constraints: expressions of states, inputs and parameters of the system that are at
        most 0.
    :ivar replaced: what of the problem is replaced, in words; empty: nothing.
    """

    setpoint: Vector
    setpoint_input: Vector
    Qx: Vector
    Qu: Vector
    cross: Vector
    x_bounds: Vector
    u_limits: Vector
    path_constraints: tuple[str, ...]
    horizon: float
    replaced: str


def check_restatable(problem: Problem, statement: Mapping[str, Any]) -> None:
    """
    Raise StatementError for what a receding horizon cannot take; the message begins with the key.

    `statement` has the keys and values from which the problem was built.
    """
    if problem.phases is not None:
        raise StatementError('phases: a receding horizon has one phase; give one final_time')
    if problem.free_parameters:
        raise StatementError('free_parameters: a receding horizon has none; give their values in '
                             'parameters')
    if problem.final_time.free:
        raise StatementError('final_time: a receding horizon has a given length; wanted '
                             '{free: false, value: ...}')
    if problem.has_clock:
        raise StatementError('t: a receding horizon does not depend on the time; remove t')
    for key, reason in _REMOVED.items():
        if statement.get(key):
            raise StatementError(f'{key}: a receding horizon {reason}; remove it')
    if problem.q:
        raise StatementError('terminal_constraints: a receding horizon ends with the cost of the '
                             'regulator; remove them')
    if problem.start is not None:
        raise StatementError('initial_state: a receding horizon begins at the measured state; '
                             'wanted a number for each state')


def restate_problem(problem: Problem, statement: Mapping[str, Any], system: System) -> Restatement:
    """
    Return what a receding horizon takes of a problem that `check_restatable` accepts.

    :param system: its plant, with the parameters of the statement.
    :raises StatementError: if the running cost is not quadratic about a set point that the plant
        holds, or an input has no weight. The message begins with the key.
    """
    n = problem.n
    H, least = _find_minimum(problem, np.array([*system.setpoint, *system.setpoint_input]))
    W = 0.5 * H
    for name, weight in zip(problem.inputs, W.diagonal()[n:], strict=True):
        if not weight > 0.0:
            raise StatementError(f'running_cost: wanted a weight of each input, such as '
                                 f'0.1*{name}**2')
    x, u = tuple(least[:n].tolist()), tuple(least[n:].tolist())
    are_own = np.array_equal([problem.u_lower, problem.u_upper], [system.u_min, system.u_max])
    return Restatement(
        setpoint=x, setpoint_input=_find_setpoint_input(system, x, u),
        Qx=_list_weights(W[:n, :n]), Qu=_list_weights(W[n:, n:]),
        cross=tuple(W[:n, n:].ravel().tolist()) if W[:n, n:].any() else (),
        x_bounds=_interleave(problem.x_lower, problem.x_upper),
        u_limits=() if are_own else _interleave(problem.u_lower, problem.u_upper),
        path_constraints=tuple(_write_path_constraints(problem, statement, system)),
        horizon=problem.final_time.value,
        replaced='' if problem.V.is_zero() else
        'terminal_cost is replaced by the cost-to-go of the regulator')


def _find_minimum(problem: Problem, near: Array) -> tuple[Array, Array]:
    """Return the Hessian (n + m, n + m) of the running cost, and its minimum next to a point."""
    names, wanted = (*problem.states, *problem.inputs), 'such as (p - 1)**2 + 0.1*u**2'
    z = ca.vertcat(problem.x, problem.u)
    L = ca.substitute(problem.L, problem.p, ca.DM(problem.p_value))
    hessian, gradient = ca.hessian(L, z)
    slope = ca.Function('slope', [z], [gradient])
    # A sign is the derivative of an absolute value, whose second derivative is 0.
    if ca.symvar(hessian) or Instructions(slope).have(ca.OP_SIGN):
        raise StatementError('running_cost: wanted a quadratic function of states and inputs, '
                             f'{wanted}')
    H, there = ca.DM(hessian).full() + 0.0, slope(near).full().ravel()
    unit = np.sqrt(np.where(H.diagonal(), np.abs(H.diagonal()), 1.0))
    step = np.linalg.lstsq(H / unit / unit[:, None], -there / unit)[0]
    # Without rounding errors: 2 in place of 1.9999999999999998, and 0 in place of 4e-17.
    least = np.array([float(f'{value:.15g}') for value in near + step / unit]) + 0.0
    least[np.abs(least) * unit < 8 * EPS * np.abs(step).max()] = 0.0
    left = np.abs(slope(least).full().ravel())
    loose = left > _EXACT * (np.abs(there) + np.abs(H) @ (1.0 + np.abs(least)))
    if loose.any():
        name = names[int(np.flatnonzero(loose)[0])]
        raise StatementError(f'running_cost: it has no minimum in {name}; wanted squares of '
                             f'errors, {wanted}')
    return H, least


def _find_setpoint_input(system: System, x: Vector, u: Vector) -> Vector:
    """Return the input with which the plant stays at a set point; empty if x determines it."""
    try:
        held = linearize_plant(system, x, u).equilibrium.u
    except ObcError as error:
        raise StatementError(f'running_cost: the plant cannot stay at its minimum: {error}'
                             ) from None
    for name, given, needed in zip(system.input_names, u, held.tolist(), strict=True):
        if abs(given - needed) > _AS_GIVEN * max(1.0, abs(needed)):
            raise StatementError(
                f'running_cost: its minimum has {name} = {given:.6g}, but the set point needs '
                f'{name} = {needed:.6g}; wanted the weight of {name} - {needed:.6g}')
    try:
        plant = linearize_plant(system, x)
        check_set_point(plant, x, ())
    except ObcError:   # it moves
        return u
    return () if np.allclose(plant.equilibrium.u, held, rtol=_EXACT, atol=_EXACT) else u


def _list_weights(M: Array) -> Vector:
    """Return the diagonal of a weight that has nothing else, or all entries row by row."""
    is_diagonal = not (M - np.diag(M.diagonal())).any()
    return tuple((M.diagonal() if is_diagonal else M.ravel()).tolist())


def _interleave(lower: Array, upper: Array) -> Vector:
    """Return lower and upper bounds in turn; empty if all are infinite."""
    pairs = np.stack([lower, upper], axis=1)
    return tuple(pairs.ravel().tolist()) if np.isfinite(pairs).any() else ()


def _write_path_constraints(problem: Problem, statement: Mapping[str, Any], system: System
                            ) -> list[str]:
    """Return expressions that are at most 0, in which only parameters of the system remain."""
    own = {parameter.name for parameter in system.parameters}
    values = {name: value for name, value in zip(
        problem.parameters, problem.p_value.tolist(), strict=True) if name not in own}
    rows = []
    for entry in state_comparisons(statement).get('path_constraints') or ():
        text = {key: insert_numbers(value, values) for key, value in entry.items()
                if value is not None}
        if 'upper' in text:
            rows.append(f'({text["expr"]}) - ({text["upper"]})')
        if 'lower' in text:
            rows.append(f'({text["lower"]}) - ({text["expr"]})')
    return rows
