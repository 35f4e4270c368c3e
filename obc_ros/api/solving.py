# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Solve problems, and certify solutions of any solver."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
import json
from typing import Any, Unpack

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from obc_ros.api.answer import Answer
from obc_ros.api.given import (
    as_duration,
    choose_given,
    convert_numbers,
    Expression,
    Expressions,
    KeysOfPlant,
    read_floats,
    StatedFunction,
    StateLike,
    UNSET,
)
from obc_ros.api.interpolation import restore_added_costates
from obc_ros.api.plants import SystemLike
from obc_ros.api.problem import as_problem, as_statement, ProblemLike
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.vectorized import VectorizedFunction
from obc_ros.core.ocp import problem as ocp
from obc_ros.core.ocp.augmentation import hide_added_states
from obc_ros.core.ocp.certificate import certificate
from obc_ros.core.ocp.method_names import get_accepted, get_method
from obc_ros.core.ocp.solution import Certificate, Report, Solution, Status
from obc_ros.core.ocp.statement import FOR_THE_SOLVER, replace_functions
from obc_ros.core.solver import solve as solver
from obc_ros.core.solver.options import read_options
from obc_ros.core.solver.program_cache import Cache
from obc_ros.core.text.errors import describe_type, StatementError
from obc_ros.core.text.recorded_functions import pack_statement

_ARGUMENTS = 'method', 'accept'   # by themselves
_KEYS = tuple(key for key in FOR_THE_SOLVER if key not in _ARGUMENTS)
_INTERPOLATIONS = 'linear', 'zoh'


def solve(problem: ProblemLike | None = None, *, name: str = UNSET,
          system: SystemLike = UNSET, states: Sequence[str] = UNSET,
          inputs: Sequence[str] = UNSET, parameters: Mapping[str, Any] = UNSET,
          free_parameters: Mapping[str, Any] = UNSET,
          tables: Mapping[str, Any] = UNSET,
          dynamics: Mapping[str, Expression] | StatedFunction = UNSET,
          running_cost: Expression | StatedFunction = UNSET,
          terminal_cost: Expression | StatedFunction = UNSET,
          initial_cost: Expression | StatedFunction = UNSET,
          initial_state: StateLike | Sequence[Any] = UNSET,
          initial_constraints: Expressions | StatedFunction = UNSET,
          terminal_constraints: Expressions | StatedFunction = UNSET,
          boundary_constraints: Expressions = UNSET, periodic: Sequence[str] = UNSET,
          input_bounds: Mapping[str, Any] = UNSET, state_bounds: Mapping[str, Any] = UNSET,
          path_constraints: Sequence[Mapping[str, Any] | Expression] | StatedFunction = UNSET,
          final_time: Mapping[str, Any] | Expression = UNSET,
          phases: Sequence[Mapping[str, Any]] = UNSET,
          initial_guess: Mapping[str, Any] | Answer = UNSET,
          starts: Sequence[Mapping[str, Any] | Answer] = UNSET,
          method: str = '', accept: str = '', time_limit: float = 60.0,
          options: Mapping[str, Any] | Iterable[str] = (), report: Report | None = None,
          isolated: bool = False, cache: Cache | None = None, **others: Unpack[KeysOfPlant]
          ) -> Answer:
    """
    Solve an optimal control problem and certify the solution.

    Parameters
    ----------
    problem : Problem, Answer, mapping, Path or str, optional
        The problem, that of an answer, the keys of a problem file, such a file, or its text.
    time_limit : float
        Limit of the wall-clock time of the search [s]. Reading the statement and making its
        expressions come before and are not counted. The search looks at the clock between its
        steps: one that has begun is finished, such as an iteration, or the derivatives of the
        expressions. With many thousand symbols, each of these may take minutes; see `isolated`.
    method : str
        'auto', 'riccati', 'time_optimal', 'reeds_shepp', 'transcription', 'arcs' or 'indirect';
        empty: that of the problem.
    accept : str
        Which answer ends the search. 'certified': a solution whose certificate holds; 'path': the
        first path that meets all constraints; 'best': a certified solution, or the best path that
        meets all constraints when the time is up. Empty: that of the problem, or 'certified'.
    options : mapping or iterable of str
        Numbers that steer the search, for experts: ``{'multistart.most': 20}`` or
        ``['multistart.most=20']``. ``obc solve --list-options`` lists them.
    report : callable, optional
        Called as report(phase, iteration, cost, infeasibility); True cancels.
    isolated : bool
        Whether to solve the problem in a process of its own, which is ended at the time limit,
        whatever it does. The limit then counts all but the start of the process, about a second.
        The process may use 2 GiB, and keeps nothing for the next problem. It gets what
        functions have returned here. A system must be its name. Needs Linux or macOS.
    cache : Cache, optional
        Keeps what is made for a problem, for problems that differ only in numbers: these are
        solved faster, from the solution of the nearest one, which may be another local minimum.
        Default: none is kept, so that the answer does not depend on earlier ones.
    name, system, states, inputs, parameters, free_parameters, tables, dynamics, running_cost, \
    terminal_cost, initial_cost, initial_state, initial_constraints, terminal_constraints, \
    boundary_constraints, periodic, input_bounds, state_bounds, path_constraints, final_time, \
    phases, initial_guess, starts
        The keys of a problem file: the problem, or changes of it; see `Problem`.
    **others
        Other keys that a file may have, such as `title` and `units`.

    Returns
    -------
    Answer
        ``status`` is 'solved' only if the certificate holds, and 'infeasible' only if that is
        proved. It is 'feasible' if `accept` allows a path that meets all constraints and has no
        certificate of optimality. Otherwise it is 'not_converged', 'timed_out' or 'cancelled',
        with the reason in ``message``.

    Raises
    ------
    StatementError
        If the problem or an argument is invalid.

    """
    keys = {**choose_given(locals(), _KEYS), **others}
    time_limit = as_duration(time_limit, 'time_limit')
    written = [f'{name}={_write(value)}' for name, value in options.items()
               ] if isinstance(options, Mapping) else list(options)
    chosen = read_options(written)
    get_method(method)
    get_accepted(accept)
    if cache is not None and not isinstance(cache, Cache):
        raise StatementError(f'cache: wanted a Cache, found {describe_type(cache)}')
    if isolated and cache is not None:
        raise StatementError('isolated: another process keeps nothing in a cache')
    if isolated:
        return _solve_isolated(problem, keys, report, time_limit,
                               {'method': method, 'accept': accept, 'options': written})
    stated = as_problem(problem, keys)
    solution = solver.solve(stated.built, method=method, accept=accept,
                            time_limit=time_limit, report=report, cache=cache, options=chosen)
    return Answer(stated.name, stated.states, stated.inputs,
                  hide_added_states(stated.built, solution), stated.built,
                  str(stated.statement.get('title') or ''))


