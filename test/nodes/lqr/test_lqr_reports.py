# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""lqr_node in its own process: diagnostics, figures of the design, refusals, smooth starts."""

import math
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from lqr_bench import Bench, HOVER, matrix, nanoseconds
from nav_msgs.msg import Odometry
import numpy as np
from obc_ros.msg import State
from obc_ros.nodes.lqr_node import LqrNode
import pytest
from std_srvs.srv import Trigger
from support import DEMO

pytestmark = pytest.mark.nodes

X = [0.3, -0.2, 0.1, 0.05, -0.04, 0.02]


@pytest.mark.alone
def test_diagnostics_report_the_loop_at_1_hz(spawn: Any, probe: Any) -> None:
    """They contain rate, state age, latency, share at a limit, revision and last refusal."""
    bench = Bench(spawn, probe, u_limits=[-1.0, 1.0, 30.0, 50.0])
    assert bench.set(Qx=[2.0] * 6).successful
    assert not bench.set(Qu=[1.0, -1.0]).successful
    arrived: list[float] = []
    probe.node.create_subscription(
        DiagnosticArray, '/diagnostics', lambda _: arrived.append(time.monotonic()), 10)
    begun, answered = time.monotonic(), 0
    bench.reports.clear()
    while len(bench.reports) < 4:
        bench.answer([9.0] * 6 if answered % 4 == 0 else [0.0] * 6)
        answered += 1
        probe.spin_for(0.01)
        assert time.monotonic() < begun + 30.0
    assert np.diff(arrived) == pytest.approx(1.0, abs=0.5)
    parts = {status.name: (status, {each.key: each.value for each in status.values})
             for status in bench.reports[-1].status}
    assert set(parts) == {f'lqr_node: {part}' for part in ('states', 'commands', 'design')}
    status, states = parts['lqr_node: states']
    assert status.level == b'\x00'
    assert status.message == 'states are answered'
    mean = answered / (time.monotonic() - begun)
    assert float(states['rate [Hz]']) == pytest.approx(mean, rel=0.5)
    assert 0.0 <= float(states['age [s]']) < 0.5
    assert states['dropped not finite'] == '0'
    _, commands = parts['lqr_node: commands']
    assert 1.0 < float(commands['latency p50 [us]']) <= float(commands['latency p99 [us]']) < 1e6
    assert float(commands['share at a limit']) == pytest.approx(0.25, abs=0.1)
    assert 'at a limit 2' in parts['lqr_node: commands'][0].message
    status, design = parts['lqr_node: design']
    assert design['revision'] == '2'
    assert design['changes refused'] == '1'
    assert design['last refusal'].startswith('Qu[1] = -1: Qu must be positive definite')
    assert 'revision 2: aircraft: spectral abscissa -' in status.message


def test_diagnostics_warn_of_a_plant_unlike_the_design(spawn: Any, probe: Any) -> None:
    """The cost-to-go grows with the wrong plant; with the right plant there is no warning."""
    reports = probe.listen(DiagnosticArray, '/diagnostics', 100)
    for name, a in (('right', -1.0), ('wrong', 1.5)):  # the design is for a = -1
        spawn('plant_simulator', {'system': 'scalar', 'system_parameters.a': a, 'x0': [1e-3],
                                  'publish_rate': 50.0}, namespace=f'/{name}')
        spawn('lqr_node', {**DEMO, 'system': 'scalar', 'system_parameters.a': -1.0},
              namespace=f'/{name}')

    def words(name: str) -> set[str]:
        return {status.message for report in reports for status in report.status
                if status.name == f'{name}/lqr_node: commands'}

    probe.wait_for(lambda: any(
        'the cost-to-go grows: the plant differs from' in each and 'x_limits are not set' in each
        for each in words('wrong')), 40.0)
    assert words('right') == {'within the limits'}


def test_the_design_reports_the_figures_of_exercise_2_10(spawn: Any, probe: Any) -> None:
    """Lateral motion py'' = (v^2 / l) phi has the closed forms of Example 2.4."""
    bench = Bench(spawn, probe, system='vehicle_lateral', Qx=[0.01, 0.0], Qu=[1.0])
    unit = math.sqrt(1.0 + math.sqrt(2.0))
    assert bench.set(Qx=[1.0, 0.0]).successful
    for revision, q in ((1, 0.01), (2, 1.0)):
        design, w0 = bench.design(revision), math.sqrt(10.0**2 / 2.0 * math.sqrt(q))
        K = [math.sqrt(q), math.sqrt(2.0) * w0 * 2.0 / 10.0]
        assert list(design.k) == pytest.approx(K, rel=1e-9)
        assert design.overshoot[0] == pytest.approx(math.exp(-math.pi), rel=1e-3)
        assert design.rise_time[0] == pytest.approx(2.1457 / w0, rel=2e-3)
        assert design.bandwidth[0] == pytest.approx(unit * w0, rel=1e-9)
        assert design.phase_margin[0] == pytest.approx(math.atan(math.sqrt(2.0) * unit), rel=1e-9)
        assert design.gain_margin[0] == math.inf
        assert design.gain_reduction_margin[0] == pytest.approx(0.0, abs=1e-9)
        # |1 + L| > 1 for any LQR (Kalman), so that |S| has no peak above 1
        assert design.sensitivity_peak == pytest.approx(1.0, abs=1e-6)
        # S - T = (s^2 - a s - b) / (s^2 + a s + b), a^2 = 2 b; its square on s = jw is
        # (w^4 + 4 b w^2 + b^2) / (w^4 + b^2), at most 3
        assert design.disk_margin[0] == pytest.approx(2.0 / math.sqrt(3.0), rel=1e-6)
        assert design.damping == pytest.approx([math.sqrt(0.5)] * 2)
        assert design.residual < 1e-12


