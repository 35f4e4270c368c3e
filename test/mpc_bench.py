# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""mpc_node with a linear plan and a simulated plant."""

import math
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import GetState
from obc_ros.msg import Command, State, Trajectory
from support import DEMO

NEAR = [0.02, 0.0, 0.0, 0.0, 0.0, 0.0]   # inside the terminal set of the stand-in
BOUND = 1.0
BOUNDS = [-math.inf, BOUND, *5 * [-math.inf, math.inf]]
STAND_IN = str(Path(__file__).parent / 'stand_in_mpc_node.py')
ACTIVE = 3   # label of the state of the lifecycle
LONG = 60.0  # [s] reached only by a failing test


class Loop:
    """A plant, the node with a linear plan, and what is heard of them."""

    def __init__(self, spawn, probe, x0=NEAR, **parameters):
        self.probe = probe
        self.states, self.commands = probe.listen(State, 'state'), probe.listen(Command, 'command')
        self.plans = probe.listen(Trajectory, 'mpc_node/plan')
        self.reports = probe.listen(DiagnosticArray, '/diagnostics')
        self.plant = spawn('plant_simulator', {
            'system': 'aircraft', 'x0': x0, 'publish_rate': 50.0})
        self.node = spawn('python', {
            **DEMO, 'system': 'aircraft', 'x_bounds': BOUNDS, **parameters}, arguments=[STAND_IN])

    def figure(self, name):
        """Return a value of the last status of the plans; empty before the first."""
        for report in reversed(self.reports):
            for status in report.status:
                if status.name == 'mpc_node: plan':
                    return next((each.value for each in status.values if each.key == name), '')
        return ''

    def is_active(self):
        """Return whether the node is active."""
        return self.probe.call(GetState, 'mpc_node/get_state').current_state.id == ACTIVE

    def wait_until_planned(self):
        """Wait for plans."""
        del self.plans[:]
        self.probe.wait_for(lambda: len(self.plans) > 3, LONG, 'plans')

    def solver(self):
        """Return the process id of the solver."""
        children = Path(f'/proc/{self.node.pid}/task')
        found = [int(pid) for task in children.iterdir()
                 for pid in (task / 'children').read_text().split()]
        assert len(found) == 1, found
        return found[0]
