# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The Fast DDS profile of the nodes; a profile of the user takes precedence."""

from pathlib import Path
import re
from typing import Any

from obc_ros.ros.middleware import FILES, find_profile, PROFILE, WISHES
import pytest


def test_the_profile_is_used_without_a_profile_of_the_user(tmp_path: Path) -> None:
    """The installed Fast DDS gets one environment variable, the path of an existing file."""
    (name, value), = find_profile({'HOME': '/'}, tmp_path).items()
    assert name in WISHES
    assert Path(value) == PROFILE
    assert PROFILE.is_file()


@pytest.mark.parametrize('wish', WISHES)
def test_a_profile_variable_of_the_user_comes_first(tmp_path: Path, wish: str) -> None:
    """An empty variable counts too: it selects the defaults of Fast DDS."""
    assert find_profile({wish: ''}, tmp_path) == {}


@pytest.mark.parametrize('file', FILES)
def test_a_profile_file_of_the_user_comes_first(tmp_path: Path, file: str) -> None:
    """Fast DDS reads the file from the working folder."""
    (tmp_path / file).touch()
    assert find_profile({}, tmp_path) == {}


def test_nodes_open_no_shared_memory_port(spawn: Any, domain: int) -> None:
    """A killed node would leave the shared-memory port of its domain behind."""
    spawn('lqr_node').wait_for_output('revision 1')
    first = 7400 + 250 * domain  # RTPS specification, 9.6.1.1
    ports = {int(found[1]) for file in Path('/dev/shm').glob('*fast*_port*')
             if (found := re.search(r'port(\d+)', file.name))}
    assert not ports & set(range(first, first + 250))
