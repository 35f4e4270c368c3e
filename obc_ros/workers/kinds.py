# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The kinds of requests, and how a worker answers one.

Requests are not trusted: an invalid one is answered with the status ``malformed``, and any other
fault ends the worker only.
"""

from collections.abc import Callable, Mapping

from obc_ros.core.ocp.solution import Report
from obc_ros.core.text.errors import ObcError, StatementError
from obc_ros.workers.wire import Packet

Keep = Callable[[Packet], None]
Handler = Callable[[Packet, float, Report, Keep], Packet]
Answering = Callable[[str, Packet, float, Report, Keep], Packet]


def answer_by(handlers: Mapping[str, Handler]) -> Answering:
    """
    Return the function `answer` of a module that a pool's workers import.

    :param handlers: by kind, what makes the answer of a request, a time limit [s], `report` and
        `keep`. It calls `keep` with the best path so far, packed as an answer, or with a part of
        an answer, whenever that changes.
    :return: ``answer(kind, request, time_limit, report, keep) -> Packet``. The status of an
        invalid request is ``malformed``.
    """
    def answer(kind: str, request: Packet, time_limit: float, report: Report,
               keep: Keep = _forget) -> Packet:
        try:
            if kind not in handlers:
                raise StatementError(f'{kind}: there is no such kind of request')
            return handlers[kind](request, time_limit, report, keep)
        except ObcError as error:
            return Packet({'status': 'malformed', 'message': str(error)})

    return answer


def _forget(path: Packet) -> None:
    """Ignore a path."""
