# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Which speeds of the plant are set, without a browser."""

import asyncio
import math
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip('nicegui', reason='NiceGUI is not installed')
from obc_ros.view.panels.plant_panel import PlantPanel, TOP_SPEED


@pytest.mark.parametrize(('priority', 'value', 'said'), [
    (0, 6.0, ''), (50, 6.0, 'speed: give a number above 0, up to 5: '), (50, TOP_SPEED, ''),
    (50, 0.0, 'speed: give a number above 0, '), (0, math.nan, 'speed: a number is wanted'),
    (0, None, 'speed: a number is wanted')])
def test_a_plant_with_a_real_time_priority_leaves_time_to_others(priority, value, said):
    """With an ordinary priority any speed may be set."""
    changes: list[dict[str, Any]] = []

    async def change(values):
        changes.append(values)

    panel = SimpleNamespace(_priority=priority, _may_control=lambda: True, _change=change,
                            _message=SimpleNamespace(text=''))
    asyncio.run(PlantPanel._set(panel, 'speed', value, False))
    assert panel._message.text.startswith(said)
    assert changes == ([] if said else [{'speed': value}])
