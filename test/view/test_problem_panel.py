# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the panel of problems shows first, and what it does when the process ends."""

import asyncio
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip('nicegui', reason='NiceGUI is not installed')
from obc_ros.msg import Trajectory
from obc_ros.srv import PlanMotion
from obc_ros.view.panels import plan_panel, problem_panel
from obc_ros.view.panels.plan_panel import PlanPanel
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


def test_the_answer_is_shown_before_its_curves_are_computed(monkeypatch):
    """They take a second for a long path; the panel says until then that it is busy."""
    seen: list[tuple[str, bool]] = []

    async def compute(_: Any, *given: Any) -> Any:
        if given == ('a problem',):
            return SimpleNamespace(name='built'), None
        seen.append((panel._message.text, panel._request is not None))
        return {}

    async def answer(_: Any) -> Any:
        panel._request.phase = 'refining'
        return SimpleNamespace(status='solved', message='well', solve_time=1.0)

    async def show(*given: Any) -> None:
        panel.refresh()
        await compute(*given)

    monkeypatch.setattr(problem_panel, 'Request', lambda *_: SimpleNamespace(phase=''))
    monkeypatch.setattr(problem_panel.run, 'io_bound', compute)
    button = SimpleNamespace(set_enabled=lambda _: None)
    panel = SimpleNamespace(
        _request=None, _may_control=lambda: True, _result=SimpleNamespace(clear=lambda: None),
        _text=SimpleNamespace(value='a problem'), _client=SimpleNamespace(solve=answer),
        _message=SimpleNamespace(text=''), _solve=button, _cancel=button, _show=show,
        _spinner=SimpleNamespace())
    panel.refresh = lambda: ProblemPanel.refresh(panel)
    asyncio.run(ProblemPanel.solve(panel))
    assert seen == [('solved: well', True)] and panel._request is None


def test_a_plan_is_told_and_drawn_in_the_picture_before_its_curves(monkeypatch):
    seen: list[tuple[str, Any]] = []

    async def compute(*_: Any) -> dict[str, Any]:
        seen.append((panel._message.text, drawn[-1]))
        return {}

    drawn: list[Any] = []
    monkeypatch.setattr(plan_panel.run, 'io_bound', compute)
    monkeypatch.setattr(plan_panel, 'draw_path_lines', lambda *_: None)
    part = type('Part', (nullcontext,), {'clear': lambda _: None})
    panel = SimpleNamespace(
        _plant=SimpleNamespace(plane='vertical', units={}, states=()), _charts=part(),
        _table=part(), _message=SimpleNamespace(text=''),
        _canvas=SimpleNamespace(show_plan=drawn.append))
    panel._clear = lambda: PlanPanel._clear(panel)
    panel._draw_way = lambda path: PlanPanel._draw_way(panel, path)
    path = Trajectory(t=[0.0, 1.0], x=[0.0, 0.0, 3.0, 4.0], state_names=['px', 'py'])
    asyncio.run(PlanPanel._show(panel, PlanMotion.Response(
        status='solved', message='well', trajectory=path), None))
    assert seen == [('solved: well', [[0.0, 0.0], [3.0, 4.0]])]
