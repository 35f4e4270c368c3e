# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Record topics as a rosbag2 folder with one MCAP file.

Messages are written as received over DDS, byte for byte, with their definitions: Foxglove,
PlotJuggler, `ros2 bag` and rosbags open the recording without this package.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
import re
import struct
import sys
import time
from typing import Any

from mcap.writer import Writer
from obc_ros.cli.ros2.yaml_messages import find_type
from obc_ros.cli.share_folders import share_directory
from obc_ros.ros.execution.subscription_thread import Apart
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
import yaml

LIBRARY = 'obc_ros'
Listener = Callable[[bytes, int], None]
# Deep enough for the bursts of a simulation that runs faster than real time.
DEPTH = 5000
LIVE = QoSProfile(depth=DEPTH)
CLOCK = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)   # as it is published
LATCHED = QoSProfile(depth=DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@dataclass
class RecordedTopic:
    """One recorded topic."""

    identifier: int
    message_type: str
    qos: QoSProfile
    count: int = 0


class Recorder:
    """
    Writes the messages of topics to `folder`/NAME_0.mcap and `folder`/metadata.yaml.

    With `ordered`, every message must have a header. Messages are then written at the end, sorted
    by their stamps, with the stamps as times and without repetitions: two runs that publish the
    same messages give the same bytes.

    A context manager: on exit the recording is complete and indexed. If the disk is full, `fault`
    has the reason and no more messages are recorded.
    """

    def __init__(self, folder: Path, ordered: bool = False) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self.path = folder / f'{folder.name}_0.mcap'
        self._channels: dict[str, RecordedTopic] = {}
        self._sources: list[tuple[Any, RecordedTopic, Listener | None]] = []
        self._first, self._last = sys.maxsize, 0
        self.now: Callable[[], int] = time.time_ns
        self.fault = ''  # the reason why recording has stopped
        self._ordered = ordered
        self._kept: list[tuple[int, int, int, RecordedTopic, bytes]] = []

    def __enter__(self) -> 'Recorder':
        self._file = self.path.open('wb')
        self._writer: Any = Writer(self._file)   # not all of its methods have types
        self._writer.start(profile='ros2', library=LIBRARY)
        return self

    def __exit__(self, *_: object) -> None:
        try:
            with self._file:
                self._write_kept()
                if not self.fault:
                    self._writer.finish()
            (self.folder / 'metadata.yaml').write_text(yaml.safe_dump(self._metadata()))
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        """Report that recording has stopped; the run continues."""
        if not self.fault:
            self.fault = f'{self.path} ends here: {error.strerror}'
            print(f'the recording {self.fault}', file=sys.stderr)

    def subscribe(self, node: Node, topic: str, message_class: Any,
                  listener: Listener | None = None, *, qos: QoSProfile = LIVE) -> None:
        """
        Record all messages of a topic from now on; with `LATCHED` also earlier ones.

        `listener` gets every serialised message and its publication time [ns] before the message
        is written. The recorded time is `now()` [ns]: wall time, unless `now` is replaced.
        """
        name = node.resolve_topic_name(topic)
        message_type = type_name(message_class)
        schema = self._writer.register_schema(
            name=message_type, encoding='ros2msg', data=get_definition(message_class).encode())
        identifier = self._writer.register_channel(
            topic=name, message_encoding='cdr', schema_id=schema,
            metadata={'offered_qos_profiles': yaml.safe_dump([_qos_for_rosbag2(qos)])})
        self._channels[name] = channel = RecordedTopic(identifier, message_type, qos)
        # Taken by drain(): an executor takes ten times longer for each message and lags behind.
        subscription = node.create_subscription(
            message_class, topic, lambda _: None, qos, raw=True, callback_group=Apart())
        self._sources.append((subscription, channel, listener))

    def drain(self) -> None:
        """Write all messages that have arrived since the last call."""
        for subscription, channel, listener in self._sources:
            with (handle := subscription.handle):
                while taken := handle.take_message(subscription.msg_type, True):
                    data, info = taken
                    if listener:
                        listener(data, info['source_timestamp'])
                    if self._ordered:
                        self._kept.append(
                            (read_stamp(data), channel.identifier, len(self._kept), channel, data))
                    else:
                        self._write(channel, data, self.now())

    def _write_kept(self) -> None:
        last: dict[int, bytes] = {}
        for moment, identifier, _, channel, data in sorted(self._kept, key=lambda each: each[:3]):
            if last.get(identifier) != data:
                last[identifier] = data
                self._write(channel, data, moment)

    def _write(self, channel: RecordedTopic, data: bytes, now: int) -> None:
        if self.fault:
            return
        try:
            self._writer.add_message(
                channel.identifier, log_time=now, publish_time=now, data=data,
                sequence=channel.count)
        except OSError as error:  # such as a full disk
            self._give_up(error)
            return
        channel.count += 1
        self._first, self._last = min(self._first, now), max(self._last, now)

    @property
    def counts(self) -> dict[str, int]:
        """Return the number of recorded messages of each topic."""
        return {topic: channel.count for topic, channel in self._channels.items()}

    def _metadata(self) -> dict[str, Any]:
        duration = {'nanoseconds': max(0, self._last - self._first)}
        start = {'nanoseconds_since_epoch': self._first}
        total = sum(self.counts.values())
        return {'rosbag2_bagfile_information': {
            'version': 5, 'storage_identifier': 'mcap', 'compression_format': '',
            'compression_mode': '', 'relative_file_paths': [self.path.name],
            'starting_time': start, 'duration': duration, 'message_count': total,
            'topics_with_message_count': [
                {'message_count': channel.count, 'topic_metadata': {
                    'name': topic, 'type': channel.message_type, 'serialization_format': 'cdr',
                    'offered_qos_profiles': yaml.safe_dump([_qos_for_rosbag2(channel.qos)])}}
                for topic, channel in self._channels.items()],
            'files': [{'path': self.path.name, 'starting_time': start, 'duration': duration,
                       'message_count': total}]}}


def read_stamp(data: bytes) -> int:
    """Return the stamp [ns] of a serialised message that begins with a header."""
    seconds, nanoseconds = struct.unpack_from('<iI', data, 4)  # after CDR's own header
    return int(seconds * 10**9 + nanoseconds)


def type_name(message_class: Any) -> str:
    """Return the ROS name of a message class, e.g. 'obc_ros/msg/State'."""
    package, kind, *_ = message_class.__module__.split('.')
    return f'{package}/{kind}/{message_class.__name__}'


def get_definition(message_class: Any) -> str:
    """Return the text of a message definition, followed by those of all types in it."""
    texts: dict[str, str] = {}
    waiting = [message_class]
    while waiting:
        kind = waiting.pop(0)
        package, folder, name = type_name(kind).split('/')
        if f'{package}/{name}' not in texts:
            texts[f'{package}/{name}'] = (
                share_directory(package) / folder / f'{name}.msg').read_text()
            waiting += [find_type(found, folder)
                        for field in kind.get_fields_and_field_types().values()
                        for found in re.findall(r'\w+/\w+', field)]
    first, *others = texts
    return texts[first] + ''.join(
        f'\n{"=" * 80}\nMSG: {name}\n{texts[name]}' for name in others)


def _qos_for_rosbag2(qos: QoSProfile) -> dict[str, Any]:
    unlimited = {'sec': 9223372036, 'nsec': 854775807}
    return {
        'history': int(qos.history), 'depth': qos.depth, 'reliability': int(qos.reliability),
        'durability': int(qos.durability), 'deadline': unlimited, 'lifespan': unlimited,
        'liveliness': 1, 'liveliness_lease_duration': unlimited,
        'avoid_ros_namespace_conventions': False}
