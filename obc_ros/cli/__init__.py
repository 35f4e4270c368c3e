# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command line `obc`, a client of the nodes."""

import os
import signal
import sys


def leave(*_: object) -> None:
    """Exit with status 130: SIGINT arrived while `obc` was loading its modules."""
    os._exit(130)


if os.path.basename(sys.argv[0]) == 'obc' and (
        signal.getsignal(signal.SIGINT) is signal.default_int_handler):
    signal.signal(signal.SIGINT, leave)  # without a traceback; `obc.main` takes over from here
