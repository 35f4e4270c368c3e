# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The trajectory server over DDS: responses, time limits, faults and refusals."""

from array import array
from collections.abc import Iterator
import os
from pathlib import Path
import resource
import signal
import time

import _endless  # of benchmarks/
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from obc_ros.action import SolveOptimalControl as SolveAction
from obc_ros.cli.processes import reserve_domain
from obc_ros.core.ocp.statement import build_problem
from obc_ros.msg import (
    InitialGuess,
    LqrWeights,
    NamedBounds,
    NamedExpression,
    NamedValues,
    OptimalControlProblem,
)
from obc_ros.ros.messages import build_problem_message
from obc_ros.srv import DesignLqr, SolveOptimalControl
from probes import Probe
import problems
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from support import alive, children, Spawner

pytestmark = pytest.mark.nodes

SERVER = '/trajectory_server'
SOLVE = f'{SERVER}/solve'
ACTION = f'{SERVER}/solve_optimal_control'
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
PROMISE = 0.2  # [s] documented tolerance of time limits and cancelling
SLACK = 0.15   # [s] for DDS and a busy machine


def message(mapping):
    """Return a statement as a message."""
    return build_problem_message(mapping, build_problem(mapping).guess)


def scalar(a=1.0, T=1.0):
    """Return Example 2.2 as a message, and its cost."""
    mapping = {
        'name': 'scalar', 'states': ['x'], 'inputs': ['u'], 'parameters': {'a': a},
        'dynamics': {'x': 'a*x + u'}, 'running_cost': 'u**2/2', 'terminal_cost': 'x**2/2',
        'initial_state': {'x': 1}, 'final_time': {'free': False, 'value': T}}
    grown = np.exp(2 * a * T)
    return message(mapping), a * grown / (2 * a - 1 + grown)


def endless(n=12):
    """Return a problem that no solver has solved within minutes."""
    return message(_endless.endless(n))


@pytest.fixture
def server(spawn, probe):
    """Return a function that starts a server and waits until it has solved a problem."""
    def start(**parameters):
        process = spawn('trajectory_server', parameters)
        assert solve(probe, scalar()[0]).status == 'solved'
        return process
    return start


@pytest.fixture(scope='module')
def standing(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Probe]:
    """Yield a probe beside a server with one worker, for the tests that leave it ready."""
    with reserve_domain() as domain:
        spawner, probe = Spawner(tmp_path_factory.mktemp('server'), domain), Probe(domain)
        spawner('trajectory_server', {'workers': 1})
        assert solve(probe, scalar()[0]).status == 'solved'
        yield probe
        assert solve(probe, scalar()[0]).status == 'solved'
        probe.close()
        assert not spawner.end()


def solve(probe, problem, **options):
    """Return the response of ``~/solve``."""
    request = SolveOptimalControl.Request(problem=problem, **options)
    return probe.call(SolveOptimalControl, SOLVE, request, timeout=60.0)


def timed(probe, problem, **options):
    """Return the response of ``~/solve``, and the times of request and response."""
    client = probe.node.create_client(SolveOptimalControl, SOLVE)
    probe.wait_for(client.service_is_ready)
    begun = time.monotonic()
    future = client.call_async(SolveOptimalControl.Request(problem=problem, **options))
    probe.wait_for(future.done, 60.0)
    end = time.monotonic()
    probe.node.destroy_client(client)
    return future.result(), begun, end


class Goals:
    """Goals of the action, with their feedback."""

    def __init__(self, probe):
        self.probe, self.handles, self.feedback = probe, [], []

    def send(self, problem, **options):
        """Send a goal; return its number."""
        received = []
        self.handles.append(self.probe.send_goal(
            SolveAction, ACTION, SolveAction.Goal(problem=problem, **options),
            lambda message: received.append(message.feedback)))
        self.feedback.append(received)
        assert self.handles[-1].accepted
        return len(self.handles) - 1

    def wait_until_solving(self, number):
        """Wait until a worker processes a goal."""
        self.probe.wait_for(
            lambda: any(each.phase != 'queued' for each in self.feedback[number]),
            what=f'progress of goal {number}')

    def cancel(self):
        """Cancel all goals; return their results, and the times of request and results."""
        begun = time.monotonic()
        for handle in self.handles:
            handle.cancel_goal_async()
        futures = [handle.get_result_async() for handle in self.handles]
        self.probe.wait_for(lambda: all(future.done() for future in futures), what='results')
        return [future.result() for future in futures], begun, time.monotonic()


