# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the panel of the set point sends and refuses, without a browser."""

import asyncio
import math
from types import SimpleNamespace
from typing import Any

from obc_ros import systems
from obc_ros.msg import LqrDesign
import pytest

pytest.importorskip('nicegui', reason='NiceGUI is not installed')
from obc_ros.view.panels.set_point_panel import find_excess, SetPointPanel
from obc_ros.view.telemetry import describe_plant


def make_design(name: str, xe: list[float], ue: list[float]) -> LqrDesign:
    """Return a message with the set point of a system."""
    system = systems[name]
    return LqrDesign(system=name, state_names=list(system.states),
                     input_names=list(system.inputs), xe=xe, ue=ue)


@pytest.mark.parametrize(('limits', 'far'), [
    ([], False), ([2.0, 1.0], False), ([0.9, 1.0], True), ([-1.5, 0.0, -1.0, 1.0], False),
    ([-0.5, 5.0, -1.0, 1.0], True), ([1.0], False)])
def test_a_set_point_beyond_the_limits_of_the_error_is_refused(limits, far):
    """The plant is at 0, the set point at 1: the error is -1."""
    design = make_design('double_integrator', [0.0, 0.0], [0.0])
    found = find_excess(describe_plant(design), design, [0.0, 0.0], [1.0, 0.0], limits)
    assert bool(found) == far
    assert not far or found.startswith(f'{systems["double_integrator"].states[0]} would be -1 ')


def test_the_error_along_the_course_of_a_moving_set_point_is_free():
    """The vehicle is 300 m down its lane: its set point begins there, 3 m beside it."""
    design = make_design('vehicle', [0.0, -2.0, 0.0], [10.0, 0.0])
    plant = describe_plant(design)
    for width, far in ((4.0, False), (2.0, True)):
        found = find_excess(plant, design, [300.0, 1.0, 2.0 * math.pi], [0.0, -2.0, 0.0],
                            [1.0, width, 0.5])
        assert found.startswith('py would be 3 m ') == far == bool(found)


def test_a_state_of_a_plant_that_is_not_registered_may_be_an_angle():
    """A turn of 2 pi is no error of an angle; whether it is one, its node knows."""
    design = LqrDesign(system='pendulum_of_a_file', state_names=['theta', 'omega'],
                       input_names=['u'], xe=[0.0, 0.0], ue=[0.0])
    plant = describe_plant(design)
    for x, far in (([6.3, 0.0], False), ([3.0, 0.0], True), ([-0.9, 0.0], False)):
        found = find_excess(plant, design, x, [0.0, 0.0], [1.0, 1.0])
        assert bool(found) == far


def make_panel(changes: list[dict[str, Any]], **more: Any) -> SimpleNamespace:
    """Return what `_set` reads of a panel; changes that are sent go to a list."""
    async def set_parameters(node, values):
        changes.append({node: values})
        return True, ''

    async def find_refusal(_):
        return ''

    panel = SimpleNamespace(**{
        '_busy': False, '_may_control': lambda: True, '_message': SimpleNamespace(text=''),
        '_shown': [0.5, 0.0], '_before': [], '_sent': [], '_old': None,
        '_find_refusal': find_refusal, '_client': SimpleNamespace(
            controller='mpc_node', plant='cart', design='first', reference=None,
            mode=SimpleNamespace(name='CONTROLLING'), set_parameters=set_parameters)} | more)
    panel._find_asked = lambda: SetPointPanel._find_asked(panel)
    return panel


@pytest.mark.parametrize(('given', 'controls', 'sent'), [
    ([1.0, 0.0], True, True), ([math.nan, 0.0], True, False), ([None, 0.0], True, False),
    ([math.inf, 0.0], True, False), ([1.0, 0.0], False, False)])
def test_only_numbers_of_a_page_that_controls_are_sent(given, controls, sent):
    changes: list[dict[str, Any]] = []
    panel = make_panel(changes, _may_control=lambda: controls)
    asyncio.run(SetPointPanel._set(panel, given))
    assert changes == ([{'mpc_node': {'setpoint': [1.0, 0.0]}}] if sent else [])
    assert panel._before == ([0.5, 0.0] if sent else []) and not panel._busy
    assert (panel._old == 'first') == sent   # the next step waits for the design that follows


