# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The folder in which one stands: files there that have names of modules are not run."""

import os
from pathlib import Path
import subprocess
import sys

from obc_ros.cli.processes import Children
import pytest
import support

ROOT = Path(__file__).resolve().parents[2]
NAMES = ('signal', 'random', 'queue', 'yaml', 'numpy', 'casadi', 'rclpy', 'obc_ros')


@pytest.fixture
def trap(tmp_path, monkeypatch):
    """Stand in a folder whose modules leave a trace; return the trace."""
    folder, trace = tmp_path / 'folder', tmp_path / 'trace'
    folder.mkdir()
    for name in NAMES:
        (folder / f'{name}.py').write_text(
            f'open({str(trace)!r}, "a").write("{name} ")\nraise SystemExit("{name} was run")\n')
    monkeypatch.chdir(folder)
    return trace


def test_a_solver_process_runs_nothing_of_the_folder(trap):
    command = [support.find('obc'), 'solve', 'di_mintime_rest']
    completed = subprocess.run(command, capture_output=True, text=True, check=False)
    assert completed.returncode == 0, completed.stderr
    assert not trap.exists()


@pytest.mark.slow
@pytest.mark.nodes
@pytest.mark.parametrize('node', ['lqr_node', 'mpc_node', 'trajectory_server'])
def test_a_node_and_its_processes_run_nothing_of_the_folder(trap, tmp_path, domain, monkeypatch,
                                                            node):
    for name, value in support.environment(domain).items():
        monkeypatch.setenv(name, value)
    with Children(tmp_path / 'log') as children:
        children.start(node)
        words = {'lqr_node': 'revision 1', 'mpc_node': 'compiled', 'trajectory_server': 'process'}
        support.wait_for(lambda: words[node] in children.log(node).read_text(), support.DEADLINE)
    assert not trap.exists()


@pytest.mark.slow
def test_an_environment_that_was_interrupted_is_made_anew(tmp_path):
    """As by Ctrl-C while it is made: it has a Python, and no pip."""
    folder = tmp_path / 'env'
    subprocess.run([sys.executable, '-m', 'venv', '--without-pip', folder], check=True)
    environment = {name: value for name, value in os.environ.items() if name != 'MAKEFLAGS'}
    subprocess.run(['make', '-s', f'VENV={folder}', f'PYTHON={sys.executable}',
                    f'{folder}/.environment'], cwd=ROOT, env=environment, check=True)
    subprocess.run([folder / 'bin' / 'python', '-m', 'pip', '--version'], check=True)
