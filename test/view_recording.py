# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A recording of given messages, for the tests of the live page."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mcap.writer import Writer
from obc_ros.msg import State
from rclpy.serialization import serialize_message


def record(file: Path, states: list[list[float]], topic: str = '/state',
           others: Sequence[tuple[int, str, Any]] = ()) -> Path:
    """Write a state each second, and other messages with their seconds and topics."""
    rows = [*((second, topic, State(x=x)) for second, x in enumerate(states)), *others]
    with file.open('wb') as opened:
        writer = Writer(opened)
        writer.start()
        channels: dict[str, int] = {}
        for second, name, message in sorted(rows, key=lambda row: row[0]):
            if name not in channels:
                schema = writer.register_schema(
                    f'obc_ros/msg/{type(message).__name__}', 'ros2msg', b'float64[] x')
                channels[name] = writer.register_channel(name, 'cdr', schema)
            writer.add_message(channels[name], log_time=second * 10**9,
                               publish_time=second * 10**9, data=serialize_message(message))
        writer.finish()
    return file