def values(array):
    """Return the values of a diagnostics message as a mapping."""
    [status] = array.status
    return {each.key: each.value for each in status.values}


def test_the_server_logs_its_workers_and_queue(spawn):
    """The log line comes without any request."""
    spawn('trajectory_server', {'workers': 1, 'queue_length': 7}).wait_for_output(
        'ready: 1 worker process, queue of 7 requests')


def test_diagnostics_have_the_namespace_and_need_no_clock(spawn, probe):
    spawn('trajectory_server', {'workers': 1, 'use_sim_time': True}, namespace='/robot1')
    diagnostics = probe.listen(DiagnosticArray, '/diagnostics')
    probe.wait_for(lambda: diagnostics)
    assert diagnostics[0].status[0].name == 'robot1/trajectory_server: workers'


@pytest.mark.parametrize('name', ['lq_scalar_unit', 'moon_lander', 'two_wheel_turn_in_place'])
def test_a_response_has_the_certified_trajectory(standing, name):
    mapping = problems.read(name)
    response = solve(standing, message(mapping))
    assert response.status == 'solved', response.message
    assert response.success
    assert response.certificate.holds, response.certificate.sentence
    expected = mapping['expected']
    assert response.objective == pytest.approx(expected['objective'], abs=expected['tolerance'])
    path = response.trajectory
    assert path.state_names == mapping['states']
    assert path.input_names == mapping['inputs']
    assert len(path.x) == len(path.lam) == len(path.t) * len(mapping['states'])
    assert len(path.u) == len(path.t) * len(mapping['inputs'])
    assert len(path.hamiltonian) == len(path.t)


def test_programs_are_cached_by_structure(standing):

    def build_time(a):
        response = solve(standing, message({
            'states': ['x'], 'inputs': ['u'], 'parameters': {'a': a},
            'dynamics': {'x': 'u - a*x**3'}, 'running_cost': 'x**2 + u**2',
            'initial_state': {'x': a}, 'final_time': {'free': False, 'value': 1 + a}}))
        assert response.status == 'solved'
        return response.build_time

    assert build_time(1.0) > 0.0
    assert build_time(1.001) == 0.0  # cached: numbers are not part of the structure


def test_max_intervals_bounds_the_mesh(server, probe):
    server(workers=1, max_intervals=10)
    mapping = problems.read('vanderpol_bounded')
    coarse = solve(probe, message(mapping))
    assert coarse.status == 'not_converged'
    assert 'max_intervals = 10' in coarse.message
    assert probe.set_parameters(SERVER, max_intervals=200)[0].successful
    assert solve(probe, message(mapping)).status == 'solved'


def test_other_requests_are_answered_while_all_workers_solve(standing, clock):
    diagnostics = standing.listen(DiagnosticArray, '/diagnostics')
    goals = Goals(standing)
    goals.wait_until_solving(goals.send(endless()))
    begun = time.monotonic()
    assert standing.get_parameters(SERVER, 'workers') == {'workers': 1}
    assert standing.call(DesignLqr, f'{SERVER}/design_lqr', DesignLqr.Request(
        a=[0.0, 1.0, 0.0, 0.0], b=[0.0, 1.0],
        weights=LqrWeights(qx=[1.0, 0.0], qu=[1.0]))).success
    assert solve(standing, OptimalControlProblem(), time_limit=0.3).status == 'timed_out'
    assert clock.since(begun) < 2.0
    standing.wait_for(lambda: diagnostics and values(diagnostics[-1])['busy'] == '1')
    goals.cancel()


def test_cancel_stops_a_solve(standing, clock):
    goals = Goals(standing)
    goals.wait_until_solving(goals.send(endless(60)))  # with long iterations
    goals.send(endless())  # queued
    answers, begun, end = goals.cancel()
    assert clock.between(begun, end) < PROMISE + SLACK
    assert [answer.status for answer in answers] == [GoalStatus.STATUS_CANCELED] * 2
    assert [answer.result.status for answer in answers] == ['cancelled'] * 2
    assert goals.feedback[0][0].phase == 'queued'
    assert solve(standing, scalar()[0]).status == 'solved'


