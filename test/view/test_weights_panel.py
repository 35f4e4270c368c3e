# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""When a changed weight is tried, without a browser."""

import asyncio
import itertools
import math
from types import SimpleNamespace

import pytest

pytest.importorskip('nicegui', reason='NiceGUI is not installed')
from obc_ros.view.panels.weights_panel import HALF_STEP, HIGHEST, MOST_CHANGES, WeightsPanel


def test_a_change_during_a_preview_is_tried_after_it():
    tried: list[int] = []

    async def try_candidate():
        tried.append(len(tried))
        panel._dirty = len(tried) < 3

    panel = SimpleNamespace(_dirty=True, _busy=True, _try_candidate=try_candidate)
    asyncio.run(WeightsPanel._preview(panel))
    assert tried == [0, 1, 2] and not panel._busy


def test_a_preview_that_fails_does_not_end_all_later_ones():
    async def fail():
        raise ZeroDivisionError

    panel = SimpleNamespace(_dirty=True, _busy=True, _try_candidate=fail)
    with pytest.raises(ZeroDivisionError):
        asyncio.run(WeightsPanel._preview(panel))
    assert not panel._busy


@pytest.mark.parametrize(('value', 'moved', 'tried'), [
    (10.0, 1.0, True), (10.0 ** (0.9 * HALF_STEP), 0.0, True), (math.inf, HIGHEST, True),
    (math.nan, 0.0, False), (None, 0.0, False), ('7', 0.0, False)])
def test_a_number_is_tried_at_once_and_moves_the_slider_that_is_elsewhere(value, moved, tried):
    begun: list[bool] = []
    panel = SimpleNamespace(_dirty=False, _begin_preview=lambda: begun.append(True))
    row = SimpleNamespace(slider=SimpleNamespace(value=0.0))
    WeightsPanel._type(panel, row, value)
    assert row.slider.value == moved and panel._dirty == bool(begun) == tried


def test_the_changes_that_can_be_undone_are_bounded():
    """A page that is open for weeks keeps the last ones."""
    async def adopt(mode, values):
        panel._used, panel._applied = mode, values
        return True

    count = itertools.count()
    panel = SimpleNamespace(_undo=[], _used='', _applied={}, _may_control=lambda: True,
                            _mode='matrices', _read=lambda: {'Qx': [float(next(count))]},
                            _set=adopt)
    for _ in range(MOST_CHANGES + 5):
        asyncio.run(WeightsPanel._apply_weights(panel))
    assert len(panel._undo) == MOST_CHANGES
    assert panel._undo[-1][1] == {'Qx': [MOST_CHANGES + 3.0]}
