# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The loop of plant_simulator and lqr_node: states as in one process, and recovery."""

import signal

from lqr_bench import Heard
import numpy as np
from obc_ros.core.simulation.simulator import Simulator
from obc_ros.core.systems import registry
from obc_ros.msg import Command, LqrDesign, State
from obc_ros.ros.messages import read_nanoseconds
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from support import DEMO

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
X0 = [1.0, -1.0, 0.1, 0.0, 0.0, 0.0]
PLANT = {'system': 'aircraft', 'x0': X0}
CONTROLLER = {**DEMO, 'system': 'aircraft', 'stamp_timeout': 0.0}   # lockstep is simulated
LOCKSTEP = {**PLANT, 'lockstep': True, 'speed': 0.0}


@pytest.mark.check
def test_the_loop_over_dds_equals_the_loop_in_one_process(spawn, probe):
    count, all_of_them = 2000, 5000   # the probe is slower than the loop
    states = probe.listen(State, 'state', QoSProfile(depth=all_of_them))
    designs = probe.listen(LqrDesign, 'lqr_node/design', LATCHED)
    spawn('plant_simulator', {
        **LOCKSTEP, 'qos_overrides./state.publisher.depth': all_of_them})
    probe.wait_for(lambda: states, what='the first state, which waits for its answer')
    spawn('lqr_node', CONTROLLER)
    probe.wait_for(lambda: read_nanoseconds(states[-1].header.stamp) > count * 5_000_000
                   and designs)
    design = designs[-1]
    K, xe, ue = np.reshape(design.k, (2, 6)), np.array(design.xe), np.array(design.ue)
    simulator = Simulator(registry.get_system('aircraft'), X0)
    wanted = []
    for _ in range(count):
        wanted.append(simulator.x)
        simulator.command(ue - K @ (simulator.x - xe))
        simulator.advance(5)
    received = {read_nanoseconds(state.header.stamp) // 5_000_000: state.x for state in states}
    assert set(received) >= set(range(count))
    assert max(np.abs(x - np.array(received[k])).max() for k, x in enumerate(wanted)) < 1e-12


@pytest.mark.parametrize('parameters', [PLANT, LOCKSTEP], ids=['real time', 'lockstep'])
@pytest.mark.parametrize('victim', ['plant_simulator', 'lqr_node'])
def test_a_killed_and_restarted_node_rejoins_the_loop(spawn, probe, victim, parameters):
    # At rest the is_waiting command keeps the plant in place.
    nodes = {'plant_simulator': {**parameters, 'x0': [0.0] * 6},
             'lqr_node': CONTROLLER}
    running = {name: spawn(name, given) for name, given in nodes.items()}
    traffic = Heard(probe)
    probe.wait_for(lambda: traffic.answers > 30, what='states that are answered')
    running[victim].kill()
    probe.spin_for(0.3)
    traffic.clear()
    spawn(victim, nodes[victim])
    probe.wait_for(lambda: traffic.answers > 30, what='states that are answered again')
    assert np.abs(traffic.x).max() < 1e-3


def test_a_stopped_controller_only_delays_lockstep(spawn, probe):
    plant = spawn('plant_simulator', LOCKSTEP)
    controller = spawn('lqr_node', CONTROLLER)
    commands = probe.listen(Command, 'command')
    states = probe.listen(State, 'state')
    probe.wait_for(lambda: states and len(commands) > 100)
    controller.popen.send_signal(signal.SIGSTOP)

    def is_waiting():   # no state is in transit any more
        stamp = states[-1].header.stamp
        probe.spin_for(0.2)
        return states[-1].header.stamp == stamp

    probe.wait_for(is_waiting, what='the plant to wait')
    before = states[-1]
    probe.spin_for(0.5)
    assert states[-1].header.stamp == before.header.stamp, 'only the last state is sent again'
    assert states[-1].x == before.x
    count = len(commands)
    controller.popen.send_signal(signal.SIGCONT)
    probe.wait_for(lambda: len(commands) > count + 100)
    assert plant.running()
