# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Designs and recordings of given messages, for the tests of the live page."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mcap.writer import Writer
import numpy as np
from obc_ros import lqr, systems
from obc_ros.msg import LqrDesign, State
from rclpy.serialization import serialize_message


def design_of(name: str, qx: list[float], qu: list[float]) -> LqrDesign:
    """Return the message of a design, with what the page reads."""
    system = systems[name]
    design = lqr(system, qx, qu)
    poles = np.linalg.eigvals(design.A - design.B @ design.K)
    n, m = np.shape(design.B)
    return LqrDesign(
        system=name, state_names=list(system.states), input_names=list(system.inputs),
        a=np.ravel(design.A), b=np.ravel(design.B), k=np.ravel(design.K), p=np.ravel(design.P),
        qx=np.diag(qx).ravel(), qu=np.diag(qu).ravel(), xe=np.zeros(n), ue=np.zeros(m),
        poles_real=poles.real, poles_imag=poles.imag,
        damping=-poles.real / np.abs(poles), rise_time=[1.0] + [np.nan] * (n - 1),
        phase_margin=[1.0] * m, disk_margin=[1.0] * m, delay_margin=[1.0] * m,
        peak_input=[2.0] * m)


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
                package = type(message).__module__.partition('.')[0]
                schema = writer.register_schema(
                    f'{package}/msg/{type(message).__name__}', 'ros2msg', b'float64[] x')
                channels[name] = writer.register_channel(name, 'cdr', schema)
            writer.add_message(channels[name], log_time=second * 10**9,
                               publish_time=second * 10**9, data=serialize_message(message))
        writer.finish()
    return file
