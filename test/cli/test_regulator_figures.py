# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The figures of `obc lqr --plot` agree with the numbers of the design."""

import math
from typing import Any

import numpy as np
from obc_ros.cli.ask.regulator_figures import draw_figure, draw_regulator
from obc_ros.cli.ask.regulator_requests import Case
from obc_ros.core.lqr.design.design import design, linearize_plant, Sampling
from obc_ros.core.lqr.design.report import Change
from obc_ros.core.systems import registry
from obc_ros.msg import LqrWeights
from obc_ros.nodes.control.controller_node import design_message
from obc_ros.srv import DesignLqr
import pytest
from scipy.linalg import expm


def design_case(**asked: Any) -> Case:
    """Return a case of the aircraft, with its design."""
    case = Case('flight', 'flight.yaml', 'flight')
    case.take({'name': 'flight', 'system': 'aircraft', **asked})
    sampling = Sampling(asked.get('sample_time', 0.0), asked.get('delay', 0.0),
                        'sample_time' in asked)
    found = design(linearize_plant(registry.get_system('aircraft')), {
        key: asked[key] for key in ('Qx', 'Qu', 'stability', 'cross') if key in asked},
        sampling=sampling)
    case.design = design_message(found, Change(), None)
    case.end('design_case', case.design.sentence)
    return case


CASES: list[dict[str, Any]] = [
    {'Qx': [1.0] * 6, 'Qu': [1.0, 1.0]},
    {'Qx': [1.0] * 6, 'Qu': [1.0, 1.0], 'stability': 0.5, 'cross': [[0.1, 0.0]] * 6},
    {'Qx': [1.0] * 6, 'Qu': [1.0, 1.0], 'sample_time': 0.05, 'delay': 0.1},
]


@pytest.mark.slow
@pytest.mark.parametrize('asked', CASES, ids=['continuous', 'cross', 'sampled'])
def test_curves_agree_with_the_numbers_of_the_design(asked: dict[str, Any], tmp_path: Any) -> None:
    """Check rise time, bandwidth and phase margin; the locus contains the poles at rho = 1."""
    case = design_case(**asked)
    step, magnitude, locus, phase = draw_figure(case).axes[:4]
    for index, line in enumerate(step.lines[:2]):
        t, y = line.get_data()
        rise = t[np.argmax(y >= 0.9)] - t[np.argmax(y >= 0.1)]
        assert rise == pytest.approx(case.design.rise_time[index], rel=0.05)
        assert y[0] == 0.0
        assert y[-1] == pytest.approx(1.0, abs=0.02)
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
    draw_regulator(tmp_path / 'figures' / 'flight', case)
    assert (tmp_path / 'figures' / 'flight.png').stat().st_size > 30_000


@pytest.mark.nodes
def test_curves_of_a_server_design_agree_with_the_formulas(spawn: Any, probe: Any) -> None:
    """
    Steps follow exp((A - B K) t), loop gains K (i w - A)^-1 B with the other loops closed.

    The locus contains the poles of designs for other rho.
    """
    spawn('trajectory_server', {'workers': 1})

    def ask(rho: float) -> Any:
        answer = probe.call(DesignLqr, '/trajectory_server/design_lqr', DesignLqr.Request(
            system='aircraft', weights=LqrWeights(qx=[1.0] * 6, qu=[rho, rho])))
        assert answer.success, answer.message
        return answer.design

    case = Case('flight', 'flight.yaml', 'flight')
    case.take({'name': 'flight', 'system': 'aircraft', 'Qx': [1.0] * 6, 'Qu': [1.0, 1.0]})
    case.design = ask(1.0)
    case.end('design_case', case.design.sentence)
    step, magnitude, locus, phase = draw_figure(case).axes[:4]
    A, B, K = (np.reshape(values, (rows, -1)) for values, rows in (
        (case.design.a, 6), (case.design.b, 6), (case.design.k, 2)))
    for index in range(2):
        t, y = step.lines[index].get_data()
        for k in range(0, len(t), 40):
            x = expm((A - B @ K) * t[k])[:, index]  # response to a unit error of that state
            assert y[k] == pytest.approx(1.0 - x[index], abs=1e-9)
        w, gain = magnitude.lines[index].get_data()
        other = 1 - index
        for k in range(0, len(w), 40):
            opened = A - B[:, [other]] @ K[[other]]
            L = K[index] @ np.linalg.solve(1j * w[k] * np.eye(6) - opened, B[:, index] + 0j)
            assert gain[k] == pytest.approx(abs(L), rel=1e-9)
            phase_error = math.radians(phase.lines[index].get_ydata()[k]) - np.angle(L)
            assert math.remainder(phase_error, math.tau) == pytest.approx(0.0, abs=1e-9)
    points = locus.collections[0].get_offsets() @ [1.0, 1j]
    colours = locus.collections[0].get_array()
    for power in (-3, -1, 0, 1, 3):
        design = ask(10.0**power)
        near = points[np.isclose(colours, power)]
        for real, imag in zip(design.poles_real, design.poles_imag, strict=True):
            assert np.abs(near - complex(real, imag)).min() < 1e-6 * abs(complex(real, imag))
