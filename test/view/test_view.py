# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the page shows and whom it serves, without a browser."""

import asyncio
from contextlib import closing, suppress
import math
import threading
import time
from types import SimpleNamespace
from typing import Any
from unittest import mock

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from obc_ros import systems
from obc_ros.cli.obc import main
from obc_ros.cli.recording import LATCHED
from obc_ros.core.lqr.weights import from_bryson
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.systems.registry import get_system
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import Estimate, LqrDesign, NamedBounds, State, Trajectory
from obc_ros.srv import PlanMotion
from obc_ros.view import command
import pytest
from rcl_interfaces.msg import Log
from scipy.stats import chi2, norm
from std_srvs.srv import Trigger

pytest.importorskip('nicegui', reason='NiceGUI is not installed')
from obc_ros.view import access
from obc_ros.view.access import COOKIE, Gate, Helm, make_token
from obc_ros.view.canvas import describe_scene, LoopCanvas
from obc_ros.view.charts import (
    add_unit,
    compute_steps,
    find_switching_functions,
    group_names,
    list_figures,
)
from obc_ros.view.loop_client import LoopClient, NEWS
from obc_ros.view.page import Viewer
from obc_ros.view.panels.plan_panel import compute_switching
from obc_ros.view.panels.weights_panel import convert_weights
from obc_ros.view.playback import Playback
from obc_ros.view.telemetry import (
    describe_plant,
    describe_uncertainty,
    FollowedPath,
    Frame,
    measure_cost,
    Named,
    Plant,
    read_mode,
    SetPoint,
    ShownMode,
)
import uvicorn
from uvicorn.server import ServerState
from view_recording import design_of, record

HOSTILE = '</script><img src=x onerror=alert(1)>{{ 7*7 }}'


def ask(gate: Gate, kind: str = 'http', query: str = '', **headers: str | list[str]
        ) -> tuple[int, dict[str, str]]:
    """
    Return status and headers of the answer to a request; 0: the application was asked.

    A list has the values of a header that stands several times.
    """
    sent: list[Any] = []

    async def send(event: Any) -> None:
        sent.append(event)

    asyncio.run(gate({'type': kind, 'query_string': query.encode(), 'headers': [
        (name.encode(), value.encode()) for name, given in headers.items()
        for value in ([given] if isinstance(given, str) else given)]}, None, send))
    if not sent:
        return 0, {}
    if sent[0]['type'] == 'websocket.close':
        return sent[0]['code'], {}
    return sent[0]['status'], {key.decode(): value.decode() for key, value in sent[0]['headers']}


async def application(scope: Any, receive: Any, send: Any) -> None:
    """Take every request."""


@pytest.mark.parametrize('kind', ['http', 'websocket'])
@pytest.mark.parametrize(('headers', 'served'), [
    ({'host': '127.0.0.1:8080'}, True),
    ({'host': 'localhost:8080', 'origin': 'http://localhost:8080'}, True),
    ({'host': '[::1]:8080'}, True),
    ({'host': '127.0.0.1:8080', 'origin': 'http://evil.example'}, False),
    ({'host': '127.0.0.1:8080', 'origin': 'null'}, False),
    ({'host': 'evil.example:8080', 'origin': 'http://evil.example:8080'}, False),
    ({'host': '127.0.0.1.evil.example'}, False), ({}, False)])
def test_only_pages_of_this_machine_are_served(kind, headers, served):
    status, _ = ask(Gate(application), kind, **headers)
    assert status == (0 if served else {'http': 403, 'websocket': 1008}[kind])


@pytest.mark.parametrize('headers', [
    {'host': '[::1'}, {'host': '127.0.0.1]:8080'}, {'host': '[x]:8080'},
    {'host': 'evil.example@localhost'}, {'host': 'localhost/x'}, {'host': 'localhost?x'},
    {'host': 'localhost#x'}, {'host': 'localhost:8080Content-Length: 5'}, {'host': 'localhost:x'},
    {'host': ['localhost', 'localhost']}, {'host': ['evil.example', 'localhost']},
    {'host': 'localhost', 'origin': ['http://evil.example', 'http://localhost']},
    {'host': '127.0.0.1:8080', 'origin': 'http://[::1'},
    {'host': '127.0.0.1:8080', 'origin': 'http://]'}])
@pytest.mark.parametrize('token', ['', 'x'])
def test_a_malformed_host_or_origin_is_answered_with_400(headers, token):
    if token and 'origin' not in headers:
        headers = {**headers, 'origin': 'http://['}
    assert ask(Gate(application, token), **headers)[0] == 400
    assert ask(Gate(application, token), 'websocket', **headers)[0] == 1008


async def answer_briefly(scope: Any, receive: Any, send: Any) -> None:
    """Answer every request."""
    await send({'type': 'http.response.start', 'status': 200, 'headers': [(b'x', b'y')]})
    await send({'type': 'http.response.body', 'body': b''})


@pytest.mark.parametrize(('host', 'status'), [('localhost', 200), ('evil.example', 403)])
def test_no_page_may_frame_an_answer(host, status):
    found, headers = ask(Gate(answer_briefly), host=host)
    assert found == status
    assert headers['content-security-policy'] == "frame-ancestors 'none'"
    assert headers['x-frame-options'] == 'DENY'


@pytest.mark.parametrize(('host', 'address'), [
    ('::1', 'http://[::1]:8080/'), ('127.0.0.1', 'http://127.0.0.1:8080/'),
    ('localhost', 'http://localhost:8080/')])
def test_an_ipv6_address_has_brackets(host, address):
    assert command.format_address(host, 8080) == address


def test_another_address_asks_for_the_token():
    token = make_token()
    gate, host = Gate(application, token), {'host': 'robot:8080'}
    assert ask(gate, **host)[0] == 403
    assert ask(gate, 'websocket', **host)[0] == 1008
    for wrong in ('', 'x', token[:-1], token + 'x', HOSTILE):
        assert ask(gate, query=f'token={wrong}', **host)[0] == 403
        assert ask(gate, cookie=f'{COOKIE}={wrong}', **host)[0] == 403
    status, headers = ask(gate, query=f'token={token}', **host)
    assert (status, headers['location']) == (303, '/')
    assert {'HttpOnly', 'SameSite=Strict'} < set(headers['set-cookie'].split('; '))
    cookie = headers['set-cookie'].partition(';')[0]
    assert ask(gate, cookie=cookie, **host)[0] == 0
    assert ask(gate, 'websocket', cookie=cookie, **host)[0] == 0
    assert ask(gate, cookie=cookie, origin='http://evil.example', **host)[0] == 403
    for others in ('a(b=1', 'a,b=1', 'x="1', '=', HOSTILE):   # of other pages of this name
        assert ask(gate, cookie=f'{others}; {cookie}', **host)[0] == 0
        assert ask(gate, cookie=others, **host)[0] == 403
    assert make_token() != token


