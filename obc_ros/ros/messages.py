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
import math
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from obc_ros.core.ocp import solution
from obc_ros.core.ocp.guess import Guess
from obc_ros.core.ocp.method_names import BEST
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
from obc_ros.workers.responses import unpack_solution
from obc_ros.workers.wire import Packet

_FREE = 'null'   # as an initial value: none is given
_WITH_FREE = ('initial_state', 'link')         # fields that may have it
_WITH_LISTS = ('parameters', 'initial_state')  # fields that may have lists
MAX_SIZE = 10_000_000  # bytes of names, expressions and numbers in one request


def check_size(message: Any) -> None:
    """Raise StatementError if texts and numbers of a request take more than `MAX_SIZE` bytes."""
    size = _size(message)
    if size > MAX_SIZE:
        raise StatementError(
            f'the request has {size} bytes of text and numbers; at most {MAX_SIZE} are accepted')


def _size(value: Any) -> int:
    if isinstance(value, str):
        return len(value) + 4
    if isinstance(value, array):
        return value.itemsize * len(value)
    if isinstance(value, list):
        return sum(map(_size, value))
    if hasattr(value, 'get_fields_and_field_types'):
        return sum(_size(getattr(value, name)) for name in value.get_fields_and_field_types())
    return 8


def read_nanoseconds(stamp: Time) -> int:
    """Return a stamp in nanoseconds; it may be negative."""
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def set_stamp(stamp: Time, time: int) -> None:
    """Set a stamp, in place, to a time [ns] that is not negative."""
    stamp.sec, stamp.nanosec = divmod(time, 10**9)


def make_stamp(time: int) -> Time:
    """Return the stamp of a time [ns] that is not negative."""
    stamp = Time()
    set_stamp(stamp, time)
    return stamp


def read_statement(problem: OptimalControlProblem) -> dict[str, Any]:
    """
    Return the statement of a problem message, without its empty fields.

    :return: with the keys of a problem file.
    :raises StatementError: if a name occurs twice in a list of names and values, or the message is
        too large.
    """
    check_size(problem)
    statement = _read_fields('', problem)
    if problem.phases:
        del statement['final_time']
    if problem.states and not problem.inputs:
        statement['inputs'] = []
    return statement


def _read_fields(where: str, message: Any) -> dict[str, Any]:
    """Return the fields of a part of a problem that are not empty; `where` begins their keys."""
    found = {name: _read_field(where + name, name, getattr(message, name), _kind(of))
             for name, of in message.get_fields_and_field_types().items()}
    return _without_empty(found)


def _read_field(where: str, name: str, value: Any, kind: str) -> Any:
    match kind:
        case 'NamedExpression':
            read = read_parameters if name in _WITH_LISTS else read_expressions
            return {key: None if text == _FREE and name in _WITH_FREE else text
                    for key, text in read(where, value).items()}
        case 'NamedBounds':
            return read_message_bounds(where, value)
        case 'NamedValues':
            return _unique(where, ((each.name, each.values.tolist()) for each in value))
        case 'PathConstraint':
            return [{'expr': each.expr, 'lower': each.lower or None, 'upper': each.upper or None}
                    for each in value]
        case 'FinalTime':
            return {'free': value.free, **_without_empty(
                {key: getattr(value, key) for key in ('value', 'lower', 'upper', 'guess')})}
        case 'InitialGuess':
            return _read_fields(f'{where}.', value)
        case 'Phase':
            return [_read_fields(f'{where}[{k}].', phase) for k, phase in enumerate(value)]
    return list(value) if isinstance(value, list) else value


def build_problem_message(mapping: Mapping[str, Any], guess: Guess) -> OptimalControlProblem:
    """Return the message of a valid statement, with the initial guess of its problem."""
    for key in ('tables', 'starts'):
        if mapping.get(key):
            raise StatementError(f'{key}: a message has none; solve the problem without a server')
    if mapping.get('phases'):
        return _build_fields(OptimalControlProblem, mapping, 'final_time', 'initial_guess')
    message = _build_fields(OptimalControlProblem, mapping, 'initial_guess')
    free = mapping.get('free_parameters') or {}
    message.initial_guess = InitialGuess(
        states=_build_values({name: x for name, x in guess.x.items() if name not in free}),
        parameters=_build_values({name: x for name, x in guess.x.items() if name in free}),
        inputs=_build_values(guess.u), final_time=guess.final_time or 0.0)
    return message


