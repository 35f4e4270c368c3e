# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""One process that solves steps, seen from the node."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
import itertools
import time
from typing import Any

from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import ObcError
from obc_ros.workers.processes.supervised_process import SupervisedProcess
from obc_ros.workers.wire import Packet

SEND = 0.005   # [s] that a request may take to be sent: the process reads at once, or is stopped
LOOK_AGAIN = 0.05    # [s] between two looks whether a reply is still wanted


class StepLink(SupervisedProcess):
    """
    A process with a prepared problem.

    One thread sends and one receives. Both use finite times, because the socket has one mode.

    :param module: module of the process that prepares the problem.
    :param priority: real-time priority of the process once it is prepared; 0: none.
    :ivar ready: reply of the process when it is prepared.
    :ivar priority_refusal: why the system does not allow the priority; empty before `ready`, and
        if it does.
    :ivar is_broken: whether a request was sent in part: the process cannot read another one.
    :raises ObcError: on Windows.
    :raises OSError: if the system starts no process, or it ends at once.
    """

    def __init__(self, module: str, problem: Packet, priority: int = 0) -> None:
        super().__init__('obc_ros.workers.steps.step_process', module, str(priority))
        self.module, self.problem, self.priority = module, problem, priority
        self.ready: Packet | None = None
        self.priority_refusal = ''
        self.is_broken = False
        self._ids = itertools.count(1)
        with ExitStack() as undo:
            undo.callback(self.close)
            self.channel.send(problem.plain, problem.arrays, timeout=1.0)
            undo.pop_all()

    def wait_until_ready(self, timeout: float,
                         is_cancelled: Callable[[], bool] = lambda: False) -> Packet:
        """
        Return the reply of the prepared process.

        :raises ObcError: if it refuses the problem, has ended, is not ready within `timeout`
            seconds, or is not wanted any more.
        """
        while self.ready is None:
            self.look(self._wait_for(lambda _: True, timeout, is_cancelled,
                                     f'is not ready after {timeout:g} s'))
        return self.ready

    def look(self, packet: Packet) -> None:
        """Take the reply to the problem; ObcError: it is refused."""
        if 'refused' in packet.plain:
            raise ObcError(str(packet.plain['refused']))
        if 'ready' in packet.plain:
            self.priority_refusal = str(packet.plain['priority'])
            self.ready = Packet(packet.plain['ready'], packet.arrays)

    def send(self, plain: Mapping[str, Any], arrays: Mapping[str, Array]) -> int:
        """Send a request; return its id, 0 if it could not be sent."""
        if self.is_broken:
            return 0
        number = next(self._ids)
        try:
            self.channel.send({**plain, 'id': number}, arrays, timeout=SEND)
        except OSError:   # stopped or ended
            self.is_broken = True
            return 0
        return number

    def call(self, plain: Mapping[str, Any], arrays: Mapping[str, Array], timeout: float,
             is_cancelled: Callable[[], bool] = lambda: False) -> Packet:
        """
        Send a request and return its reply.

        :raises ObcError: if the reply is a refusal or does not arrive, or is not wanted any more.
        """
        number = self.send(plain, arrays)
        packet = self._wait_for(lambda packet: packet.plain.get('id') == number, timeout,
                                is_cancelled, f'has not answered within {timeout:g} s')
        if 'refused' in packet.plain:
            raise ObcError(str(packet.plain['refused']))
        return packet

    def _wait_for(self, is_wanted: Callable[[Packet], bool], timeout: float,
                  is_cancelled: Callable[[], bool], delay: str) -> Packet:
        """Return the next wanted packet; ObcError: there is none, or no need of it any more."""
        end = time.monotonic() + timeout
        while (left := end - time.monotonic()) > 0.0:
            if is_cancelled():
                raise ObcError('cancelled')
            try:
                packet = self.channel.receive(min(left, LOOK_AGAIN))
            except EOFError:
                raise ObcError(f'the solver process {self.describe_end()}') from None
            if packet is not None and is_wanted(packet):
                return packet
        raise ObcError(f'the solver process {delay}')
