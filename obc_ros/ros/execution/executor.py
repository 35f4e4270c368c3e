# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The `main` of every node: start, spin, and end without a traceback.

A node that cannot start prints the reason in one sentence on stderr; its exit status is 1. SIGINT
and SIGTERM end it with status 0. They are handled here because rclpy would shut DDS down at once:
so `destroy_node` can still publish, and a controller can send its plant a safe last command.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
import faulthandler
import os
from pathlib import Path
from random import uniform
import re
import signal
import sys
import threading
from time import monotonic, sleep

from obc_ros.core.text.errors import ObcError, quote, StatementError
from obc_ros.ros.execution.callback_guards import guard_callbacks
from obc_ros.ros.middleware import choose_profile
from obc_ros.ros.service_qos import be_patient
import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

FAREWELL = 0.5  # [s] for a node to answer earlier requests after a signal to end
LAST = 20       # turns of the executor that send the responses

# What rclpy raises for arguments, files, names and QoS overrides: RCLError is a RuntimeError.
_UNFIT = (ObcError, RuntimeError, NameValidationException, ParameterException)
PATIENCE = 10.0  # [s] for a node to leave the graph
# [s] for other participants to process the removal of the node's topics, before the node itself
# is removed: a removal that they process after that of the participant makes them list the node
# for ever.
SETTLE = 0.2
# [s] for each node in the graph, 1 s at most: nodes that end together leave at random times within
# it, since the simultaneous removal of another node is the cause of the fault in `limit_leaving`.
ROOM = 0.02


@contextmanager
def limit_leaving() -> Iterator[None]:
    """
    End the process with status 1 if a node does not leave the graph.

    Fast DDS may never return if it processes news of another node at this moment
    (docs/development/reliability.md). It then holds the interpreter's lock: only this timer can
    end the process.
    """
    faulthandler.dump_traceback_later(PATIENCE, exit=True, file=2)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()


def run(build: Callable[[], Node]) -> int:
    """Build and spin a node until SIGINT or SIGTERM, and end the process; 1: it cannot start."""
    with _stopped_by_signals() as stop:
        try:
            choose_profile()
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
            _refuse(remove_ros_args()[1:])
            node = build()
            for service in node.services:  # including those of the parameters
                be_patient(node, service)
                guard_callbacks(node, service, service.srv_name)
            for subscription in node.subscriptions:
                guard_callbacks(node, subscription, subscription.topic_name)
        except _UNFIT as error:
            print(f'{Path(sys.argv[0]).stem}: {summarize_error(error)}', file=sys.stderr)
            rclpy.try_shutdown()
            return 1
        try:
            _spin(node, stop)
        finally:
            with limit_leaving():
                with node.handle:   # keeps the node until its entities are destroyed
                    room = _room(node)
                    node.destroy_node()
                    sleep(SETTLE + uniform(0.0, room))
                rclpy.try_shutdown()
    # Nothing is left to do, and the libraries may block in the same way when they are unloaded.
    for stream in filter(None, (sys.stdout, sys.stderr)):
        with suppress(OSError, ValueError):   # closed by the reader
            stream.flush()
    os._exit(0)


def _room(node: Node) -> float:
    try:
        return min(ROOM * len(node.get_node_names()), 1.0)
    except RuntimeError:  # other code in this process has shut down the context
        return 0.0


def _refuse(words: list[str]) -> None:
    """Reject arguments that are not for ROS: parameters before --ros-args have no effect."""
    if words:
        raise StatementError(f"'{quote(words[0])}' is not understood; parameters are given as in: "
                             '--ros-args -p system:=aircraft --params-file FILE')


class _Stop:
    """A request to stop, made by a signal at any time; it wakes the executor."""

    def __init__(self) -> None:
        self.asked = False
        self.wake: Callable[[], object] = lambda: None

    def ask(self) -> None:
        self.asked = True
        self.wake()


@contextmanager
def _stopped_by_signals() -> Iterator[_Stop]:
    """
    Turn SIGINT and SIGTERM into a request to stop.

    A Python handler does not run while the executor waits in C. When a signal arrives, the
    interpreter writes a byte to a pipe; a thread reads it and wakes the executor.
    """
    stop = _Stop()
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    former = signal.set_wakeup_fd(writer)
    handlers = {number: signal.signal(number, lambda *_: None)
                for number in (signal.SIGINT, signal.SIGTERM)}

    def watch() -> None:
        while os.read(reader, 1) not in (b'', b'\0'):  # 0: the thread is to end
            stop.ask()

    thread = threading.Thread(target=watch, name='signals', daemon=True)
    thread.start()
    try:
        yield stop
    finally:
        for number, handler in handlers.items():
            # A launch file sends the signal twice: the second one arrives while the process ends.
            signal.signal(number, signal.SIG_IGN if stop.asked else handler)
        signal.set_wakeup_fd(former)
        os.write(writer, b'\0')
        thread.join()
        os.close(reader)
        os.close(writer)


def _spin(node: Node, stop: _Stop) -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    # a task: an executor that is only woken continues to wait
    stop.wake = lambda: executor.create_task(lambda: None)
    try:
        while not stop.asked:
            executor.spin_once()
        _answer(node, executor)
    except ExternalShutdownException:
        pass  # other code in this process has shut down the context
    finally:
        stop.wake = lambda: None
        executor.shutdown()


def _answer(node: Node, executor: SingleThreadedExecutor) -> None:
    """Let a node whose `owes()` is true send its responses before it ends."""
    deadline = monotonic() + FAREWELL
    owes = getattr(node, 'owes', None)
    if not owes:
        return
    owed = owes()
    while owes() and monotonic() < deadline:
        executor.spin_once(timeout_sec=0.02)
    if owes():
        node.get_logger().error(f'ends without all responses: some took over {FAREWELL:g} s')
    for _ in range(LAST):
        executor.spin_once(timeout_sec=0.0)
    if owed:
        # A client reads responses and the removal of their sender in two threads. It drops a
        # response that it reads after the removal.
        sleep(SETTLE)


def summarize_error(error: Exception) -> str:
    """
    Return the text of an error on one line, without places in the sources of rcl.

    :param error: of this package, of rclpy or of rcl.
    :return: with advice for lists of mixed types and for a log folder that cannot be written.
    """
    words = ' '.join(re.sub(r', at /\S+:\d+', '', str(error)).split())
    if 'Sequence should be of same type' in words:
        words += ': write the numbers of a list all with a point, or none'
    if 'log director' in words or 'logging director' in words:
        words += ': set ROS_LOG_DIR to a folder that can be written'
    return words