def test_feedback_has_the_elapsed_time(standing):
    goals = Goals(standing)
    number = goals.send(message(problems.read('vanderpol_bounded')))
    answer = standing.result(goals.handles[number])
    assert answer.status == GoalStatus.STATUS_SUCCEEDED
    assert answer.result.success
    elapsed = [each.elapsed for each in goals.feedback[number]]
    assert len(elapsed) >= 2
    assert elapsed == sorted(elapsed)


def test_the_first_path_is_an_answer_if_that_is_asked_for(standing):
    """No input attains the infimum -1 of the integral of x^2 - u^2: there is no certificate."""
    response = solve(standing, message({
        'name': 'chattering', 'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u'},
        'running_cost': 'x**2 - u**2', 'input_bounds': {'u': [-1, 1]}, 'initial_state': {'x': 0},
        'final_time': {'free': False, 'value': 1}}), accept='path')
    assert (response.success, response.status) == (True, 'feasible')
    assert 'no certificate of optimality' in response.message
    assert 0.0 <= response.objective + 1.0 <= response.certificate.excess
    assert 0.0 < response.first_path_time <= response.build_time + response.solve_time
    refused = solve(standing, scalar()[0], accept='paths')
    assert (refused.success, refused.status) == (False, 'malformed')
    assert refused.message.startswith("accept: 'paths' is unknown")
    assert np.isnan(refused.first_path_time)


@pytest.mark.parametrize('n', [12, 60])
def test_the_time_limit_is_kept(standing, clock, n):
    response, begun, end = timed(standing, endless(n), time_limit=1.0)
    assert response.status == 'timed_out'
    assert not response.success
    assert end - begun > 1.0 - PROMISE
    assert clock.between(begun + 1.0, end) < PROMISE + SLACK
    assert solve(standing, scalar()[0]).status == 'solved'


def test_a_killed_worker_loses_one_request(server, probe):
    process = server(workers=1)
    diagnostics = probe.listen(DiagnosticArray, '/diagnostics')
    goals = Goals(probe)
    goals.wait_until_solving(goals.send(endless()))
    for pid in children(process.pid):
        os.kill(pid, signal.SIGKILL)
    answer = probe.result(goals.handles[0])
    assert answer.status == GoalStatus.STATUS_ABORTED
    assert answer.result.status == 'not_converged'
    assert 'SIGKILL' in answer.result.message
    assert solve(probe, scalar()[0]).status == 'solved'
    probe.wait_for(lambda: diagnostics and int(values(diagnostics[-1])['workers replaced']) >= 1)


def test_a_killed_worker_leaves_its_best_path(server, probe):
    process = server(workers=1)
    request = message(problems.read('free_flying_robot'))
    for seconds in (1.0, 2.0, 4.0, 8.0, 16.0):
        goals = Goals(probe)
        number = goals.send(request)
        probe.wait_for(lambda: goals.feedback[number]  # noqa: B023 - called at once
                       and goals.feedback[number][-1].elapsed >= seconds)  # noqa: B023
        for pid in children(process.pid):
            os.kill(pid, signal.SIGKILL)
        found = probe.result(goals.handles[number]).result
        assert (found.status, found.success) == ('not_converged', False)
        assert 'SIGKILL' in found.message
        if len(found.trajectory.t):
            break
    passes = all(residual <= tolerance for residual, tolerance in zip(
        found.certificate.residuals, found.certificate.tolerances, strict=True))
    assert f'the best path so far: cost {found.objective:.8g}, ' + (
        'the certificate passes, but' if passes else 'not certified') in found.message
    assert solve(probe, scalar()[0]).status == 'solved'


def test_a_worker_without_memory_loses_one_request(server, probe):
    process = server(workers=1)
    for pid in children(process.pid):
        status = Path(f'/proc/{pid}/status').read_text()
        [used] = [line.split()[1] for line in status.splitlines() if line.startswith('VmData')]
        bound = (int(used) << 10) + (8 << 20)
        resource.prlimit(pid, resource.RLIMIT_DATA, (bound, bound))
    response = solve(probe, endless(60))
    assert response.status == 'not_converged'
    assert 'worker' in response.message
    assert solve(probe, scalar()[0]).status == 'solved'


