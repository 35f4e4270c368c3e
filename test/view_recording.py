# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A recording of given states, for the tests of the live page."""

from pathlib import Path

from mcap.writer import Writer
from obc_ros.msg import State
from rclpy.serialization import serialize_message


def record(file: Path, states: list[list[float]], topic: str = '/state') -> Path:
    """Write a recording with a state each second."""
    with file.open('wb') as opened:
        writer = Writer(opened)
        writer.start()
        schema = writer.register_schema('obc_ros/msg/State', 'ros2msg', b'float64[] x')
        channel = writer.register_channel(topic, 'cdr', schema)
        for second, x in enumerate(states):
            writer.add_message(channel, log_time=second * 10**9, publish_time=second * 10**9,
                               data=serialize_message(State(x=x)))
        writer.finish()
    return file
