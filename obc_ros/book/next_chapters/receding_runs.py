# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Runs of plant_simulator with mpc_node in lockstep, for entries of the gallery."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from obc_ros.book.loop import ATTEMPTS, read_run, record_nodes, Run, SIMULATED, UnansweredError
from obc_ros.book.ros2_commands import run_node
from obc_ros.book.runner import Desk

LONGEST = 120.0   # [s] that the nodes may take to begin, and for a run
MISSED = 'deadlines missed'
PLAN = 'ros2 topic echo --once /mpc_node/plan obc_ros/msg/Trajectory'


def run_receding(desk: Desk, plant: Mapping[str, Any], controller: Mapping[str, Any],
                 duration: float) -> Run:
    """
    Return the states and commands of a loop whose plant waits at each state for its command.

    :param plant, controller: parameters of plant_simulator and mpc_node.
    :param duration: length of the run [s]; the plant keeps real time, so that each plan is ready
        in time.
    :raises UnansweredError: if messages are lost or a plan is late in each of `ATTEMPTS` runs.
    """
    plant = {**plant, 'lockstep': True}   # whose stamps are simulated
    # The period is as long as the default: a late state would count as missing.
    controller = {**controller, **SIMULATED, 'stamp_timeout': 0.0, 'state_timeout': 0.0}
    desk.note(run_node('plant_simulator', plant))
    desk.note(run_node('mpc_node', controller))
    desk.note(PLAN)
    for _ in range(ATTEMPTS):
        found = _run(desk.name_folder(plant['system']), plant, controller, round(duration * 1e9))
        if found is not None:
            return found
    raise UnansweredError('states or commands of the loop were lost in transit, or plans late')


def _run(folder: Path, plant: Mapping[str, Any], controller: Mapping[str, Any], end: int
         ) -> Run | None:
    """Return a run up to a stamp [ns]; None if messages are lost or a plan is late."""
    reports: list[DiagnosticArray] = []
    with record_nodes(folder, 'mpc_node') as nodes:
        pilot = nodes.pilot
        pilot.node.create_subscription(DiagnosticArray, '/diagnostics', reports.append, 100)
        nodes.start('plant_simulator', plant)
        # Every command is heard: mpc_node begins after the client has heard a state.
        pilot.wait(lambda: bool(pilot.states.stamp), 'the plant', LONGEST)
        nodes.start('mpc_node', controller)
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
