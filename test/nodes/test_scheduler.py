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


def test_a_malformed_address_is_refused(spawn, probe):
    spawn('trajectory_server', {'workers': 1})
    value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value='host:8786')
    [result] = probe.call(SetParameters, f'{SERVER}/set_parameters', SetParameters.Request(
        parameters=[Parameter(name='scheduler', value=value)])).results
    assert not result.successful and 'tcp://host:8786' in result.reason
    assert solve(probe).status == 'solved'
