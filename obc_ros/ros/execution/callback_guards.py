# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Guards of the callbacks of a node: no message and no request ends the node.

rclpy raises an exception in some of its own callbacks, which ends the node: for a time before 1970
on /clock, and for the type of an undeclared parameter. Any other exception in a callback is a
defect: it is logged with its traceback, and the node continues.
"""

from functools import wraps
from itertools import count
from traceback import format_exc
from typing import Any

from rcl_interfaces.srv import GetParameterTypes
from rclpy.executors import await_or_execute, ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter


def guard(node: Node) -> None:
    """Guard the clock and the parameter services of a node."""
    for service in node.services:
        if service.srv_type is GetParameterTypes:
            service.callback = lambda request, response: _types(node, request, response)
    _guard_clock(node)


def guard_callbacks(node: Node, entity: Any, name: str) -> None:
    """Log exceptions in a callback, which then end no node; a response has them."""
    callback, errors = entity.callback, count(1)

    @wraps(callback)
    async def caught(*arguments: Any) -> Any:
        try:
            return await await_or_execute(callback, *arguments)
        except ExternalShutdownException:
            raise
        except Exception as error:  # of any kind: no request may end the node
            sentence = f'{name}: {type(error).__name__}: {error} (error {next(errors)} here)'
            node.get_logger().error(f'{sentence}\n{format_exc()}')
            response: Any = arguments[-1] if arguments else None
            if hasattr(response, 'success') and hasattr(response, 'message'):
                response.success, response.message = False, sentence
            return response

    entity.callback = caught


def _types(node: Node, request: Any, response: Any) -> Any:
    response.types = [node.get_parameter_type(name) if node.has_parameter(name)
                      else Parameter.Type.NOT_SET.value for name in request.names]
    return response


def _guard_clock(node: Node) -> None:
    source = node._time_source  # rclpy has no public access to it
    take = source.clock_callback

    def take_or_drop(message: Any) -> None:
        if message.clock.sec >= 0:
            take(message)
        else:
            node.get_logger().warning(
                f'/clock: a time of {message.clock.sec} s was dropped', throttle_duration_sec=1.0)

    source.clock_callback = take_or_drop  # for a subscription that use_sim_time makes later
    if source._clock_sub is not None:
        source._clock_sub.callback = take_or_drop
