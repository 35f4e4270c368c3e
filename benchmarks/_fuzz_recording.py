# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Recordings as `obc view` opens them, for _fuzz.py.

A file that is no recording of a loop is rejected with one sentence; of any other, all that the
page shows has to be JSON.
"""

import json
from pathlib import Path
import tempfile
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from mcap.writer import CompressionType, Writer
import numpy as np
from obc_ros import lqr, systems
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import Command, Estimate, LqrDesign, State, Trajectory
from obc_ros.view.canvas import AHEAD, describe_scene
from obc_ros.view.playback import Playback
from rcl_interfaces.msg import Log
from rclpy.serialization import serialize_message

LONGEST = 1000   # characters of a sentence
PLANT = 'double_integrator'


def list_messages() -> list[tuple[str, Any]]:
    """Return a message of each kind that the page shows, with its topic."""
    system = systems[PLANT]
    design = lqr(system, [1.0, 1.0], [1.0])
    names, inputs = list(system.states), list(system.inputs)
    n, m = design.B.shape
    path = Trajectory(state_names=names, input_names=inputs, t=[0.0, 1.0], x=[1.0, 0.0, 0.0, 0.0],
                      u=[-1.0, 0.0])
    return [
        ('/state', State(names=names, x=[1.0, 0.0])), ('/command', Command(names=inputs, u=[0.5])),
        ('/lqr_node/design', LqrDesign(
            system=PLANT, state_names=names, input_names=inputs, a=np.ravel(design.A),
            b=np.ravel(design.B), k=np.ravel(design.K), p=np.ravel(design.P), xe=np.zeros(n),
            ue=np.zeros(m), poles_real=design.E.real, poles_imag=design.E.imag,
            damping=np.ones(n), rise_time=np.ones(n), phase_margin=np.ones(m),
            disk_margin=np.ones(m), delay_margin=np.ones(m), peak_input=np.ones(m))),
        ('/reference', path), ('/mpc_node/plan', path),
        ('/estimator_node/estimate', Estimate(covariance=[1.0, 0.0, 0.0, 1.0])),
        ('/rosout', Log(level=40, name='lqr_node', msg='stopped')),
        *(('/diagnostics', DiagnosticArray(status=[DiagnosticStatus(
            name='lqr_node: commands', values=[KeyValue(key='mode', value=mode)])]))
          for mode in ('SET_POINT', 'STOPPED')),
        ('/state', State(names=names, x=[0.0, 1.0]))]


def write_seeds(folder: str) -> None:
    """Write recordings with and without chunks and compressions into a folder."""
    for chunked, compression in ((False, CompressionType.NONE), (True, CompressionType.NONE),
                                 (True, CompressionType.LZ4), (True, CompressionType.ZSTD)):
        name = f'{"chunks" if chunked else "plain"}_{compression.name.lower()}'
        with (Path(folder) / name).open('wb') as file:
            writer = Writer(file, compression=compression, use_chunking=chunked)
            writer.start(profile='ros2')
            channels: dict[str, int] = {}
            for second, (topic, message) in enumerate(list_messages()):
                if topic not in channels:
                    package = type(message).__module__.partition('.')[0]
                    kind = f'{package}/msg/{type(message).__name__}'
                    schema = writer.register_schema(kind, 'ros2msg', b'float64[] x')
                    channels[topic] = writer.register_channel(topic, 'cdr', schema)
                writer.add_message(channels[topic], log_time=second * 10**9,
                                   publish_time=second * 10**9, data=serialize_message(message))
            writer.finish()


def mcap(data: bytes) -> None:
    """Open a recording, and look at it at several times."""
    with tempfile.NamedTemporaryFile(suffix='.mcap') as file:
        file.write(data)
        file.flush()
        try:
            playback = Playback(Path(file.name))
        except ObcError as error:
            assert 0 < len(str(error)) < LONGEST and '\n' not in str(error)
            return
    playback.playing = False
    shown = [playback.duration, describe_scene(playback.plant, playback.events)]
    for part in (0.0, 0.3, 0.7, 1.0):
        playback.seek(part * playback.duration)
        frame = playback.take_frame()
        if frame is not None:
            shown += [frame.pack(1), list(frame.prediction)]
        if playback.reference is not None:
            shown.append(playback.reference.pack(playback.plant, AHEAD))
        shown.append(playback.design.sentence if playback.design else '')
    json.dumps(shown, allow_nan=False).encode()
