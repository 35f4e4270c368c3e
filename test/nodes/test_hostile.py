# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Hostile input over DDS: the nodes keep running and respond.

Every service, topic, action and parameter of the three nodes gets many hostile requests. One
process of each node gets all of them.
"""

from array import array
from collections.abc import Iterator
import copy
import os
from pathlib import Path
import random
import re
import time
from typing import Any

from action_msgs.srv import CancelGoal
import hostile
from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
from lifecycle_msgs.srv import (
    ChangeState,
    GetAvailableStates,
    GetAvailableTransitions,
    GetState,
)
from nav_msgs.msg import Odometry
from obc_ros.action import SolveOptimalControl as SolveAction
from obc_ros.cli.processes import reserve_domain
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.text.errors import StatementError
from obc_ros.core.text.expressions import parse_expression, parse_number
from obc_ros.msg import (
    Command,
    FinalTime,
    InitialGuess,
    LqrWeights,
    Measurement,
    NamedBounds,
    NamedExpression,
    NamedValues,
    OptimalControlProblem,
    State,
    Trajectory,
)
from obc_ros.ros.messages import build_problem_message, read_request
from obc_ros.srv import (
    DesignLqr,
    FollowReference,
    Minimize,
    PlanMotion,
    PredictState,
    SolveOptimalControl,
    SuggestNoise,
    SuggestWeights,
    TryDesign,
)
from probes import build_parameters, Probe
import pytest
from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger
import support

pytestmark = pytest.mark.nodes

PARAMETERS = {
    'describe_parameters': DescribeParameters, 'get_parameter_types': GetParameterTypes,
    'get_parameters': GetParameters, 'list_parameters': ListParameters,
    'set_parameters': SetParameters, 'set_parameters_atomically': SetParametersAtomically}
SERVICES = {
    'lqr_node': {
        **PARAMETERS, 'start': Trigger, 'stop': Trigger, 'suggest_weights': SuggestWeights,
        'try_design': TryDesign, 'predict_state': PredictState,
        'follow_reference': FollowReference, 'change_state': ChangeState, 'get_state': GetState,
        'get_available_states': GetAvailableStates,
        'get_available_transitions': GetAvailableTransitions},
    'estimator_node': {
        **PARAMETERS, 'suggest_noise': SuggestNoise, 'suggest_weights': SuggestNoise},
    'plant_simulator': {**PARAMETERS, 'pause': SetBool, 'reset': Trigger, 'step': Trigger},
    'trajectory_server': {
        **PARAMETERS, 'design_lqr': DesignLqr, 'minimize': Minimize, 'plan': PlanMotion,
        'solve': SolveOptimalControl,
        'solve_optimal_control/_action/cancel_goal': CancelGoal}}
TOPICS = {'state': State, 'odom': Odometry, 'reference': Trajectory, 'command': Command,
          'measurement': Measurement, '/clock': Clock}
NODES = {'lqr_node': {'use_sim_time': True}, 'plant_simulator': {}, 'estimator_node': {},
         'trajectory_server': {'time_limit': 0.3, 'use_sim_time': True}}
SHUTDOWNS = (5, 6, 7)  # transitions that rightly end a lifecycle node
LIMIT = 40.0           # [s] for each response, on a busy machine
QUICK = settings(database=None, suppress_health_check=list(HealthCheck))


class Victims:
    """The nodes under test, and a probe."""

    def __init__(self, folder: Path, domain: int) -> None:
        self.spawner = support.Spawner(folder, domain)
        self.processes = {name: self.spawner(name, parameters)
                          for name, parameters in NODES.items()}
        self.odometer = self.spawner('lqr_node', {'state_source': 'odom'}, name='odometer')
        self.probe = Probe(domain)
        self._read = dict.fromkeys(self.processes, 0)
        self._clients: dict[str, Any] = {}
        self._publishers: dict[str, Any] = {}

    def ask(self, name: str, service_type: Any, request: Any) -> Any:
        """Return the response of a service; keep its client."""
        if name not in self._clients:
            self._clients[name] = self.probe.node.create_client(service_type, name)
            self.probe.wait_for(self._clients[name].service_is_ready, what=f'service {name}')
        future = self._clients[name].call_async(request)
        self.probe.wait_for(future.done, LIMIT, f'an answer of {name} to {str(request)[:500]}')
        return future.result()

    def tell(self, topic: str, message_type: Any, message: Any) -> None:
        """Publish a message, or bytes in place of one."""
        if topic not in self._publishers:
            self._publishers[topic] = self.probe.publisher(message_type, topic, QoSProfile(
                depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        self._publishers[topic].publish(message)

    def check(self) -> None:
        """Fail if a node has ended, does not respond or has logged a traceback."""
        for name, process in self.processes.items():
            new = process.output()[self._read[name]:]
            self._read[name] += len(new)
            assert process.running(), new[-3000:]
            self.ask(f'/{name}/get_parameters', GetParameters,
                     GetParameters.Request(names=['system']))
            assert 'Traceback' not in new, new[-3000:]
        assert self.odometer.running(), self.odometer.output()[-3000:]


@pytest.fixture(scope='module')
def victims(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Victims]:
    with reserve_domain() as domain:
        victims = Victims(tmp_path_factory.mktemp('hostile'), domain)
        for name in NODES:
            victims.probe.wait_for_node(name)
        yield victims
        victims.probe.close()
        assert not victims.spawner.end()


def restrict(request: Any) -> Any:
    """Return a request without valid demands to end the node or to wait for long."""
    if isinstance(request, ChangeState.Request):
        if request.transition.id in SHUTDOWNS:
            request.transition.id = 0
        if 'shutdown' in request.transition.label:
            request.transition.label = ''
    if isinstance(request, (SetParameters.Request, SetParametersAtomically.Request)):
        for each in request.parameters:
            if each.name in ('workers', 'time_limit'):  # 64 workers would be valid too
                each.value.integer_value = min(each.value.integer_value, 2)
                each.value.double_value = min(each.value.double_value, 0.3)
    return request


@pytest.mark.parametrize(('node', 'service'), [
    (node, service) for node, services in SERVICES.items() for service in services])
def test_every_service_responds_to_hostile_requests(victims, node, service):
    service_type = SERVICES[node][service]

    @QUICK
    @given(hostile.messages(service_type.Request))
    def ask(request):
        response = victims.ask(f'/{node}/{service}', service_type, restrict(request))
        if getattr(response, 'success', True) is False and hasattr(response, 'message'):
            assert response.message, 'a refusal without a reason'

    ask()
    victims.check()


def valid_requests() -> dict[str, Any]:
    """Return valid requests by the name of their service."""
    mapping = {
        'states': ['p', 'v'], 'inputs': ['u'], 'parameters': {'m': 2.0},
        'dynamics': {'p': 'v', 'v': 'u/m'}, 'running_cost': 'u**2 + p**2',
        'initial_state': {'p': 1, 'v': 0}, 'terminal_constraints': ['p', 'v'],
        'input_bounds': {'u': [-1, 1]}, 'state_bounds': {'v': [-2, None]},
        'path_constraints': [{'expr': 'p + v', 'lower': -3}],
        'final_time': {'free': False, 'value': 5},
        'initial_guess': {'states': {'p': [1, 0.5, 0]}, 'inputs': {'u': 0}}}
    problem = build_problem_message(mapping, build_problem(mapping).guess)
    weights = LqrWeights(qx=[1.0] * 6, qu=[1.0] * 2)
    return {
        'solve': SolveOptimalControl.Request(problem=problem, method='auto'),
        'plan': PlanMotion.Request(
            system='two_wheeled', start=[0.0] * 3, goal=[1.0, 1.0, 0.5], objective='time',
            system_parameters=[NamedExpression(name='L', expression='1')]),
        'minimize': Minimize.Request(
            variables=['x', 'y'], cost='x**2 + y**2', equalities=['x + y - a'],
            inequalities=['x - 3'], parameters=[NamedExpression(name='a', expression='1')],
            bounds=[NamedBounds(name='x', lower='-1', upper='2')], guess=[0.0, 0.0]),
        'design_lqr': DesignLqr.Request(
            system='aircraft', setpoint=[0.0] * 6, setpoint_input=[0.0, 39.2], weights=weights,
            sample_time=0.01, delay=0.02),
        'try_design': TryDesign.Request(weights=weights),
        'predict_state': PredictState.Request(),
        'suggest_weights': SuggestWeights.Request(
            x_max=[1.0] * 6, u_max=[1.0] * 2, rise_time=2.0, overshoot=0.2,
            peak_input=[10.0, 50.0])}


@pytest.mark.parametrize(('name', 'request_'), valid_requests().items(), ids=valid_requests())
def test_a_corrupted_request_gets_a_message(victims, name, request_):
    node = 'lqr_node' if name in SERVICES['lqr_node'] else 'trajectory_server'

    @QUICK
    @given(hostile.spoilt(request_))
    def ask(request):
        response = victims.ask(f'/{node}/{name}', SERVICES[node][name], request)
        assert response.message

    ask()
    victims.check()


def problem(count: int, expression: str = 'u', **others: Any) -> OptimalControlProblem:
    """Return a problem with `count` states that have the same derivative."""
    names = [f'x{k}' for k in range(count)]
    each = [NamedExpression(name=name, expression=expression) for name in names]
    start = [NamedExpression(name=name, expression='0') for name in names]
    return OptimalControlProblem(
        states=names, inputs=['u'], dynamics=each, initial_state=start, running_cost='u**2',
        final_time=FinalTime(value='1'), **others)


SIZES = {
    'a million terms': ('solve', lambda: problem(1, '+'.join(['u'] * 10**6))),
    '50 MB of text': ('solve', lambda: problem(1, 'u' * 50_000_000)),
    '3000 states': ('solve', lambda: problem(3000)),
    'every expression long': ('solve', lambda: problem(300, '+'.join(['sin(u)*u'] * 600))),
    'a guess of a million': ('solve', lambda: problem(1, initial_guess=InitialGuess(
        inputs=[NamedValues(name='u', values=[0.0] * 10**6)]))),
    'a power of powers': ('solve', lambda: problem(1, 'u**9**9**9**9')),
    '20 000 brackets': ('solve', lambda: problem(1, '(' * 20_000 + 'u' + ')' * 20_000)),
    'an option of a system': ('plan', lambda: PlanMotion.Request(
        system='brockett', objective='effort',
        system_parameters=[NamedExpression(name='m', expression='1000000')])),
    'A of a million': ('design_lqr', lambda: DesignLqr.Request(a=[0.0] * 10**6, b=[1.0] * 1000)),
    '3000 variables': ('minimize', lambda: Minimize.Request(
        variables=[f'x{k}' for k in range(3000)], cost='x0'))}


@pytest.fixture
def long_time_limit(victims: Victims) -> Iterator[None]:
    """Raise the time limit, since on a busy machine a refusal waits for its worker."""
    victims.probe.set_parameters('/trajectory_server', time_limit=30.0)
    yield
    victims.probe.set_parameters('/trajectory_server', time_limit=0.3)


@pytest.mark.usefixtures('long_time_limit')
@pytest.mark.parametrize(('service', 'make'), SIZES.values(), ids=SIZES)
def test_an_oversized_request_is_refused_with_a_reason(victims, service, make):
    made = make()
    request = SolveOptimalControl.Request(problem=made) if service == 'solve' else made
    response = victims.ask(f'/trajectory_server/{service}',
                           SERVICES['trajectory_server'][service], request)
    assert not response.success
    assert 'malformed' in (getattr(response, 'status', ''), response.message.split(':')[0])
    assert re.search(r'at most|from 2 to 50|not a finite number', response.message)
    victims.check()


def test_a_million_intervals_are_refused(victims):
    answer, = victims.probe.set_parameters('/trajectory_server', max_intervals=10**6)
    assert not answer.successful
    assert 'between 10 and 100000' in answer.reason


def test_a_problem_of_the_largest_size_gets_a_response(victims):
    widest = problem(1000, '+'.join(['sin(u)'] * 25))
    response = victims.ask('/trajectory_server/solve', SolveOptimalControl,
                           SolveOptimalControl.Request(problem=widest, time_limit=0.3))
    assert response.status in ('timed_out', 'not_converged', 'solved')
    assert response.message
    victims.check()


@pytest.mark.parametrize('node', NODES)
def test_hostile_parameter_values_are_accepted_or_refused(victims, node):
    names = victims.ask(f'/{node}/list_parameters', ListParameters,
                        ListParameters.Request()).result.names
    values = victims.ask(f'/{node}/get_parameters', GetParameters,
                         GetParameters.Request(names=names)).values
    all_ = [Parameter(name=name, value=value)
            for name, value in zip(names, values, strict=True)]
    several = st.lists(st.sampled_from(all_), min_size=1, max_size=4)

    @given(several.flatmap(lambda chosen: hostile.spoilt(
        SetParameters.Request(parameters=copy.deepcopy(chosen)))))
    @QUICK
    def change(request):
        results = victims.ask(f'/{node}/set_parameters', SetParameters, restrict(request)).results
        assert len(results) == len(request.parameters)
        assert all(each.successful or each.reason for each in results)

    change()
    victims.ask(f'/{node}/set_parameters', SetParameters, SetParameters.Request(parameters=all_))
    victims.check()


@pytest.mark.parametrize('topic', TOPICS)
def test_every_topic_tolerates_hostile_messages(victims, topic):
    @QUICK
    @given(hostile.messages(TOPICS[topic]))
    def tell(message):
        victims.tell(topic, TOPICS[topic], message)
        victims.probe.spin_for(0.002)

    tell()
    victims.check()


@pytest.mark.parametrize('topic', TOPICS)
def test_every_topic_tolerates_bytes_that_are_no_message(victims, topic):
    draw = random.Random(topic)
    whole = bytes(serialize_message(TOPICS[topic]()))
    for k in range(40):
        spoilt = bytearray(whole)
        spoilt[draw.randrange(4, len(spoilt))] = draw.randrange(256)
        data = (bytes(spoilt), whole[:draw.randrange(4, len(whole))],
                whole[:4] + b'\xff' * draw.randrange(1, 100),
                whole[:4] + draw.randbytes(draw.randrange(200)))[k % 4]
        data += b'\0' * (-len(data) % 4)
        # the middleware does not send more bytes than a Clock has
        victims.tell(topic, TOPICS[topic], data[:len(whole)] if topic == '/clock' else data)
        victims.probe.spin_for(0.002)
    victims.check()


def test_the_action_responds_to_hostile_goals(victims):
    names = 'solve_optimal_control/_action'
    goals = SolveAction.Impl.SendGoalService
    results = SolveAction.Impl.GetResultService

    @QUICK
    @given(hostile.messages(goals.Request), st.booleans())
    def ask(request, cancel):
        accepted = victims.ask(f'/trajectory_server/{names}/send_goal', goals, request)
        if cancel:
            victims.ask(f'/trajectory_server/{names}/cancel_goal', CancelGoal,
                        CancelGoal.Request())
        answer = victims.ask(f'/trajectory_server/{names}/get_result', results,
                             results.Request(goal_id=request.goal_id))
        if accepted.accepted:
            assert answer.result.status
            assert answer.result.message

    ask()
    victims.check()


def test_the_same_processes_still_work_after_all_tests(victims):
    """The settings are restored, and each node does its task."""
    probe = victims.probe
    pids = {name: process.pid for name, process in victims.processes.items()}
    for pid in pids.values():
        os.kill(pid, 0)
    hover = DesignLqr.Request(system='aircraft')
    hover.weights.qx, hover.weights.qu = array('d', [1.0] * 6), array('d', [1.0] * 2)
    victims.ask('/trajectory_server/set_parameters', SetParameters, SetParameters.Request(
        parameters=build_parameters({'time_limit': 20.0})))
    answer = victims.ask('/trajectory_server/design_lqr', DesignLqr, hover)
    assert answer.success, answer.message
    probe.call(Trigger, '/plant_simulator/reset')
    answer = probe.call(TryDesign, '/lqr_node/try_design')
    assert answer.message


# In this process: the parser of expressions, and the reading of requests

SYMBOLS = {'x': 2.0, 'v': -1.0}
PIECES = ['x', 'v', '1', '0', '9', '.5', '1e9', '1e-400', '+', '-', '*', '/', '**', '(', ')', ',',
          'sin', 'log', 'sqrt', 'atan2', 'pi', ' ', '\n', '\t', '.', '_', 'j', '0x', '[', ']',
          '{', '}', ':', '=', '==', ':=', 'lambda', 'if', 'else', 'for', 'in', 'not', 'and', 'or',
          'import', '__', '"', "'", '\\', '#', '@', ';', '`', '~', '%', '^', '&', '|', '<', '>',
          '!', '?', '$', 'é', '\u202e', '\ufeff', '\x00', '\ud800']
sentences = st.lists(st.sampled_from(PIECES), max_size=40).map(''.join) | st.text(max_size=60)


@settings(max_examples=500)
@given(sentences)
def test_any_text_is_parsed_or_refused(text):
    try:
        assert isinstance(parse_number(text, SYMBOLS, 'here'), float)
    except StatementError as error:
        assert str(error).startswith('here')


@pytest.mark.parametrize(('text', 'seconds'), [
    ('+'.join(['x'] * 1_000_000), 1.0), ('9**9**9**9', 1.0), ('(' * 20_000, 1.0),
    ('(' * 10_000 + 'x' + ')' * 10_000, 1.0), ('-' * 19_999 + 'x', 1.0), ('x' * 10**8, 1.0),
    ('sin(' * 6_000, 1.0), ('x**' * 3_000 + 'x', 1.0), ('1' * 19_999, 1.0), ('\n' * 10**7, 1.0),
    ('1e' + '9' * 5_000, 1.0), ('[' * 10**6, 1.0), ('x.' * 9_000, 1.0)],
    ids=lambda value: str(value)[:12])
def test_an_oversized_text_is_refused_quickly(text, seconds):
    begin = time.process_time()
    with pytest.raises(StatementError):
        parse_number(text, SYMBOLS, 'here')
    with pytest.raises(StatementError):
        parse_expression(text, {}, 'here')
    assert time.process_time() - begin < seconds


@settings(max_examples=200, suppress_health_check=list(HealthCheck))
@given(hostile.messages(OptimalControlProblem) | hostile.spoilt(valid_requests()['solve'].problem),
       st.sampled_from(['auto', '', 'x', 'lq']))
def test_any_problem_message_is_read_or_refused(message, method):
    try:
        packet = read_request('solve', SolveOptimalControl.Request(
            problem=message, method=method))
        build_problem(packet.plain['statement'])
    except StatementError as error:
        assert str(error)
