# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The documentation says what is so: its tutorial is run, its reference is read from the sources."""

from contextlib import suppress
from dataclasses import fields
import doctest
from importlib import import_module, util
import os
from pathlib import Path
import re
import shlex
import shutil
import signal
import subprocess
import sys

import pytest
import support

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / 'docs'
PAGES = sorted(DOCS.glob('*.md'))
BLOCK = re.compile(r'^```(?:\{code-block\} )?(\w+)\n(?::caption: (\S+)\n\n)?(.*?)^```$',
                   re.MULTILINE | re.DOTALL)
# Where there is no `ros2`, its two verbs that the tutorial needs.
ROS2 = f'''#!{sys.executable}
import sys
import rclpy
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
import yaml

assert sys.argv[1:3] == ['param', 'set'], sys.argv
node, name, text = sys.argv[3:]
rclpy.init()
own = rclpy.create_node('cli')
client = AsyncParameterClient(own, node)
assert client.wait_for_services(timeout_sec=20.0), 'Node not found'
future = client.set_parameters([Parameter(name, value=yaml.safe_load(text))])
rclpy.spin_until_future_complete(own, future, timeout_sec=20.0)
answer = future.result().results[0]
print('Set parameter successful' if answer.successful else
      f'Setting parameter failed: {{answer.reason}}')
'''


def blocks(page: str) -> list[tuple[str, str, str]]:
    """Return language, caption and text of the code blocks of a page."""
    return BLOCK.findall((DOCS / page).read_text(encoding='utf-8'))


def steps(text: str) -> list[tuple[str, str]]:
    """Return the commands of a console block, each with what it prints."""
    found = re.findall(r'^\$ (.*)\n((?:(?!\$ ).*\n)*)', text, re.MULTILINE)
    assert ''.join(f'$ {command}\n{said}' for command, said in found) == text
    return found


def test_the_tutorial_runs_and_prints_what_it_says(domain, tmp_path):
    commands = []
    for language, caption, text in blocks('tutorial.md'):
        if caption:
            (tmp_path / caption).write_text(text)
        elif language == 'console':
            commands += steps(text)
    assert len(commands) > 10
    bin_ = tmp_path / 'bin'
    bin_.mkdir()
    for name in ('plant_simulator', 'lqr_node', 'obc'):
        (bin_ / name).symlink_to(support.find(name))
    (bin_ / 'python').write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} "$@"\n')
    if not shutil.which('ros2'):
        (bin_ / 'ros2').write_text(ROS2)
    for script in bin_.iterdir():
        if not script.is_symlink():
            script.chmod(0o755)
    said = run(tmp_path, domain, [command for command, _ in commands])
    checker, options = doctest.OutputChecker(), doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    for (command, wanted), got in zip(commands, said, strict=True):
        assert checker.check_output(wanted, got, options), f'$ {command}\n{got}\nnot\n{wanted}'
    assert (tmp_path / 'figures' / 'crane.png').stat().st_size > 10_000
    assert 'then its end is held' in (tmp_path / 'log').read_text()


def run(folder: Path, domain: int, commands: list[str]) -> list[str]:
    """Run commands in one shell, as a user types them; return what each of them prints."""
    mark = '--- next ---'
    # What stays in the background writes to a file, as it would to another terminal.
    lines = [re.sub(r' &$', ' >> log 2>&1 &', command) for command in commands]
    lines = [f'{line} 2>&1' if line.startswith('ros2') else line for line in lines]
    script = ''.join(f'{line}\necho {shlex.quote(mark)}\n' for line in lines) + 'wait\n'
    environment = support.environment(domain)
    path = os.pathsep.join([str(folder / 'bin'), environment.get('PATH', '')])
    with (folder / 'errors').open('w') as errors:
        shell = subprocess.Popen(
            ['bash', '-c', script], cwd=folder, env={**environment, 'PATH': path}, text=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors,
            start_new_session=True)
    try:
        output, _ = shell.communicate(timeout=100)
    finally:
        with suppress(ProcessLookupError):  # nothing of the group is left
            os.killpg(shell.pid, signal.SIGKILL)
        shell.wait()
    said = output.split(f'{mark}\n')
    assert len(said) == len(commands) + 1, f'{output}\n{(folder / "errors").read_text()}'
    return said[:-1]
