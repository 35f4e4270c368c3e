# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The action of one server, which works on problems."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from action_msgs.msg import GoalStatus
from obc_ros.action import SolveOptimalControl
from obc_ros.cli.ask.batch import Batch, Question
from obc_ros.cli.client import Client, connect_client
from obc_ros.cli.terminal import Lines, show_progress
from obc_ros.core.text.errors import DynamicsError, StatementError
from obc_ros.ros.messages import build_problem_message, read_solution


def answer_by_server(server: str, asked: Sequence[Question], time_limit: float) -> None:
    """
    Have a server, '' for any, solve problems; each has a status, also after an error.

    :param time_limit: of each problem [s]; 0: that of the server.
    """
    with show_progress() as lines:
        if messages := dict(_build_messages(asked, time_limit, lines)):
            with connect_client(server) as client:
                ServerBatch(client, messages, lines).work()


def _build_messages(asked: Sequence[Question], time_limit: float, lines: Lines
                    ) -> Iterator[tuple[Question, Any]]:
    for question in asked:
        try:
            problem = question.build_problem()
            yield question, SolveOptimalControl.Goal(
                problem=build_problem_message(problem.statement, problem.guess),
                method=question.method or problem.method,
                accept=question.accept or problem.accept, time_limit=time_limit,
                options=list(question.options))
        except (StatementError, DynamicsError) as error:
            question.end('malformed', str(error))
            lines.end(question.label)


@dataclass
class Goal:
    """The futures of a goal and of its result."""

    sent: Any
    handle: Any = None
    result: Any = None
    is_cancelled: bool = False


class ServerBatch(Batch):
    """Problems that one server solves."""

    def __init__(self, client: Client, messages: Mapping[Question, Any], lines: Lines) -> None:
        super().__init__(list(messages), lines)
        self._client, self._messages = client, messages
        self._goals: dict[Question, Goal] = {}
        self._action = client.action()
        self._workers: int = client.parameter('workers')

    def work(self) -> None:
        """Have the server solve all problems."""
        try:
            super().work()
        finally:
            self._action.destroy()

    def count_workers(self) -> int:
        """Return the number of workers of the server."""
        return self._workers

    def send(self, entry: Question) -> None:
        """Send a problem as a goal."""
        def report(message: Any) -> None:
            self.report(entry, message.feedback.phase)

        self._goals[entry] = Goal(self._action.send_goal_async(
            self._messages[entry], report))

    def wait(self, check: bool = True) -> None:
        """Spin until a problem has a result; without `check`, for one event."""
        if check:
            self._client.wait(self._advance, self._action.server_is_ready)
        else:
            self._client.spin(check=False)
            self._advance()

    def cancel(self, entry: Question) -> None:
        """Cancel the goal of a problem, once the server has accepted it."""
        goal = self._goals[entry]
        if goal.handle and not goal.is_cancelled:
            goal.is_cancelled = True
            goal.handle.cancel_goal_async()

    def _advance(self) -> bool:
        """Process what has arrived; return whether a problem has ended."""
        ended = [entry for entry in self._begun if self._has_ended(entry, self._goals[entry])]
        for entry in ended:
            self.finish(entry)
        return bool(ended)

    def _has_ended(self, entry: Question, goal: Goal) -> bool:
        if goal.handle is None and goal.sent.done():
            goal.handle = goal.sent.result()
            if goal.handle.accepted:
                goal.result = goal.handle.get_result_async()
            else:
                entry.end('not_converged', 'the server rejected the request')
        if goal.result and goal.result.done():
            found = goal.result.result()
            if found.status == GoalStatus.STATUS_UNKNOWN:
                entry.end('not_converged', 'the server lost the request')
            else:
                path = found.result.trajectory
                entry.take_solution(
                    read_solution(found.result), path.state_names, path.input_names)
        return bool(entry.status)
