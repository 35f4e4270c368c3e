# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the panel of problems does when the process ends, without a browser."""

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip('nicegui', reason='NiceGUI is not installed')
from obc_ros.view.panels import problem_panel
from obc_ros.view.panels.problem_panel import ProblemPanel


def test_a_problem_that_is_asked_for_while_the_process_ends_is_left(monkeypatch):
    async def answer_nothing(*_: Any) -> None:
        """Return None, as NiceGUI does when it stops."""

    monkeypatch.setattr(problem_panel.run, 'io_bound', answer_nothing)
    panel = SimpleNamespace(_request=None, _may_control=lambda: True,
                            _result=SimpleNamespace(clear=lambda: None),
                            _text=SimpleNamespace(value=''), _client=None)
    asyncio.run(ProblemPanel.solve(panel))
    assert panel._request is None
