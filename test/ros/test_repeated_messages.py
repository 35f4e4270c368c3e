# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A stream of serialised states is read as rclpy reads each one of them."""

from array import array

from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from obc_ros.msg import State
from obc_ros.ros.repeated_messages import RepeatedReader
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Header

stamps = st.builds(Time, sec=st.integers(-2**31, 2**31 - 1), nanosec=st.integers(0, 2**32 - 1))
states = st.builds(
    lambda stamp, frame, names, restarts, x: State(
        header=Header(stamp=stamp, frame_id=frame), names=names, restarts=restarts,
        x=array('d', x)),
    stamps, st.sampled_from(['', 'odom', 'mäp']),
    st.sampled_from([[], ['px', 'py'], ['py', 'px'], ['a']]), st.integers(0, 1),
    st.lists(st.floats(), max_size=3))


def list_fields(state: State) -> list[object]:
    """
    Return what a state says.

    Numbers are bytes, since a NaN differs from itself. Serialised messages would differ where CDR
    pads: the middleware leaves in these bytes what was in memory.
    """
    header = state.header
    return [header.stamp, header.frame_id, state.names, state.restarts, state.x.tobytes()]


@given(st.lists(states | st.binary(max_size=80), max_size=30))
def test_whatever_came_before_a_message_is_read_as_rclpy_reads_it(stream: list[State | bytes]
                                                                 ) -> None:
    """Frames, names, sizes and restarts change; bytes that are no message come in between."""
    reader = RepeatedReader(State, 'x')
    for each in stream:
        data = each if isinstance(each, bytes) else serialize_message(each)
        try:
            wanted = deserialize_message(data, State)
        except RuntimeError:
            assert reader.read(data) is None
            continue
        assert list_fields(reader.read(data)) == list_fields(wanted)


@given(states, st.data())
def test_a_changed_byte_is_seen(state: State, data: st.DataObject) -> None:
    """After any number of equal messages."""
    reader, sent = RepeatedReader(State, 'x'), bytearray(serialize_message(state))
    for _ in range(2):
        reader.read(bytes(sent))
    sent[data.draw(st.integers(0, len(sent) - 1))] ^= data.draw(st.integers(1, 255))
    try:
        wanted = deserialize_message(bytes(sent), State)
    except RuntimeError:
        assert reader.read(bytes(sent)) is None
        return
    assert list_fields(reader.read(bytes(sent))) == list_fields(wanted)