def _build_fields(kind: type, mapping: Mapping[str, Any], *left_out: str) -> Any:
    """Return a part of a problem as a message, without the fields that are left out."""
    message = kind()
    for name, of in message.get_fields_and_field_types().items():
        value = mapping.get(name)
        # An empty value says nothing; a cost of 0 is one.
        if name not in left_out and (value or value == 0 and of == 'string'):
            setattr(message, name, _build_field(name, value, _kind(of), of.startswith('seq')))
    return message


def _build_field(name: str, value: Any, kind: str, is_list: bool) -> Any:
    match kind:
        case 'NamedExpression':
            return build_named_expressions({
                key: _FREE if each is None and name in _WITH_FREE else each
                for key, each in value.items()})
        case 'NamedBounds':
            if name == 'free_parameters':
                value = {key: pair or (None, None) for key, pair in value.items()}
            return build_named_bounds(value)
        case 'NamedValues':
            return _build_values(value)
        case 'PathConstraint':
            return [PathConstraint(**{key: _text(side) for key, side in each.items()})
                    for each in value]
        case 'FinalTime':
            entry = dict(value) if isinstance(value, Mapping) else {'free': False, 'value': value}
            return FinalTime(free=entry.pop('free'), **{
                key: _text(each) for key, each in entry.items()})
        case 'InitialGuess':
            return _build_fields(InitialGuess, value, 'final_time')
        case 'Phase':
            return [_build_fields(Phase, each) for each in value]
    return list(map(_text, value)) if is_list else _text(value)


def _build_values(mapping: Mapping[str, Any]) -> list[NamedValues]:
    return [NamedValues(name=name, values=flatten_doubles(values))
            for name, values in mapping.items()]


def _kind(of: str) -> str:
    """Return the type of a field, or of the entries of a list, without its package."""
    return of.removeprefix('sequence<').removesuffix('>').rpartition('/')[2]


def read_expressions(where: str, entries: Iterable[NamedExpression]) -> dict[str, str]:
    """Return expressions by name, in order; StatementError: a name occurs twice in `where`."""
    return _unique(where, ((each.name, each.expression) for each in entries))


def read_parameters(where: str, entries: Iterable[NamedExpression]) -> dict[str, Any]:
    """
    Return parameters and construction options of a system by name.

    :param where: key of the statement, for errors.
    :param entries: lists are written as JSON.
    :raises StatementError: if a name occurs twice, or a text that begins with a bracket is no
        list.
    """
    return {name: _list(f'{where}.{quote(name)}', text) if text.startswith('[') else text
            for name, text in read_expressions(where, entries).items()}


def read_message_bounds(where: str, entries: Iterable[NamedBounds]) -> dict[str, list[str | None]]:
    """
    Return bounds by name: [lower, upper], as expressions; None: no bound.

    :param where: key of the statement, for errors.
    :raises StatementError: if a name occurs twice.
    """
    return _unique(where, (
        (each.name, [each.lower or None, each.upper or None]) for each in entries))


def build_named_expressions(mapping: Mapping[str, Any]) -> list[NamedExpression]:
    """Return a mapping of names to numbers, expressions or lists as messages."""
    return [NamedExpression(name=name, expression=_text(value))
            for name, value in mapping.items()]


def build_named_bounds(mapping: Mapping[str, Any]) -> list[NamedBounds]:
    """
    Return a mapping of names to bounds as messages, without the names that have None.

    :param mapping: from names to [lower, upper], each a number, an expression or None; or to None.
    """
    return [NamedBounds(name=name, lower=_text(pair[0]), upper=_text(pair[1]))
            for name, pair in mapping.items() if pair is not None]


def read_request(kind: str, request: Any) -> Packet:
    """
    Return a request as plain data, for `requests.answer`.

    :param kind: a key of `requests.KINDS`.
    :raises StatementError: if it is too large, or a name occurs twice in a list of names and
        values.
    """
    check_size(request)
    return _REQUESTS[kind](request)