@pytest.mark.parametrize('change', [
    {'controller': 'lqr_node'}, {'plant': 'ship'}, {'design': 'that of somebody else'},
    {'mode': SimpleNamespace(name='STOPPED')}, {}])
def test_nothing_is_sent_if_the_loop_changes_meanwhile(change):
    """The limits are read first; a stop, another page or another controller may come before."""
    changes: list[dict[str, Any]] = []
    controls = [True, bool(change)]

    async def find_refusal(_):
        vars(panel._client).update(change)
        return ''

    panel = make_panel(changes, _find_refusal=find_refusal, _may_control=lambda: controls.pop(0))
    asyncio.run(SetPointPanel._set(panel, [1.0, 0.0]))
    assert not changes and panel._message.text.startswith('not sent')
    assert not panel._busy and not panel._before


def test_a_path_that_is_followed_is_not_left_by_the_same_set_point():
    changes: list[dict[str, Any]] = []
    panel = make_panel(changes)
    panel._client.reference = 'a path'
    asyncio.run(SetPointPanel._set(panel, [0.5, 0.0]))
    assert not changes and 'a path is followed' in panel._message.text
    asyncio.run(SetPointPanel._set(panel, [1.0, 0.0]))
    assert changes


def make_fields(values: list[float]) -> dict[str, Any]:
    """Return fields with values, and what `refresh` reads and sets of a panel."""
    part = SimpleNamespace(set_enabled=lambda _: None, text='', value='px')
    plant = SimpleNamespace(state_names=('px', 'py'), states=())
    return {'_fields': [SimpleNamespace(value=each) for each in values], '_shown': [0.0, 0.0],
            '_of': ('mpc_node', plant), '_seen': None, '_state': part,
            '_size': SimpleNamespace(value=0.5), **dict.fromkeys(
                ('_hold', '_step', '_back', '_use', '_changed'), part)}


@pytest.mark.parametrize('change', [
    {'design': SimpleNamespace(xe=[0.0, 0.0], revision=2)}, {'reference': 'a path'},
    {'mode': SimpleNamespace(name='STOPPED')}, {}])
def test_a_click_before_another_change_of_the_loop_is_not_sent_after_it(change):
    """New weights, a path that is flown, a stop: of this page or of another one."""
    changes: list[dict[str, Any]] = []
    panel = make_panel(changes, **make_fields([0.0, 0.0]))
    client = panel._client
    client.plant, client.design = panel._of[1], SimpleNamespace(xe=[0.0, 0.0])
    panel._names = lambda: ('px', 'py')
    panel.drop = lambda: SetPointPanel.drop(panel)
    panel._set = lambda given: SetPointPanel._set(panel, given)
    SetPointPanel.refresh(panel)
    SetPointPanel.click(panel, 0.6, 0.4)
    SetPointPanel.refresh(panel)
    vars(client).update(change)
    SetPointPanel.refresh(panel)
    asyncio.run(SetPointPanel.hold(panel))
    pending = [0.0, 0.0] if change else [0.6, 0.4]
    assert [field.value for field in panel._fields] == pending
    assert changes == ([] if 'reference' in change else [{'mpc_node': {'setpoint': pending}}])


def test_a_step_and_the_way_back_drop_what_was_clicked():
    for act in (SetPointPanel.step, SetPointPanel.go_back):
        sent: list[Any] = []

        async def refuse(given: list[float], sent: list[Any] = sent) -> None:
            sent.append(given)

        panel = make_panel([], **make_fields([0.6, 0.4]), _before=[0.1, 0.0], _set=refuse)
        panel._names = lambda: ('px', 'py')
        panel.drop = lambda panel=panel: SetPointPanel.drop(panel)
        asyncio.run(act(panel))
        assert sent == [[0.5, 0.0]] or sent == [[0.1, 0.0]]
        assert [field.value for field in panel._fields] == [0.0, 0.0]
