# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fixtures `obc` and `both`: the commands on files, in process or in both ways."""

from collections.abc import Iterator
from pathlib import Path

import asking
import pytest


@pytest.fixture
def obc(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[asking.Command]:
    """Return a function that runs `obc` on files, in its own processes."""
    command = asking.Command(tmp_path, request, 'in process')
    yield command
    command.end()


@pytest.fixture(params=asking.WAYS)
def both(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[asking.Command]:
    """Return a function that runs `obc` on files, in process and by a server."""
    command = asking.Command(tmp_path, request, request.param)
    yield command
    command.end()
