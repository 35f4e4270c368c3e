# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A thread that waits for the messages of one subscription.

The executor of rclpy collects all entities of a node for each message. With the services of a
node this takes longer than the control law. Here a wait set holds one subscription, and neither a
service nor a timer delays a state.
"""

from collections.abc import Callable, Iterable
import gc
import sys
import threading
from typing import Any

from obc_ros.workers.processes.real_time import raise_priority
from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import EventHandler
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.subscription import Subscription

# [s] after which a thread that runs Python code yields to a waiting one; 5 ms by default.
SWITCH_INTERVAL = 2e-4
PRIORITY = ('real-time priority (SCHED_FIFO) of the process; 0: none. Threads of the node have '
            'one less than those of DDS, and the solver process of mpc_node has one less again. '
            'Needs an rtprio limit, or root')


class Apart(CallbackGroup):  # type: ignore[misc] # rclpy's classes are untyped
    """The callback group of subscriptions that the executor ignores."""

    def can_execute(self, entity: Any) -> bool:
        """Return that the executor must not wait for an entity."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Return that the executor must not execute an entity."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Do nothing."""


class OwnThread:
    """
    Takes the messages of one subscription, whose callback group must be an `Apart`.

    :param on_message: called in the thread with each message and its information
        (`rmw_message_info_t`).
    :param on_time: called in the thread after each wait; returns how long [s] to wait at most.
    :param events: QoS events of the subscription. In an executor they would wake it at each
        message.
    :param priority: real-time priority of the process, see `PRIORITY`.
    :param is_raw: whether messages are passed as they were sent, in bytes.
    """

    def __init__(self, node: Node, subscription: Subscription,
                 on_message: Callable[[Any, Any], None],
                 on_time: Callable[[], float], events: Iterable[EventHandler] = (),
                 priority: int = 0, is_raw: bool = False) -> None:
        sys.setswitchinterval(SWITCH_INTERVAL)
        self._priority = priority
        self._node, self._subscription, self._events = node, subscription, tuple(events)
        self._on_message, self._on_time, self._is_raw = on_message, on_time, is_raw
        self._wake = GuardCondition(None, None, context=node.context)
        self._died = node.create_guard_condition(self._end)
        self._thread: threading.Thread | None = None
        self._running = False

    def start(self) -> None:
        """Begin to take messages."""
        gc.collect()
        gc.freeze()  # later collections skip the objects of the start, and are shorter
        # Messages are delivered before the node continues. With equal priorities on one core a
        # message waits for its turn, and a plant at 1 kHz missed ten times as many commands.
        if self._priority and (reason := raise_priority(self._priority, self._priority - 1)):
            self._node.get_logger().warning(reason)
        self._running = True
        self._thread = threading.Thread(target=self._run, name='states', daemon=True)
        self._thread.start()

    def wake(self) -> None:
        """Let `on_time` be called now."""
        self._wake.trigger()

    def stop(self) -> None:
        """Take no more messages; return when the last callback has ended."""
        self._running = False
        if self._thread is not None:
            self._wake.trigger()
            self._thread.join()
            self._thread = None

    def _end(self) -> None:
        raise RuntimeError('the thread that takes the states has ended')

    def _run(self) -> None:
        try:
            self._take()
        finally:
            if self._running:  # an exception here must end the node
                self._died.trigger()

    def _take(self) -> None:
        handle, message_type = self._subscription.handle, self._subscription.msg_type
        events, context, is_raw = self._events, self._node.context.handle, self._is_raw
        with handle, self._wake.handle, context:
            wait_set = _rclpy.WaitSet(1, 1, 0, 0, 0, len(events), context)
            while self._running:
                wait_set.clear_entities()
                wait_set.add_subscription(handle)
                wait_set.add_guard_condition(self._wake.handle)
                for event in events:
                    event.add_to_wait_set(wait_set)
                wait_set.wait(int(max(self._on_time(), 0.0) * 1e9))
                taken = handle.take_message(message_type, is_raw)
                if taken is not None:
                    self._on_message(*taken)
                for event in events:
                    if event.is_ready(wait_set):
                        event.callback(event.take_data())
