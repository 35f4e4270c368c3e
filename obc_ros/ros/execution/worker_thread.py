# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A thread for what takes time, so that no service of a node waits for it.

An async callback of the executor awaits `WorkerThread.run`. Meanwhile the executor serves other
callbacks, such as `~/stop`, if they are of another callback group.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from queue import SimpleQueue
from threading import Thread
from typing import Any

from obc_ros.core.text.errors import ObcError
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.service import Service
from rclpy.task import Future

Work = Callable[[], Any]


class CancelledError(ObcError):
    """A computation was cancelled."""


@dataclass(eq=False)
class _Job:
    work: Work
    is_change: bool
    future: Future = field(default_factory=Future)
    reason: str = ''   # of its cancellation


class WorkerThread:
    """
    One thread that computes in the order of the requests.

    :ivar group: for callbacks that await a result.
    :ivar changes: for those of which one is to end before the next begins.
    """

    def __init__(self, node: Node) -> None:
        self.group, self.changes = ReentrantCallbackGroup(), MutuallyExclusiveCallbackGroup()
        self._jobs: SimpleQueue[_Job | None] = SimpleQueue()
        self._waiting: list[_Job] = []
        self._done: deque[tuple[_Job, Any, BaseException | None]] = deque()
        self._news = node.create_guard_condition(self._deliver, callback_group=self.group)
        self._present: _Job | None = None
        self._thread = Thread(target=self._run, name='desk', daemon=True)
        self._thread.start()

    def move(self, service: Service, group: Any) -> None:
        """Put a service, whose callback may await a result, into a group of this desk."""
        service.callback_group = group
        group.add_entity(service)

    async def run(self, work: Work, is_change: bool = False) -> Any:
        """
        Return the result of a computation, or raise what it raises.

        :param work: runs in the thread. A long one looks at `is_cancelled`.
        :param is_change: whether `cancel` applies to it.
        :raises CancelledError: if it was cancelled.
        """
        job = _Job(work, is_change)
        self._waiting.append(job)
        self._jobs.put(job)
        try:
            result = await job.future
        finally:
            self._waiting.remove(job)
        # A result that is there can be cancelled until the one who awaits it goes on.
        if job.reason:
            raise CancelledError(job.reason)
        return result

    def is_cancelled(self) -> bool:
        """Return whether the present computation is not wanted any more; in the thread."""
        return self._present is not None and bool(self._present.reason)

    def cancel(self, reason: str) -> None:
        """Answer all changes that are not adopted yet with a reason; in the executor."""
        for job in self._waiting:
            if job.is_change:
                job.reason = reason
                self._answer(job, None, CancelledError(reason))

    def close(self) -> None:
        """End the thread after the present computation."""
        for job in self._waiting:
            job.reason = job.reason or 'the node ends'
        self._jobs.put(None)
        self._thread.join()

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            if job.reason:
                continue
            self._present = job
            try:
                self._done.append((job, job.work(), None))
            except BaseException as error:   # it is raised where the result is awaited
                self._done.append((job, None, error))
            self._present = None
            self._news.trigger()

    def _deliver(self) -> None:
        while self._done:
            self._answer(*self._done.popleft())

    def _answer(self, job: _Job, result: Any, error: BaseException | None) -> None:
        if job.future.done():   # cancelled
            return
        if error is None:
            job.future.set_result(result)
        else:
            job.future.set_exception(error)
