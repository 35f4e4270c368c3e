# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Send problems to the action of one server, as many at once as it has workers."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
import math
import time
from typing import Any

from action_msgs.msg import GoalStatus
from obc_ros.action import SolveOptimalControl
from obc_ros.cli.ask.problem_requests import Question
from obc_ros.cli.client import Client
from obc_ros.cli.processes import InterruptedByUserError
from obc_ros.cli.terminal import Lines
from obc_ros.ros.messages import build_problem_message

CANCEL = 2.0  # [s] to wait for the results of cancelled requests


@dataclass
class PendingRequest:
    """A problem sent to the server, with the futures of its goal and of its result."""

    question: Question
    begun: float
    sent: Any
    goal: Any = None
    answer: Any = None

    def advance(self) -> bool:
        """Process what has arrived; return whether the problem has ended."""
        if self.goal is None and self.sent.done():
            self.goal = self.sent.result()
            if self.goal.accepted:
                self.answer = self.goal.get_result_async()
            else:
                self.question.end('not_converged', 'the server rejected the request')
        if self.answer and self.answer.done():
            self._take(self.answer.result())
        return bool(self.question.status)

    def _take(self, answer: Any) -> None:
        self.question.took = time.monotonic() - self.begun
        if answer.status == GoalStatus.STATUS_UNKNOWN:
            self.question.end('not_converged', 'the server lost the request')
        else:
            self.question.result = answer.result
            self.question.end(answer.result.status, answer.result.message)


class RequestBatch:
    """Problems that one server solves."""

    def __init__(self, client: Client, questions: Sequence[Question], time_limit: float,
                 lines: Lines, method: str = '', options: Sequence[str] = ()) -> None:
        self._client = client
        self._waiting = deque(questions)
        self._time_limit, self._method, self._options = time_limit, method, list(options)
        self._lines = lines
        self._flights: list[PendingRequest] = []
        self._action = client.action()

    def work(self) -> None:
        """Send all problems and wait for the results; cancel those under way when interrupted."""
        abreast = self._client.parameter('workers')
        try:
            while self._waiting or self._flights:
                while self._waiting and len(self._flights) < abreast:
                    self._send(self._waiting.popleft())
                self._client.wait(self._advance, self._action.server_is_ready)
        except InterruptedByUserError:
            self._cancel()
            raise
        finally:
            self._action.destroy()

    def _send(self, question: Question) -> None:
        goal = SolveOptimalControl.Goal(
            problem=build_problem_message(question.mapping, question.problem.guess),
            method=self._method or question.problem.method, time_limit=self._time_limit,
            options=self._options)
        self._lines.update(question.label, 'sent')
        self._flights.append(
            PendingRequest(question, time.monotonic(), self._action.send_goal_async(
            goal, lambda message: self._report(question, message.feedback))))

    def _report(self, question: Question, feedback: Any) -> None:
        numbers = (('cost', feedback.cost), ('infeasibility', feedback.infeasibility))
        self._lines.update(question.label, ', '.join(
            [feedback.phase, f'iteration {feedback.iteration}',
             *(f'{name} {value:.4g}' for name, value in numbers if not math.isnan(value))]))

    def _advance(self) -> bool:
        """Process what has arrived; return whether a problem has ended."""
        done = [flight for flight in self._flights if flight.advance()]
        for flight in done:
            self._flights.remove(flight)
            self._lines.end(flight.question.label,
                            f'{flight.question.status}, {flight.question.message}')
        return bool(done)

    def _cancel(self) -> None:
        """Cancel the requests under way, and wait at most `CANCEL` seconds for their results."""
        asked: set[int] = set()
        deadline = time.monotonic() + CANCEL
        while self._flights and time.monotonic() < deadline:
            for flight in self._flights:
                if flight.goal and id(flight) not in asked:
                    asked.add(id(flight))
                    flight.goal.cancel_goal_async()
            self._client.spin(check=False)
            self._advance()
