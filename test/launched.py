# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The nodes that a launch file of this package starts, by `launch` if installed or `obc launch`.

The launch file runs with executables in place of the nodes, which record their arguments.
"""

import importlib.util
import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile
from typing import Any

from obc_ros.cli.ros2.launch_file import LaunchFile, Started
from obc_ros.core.text.errors import ObcError

ROOT = Path(__file__).resolve().parents[1]
EXECUTABLES = ('plant_simulator', 'lqr_node', 'mpc_node', 'trajectory_server')
VARIABLE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
# The launch ends once every node has been started a second time, if nodes are respawned.
LAUNCH = """
import os, pathlib, sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription, RegisterEventHandler, Shutdown
from launch.event_handlers import OnProcessExit
from launch.launch_description_sources import PythonLaunchDescriptionSource
file, *arguments = sys.argv[1:]
records = pathlib.Path(os.environ['OBC_WITNESSES'])
def on_exit(event, context):
    names = {each.name for each in records.iterdir()}
    again = {each for each in names if each.endswith('.again')}
    return [Shutdown()] if 2 * len(again) == len(names) else []
service = LaunchService(noninteractive=True)
service.include_launch_description(LaunchDescription([
    RegisterEventHandler(OnProcessExit(on_exit=on_exit)),
    IncludeLaunchDescription(
        PythonLaunchDescriptionSource(file),
        launch_arguments=[tuple(each.split(':=', 1)) for each in arguments])]))
sys.exit(service.run())
"""
# In place of a node: records its arguments, and whether it is started again.
WITNESS = f"""#!{sys.executable}
import json, os, pathlib, sys
import yaml
given = dict(each.split(':=', 1) for each in sys.argv if each.startswith('__'))
files = [after for each, after in zip(sys.argv, sys.argv[1:]) if each == '--params-file']
record = dict(executable=pathlib.Path(sys.argv[0]).name, name=given['__node'],
              namespace=given.get('__ns', '').strip('/'), range=os.environ['{VARIABLE}'],
              files=[(each, yaml.safe_load(pathlib.Path(each).read_text())) for each in files])
name = record['namespace'].replace('/', '+') + '+' + record['executable']
path = pathlib.Path(os.environ['OBC_WITNESSES'], name)
if path.exists():
    path.with_name(name + '.again').touch()
else:
    path.write_text(json.dumps(record))
"""


class RefusedError(Exception):
    """The arguments were rejected, and no node was started."""


def nodes(file: str, **arguments: str) -> list[Started]:
    """
    Return the nodes that a launch file of this package starts with some arguments.

    Raises
    ------
    RefusedError
        With the sentence that is shown.

    """
    if importlib.util.find_spec('launch_ros'):
        found = _launched(file, arguments)
    else:
        try:
            found = LaunchFile(ROOT / 'launch' / file).nodes(arguments)
        except ObcError as error:
            raise RefusedError(str(error)) from error
    return sorted(found, key=lambda each: (
        len(each.namespace), each.namespace, EXECUTABLES.index(each.executable)))


def _launched(file: str, arguments: dict[str, str]) -> list[Started]:
    with tempfile.TemporaryDirectory() as folder:
        prefix, records = Path(folder, 'prefix'), Path(folder, 'records')
        for executable in EXECUTABLES:
            path = prefix / 'lib' / 'obc_ros' / executable
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(WITNESS, encoding='utf-8')
            path.chmod(0o755)
        index = prefix / 'share' / 'ament_index' / 'resource_index' / 'packages'
        index.mkdir(parents=True)
        (index / 'obc_ros').touch()
        records.mkdir()
        paths = [str(prefix), *filter(None, [os.environ.get('AMENT_PREFIX_PATH')])]
        done = subprocess.run(
            [sys.executable, '-c', LAUNCH, str(ROOT / 'launch' / file),
             *(f'{name}:={value}' for name, value in arguments.items())],
            env={**os.environ, 'AMENT_PREFIX_PATH': os.pathsep.join(paths),
                 'OBC_WITNESSES': str(records), 'ROS_LOG_DIR': folder},
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=60, check=False)
        written = {each.name: each for each in records.iterdir()}
        if done.returncode:
            assert not written, f'started {sorted(written)} and then said {done.stdout}'
            raise RefusedError(done.stdout)
        return [_started(json.loads(each.read_text(encoding='utf-8')), f'{name}.again' in written)
                for name, each in written.items() if each.suffix != '.again']


def _started(record: dict[str, Any], respawn: bool) -> Started:
    files = [(Path(path), content) for path, content in record['files']]
    values: dict[str, Any] = {}
    for path, content in files:
        if path.name.startswith('launch_params_'):
            values.update(next(iter(content.values()))['ros__parameters'])
    return Started(
        'obc_ros', record['executable'], record['name'], record['namespace'],
        tuple(path for path, _ in files if not path.name.startswith('launch_params_')), values,
        {VARIABLE: record['range']}, respawn)
