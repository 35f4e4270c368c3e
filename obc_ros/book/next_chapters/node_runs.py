# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Runs of plant_simulator with estimator_node, and with mpc_node in lockstep."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from obc_ros.book.loop import (
    ATTEMPTS,
    read_run,
    record_nodes,
    Run,
    run_node,
    SIMULATED,
    UnansweredError,
    write_service_call,
)
from obc_ros.book.runner import Desk
from obc_ros.cli.flight_client import Pilot, Samples
from obc_ros.core.numerics.arrays import Array
from obc_ros.msg import Estimate, Measurement, State
from obc_ros.srv import SuggestNoise
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

RENAMED = {'state': 'true_state'}  # of the plant; estimator_node publishes the estimate as state
ECHO = 'ros2 topic echo --once /estimator_node/estimate obc_ros/msg/Estimate'
SPEED = 2.0      # other than 1: the stamps are simulated time from 0
AGAIN = 0.5      # [s] after which a paused plant is asked for another state
LONGEST = 60.0   # [s] that the nodes may take to begin, and for a run
LONGEST_RUN = 120.0   # [s] the same with mpc_node
MISSED = 'deadlines missed'
PLAN = 'ros2 topic echo --once /mpc_node/plan obc_ros/msg/Trajectory'


@dataclass(frozen=True, eq=False)
class EstimatedRun:
    """Measurements y (N, q) at t (N,) [s], estimates x, P after them, true states (N, n)."""

    t: Array
    y: Array
    x: Array
    P: Array
    true: Array


def run_estimator(desk: Desk, plant: Mapping[str, Any], estimator: Mapping[str, Any], count: int
                  ) -> EstimatedRun:
    """Return `count` estimates of a plant, one after each measurement; UnansweredError if lost."""
    plant, estimator = {**plant, 'speed': SPEED}, {**estimator, 'stamp_timeout': 0.0}
    desk.note(run_node('plant_simulator', plant, RENAMED))
    desk.note(run_node('estimator_node', estimator))
    desk.note(ECHO)
    heard = {kind: Samples() for kind in (Measurement, Estimate, State)}
    topics = {Measurement: 'measurement', Estimate: 'estimator_node/estimate',
              State: RENAMED['state']}
    with record_nodes(desk.name_folder(plant['system']), 'estimator_node') as nodes:
        pilot = nodes.pilot
        for kind, samples in heard.items():
            nodes.recorder.subscribe(pilot.node, topics[kind], kind, samples.append)
        # The plant is paused after its first states: the nodes begin together.
        nodes.start('plant_simulator', {**plant, 'pause_at': 1.0 / plant['publish_rate']}, RENAMED)
        nodes.start('estimator_node', estimator)
        _begin(pilot, heard[Estimate])
        pilot.pause(False)
        pilot.wait(lambda: len(heard[Estimate].stamp) >= count, f'{count} estimates', LONGEST)
        pilot.pause(True)
    return _read(heard, count)


def ask_estimator(desk: Desk, estimator: Mapping[str, Any], request: SuggestNoise.Request
                  ) -> SuggestNoise.Response:
    """Return the answer of estimator_node to a request; UnansweredError if it rejects it."""
    desk.note(run_node('estimator_node', estimator))
    desk.note(write_service_call('suggest_noise', SuggestNoise, request, 'estimator_node'))
    with record_nodes(desk.name_folder('suggestion'), 'estimator_node') as nodes:
        nodes.start('estimator_node', estimator)
        answer = nodes.pilot.call(
            SuggestNoise, 'estimator_node/suggest_noise', request, LONGEST)
    if not answer.success:
        raise UnansweredError(f'estimator_node: {answer.message}')
    return answer


def _begin(pilot: Pilot, estimates: Samples) -> None:
    """Advance the paused plant until there is an estimate."""
    stepper = pilot.node.create_client(Trigger, 'plant_simulator/step')
    pilot.wait(stepper.service_is_ready, 'the plant', LONGEST)
    due = 0.0

    def is_estimated() -> bool:
        nonlocal due
        if not estimates.stamp and time.monotonic() > due:
            stepper.call_async(Trigger.Request())
            due = time.monotonic() + AGAIN
        return bool(estimates.stamp)

    pilot.wait(is_estimated, 'the first estimate', LONGEST)


def _read(heard: Mapping[Any, Samples], count: int) -> EstimatedRun:
    """Return the messages of each stamp side by side."""
    by_stamp = {kind: {stamp: deserialize_message(data, kind) for stamp, data in zip(
        samples.stamp, samples.data, strict=True)} for kind, samples in heard.items()}
    stamps = heard[Estimate].stamp[:count]
    if any(stamp not in by_stamp[kind] for kind in heard for stamp in stamps):
        raise UnansweredError('measurements or states of the run were lost in transit')
    estimates = [by_stamp[Estimate][stamp] for stamp in stamps]
    x = np.array([each.x for each in estimates])
    n = x.shape[1]
    return EstimatedRun(
        1e-9 * np.array(stamps), np.array([by_stamp[Measurement][stamp].y for stamp in stamps]),
        x, np.array([each.covariance for each in estimates]).reshape(-1, n, n),
        np.array([by_stamp[State][stamp].x for stamp in stamps]))


def run_receding(desk: Desk, plant: Mapping[str, Any], controller: Mapping[str, Any],
                 duration: float) -> Run:
    """
    Return the states and commands of a loop whose plant waits at each state for its command.

    The plant keeps real time, so that each plan is ready in time.
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
        pilot.wait(lambda: bool(pilot.states.stamp), 'the plant', LONGEST_RUN)
        nodes.start('mpc_node', controller)
        pilot.wait(lambda: pilot.states.stamp[-1] >= end
                   and pilot.commands.stamp[-1:] >= [end], f't = {1e-9 * end:g} s', LONGEST_RUN)
        del reports[:]
        pilot.wait(lambda: MISSED in _read_figures(reports), 'the diagnostics', LONGEST_RUN)
        if int(_read_figures(reports)[MISSED]):
            return None
        return read_run(pilot.states, pilot.commands, end)


def _read_figures(reports: Sequence[DiagnosticArray]) -> dict[str, str]:
    """Return the figures of the plans in diagnostics; empty if they are not there."""
    return {each.key: each.value for report in reports for status in report.status
            if status.name == 'mpc_node: plan' for each in status.values}
