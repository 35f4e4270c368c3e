# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Motions of registered systems, shortest paths of a car, and minima of functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from obc_ros.api.answer import Answer
from obc_ros.api.given import (
    as_number,
    as_state,
    choose_given,
    convert_numbers,
    Expression,
    Expressions,
    read_floats,
    StateLike,
    UNSET,
    VectorLike,
)
from obc_ros.api.plants import as_system, SystemLike
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.augmentation import hide_added_states
from obc_ros.core.systems.file import evaluate_parameters
from obc_ros.core.systems.reeds_shepp import find_shortest_path
from obc_ros.core.systems.registry import find_registered, is_file
from obc_ros.core.tasks import minimize as static
from obc_ros.core.tasks.minimize import Minimum
from obc_ros.core.tasks.motion_planning import Motion, solve_motion
from obc_ros.core.text.errors import describe_type, StatementError

_KEYS = 'variables', 'parameters', 'cost', 'equalities', 'inequalities', 'bounds', 'guess'


def plan(system: SystemLike, start: StateLike, goal: StateLike,
         objective: str = 'time', *, parameters: Mapping[str, Any] | None = None,
         Qx: Sequence[float] | Array = (), Qu: Sequence[float] | Array = (),
         final_time: float = 0.0, input_bounds: Mapping[str, Any] | None = None,
         time_limit: float = 60.0) -> Answer:
    """
    Plan a motion of a system from a start to a goal.

    Parameters
    ----------
    system : str, Path, System, mapping, Problem, StateSpace or NonlinearIOSystem
        The name of a registered system, such as 'vehicle', or another one, as for `equilibrium`.
    start, goal : array_like, shape (n,), or mapping
        States at 0 and T, in order or by name.
    objective : str
        'time' (minimum time), 'effort' (input cost) or 'quadratic' (state and input cost).
    parameters : mapping, optional
        Values of parameters of the system.
    Qx, Qu : array_like, optional
        Weights about the goal: diagonals, or full matrices row by row; default: the identity.
    final_time : float
        T [s] of 'effort' and 'quadratic'; 0: twice the minimum time.
    input_bounds : mapping, optional
        ``{'v': [lower, upper]}``, tighter than the limits of the system.
    time_limit : float
        Limit of the wall-clock time [s].

    Returns
    -------
    Answer
        As of `solve`.

    Raises
    ------
    StatementError, DynamicsError
        If an argument is invalid.

    """
    chosen = convert_numbers(parameters or {})
    plant = (find_registered(system, chosen) if isinstance(system, str) and not is_file(system)
             else as_system(system).model.with_parameters(evaluate_parameters(chosen)))
    motion = Motion(
        plant, as_state(start, plant.state_names, 'start'),
        as_state(goal, plant.state_names, 'goal'), objective=objective,
        Qx=read_floats(Qx, 'Qx').ravel(), Qu=read_floats(Qu, 'Qu').ravel(),
        final_time=as_number(final_time, 'final_time'),
        input_bounds=convert_numbers(input_bounds or {}))
    problem, solution = solve_motion(motion, as_number(time_limit, 'time_limit'))
    return Answer(problem.name, problem.states[:problem.stated], problem.inputs,
                  hide_added_states(problem, solution), problem)


def minimize(statement: Mapping[str, Any] | None = None, *, variables: Sequence[str] = UNSET,
             parameters: Mapping[str, Any] = UNSET, cost: Expression = UNSET,
             equalities: Expressions = UNSET, inequalities: Expressions = UNSET,
             bounds: Mapping[str, Any] = UNSET, guess: VectorLike = UNSET,
             time_limit: float = 10.0) -> Minimum:
    """
    Minimise a function of several variables, with a certificate.

    Parameters
    ----------
    statement : mapping, optional
        The keys below.
    variables : sequence of str
        Names.
    parameters : mapping, optional
        Numbers by name.
    cost : str
        An expression.
    equalities, inequalities : sequence of str, optional
        Expressions that are 0, and at most 0.
    bounds : mapping, optional
        ``{'x': [lower, upper]}``; None: no bound.
    guess : array_like, optional
        The point from which the search begins; otherwise from several.
    time_limit : float
        Limit of the wall-clock time [s].

    Returns
    -------
    Minimum
        ``status``, ``x`` in the order of the variables, ``objective``, multipliers ``lam`` and
        ``mu``, ``certificate``.

    Raises
    ------
    StatementError
        If the statement is invalid.

    """
    keys = choose_given(locals(), _KEYS)
    if statement is not None and not isinstance(statement, Mapping):
        raise StatementError(f'statement: wanted a mapping, found {describe_type(statement)}')
    return static.minimize(convert_numbers({**(statement or {}), **keys}),
                           time_limit=as_number(time_limit, 'time_limit'))


reeds_shepp = find_shortest_path   # the name of the library
