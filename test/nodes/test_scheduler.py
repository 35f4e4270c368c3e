# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The trajectory server with a Dask cluster: requests, loss of the cluster, bad addresses."""

from dask_cluster import Cluster
from diagnostic_msgs.msg import DiagnosticArray
from obc_ros.core.ocp.statement import build_problem
from obc_ros.ros.messages import build_problem_message
from obc_ros.srv import SolveOptimalControl
import problems
import pytest
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters

pytest.importorskip('distributed')
pytestmark = pytest.mark.nodes

SERVER = '/trajectory_server'


def solve(probe):
    """Return the response for the double integrator of minimum time."""
    mapping = problems.read('di_mintime_rest')
    message = build_problem_message(mapping, build_problem(mapping).guess)
    return probe.call(SolveOptimalControl, f'{SERVER}/solve',
                      SolveOptimalControl.Request(problem=message), timeout=60.0)


def test_requests_go_to_the_cluster_and_back(spawn, probe):
    cluster = Cluster()
    try:
        cluster.add_worker()
        server = spawn('trajectory_server', {'workers': 1, 'scheduler': cluster.address})
        server.wait_for_output(f'requests go to the cluster {cluster.address}, 1 threads', 60.0)
        told = probe.listen(DiagnosticArray, '/diagnostics')
        assert solve(probe).objective == pytest.approx(2.0)
        probe.wait_for(lambda: told and '1 threads' in told[-1].status[0].message)
        for process in cluster.processes:
            process.kill()
        server.wait_for_output('requests go to the processes of this server', 30.0)
        probe.wait_for(lambda: 'cannot be used' in told[-1].status[0].message)
        assert told[-1].status[0].level != b'\0'
        assert solve(probe).status == 'solved'
    finally:
        for process in reversed(cluster.processes):
            process.kill()
            process.wait()


def test_nobody_chooses_the_cluster_of_a_running_server(spawn, probe):
    """What a cluster answers is unpickled: its address is the operator's."""
    spawn('trajectory_server', {'workers': 1})
    [result] = probe.call(SetParameters, f'{SERVER}/set_parameters', SetParameters.Request(
        parameters=[Parameter(name='scheduler', value=ParameterValue(
            type=ParameterType.PARAMETER_STRING, string_value='tcp://127.0.0.1:8786'))])).results
    assert not result.successful
    assert 'read-only' in result.reason
    assert probe.get_parameters(SERVER, 'scheduler')['scheduler'] == ''
    assert solve(probe).status == 'solved'


def test_a_malformed_address_is_refused(spawn):
    server = spawn('trajectory_server', {'workers': 1, 'scheduler': 'host:8786'})
    assert server.wait() == 1
    assert 'tcp://host:8786' in server.output()


def test_an_open_connection_is_said_in_the_log(spawn):
    """192.0.2.0/24 is for documentation: nobody answers there."""
    server = spawn('trajectory_server', {'workers': 1, 'scheduler': 'tcp://192.0.2.1:8786'})
    server.wait_for_output('can run programs on this machine; use tls://')
