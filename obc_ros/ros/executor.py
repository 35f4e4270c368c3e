# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The `main` of every node: start, spin, end without a traceback.

A node that cannot start says why in one sentence on stderr and its exit status is 1. SIGINT and
SIGTERM end it with status 0. They are taken here rather than by rclpy, which shuts DDS down at
once: `destroy_node` can still publish, so that a controller can leave its plant a safe command.
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
from obc_ros.ros.callback_guards import guard_callbacks
from obc_ros.ros.middleware import choose_profile
from obc_ros.ros.service_qos import be_patient
import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

FAREWELL = 0.5  # [s] that a node has to answer what it was asked before it was told to end
LAST = 20       # turns of the executor in which what is answered is sent

# What rclpy raises for arguments, files, names and QoS overrides: RCLError is a RuntimeError.
_UNFIT = (ObcError, RuntimeError, NameValidationException, ParameterException)
PATIENCE = 10.0  # [s] with a node that is leaving the graph
# [s] for others to take in that its topics are gone, one by one, before the node is: what of this
# reaches them after the farewell of its participant makes them list the node for ever.
SETTLE = 0.2
# [s] for each node in the graph, 1 s at most, in which those that are told to end together leave
# one by one: the news of another's leaving is what `limit_leaving` is about.
ROOM = 0.02


@contextmanager
def limit_leaving() -> Iterator[None]:
    """
    End the process with status 1 if a node does not leave the graph.

    Fast DDS never returns if it is just taking in news of another node (docs/reliability.md), and
    it keeps the interpreter's lock: only this timer can end the process then.
    """
    faulthandler.dump_traceback_later(PATIENCE, exit=True, file=2)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()


def run(build: Callable[[], Node]) -> int:
    """
    Build a node, spin it until SIGINT or SIGTERM, and end the process; return 1 if it is unfit.

    Parameters
    ----------
    build : callable
        Returns the node; usually its class.

    """
    with _stopped_by_signals() as stop:
        try:
            choose_profile()
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
            _refuse(remove_ros_args()[1:])
            node = build()
            for service in node.services:  # those of parameters among them
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
                with node.handle:   # what is in use is destroyed after that: the node comes last
                    room = _room(node)
                    node.destroy_node()
                    sleep(SETTLE + uniform(0.0, room))
                rclpy.try_shutdown()
    # Nothing is left to do, and what the libraries do after the interpreter has ended may stand
    # still in the same way.
    for stream in filter(None, (sys.stdout, sys.stderr)):
        with suppress(OSError, ValueError):   # nobody reads any more
            stream.flush()
    os._exit(0)


def _room(node: Node) -> float:
    """Return the time [s] within which a node leaves."""
    try:
        return min(ROOM * len(node.get_node_names()), 1.0)
    except RuntimeError:  # the context was shut down by someone else in this process
        return 0.0


def _refuse(words: list[str]) -> None:
    """Refuse what is no ROS argument: parameters that stand before --ros-args have no effect."""
    if words:
        raise StatementError(f"'{quote(words[0])}' is not understood; parameters are given as in: "
                             '--ros-args -p system:=aircraft --params-file FILE')


class _Stop:
    """Asked for by a signal, at any time; wakes whoever waits."""

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

    A Python handler does not run while the executor waits in C. The byte that the interpreter
    writes on arrival of a signal reaches a thread, and that wakes the executor.
    """
    stop = _Stop()
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    former = signal.set_wakeup_fd(writer)
    handlers = {number: signal.signal(number, lambda *_: None)
                for number in (signal.SIGINT, signal.SIGTERM)}

    def watch() -> None:
        while os.read(reader, 1) not in (b'', b'\0'):  # 0: told to end
            stop.ask()

    thread = threading.Thread(target=watch, name='signals', daemon=True)
    thread.start()
    try:
        yield stop
    finally:
        for number, handler in handlers.items():
            # A launch file asks twice: the second time while the interpreter ends already.
            signal.signal(number, signal.SIG_IGN if stop.asked else handler)
        signal.set_wakeup_fd(former)
        os.write(writer, b'\0')
        thread.join()
        os.close(reader)
        os.close(writer)


def _spin(node: Node, stop: _Stop) -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    # a task, since the executor goes on waiting when it is only woken
    stop.wake = lambda: executor.create_task(lambda: None)
    try:
        while not stop.asked:
            executor.spin_once()
        _answer(node, executor)
    except ExternalShutdownException:
        pass  # the context was shut down by someone else in this process
    finally:
        stop.wake = lambda: None
        executor.shutdown()


def _answer(node: Node, executor: SingleThreadedExecutor) -> None:
    """Let a node that `owes` answers give them before it ends."""
    deadline = monotonic() + FAREWELL
    owes = getattr(node, 'owes', None)
    if not owes:
        return
    owed = owes()
    while owes() and monotonic() < deadline:
        executor.spin_once(timeout_sec=0.02)
    if owes():
        node.get_logger().error(f'ends without all answers: some took over {FAREWELL:g} s')
    for _ in range(LAST):
        executor.spin_once(timeout_sec=0.0)
    if owed:
        # Answers and the news that who gave them is gone are read by two threads: an answer that
        # a busy client reads later is dropped.
        sleep(SETTLE)


def summarize_error(error: Exception) -> str:
    """Return what an error says without the places in rcl's sources and on one line."""
    words = ' '.join(re.sub(r', at /\S+:\d+', '', str(error)).split())
    if 'Sequence should be of same type' in words:
        words += ': write the numbers of a list all with a point, or none'
    if 'log director' in words or 'logging director' in words:
        words += ': set ROS_LOG_DIR to a folder that can be written'
    return words