async def answer_slowly(scope: Any, receive: Any, send: Any) -> None:
    """Answer a request, and the messages of a websocket, after longer than a header may take."""
    if scope['type'] == 'http':
        await asyncio.sleep(1.5 * access.HEADER_TIME)
        await send({'type': 'http.response.start', 'status': 200,
                    'headers': [(b'content-length', b'2')]})
        await send({'type': 'http.response.body', 'body': b'ok'})
        return
    await receive()
    await send({'type': 'websocket.accept'})
    while (await receive())['type'] == 'websocket.receive':
        await send({'type': 'websocket.send', 'text': 'ok'})


async def exchange(protocol: type, client: Any) -> Any:
    """Run a server with a protocol of HTTP, and a client of it; return what the client returns."""
    server = uvicorn.Server(uvicorn.Config(
        answer_slowly, port=0, http=protocol, ws='wsproto', lifespan='off', log_level='error'))
    task = asyncio.create_task(server.serve())
    while not server.started:
        await asyncio.sleep(0.01)
    reader, writer = await asyncio.open_connection(
        *server.servers[0].sockets[0].getsockname())
    try:
        return await client(reader, writer)
    finally:
        writer.close()
        server.should_exit = True
        await task


@pytest.fixture(params=['httptools', 'h11'])
def protocol(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> type:
    """Return a protocol with a short deadline."""
    monkeypatch.setattr(access, 'HEADER_TIME', 0.4)
    module = pytest.importorskip(f'uvicorn.protocols.http.{request.param}_impl')
    base = {'httptools': 'HttpToolsProtocol', 'h11': 'H11Protocol'}[request.param]
    return type('Protocol', (access.HeaderDeadline, getattr(module, base)), {})


REQUEST = b'GET / HTTP/1.1\r\nHost: localhost\r\n\r\n'
UPGRADE = (b'GET / HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n'
           b'Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n')


@pytest.mark.parametrize(('sent', 'answered'), [
    (b'', 0), (REQUEST[:-4], 0), (REQUEST[:-4], 1), (b'slowly', 0), (b'slowly', 1)])
def test_a_header_that_does_not_arrive_ends_the_connection(protocol, sent, answered):
    """Also after a request that was answered, where half a header begins the wait."""
    async def client(reader: Any, writer: Any) -> float:
        for _ in range(answered):
            writer.write(REQUEST)
            assert (await reader.readuntil(b'ok')).startswith(b'HTTP/1.1 200')
        begun = time.monotonic()
        if sent == b'slowly':
            for byte in REQUEST[:-4]:
                writer.write(bytes([byte]))
                with suppress(TimeoutError):
                    assert await asyncio.wait_for(reader.read(), 0.05) == b''
                    return time.monotonic() - begun
        writer.write(sent)
        assert await asyncio.wait_for(reader.read(), 20.0) == b''
        return time.monotonic() - begun
    assert 0.35 < asyncio.run(exchange(protocol, client)) < 3.0


def test_a_request_that_arrived_and_a_websocket_have_all_time(protocol):
    async def ask_twice(reader: Any, writer: Any) -> None:
        for _ in range(2):
            writer.write(REQUEST[:-4])
            await asyncio.sleep(0.1)
            writer.write(REQUEST[-4:])
            assert (await reader.readuntil(b'ok')).startswith(b'HTTP/1.1 200')

    async def converse(reader: Any, writer: Any) -> None:
        writer.write(UPGRADE)
        assert b' 101 ' in await reader.readuntil(b'\r\n\r\n')
        for _ in range(2):
            await asyncio.sleep(0.6)
            writer.write(b'\x81\x82\0\0\0\0hi')
            assert await asyncio.wait_for(reader.readexactly(4), 5.0) == b'\x81\x02ok'

    asyncio.run(exchange(protocol, ask_twice))
    asyncio.run(exchange(protocol, converse))


def connect(protocol: type, application: Any) -> tuple[Any, Any, ServerState]:
    """Return a protocol that serves an application, its connection, and its requests."""
    config = uvicorn.Config(application, lifespan='off', log_config=None)
    config.load()
    state = ServerState()
    server = protocol(config=config, server_state=state, app_state={})
    connection = mock.MagicMock(spec=asyncio.Transport)
    connection.is_closing.side_effect = lambda: connection.close.called
    connection.get_protocol.return_value = server
    connection.get_extra_info.return_value = None
    server.connection_made(connection)
    return server, connection, state


@pytest.mark.parametrize('protocol', ['h11'], indirect=True)   # httptools reads on
def test_a_request_before_malformed_data_is_not_answered_after_400(protocol, caplog):
    """The application answers before the loop tells it of the end of the connection."""
    async def give_both() -> bytes:
        going = asyncio.Event()

        async def answer_later(scope: Any, receive: Any, send: Any) -> None:
            await going.wait()
            await answer_briefly(scope, receive, send)

        server, connection, state = connect(protocol, answer_later)
        server.data_received(REQUEST.replace(b'1.1', b'1.0'))
        await asyncio.sleep(0)
        server.data_received(b'more\r\n\r\n')
        assert connection.close.called
        going.set()
        await asyncio.gather(*state.tasks)
        server.connection_lost(None)
        return b''.join(call.args[0] for call in connection.write.mock_calls)

    written = asyncio.run(give_both())
    assert (written.count(b'HTTP/1.1'), written.count(b'HTTP/1.1 400')) == (1, 1)
    assert not [each for each in caplog.records if each.name == 'uvicorn.error' and (
        each.levelname == 'ERROR')]


@pytest.mark.parametrize('protocol', ['h11'], indirect=True)
def test_malformed_data_after_an_answer_end_the_connection(protocol):
    """The body of the request is not read, so that the answer is the last one."""
    async def give() -> bool:
        server, connection, state = connect(protocol, answer_briefly)
        server.data_received(REQUEST.replace(
            b'\r\n\r\n', b'\r\nTransfer-Encoding: chunked\r\n\r\n\xbf'))
        await asyncio.gather(*state.tasks)
        server.data_received(b'\r\n')
        server.connection_lost(None)
        return connection.close.called

    assert asyncio.run(give())


def test_one_page_controls_at_a_time_after_a_click():
    """A page that comes back has the control again only if nobody has taken it since."""
    helm = Helm(True)
    helm.resume('a')
    assert not helm.has('a')
    helm.seize('a')
    helm.leave('b')
    assert helm.has('a')
    helm.seize('b')
    assert helm.has('b') and not helm.has('a')
    helm.leave('b')
    helm.resume('a')
    assert not helm.has('a') and not helm.has('b')
    helm.resume('b')
    assert helm.has('b')
    helm.leave('b')
    helm.seize('a')
    helm.leave('a')
    helm.resume('b')
    assert not helm.has('b')


def test_nobody_controls_what_is_read_only():
    helm = Helm(False)
    helm.seize('a')
    helm.resume('a')
    assert not helm.has('a')


def test_the_step_response_is_that_of_the_closed_loop():
    """K = (1, sqrt 3) for Qx = diag(1, 1), Qu = 1: both poles of the loop are known."""
    [(name, data)] = compute_steps(design_of('double_integrator', [1.0, 1.0], [1.0]))
    t, y = np.array(data).T
    s = np.roots([1.0, np.sqrt(3.0), 1.0])
    exact = 1.0 - ((s[1] * np.exp(s[0] * t) - s[0] * np.exp(s[1] * t)) / (s[1] - s[0])).real
    assert name == systems['double_integrator'].states[0]
    assert np.abs(y - exact).max() < 1e-12
    assert t[-1] > 5.0 / np.abs(s.real).min()


def test_the_table_compares_two_designs():
    use, new = (design_of('double_integrator', [q, 1.0], [1.0]) for q in (1.0, 4.0))
    [row] = [row for row in list_figures(use, new) if '(damping ratio)' in row['what']]
    assert row['use'] == f'{np.sqrt(3) / 2:.3g}'
    assert row['new'] == f'{np.sqrt(5) / 2 / np.sqrt(2):.3g}'
    assert list_figures(None, None) == []


def test_the_cost_to_go_is_a_quadratic_form():
    design = design_of('double_integrator', [1.0, 1.0], [1.0])
    x = np.array([0.3, -0.2])
    P = np.array([[np.sqrt(3.0), 1.0], [1.0, np.sqrt(3.0)]])
    assert measure_cost(design, x) == pytest.approx(x @ P @ x, rel=1e-12)
    assert np.isnan(measure_cost(design, [1.0]))


@pytest.mark.parametrize('name', ['aircraft', 'vehicle', 'two_wheeled'])
def test_a_body_is_drawn_where_it_moves(name):
    plant = describe_plant(LqrDesign(
        system=name, state_names=list(systems[name].states),
        input_names=list(systems[name].inputs)))
    scene = describe_scene(plant)
    assert scene['body'] and scene['plane']['x'] == plant.state_names.index('px')
    drawn = [(each['of'], each['index']) for panel in scene['panels']
             for each in panel['signals']]
    assert len(drawn) == len(set(drawn)) == len(plant.states) + len(plant.inputs) + 2


def test_a_position_that_moves_at_the_set_point_has_a_panel_of_its_own():
    """The vehicle drives along px: py, a few metres, is not flattened by hundreds of px."""
    design = LqrDesign(system='vehicle', state_names=list(systems['vehicle'].states),
                       input_names=list(systems['vehicle'].inputs), xe=[0.0] * 3, ue=[10.0, 0.0])
    plant = describe_plant(design)
    panels = [[signal['name'] for signal in panel['signals']]
              for panel in describe_scene(plant)['panels']]
    assert panels[:3] == [['px'], ['py'], ['theta']]
    moving = [each.name for each in plant.states if each.moves]
    assert group_names(plant.state_names, plant.units, moving) == [
        ('m', [0]), ('m', [1]), ('rad', [2])]
    assert group_names(plant.state_names, plant.units, ()) == [('m', [0, 1]), ('rad', [2])]
    at_rest = describe_plant(LqrDesign(
        system='vehicle', state_names=design.state_names, input_names=design.input_names,
        xe=[0.0] * 3, ue=[0.0, 0.0]))
    assert not any(each.moves for each in at_rest.states)


def test_names_of_unknown_plants_stay_text():
    plant = describe_plant(LqrDesign(system=HOSTILE, state_names=[HOSTILE], input_names=['u']))
    assert plant == Plant(HOSTILE, (Named(HOSTILE),), (Named('u'),))
    scene = describe_scene(plant)
    assert scene['plane'] is None and not scene['body']


def test_a_name_from_the_network_reads_no_file(tmp_path):
    file = tmp_path / 'plant.yaml'
    file.write_text('name: plant\nstates: [a]\ninputs: [b]\ndynamics: {a: b}\nunits: {a: m}\n')
    assert get_system(str(file)).units == {'a': 'm'}
    design = LqrDesign(system=str(file), state_names=['a'], input_names=['b'], xe=[0.0], ue=[1.0])
    assert describe_plant(design).units == {'a': '', 'b': ''}
    assert list(SetPoint(design).locate([3.0])) == [0.0]


def test_numbers_that_are_not_finite_are_left_out():
    packed = Frame(1.0, [np.nan, 1.0], [np.inf]).pack(3)
    assert packed == {'n': 3, 't': 1.0, 'x': [None, 1.0], 'u': [None], 'goal': [], 'cost': None,
                      'latency': None, 'band': [], 'ellipse': [], 'acting': [],
                      'gust': False, 'push': []}


def test_a_recording_plays_pauses_and_is_scrubbed(tmp_path, monkeypatch):
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(time, 'monotonic', lambda: clock.now)
    playback = Playback(record(tmp_path / 'a.mcap', [[0.0], [1.0], [2.0], [3.0]]))
    assert playback.duration == 3.0 and playback.plant.state_names == ('x1',)
    assert list(playback.take_frame().x) == [0.0]
    clock.now = 1.0
    assert playback.take_frame() is None   # it waits for play
    playback.playing = True
    clock.now = 2.5
    assert list(playback.take_frame().x) == [1.0]
    playback.playing = False
    clock.now = 3.5
    assert playback.take_frame() is None
    playback.seek(2.0)
    assert list(playback.take_frame().x) == [2.0]
    playback.playing, playback.speed = True, 5.0
    clock.now = 4.0
    assert list(playback.take_frame().x) == [3.0]
    assert not playback.playing
    playback.seek(-7.0)
    assert playback.position == 0.0


def test_a_recorded_design_whose_arrays_do_not_fit_is_left_out(tmp_path):
    good, bad = (design_of('double_integrator', [1.0, 1.0], [1.0]) for _ in range(2))
    bad.p = [1.0]
    playback = Playback(record(tmp_path / 'a.mcap', [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]], others=[
        (0, '/lqr_node/design', good), (1, '/lqr_node/design', bad)]))
    playback.seek(2.0)
    assert playback.take_frame().cost == pytest.approx(4 * good.p[0])


