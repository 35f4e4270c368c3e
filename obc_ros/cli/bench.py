# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
`obc bench`: run the benchmarks, each in a process of its own.

A benchmark is a script that prints a table; its exit status is 0 if all its requirements hold.
Without ROS 2 those that need it are left out.
"""

import argparse
import os
from pathlib import Path
import subprocess
import sys

from obc_ros.cli.share_folders import share_directory
from obc_ros.cli.terminal import Parser
from obc_ros.core.text.errors import ObcError, quote, suggest_name
from obc_ros.ros.installation import explain_missing_ros, require_ros

HELPERS = ('baseline', 'timing')  # no benchmarks: a comparison of two versions, and shared code
# These need ROS 2.
NODES = ('fuzz', 'hosts', 'latency', 'mpc_loop', 'real_time', 'scale', 'server', 'soak', 'stop',
         'view')


def add_arguments(parser: Parser) -> None:
    """Declare the arguments of `obc bench`."""
    parser.add_argument('names', nargs='*', metavar='NAME', help='benchmarks (default: all)')
    parser.add_argument('--peers', action='store_true',
                        help='also measure other tools; those not installed are listed')
    parser.add_argument('--list', action='store_true', help='list the benchmarks')
    parser.limit('NAME', '--peers', without=['--list'])


def run(args: argparse.Namespace) -> int:
    """Run benchmarks; return 0 if all requirements hold, 1 if not, 2 for an unknown name."""
    try:
        scripts = find_benchmarks()
    except ObcError as error:
        print(f'obc bench: {error}', file=sys.stderr)
        return 2
    unknown = [name for name in args.names if name not in scripts]
    if unknown:
        print(f"obc bench: no benchmark '{quote(unknown[0])}'"
              f"{suggest_name(unknown[0], scripts)}; there are {', '.join(scripts)}",
              file=sys.stderr)
        return 2
    for name in args.names:
        if name in NODES:
            require_ros(name)
    if explain_missing_ros():
        scripts = {name: script for name, script in scripts.items() if name not in NODES}
    if args.list:
        print('\n'.join(scripts))
        return 0
    failed = [name for name in args.names or scripts
              if not run_benchmark(scripts[name], args.peers)]
    if failed:
        print(f'obc bench: requirements not met: {", ".join(failed)}', file=sys.stderr)
    return 1 if failed else 0


def find_benchmarks() -> dict[str, Path]:
    """Return the scripts of the benchmarks by name; ObcError if none are installed."""
    folder = share_directory('obc_ros') / 'benchmarks'
    scripts = {path.stem: path for path in sorted(folder.glob('*.py'))
               if path.stem not in HELPERS and not path.stem.startswith('_')}
    if not scripts:
        raise ObcError(f'no benchmarks in {folder}')
    return scripts


def run_benchmark(script: Path, peers: bool) -> bool:
    """Run one benchmark; return whether its requirements hold."""
    print(f'== {script.stem} ==', flush=True)
    options = ['--peers'] if peers else []
    child = subprocess.Popen([sys.executable, str(script), *options], env={
        **os.environ, 'PYTHONUNBUFFERED': '1'})
    try:
        status = child.wait()
    finally:
        if child.poll() is None:  # interrupted: the child may not have got the signal
            child.terminate()
            child.wait()
    print(flush=True)
    return status == 0
