# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `obc`: a ROS client like any other."""

import os
import signal
import sys


def leave(*_: object) -> None:
    """End at once: the command `obc` was interrupted while it still loads its modules."""
    os._exit(130)


if os.path.basename(sys.argv[0]) == 'obc' and (
        signal.getsignal(signal.SIGINT) is signal.default_int_handler):
    signal.signal(signal.SIGINT, leave)  # without a traceback; `obc.main` takes over from here
