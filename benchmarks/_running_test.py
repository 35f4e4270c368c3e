# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The test that runs now, for plugins of pytest."""

import os


def find_running_test() -> str:
    """Return the node id of the test whose body runs; empty: none, or its fixtures run."""
    test, _, phase = os.environ.get('PYTEST_CURRENT_TEST', '').rpartition(' ')
    return test if phase == '(call)' else ''
