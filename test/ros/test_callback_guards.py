# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""An exception in a callback is logged and answered, and does not end the node."""

from pathlib import Path
import subprocess
import sys
from typing import Any

from obc_ros.msg import Trajectory
from obc_ros.ros.service_qos import LATCHED_QOS
from obc_ros.srv import DesignLqr
import pytest
from std_srvs.srv import Trigger
import support

# A node whose callback `callback` raises ZeroDivisionError.
DEFECT = """
from obc_ros.nodes import {module}
def defect(*_): return 1 / 0
{module}.{node}.{callback} = defect
raise SystemExit({module}.main())
"""
LATER = DEFECT.replace('def defect', 'async def defect')


def start_defective(code: str, domain: int, log: Path, **names: str) -> subprocess.Popen[bytes]:
    """Start a node whose callback raises; its output goes to `log`."""
    with log.open('wb') as output:
        return subprocess.Popen([sys.executable, '-c', code.format(**names)], stdout=output,
                                stderr=output, env=support.environment(domain))


@pytest.mark.parametrize(('code', 'module', 'node', 'callback', 'service', 'kind'), [
    (DEFECT, 'lqr_node', 'LqrNode', '_on_stop', 'stop', Trigger),
    (DEFECT, 'plant_simulator', 'PlantSimulator', '_on_reset', 'reset', Trigger),
    (LATER, 'trajectory_server', 'TrajectoryServer', '_design_lqr', 'design_lqr', DesignLqr)])
def test_a_service_reports_an_exception_of_its_callback(probe: Any, domain: int, tmp_path: Path,
                                                        code: str, module: str, node: str,
                                                        callback: str, service: str, kind: Any
                                                        ) -> None:
    """Each of two calls gets an error message, and SIGTERM still ends the node with status 0."""
    log = tmp_path / 'log'
    process = start_defective(code, domain, log, module=module, node=node, callback=callback)
    try:
        for number in (1, 2):
            response = probe.call(kind, f'/{module}/{service}', kind.Request())
            assert not response.success
            assert 'ZeroDivisionError' in response.message
            assert f'error {number}' in response.message
        process.terminate()
        assert process.wait(10.0) == 0
    finally:
        process.kill()
    assert log.read_text().count('Traceback') == 2  # one for each call


def test_an_exception_in_a_subscription_does_not_end_the_node(probe: Any, domain: int,
                                                              tmp_path: Path) -> None:
    """The traceback is logged, only that message is lost, and the services still respond."""
    log = tmp_path / 'log'
    process = start_defective(DEFECT, domain, log, module='lqr_node', node='LqrNode',
                              callback='_on_reference')
    try:
        publisher = probe.publisher(Trajectory, 'reference', LATCHED_QOS)
        publisher.publish(Trajectory())
        support.wait_for(lambda: 'ZeroDivisionError' in log.read_text())
        assert probe.call(Trigger, '/lqr_node/stop', Trigger.Request()).success
    finally:
        process.kill()
        process.wait()