def test_a_full_queue_refuses_requests(server, probe, clock):
    server(workers=1, queue_length=2)
    goals = Goals(probe)
    goals.wait_until_solving(goals.send(endless()))
    for _ in range(2):
        goals.send(endless())
    response, begun, end = timed(probe, scalar()[0])
    assert clock.between(begun, end) < 1.0
    assert response.status == 'cancelled'
    assert 'the queue is full, with 2 requests' in response.message
    answers, *_ = goals.cancel()
    assert {answer.result.status for answer in answers} == {'cancelled'}


def test_twenty_concurrent_clients_get_their_solutions(server, probe):
    server(workers=2)
    requests, futures = [], []
    for k in range(20):
        problem, cost = scalar(a=0.5 + 0.1 * k)
        client = probe.node.create_client(SolveOptimalControl, SOLVE)
        probe.wait_for(client.service_is_ready)
        requests.append((client, SolveOptimalControl.Request(problem=problem), cost))
    for client, request, _ in requests * 3:
        futures.append(client.call_async(request))
    probe.wait_for(lambda: all(future.done() for future in futures), 60.0)
    for future, (_, _, cost) in zip(futures, requests * 3, strict=True):
        assert future.result().status == 'solved'
        assert future.result().objective == pytest.approx(cost, rel=1e-6)


def test_a_killed_client_does_not_affect_the_server(server, spawn, probe, tmp_path):
    server(workers=1)
    diagnostics = probe.listen(DiagnosticArray, '/diagnostics')
    file = tmp_path / 'slow.yaml'
    file.write_text((problems.FOLDER / 'vanderpol_bounded.yaml').read_text())
    for delay in (0.0, 0.05, 0.2):
        client = spawn('obc', arguments=['solve', str(file)])
        before = len(diagnostics)
        probe.wait_for(lambda: len(diagnostics) > before)  # noqa: B023 - called at once
        probe.spin_for(delay)
        client.kill()
    assert solve(probe, scalar()[0]).status == 'solved'


def test_a_request_of_50_megabytes_is_refused(standing):
    problem = scalar()[0]
    problem.running_cost = 'u + ' * 12_500_000 + 'u'
    response = solve(standing, problem)
    assert response.status == 'malformed'
    assert 'has 50000' in response.message
    problem = scalar()[0]
    problem.initial_guess.states = [NamedValues(name='x', values=array('d', bytes(50_000_000)))]
    assert solve(standing, problem).status == 'malformed'
    assert solve(standing, scalar()[0]).status == 'solved'


def test_the_workers_of_a_killed_server_end(server):
    process = server(workers=2)
    pids = children(process.pid)
    assert len(pids) == 3
    process.kill()
    deadline = time.monotonic() + 5.0
    while any(map(alive, pids)):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_ctrl_c_ends_a_solving_server(server, probe, clock):
    process = server(workers=1)
    goals = Goals(probe)
    goals.wait_until_solving(goals.send(endless()))
    pids = children(process.pid)
    begun = time.monotonic()
    assert process.interrupt() == 0
    assert clock.since(begun) < 2.0
    assert not any(map(alive, pids))
    assert 'Traceback' not in process.output()


def test_shutdown_answers_all_waiting_requests(server, probe):
    process = server(workers=1)
    arrays = probe.listen(DiagnosticArray, '/diagnostics')
    goals = Goals(probe)
    goals.wait_until_solving(goals.send(endless()))
    client = probe.node.create_client(SolveOptimalControl, SOLVE)
    probe.wait_for(client.service_is_ready)
    answers = [client.call_async(SolveOptimalControl.Request(problem=endless())) for _ in range(3)]
    answers.append(goals.handles[0].get_result_async())
    probe.wait_for(lambda: arrays and values(arrays[-1])['queue'] == '3', what='three in queue')
    os.kill(process.pid, signal.SIGINT)
    probe.wait_for(lambda: all(each.done() for each in answers), what='their responses')
    *waited, solved = [each.result() for each in answers]
    assert {each.message for each in waited} == {'the server is shutting down'}
    assert {each.status for each in (*waited, solved.result)} == {'cancelled'}
    assert process.wait(10.0) == 0


