# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Which speeds of the plant are set, and that a gust acts, without a browser."""

import asyncio
from contextlib import closing
import math
from types import SimpleNamespace
from typing import Any

from obc_ros import systems
from obc_ros.msg import State
import pytest

pytest.importorskip('nicegui', reason='NiceGUI is not installed')
from obc_ros.view.disturbances import Acting, Disturbances
from obc_ros.view.loop_client import LoopClient
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


@pytest.mark.nodes
@pytest.mark.parametrize('publish_clock', [False, True])
def test_a_gust_acts_whatever_the_stamps_of_the_states_are(
        spawn, probe, domain, monkeypatch, publish_clock):
    """Without publish_clock stamps are wall time; the gust adds half its peak times its span."""
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    states = probe.listen(State, 'state')
    spawn('plant_simulator', {
        'system': 'double_integrator', 'publish_rate': 50.0, 'publish_clock': publish_clock,
        'hold_until_command': False})
    probe.wait_for(lambda: states)
    speed = systems['double_integrator'].states[1]
    gust, seen = (f'gust on {speed}',), []

    async def disturb(client: LoopClient) -> None:
        async def change(values: dict[str, Any], beside: dict[str, Any]) -> None:
            given = {**beside, **values}   # no gust on another state begins again
            assert await client.set_parameters('plant_simulator', given) == (True, '')

        await client.load_disturbances()
        panel = SimpleNamespace(_client=client, _may_control=lambda: True, _change=change,
                                _message=SimpleNamespace(text=''))
        await PlantPanel._gust(panel, speed, 4.0, 0.5)
        assert not panel._message.text

    with closing(LoopClient()) as client:
        asyncio.run(disturb(client))

        def is_over() -> bool:
            if frame := client.take_frame():
                seen.append(frame.acting)
            return Acting(gust, is_gust=True) in seen and seen[-1] == Acting()

        probe.wait_for(is_over)
        states.clear()
        probe.wait_for(lambda: states)
    assert 0.5 < states[-1].x[1] <= 1.0 + 1e-9   # on a busy machine its begin has passed


@pytest.mark.parametrize(('values', 'stamp', 'acting'), [
    ({}, 5.0, Acting()),
    ({'disturbance.gust.vx': 2.0, 'disturbance.gust_start': 1.0}, 101.5,
     Acting(('gust on vx',), True, (2.0, 0.0))),
    ({'disturbance.gust.vx': 2.0, 'disturbance.gust_start': 1.0}, 102.5, Acting()),
    ({'disturbance.gust.vx': 2.0, 'disturbance.gust_start': 1.0}, 1.5, Acting()),
    ({'disturbance.constant.vy': -1.0, 'noise.px': 0.1, 'noise.py': 0.0}, 0.0,
     Acting(('constant on vy', 'noise'), False, (0.0, -1.0))),
    ({'disturbance.constant.omega': 1.0, 'mass': 4.0}, 0.0, Acting(('constant on omega',))),
    ({'disturbance.constant.vx': math.nan, 'noise.px': 'much'}, 0.0, Acting())])
def test_what_acts_is_found_by_the_time_of_the_plant(values, stamp, acting):
    """Its time 0 has the stamp 100 s."""
    disturbances = Disturbances()
    disturbances.epoch = 100.0
    disturbances.take(values)
    assert disturbances.find(stamp) == acting


def test_a_disturbance_that_is_no_parameter_any_more_does_not_act():
    """Nor does one of the plant before, whose states have other names."""
    disturbances = Disturbances()
    disturbances.take({'disturbance.constant.vx': 1.0, 'noise.px': 0.1})
    disturbances.change({'disturbance.constant.vy': 2.0}, ['noise.px'])
    assert disturbances.find(0.0).words == ('constant on vx, vy',)
    disturbances.change({'disturbance.constant.vy': math.nan}, ())
    assert disturbances.find(0.0).words == ('constant on vx',)
    disturbances.take({'disturbance.constant.v': 3.0})
    assert disturbances.find(0.0).words == ('constant on v',)
