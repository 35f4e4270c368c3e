# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The services that set parameters of a node, without exceptions and needless rejections of rclpy.

- A value type that does not exist is rejected; rclpy raises an exception.
- A file with all parameters of a node, as ``ros2 param dump`` writes it, can be loaded again: a
  read-only parameter may be set to its present value, and so may a string that reads as a number.
- Parameters that are acceptable together are set together, in any order of the request, and the
  node adopts them once. Otherwise each is tried separately, after those that give it an effect.
- Each rejection is logged with its reason, including those by rclpy.
- A node may judge a change elsewhere, and serve other requests meanwhile.
"""

from collections.abc import Awaitable, Callable
from typing import Any

from obc_ros.core.text.errors import quote
from obc_ros.ros.throttled_log import ThrottledLog
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter

TYPES = {each.value for each in Parameter.Type}

IsKept = Callable[[Parameter], bool]
SetTogether = Callable[[list[Parameter]], SetParametersResult]
Prepare = Callable[[list[Parameter]], Awaitable[None]]
Reply = Callable[[Any, Any], Awaitable[Any]]


def serve_parameters(node: Node, is_kept: IsKept, attempt: SetTogether, prepare: Prepare,
                     depth: Callable[[str], int]) -> None:
    """
    Replace the callbacks of the services that set parameters of a node.

    :param node: before it spins.
    :param is_kept: returns whether a parameter has the given value already and would reject it as
        given.
    :param attempt: sets all given parameters or none, and reports a rejection in its result only.
    :param prepare: awaited before parameters are set; may judge them elsewhere meanwhile.
    :param depth: returns the number of parameters that have to be set in turn before a parameter
        is used.
    """
    log = ThrottledLog(node)
    for service in node.services:
        if service.srv_type is SetParameters:
            service.callback = _logged(
                _one_by_one(service.callback, is_kept, attempt, prepare, depth), log)
        elif service.srv_type is SetParametersAtomically:
            service.callback = _logged(_together(service.callback, is_kept, prepare), log)


def _one_by_one(callback: Callable[[Any, Any], Any], is_kept: IsKept, attempt: SetTogether,
                prepare: Prepare, depth: Callable[[str], int]) -> Reply:
    async def answer(request: SetParameters.Request, response: SetParameters.Response) -> Any:
        given = list(request.parameters)
        if refusal := _unknown_type(given):
            response.results = [refusal] * len(given)
            return response
        results = [_done() if is_kept(Parameter.from_parameter_msg(each)) else None
                   for each in given]
        left = [index for index, result in enumerate(results) if result is None]
        changes = [Parameter.from_parameter_msg(given[index]) for index in left]
        if len(changes) > 1:
            await prepare(changes)
            if attempt(changes).successful:
                response.results = [_done()] * len(given)
                return response
        for index in sorted(left, key=lambda index: depth(given[index].name)):
            await prepare([Parameter.from_parameter_msg(given[index])])
            request.parameters = [given[index]]
            results[index] = callback(request, SetParameters.Response()).results[0]
        response.results = results
        return response

    return answer


def _together(callback: Callable[[Any, Any], Any], is_kept: IsKept, prepare: Prepare) -> Reply:
    async def answer(request: SetParametersAtomically.Request,
                     response: SetParametersAtomically.Response) -> Any:
        given = list(request.parameters)
        if refusal := _unknown_type(given):
            response.result = refusal
            return response
        request.parameters = [
            each for each in given if not is_kept(Parameter.from_parameter_msg(each))]
        if given and not request.parameters:
            response.result = _done()
            return response
        await prepare([Parameter.from_parameter_msg(each) for each in request.parameters])
        return callback(request, response)

    return answer


def _logged(callback: Reply, log: ThrottledLog) -> Reply:
    async def answer(request: Any, response: Any) -> Any:
        names = [each.name for each in request.parameters]
        answered = await callback(request, response)
        if isinstance(answered, SetParameters.Response):
            results = answered.results
        else:
            names, results = [', '.join(names)], [answered.result]
        for name, result in zip(names, results, strict=True):
            if not result.successful:
                log.warning('refused', f'a change of {quote(name, 100)} was rejected: '
                                       f'{quote(result.reason, 500)}')
        return answered

    return answer


def _unknown_type(given: list[Any]) -> SetParametersResult | None:
    for each in given:
        if each.value.type not in TYPES:
            return SetParametersResult(
                reason=f'{quote(each.name)}: there is no parameter type {each.value.type}')
    return None


def _done() -> SetParametersResult:
    return SetParametersResult(successful=True)
