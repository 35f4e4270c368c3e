# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Services of the controllers while a change takes long: ~/stop is answered and cancels it."""

import time

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from mpc_bench import LONG, Loop
from obc_ros.ros.execution.worker_thread import CancelledError, WorkerThread
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

pytestmark = [pytest.mark.slow, pytest.mark.nodes]
HOVER = pytest.approx([0.0, 39.2])


def test_the_desk_computes_what_is_asked_and_cancels_changes(probe):
    desk, told = WorkerThread(probe.node), []

    async def ask(number, is_change):
        try:
            told.append(await desk.run(lambda: (time.sleep(0.05), number)[1], is_change))
        except CancelledError as error:
            told.append(str(error))

    for number, is_change in enumerate((False, True, True, False)):
        probe.executor.create_task(ask(number, is_change))
    probe.wait_for(lambda: told, what='the first result')
    desk.cancel('by test')
    probe.wait_for(lambda: len(told) == 4, what='all results')
    assert sorted(map(str, told)) == ['0', '3', 'by test', 'by test']
    desk.close()


def test_a_change_that_is_computed_but_not_adopted_is_cancelled(probe):
    """As by a stop that is served between the result and the callback that awaits it."""
    desk, told = WorkerThread(probe.node), []

    async def ask_later():
        told.append(await desk.run(lambda: 'later'))

    change = desk.run(lambda: 'a result', is_change=True)
    change.send(None)
    probe.executor.create_task(ask_later())
    probe.wait_for(lambda: told, what='the results')
    desk.cancel('by test')
    with pytest.raises(CancelledError, match='by test'):
        change.send(None)
    desk.close()


def test_a_stop_is_answered_during_a_change_and_cancels_it(spawn, probe):
    """The process of a changed problem takes a while to start, in which the loop flies on."""
    loop = Loop(spawn, probe)
    loop.wait_until_planned()
    client = probe.node.create_client(SetParameters, 'mpc_node/set_parameters')
    probe.wait_for(client.service_is_ready)
    adopted = []
    for attempt in range(20):   # a fast machine may be ready before the stop
        wanted = [9.0 + attempt, 9.0, 1.0, 1.0, 1.0, 1.0]
        change = client.call_async(SetParameters.Request(
            parameters=[Parameter('Qx', value=wanted).to_parameter_msg()]))
        seen = len(loop.commands)
        probe.wait_for(lambda: len(loop.commands) > seen, LONG, 'the loop flies on')  # noqa: B023
        assert probe.call(Trigger, 'mpc_node/stop').success
        probe.wait_for(change.done, LONG, 'the answer to the change')
        result = change.result().results[0]
        if not result.successful:
            break
        adopted = wanted
        assert probe.call(Trigger, 'mpc_node/start').success
    assert not result.successful
    assert result.reason == 'cancelled by ~/stop'
    probe.wait_for(lambda: loop.commands[-1].u == HOVER, LONG, 'rest')
    assert list(probe.get_parameters('/mpc_node', 'Qx')['Qx']) == adopted


def test_a_node_without_a_first_plan_tries_again_and_reports_an_error(spawn, probe):
    """It becomes active by itself once a plan begins at the state."""
    loop = Loop(spawn, probe, x0=[2.0, *5 * [0.0]])
    loop.node.wait_for_output('not active yet: no plan keeps the bounds from here', LONG)

    def level():
        return next((status.level for report in reversed(loop.reports) for status in report.status
                     if status.name == 'mpc_node: states'), None)

    probe.wait_for(lambda: level() == b'\x02', LONG, 'an error')
    assert not loop.is_active()
    assert probe.set_parameters('/mpc_node', x_bounds=[])[0].successful
    probe.wait_for(loop.is_active, LONG, 'activation')
    probe.wait_for(lambda: level() == b'\x00', LONG, 'no error any more')
    request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
    assert probe.call(ChangeState, 'mpc_node/change_state', request).success
    probe.spin_for(3.0)
    assert not loop.is_active(), 'who deactivates it decides'
