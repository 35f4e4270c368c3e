# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The view of the last plan of trajectory_server: its path, goal, switching times and obstacles.

Messages are made only if somebody subscribes, after the response to the request. They are kept for
later subscribers. Nothing that draws is imported before, so that the node starts as fast as
without a view.
"""

from collections.abc import Callable, Mapping
from typing import Any

from nav_msgs.msg import Path
from obc_ros.msg import Trajectory
from obc_ros.nodes.views.scene import Scene
from obc_ros.ros.execution.callback_guards import guard_callbacks
from obc_ros.ros.service_qos import LATCHED_QOS, STEADY
from rclpy.node import Node

LOOK_PERIOD = 0.5  # [s] between two looks for subscribers
StateProblem = Callable[[], Mapping[str, Any]]
PLACES = {'px', 'py'}   # states without which there is nothing to draw


class PlanView:
    """The view of the plans of a node."""

    def __init__(self, node: Node) -> None:
        self.is_shown = True
        self._path = node.create_publisher(Path, 'plan', LATCHED_QOS)
        self._scene = Scene(node, 'plan_markers', LATCHED_QOS)
        self._plan: tuple[Trajectory, StateProblem | None] | None = None
        self._todo: set[str] = set()
        timer = node.create_timer(LOOK_PERIOD, self._publish,
                                  clock=STEADY)
        guard_callbacks(node, timer, 'view of the plan')

    def show(self, plan: Trajectory, state: StateProblem | None = None) -> None:
        """Show a plan, if it has places; `state` returns its problem, as in a file."""
        if PLACES & set(plan.state_names) and plan.t:
            self._plan, self._todo = (plan, state), {'path', 'markers'}

    def _publish(self) -> None:
        watched: dict[str, Any] = {
            'path': self._path.get_subscription_count() > 0, 'markers': self._scene.is_watched}
        todo = {name for name in self._todo if watched[name]}
        if not (self.is_shown and todo and self._plan):
            return
        from obc_ros.nodes.views.plan_messages import make_markers, make_path  # CasADi: 0.3 s
        self._todo -= todo
        if 'path' in todo and (path := make_path(self._plan[0])):
            self._path.publish(path)
        if 'markers' in todo:
            plan, state = self._plan
            self._scene.show(make_markers(plan, state() if state else None))
