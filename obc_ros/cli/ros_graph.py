# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A node that joins the ROS graph for one command: it finds nodes, services and topics.

Every search waits for a limited time: a participant discovers the others one by one after it has
joined.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import os
import time
from typing import Any

from obc_ros.cli.processes import find_log_folder
from obc_ros.core.text.errors import ObcError
from obc_ros.ros.execution.executor import limit_leaving, summarize_error
from obc_ros.ros.middleware import choose_profile
from obc_ros.ros.service_qos import BURST
import rclpy
from rclpy.exceptions import NameValidationException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

LOOK = 5.0       # [s] to find a node: Fast DDS repeats its announcement after 3 s
QUIET = 1.5      # [s] without changes until a list is complete: nodes announce themselves each 1 s
SILENCE = 5.0    # [s] without a server until it counts as lost
NAME = '_obc'    # a hidden node: lists of nodes leave it out


class ServerLostError(ObcError):
    """The server has disappeared."""


class Graph:
    """A node that calls services of others; `check` raises if the command is to end."""

    def __init__(self, context: rclpy.Context, check: Callable[[], None] = lambda: None,
                 name: str = NAME) -> None:
        self.node: Node = rclpy.create_node(
            name, context=context, use_global_arguments=False, start_parameter_services=False)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self.node)
        self._check = check
        self.server = ''  # the name of the server in errors

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self.node.destroy_node()

    def spin(self, check: bool = True) -> None:
        """Handle one event, waiting at most 20 ms for it."""
        if check:
            self._check()
        self._executor.spin_once(timeout_sec=0.02)

    def until(self, condition: Callable[[], Any], timeout: float = LOOK) -> Any:
        """Return the value of a condition once it is true, or the last one after `timeout` [s]."""
        deadline = time.monotonic() + timeout
        while not (value := condition()) and time.monotonic() < deadline:
            self.spin()
        return value

    def settle(self, look: Callable[[], list[Any]], quiet: float = QUIET) -> list[Any]:
        """Return the value of `look`, once it has not changed for `quiet` [s]."""
        seen, since = look(), time.monotonic()
        while time.monotonic() < since + quiet:
            self.spin()
            if (now := look()) != seen:
                seen, since = now, time.monotonic()
        return seen

    def wait(self, ready: Callable[[], bool], available: Callable[[], bool], whom: str = ''
             ) -> None:
        """
        Spin until `ready`.

        :param available: returns whether the other side can be reached.
        :param whom: the other side, for the error; by default the server.
        :raises ServerLostError: if the other side has not been available for `SILENCE` seconds.
        """
        seen = time.monotonic()
        while not ready():
            self.spin()
            now = time.monotonic()
            if available():
                seen = now
            elif now > seen + SILENCE:
                raise ServerLostError(
                    f'{whom or f"the server {self.server}"} does not respond any more')

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """Return the response of a service."""
        client = self.node.create_client(kind, service, qos_profile=BURST)
        try:
            self.wait(client.service_is_ready, client.service_is_ready, f'service {service}')
            future = client.call_async(request)
            self.wait(future.done, client.service_is_ready, f'service {service}')
            return future.result()
        finally:
            self.node.destroy_client(client)

    def has_service(self, service: str, timeout: float = LOOK) -> bool:
        """Return whether a service exists, waiting at most `timeout` [s] for it."""
        return bool(self.until(lambda: service in dict(self.node.get_service_names_and_types()),
                               timeout))

    def nodes(self, hidden: bool = False) -> list[str]:
        """Return the full names of the known nodes, without this one."""
        own = self.node.get_name()
        found = (f'{namespace.rstrip("/")}/{name}' for name, namespace
                 in self.node.get_node_names_and_namespaces() if name != own)
        return sorted(each for each in found if hidden or '/_' not in each)

    def find_node(self, name: str, timeout: float = LOOK) -> str:
        """Return the full name of a node, waiting at most `timeout` [s] for it."""
        full = name if name.startswith('/') else f'/{name}'
        if not self.until(lambda: full in self.nodes(hidden=True), timeout):
            raise ObcError(f'Node not found: no node {full} within {timeout:g} s; '
                           + report_nodes(self.nodes()))
        return full


def report_nodes(nodes: list[str]) -> str:
    """Return the sentence on which nodes run; if none do, on which domain."""
    if nodes:
        return f'running: {", ".join(nodes)}'
    domain = os.environ.get('ROS_DOMAIN_ID') or '0'
    return (f'no node runs on ROS_DOMAIN_ID={domain}: start one '
            '(obc launch obc_ros loop.launch.py), or set ROS_DOMAIN_ID to its domain')


def keep_to_this_machine() -> None:
    """Limit discovery to this machine, unless the environment sets another range."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')


@contextmanager
def join_graph(check: Callable[[], None] = lambda: None, kind: Callable[..., Graph] = Graph
               ) -> Iterator[Any]:
    """
    Yield a node in the ROS graph; it leaves at the end.

    :param check: called while the node waits; raises if the command is to end.
    :param kind: returns the `Graph` for a context and `check`.
    """
    context = rclpy.Context()
    find_log_folder()
    choose_profile()
    try:
        rclpy.init(args=[], context=context)
    except RuntimeError as error:  # RCLError, for an environment that rcl rejects
        raise ObcError(summarize_error(error)) from error
    graph = kind(context, check)
    try:
        yield graph
    except NameValidationException as error:
        raise ObcError(summarize_error(error)) from error
    finally:
        with limit_leaving():
            graph.close()
            context.try_shutdown()
