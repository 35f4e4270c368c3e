# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The node mpc_node with the steps of `stand_in_steps`."""

import os
from pathlib import Path
import sys

from obc_ros.nodes.mpc_node import MpcNode
from obc_ros.ros.execution.executor import run


class StandInNode(MpcNode):
    """The node with a linear plan."""

    STEPS = 'stand_in_steps'


if __name__ == '__main__':
    os.environ['PYTHONPATH'] = str(Path(__file__).parent)   # for the process of the steps
    sys.exit(run(StandInNode))
