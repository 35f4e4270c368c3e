# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What Fast DDS is asked for, so that a node that starts anew is soon back in its loop.

A participant announces itself before it listens (``RTPSParticipantImpl::enable``): the answers of
those that are quick are dropped, and it hears of them only with their next announcement, up to 3 s
later. With the profile beside this module that is 1 s. And who writes to a process by shared
memory goes on writing into what a killed one has left, until a watchdog has looked twice: 1 to
3 s. With the profile a node takes its messages by UDP, which for their size is as quick.
"""

from collections.abc import Mapping
from importlib import metadata
import os
from pathlib import Path

PROFILE = Path(__file__).with_name('fastdds.xml')
FILES = ('DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml')  # read where one stands
VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')  # of 2.x, of 3.x
WISHES = (*VARIABLES, 'FASTDDS_BUILTIN_TRANSPORTS')
KILTED = 9  # the version of its rclpy; it has Fast DDS 3 and complains of the old variable


def find_profile(environment: Mapping[str, str], folder: Path) -> dict[str, str]:
    """Return the variable that names the profile; nothing where the user has a wish."""
    if any(name in environment for name in WISHES) or any(
            (folder / name).exists() for name in FILES):
        return {}
    try:
        version = int(metadata.version('rclpy').partition('.')[0])
    except metadata.PackageNotFoundError:   # a distribution that says nothing of its packages
        return {}
    return {VARIABLES[version >= KILTED]: str(PROFILE)}


def choose_profile() -> None:
    """Have this process and its children use the profile; before a node is created."""
    os.environ.update(find_profile(os.environ, Path()))
