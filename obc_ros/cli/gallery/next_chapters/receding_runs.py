# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Runs of plant_simulator with mpc_node in lockstep, for entries of the gallery."""

from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from obc_ros.cli.flight_client import Pilot
from obc_ros.cli.gallery.loop import (
    ATTEMPTS,
    list_arguments,
    read_run,
    Run,
    UnansweredError,
)
from obc_ros.cli.gallery.ros2_commands import run_node
from obc_ros.cli.gallery.runner import Desk
from obc_ros.cli.processes import Children
from obc_ros.cli.recording import Recorder

LONGEST = 120.0   # [s] that the nodes may take to begin, and for a run
MISSED = 'deadlines missed'
PLAN = 'ros2 topic echo --once /mpc_node/plan obc_ros/msg/Trajectory'


def run_receding(desk: Desk, name: str, plant: Mapping[str, Any], controller: Mapping[str, Any],
                 duration: float) -> Run:
    """
    Return the states and commands of a loop whose plant waits at each state for its command.

    Parameters
    ----------
    desk : Desk
        Keeps the commands.
    name : str
        Of the recording.
    plant, controller : mapping
        Parameters of plant_simulator and mpc_node.
    duration : float
        Of the run [s]; it is in real time, so that each plan is ready in time.

    Raises
    ------
    UnansweredError
        If messages are lost or a plan is late in each of `ATTEMPTS` runs.

    """
    plant = {**plant, 'lockstep': True}
    desk.note(run_node('plant_simulator', plant))
    desk.note(run_node('mpc_node', controller))
    desk.note(PLAN)
    for _ in range(ATTEMPTS):
        found = _run(desk.name_folder(name), plant, controller, round(duration * 1e9))
        if found is not None:
            return found
    raise UnansweredError('states or commands of the loop were lost in transit, or plans late')


def _run(folder: Path, plant: Mapping[str, Any], controller: Mapping[str, Any], end: int
         ) -> Run | None:
    """Return a run up to a stamp [ns]; None if messages are lost or a plan is late."""
    reports: list[DiagnosticArray] = []
    with Children(folder / 'log') as children, Recorder(folder) as recorder:
        children.start('plant_simulator', *list_arguments(plant))
        with closing(Pilot(children, recorder, controller='mpc_node')) as pilot:
            pilot.node.create_subscription(DiagnosticArray, '/diagnostics', reports.append, 100)
            # Every command is heard: the node begins after this client.
            pilot.wait(lambda: bool(pilot.states.stamp), 'the plant', LONGEST)
            children.start('mpc_node', *list_arguments(controller))
            pilot.wait(lambda: pilot.states.stamp[-1] >= end
                       and pilot.commands.stamp[-1:] >= [end], f't = {1e-9 * end:g} s', LONGEST)
            del reports[:]
            pilot.wait(lambda: MISSED in _read_figures(reports), 'the diagnostics', LONGEST)
            if int(_read_figures(reports)[MISSED]):
                return None
            return read_run(pilot.states, pilot.commands, end)


def _read_figures(reports: Sequence[DiagnosticArray]) -> dict[str, str]:
    """Return the figures of the plans in diagnostics; empty if they are not there."""
    return {each.key: each.value for report in reports for status in report.status
            if status.name == 'mpc_node: plan' for each in status.values}
