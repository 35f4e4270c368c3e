# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Who may open the page, and who may control the loop.

The page is for this machine unless `--host` says otherwise; then it asks for a token. Requests of
pages of other sites are rejected: a browser sends their origin.
"""

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping, MutableMapping, Sequence
import hmac
import re
import secrets
from typing import Any
from urllib.parse import parse_qs

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Any]]
Send = Callable[[Any], Awaitable[None]]

COOKIE = 'obc_view_token'
OWN_NAMES = '127.0.0.1', 'localhost', '[::1]'
HEADER_TIME = 10.0   # [s] from the first byte of a request, or the connection, to its whole header
NO_FRAMES = ((b'content-security-policy', b"frame-ancestors 'none'"),
             (b'x-frame-options', b'DENY'))
_ADDRESS = re.compile(r'([\w.-]+|\[[\da-f:.]+\])(:\d*)?', re.ASCII | re.IGNORECASE)
FORM = (b'<!doctype html><meta charset=utf-8><title>obc view</title>'
        b'<meta name=viewport content="width=device-width, initial-scale=1">'
        b'<form method=get><label>Token that obc view has printed: '
        b'<input name=token type=password autofocus></label> <button>Open</button></form>')


class Gate:
    """ASGI middleware: rejects requests from other sites and, with a token, those without it."""

    def __init__(self, app: Any, token: str = '') -> None:
        self._app, self._token = app, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request, or answer it with 400 or 403."""
        if scope['type'] not in ('http', 'websocket'):
            await self._app(scope, receive, send)
            return
        headers = _collect(scope['headers'])
        try:
            is_own = self._is_own(headers)
        except ValueError:
            await _reject(scope, send, b'the header Host or Origin is malformed', 400)
            return
        if not is_own:
            await _reject(scope, send, b'this page is served to its own address only')
        elif not self._token or _has_cookie(headers.get('cookie', ()), self._token):
            await self._app(scope, receive, _forbid_frames(send))
        elif scope['type'] == 'http' and self._gives_token(scope):
            await _admit(send, self._token)
        else:
            await _reject(scope, send, FORM)

    def _is_own(self, headers: Mapping[str, Sequence[str]]) -> bool:
        """Return whether a request comes from this page and, without a token, to this machine."""
        hosts, origins = headers.get('host', ()), headers.get('origin', ())
        names = [_read_name(host) for host in hosts]
        sites = [origin.partition('://')[2] for origin in origins]
        for site in filter(None, sites):
            _read_name(site)
        if len(hosts) > 1 or len(origins) > 1:
            raise ValueError
        return set(sites) <= set(hosts) and (bool(self._token) or (
            bool(names) and names[0] in OWN_NAMES))

    def _gives_token(self, scope: Scope) -> bool:
        query = parse_qs(scope.get('query_string', b'').decode('latin-1'))
        given = query.get('token', [''])[0]
        return hmac.compare_digest(given.encode(), self._token.encode())


def _collect(given: Iterable[tuple[bytes, bytes]]) -> dict[str, list[str]]:
    """Return the values of each header by its name in small letters."""
    headers: dict[str, list[str]] = {}
    for name, value in given:
        headers.setdefault(name.lower().decode('latin-1'), []).append(value.decode('latin-1'))
    return headers


def _read_name(address: str) -> str:
    """Return the name in NAME or NAME:PORT, in small letters; raise ValueError for any other."""
    found = _ADDRESS.fullmatch(address)
    if found is None:
        raise ValueError
    return found[1].lower()


def _has_cookie(cookies: Iterable[str], token: str) -> bool:
    """Return whether a token is among cookies, whatever others the browser has for this name."""
    pairs = [pair.strip().partition('=') for each in cookies for pair in each.split(';')]
    return any(name == COOKIE and hmac.compare_digest(value.encode(), token.encode())
               for name, _, value in pairs)


async def _admit(send: Send, token: str) -> None:
    await send({'type': 'http.response.start', 'status': 303, 'headers': [
        (b'location', b'/'),
        (b'set-cookie', f'{COOKIE}={token}; HttpOnly; SameSite=Strict; Path=/'.encode())]})
    await send({'type': 'http.response.body', 'body': b''})


def _forbid_frames(send: Send) -> Send:
    """Return a sender that adds the headers against other pages that frame this one."""
    async def send_with_headers(event: Any) -> None:
        if event['type'] == 'http.response.start':
            event = {**event, 'headers': [*event.get('headers', ()), *NO_FRAMES]}
        await send(event)
    return send_with_headers


async def _reject(scope: Scope, send: Send, body: bytes, status: int = 403) -> None:
    if scope['type'] == 'websocket':
        await send({'type': 'websocket.close', 'code': 1008})
        return
    await send({'type': 'http.response.start', 'status': status, 'headers': [
        (b'content-type', b'text/html; charset=utf-8'), (b'cache-control', b'no-store'),
        *NO_FRAMES]})
    await send({'type': 'http.response.body', 'body': body})


def make_token() -> str:
    """Return a new token."""
    return secrets.token_urlsafe(16)


class HeaderDeadline(asyncio.Protocol):
    """
    Closes connections that send the header of a request slowly or never.

    A base class to stand before a protocol of uvicorn, which waits without end for the first
    request, and for a request that has begun; and which answers a request on a connection that it
    has closed for malformed data.
    """

    cycle: Any       # of uvicorn: the request, and how it sends
    transport: Any
    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Wait for the first request."""
        super().connection_made(transport)
        self._watch()

    def data_received(self, data: bytes) -> None:
        """Read data, and wait for the rest of a header that has begun."""
        try:
            super().data_received(data)
        except Exception as error:
            if not type(error).__module__.startswith('h11.'):
                raise
            self.transport.close()   # h11 has no 400 behind an answer that ends the connection
        self._watch()
        cycle = self.cycle
        if self.transport.is_closing() and cycle and not cycle.response_complete:
            # uvicorn has answered malformed data with 400; the request before them has no answer
            cycle.disconnected = True
            cycle.message_event.set()

    def connection_lost(self, error: Exception | None) -> None:
        """Wait no more."""
        self._cancel()
        super().connection_lost(error)

    def _watch(self) -> None:
        # A websocket has a protocol of its own, and a request a cycle until it is answered.
        cycle = self.cycle
        transport = self.transport
        if transport.get_protocol() is not self or (cycle and not cycle.response_complete):
            self._cancel()
        elif self._deadline is None:
            self._deadline = asyncio.get_running_loop().call_later(HEADER_TIME, transport.close)

    def _cancel(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


class Helm:
    """Which page controls the loop, if allowed: one at a time, after a click."""

    def __init__(self, allowed: bool) -> None:
        self.allowed = allowed
        self._holder = self._last = ''   # `_last` had the control, and nobody has taken it since

    def seize(self, page: str) -> None:
        """Give the control to a page whose user asks for it, whoever has it."""
        if self.allowed:
            self._holder = self._last = page

    def resume(self, page: str) -> None:
        """Give the control back to a page that had it when its connection broke."""
        if page == self._last:
            self._holder = page

    def leave(self, page: str) -> None:
        """Take the control from a page that closes."""
        if self._holder == page:
            self._holder = ''

    def has(self, page: str) -> bool:
        """Return whether a page has the control."""
        return self.allowed and self._holder == page
