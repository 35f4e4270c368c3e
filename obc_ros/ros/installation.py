# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Whether this installation has ROS 2, and if not, how to get it.

A pure wheel has the modules of nodes and commands, but neither the messages nor rclpy.
"""

from importlib import util
import sysconfig

from obc_ros.core.text.errors import ObcError

ROS_PLATFORM = 'linux-x86_64'


def explain_missing_ros() -> str:
    """
    Return why nothing here can use ROS 2, and how to change that.

    :return: the end of a sentence that begins with a command; empty if ROS 2 and the messages of
        this package are there.
    """
    if util.find_spec('obc_ros.msg') is None:
        return _explain_pure_wheel(sysconfig.get_platform())
    if util.find_spec('rclpy') is None:
        return ('needs ROS 2, and this interpreter finds no rclpy: source the setup file of the '
                'workspace, or run `pip install .` in the sources of obc_ros')
    return ''


def require_ros(what: str) -> None:
    """Raise ObcError with the reason and the remedy if there is no ROS 2, which `what` needs."""
    if missing := explain_missing_ros():
        raise ObcError(f'{what} {missing}')


def _explain_pure_wheel(platform: str) -> str:
    if platform == ROS_PLATFORM:
        return ('needs ROS 2, and obc_ros is installed without it (OBC_ROS_PURE=1, or a pure '
                'wheel): `pip install .` in its sources, without OBC_ROS_PURE, installs both')
    return ('needs ROS 2, and obc_ros is installed without it: ROS 2 comes as Python wheels for '
            f'Linux on x86-64 only, and this is {platform}. Where ROS 2 itself is installed, '
            'colcon builds obc_ros with it: see docs/install.md')
