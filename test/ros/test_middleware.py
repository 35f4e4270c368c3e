# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What is asked of Fast DDS, and that the user's wishes come first."""

from pathlib import Path
import re
from typing import Any

from obc_ros.ros.middleware import FILES, find_profile, PROFILE, WISHES
import pytest


def test_the_profile_is_for_who_has_no_wish(tmp_path: Path) -> None:
    """One variable, that of the Fast DDS that is installed; it names a file that is there."""
    (name, value), = find_profile({'HOME': '/'}, tmp_path).items()
    assert name in WISHES
    assert Path(value) == PROFILE
    assert PROFILE.is_file()


@pytest.mark.parametrize('wish', WISHES)
def test_a_variable_comes_first(tmp_path: Path, wish: str) -> None:
    """Empty ones too: that is how to have Fast DDS as it is."""
    assert find_profile({wish: ''}, tmp_path) == {}


@pytest.mark.parametrize('file', FILES)
def test_a_file_comes_first(tmp_path: Path, file: str) -> None:
    """Fast DDS reads it where it is started."""
    (tmp_path / file).touch()
    assert find_profile({}, tmp_path) == {}


def test_messages_do_not_go_by_shared_memory(spawn: Any, domain: int) -> None:
    """There is no port of it in the range of the domain, where a killed node would leave one."""
    spawn('lqr_node').wait_for_output('revision 1')
    first = 7400 + 250 * domain  # of the RTPS specification, 9.6.1.1
    ports = {int(found[1]) for file in Path('/dev/shm').glob('*fast*_port*')
             if (found := re.search(r'port(\d+)', file.name))}
    assert not ports & set(range(first, first + 250))
