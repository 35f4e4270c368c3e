# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The Fast DDS profile of nodes and commands: a restarted node is back in its loop within 1 s.

A participant announces itself before it listens (``RTPSParticipantImpl::enable``). Fast replies
are dropped, and it discovers their senders only with their next announcement, up to 3 s later.
With the profile in the folder of this module announcements are 1 s apart. A writer that uses
shared memory continues to write to the memory of a killed process until a watchdog has looked
twice, for 1 to 3 s. With the profile a node receives by UDP, which is as fast for messages of
this size.
"""

from collections.abc import Mapping
from importlib import metadata
import os
from pathlib import Path

PROFILE = Path(__file__).with_name('fastdds.xml')
FILES = ('DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml')  # in a working folder
VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')  # of 2.x, of 3.x
WISHES = (*VARIABLES, 'FASTDDS_BUILTIN_TRANSPORTS')
KILTED = 9  # major version of rclpy in Kilted, whose Fast DDS 3 warns of the old variable


def find_profile(environment: Mapping[str, str], folder: Path) -> dict[str, str]:
    """Return the variable that names the profile; none if the user has chosen another."""
    if any(name in environment for name in WISHES) or any(
            (folder / name).exists() for name in FILES):
        return {}
    try:
        version = int(metadata.version('rclpy').partition('.')[0])
    except metadata.PackageNotFoundError:   # no metadata of rclpy: the distribution is unknown
        return {}
    return {VARIABLES[version >= KILTED]: str(PROFILE)}


def choose_profile() -> None:
    """Have this process and its children use the profile; call it before a node is created."""
    os.environ.update(find_profile(os.environ, Path()))
