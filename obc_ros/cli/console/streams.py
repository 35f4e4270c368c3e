# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The standard streams of a command, and the width of its terminal."""

import io
import os
import shutil
import sys


def open_streams() -> None:
    """
    Make the standard streams accept any text.

    Closed streams are connected to the null device: otherwise the next opened file gets their
    number, and their text. Characters that an encoding lacks are written as escape sequences.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(number)
    sys.stdout = sys.stdout or os.fdopen(1, 'w')
    sys.stderr = sys.stderr or os.fdopen(2, 'w')
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors='backslashreplace')


def get_width() -> int | None:
    """Return the characters of a line of the terminal; None if the output is not a terminal."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None
