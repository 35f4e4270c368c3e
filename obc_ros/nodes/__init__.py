# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 nodes: each converts a message to values, calls the core, and converts back."""

import os
import signal
import sys

# Before numpy is imported: for the small matrices of a node one thread is faster than two.
for _name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ.setdefault(_name, '1')

# A process that is a node heeds signals while it still loads its modules, and without a traceback;
# `executor.run` takes over from here.
_started = sys.argv[0] if sys.argv[0] != '-m' else sys.orig_argv[sys.orig_argv.index('-m') + 1]
if _started.replace('.', '/').rpartition('/')[2] in (
        'lqr_node', 'plant_simulator', 'trajectory_server'):
    for _number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(_number, lambda *_: os._exit(0))