@pytest.mark.parametrize(('A', 'B', 'Qx', 'Qu', 'sentence'), [
    ([1.0, 0.0, 0.0, -1.0], [0.0, 1.0], [1.0, 1.0], [1.0], 'the mode s = +1 is uncontrollable'),
    ([1.0, 0.0, 0.0, -1.0], [1.0, 1.0], [0.0, 1.0], [1.0], '(A, Qx) is not detectable'),
    ([0.0, 1.0, 0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [-1.0], 'Qu[0] = -1: Qu must be positive'),
    ([0.0, 1.0, 0.0, 0.0], [0.0, 1.0], [1.0, 2.0, 3.0, 1.0], [1.0], 'Qx must be symmetric'),
])
def test_the_node_does_not_start_with_an_invalid_design(probe: Any, A: Any, B: Any, Qx: Any,
                                                        Qu: Any, sentence: str) -> None:
    """The error names the violated condition of the design."""
    assert sentence in probe.refusal(LqrNode, {
        'system': 'linear', 'system_parameters.A': A, 'system_parameters.B': B, 'Qx': Qx,
        'Qu': Qu})


def test_extreme_weights_give_the_closed_form_gain(spawn: Any, probe: Any) -> None:
    """K = (sqrt(q/r), sqrt(2 sqrt(q/r))); common Riccati solvers return an unstable gain."""
    bench = Bench(spawn, probe, system='double_integrator', Qx=[1e16, 1e-16], Qu=[1e-16])
    design = bench.design(1)
    assert list(design.k) == pytest.approx([1e16, math.sqrt(2e16)], rel=1e-12)
    assert max(design.poles_real) < 0.0
    assert 'spectral abscissa' in design.sentence
    u = bench.answer([1e-16, 0.0])
    assert u == pytest.approx(-1.0)
    assert 'Qu must be positive definite' in bench.set(Qu=[-1.0]).reason
    assert (bench.answer([1e-16, 0.0]) == u).all()


def test_the_integral_does_not_wind_up_at_a_limit(spawn: Any, probe: Any) -> None:
    """The input leaves its limit at once when the error changes its sign."""
    bench = Bench(spawn, probe, system='double_integrator', integral=['x1'], Qi=[1.0],
                  u_limits=[-1.0, 1.0])
    for k in range(100):
        u = bench.answer([5.0, 0.0], 0.05 * k)
    assert u == -1.0
    assert bench.answer([-0.2, 0.0], 5.0)[0] > 0.2  # with windup it would stay at -1


def test_the_loop_over_odometry_equals_that_over_states(spawn: Any, probe: Any) -> None:
    """Odometry has the velocity in the body frame; commands are those of the state."""
    spawn('plant_simulator', {'lockstep': True, 'speed': 0.5, 'publish_clock': True,
                              'x0': [1.0, 0.5, 0.6, 1.0, -1.0, 0.3]})  # waits for a command
    states: list[State] = probe.listen(State, 'state', 1_000)
    probe.wait_for(lambda: states, what='a state')
    bench = Bench(spawn, probe, message=Odometry, topic='odom', state_source='odom')
    K = matrix(bench.design(1).k, 2)

    def answered() -> list[tuple[Any, Any]]:
        known = {nanoseconds(each): np.array(each.x) for each in states}
        return [(each.u, known[nanoseconds(each)]) for each in bench.commands
                if nanoseconds(each) in known]

    probe.wait_for(lambda: len(answered()) > 100, what='answers to known states')
    for u, x in answered():
        np.testing.assert_allclose(u, HOVER - K @ x, rtol=1e-9, atol=1e-9)
    assert max(np.abs(x[3:5]).max() for _, x in answered()) > 1e-2


def test_start_after_stop_is_smooth_with_transition_time(spawn: Any, probe: Any) -> None:
    """After ~/start the command blends from the equilibrium input into the law."""
    bench = Bench(spawn, probe, transition_time=1.0)
    assert (bench.answer(X, 0.5) == HOVER).all()   # the first command, too
    law = bench.answer(X, 2.0)
    assert probe.call(Trigger, '/lqr_node/stop').success
    assert (bench.answer(X, 2.1) == HOVER).all()
    assert probe.call(Trigger, '/lqr_node/start').success
    np.testing.assert_allclose(bench.answer(X, 2.2), HOVER, atol=1e-9)
    half = bench.answer(X, 2.7)
    np.testing.assert_allclose(half, 0.5 * (HOVER + law), atol=1e-9)
    np.testing.assert_allclose(bench.answer(X, 3.2), law, atol=1e-9)
