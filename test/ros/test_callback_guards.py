# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A defect in a callback is told and answered, and does not end the node."""

from pathlib import Path
import subprocess
import sys
from typing import Any

from obc_ros.msg import Trajectory
from obc_ros.nodes.lqr_node import DESIGN_QOS
from obc_ros.srv import DesignLqr
import pytest
from std_srvs.srv import Trigger
import support

# A node with a defect in one of its callbacks.
DEFECT = """
from obc_ros.nodes import {module}
def defect(*_): return 1 / 0
{module}.{node}.{callback} = defect
raise SystemExit({module}.main())
"""
LATER = DEFECT.replace('def defect', 'async def defect')


def defective(code: str, domain: int, log: Path, **names: str) -> subprocess.Popen[bytes]:
    """Start a node with a defect."""
    with log.open('wb') as output:
        return subprocess.Popen([sys.executable, '-c', code.format(**names)], stdout=output,
                                stderr=output, env=support.environment(domain))


@pytest.mark.parametrize(('code', 'module', 'node', 'callback', 'service', 'kind'), [
    (DEFECT, 'lqr_node', 'LqrNode', '_on_stop', 'stop', Trigger),
    (DEFECT, 'plant_simulator', 'PlantSimulator', '_on_reset', 'reset', Trigger),
    (LATER, 'trajectory_server', 'TrajectoryServer', '_design_lqr', 'design_lqr', DesignLqr)])
def test_a_service_with_a_defect_answers(probe: Any, domain: int, tmp_path: Path, code: str,
                                         module: str, node: str, callback: str, service: str,
                                         kind: Any) -> None:
    """Twice, and the node ends as it should."""
    log = tmp_path / 'log'
    process = defective(code, domain, log, module=module, node=node, callback=callback)
    try:
        for number in (1, 2):
            answer = probe.call(kind, f'/{module}/{service}', kind.Request())
            assert not answer.success
            assert 'ZeroDivisionError' in answer.message
            assert f'error {number}' in answer.message
        process.terminate()
        assert process.wait(10.0) == 0
    finally:
        process.kill()
    assert log.read_text().count('Traceback') == 2  # a defect is not hidden


def test_a_topic_with_a_defect(probe: Any, domain: int, tmp_path: Path) -> None:
    """What it brings is lost, and no more."""
    log = tmp_path / 'log'
    process = defective(DEFECT, domain, log, module='lqr_node', node='LqrNode',
                        callback='_on_reference')
    try:
        publisher = probe.publisher(Trajectory, 'reference', DESIGN_QOS)
        publisher.publish(Trajectory())
        support.wait_for(lambda: 'ZeroDivisionError' in log.read_text())
        assert probe.call(Trigger, '/lqr_node/stop', Trigger.Request()).success
    finally:
        process.kill()
        process.wait()
