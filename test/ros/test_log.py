# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The log on /rosout: every event has a line, and repeated events are throttled."""

from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from lqr_bench import Bench
from obc_ros.ros.throttled_log import LOG_BURST
import pytest
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import SetBool, Trigger

pytestmark = pytest.mark.nodes

ROSOUT = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LINE = {'system': 'double_integrator'}


@pytest.fixture
def log(probe: Any) -> list[Log]:
    """Return the list to which the log lines of all nodes are appended."""
    return probe.listen(Log, '/rosout', ROSOUT)  # type: ignore[no-any-return]


def wait_for_line(probe: Any, log: list[Log], words: str, level: Any) -> Log:
    """Return the first line of a level that contains `words`."""
    return probe.wait_for(  # type: ignore[no-any-return]
        lambda: next((each for each in log if words in each.msg and each.level == level), None),
        what=f'a line with {words!r}')


def test_a_refusal_stop_start_and_transitions_are_logged(spawn: Any, probe: Any, log: list[Log]
                                                         ) -> None:
    Bench(spawn, probe, **LINE)
    [result] = probe.set_parameters('/lqr_node', Qu=[-1.0])
    assert not result.successful
    assert result.reason in wait_for_line(probe, log, 'a change of Qu was rejected', Log.WARN).msg
    probe.call(Trigger, '/lqr_node/stop')
    wait_for_line(probe, log, '~/stop: stopped at', Log.WARN)
    probe.call(Trigger, '/lqr_node/start')
    wait_for_line(probe, log, '~/start: started again', Log.INFO)
    for transition, words in ((Transition.TRANSITION_DEACTIVATE, 'deactivated'),
                              (Transition.TRANSITION_ACTIVATE, 'activated: the loop runs')):
        log.clear()
        request = ChangeState.Request(transition=Transition(id=transition))
        assert probe.call(ChangeState, '/lqr_node/change_state', request).success
        wait_for_line(probe, log, words, Log.INFO)


def test_lost_and_returned_states_are_logged(spawn: Any, probe: Any, log: list[Log]) -> None:
    bench = Bench(spawn, probe, state_timeout=0.3, **LINE)
    bench.ask([0.1, 0.0])
    wait_for_line(probe, log, 'no valid state for 0.3 s', Log.WARN)
    bench.answer([0.1, 0.0])
    line = wait_for_line(probe, log, 'states have returned after ', Log.INFO).msg
    assert float(line.split()[4]) >= 0.3


def test_repeated_refusals_do_not_flood_the_log(spawn: Any, probe: Any, log: list[Log]) -> None:
    Bench(spawn, probe, **LINE)
    for _ in range(5 * LOG_BURST):
        probe.set_parameters('/lqr_node', Qu=[-1.0])
    probe.call(Trigger, '/lqr_node/stop')
    wait_for_line(probe, log, '~/stop', Log.WARN)   # lines arrive in order: all refusals are here
    refused = [each for each in log if 'a change of Qu was rejected' in each.msg]
    assert LOG_BURST <= len(refused) < 4 * LOG_BURST


def test_the_plant_logs_reset_and_pause(spawn: Any, probe: Any, log: list[Log]) -> None:
    spawn('plant_simulator', LINE)
    probe.call(Trigger, '/plant_simulator/reset')
    wait_for_line(probe, log, '~/reset: at ', Log.INFO)
    probe.call(SetBool, '/plant_simulator/pause', SetBool.Request(data=True))
    wait_for_line(probe, log, '~/pause: paused at t = ', Log.INFO)
