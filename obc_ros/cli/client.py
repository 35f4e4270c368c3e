# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A client of the trajectory server: of a running one, or of one that the command starts."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import os
from typing import Any

from obc_ros.action import SolveOptimalControl
from obc_ros.cli.processes import APPEARS, Children, is_domain_used
from obc_ros.cli.ros_graph import Graph, join_graph, ServerLostError
from obc_ros.cli.terminal import EndSignals
from obc_ros.core.text.errors import ObcError
from obc_ros.ros.service_qos import BURST
from rcl_interfaces.srv import GetParameters
import rclpy
from rclpy.action import ActionClient, get_action_names_and_types
from rclpy.parameter import parameter_value_to_python

ACTION = 'obc_ros/action/SolveOptimalControl'
CLIENT_LOOK = 1.0  # [s] to look for a server if no process of this machine uses the domain
LOOK_HERE = 4.0    # [s] if one does: Fast DDS repeats its announcement after 3 s
PARTICIPANTS = 32


class Client(Graph):
    """Requests to one trajectory server."""

    def __init__(self, context: rclpy.Context, check: Callable[[], None]) -> None:
        super().__init__(context, check, 'obc')

    def find(self, timeout: float, name: str = '') -> bool:
        """Look for a server for `timeout` seconds; return whether one was found."""
        def look() -> str:
            return next((each for each in self.list_servers() if name in ('', each)), '')

        self.server = self.until(look, timeout)
        return bool(self.server)

    def list_servers(self) -> list[str]:
        """Return the full names of the known servers, sorted."""
        return sorted(name.rpartition('/')[0] for name, types in get_action_names_and_types(
            self.node) if ACTION in types)

    def ask(self, service_type: Any, name: str, request: Any) -> Any:
        """Return the response of the server's service `name`."""
        return self.call(service_type, f'{self.server}/{name}', request)

    def parameter(self, name: str) -> Any:
        """Return the value of a parameter of the server."""
        values = self.ask(GetParameters, 'get_parameters', GetParameters.Request(names=[name]))
        return parameter_value_to_python(values.values[0])

    def action(self) -> ActionClient:
        """Return a client of the server's action, once the action is available."""
        client = ActionClient(
            self.node, SolveOptimalControl, f'{self.server}/solve_optimal_control',
            goal_service_qos_profile=BURST, result_service_qos_profile=BURST,
            cancel_service_qos_profile=BURST, feedback_sub_qos_profile=BURST)
        self.wait(client.server_is_ready, client.server_is_ready)
        return client


@contextmanager
def connect_client(server: str = '') -> Iterator[Client]:
    """
    Yield a client of a running server, of the first one by name if none is given.

    It and its methods raise InterruptedByUserError on a signal, ServerLostError if the server
    disappears.
    """
    with EndSignals() as signals, join_graph(signals.check, Client) as client:
        if not client.find(LOOK_HERE if is_own_domain_used() else CLIENT_LOOK, server):
            raise ObcError(_report_servers(server, client.list_servers()))
        yield client


def _report_servers(wanted: str, running: list[str]) -> str:
    if running:
        return f'no trajectory_server {wanted} is running; there is {", ".join(running)}'
    domain = os.environ.get('ROS_DOMAIN_ID') or '0'
    return (f'no trajectory_server runs on ROS_DOMAIN_ID={domain}: start one '
            '(obc run obc_ros trajectory_server), or leave out --server')


@contextmanager
def serve_client(children: Children, *parameters: str) -> Iterator[Client]:
    """Start a server with parameters ``name:=value`` on the own domain, and yield a client."""
    children.start('trajectory_server', *(
        word for each in parameters for word in ('-p', each)))
    with join_graph(children.check, Client) as client:
        if not client.find(APPEARS):
            raise ServerLostError(f'no trajectory_server appears within {APPEARS:g} s')
        yield client


def is_own_domain_used() -> bool:
    """Return whether a process of this machine takes part in the domain of this process."""
    domain = os.environ.get('ROS_DOMAIN_ID', '')
    return is_domain_used(int(domain) if domain.isdigit() else 0, PARTICIPANTS)
