# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Steps of a linear plan without limits, for the tests of the process and of mpc_node.

The plan is that of the sampled regulator. The terminal set is x'P x <= 1. A first plan is refused
outside the bounds of the states.
"""

import gc
import os
import time

import numpy as np
from obc_ros.core.lqr.held_loop import discretize_plant
from obc_ros.core.lqr.sampled import sampled_lqr
from obc_ros.core.lqr.weights import Weights
from obc_ros.core.systems.equilibrium import linearize
from obc_ros.core.systems.registry import get_system
from obc_ros.core.text.errors import StatementError
from obc_ros.workers.wire import Packet


def prepare(problem):
    """Return the steps of a problem, or refuse it."""
    if problem.plain['system'] == 'refused':
        raise StatementError('this problem is refused')
    return LinearSteps(problem)


class LinearSteps:
    """The steps of one problem."""

    def __init__(self, problem):
        self.problem = problem
        a, plain = problem.arrays, problem.plain
        self.xe, self.ue = a['xe'], a['ue']
        A, B = linearize(get_system(plain['system']), self.xe, self.ue)
        self.A, self.B = discretize_plant(A, B, plain['period'])
        found = sampled_lqr(A, B, Weights(a['Qx'], a['Qu'], np.zeros(B.shape)),
                            plain['period'])
        self.K, self.P = found.K, found.P

    @property
    def ready(self):
        """Return the terminal set."""
        return Packet({'level': 1.0, 'sentence': "terminal set x'P x <= 1"}, {'P': self.P})

    def answer(self, request):
        """Return a plan."""
        # A deadline of seconds is used.
        deadline = self.problem.plain.get('deadline', 0.0)
        time.sleep(request.plain.get('sleep', 0.75 * deadline if deadline > 1.0 else 0.0))
        x = request.arrays['x'] - self.xe
        if request.plain['kind'] == 'first':
            bounds = self.problem.arrays
            if np.any(request.arrays['x'] > bounds['x_upper']):
                raise StatementError('no plan keeps the bounds from here')
        else:
            x = self.A @ x + self.B @ (request.arrays['u'] - self.ue)
        states, inputs = [x], []
        for _ in range(self.problem.plain['steps']):
            inputs.append(-self.K @ x)
            x = self.A @ x + self.B @ inputs[-1]
            states.append(x)
        return Packet(
            {'stamp': request.plain.get('stamp', 0), 'status': 'solved', 'iterations': 1,
             'residual': 0.0, 'cost': 0.0, 'slack': {}, 'seconds': 0.0, 'pid': os.getpid(),
             'words': 'the first plan is linear', 'frozen': gc.get_freeze_count()},
            {'x': np.array(states) + self.xe, 'u': np.array(inputs) + self.ue})
