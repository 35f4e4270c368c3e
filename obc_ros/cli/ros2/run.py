# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc run`: run an executable of a package in place of this command."""

import argparse
import os
from pathlib import Path
import sys

from obc_ros.cli.ros_graph import keep_to_this_machine
from obc_ros.cli.terminal import Parser
from obc_ros.core.text.errors import ObcError, quote


def add_arguments(parser: Parser) -> None:
    """Declare the arguments."""
    parser.add_argument('package_name', help='obc_ros')
    parser.add_argument('executable_name', help='lqr_node, mpc_node, plant_simulator, '
                        'estimator_node, trajectory_server')
    parser.add_argument('argv', nargs=argparse.REMAINDER,
                        help='its arguments: --ros-args -p system:=vehicle')


def run(args: argparse.Namespace) -> int:
    """Replace this process by the executable."""
    keep_to_this_machine()
    path = find_executable(args.package_name, args.executable_name)
    sys.stdout.flush()
    os.execv(path, [str(path), *args.argv])


def find_executable(package: str, name: str) -> Path:
    """Return an executable of a package, in a sourced workspace or this environment."""
    prefixes = [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]
    folders = [Path(prefix) / 'lib' / package for prefix in filter(None, prefixes)]
    there = {path.name: path for folder in reversed(folders) if folder.is_dir()
             for path in folder.iterdir() if path.is_file() and os.access(path, os.X_OK)}
    if name not in there:
        raise ObcError(f"No executable found: '{quote(package)}' has no '{quote(name)}'; "
                       f'it has {", ".join(sorted(there)) or "none"}')
    return there[name]
