# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Determinism: two flights in lockstep give recordings that are equal byte by byte."""

from collections.abc import Callable
from pathlib import Path
import subprocess
import sys
from typing import Any

from obc_ros.cli.demo import vehicle
from obc_ros.cli.demo.flight import Flight, FlightEvent, fly, set_parameters
from obc_ros.cli.flight_client import Pilot
from obc_ros.cli.processes import isolate, reserve_domain
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import Trajectory
from obc_ros.srv import PlanMotion
import pytest
from rosbags.highlevel import AnyReader

pytestmark = pytest.mark.nodes

BUSY = 'while True: pass'


def change(**values: list[float]) -> Callable[[Pilot], str]:
    """Return an action that sets parameters of lqr_node and waits for the new design."""
    def act(pilot: Pilot) -> str:
        revision = pilot.designs[-1].revision
        set_parameters('lqr_node', dict(values))(pilot)
        pilot.wait(lambda: pilot.designs[-1].revision > revision, 'the new design')
        return ''
    return act


def plan(pilot: Pilot) -> str:
    """Follow a plan that begins where the vehicle will be in one second."""
    answer = pilot.call(PlanMotion, 'trajectory_server/plan', PlanMotion.Request(
        system='vehicle', start=[float(pilot.x[0]) + 10.0, -2.0, 0.0],
        goal=[float(pilot.x[0]) + 60.0, 2.0, 0.0], objective='effort', final_time=5.0))
    if not answer.success:
        raise ObcError(answer.message)
    reference: Trajectory = answer.trajectory
    vehicle._publish(pilot, reference, pilot.states.stamp[-1] + 10**9)
    return ''


FLIGHTS = {
    'aircraft': Flight('flight', 'aircraft.yaml', 3.0, (
        FlightEvent(0.5, 'a step', change(setpoint=[1.0, 1.0, 0.0, 0.0, 0.0, 0.0])),
        FlightEvent(1.8, 'other weights', change(
            Qx=[100.0, 1.0, 0.698, 0.0, 0.0, 0.0], Qu=[0.1, 0.1])),
        FlightEvent(2.0, 'a step', change(setpoint=[2.0, 1.0, 0.0, 0.0, 0.0, 0.0])))),
    'vehicle': Flight('flight', 'vehicle.yaml', 4.0, (FlightEvent(1.0, 'a plan', plan),))}


@pytest.mark.parametrize('flight', FLIGHTS.values(), ids=FLIGHTS)
def test_two_flights_in_lockstep_give_equal_recordings(flight: Flight, tmp_path: Path,
                                                       monkeypatch: Any) -> None:
    """The second flight runs beside a process that loads one core."""
    for name in ('ROS_DOMAIN_ID', 'ROS_AUTOMATIC_DISCOVERY_RANGE'):
        monkeypatch.setenv(name, '')
    recordings = []
    for number, load in enumerate((0, 1)):
        busy = [subprocess.Popen([sys.executable, '-c', BUSY]) for _ in range(load)]
        try:
            with reserve_domain() as domain:
                isolate(domain)
                fly(flight, tmp_path / str(number), False, lambda pilot, wall: 0)
        finally:
            for process in busy:
                process.kill()
                process.wait()
        folder = tmp_path / str(number) / 'flight'
        recordings.append((folder / 'flight_0.mcap').read_bytes())
        assert (folder / 'metadata.yaml').read_bytes() == (
            tmp_path / '0' / 'flight' / 'metadata.yaml').read_bytes()
    assert recordings[0] == recordings[1]
    with AnyReader([tmp_path / '0' / 'flight']) as reader:
        counts = {each.topic: each.msgcount for each in reader.connections}
    assert counts['/state'] == counts['/command'] == counts['/odom'] > 100 * flight.duration
    assert counts['/lqr_node/design'] == 1 + len(flight.events) * (flight is FLIGHTS['aircraft'])
    assert counts['/reference'] == (flight is FLIGHTS['vehicle'])
