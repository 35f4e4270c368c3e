# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 nodes: each converts a message to values, calls the core, and converts back."""

import os

# Before numpy is imported: for the small matrices of a node one thread is faster than two.
for _name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ.setdefault(_name, '1')
