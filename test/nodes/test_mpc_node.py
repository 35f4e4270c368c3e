# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""mpc_node over DDS: activation, faults of the solver and of the states, changes of parameters."""

import math
import os
import signal

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from mpc_bench import BOUND, BOUNDS, LONG, Loop
import numpy as np
from obc_ros.msg import LqrDesign
from obc_ros.workers.processes.real_time import find_priority_refusal
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger

pytestmark = [pytest.mark.slow, pytest.mark.nodes]
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def test_plans_are_followed_and_published(spawn, probe):
    loop = Loop(spawn, probe)
    designs = probe.listen(LqrDesign, 'mpc_node/design', LATCHED)
    loop.wait_until_planned()
    plan = loop.plans[-1]
    assert (len(plan.t), len(plan.x), len(plan.u)) == (51, 306, 102)
    assert plan.interpolation == 'zoh'
    assert np.diff(plan.t) == pytest.approx(0.02)
    probe.wait_for(lambda: 'terminal set' in designs[-1].sentence, LONG)
    probe.wait_for(lambda: np.abs(loop.states[-1].x).max() < 1e-3, LONG, 'the set point')
    assert loop.is_active()
    loop.node.wait_for_output('the first plan is linear', LONG)
    probe.wait_for(lambda: loop.figure('first plan') == 'the first plan is linear', LONG)


def test_activation_is_refused_with_the_reason_where_no_plan_begins(spawn, probe):
    loop = Loop(spawn, probe, x0=[2.0 * BOUND, *5 * [0.0]])
    loop.node.wait_for_output('not active yet: no plan keeps the bounds from here', LONG)
    assert not loop.is_active()
    assert not loop.commands
    request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_ACTIVATE))
    assert not probe.call(ChangeState, 'mpc_node/change_state', request).success
    refused = probe.set_parameters('/mpc_node', path_constraints=['pxx - 3'])[0]
    assert not refused.successful
    assert "unknown name 'pxx'" in refused.reason
    assert probe.set_parameters('/mpc_node', x_bounds=[])[0].successful
    probe.wait_for(loop.is_active, LONG, 'activation')   # by itself
    probe.wait_for(lambda: loop.commands, LONG)


@pytest.mark.parametrize(('number', 'count'), [
    (signal.SIGKILL, 'solver ended'), (signal.SIGSTOP, 'solver silent')])
def test_a_lost_solver_is_replaced_while_the_loop_goes_on(spawn, probe, number, count):
    loop = Loop(spawn, probe)
    loop.wait_until_planned()
    lost = loop.solver()
    os.kill(lost, number)
    loop.node.wait_for_output('the solver process has been replaced', LONG)
    assert loop.solver() != lost
    loop.wait_until_planned()
    probe.wait_for(lambda: loop.figure(count) == '1', LONG, count)
    assert np.abs([state.x for state in loop.states]).max() < 0.1
    del loop.commands[:], loop.states[:]
    probe.wait_for(lambda: len(loop.states) > 50 and len(loop.commands) > 40, LONG, 'commands')


def test_each_solver_process_has_the_priority_or_the_log_says_why_not(spawn, probe):
    """One less than the threads of the node, which have one less than those of DDS."""
    loop = Loop(spawn, probe, priority=7)
    loop.wait_until_planned()
    refusal = find_priority_refusal(5)
    for _ in range(2):
        pid = loop.solver()
        found = os.sched_getscheduler(pid), os.sched_getparam(pid).sched_priority
        assert found == ((os.SCHED_OTHER, 0) if refusal else (os.SCHED_FIFO, 5))
        os.kill(pid, signal.SIGKILL)
        loop.node.wait_for_output('the solver process has been replaced', LONG)
    assert (f'the solver process: {refusal}' in loop.node.output()) == bool(refusal)


def test_a_solver_that_uses_its_deadline_of_seconds_is_not_replaced(spawn, probe):
    """It answers after 1.5 of 2 s."""
    loop = Loop(spawn, probe, rate=0.4, horizon=10.0, deadline=2.0)
    loop.wait_until_planned()
    assert [loop.figure(f'solver {kind}') for kind in ('ended', 'silent', 'unsent')] == ['0'] * 3
    assert loop.figure('deadlines missed') == '0'


