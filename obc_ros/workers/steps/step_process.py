# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A process that solves one step of a receding horizon after another.

Started by `step_supervisor.StepLink`:
``python -P -m obc_ros.workers.steps.step_process FD PARENT MODULE PRIORITY``. MODULE offers
``prepare(problem: Packet)``, which returns an object like `receding_steps.RecedingSteps`. The
first packet is the problem; its reply has `ready` or `refused`. Of the requests that wait, the
newest is answered.

The process has its real-time priority once it is prepared: building and compiling must not delay
others.
"""

from contextlib import suppress
import gc
from importlib import import_module
import os
import signal
import sys

from obc_ros.core.text.errors import ObcError
from obc_ros.workers.processes.child_start import connect_to_parent
from obc_ros.workers.processes.real_time import drop_priority, raise_priority
from obc_ros.workers.wire import Channel, Packet


def serve_steps(channel: Channel, module: str, priority: int) -> None:
    """Prepare the first packet, then answer the newest request until the channel is closed."""
    problem = channel.receive()
    assert problem is not None   # it waits for ever
    try:
        answerer = import_module(module).prepare(problem)
    except (ObcError, ArithmeticError) as error:
        channel.send({'refused': str(error)})
        return
    gc.collect()
    gc.freeze()   # a collection with the objects of the start takes a period, 20 ms
    refusal = raise_priority(priority, priority) if priority else ''
    channel.send({'ready': answerer.ready.plain, 'priority': refusal}, answerer.ready.arrays)
    while True:
        request = channel.receive()
        while request is not None and (newer := channel.receive(timeout=0.0)) is not None:
            request = newer
        assert request is not None
        try:
            reply = answerer.answer(request)
        except (ObcError, ArithmeticError) as error:
            reply = Packet({'refused': str(error)})
        asked = {name: request.plain[name] for name in ('id', 'kind')}
        channel.send({**reply.plain, **asked}, reply.arrays)


def main() -> int:
    """Serve the node that has started this process; it ends with the node."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)   # the node ends this process
    channel, (module, priority) = connect_to_parent()
    if int(priority):
        drop_priority()   # that of the thread which has started it
    with suppress(EOFError, BrokenPipeError):   # the node has closed the channel
        serve_steps(channel, module, int(priority))
    os._exit(0)   # without the destructors of CasADi: nothing is left to keep


if __name__ == '__main__':
    sys.exit(main())