def _solve_isolated(problem: ProblemLike | None, keys: Mapping[str, Any],
                    report: Report | None, time_limit: float, request: Mapping[str, Any]
                    ) -> Answer:
    """Return the answer of another process; this one does not build the problem."""
    statement = replace_functions(convert_numbers(as_statement(problem, keys)))
    try:
        packed = pack_statement(statement)
        json.dumps(packed)
    except (TypeError, ValueError, RecursionError):
        raise StatementError('isolated: another process gets the statement; wanted texts, numbers '
                             'and functions, and a system by its name') from None
    from obc_ros.workers.responses import solve_in_process  # loaded on request only
    solution, states, inputs = solve_in_process(
        {**request, **packed, 'cache_size': 1}, time_limit, report)
    if solution.status is Status.MALFORMED:
        raise StatementError(solution.message)
    return Answer(str(statement.get('name', 'problem')), states, inputs, solution,
                  title=str(statement.get('title') or ''), statement=statement)


def certify(problem: ProblemLike, answer: Answer | None = None, *,
            t: ArrayLike | None = None, x: ArrayLike | Mapping[str, ArrayLike] | None = None,
            u: ArrayLike | Mapping[str, ArrayLike] | None = None,
            lam: ArrayLike | Mapping[str, ArrayLike] | None = None,
            objective: float | None = None, interpolation: str = 'linear',
            nu: ArrayLike | None = None, state_multipliers: ArrayLike | None = None,
            path_multipliers: ArrayLike | None = None,
            free_parameters: Mapping[str, float] | None = None) -> Certificate:
    """
    Compute the residuals of the necessary conditions for an answer, or a path of any solver.

    Parameters
    ----------
    problem : Problem, Answer, mapping, Path or str
        As for `solve`; of an answer without anything else, it is certified again.
    answer : Answer, optional
        Such as `solve` returns; or the arrays below.
    t : array_like, shape (N,)
        Times [s], from 0, not decreasing; a time that stands twice is a jump.
    x, u, lam : array_like, shape (N, n), (N, m), (N, n), or mapping
        States, inputs and costates (H = L + lam' f, minimised); or arrays (N,) by name.
    objective : float
        The cost that the solver returned.
    interpolation : str
        Of u between samples: 'linear' or 'zoh' (constant from each sample on).
    nu : array_like, shape (q,), optional
        Multipliers of the terminal constraints; by least squares if left out.
    state_multipliers, path_multipliers : array_like, shape (N, n), (N, l), optional
        Densities of the multipliers of state bounds and path constraints.
    free_parameters : mapping, optional
        Values of the free parameters, by name.

    Returns
    -------
    Certificate
        Residuals and tolerances. It prints as a table.

    Raises
    ------
    StatementError
        If the problem is invalid, or an array is missing or has a wrong shape.

    """
    stated = as_problem(problem, {})
    built = stated.built
    if built.phases is not None:
        raise StatementError('phases: certify is not for problems with phases; the answer of '
                             'solve has its certificate')
    if answer is None and t is None and isinstance(problem, Answer):
        answer = problem
    if answer is not None:
        if not isinstance(answer, Answer):
            raise StatementError('answer: wanted an Answer, or the arrays t, x, u and lam by '
                                 f'their names, found {describe_type(answer)}')
        if (answer.states, answer.inputs) != (stated.states, stated.inputs):
            raise StatementError('answer: its states and inputs are not those of the problem')
        return certificate.certify(built, restore_added_costates(built, answer.solution))
    if not stated.inputs and t is not None:
        u = np.zeros((np.size(t), 0))
    for name, value in (('t', t), ('x', x), ('u', u), ('lam', lam), ('objective', objective)):
        if value is None:
            raise StatementError(f'{name}: missing; wanted an answer, or t, x, u, lam and '
                                 'objective')
    if interpolation not in _INTERPOLATIONS:
        raise StatementError(f'interpolation: wanted one of {", ".join(_INTERPOLATIONS)}, found '
                             f'{describe_type(interpolation)}')
    times = _read('t', t, (None,))
    N = len(times)
    if N < 2 or times[0] == times[-1] or (np.diff(times) < 0).any():
        raise StatementError('t: wanted at least two times that do not decrease')
    columns = (('x', x, stated.states), ('u', u, stated.inputs), ('lam', lam, stated.states))
    states, inputs, costates = (_read(name, _join(name, value, names), (N, len(names)))
                                for name, value, names in columns)

    def read_density(name: str, value: ArrayLike | None, count: int) -> Array | None:
        return None if value is None else _read(name, value, (N, count))

    values = dict(free_parameters or {})
    for name in built.free_parameters:
        values[name] = float(_read(f'free_parameters.{name}', values.get(name), ()))
    path = Solution(
        Status.NOT_CONVERGED, '', float(_read('objective', objective, ())), times, states, inputs,
        costates, 0 * times, np.zeros(0) if nu is None else _read('nu', nu, (built.q,)),
        read_density('state_multipliers', state_multipliers, len(stated.states)),
        read_density('path_multipliers', path_multipliers, int(built.path.numel())),
        interpolation, free_parameters=values)
    path = restore_added_costates(built, path)
    return certificate.certify(built, replace(path, hamiltonian=_evaluate_hamiltonian(
        built, path.x, path.u, path.lam)))


