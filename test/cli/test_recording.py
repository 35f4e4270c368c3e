# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings, read back by rosbags, which is independent of this package."""

from array import array
from pathlib import Path

from nav_msgs.msg import Odometry
import numpy as np
from obc_ros.cli.recording import get_definition, LATCHED, LIVE, Recorder
from obc_ros.cli.share_folders import share_directory
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import State, Trajectory
from probes import Probe
import pytest
from rosbags.highlevel import AnyReader

pytestmark = pytest.mark.nodes


def test_a_recording_has_all_published_messages(probe: Probe, tmp_path: Path) -> None:
    """Messages of several types keep their values, types and times."""
    with Recorder(tmp_path / 'flight') as recorder:
        recorder.now = iter(range(1000, 2000)).__next__
        recorder.subscribe(probe.node, 'state', State)
        recorder.subscribe(probe.node, 'reference', Trajectory, qos=LATCHED)
        recorder.subscribe(probe.node, 'odom', Odometry)
        states = probe.publisher(State, 'state', LIVE)
        odometry = probe.publisher(Odometry, 'odom', LIVE)
        for k in range(50):
            state = State(x=array('d', [k, -k / 3]))
            state.header.stamp.sec = k
            states.publish(state)
        message = Odometry(child_frame_id='base_link')
        message.pose.pose.orientation.w = 0.5
        odometry.publish(message)

        def complete() -> bool:
            recorder.drain()
            return recorder.counts == {'/state': 50, '/reference': 0, '/odom': 1}

        probe.wait_for(complete)
    with AnyReader([tmp_path / 'flight']) as reader:
        read = [(connection.topic, time, reader.deserialize(data, connection.msgtype))
                for connection, time, data in reader.messages()]
    x = np.array([message.x for topic, _, message in read if topic == '/state'])
    np.testing.assert_array_equal(x, [[k, -k / 3] for k in range(50)])
    odom = next(message for topic, _, message in read if topic == '/odom')
    assert (odom.child_frame_id, odom.pose.pose.orientation.w) == ('base_link', 0.5)
    assert sorted(time for _, time, _ in read) == list(range(1000, 1051))


def test_an_empty_recording_is_readable(tmp_path: Path) -> None:
    with Recorder(tmp_path / 'empty'):
        pass
    with AnyReader([tmp_path / 'empty']) as reader:
        assert list(reader.messages()) == []


def test_a_definition_has_every_type_once() -> None:
    """The definition of a type contains all types of its fields."""
    text = get_definition(Odometry)
    types = [line for line in text.splitlines() if line.startswith('MSG: ')]
    assert len(types) == len(set(types))
    assert {'MSG: std_msgs/Header', 'MSG: builtin_interfaces/Time', 'MSG: geometry_msgs/Pose',
            'MSG: geometry_msgs/Vector3'} <= set(types)


def test_a_missing_package_is_named() -> None:
    with pytest.raises(ObcError, match="'no_such_msgs' is not installed"):
        share_directory('no_such_msgs')
