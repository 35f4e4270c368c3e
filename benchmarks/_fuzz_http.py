# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Bytes that arrive at the page of `obc view`, for _fuzz.py.

They pass the protocols of uvicorn and the page's own checks, without a socket. A request may reach
the application only if an independent reading of its headers allows that.
"""

import asyncio
import logging
import re
from typing import Any

from obc_ros.view.access import COOKIE, Gate, HeaderDeadline
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.server import ServerState

TOKEN = 'a-token'
LOOPS = 50   # of the event loop between two pieces, at most
OWN_HOST = re.compile(rb'(127\.0\.0\.1|localhost|\[::1\])(:\d*)?', re.IGNORECASE)
BEGIN = b'GET / HTTP/1.1\r\nHost: localhost\r\nCookie: ' + f'{COOKIE}={TOKEN}\r\n'.encode()
UPGRADE = (b'Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n'
           b'Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n')
PIECES = [
    BEGIN, BEGIN + b'\r\n', BEGIN + UPGRADE, BEGIN + UPGRADE + b'\r\n', UPGRADE,
    b'GET / HTTP/1.1\r\n', b'POST /x?token=a-token HTTP/1.1\r\n', b'GET /?token=', b'\r\n',
    b'\r\n\r\n', b'Host: ', b'host:', b'Origin: ', b'Cookie: ', COOKIE.encode() + b'=',
    TOKEN.encode(), b'localhost', b'localhost:8080', b'127.0.0.1', b'[::1]:8080', b'[::1', b'@',
    b'evil.example', b'http://', b'https://', b'null', b'://', b'/', b'?', b'#', b' ', b'\t', b',',
    b';', b'"', b'\x00', b'\xff', b'Content-Length: 5\r\n', b'Content-Length: -1\r\n',
    b'Transfer-Encoding: chunked\r\n', b'5\r\nhello\r\n', b'0\r\n\r\n', b'ffffffffffffffff\r\n',
    b'Connection: close\r\n', b'Expect: 100-continue\r\n', b' HTTP/1.0\r\n', b' HTTP/1.1\r\n',
    b'\x81\x82\0\0\0\0hi',
    b'PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n', b'Host: localhost\r\n']


class Errors(logging.Handler):
    """Keeps what uvicorn logs as an error: an exception that nothing has caught."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.found: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a record."""
        self.found.append(self.format(record))


class Transport(asyncio.Transport):
    """A connection whose other end reads nothing."""

    def __init__(self, protocol: Any) -> None:
        super().__init__({'peername': ('127.0.0.1', 40_000), 'sockname': ('127.0.0.1', 8080)})
        self.protocol, self.closed, self.written = protocol, False, b''

    def write(self, data: Any) -> None:
        """Keep what is written."""
        self.written += bytes(data)

    def close(self) -> None:
        """Close the connection."""
        self.closed = True

    abort = close

    def is_closing(self) -> bool:
        """Return whether it is closed."""
        return self.closed

    def get_protocol(self) -> Any:
        """Return what reads it."""
        return self.protocol

    def set_protocol(self, protocol: Any) -> None:
        """Let another protocol read it."""
        self.protocol = protocol

    def pause_reading(self) -> None:
        """Go on: the data come from a list."""

    resume_reading = pause_reading
    get_write_buffer_size = int


async def answer(scope: Any, receive: Any, send: Any) -> None:
    """Answer a request that the page accepts, after the headers were read a second time."""
    given = [(name.lower(), value) for name, value in scope['headers']]
    hosts, origins, cookies = ([value for name, value in given if name == wanted]
                               for wanted in (b'host', b'origin', b'cookie'))
    assert len(hosts) <= 1, hosts
    for origin in origins:
        assert hosts and origin.split(b'://', 1)[1:] == hosts, (hosts, origins)
    if scope['state']['token']:
        assert any(COOKIE.encode() in each and TOKEN.encode() in each for each in cookies), given
    else:
        assert OWN_HOST.fullmatch(hosts[0]), hosts
    if scope['type'] == 'http':
        while (await receive()).get('more_body'):
            pass
        await send({'type': 'http.response.start', 'status': 200, 'headers': []})
        await send({'type': 'http.response.body', 'body': b'ok'})
    elif (await receive())['type'] == 'websocket.connect':
        await send({'type': 'websocket.accept'})
        while (await receive())['type'] != 'websocket.disconnect':
            pass


async def exchange(pieces: list[bytes], base: type, token: str, errors: Errors) -> None:
    """Let a protocol read pieces of a connection, and the end of it."""
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda _, context: errors.found.append(str(context)))
    config = uvicorn.Config(Gate(answer, token), lifespan='off', log_config=None)
    config.load()
    state = ServerState()
    protocol = type('Protocol', (HeaderDeadline, base), {})(
        config=config, server_state=state, app_state={'token': token})
    transport = Transport(protocol)
    protocol.connection_made(transport)
    for piece in pieces:
        if transport.closed:
            break
        transport.protocol.data_received(piece)
        for _ in range(LOOPS):
            await asyncio.sleep(0)
            # An assertion of uvicorn fails for frames that do not wait for the handshake: asyncio
            # logs it and closes the connection.
            if transport.closed or getattr(transport.protocol, 'handshake_complete', True):
                break
        if transport.protocol is protocol and not transport.closed:
            assert protocol._deadline is not None or protocol.cycle is not None, 'waits for ever'
    if not transport.closed:
        transport.protocol.eof_received()
    transport.protocol.connection_lost(None)
    if transport.protocol is not protocol:
        protocol.connection_lost(None)
    await asyncio.gather(*state.tasks)


def http(data: Any) -> None:
    """Send bytes in pieces to the page."""
    errors = Errors()
    logging.getLogger('uvicorn.error').addHandler(errors)
    base = data.PickValueInList([HttpToolsProtocol, H11Protocol])
    token = data.PickValueInList(['', TOKEN])
    pieces = [b''.join(
        data.PickValueInList(PIECES) if data.ConsumeBool() else data.ConsumeBytes(
            data.ConsumeIntInRange(0, 20)) for _ in range(data.ConsumeIntInRange(1, 12)))
        for _ in range(data.ConsumeIntInRange(1, 4))]
    try:
        asyncio.run(exchange([each for each in pieces if each], base, token, errors))
    finally:
        logging.getLogger('uvicorn.error').removeHandler(errors)
    assert not errors.found, errors.found[0]
