# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""lqr_node as a client sees it: where its plant will be, and whether it follows a reference."""

from typing import Any

from builtin_interfaces.msg import Time
from obc_ros.msg import Trajectory
from obc_ros.ros.execution.callback_guards import STEADY
from obc_ros.ros.service_qos import BURST
from obc_ros.srv import FollowReference, PredictState
from rclpy.callback_groups import CallbackGroup
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future


def make_stamp(time: int) -> Time:
    """Return the stamp of a time [ns], not negative."""
    seconds, nanoseconds = divmod(time, 10**9)
    return Time(sec=seconds, nanosec=nanoseconds)


class LqrClient:
    """
    The services of the lqr_node in the namespace of a node.

    :param node: the node that asks.
    :param group: of the answers; it must not contain the callback that waits, unless it is
        reentrant.
    """

    def __init__(self, node: Node, group: CallbackGroup) -> None:
        self._node, self._group = node, group
        self._prediction, self._following = (
            node.create_client(service, name, qos_profile=BURST, callback_group=group)
            for service, name in ((PredictState, 'lqr_node/predict_state'),
                                  (FollowReference, 'lqr_node/follow_reference')))

    @property
    def is_there(self) -> bool:
        """Return whether both services are offered."""
        return all(each.service_is_ready() for each in (self._prediction, self._following))

    @property
    def prediction(self) -> str:
        """Return the name of the service that predicts states."""
        return str(self._prediction.service_name)

    @property
    def following(self) -> str:
        """Return the name of the service that follows references."""
        return str(self._following.service_name)

    async def predict(self, stamp: int, timeout: float) -> Any:
        """Return the response for a stamp [ns]; None: there is none within `timeout` [s]."""
        request = PredictState.Request(stamp=make_stamp(stamp))
        return await self._call(self._prediction, request, timeout)

    async def follow(self, plan: Trajectory, timeout: float) -> Any:
        """Return the response to a reference; None: there is none within `timeout` [s]."""
        return await self._call(self._following, FollowReference.Request(reference=plan), timeout)

    async def _call(self, client: Client, request: Any, timeout: float) -> Any:
        done: Future = Future()

        def end(answer: Any) -> None:
            if not done.done():
                done.set_result(answer)

        asked = client.call_async(request)
        asked.add_done_callback(lambda _: end(asked.result()))
        timer = self._node.create_timer(timeout, lambda: end(None), self._group, STEADY)
        answer = await done
        self._node.destroy_timer(timer)
        client.remove_pending_request(asked)
        return answer
