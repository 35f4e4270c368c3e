# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A controller and a robot that the test moves: each state waits for the command to it."""

from collections.abc import Callable, Sequence
import math
from typing import Any

from geometry_msgs.msg import TwistStamped, WrenchStamped
from nav_msgs.msg import Odometry
import numpy as np
from numpy.typing import NDArray
from obc_ros.msg import Command, Measurement, State, Trajectory
from obc_ros.ros.messages import read_nanoseconds, set_stamp
from probes import Probe
import support

Array = NDArray[np.float64]

SOURCES = {'state': State, 'odom': Odometry, 'measurement': Measurement}
SINKS = {'command': Command, 'cmd_vel': TwistStamped, 'wrench': WrenchStamped}
SILENT = 0.2   # [s] until a state is sent again
PLANNED = 2.0  # [s] that a plan for the next state is waited for
# Points (px, py) and headings. A set point that moves is carried on by each change that leaves it
# the same: here a change leaves nothing the same.
LANES = ((0.0, 0.0, 0.0), (1.0, -1.0, math.radians(1.0)), (2.0, -2.0, math.pi / 2),
         (3.0, -3.0, math.pi))
# The stamps are simulated, and a loaded machine answers late.
LOCKSTEP = {'stamp_timeout': 0.0, 'state_timeout': support.DEADLINE, 'transition_time': 0.0}


class RobotBench:
    """
    A controller in a process of its own, driven in lockstep.

    Parameters
    ----------
    spawn, probe
        The fixtures.
    node : str
        lqr_node or mpc_node.
    source, sink : str
        Topics of the states and the commands; `odom` takes states (px, py, theta) of a body that
        moves in a horizontal plane, `measurement` what sensors measure: see `estimator`.
    period : float
        Time between two states [s].
    estimator : dict, optional
        Parameters of an estimator_node, with the names of the `outputs` that are measured.
    parameters
        Of the node.

    Attributes
    ----------
    time : int
        Stamp of the next state [ns].
    commands : list
        The messages of `sink`, all of them.

    """

    def __init__(self, spawn: support.Spawner, probe: Probe, node: str, source: str, sink: str,
                 period: float, estimator: dict[str, Any] | None = None, **parameters: Any
                 ) -> None:
        self.probe, self.node, self.source, self.sink = probe, node, source, sink
        self.period, self.time = round(period * 1e9), 0
        self._outputs: list[str] = estimator['outputs'] if estimator else []
        if estimator:
            spawn('estimator_node', {'rate': 0.0, 'stamp_timeout': 0.0} | estimator)
        given: dict[str, Any] = {**LOCKSTEP, 'state_source': 'state' if estimator else source,
                                 'command_sink': sink}
        if node == 'mpc_node':
            # A solve may take as long as it likes: time stands still until its plan has come.
            given |= {'rate': 1.0 / period, 'deadline': PLANNED, 'plan_rate': 1e6}
        self.process = spawn(node, given | parameters)
        self.commands: list[Any] = probe.listen(SINKS[sink], sink)
        self._plans: list[Trajectory] = probe.listen(Trajectory, f'{node}/plan')
        self._states = probe.publisher(SOURCES[source], source)
        if estimator:
            probe.wait_for(lambda: probe.node.count_subscribers('measurement')
                           and probe.node.count_subscribers('state'), what='the estimator')

    def ask(self, x: Sequence[float]) -> Any:
        """Send a state (n,) until it is answered; return the message of its command."""
        message = self._make_message(x)
        seen, is_again = len(self.commands), False

        def answered() -> Any:
            nonlocal is_again
            if is_again and self._outputs:   # the same measurement would give no other estimate
                self.time += self.period
            is_again = True
            set_stamp(message.header.stamp, self.time)
            self._states.publish(message)
            self.probe.spin_until(lambda: self._find(seen), SILENT)
            return self._find(seen)

        found = self.probe.wait_for(answered, what=f'the answer to {list(x)}')
        self.time += self.period
        if self.node == 'mpc_node':
            self.probe.spin_until(self._is_planned, PLANNED)
            del self._plans[:-1]
        return found

    def run(self, seconds: float, measure: Callable[[], Sequence[float]],
            move: Callable[[Any], None]) -> Array:
        """
        Close the loop for a time [s]; return the states (k, n).

        `measure` returns the state; `move` takes the message of a command for one period.
        """
        x = []
        for _ in range(round(seconds * 1e9 / self.period)):
            x.append(np.array(measure()))
            move(self.ask(x[-1]))
        return np.array(x)

    def begin_anew(self) -> None:
        """Let no state come for longer than `state_timeout`, by the stamps."""
        self.time += round(2e9 * support.DEADLINE)

    def set(self, **values: Any) -> None:
        """Set parameters at once; the node must accept them."""
        result = self.probe.set_parameters_atomically(f'/{self.node}', **values)
        assert result.successful, result.reason

    def _find(self, seen: int) -> Any:
        return next((each for each in self.commands[seen:]
                     if read_nanoseconds(each.header.stamp) == self.time), None)

    def _is_planned(self) -> bool:
        return bool(self._plans) and read_nanoseconds(self._plans[-1].header.stamp) >= self.time

    def _make_message(self, x: Sequence[float]) -> Any:
        if self.source == 'state':
            return State(x=list(map(float, x)))
        if self.source == 'measurement':
            return Measurement(names=self._outputs, y=list(map(float, x)))
        message = Odometry(child_frame_id='base_link')
        message.header.frame_id = 'odom'
        pose = message.pose.pose
        pose.position.x, pose.position.y = map(float, x[:2])
        pose.orientation.z, pose.orientation.w = math.sin(x[2] / 2), math.cos(x[2] / 2)
        return message


def see_from_lane(x: Array, lane: Sequence[float]) -> Array:
    """Return states (k, 3) of a car (px, py, theta) in the frame of a lane: a point, a heading."""
    px, py, heading = lane
    c, s, turn = math.cos(heading), math.sin(heading), x[:, 2] - heading
    dx, dy = x[:, 0] - px, x[:, 1] - py
    return np.column_stack([c * dx + s * dy, c * dy - s * dx,
                            np.arctan2(np.sin(turn), np.cos(turn))])


def place_beside_lane(seen: Sequence[float], lane: Sequence[float]) -> list[float]:
    """Return the state (3,) of a car that is seen from a lane at (along, across, turn)."""
    (along, across, turn), (px, py, heading) = seen, lane
    c, s = math.cos(heading), math.sin(heading)
    return [px + c * along - s * across, py + s * along + c * across, turn + heading]