def test_changed_weights_are_adopted_with_their_problem_or_refused(spawn, probe):
    loop = Loop(spawn, probe)
    loop.wait_until_planned()
    designs = probe.listen(LqrDesign, 'mpc_node/design', LATCHED)
    first = loop.solver()
    assert probe.set_parameters('/mpc_node', Qx=[9.0, 9.0, 1.0, 1.0, 1.0, 1.0])[0].successful
    probe.wait_for(lambda: designs and designs[-1].revision > 1, LONG, 'the design')
    assert loop.solver() != first
    loop.wait_until_planned()
    second = loop.solver()
    refused = probe.set_parameters('/mpc_node', Qu=[-1.0, 1.0])[0]
    assert not refused.successful
    assert 'Qu' in refused.reason
    # From the present state, near the set point, no plan keeps px below -1.
    refused = probe.set_parameters('/mpc_node', x_bounds=[-2.0, -1.0, *BOUNDS[2:]])[0]
    assert not refused.successful
    assert 'no plan keeps the bounds from here' in refused.reason
    assert loop.solver() == second, 'the process of a refused change must end'
    loop.wait_until_planned()


@pytest.mark.parametrize(('name', 'value', 'words'), [
    ('x_bounds', [1.0], 'x_bounds'), ('x_bounds', [math.nan] * 12, 'x_bounds'),
    ('horizon', -1.0, 'horizon'), ('horizon', 1e3, 'horizon'), ('horizon', math.nan, 'horizon'),
    ('deadline', math.inf, 'deadline'), ('Qx', [1e999] * 6, 'Qx'), ('rate', 10.0, 'rate'),
    ('path_constraints', [1.0], 'path_constraints'), ('system', 'vehicle', 'system'),
    ('no_such_name', 1, 'no_such_name')])
def test_a_hostile_value_is_refused_and_changes_nothing(running, name, value, words):
    loop, probe = running
    result = probe.set_parameters('/mpc_node', **{name: value})[0]
    assert not result.successful
    assert words in result.reason
    assert loop.node.running()


@pytest.fixture(scope='module')
def running(request, tmp_path_factory):
    """Yield one loop for many changes."""
    from obc_ros.cli.processes import reserve_domain
    from probes import Probe
    from support import Spawner
    with reserve_domain() as domain:
        spawner, probe = Spawner(tmp_path_factory.mktemp('loop'), domain), Probe(domain)
        loop = Loop(spawner, probe)
        loop.wait_until_planned()
        yield loop, probe
        probe.close()
        assert not spawner.end()


def test_states_that_stay_away_are_answered_by_rest_and_the_loop_recovers(spawn, probe):
    loop = Loop(spawn, probe, state_timeout=0.3)
    loop.wait_until_planned()
    loop.plant.popen.send_signal(signal.SIGSTOP)
    loop.node.wait_for_output('no valid state for 0.3 s; on_stale: equilibrium', LONG)
    probe.wait_for(lambda: list(loop.commands[-1].u) == pytest.approx([0.0, 39.2]), LONG, 'rest')
    loop.plant.popen.send_signal(signal.SIGCONT)
    loop.node.wait_for_output('states have returned', LONG)
    loop.wait_until_planned()


@pytest.mark.parametrize('on_stale', ['equilibrium', 'silent'])
def test_stop_holds_the_input_at_rest_until_start(spawn, probe, on_stale):
    loop = Loop(spawn, probe, on_stale=on_stale)
    loop.wait_until_planned()
    assert probe.call(Trigger, 'mpc_node/stop').success
    del loop.commands[:]
    probe.wait_for(lambda: len(loop.commands) > 20, LONG)
    assert [list(each.u) for each in loop.commands[-10:]] == [pytest.approx([0.0, 39.2])] * 10
    assert probe.call(Trigger, 'mpc_node/start').success
    loop.wait_until_planned()
