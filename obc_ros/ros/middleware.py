# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The Fast DDS profile of nodes and commands: a restarted node is back in its loop within 1 s.

docs/development/decisions.md has the reasons. With the profile in the folder of this module
announcements are 1 s apart, and a node receives by UDP, which is as fast for messages of this
size.

With ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST the middleware still opens its ports on all
interfaces. Another profile then opens them on the loopback interface only, and the range is left
to it: otherwise the middleware adds a transport of its own.
"""

from collections.abc import Mapping
from importlib import metadata
import os
from pathlib import Path

PROFILE = Path(__file__).with_name('fastdds.xml')
LOOPBACK = Path(__file__).with_name('fastdds_localhost.xml')
RANGE, PEERS = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS'
FILES = ('DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml')  # in a working folder
VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')  # of 2.x, of 3.x
WISHES = (*VARIABLES, 'FASTDDS_BUILTIN_TRANSPORTS')
KILTED = 9  # major version of rclpy in Kilted, whose Fast DDS 3 warns of the old variable


def find_profile(environment: Mapping[str, str], folder: Path) -> dict[str, str]:
    """Return the variables that choose a profile; none if the user has chosen another."""
    ours = str(PROFILE), str(LOOPBACK)   # chosen by the command that has started this process
    if any(environment.get(name, ours[0]) not in ours for name in WISHES) or any(
            (folder / name).exists() for name in FILES):
        return {}
    try:
        version = int(metadata.version('rclpy').partition('.')[0])
    except metadata.PackageNotFoundError:   # no metadata of rclpy: the distribution is unknown
        return {}
    variable = VARIABLES[version >= KILTED]
    is_here = environment.get(RANGE) == 'LOCALHOST' and not environment.get(PEERS)
    is_left = (environment.get(RANGE), environment.get(variable)) == (
        'SYSTEM_DEFAULT', str(LOOPBACK))   # by that command
    if is_here or is_left:
        return {variable: str(LOOPBACK), RANGE: 'SYSTEM_DEFAULT'}
    return {variable: str(PROFILE)}


def choose_profile() -> None:
    """Have this process and its children use the profile; call it before a node is created."""
    os.environ.update(find_profile(os.environ, Path()))