def _write(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return ','.join(map(str, value))
    return str(value)


def _join(name: str, value: Any, names: tuple[str, ...]) -> Any:
    """Return the columns of a mapping side by side; other values as they are."""
    if not isinstance(value, Mapping):
        return value
    for each in names:
        if each not in value:
            raise StatementError(f"{name}: no values for '{each}'")
    try:
        return np.column_stack([np.asarray(value[each], dtype=float) for each in names])
    except (TypeError, ValueError):
        raise StatementError(f'{name}: wanted numbers, equally many for each name') from None


def _read(name: str, value: Any, shape: tuple[int | None, ...]) -> Array:
    """Return finite numbers of a shape."""
    if value is None:
        raise StatementError(f'{name}: missing')
    found = read_floats(value, name)
    if len(found.shape) != len(shape) or any(
            wanted not in (None, size) for wanted, size in zip(shape, found.shape, strict=True)):
        wanted = ', '.join('N' if size is None else str(size) for size in shape)
        raise StatementError(f'{name}: wanted an array of shape ({wanted}), found {found.shape}')
    if not np.isfinite(found).all():
        raise StatementError(f'{name}: wanted finite numbers')
    return found


def _evaluate_hamiltonian(problem: ocp.Problem, x: Array, u: Array, lam: Array) -> Array:
    """Return H = L + lam' f, shape (N,)."""
    costate = ca.SX.sym('lam', problem.n)
    H = VectorizedFunction([problem.x, problem.u, costate, problem.p],
                           [problem.L + ca.dot(costate, problem.f)])
    return np.asarray(H(x, u, lam, problem.p_value)[0][:, 0])
