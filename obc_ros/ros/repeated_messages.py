# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Reads messages of which only the stamp and the numbers at the end change from one to the next.

rclpy builds a message field by field, which takes longer than the control law. Between the stamp
and the numbers a stream repeats frame, names and counts: these bytes are compared, not read again.
"""

from array import array
import struct
from typing import Any

from rclpy.serialization import deserialize_message

_PLAIN = b'\x00\x01\x00\x00'   # head of plain CDR, little-endian, as of all x86 and ARM robots
_STAMP = struct.Struct('<iI')
_BEGIN = len(_PLAIN) + _STAMP.size


class RepeatedReader:
    """
    Reader of serialised messages of one type.

    :param kind: its first field is a header, and its last one a ``float64[]``.
    :param numbers: name of the last field.
    """

    def __init__(self, kind: type, numbers: str) -> None:
        self._kind, self._numbers = kind, numbers
        self._message: Any = None
        self._length, self._end, self._between = -1, 0, b''

    def read(self, data: bytes) -> Any:
        """Return the message, which the next call may change in place; None: the data is none."""
        if len(data) != self._length or data[_BEGIN:self._end] != self._between or (
                not data.startswith(_PLAIN)):
            return self._learn(data)
        message = self._message
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = _STAMP.unpack_from(data, len(_PLAIN))
        setattr(message, self._numbers, array('d', data[self._end:]))
        return message

    def _learn(self, data: bytes) -> Any:
        """Return the message, read as a whole; keep what may be the same in the next one."""
        self._length = -1
        try:
            message = self._message = deserialize_message(data, self._kind)
        except RuntimeError:   # that of rclpy; the words are those of the middleware
            return None
        numbers, stamp = getattr(message, self._numbers), message.header.stamp
        end = len(data) - 8 * len(numbers)
        # In another layout each message is read as a whole.
        if data[end:] == numbers.tobytes() and (
                _STAMP.unpack_from(data, len(_PLAIN)) == (stamp.sec, stamp.nanosec)):
            self._length, self._end, self._between = len(data), end, data[_BEGIN:end]
        return message