def test_parameters_are_checked_and_take_effect(server, probe, clock):
    process = server(workers=1)
    for name, value, words in (
            ('workers', 0, 'workers = 0'), ('workers', 'many', 'workers'),
            ('time_limit', -1.0, 'time_limit'), ('time_limit', float('nan'), 'time_limit'),
            ('cache_size', 0, 'cache_size = 0'), ('queue_length', -1, 'queue_length = -1')):
        [result] = probe.set_parameters(SERVER, **{name: value})
        assert not result.successful
        assert words in result.reason
    assert probe.set_parameters(SERVER, workers=2)[0].successful
    probe.wait_for(lambda: len(children(process.pid)) == 3, what='a second worker')
    assert probe.set_parameters(SERVER, workers=1, time_limit=0.5)[0].successful
    response, begun, end = timed(probe, endless(), time_limit=100.0)
    assert response.status == 'timed_out'
    assert clock.between(begun + 0.5, end) < PROMISE + SLACK
    probe.wait_for(lambda: len(children(process.pid)) == 2, what='one worker less')


def changed(**changes):
    """Return Example 2.2 with fields replaced."""
    problem = scalar()[0]
    for name, value in changes.items():
        setattr(problem, name, value)
    return problem


def named(**expressions):
    return [NamedExpression(name=name, expression=text) for name, text in expressions.items()]


MALFORMED = {
    'empty problem': (OptimalControlProblem(), 'states'),
    'unknown name': (changed(running_cost='u**2 + y'), 'y'),
    'attribute': (changed(running_cost='u.__class__'), 'running_cost'),
    'call of Python': (changed(running_cost="__import__('os').system('true')"), 'running_cost'),
    'power tower': (changed(running_cost='9**9**9**9**9'), 'running_cost'),
    'brackets': (changed(running_cost='(' * 9000 + 'u' + ')' * 9000), 'running_cost'),
    'control characters': (changed(running_cost='u\x07'), 'running_cost'),
    'no equation': (changed(dynamics=[]), 'dynamics'),
    'equation of an unknown state': (changed(dynamics=named(x='u', y='u')), 'y'),
    'equation twice': (changed(dynamics=named(x='u') * 2), 'is given twice'),
    'name twice': (changed(states=['x', 'x']), 'x'),
    'state and input': (changed(inputs=['x']), 'x'),
    'no number': (changed(initial_state=named(x='nan')), 'initial_state'),
    'division by zero': (changed(parameters=named(a='1/0')), 'parameters.a'),
    'crossed bounds': (changed(
        input_bounds=[NamedBounds(name='u', lower='1', upper='-1')]), 'cross'),
    'bound of an unknown input': (changed(input_bounds=[NamedBounds(name='w', lower='1')]), 'w'),
    'undefined at the start': (changed(dynamics=named(x='log(x - 2)')), 'dynamics.x'),
    'guess of an unknown state': (changed(initial_guess=InitialGuess(
        states=[NamedValues(name='y', values=[1.0])])), 'y'),
    'unknown system': (OptimalControlProblem(system='zeppelin'), 'zeppelin'),
    'file of the server': (OptimalControlProblem(system='/etc/passwd.yaml'), 'system'),
}


def test_malformed_problems_are_refused_with_a_reason(standing, clock):
    for name, (problem, words) in MALFORMED.items():
        response, begun, end = timed(standing, problem)
        assert clock.between(begun, end) < 1.0, name
        assert (response.status, response.success) == ('malformed', False), name
        assert words in response.message, (name, response.message)
    for options in ({'method': 'magic'}, {'time_limit': -1.0}, {'time_limit': float('nan')},
                    {'options': ['coarse.rough']}, {'options': ['coarse.rough=nan']},
                    {'options': ['magic=1'] * 1000}):
        assert solve(standing, scalar()[0], **options).status == 'malformed', options
    assert solve(standing, scalar()[0]).status == 'solved'