def test_a_design_with_integrals_is_shown(tmp_path):
    """It has a pole for each integral, beyond those of the states."""
    design = design_of('double_integrator', [1.0, 1.0], [1.0])
    for name in ('poles_real', 'poles_imag', 'damping'):
        setattr(design, name, [*getattr(design, name), -1.0])
    playback = Playback(record(tmp_path / 'a.mcap', [[0.0, 0.0], [1.0, 0.0]], others=[
        (0, '/lqr_node/design', design)]))
    playback.take_frame()
    assert list(playback.design.poles_real) == list(design.poles_real)


@pytest.mark.nodes
def test_no_message_ends_the_client_of_the_loop(domain, probe, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    designs = probe.node.create_publisher(LqrDesign, 'lqr_node/design', LATCHED)
    states = probe.node.create_publisher(State, 'state', 10)
    plans = probe.node.create_publisher(Trajectory, 'mpc_node/plan', 10)
    estimates = probe.node.create_publisher(Estimate, 'estimator_node/estimate', 10)
    good = design_of('double_integrator', [1.0, 1.0], [1.0])
    with closing(LoopClient()) as client:
        designs.publish(good)
        probe.wait_for(lambda: client.design is not None, what='the design')
        for name in ('xe', 'a', 'b', 'k', 'p', 'poles_imag', 'peak_input'):
            for values in ([], [math.nan] * 3, [1.0] * 50):
                bad = design_of('double_integrator', [1.0, 1.0], [1.0])
                setattr(bad, name, values)
                designs.publish(bad)
        designs.publish(LqrDesign(system='../../etc/passwd'))
        for x in ([], [math.nan], [1.0] * 1000):
            states.publish(State(x=x))
            plans.publish(Trajectory(t=[0.0, math.inf], x=x, u=x, state_names=['a', 'b']))
            estimates.publish(Estimate(x=x, covariance=x))

        def is_read() -> bool:
            states.publish(State(x=[2.0, 0.0]))
            probe.spin_for(0.05)
            frame = client.take_frame()
            return frame is not None and frame.cost == pytest.approx(4 * good.p[0])

        probe.wait_for(is_read, what='a frame')
        assert sum('do not fit' in line for _, line in client.list_lines()) > 0
        assert list(client.design.p) == list(good.p)


def status(name: str, message: str = '', **values: str) -> DiagnosticStatus:
    """Return a status of diagnostics."""
    return DiagnosticStatus(name=name, message=message, values=[
        KeyValue(key=key.replace('_', ' '), value=value) for key, value in values.items()])


@pytest.mark.parametrize(('given', 'expected', 'sentence'), [
    (status('', 'within the limits', mode='SET_POINT'), ShownMode('SET_POINT'), 'set point'),
    (status('', 'x', mode='RESTING', mode_reason='no state for 0.6 s'),
     ShownMode('RESTING', 'no state for 0.6 s'), 'resting: no state for 0.6 s'),
    (status('', 'stopped: by ~/stop', mode='STOPPED', mode_reason='by ~/stop'),
     ShownMode('STOPPED', 'by ~/stop'), 'STOPPED: by ~/stop'),
    (status('', 'of a node that names no mode'), ShownMode(), 'mode not known'),
    (status('', '', mode=HOSTILE, mode_reason='y' * 10**6), ShownMode(HOSTILE, 'y' * 200),
     f'{HOSTILE.lower()}: {"y" * 200}'),
])
def test_the_mode_is_read_from_diagnostics(given, expected, sentence):
    assert read_mode(given) == expected
    assert expected.sentence == sentence


@pytest.mark.nodes
def test_the_mode_is_that_of_the_controller_in_the_namespace(domain, probe, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    with closing(LoopClient('robot1')) as client:
        publisher = probe.publisher(DiagnosticArray, '/diagnostics')
        assert client.mode == ShownMode('', 'no diagnostics of lqr_node yet')

        def shows(expected: ShownMode) -> bool:
            publisher.publish(DiagnosticArray(status=[
                status('robot1/lqr_node: states', mode='PLAN'),
                status('lqr_node: commands', mode='PLAN'),
                status('robot1/mpc_node: commands', mode='PLAN'),
                status('robot1/lqr_node: commands', mode='REFERENCE')]))
            return client.mode == expected

        probe.wait_for(lambda: shows(ShownMode('REFERENCE')))
        now = time.monotonic() + NEWS
        monkeypatch.setattr(time, 'monotonic', lambda: now)
        assert client.mode == ShownMode(
            '', 'no diagnostics of lqr_node any more; the last mode was reference')


@pytest.mark.nodes
def test_stop_reaches_each_controller_that_there_is(domain, probe, monkeypatch):
    """Whichever has published the last design; without any the answer is in words."""
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    asked = []

    def answer(_, response):
        asked.append(1)
        response.success, response.message = True, 'stopped at [0.0]'
        return response

    with closing(LoopClient()) as client:
        assert 'there is no service lqr_node/stop' in asyncio.run(client.stop())
        probe.node.create_service(Trigger, 'mpc_node/stop', answer)
        probe.wait_for(client._clients['mpc_node/stop'].service_is_ready)
        found = []
        thread = threading.Thread(target=lambda: found.append(asyncio.run(client.stop())))
        thread.start()
        probe.wait_for(lambda: found)
        thread.join()
        assert found == ['mpc_node: stopped at [0.0]'] and asked == [1]
        client.controller = 'mpc_node'
        assert client.mode == ShownMode('STOPPED', 'by ~/stop')


@pytest.mark.parametrize(('contents', 'why'), [
    (b'', 'is not a recording'), (b'no recording at all', 'is not a recording'),
    (None, 'no such recording')])
def test_what_is_no_recording_is_rejected(tmp_path, contents, why):
    file = tmp_path / 'a.mcap'
    if contents is not None:
        file.write_bytes(contents)
    with pytest.raises(ObcError, match=why):
        Playback(file)


@pytest.mark.filterwarnings('error::RuntimeWarning')
def test_a_recording_with_a_flipped_byte_plays_or_is_rejected_in_words(tmp_path):
    design = design_of('double_integrator', [1.0, 1.0], [1.0])
    plan = Trajectory(state_names=['px', 'v'], t=[0.0, 1.0], x=[0.0, 1.0, 2.0, 3.0])
    file = record(tmp_path / 'a.mcap', [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]], others=[
        (0, '/lqr_node/design', design), (1, '/reference', plan), (1, '/mpc_node/plan', plan),
        (1, '/estimator_node/estimate', Estimate(x=[0.0, 0.0], covariance=[1.0, 0.0, 0.0, 1.0])),
        (1, '/rosout', Log(level=40, name='a', msg='b')),
        (1, '/diagnostics', DiagnosticArray(status=[status('a: commands', mode='PLAN')]))])
    contents, draw = file.read_bytes(), np.random.default_rng(46)
    for place in draw.integers(len(contents), size=300):
        mutant = bytearray(contents)
        mutant[place] ^= int(draw.integers(1, 256))
        file.write_bytes(mutant)
        try:
            playback = Playback(file)
        except ObcError:
            continue
        for moment in np.linspace(0.0, playback.duration, 5):
            playback.seek(moment)
            if frame := playback.take_frame():
                frame.pack(0)


def test_the_events_of_a_recording_are_listed_in_order(tmp_path):
    """A first design, a repeated warning and an unchanged mode are none."""
    designs = [design_of('double_integrator', [q, 1.0], [1.0]) for q in (1.0, 1.0, 4.0)]
    designs[1].xe = [1.0, 0.0]
    designs[2].xe = [1.0, 0.0]
    reset = State(x=[0.0, 0.0], restarts=1)
    modes = [DiagnosticArray(status=[status('lqr_node: commands', mode=mode, mode_reason=why)])
             for mode, why in (('SET_POINT', ''), ('SET_POINT', ''), ('STOPPED', 'by ~/stop'))]
    lines = [Log(level=level, name='lqr_node', msg=text) for level, text in (
        (20, 'quiet'), (30, 'late'), (30, 'late'))]
    path = Trajectory(t=[0.0, 1.0])
    file = record(tmp_path / 'a.mcap', [[0.0, 0.0]] * 9, others=[
        *((second, '/lqr_node/design', each) for second, each in enumerate(designs)),
        (3, '/reference', path), (4, '/reference', Trajectory()), (5, '/state', reset),
        *((second, '/diagnostics', each) for second, each in zip(
            (5, 6, 6), modes, strict=True)),
        *((second, '/rosout', each) for second, each in zip((0, 7, 8), lines, strict=True)),
        (20, '/reference', path)])   # after the last state
    events = Playback(file).events
    assert [(round(each.time, 6), each.words) for each in events] == [
        (1.0, 'set point'), (2.0, 'weights'), (3.0, 'reference'), (4.0, 'end of the reference'),
        (5.0, 'reset'), (6.0, 'STOPPED: by ~/stop'), (6.0, 'reset'), (7.0, 'lqr_node: late')]
    assert describe_scene(Playback(file).plant, events)['marks'][0] == [1.0, 'set point']


def test_the_first_fifty_events_of_a_recording_are_listed(tmp_path):
    file = record(tmp_path / 'a.mcap', [[0.0]] * 80, others=[
        (second, '/reference', Trajectory(t=[0.0])) for second in range(80)])
    *listed, last = Playback(file).events
    assert [round(each.time) for each in listed] == list(range(50))
    assert (round(last.time), last.words) == (50, '30 more events from here on, not listed')


def test_two_loops_of_a_recording_are_not_mixed(tmp_path):
    """Each has its states, its design and its log; diagnostics of both are in one message."""
    modes = [DiagnosticArray(status=[status('a/lqr_node: commands', mode=mode),
                                     status('fleet/b/lqr_node: commands', mode='PLAN')])
             for mode in ('PLAN', 'STOPPED')]
    file = record(tmp_path / 'a.mcap', [[0.0], [1.0], [2.0]], '/a/state', [
        *((second, '/fleet/b/state', State(x=[7.0, 0.0])) for second in range(3)),
        (0, '/fleet/b/lqr_node/design', design_of('double_integrator', [1.0, 1.0], [1.0])),
        *((second, '/diagnostics', each) for second, each in enumerate(modes)),
        *((1, '/rosout', Log(level=30, name=name, msg='late')) for name in (
            'a.lqr_node', 'fleet.b.lqr_node'))])
    with pytest.raises(ObcError, match='choose a loop with --namespace: /a, /fleet/b$'):
        Playback(file)
    with pytest.raises(ObcError, match='choose a loop with --namespace: /a, /fleet/b$'):
        Playback(file, 'c')
    first, second = Playback(file, 'a'), Playback(file, '/fleet/b/')
    assert first.plant.state_names == ('x1',) and first.design is None
    assert [each.words for each in first.events] == ['STOPPED', 'a.lqr_node: late']
    assert second.plant.system == 'double_integrator'
    assert list(second.take_frame().x) == [7.0, 0.0]
    assert [each.words for each in second.events] == ['fleet.b.lqr_node: late']


def test_a_recording_without_states_is_rejected(tmp_path):
    with pytest.raises(ObcError, match='no messages of the topic state'):
        Playback(record(tmp_path / 'a.mcap', [[1.0]], '/other'))


@pytest.mark.parametrize(('words', 'why'), [
    (['--host', '203.0.113.7'], 'cannot be served at'), (['--port', '-1'], 'cannot be served at'),
    (['no.mcap'], 'no such recording')])
def test_the_command_says_why_there_is_no_page(capsys, words, why):
    assert main(['view', '--no-browser', *(['--port', '0'] if '--port' not in words else []),
                 *words]) == 1
    assert why in capsys.readouterr().err


@pytest.mark.parametrize(('wanted', 'refusal', 'priority', 'said'), [
    (None, '', command.LOOP_PRIORITY, ''), (0, 'never asked', 0, ''), (30, '', 30, ''),
    (None, 'priority = 50: not permitted', 0, 'priority = 50: not permitted')])
def test_the_loop_has_a_real_time_priority_where_it_may(
        monkeypatch, capsys, wanted, refusal, priority, said):
    monkeypatch.setattr(command, 'find_priority_refusal', lambda asked: refusal)
    assert command.choose_priority(wanted) == priority
    assert said in capsys.readouterr().out


def test_a_given_priority_that_is_not_allowed_is_an_error(monkeypatch):
    monkeypatch.setattr(
        command, 'find_priority_refusal', lambda asked: f'priority = {asked}: not permitted')
    with pytest.raises(ObcError, match='--priority 30: not permitted'):
        command.choose_priority(30)


@pytest.mark.parametrize('text', ['-1', '100', 'x', '1.5', '', 'nan'])
def test_a_priority_is_a_whole_number(capsys, text):
    with pytest.raises(SystemExit):
        main(['view', f'--priority={text}'])
    assert 'a whole number from 0 to 99' in capsys.readouterr().err


@pytest.mark.parametrize(('x', 'u'), [([4.0, 0.0], [100.0]), ([0.25, 1e-4], [3.0])])
def test_weights_as_deviations_give_the_same_cost_and_return(x, u):
    """By Bryson's rule each weight times the square of its deviation is 1."""
    scales = convert_weights('bryson', x, u)
    weights = from_bryson(2, 1, scales['x_max'], scales['u_max'])
    assert np.allclose(np.diag(weights.Qx), x, rtol=1e-11)
    assert np.allclose(np.diag(weights.Qu), u, rtol=1e-11)
    back = convert_weights('matrices', *scales.values())
    assert list(back) == ['Qx', 'Qu']
    assert np.allclose(back['Qx'], x, rtol=1e-10) and np.allclose(back['Qu'], u, rtol=1e-10)


@pytest.mark.parametrize(('mode', 'x', 'u', 'why'), [
    ('bryson', [-1.0], [1.0], r'Qx\[0\] = -1'), ('bryson', [1.0], [0.0], r'Qu\[0\] = 0'),
    ('matrices', [0.0], [1.0], r'x_max\[0\] = 0'), ('matrices', [1.0], [-2.0], r'u_max\[0\] = -2'),
    ('bryson', [np.nan], [1.0], r'Qx\[0\] = nan')])
def test_what_has_no_deviation_is_named(mode, x, u, why):
    with pytest.raises(ObcError, match=why):
        convert_weights(mode, x, u)


def test_a_switching_function_tells_where_an_input_is_at_its_bounds():
    """Minimum time to rest: dH/du = lam2 is linear in time, and 0 at the middle of the way."""
    x, u, lam, t = solve_double_integrator()
    request = PlanMotion.Request(system='double_integrator', start=[0.0, 0.0], goal=[1.0, 0.0],
                                 objective='time', input_bounds=[
                                     NamedBounds(name='u', lower='-1', upper='1')])
    path = Trajectory(t=t, x=np.ravel(x), u=np.ravel(u), lam=np.ravel(lam))
    [(name, values)] = compute_switching(request, path).items()
    assert name == systems['double_integrator'].inputs[0]
    assert np.allclose(values, lam[:, 1], atol=1e-12)
    assert (np.sign(values[np.abs(values) > 1e-9]) == -np.sign(
        u[np.abs(values) > 1e-9, 0])).all()


@pytest.mark.parametrize('change', [
    {'system': 'plant_of_a_file'}, {'path_constraints': ['v - 1']},
    {'state_bounds': [NamedBounds(name='v', lower='-1', upper='1')]}])
def test_no_switching_function_where_the_request_does_not_tell_it(change):
    """A plant of the server's files is not known here; constraints add multipliers to dH/du."""
    x, u, lam, t = solve_double_integrator()
    asked = {'system': 'double_integrator', 'start': [0.0, 0.0], 'goal': [1.0, 0.0],
             'objective': 'time', 'input_bounds': [NamedBounds(name='u', lower='-1', upper='1')]}
    path = Trajectory(t=t, x=np.ravel(x), u=np.ravel(u), lam=np.ravel(lam))
    assert compute_switching(PlanMotion.Request(**{**asked, **change}), path) == {}


def solve_double_integrator():
    """Return the path from (0, 0) to (1, 0) in minimum time for |u| <= 1, in closed form."""
    t = np.linspace(0.0, 2.0, 41)
    first = t <= 1.0
    x = np.stack([np.where(first, t**2 / 2, 1 - (2 - t)**2 / 2), np.where(first, t, 2 - t)], 1)
    lam = np.stack([np.full_like(t, -1.0), t - 1.0], 1)   # H = 1 + lam1 x2 + lam2 u = 0
    return x, np.where(first, 1.0, -1.0)[:, None], lam, t


def test_no_switching_function_without_bounds_or_costates():
    x, u, lam, _ = solve_double_integrator()
    problem = build_problem({
        'states': ['p', 'v'], 'inputs': ['u'], 'dynamics': {'p': 'v', 'v': 'u'},
        'initial_state': {'p': 0, 'v': 0}, 'running_cost': 'u**2',
        'final_time': {'free': False, 'value': 2}})
    assert find_switching_functions(problem, x, u, lam) == {}
    bounded = build_problem({
        'states': ['p', 'v'], 'inputs': ['u'], 'dynamics': {'p': 'v', 'v': 'u'},
        'initial_state': {'p': 0, 'v': 0}, 'running_cost': '1', 'input_bounds': {'u': [-1, 1]},
        'final_time': {'free': False, 'value': 2}})
    assert find_switching_functions(bounded, x, u, lam[:0]) == {}
    assert find_switching_functions(bounded, x, u, 0.0 * lam) == {}
    assert list(find_switching_functions(bounded, x, u, lam)) == ['u']


def test_a_reference_is_packed_in_the_order_of_the_plant():
    plant = Plant('a', (Named('p'), Named('v')), (Named('u'),))
    path = Trajectory(state_names=['v', 'p'], t=[0.0, 1.0], x=[1.0, 2.0, 3.0, np.nan])
    assert FollowedPath(5.0, path).pack(plant, 10) == [[5.0, 2.0, 1.0], [6.0, None, 3.0]]
    for other in (Trajectory(state_names=['p'], t=[0.0], x=[1.0]), Trajectory(),
                  Trajectory(state_names=['v', 'p'], t=[0.0, 1.0], x=[1.0])):
        assert FollowedPath(5.0, other).pack(plant, 10) == []
    long = Trajectory(state_names=['p', 'v'], t=np.arange(5000.0), x=np.zeros(10_000))
    rows = FollowedPath(0.0, long).pack(plant, 400)
    assert len(rows) <= 400 and (rows[0][0], rows[-1][0]) == (0.0, 4999.0)


def test_the_rows_of_a_prediction_have_the_inputs_too():
    plant = Plant('a', (Named('p'), Named('v')), (Named('f'), Named('g')))
    path = Trajectory(state_names=['v', 'p'], input_names=['g', 'f'], t=[0.0, 0.5],
                      x=[1.0, 2.0, 3.0, 4.0], u=[5.0, 6.0, 7.0, 8.0])
    assert FollowedPath(1.0, path).pack(plant, 10, inputs=True) == [
        [1.0, 2.0, 1.0, 6.0, 5.0], [1.5, 4.0, 3.0, 8.0, 7.0]]
    path.u = path.u[:-1]
    assert FollowedPath(1.0, path).pack(plant, 10, inputs=True) == []


@given(st.floats(-math.pi, math.pi), st.floats(1e-2, 1e2), st.floats(1e-2, 1e2))
def test_the_ellipse_is_that_of_the_chi_square_distribution(angle, first, second):
    """All its points have the distance that 95 % of the errors do not exceed."""
    plant = Plant('a', (Named('py'), Named('v'), Named('px')), (Named('u'),), 'vertical')
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    places = turn @ np.diag([first**2, second**2]) @ turn.T   # of px, py
    P = np.eye(3)
    P[np.ix_([2, 0], [2, 0])] = places
    shown = describe_uncertainty(plant, Estimate(covariance=P.ravel()))
    a, b, direction = shown.ellipse
    way = np.linspace(0.0, 2.0 * np.pi, 12)
    c, s = np.cos(direction), np.sin(direction)
    points = np.array([[c, -s], [s, c]]) @ [a * np.cos(way), b * np.sin(way)]
    distances = np.sum(points * np.linalg.solve(places, points), axis=0)
    assert np.allclose(distances, chi2.ppf(0.95, 2), rtol=1e-6)
    assert np.allclose(shown.band, norm.ppf(0.975) * np.sqrt(P.diagonal()), rtol=1e-12)


@pytest.mark.parametrize('covariance', [[], [1.0], [1.0, 0.0, 0.0], [1.0, math.nan, 0.0, 1.0],
                                        [math.inf, 0.0, 0.0, 1.0]])
def test_a_covariance_of_other_states_is_not_shown(covariance):
    plant = Plant('a', (Named('px'), Named('py')), (), 'vertical')
    assert describe_uncertainty(plant, Estimate(covariance=covariance)) is None


def test_an_ellipse_that_is_too_large_for_a_number_is_not_shown():
    plant = Plant('a', (Named('px'), Named('py')), (), 'vertical')
    shown = describe_uncertainty(plant, Estimate(covariance=[1e308] * 4))
    assert shown.ellipse == () and np.isfinite(shown.band).all()


@pytest.mark.parametrize('covariance', [[0.0] * 4, [4.0, 2.0, 2.0, 1.0], [-1e-20, 0.0, 0.0, 0.0]])
def test_an_ellipse_may_be_a_line_or_a_point(covariance):
    plant = Plant('a', (Named('px'), Named('py')), (), 'vertical')
    a, b, _ = describe_uncertainty(plant, Estimate(covariance=covariance)).ellipse
    trace = max(covariance[0] + covariance[3], 0.0)   # the larger variance: the other one is 0
    assert a == pytest.approx(0.0, abs=1e-7)
    assert b**2 == pytest.approx(chi2.ppf(0.95, 2) * trace)


def test_a_plant_without_a_plane_has_bands_only():
    plant = Plant('a', (Named('p'), Named('v')), ())
    shown = describe_uncertainty(plant, Estimate(covariance=[4.0, 0.0, 0.0, -1e-20]))
    assert shown.ellipse == () and shown.band[1] == 0.0
    assert Frame(0.0, [0.0, 0.0], uncertainty=shown).pack(1)['band'] == shown.band


def test_a_prediction_is_sent_once_to_each_page():
    sent: list[Any] = []
    page = SimpleNamespace(_sent=0, _seen=0, _predicted=(),
                           run_method=lambda name, packed, age: sent.append(packed))
    rows = [[0.0, 1.0]]
    for prediction in ((), rows, rows, (), rows):
        LoopCanvas.push(page, Frame(0.0, [1.0], prediction=prediction))
    assert [each.get('prediction') for each in sent] == [None, rows, None, (), rows]


@pytest.mark.parametrize('frame', [None, Frame(1.0, [2.0])])
def test_a_page_that_opens_is_sent_the_last_frame_and_its_age(monkeypatch, frame):
    """A paused plant sends no other: its picture says for how long."""
    monkeypatch.setattr(time, 'monotonic', lambda: 12.0)
    shown: list[Any] = []
    viewer = SimpleNamespace(frame=frame, _arrived=5.0, _canvases={}, helm=Helm(True))
    canvas = SimpleNamespace(push=lambda *given: shown.append(given))
    Viewer.add(viewer, 'a', canvas)
    assert shown == ([(frame, 7.0)] if frame else [])
    assert viewer._canvases == {'a': canvas} and not viewer.helm.has('a')


def test_a_recording_shows_prediction_and_uncertainty(tmp_path, monkeypatch):
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(time, 'monotonic', lambda: clock.now)
    plan = Trajectory(state_names=['x1'], t=[0.0, 1.0], x=[5.0, 6.0])
    plan.header.stamp.sec = 101
    states = [(f'{second}', State(x=[float(second)])) for second in range(3)]
    for second, state in states:
        state.header.stamp.sec = 100 + int(second)
    playback = Playback(record(tmp_path / 'a.mcap', [], others=[
        *((int(second), '/state', state) for second, state in states),
        (1, '/mpc_node/plan', plan),
        (1, '/estimator_node/estimate', Estimate(x=[0.0], covariance=[4.0]))]))
    frame = playback.take_frame()
    assert list(frame.prediction) == [] and frame.uncertainty is None
    playback.playing = True
    clock.now = 1.5
    frame = playback.take_frame()
    assert frame.prediction == [[1.5, 5.0], [2.5, 6.0]]   # it begins at the stamp of the state
    assert frame.uncertainty.band == pytest.approx([2.0 * norm.ppf(0.975)])


@pytest.mark.parametrize(('units', 'title'), [
    (('cost', 's'), 'a [cost/s]'), (('cost', 's', 'm/s'), 'a [cost/s/(m/s)]'),
    (('cost', ''), 'a [cost]'), (('',), 'a')])
def test_a_unit_is_that_of_the_quotient(units, title):
    assert add_unit('a', *units) == title


def test_a_set_point_that_moves_is_shown_beside_the_plant():
    """The vehicle's set point drives along px: only its distance across the course is known."""
    system = systems['vehicle']
    names = list(system.states)
    design = LqrDesign(system='vehicle', state_names=names, input_names=list(system.inputs),
                       xe=[0.0, -2.0, 0.0], ue=[10.0, 0.0], p=np.eye(3).ravel())
    held = SetPoint(design)
    assert np.allclose(held.locate([300.0, 1.0, 0.1]), [300.0, -2.0, 0.0], atol=1e-12)
    assert np.isnan(held.measure_cost([300.0, 1.0, 0.1]))
    assert list(held.locate([1.0])) == [0.0, -2.0, 0.0]


@pytest.mark.parametrize('ue', [[0.0, 30.0], [0.0, 45.0]])
def test_a_hover_of_another_mass_is_at_rest(ue):
    """Its thrust is not that of the registered mass: the aircraft would fall, not move on."""
    names = list(systems['aircraft'].states)
    design = LqrDesign(system='aircraft', state_names=names, xe=[0.0] * 6, ue=ue,
                       input_names=list(systems['aircraft'].inputs), p=np.eye(6).ravel())
    assert list(SetPoint(design).locate([1.0, 2.0, *[0.0] * 4])) == [0.0] * 6
    assert SetPoint(design).measure_cost([1.0, 2.0, *[0.0] * 4]) == 5.0
    assert not any(each.moves for each in describe_plant(design).states)


def test_a_new_set_point_may_begin_to_move():
    """The vehicle stops and drives on: px has a plot of its own only while it drives."""
    client = SimpleNamespace(controller='lqr_node', plant=None, design=None, _given=None)
    for speed in (0.0, 10.0, 0.0):
        design = design_of('vehicle', [1.0] * 3, [1.0] * 2)
        design.ue = [speed, 0.0]
        LoopClient._on_design(client, 'lqr_node', design)
        assert [each.moves for each in client.plant.states] == [speed > 0.0, False, False]


def test_a_loop_that_follows_a_reference_holds_its_end():
    """Until the reference is withdrawn; the cost-to-go is that of the way to it."""
    design = design_of('double_integrator', [1.0, 1.0], [1.0])
    names = [each.name for each in describe_plant(design).states]
    path = FollowedPath(0.0, Trajectory(t=[0.0, 1.0, 2.0], x=[0.0, 0.0, 9.0, 9.0, 0.0, 3.0],
                                        state_names=names[::-1]))
    client = SimpleNamespace(design=design, plant=describe_plant(design), _held=(None, None))
    for reference, point in ((None, [0.0, 0.0]), (path, [3.0, 0.0]), (None, [0.0, 0.0])):
        client.reference = reference
        held = LoopClient._find_held(client)
        assert list(held.locate([1.0, 1.0])) == point
        assert held.measure_cost(point) == 0.0
    assert held.measure_cost([3.0, 0.0]) > 0.0
    client.reference = FollowedPath(0.0, Trajectory(t=[0.0], x=[1.0], state_names=['other']))
    assert list(LoopClient._find_held(client).locate([1.0, 1.0])) == [0.0, 0.0]


def test_a_set_point_at_rest_stays():
    design = design_of('double_integrator', [1.0, 1.0], [1.0])
    held = SetPoint(design)
    assert list(held.locate([3.0, 4.0])) == [0.0, 0.0]
    assert held.measure_cost([3.0, 4.0]) == measure_cost(design, [3.0, 4.0])
    assert list(SetPoint(LqrDesign(system=HOSTILE, xe=[1.0])).locate([2.0])) == [1.0]


@pytest.mark.nodes
def test_plan_and_covariance_of_other_nodes_are_shown_with_the_state(probe, domain, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    with closing(LoopClient()) as client:
        designs, plans, estimates, states = (probe.publisher(*each) for each in (
            (LqrDesign, 'mpc_node/design', LATCHED), (Trajectory, 'mpc_node/plan'),
            (Estimate, 'estimator_node/estimate'), (State, 'state')))
        designs.publish(design_of('double_integrator', [1.0, 1.0], [1.0]))
        probe.wait_for(lambda: client.plant)
        assert client.controller == 'mpc_node' and not client.is_lqr
        names = client.plant.state_names
        plan = Trajectory(state_names=list(names), input_names=['u'], t=[0.0, 0.5],
                          x=[1.0, 2.0, 3.0, 4.0], u=[5.0, 6.0])
        estimate, state = Estimate(covariance=[4.0, 0.0, 0.0, 1.0]), State(x=[1.0, 2.0])
        for message in (plan, estimate, state):
            message.header.stamp.sec = 10
        frames = []

        def see(known: bool) -> bool:
            for publisher, message in ((plans, plan), (estimates, estimate), (states, state)):
                publisher.publish(message)
            frames.append(client.take_frame())
            return bool(frames[-1] and (frames[-1].uncertainty is not None) == known
                        and frames[-1].time == state.header.stamp.sec)

        probe.wait_for(lambda: see(True))
        assert frames[-1].prediction == [[10.0, 1.0, 2.0, 5.0], [10.5, 3.0, 4.0, 6.0]]
        assert frames[-1].uncertainty.band == pytest.approx([2.0 * norm.ppf(0.975),
                                                             norm.ppf(0.975)])
        state.header.stamp.sec = 12   # the estimate is not that of this state
        probe.wait_for(lambda: see(False))
