# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A node that tests use to talk to nodes over DDS."""

from collections.abc import Callable, Mapping
import gc
import time
from typing import Any

from obc_ros.core.text.errors import ObcError
import pytest
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from support import DEADLINE


class Probe:
    """A node that listens, publishes, calls services and spins on demand."""

    def __init__(self, domain: int, name: str = 'probe', namespace: str = '') -> None:
        """Create the node in its own context; it spins only while a method waits."""
        self.context = Context()
        self.context.init(args=[], domain_id=domain)
        self.node = Node(name, namespace=namespace, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.actions: list[ActionClient] = []

    def close(self) -> None:
        """Destroy the node and its context."""
        for client in self.actions:
            client.destroy()
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def add(self, node: Node) -> None:
        """Spin `node`, created with ``context=probe.context``, in the same executor."""
        self.executor.add_node(node)

    def wait_for(
        self, condition: Callable[[], Any], timeout: float = DEADLINE, what: str = ''
    ) -> Any:
        """Spin until `condition` is true and return its value; fail at the timeout."""
        deadline = time.monotonic() + timeout
        while not (value := condition()):
            assert time.monotonic() < deadline, f'not within {timeout} s: {what or condition}'
            self.executor.spin_once(timeout_sec=0.02)
        return value

    def spin_until(self, condition: Callable[[], Any], duration: float) -> None:
        """Spin until `condition` is true, for at most `duration` seconds."""
        deadline = time.monotonic() + duration
        while not condition() and (left := deadline - time.monotonic()) > 0:
            self.executor.spin_once(timeout_sec=left)

    def spin_for(self, duration: float) -> None:
        """Spin for `duration` seconds, to show that something does *not* happen."""
        deadline = time.monotonic() + duration
        while (left := deadline - time.monotonic()) > 0:
            self.executor.spin_once(timeout_sec=left)

    def listen(self, message_type: type, topic: str, qos: Any = 10) -> list[Any]:
        """Subscribe and return the list to which messages are appended."""
        received: list[Any] = []
        self.node.create_subscription(message_type, topic, received.append, qos)
        return received

    def publisher(self, message_type: type, topic: str, qos: Any = 10, matched: int = 1) -> Any:
        """Return a publisher after `matched` subscriptions have been discovered."""
        publisher = self.node.create_publisher(message_type, topic, qos)
        self.wait_for(lambda: publisher.get_subscription_count() >= matched,
                      what=f'{matched} subscription(s) of {topic}')
        return publisher

    def refusal(self, node: type[Node], parameters: Mapping[str, Any]) -> str:
        """Return why `node` does not start with parameters; it is created in this process."""
        with pytest.raises(ObcError) as refused:
            node(context=self.context, parameter_overrides=[
                Parameter(name, value=value) for name, value in parameters.items()])
        reason = str(refused.value)
        del refused
        gc.collect()   # what was created of the node, its participant of DDS above all
        return reason

    def wait_for_node(self, name: str, timeout: float = DEADLINE) -> None:
        """Wait until a node of that name (without namespace) is discovered."""
        self.wait_for(lambda: name in self.node.get_node_names(), timeout, f'node {name}')

    def call(
        self, service_type: Any, service: str, request: Any = None, timeout: float = DEADLINE
    ) -> Any:
        """Call `service` and return its response."""
        client = self.node.create_client(service_type, service)
        try:
            self.wait_for(client.service_is_ready, timeout, f'service {service}')
            future = client.call_async(request or service_type.Request())
            self.wait_for(future.done, timeout, f'response of {service}')
            return future.result()
        finally:
            self.node.destroy_client(client)

    def get_parameters(self, node: str, *names: str) -> dict[str, Any]:
        """Return the values of parameters of `node` (a name such as ``/lqr_node``)."""
        request = GetParameters.Request(names=names)
        values = self.call(GetParameters, f'{node}/get_parameters', request).values
        return dict(zip(names, map(parameter_value_to_python, values), strict=True))

    def set_parameters(self, node: str, **values: Any) -> list[Any]:
        """Set parameters one by one; return a SetParametersResult for each."""
        request = SetParameters.Request(parameters=build_parameters(values))
        return list(self.call(SetParameters, f'{node}/set_parameters', request).results)

    def set_parameters_atomically(self, node: str, **values: Any) -> Any:
        """Set all parameters or none; return the SetParametersResult."""
        request = SetParametersAtomically.Request(parameters=build_parameters(values))
        service = f'{node}/set_parameters_atomically'
        return self.call(SetParametersAtomically, service, request).result

    def send_goal(
        self,
        action_type: Any,
        action: str,
        goal: Any,
        feedback: Callable[[Any], None] | None = None,
    ) -> Any:
        """Send a goal and return the goal handle, accepted or not."""
        client = ActionClient(self.node, action_type, action)
        self.actions.append(client)
        self.wait_for(client.server_is_ready, what=f'action {action}')
        future = client.send_goal_async(goal, feedback)
        self.wait_for(future.done, what=f'answer to the goal of {action}')
        return future.result()

    def result(self, goal_handle: Any, timeout: float = DEADLINE) -> Any:
        """Return status and result of an accepted goal when they are available."""
        future = goal_handle.get_result_async()
        self.wait_for(future.done, timeout, 'result of the goal')
        return future.result()

    def cancel(self, goal_handle: Any) -> Any:
        """Request the cancellation of a goal and return the response."""
        future = goal_handle.cancel_goal_async()
        self.wait_for(future.done, what='answer to the cancel request')
        return future.result()


def build_parameters(values: Mapping[str, Any]) -> list[Any]:
    """Return the messages of parameters."""
    return [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
