# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A node that waits for a /clock that nobody publishes says so."""

from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import pytest
from rosgraph_msgs.msg import Clock

SENTENCE = 'use_sim_time is true, but no node publishes /clock: time stands still'


@pytest.mark.parametrize('executable', ['plant_simulator', 'lqr_node', 'estimator_node'])
def test_a_missing_clock_is_reported_once_and_until_it_is_there(spawn: Any, probe: Any,
                                                                executable: str) -> None:
    arrays = probe.listen(DiagnosticArray, '/diagnostics')
    node = spawn(executable, {'use_sim_time': True})

    def find_faults() -> list[Any]:
        return [each.level for each in arrays[-1].status if SENTENCE in each.message]

    node.wait_for_output(SENTENCE)
    probe.wait_for(lambda: arrays and find_faults() == [DiagnosticStatus.ERROR])
    count = len(arrays)
    probe.wait_for(lambda: len(arrays) > count + 2)
    assert node.output().count(SENTENCE) == 1
    clock = probe.node.create_publisher(Clock, '/clock', 1)
    probe.wait_for(lambda: not find_faults(), what='the end of the report')
    probe.node.destroy_publisher(clock)
    probe.wait_for(lambda: node.output().count(SENTENCE) == 2, what='a second report')


def test_a_node_with_a_clock_or_without_use_sim_time_says_nothing(spawn: Any, probe: Any) -> None:
    arrays = probe.listen(DiagnosticArray, '/diagnostics')
    nodes = [spawn('plant_simulator', {'use_sim_time': True, 'publish_clock': True}),
             spawn('plant_simulator', namespace='/other')]
    probe.wait_for(lambda: len(arrays) > 10, what='reports of five seconds')
    assert not any('/clock' in node.output() for node in nodes)
    assert not any('/clock' in each.message for array in arrays for each in array.status)
