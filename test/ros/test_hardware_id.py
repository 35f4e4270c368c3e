# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The hardware_id in the diagnostics of each node."""

from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import pytest


@pytest.mark.parametrize(('executable', 'default'), [
    ('plant_simulator', 'aircraft'), ('lqr_node', 'aircraft'),
    ('trajectory_server', 'trajectory_server')])
def test_every_status_has_the_hardware_id(spawn: Any, probe: Any, executable: str, default: str
                                          ) -> None:
    """It is the parameter, else the namespace, else the system or the node; it may change."""
    arrays = probe.listen(DiagnosticArray, '/diagnostics')
    spawn(executable)
    spawn(executable, namespace='/yard/robot1')
    spawn(executable, {'hardware_id': 'serial 0042'}, namespace='/robot2')
    node = f'robot2/{executable}'

    def hardware() -> dict[str, set[str]]:
        found: dict[str, set[str]] = {}
        for status in (each for array in arrays for each in array.status):
            found.setdefault(status.name.split(':')[0], set()).add(status.hardware_id)
        return found

    wanted = {executable: {default}, f'yard/robot1/{executable}': {'yard/robot1'},
              node: {'serial 0042'}}
    probe.wait_for(lambda: wanted.keys() <= hardware().keys(), what='a report of each')
    assert hardware() == wanted
    assert probe.set_parameters(f'/{node}', hardware_id=' ')[0].successful
    arrays.clear()
    probe.wait_for(lambda: 'robot2' in hardware().get(node, ()), what='another name')
