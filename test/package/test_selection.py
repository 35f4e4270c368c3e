# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Without ROS 2 all tests run that need none: `make pure` leaves out no others."""

import os
from pathlib import Path
import subprocess
import sys

import pytest
from selection import FOLDERS, imports_ros, needs_ros

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted((ROOT / 'test').rglob('test_*.py'))
# What may import ROS 2 outside of `FOLDERS`; all others run without it.
LEFT_OUT = {
    'book/test_gallery.py', 'cli/test_demo.py', 'cli/test_demo_figure.py',
    'cli/test_determinism.py', 'cli/test_recording.py', 'cli/test_regulator_figures.py',
    'cli/test_server_option.py', 'docs/test_gallery_pages.py', 'view/test_loop_nodes.py',
    'view/test_page.py', 'view/test_plant_panel.py', 'view/test_problem_panel.py',
    'view/test_set_point_panel.py', 'view/test_view.py', 'view/test_weights_panel.py'}
# Each module of ROS 2 is hidden before pytest loads conftest.py.
HIDDEN = ('import sys, pytest, selection\n'
          'names = {*selection.ROS, "obc_ros.msg", "obc_ros.srv", "obc_ros.action", "mcap"}\n'
          'sys.modules.update(dict.fromkeys(names))\n'
          'sys.exit(pytest.main(sys.argv[1:]))')


@pytest.mark.slow
def test_no_other_files_are_left_out():
    outside = {str(path.relative_to(ROOT / 'test')) for path in FILES if needs_ros(path)
               and not any(path.is_relative_to(folder) for folder in FOLDERS)}
    assert outside <= LEFT_OUT, 'move what imports ROS 2 to a folder for it, or add it here'


def test_an_import_is_found_through_other_files():
    assert imports_ros(ROOT / 'test' / 'lqr_bench.py')
    assert imports_ros(ROOT / 'obc_ros' / 'nodes' / 'control' / 'command_sinks.py')
    assert not imports_ros(ROOT / 'test' / 'conftest.py')   # it imports the probe in a function
    assert not imports_ros(ROOT / 'obc_ros' / 'workers' / 'pool.py')


def collect(*start: str) -> set[str]:
    """Return the tests that a new interpreter collects, of those without `nodes` and `ros`."""
    done = subprocess.run(
        [sys.executable, *start, '--collect-only', '-q', '-m', 'not nodes and not ros'], cwd=ROOT,
        capture_output=True, text=True, check=False,
        env={**os.environ, 'PYTHONPATH': str(ROOT / 'test'), 'PYTEST_ADDOPTS': ''})
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr
    return {line for line in done.stdout.splitlines() if line.startswith('test/')}


@pytest.mark.slow
@pytest.mark.ros
def test_without_ros_the_same_tests_are_collected_of_all_other_files():
    left_out = tuple(f'{path.relative_to(ROOT)}::' for path in FILES if needs_ros(path))
    every, pure = collect('-m', 'pytest'), collect('-c', HIDDEN)
    assert pure == {each for each in every if not each.startswith(left_out)}
    assert len(pure) > 2000
