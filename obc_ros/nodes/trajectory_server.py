# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Node trajectory_server: solves optimal control problems on request, with a certificate.

Topics, services and the action: docs/interfaces.md. Parameters: see `Settings`.

Worker processes solve the problems, so that the node always responds.
"""

from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
import math
import sys
from time import monotonic
from types import MappingProxyType
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from obc_ros.action import SolveOptimalControl as SolveAction
from obc_ros.core.ocp.solution import MAX_INTERVALS
from obc_ros.core.text.errors import ObcError, quote, StatementError
from obc_ros.nodes.motions.motion_requests import MotionRequests, state_plan
from obc_ros.nodes.motions.present_state import load_plants
from obc_ros.nodes.views.plan_view import PlanView
from obc_ros.ros import messages
from obc_ros.ros.diagnostics import Diagnostics, make_status
from obc_ros.ros.execution.callback_guards import guard_callbacks
from obc_ros.ros.execution.executor import run
from obc_ros.ros.parameters.node_parameters import declare_field, Parameters
from obc_ros.ros.service_qos import be_patient, BURST, STEADY
from obc_ros.ros.state_sources import SOURCES, STATE_SOURCE
from obc_ros.ros.throttled_log import ThrottledLog
from obc_ros.srv import DesignLqr, Minimize, PlanMotion, SolveOptimalControl
from obc_ros.sweep.cluster.connection import check_address, explain_exposure, has_dask
from obc_ros.sweep.cluster.requests_on_cluster import ClusterPool
from obc_ros.workers.pool import (
    Job,
    LONGEST_LIMIT,
    Pool,
    RequestAnswer,
    RequestOutcome,
    SHORTEST,
    TIME_LIMIT,
)
from obc_ros.workers.responses import compute_affinity, respond
from obc_ros.workers.wire import Packet
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future

ANSWERS = 'obc_ros.workers.requests'
START, LOOK = 10.0, 0.02  # [s] maximum wait of the services for the workers, and its step
RESULT_TIMEOUT = 30  # [s] time for which the result of an action is kept
QUICK = 2_500        # numbers in A up to which a design has a worker of its own

Progress = Callable[[str, int, float, float], None]


@dataclass(frozen=True)
class Settings:
    """The parameters of the node."""

    workers: int = declare_field(2, 'number of solver processes', lower=1, upper=64)
    time_limit: float = declare_field(
        TIME_LIMIT, 'maximum time from a request to its response', 's', lower=SHORTEST,
        upper=LONGEST_LIMIT)
    max_intervals: int = declare_field(
        MAX_INTERVALS, 'maximum number of mesh intervals of a solution', lower=10, upper=100_000)
    cache_size: int = declare_field(
        32, 'number of problem structures whose solvers each worker keeps', lower=1, upper=10_000)
    queue_length: int = declare_field(
        128, 'maximum number of waiting requests; others are rejected', lower=0, upper=10_000)
    scheduler: str = declare_field(
        '', 'address of a Dask scheduler, such as tls://host:8786, whose workers solve the '
        'requests and may run programs in this node: read at the start; empty: the processes of '
        'this node', read_only=True)
    hardware_id: str = declare_field(
        '', 'hardware_id of the diagnostics; empty: the namespace, or else the name of the node')
    state_timeout: float = declare_field(
        0.5, 'maximum age of the state at which a plan may begin', 's', lower=1e-3)
    plan_lead: float = declare_field(
        0.5, 'time from a plan to its beginning, in which lqr_node computes its gains; where the '
        'plant moves, the time that such a plan took before is added before it is computed', 's',
        lower=0.0, upper=60.0)
    execute_feasible: bool = declare_field(
        False, 'true: ~/plan also executes plans that meet all constraints and have no '
        'certificate of optimality')
    systems: tuple[str, ...] = declare_field(
        (), 'YAML files of plants that ~/plan plans for by their names, besides the registered '
        'systems; read at the start', texts=True, read_only=True)
    state_source: str = declare_field(
        'state', STATE_SOURCE, choices=tuple(SOURCES), read_only=True)
    markers: bool = declare_field(
        True, 'true: publish the path, goal and obstacles of the last plan if somebody subscribes')


class TrajectoryServer(Node):  # type: ignore[misc] # rclpy's classes are untyped
    """The node; see the module's text."""

    _pools: tuple[Pool, ...] = ()  # until the parameters are accepted

    def __init__(self, **options: Any) -> None:
        super().__init__('trajectory_server', allow_undeclared_parameters=True, **options)
        self._settings = Parameters(self, Settings, _judge, self._adopt)
        self._solvers = self._find_solvers(self._settings.settings.scheduler)
        self._designers = Pool(ANSWERS, 1, niceness=0)  # short designs do not wait for solves
        self._pools = self._solvers, self._designers
        self._view = PlanView(self)
        self._adopt(self._settings.settings)
        self._jobs: dict[bytes, tuple[Any, Job]] = {}   # with their pools
        self._asked = 0
        self._arrived: deque[tuple[Future, RequestAnswer]] = deque()
        self._statuses: Counter[str] = Counter()
        self._log = ThrottledLog(self)
        self._motions = MotionRequests(
            self, self._settings.settings.state_source, self._log, partial(self._ask, 'plan'))
        self._diagnostics = Diagnostics(self)
        self.create_timer(1.0, self._diagnose, clock=STEADY)
        self._action: ActionServer | None = None
        self._latest = monotonic() + START
        self._opening = self.create_timer(LOOK, self._open, clock=STEADY)

    def _open(self) -> None:
        """Create the services once the workers run, so that the first responses are in time."""
        if monotonic() < self._latest and not all(pool.has_started for pool in self._pools):
            return
        self.destroy_timer(self._opening)
        group = ReentrantCallbackGroup()  # a waiting request must not block others
        self._arrival = self.create_guard_condition(self._take_arrived, callback_group=group)
        for service, name, callback in (
                (SolveOptimalControl, '~/solve', self._solve),
                (DesignLqr, '~/design_lqr', self._design_lqr),
                (Minimize, '~/minimize', self._minimize),
                (PlanMotion, '~/plan', self._plan)):
            offered = self.create_service(
                service, name, callback, qos_profile=BURST, callback_group=group)
            be_patient(self, offered)
            guard_callbacks(self, offered, offered.srv_name)
        self._action = ActionServer(
            self, SolveAction, '~/solve_optimal_control', self._execute, callback_group=group,
            cancel_callback=self._cancel, result_timeout=RESULT_TIMEOUT,
            goal_service_qos_profile=BURST, result_service_qos_profile=BURST,
            cancel_service_qos_profile=BURST, feedback_pub_qos_profile=BURST)
        settings = self._settings.settings
        noun = 'process' if settings.workers == 1 else 'processes'
        self.get_logger().info(
            f'ready: {settings.workers} worker {noun}, queue of {settings.queue_length} requests')

    def owes(self) -> bool:
        """Cancel all requests without a response; return whether there are any."""
        for pool in self._pools:
            pool.close()
        return self._asked > 0

    def destroy_node(self) -> None:
        """End the workers, then the node."""
        for pool in self._pools:
            pool.close()
        if self._pools and self._action:
            self._action.destroy()
        super().destroy_node()

    async def _solve(self, request: Any, response: Any) -> Any:
        messages.fill_answer(response, await self._ask('solve', request, request.time_limit))
        if response.success:
            self._view.show(response.trajectory, partial(messages.read_statement, request.problem))
        return response

    async def _minimize(self, request: Any, response: Any) -> Any:
        messages.fill_minimum(response, await self._ask('minimize', request, request.time_limit))
        return response

    async def _design_lqr(self, request: Any, response: Any) -> Any:
        messages.fill_design(response, await self._ask('design_lqr', request))
        return response

    async def _plan(self, request: Any, response: Any) -> Any:
        try:
            await self._motions.answer(
                request, response, self._settings.settings,
                min(self._limit(request.time_limit), self._limit(request.deadline, 'deadline')))
        except ObcError as error:
            messages.fill_answer(response, self._refuse('plan', error))
        if response.success:
            self._view.show(response.trajectory, partial(
                state_plan, request, self._settings.settings.systems))
        return response

    async def _execute(self, goal: Any) -> Any:
        """Execute a goal of the action; it succeeds only with an answer that it accepts."""
        begun = self.get_clock().now()

        def progress(phase: str, iteration: int, cost: float, infeasibility: float) -> None:
            goal.publish_feedback(SolveAction.Feedback(
                phase=phase, iteration=iteration, cost=cost, infeasibility=infeasibility,
                elapsed=(self.get_clock().now() - begun).nanoseconds * 1e-9))

        progress('queued', 0, math.nan, math.nan)
        result = SolveAction.Result()
        messages.fill_answer(result, await self._ask(
            'solve', goal.request, goal.request.time_limit, progress=progress, goal=goal))
        if result.success:
            self._view.show(
                result.trajectory, partial(messages.read_statement, goal.request.problem))
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return result

    def _cancel(self, goal: Any) -> CancelResponse:
        if bytes(goal.goal_id.uuid) in self._jobs:
            pool, job = self._jobs[bytes(goal.goal_id.uuid)]
            pool.cancel(job)
        return CancelResponse.ACCEPT

    async def _ask(self, kind: str, request: Any, time_limit: float = 0.0,
                   more: Mapping[str, Any] = MappingProxyType({}),
                   progress: Progress = lambda *_: None, goal: Any = None) -> Packet:
        """Return the response of a worker to a request, or the reason for its absence."""
        try:
            packet = messages.read_request(kind, request)
            limit = self._limit(time_limit)
        except StatementError as error:
            return self._refuse(kind, error)
        settings = self._settings.settings
        packet.plain.update(
            more, cache_size=settings.cache_size, max_intervals=settings.max_intervals)
        future: Future = Future()
        job = Job(
            kind=kind, request=packet, time_limit=limit,
            done=lambda answer: self._deliver(future, answer), progress=progress,
            affinity=compute_affinity(packet))
        quick = kind == 'design_lqr' and len(request.a) <= QUICK
        pool = self._designers if quick else self._solvers
        pool.submit(job)
        if goal:
            key = bytes(goal.goal_id.uuid)
            self._jobs[key] = pool, job
            if goal.is_cancel_requested:  # before the job existed
                pool.cancel(job)
        self._asked += 1
        answer: RequestAnswer = await future
        self._asked -= 1
        if goal:
            del self._jobs[key]
        response = respond(answer)
        if answer.outcome is RequestOutcome.DIED:
            self.get_logger().error(answer.message)
        elif answer.outcome is RequestOutcome.REFUSED or (
                response.plain['status'] in ('malformed', 'refused')):
            self._log_refusal(kind, response.plain['message'])
        self._statuses[response.plain['status']] += 1
        return response

    def _limit(self, time_limit: float, name: str = 'time_limit') -> float:
        if not time_limit >= 0.0:
            raise StatementError(f'{name} = {time_limit:g}: wanted seconds, or 0 for the '
                                 "server's own limit")
        return min(time_limit or math.inf, self._settings.settings.time_limit)

    def _deliver(self, future: Future, answer: RequestAnswer) -> None:
        self._arrived.append((future, answer))
        self._arrival.trigger()

    def _take_arrived(self) -> None:
        while self._arrived:
            future, answer = self._arrived.popleft()
            future.set_result(answer)

    def _refuse(self, kind: str, error: ObcError) -> Packet:
        self._log_refusal(kind, str(error))
        self._statuses['malformed'] += 1
        return Packet({'status': 'malformed', 'message': str(error)})

    def _log_refusal(self, kind: str, reason: str) -> None:
        self._log.warning('refused', f'a request to ~/{kind} was rejected: {quote(reason, 500)}')

    def _adopt(self, settings: Settings) -> None:
        self._view.is_shown = settings.markers
        self._solvers.queue_length = settings.queue_length
        self._solvers.affinities = settings.cache_size
        self._solvers.resize(settings.workers)

    def _find_solvers(self, scheduler: str) -> Pool:
        if not scheduler:
            return Pool(ANSWERS, 0)
        if exposure := explain_exposure(scheduler):
            self.get_logger().warning(exposure)
        return ClusterPool(scheduler, ANSWERS, 0, self._tell)

    def _tell(self, sentence: str, good: bool) -> None:
        if good:
            self.get_logger().info(quote(sentence, 500))
        else:   # rclpy wants a severity of its own at each place
            self.get_logger().warning(quote(sentence, 500))

    def _diagnose(self) -> None:
        pool = self._solvers
        replaced = pool.replaced + self._designers.replaced
        status = make_status(
            f'{self.get_fully_qualified_name()[1:]}: workers', DiagnosticStatus.OK,
            f'{pool.busy} of {pool.size} workers are busy, {pool.waiting} requests wait', {
                'queue': pool.waiting, 'queue length': pool.queue_length, 'busy': pool.busy,
                'workers': pool.size, 'workers replaced': replaced,
                'requests': self._statuses.total(),
                **{f'requests {name}': count for name, count in sorted(self._statuses.items())}})
        if fault := pool.fault or self._designers.fault:
            status.level = DiagnosticStatus.ERROR
            status.message += f'; no worker starts: {fault}'
        elif len(pool.pids) < pool.size:
            if replaced:   # the first start of a worker is no fault
                status.level = DiagnosticStatus.WARN
            status.message += f'; {pool.size - len(pool.pids)} workers are being started'
        if isinstance(pool, ClusterPool) and pool.absence:
            status.level = max(status.level, DiagnosticStatus.WARN)
            status.message += f'; the cluster {pool.address} cannot be used: {pool.absence}'
        elif isinstance(pool, ClusterPool):
            status.message += (f'; {pool.sent} requests are on the cluster {pool.address}, '
                               f'{pool.threads} threads')
        if pool.waiting >= pool.queue_length:
            status.level = max(status.level, DiagnosticStatus.WARN)
            status.message += '; the queue is full'
        self._diagnostics.publish([status], self.get_clock().now().to_msg(),
                                  self._settings.settings.hardware_id, self.get_name())


def _judge(settings: Settings) -> Settings:
    """Return the settings; raise ObcError if the scheduler or a system cannot be used."""
    load_plants(settings.systems)
    if settings.scheduler:
        check_address(settings.scheduler)
        if not has_dask():
            raise StatementError('scheduler: Dask is missing: pip install distributed')
    return settings


def main() -> int:
    """Run the node until SIGINT or SIGTERM."""
    return run(TrajectoryServer)


if __name__ == '__main__':
    sys.exit(main())