def _solve_request(request: Any) -> Packet:
    return Packet({'statement': read_statement(request.problem), 'method': request.method,
                   'accept': request.accept, 'options': list(request.options)})


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
         'final_time': request.final_time, 'accept': BEST if request.deadline else ''},
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
    """Fill a response or a result with the answer to a problem, or a status and a message only."""
    plain = dict(packet.plain)
    response.certificate = build_certificate_message(plain.pop('certificate', None))
    response.optimality = Optimality(**plain.pop('optimality', None) or {})
    response.attempts = [Attempt(**attempt) for attempt in plain.pop('attempts', ())]
    free = plain.pop('free_parameters', {})
    if hasattr(response, 'free_parameters'):   # a motion has none
        response.free_parameters = [NamedValues(name=name, values=[value])
                                    for name, value in free.items()]
    response.success = plain['status'] == 'feasible' or (
        plain['status'] == 'solved' and response.certificate.holds)
    response.first_path_time = math.nan
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
    """Fill the response of ``~/minimize`` with an answer, or a status and a message only."""
    plain = dict(packet.plain)
    response.certificate = build_certificate_message(plain.pop('certificate', None))
    response.success = plain['status'] == 'solved' and response.certificate.holds
    for name, value in plain.items():
        setattr(response, name, value)
    for name, values in packet.arrays.items():
        setattr(response, name, flatten_doubles(values))


def fill_design(response: Any, packet: Packet) -> None:
    """Fill the response of ``~/design_lqr``; the message of a failure begins with the status."""
    status, response.message = packet.plain['status'], packet.plain['message']
    response.success = status == 'solved'
    if not response.success:
        response.message = f'{status}: {response.message}'
    else:
        response.design = build_lqr_design({**packet.plain['design'], **packet.arrays})


def build_lqr_design(fields: Mapping[str, Any]) -> LqrDesign:
    """Return the message of the fields that `report_fields` returns."""
    return LqrDesign(**{name: flatten_doubles(value) if isinstance(value, np.ndarray) else value
                        for name, value in fields.items()})


def build_certificate_message(conditions: Mapping[str, Any] | None) -> Certificate:
    """Return the message of a certificate; without conditions, an empty one."""
    if conditions is None:
        return Certificate(sentence='there is no solution to certify', excess=math.nan)
    verdict = solution.Certificate(**conditions)
    return Certificate(
        holds=verdict.holds, conditions=list(verdict.tolerances),
        residuals=[verdict.residuals[name] for name in verdict.tolerances],
        tolerances=list(verdict.tolerances.values()), sentence=verdict.sentence,
        excess=verdict.excess)


def read_solution(result: Any) -> solution.Solution:
    """Return the solution in a response; it has no multipliers of bounds and path constraints."""
    path, certificate, known = result.trajectory, result.certificate, result.optimality
    shape = len(path.t), -1
    arrays = {name: np.array(getattr(path, name)).reshape(shape if getattr(path, name) else (0, 0))
              for name in ('x', 'u', 'lam')}
    arrays |= _arrays(path, 't', 'hamiltonian', 'switching_times') | _arrays(result, 'nu')
    plain = {name: getattr(result, name) for name in (
        'status', 'message', 'remark', 'objective', 'method', 'iterations', 'build_time',
        'solve_time', 'first_path_time')}
    plain |= {
        'interpolation': path.interpolation or 'linear',
        'free_parameters': {each.name: each.values[0] for each in result.free_parameters},
        'certificate': {'excess': certificate.excess, **{
            name: dict(zip(certificate.conditions, getattr(certificate, name), strict=True))
            for name in ('residuals', 'tolerances')}} if certificate.conditions else None,
        'optimality': _read_plain(known) if known.kind else None,
        'attempts': list(map(_read_plain, result.attempts))}
    return unpack_solution(Packet(plain, arrays))


def _read_plain(message: Any) -> dict[str, Any]:
    return {name: getattr(message, name) for name in message.get_fields_and_field_types()}


def flatten_doubles(values: Any) -> 'array[float]':
    """Return numbers, of any shape, row by row as the value of a float64[] field."""
    return array('d', np.asarray(values, np.float64).tobytes())


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
    if isinstance(value, Mapping):   # a constraint at an end, with bounds
        low, high = value.get('lower'), value.get('upper')
        return (f'{low} <= ' * (low is not None) + str(value['expr'])
                + f' <= {high}' * (high is not None))
    if isinstance(value, (list, tuple)):
        return json.dumps(value)
    return '' if value is None else str(value)


def _list(where: str, text: str) -> Any:
    try:
        return json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        raise StatementError(f'{where}: {quote(text)} is no list of numbers: {error}') from None
