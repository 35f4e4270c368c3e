# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""ROS 2 nodes, which convert messages to values, call the core, and convert the results back."""

import os
import re
import signal
import sys

from obc_ros.ros.installation import explain_missing_ros

# This must precede the import of numpy. One thread is faster for the small matrices of a node.
for _name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ.setdefault(_name, '1')

_started = re.split(r'[./\\]', sys.argv[0] if sys.argv[0] != '-m' else sys.orig_argv[
    sys.orig_argv.index('-m') + 1])[-1]
if _started in ('estimator_node', 'lqr_node', 'mpc_node', 'plant_simulator',
                'trajectory_server'):
    # A node ends without a traceback on a signal while it still loads its modules; later
    # `executor.run` handles signals.
    for _number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(_number, lambda *_: os._exit(0))
    if _missing := explain_missing_ros():
        sys.exit(f'{_started} {_missing}')
