# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Conversions between messages and plain values: statements, requests, responses.

A statement is the mapping of a problem file. Only what a mapping cannot hold, such as a name that
occurs twice, is checked here; the worker that solves the problem checks the statement.

The module is long because every message of the package is read and filled here, and only here.
"""

from array import array
from collections.abc import Iterable, Mapping
import json
from typing import Any

import numpy as np
from obc_ros.core.ocp import solution
from obc_ros.core.ocp.guess import Guess
from obc_ros.core.text.errors import quote, StatementError
from obc_ros.msg import (
    Attempt,
    Certificate,
    FinalTime,
    InitialGuess,
    LqrDesign,
    NamedBounds,
    NamedExpression,
    NamedValues,
    OptimalControlProblem,
    Optimality,
    PathConstraint,
    Phase,
    Trajectory,
)
from obc_ros.workers.wire import Packet

_FREE = 'null'   # as an initial value: none is given
MAX_SIZE = 10_000_000  # bytes of names, expressions and numbers in one request


def check_size(message: Any) -> None:
    """
    Reject a request that is too large.

    :param message: the request, or a field of it.
    :raises StatementError: if its texts and numbers take more than `MAX_SIZE` bytes.
    """
    size = _size(message)
    if size > MAX_SIZE:
        raise StatementError(
            f'the request has {size} bytes of text and numbers; at most {MAX_SIZE} are accepted')


def _size(value: Any) -> int:
    """Return the size [bytes] of the texts and numbers of a message, including lists."""
    if isinstance(value, str):
        return len(value) + 4
    if isinstance(value, array):
        return value.itemsize * len(value)
    if isinstance(value, list):
        return sum(map(_size, value))
    if hasattr(value, 'get_fields_and_field_types'):
        return sum(_size(getattr(value, name)) for name in value.get_fields_and_field_types())
    return 8


def read_statement(problem: OptimalControlProblem) -> dict[str, Any]:
    """
    Return the statement of a problem message, without its empty fields.

    :param problem: the message.
    :return: with the keys of a problem file.
    :raises StatementError: if a name occurs twice in a list of names and values, or the message is
        too large.
    """
    check_size(problem)
    entries = {
        'name': problem.name,
        'system': problem.system,
        'states': list(problem.states),
        'inputs': list(problem.inputs),
        'parameters': read_parameters('parameters', problem.parameters),
        'free_parameters': read_message_bounds('free_parameters', problem.free_parameters),
        'dynamics': read_expressions('dynamics', problem.dynamics),
        'running_cost': problem.running_cost,
        'terminal_cost': problem.terminal_cost,
        'initial_cost': problem.initial_cost,
        'initial_state': {
            name: None if text == _FREE else text for name, text in read_parameters(
                'initial_state', problem.initial_state).items()},
        'initial_constraints': list(problem.initial_constraints),
        'terminal_constraints': list(problem.terminal_constraints),
        'boundary_constraints': list(problem.boundary_constraints),
        'periodic': list(problem.periodic),
        'input_bounds': read_message_bounds('input_bounds', problem.input_bounds),
        'state_bounds': read_message_bounds('state_bounds', problem.state_bounds),
        'path_constraints': _read_path_constraints(problem.path_constraints),
        'final_time': {} if problem.phases else _read_final_time(problem.final_time),
        'phases': [_read_phase(f'phases[{k}]', phase) for k, phase in enumerate(problem.phases)],
        'initial_guess': _read_guess('initial_guess', problem.initial_guess),
    }
    return _without_empty(entries)


def _read_phase(where: str, phase: Phase) -> dict[str, Any]:
    return _without_empty({
        'name': phase.name,
        'duration': _read_final_time(phase.duration),
        'link': {name: None if text == _FREE else text
                 for name, text in read_expressions(f'{where}.link', phase.link).items()},
        'dynamics': read_expressions(f'{where}.dynamics', phase.dynamics),
        'running_cost': phase.running_cost,
        'terminal_cost': phase.terminal_cost,
        'terminal_constraints': list(phase.terminal_constraints),
        'input_bounds': read_message_bounds(f'{where}.input_bounds', phase.input_bounds),
        'state_bounds': read_message_bounds(f'{where}.state_bounds', phase.state_bounds),
        'path_constraints': _read_path_constraints(phase.path_constraints),
        'initial_guess': _read_guess(f'{where}.initial_guess', phase.initial_guess)})


def _read_final_time(time: FinalTime) -> dict[str, Any]:
    return {'free': time.free, **_without_empty(
        {key: getattr(time, key) for key in ('value', 'lower', 'upper', 'guess')})}


def _read_path_constraints(rows: Iterable[PathConstraint]) -> list[dict[str, Any]]:
    return [{'expr': each.expr, 'lower': each.lower or None, 'upper': each.upper or None}
            for each in rows]


def _read_guess(where: str, guess: InitialGuess) -> dict[str, Any]:
    return _without_empty({
        **{key: _values(f'{where}.{key}', getattr(guess, key))
           for key in ('states', 'inputs', 'parameters')},
        'final_time': guess.final_time})


def build_problem_message(mapping: Mapping[str, Any], guess: Guess) -> OptimalControlProblem:
    """
    Return the message of a statement.

    :param mapping: a statement that `statement.build_problem` accepts.
    :param guess: initial guess of the problem that `build_problem` returns.
    :return: the message.
    """
    message = OptimalControlProblem()
    for key in ('name', 'system'):
        setattr(message, key, mapping.get(key) or '')
    for key in ('running_cost', 'terminal_cost', 'initial_cost'):
        setattr(message, key, _text(mapping.get(key)))
    for key in ('states', 'inputs', 'periodic'):
        setattr(message, key, list(mapping.get(key) or ()))
    for key in ('terminal_constraints', 'initial_constraints', 'boundary_constraints'):
        setattr(message, key, [_text(each) for each in mapping.get(key) or ()])
    for key in ('parameters', 'dynamics'):
        setattr(message, key, build_named_expressions(mapping.get(key) or {}))
    message.initial_state = build_named_expressions({
        name: _FREE if value is None else value
        for name, value in (mapping.get('initial_state') or {}).items()})
    free = mapping.get('free_parameters') or {}
    message.free_parameters = build_named_bounds({
        name: pair or (None, None) for name, pair in free.items()})
    for key in ('input_bounds', 'state_bounds'):
        setattr(message, key, build_named_bounds(mapping.get(key) or {}))
    message.path_constraints = _build_path_constraints(mapping)
    if mapping.get('phases'):
        message.phases = [_build_phase(each) for each in mapping['phases']]
        return message
    message.final_time = _build_final_time(mapping['final_time'])
    message.initial_guess = InitialGuess(
        states=[NamedValues(name=name, values=flatten_doubles(x))
                for name, x in guess.x.items() if name not in free],
        parameters=[NamedValues(name=name, values=flatten_doubles(x))
                    for name, x in guess.x.items() if name in free],
        inputs=[NamedValues(name=name, values=flatten_doubles(u)) for name, u in guess.u.items()],
        final_time=guess.final_time or 0.0)
    return message


def _build_phase(phase: Mapping[str, Any]) -> Phase:
    message = Phase(
        name=_text(phase.get('name')), duration=_build_final_time(phase['duration']),
        running_cost=_text(phase.get('running_cost')),
        terminal_cost=_text(phase.get('terminal_cost')),
        terminal_constraints=[_text(each) for each in phase.get('terminal_constraints') or ()],
        link=build_named_expressions({name: _FREE if value is None else value
                                      for name, value in (phase.get('link') or {}).items()}),
        dynamics=build_named_expressions(phase.get('dynamics') or {}),
        path_constraints=_build_path_constraints(phase))
    for key in ('input_bounds', 'state_bounds'):
        setattr(message, key, build_named_bounds(phase.get(key) or {}))
    guess = phase.get('initial_guess') or {}
    message.initial_guess = InitialGuess(**{
        key: [NamedValues(name=name, values=flatten_doubles(np.atleast_1d(values)))
              for name, values in (guess.get(key) or {}).items()]
        for key in ('states', 'inputs', 'parameters')})
    return message


def _build_final_time(entry: Any) -> FinalTime:
    entry = dict(entry) if isinstance(entry, Mapping) else {'free': False, 'value': entry}
    return FinalTime(free=entry.pop('free'), **{
        key: _text(value) for key, value in entry.items()})


def _build_path_constraints(of: Mapping[str, Any]) -> list[PathConstraint]:
    return [PathConstraint(**{key: _text(value) for key, value in each.items()})
            for each in of.get('path_constraints') or ()]


def read_expressions(where: str, entries: Iterable[NamedExpression]) -> dict[str, str]:
    """
    Return expressions by name, in order.

    :param where: key of the statement, for errors.
    :param entries: field of a message.
    :return: Expressions.
    :raises StatementError: if a name occurs twice.
    """
    return _unique(where, ((each.name, each.expression) for each in entries))


def read_parameters(where: str, entries: Iterable[NamedExpression]) -> dict[str, Any]:
    """
    Return parameters and construction options of a system by name.

    :param where: key of the statement, for errors.
    :param entries: field of a message; lists are written as JSON.
    :return: expressions, and lists.
    :raises StatementError: if a name occurs twice, or a text that begins with a bracket is no
        list.
    """
    return {name: _list(f'{where}.{quote(name)}', text) if text.startswith('[') else text
            for name, text in read_expressions(where, entries).items()}


def read_message_bounds(where: str, entries: Iterable[NamedBounds]) -> dict[str, list[str | None]]:
    """
    Return bounds by name.

    :param where: key of the statement, for errors.
    :param entries: field of a message.
    :return: [lower, upper], as expressions; None: no bound.
    :raises StatementError: if a name occurs twice.
    """
    return _unique(where, (
        (each.name, [each.lower or None, each.upper or None]) for each in entries))


def build_named_expressions(mapping: Mapping[str, Any]) -> list[NamedExpression]:
    """
    Return a mapping of names to numbers or expressions as messages.

    :param mapping: from names to numbers, expressions or lists.
    :return: in the order of the mapping.
    """
    return [NamedExpression(name=name, expression=_text(value))
            for name, value in mapping.items()]


def build_named_bounds(mapping: Mapping[str, Any]) -> list[NamedBounds]:
    """
    Return a mapping of names to bounds as messages.

    :param mapping: from names to [lower, upper], each a number, an expression or None; or to None.
    :return: in the order of the mapping, without the names that have None.
    """
    return [NamedBounds(name=name, lower=_text(pair[0]), upper=_text(pair[1]))
            for name, pair in mapping.items() if pair is not None]


def read_request(kind: str, request: Any) -> Packet:
    """
    Return a request as plain data.

    :param kind: a key of `requests.KINDS`.
    :param request: of that kind.
    :return: for `requests.answer`.
    :raises StatementError: if it is too large, or a name occurs twice in a list of names and
        values.
    """
    check_size(request)
    return _REQUESTS[kind](request)


def _solve_request(request: Any) -> Packet:
    return Packet({'statement': read_statement(request.problem), 'method': request.method,
                   'options': list(request.options)})


def _minimize_request(request: Any) -> Packet:
    return Packet({'statement': _without_empty({
        'variables': list(request.variables),
        'parameters': read_expressions('parameters', request.parameters),
        'cost': request.cost,
        'equalities': list(request.equalities),
        'inequalities': list(request.inequalities),
        'bounds': read_message_bounds('bounds', request.bounds),
        'guess': request.guess.tolist()})})


def _plan_request(request: Any) -> Packet:
    return Packet(
        {'system': request.system, 'objective': request.objective,
         'parameters': read_parameters('system_parameters', request.system_parameters),
         'input_bounds': read_message_bounds('input_bounds', request.input_bounds),
         'state_bounds': read_message_bounds('state_bounds', request.state_bounds),
         'path_constraints': list(request.path_constraints),
         'final_time': request.final_time},
        _arrays(request, 'start', 'goal', 'qx', 'qu'))


def _design_request(request: Any) -> Packet:
    weights = request.weights
    return Packet(
        {'system': request.system,
         'parameters': read_parameters('system_parameters', request.system_parameters),
         'sample_time': request.sample_time, 'delay': request.delay,
         'weights': weights.weights, 'rho': weights.rho, 'stability': weights.stability},
        _arrays(request, 'setpoint', 'setpoint_input', 'a', 'b')
        | _arrays(weights, 'qx', 'qu', 'cross', 'x_max', 'u_max', 'h'))


_REQUESTS = {'solve': _solve_request, 'minimize': _minimize_request, 'plan': _plan_request,
             'design_lqr': _design_request}


def _arrays(message: Any, *names: str) -> dict[str, Any]:
    return {name: np.array(getattr(message, name), np.float64) for name in names}


def fill_answer(response: Any, packet: Packet) -> None:
    """
    Fill a response or a result with the answer to a problem.

    :param response: filled in place.
    :param packet: as `solutions.pack_solution` returns it, or with a status and a message only.
    """
    plain = dict(packet.plain)
    response.certificate = build_certificate_message(plain.pop('certificate', None))
    response.optimality = Optimality(**plain.pop('optimality', None) or {})
    response.attempts = [Attempt(**attempt) for attempt in plain.pop('attempts', ())]
    free = plain.pop('free_parameters', {})
    if hasattr(response, 'free_parameters'):   # a motion has none
        response.free_parameters = [NamedValues(name=name, values=[value])
                                    for name, value in free.items()]
    response.success = plain['status'] == 'solved' and response.certificate.holds
    for name in set(response.get_fields_and_field_types()) & set(plain):
        setattr(response, name, plain[name])
    if 'nu' in packet.arrays and hasattr(response, 'nu'):
        response.nu = flatten_doubles(packet.arrays['nu'])
    if 't' in packet.arrays:
        response.trajectory = Trajectory(
            system=plain['system'], state_names=plain['states'], input_names=plain['inputs'],
            interpolation=plain['interpolation'],
            **{name: flatten_doubles(packet.arrays[name])
               for name in ('t', 'x', 'u', 'lam', 'hamiltonian', 'switching_times')})


def fill_minimum(response: Any, packet: Packet) -> None:
    """
    Fill the response of ``~/minimize``.

    :param response: filled in place.
    :param packet: as `requests.answer` returns it, or with a status and a message only.
    """
    plain = dict(packet.plain)
    response.certificate = build_certificate_message(plain.pop('certificate', None))
    response.success = plain['status'] == 'solved' and response.certificate.holds
    for name, value in plain.items():
        setattr(response, name, value)
    for name, values in packet.arrays.items():
        setattr(response, name, flatten_doubles(values))


def fill_design(response: Any, packet: Packet) -> None:
    """
    Fill the response of ``~/design_lqr``.

    :param response: filled in place; the message of a failure begins with the status.
    :param packet: as `requests.answer` returns it, or with a status and a message only.
    """
    status, response.message = packet.plain['status'], packet.plain['message']
    response.success = status == 'solved'
    if not response.success:
        response.message = f'{status}: {response.message}'
    else:
        response.design = build_lqr_design({**packet.plain['design'], **packet.arrays})


def build_lqr_design(fields: Mapping[str, Any]) -> LqrDesign:
    """
    Return the message of a design.

    :param fields: as `report_fields` returns it; arrays are flattened row by row.
    :return: the message.
    """
    return LqrDesign(**{name: flatten_doubles(value) if isinstance(value, np.ndarray) else value
                        for name, value in fields.items()})


def build_certificate_message(conditions: Mapping[str, Mapping[str, float]] | None) -> Certificate:
    """Return the message of a certificate; without conditions, an empty one."""
    if conditions is None:
        return Certificate(sentence='there is no solution to certify')
    verdict = solution.Certificate(**conditions)
    return Certificate(
        holds=verdict.holds, conditions=list(verdict.tolerances),
        residuals=[verdict.residuals[name] for name in verdict.tolerances],
        tolerances=list(verdict.tolerances.values()), sentence=verdict.sentence)


def read_solution(result: Any) -> solution.Solution:
    """
    Return the solution that a response or a result contains.

    :param result: as `fill_answer` fills it. It has no multipliers of state bounds and path
        constraints.
    :return: with the arrays of the trajectory.
    """
    path, certificate, known = result.trajectory, result.certificate, result.optimality
    shape = len(path.t), -1
    arrays = {name: np.array(getattr(path, name)).reshape(shape if getattr(path, name) else (0, 0))
              for name in ('x', 'u', 'lam')}
    return solution.Solution(
        status=solution.Status(result.status), message=result.message, remark=result.remark,
        objective=result.objective,
        **arrays, t=np.array(path.t), hamiltonian=np.array(path.hamiltonian),
        nu=np.array(result.nu), interpolation=path.interpolation or 'linear',
        switching_times=np.array(path.switching_times), method=result.method,
        iterations=result.iterations, build_time=result.build_time, solve_time=result.solve_time,
        free_parameters={each.name: each.values[0] for each in result.free_parameters},
        certificate=solution.Certificate(*(
            dict(zip(certificate.conditions, values, strict=True))
            for values in (certificate.residuals, certificate.tolerances)))
        if certificate.conditions else None,
        optimality=solution.Optimality(known.kind, known.reason, known.starts,
                                       tuple(known.minima)) if known.kind else None,
        attempts=tuple(solution.Attempt(**{
            name: getattr(each, name) for name in each.get_fields_and_field_types()
        } | {'verdict': solution.Verdict(each.verdict)}) for each in result.attempts))


def flatten_doubles(values: Any) -> 'array[float]':
    """
    Return numbers as the value of a float64[] field.

    :param values: of any shape.
    :return: row by row.
    """
    return array('d', np.asarray(values, np.float64).tobytes())


def _values(where: str, entries: Iterable[NamedValues]) -> dict[str, Any]:
    return _unique(where, ((each.name, each.values.tolist()) for each in entries))


def _unique(where: str, pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise StatementError(f"{where}: '{quote(name)}' is given twice")
        found[name] = value
    return found


def _without_empty(mapping: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in mapping.items() if value not in ('', [], {}, 0.0)}


def _text(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return json.dumps(value)
    return '' if value is None else str(value)


def _list(where: str, text: str) -> Any:
    try:
        return json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        raise StatementError(f'{where}: {quote(text)} is no list of numbers: {error}') from None
