# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What ``obc lqr --plot`` draws: curves that say what the design says in numbers."""

import math
from typing import Any

import numpy as np
from obc_ros.cli.cases import Case
from obc_ros.cli.lqr_figures import draw, figure
from obc_ros.core import systems
from obc_ros.core.design import design, plant, Sampling
from obc_ros.core.design_report import Change
from obc_ros.nodes.design_message import design_message
import pytest


def solved(**asked: Any) -> Case:
    """Return a case of the aircraft with its design."""
    case = Case('flight', 'flight.yaml', 'flight')
    case.take({'name': 'flight', 'system': 'aircraft', **asked})
    sampling = Sampling(asked.get('sample_time', 0.0), asked.get('delay', 0.0),
                        'sample_time' in asked)
    found = design(plant(systems.get('aircraft')), {
        key: asked[key] for key in ('Qx', 'Qu', 'stability', 'cross') if key in asked},
        sampling=sampling)
    case.design = design_message(found, Change(), None)
    case.end('solved', case.design.sentence)
    return case


CASES: list[dict[str, Any]] = [
    {'Qx': [1.0] * 6, 'Qu': [1.0, 1.0]},
    {'Qx': [1.0] * 6, 'Qu': [1.0, 1.0], 'stability': 0.5, 'cross': [[0.1, 0.0]] * 6},
    {'Qx': [1.0] * 6, 'Qu': [1.0, 1.0], 'sample_time': 0.05, 'delay': 0.1},
]


@pytest.mark.parametrize('asked', CASES, ids=['continuous', 'cross', 'sampled'])
def test_curves_say_what_the_numbers_say(asked: dict[str, Any], tmp_path: Any) -> None:
    """Rise time, phase margin and bandwidth are read off the curves; rho = 1 is on the locus."""
    case = solved(**asked)
    step, magnitude, locus, phase = figure(case).axes[:4]
    for index, line in enumerate(step.lines[:2]):
        t, y = line.get_data()
        rise = t[np.argmax(y >= 0.9)] - t[np.argmax(y >= 0.1)]
        assert rise == pytest.approx(case.design.rise_time[index], rel=0.05)
        assert y[0] == 0.0 and y[-1] == pytest.approx(1.0, abs=0.02)
    for j in range(2):
        w, gain = magnitude.lines[j].get_data()
        last = np.flatnonzero(gain >= 1.0)[-1]
        assert w[last] == pytest.approx(case.design.bandwidth[j], rel=0.05)
        crossings = np.flatnonzero(np.diff(np.signbit(gain - 1.0)))
        margin = np.abs(np.mod(phase.lines[j].get_ydata()[crossings], 360.0) - 180.0).min()
        assert math.radians(margin) == pytest.approx(case.design.phase_margin[j], abs=0.05)
        assert -180.0 < phase.lines[j].get_ydata()[last] < 0.0
    points = locus.collections[0].get_offsets() @ [1.0, 1j]
    for real, imag in zip(case.design.poles_real, case.design.poles_imag, strict=True):
        assert np.abs(points - complex(real, imag)).min() < 1e-6 * abs(complex(real, imag))
    draw(tmp_path / 'figures' / 'flight.png', case)
    assert (tmp_path / 'figures' / 'flight.png').stat().st_size > 30_000
