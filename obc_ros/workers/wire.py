# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Plain data between a process and its workers: JSON and arrays of numbers, nothing executable.

A packet is a JSON value for everything but the arrays, followed by the bytes of the arrays.
A channel carries packets over a stream socket, each preceded by its length.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
import json
import math
import socket
import struct
import time
from typing import Any

import numpy as np
from obc_ros.core.numerics.arrays import Array

_LENGTH = struct.Struct('<Q')
_CHUNK = 1 << 18


@dataclass(frozen=True)
class Packet:
    """Values that JSON can represent (with NaN and infinity), and named arrays of floats."""

    plain: dict[str, Any]
    arrays: dict[str, Array] = field(default_factory=dict)


def pack(packet: Packet) -> bytes:
    """Return the bytes of a packet."""
    arrays = {name: np.asarray(array, np.float64, order='C')
              for name, array in packet.arrays.items()}
    head = json.dumps([packet.plain, {name: array.shape for name, array in arrays.items()}],
                      separators=(',', ':')).encode()
    return b''.join([_LENGTH.pack(len(head)), head, *(each.tobytes() for each in arrays.values())])


def unpack(data: bytes) -> Packet:
    """Return the packet whose bytes `pack` returned."""
    start = _LENGTH.size + _LENGTH.unpack_from(data)[0]
    plain, shapes = json.loads(data[_LENGTH.size:start])
    arrays = {}
    for name, shape in shapes.items():
        count = math.prod(shape)
        arrays[name] = np.frombuffer(data, np.float64, count, start).reshape(shape).copy()
        start += 8 * count
    return Packet(plain, arrays)


class Channel:
    """Packets over a connected stream socket; one thread sends and one receives."""

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        self._received = bytearray()

    def send(self, plain: Mapping[str, Any], arrays: Mapping[str, Array] | None = None,
             timeout: float | None = None) -> None:
        """Send one packet; OSError: it is not accepted within `timeout` seconds."""
        data = pack(Packet(dict(plain), dict(arrays or {})))
        self._socket.settimeout(timeout)
        self._socket.sendall(_LENGTH.pack(len(data)) + data)

    def receive(self, timeout: float | None = None) -> Packet | None:
        """
        Return the next packet, or None if it has not arrived within `timeout` seconds.

        :raises EOFError: if the other end is closed.
        """
        deadline = math.inf if timeout is None else time.monotonic() + timeout
        while (packet := self._take()) is None:
            left = deadline - time.monotonic()
            self._socket.settimeout(None if math.isinf(left) else max(0.0, left))
            try:
                chunk = self._socket.recv(_CHUNK)
            except (TimeoutError, BlockingIOError):
                return None
            except ConnectionResetError:
                chunk = b''
            if not chunk:
                raise EOFError
            self._received += chunk
        return packet

    def close(self) -> None:
        """Close this end."""
        self._socket.close()

    def _take(self) -> Packet | None:
        if len(self._received) < _LENGTH.size:
            return None
        end = _LENGTH.size + _LENGTH.unpack_from(self._received)[0]
        if len(self._received) < end:
            return None
        packet = unpack(bytes(memoryview(self._received)[_LENGTH.size:end]))
        del self._received[:end]
        return packet
