# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""lqr_node in its own process: states, commands, and changes of parameters."""

import math
from pathlib import Path
import random
import subprocess
import sys
from typing import Any

from lqr_bench import Bench, BEST_EFFORT, HOVER, LATCHED, matrix, nanoseconds, riccati_gain
import numpy as np
from obc_ros.core.simulation.simulator import Simulator
from obc_ros.core.systems import registry
from obc_ros.msg import LqrDesign, State
from obc_ros.nodes.lqr_node import LqrNode
from probes import Probe
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

pytestmark = pytest.mark.nodes

X = [0.3, -0.2, 0.1, 0.05, -0.04, 0.02]
EXAMPLE_2_5 = {'Qx': [100.0, 1.0, 2 * math.pi / 9, 0.0, 0.0, 0.0], 'Qu': [0.1, 0.1]}
NAMES = ('px', 'py', 'theta', 'vx', 'vy', 'omega')


def test_a_change_of_weights_changes_the_gain(spawn: Any, probe: Any) -> None:
    """Diagonals, integers, full matrices and text are accepted and reported in ~/design."""
    bench = Bench(spawn, probe)
    first = bench.design(1)
    assert tuple(first.state_names) == NAMES
    assert list(first.ue) == pytest.approx(HOVER)
    Qx = np.eye(6)
    Qx[0, 1] = Qx[1, 0] = 0.5
    before = np.zeros((2, 6))
    for revision, change, weights in (
            (1, {}, (np.eye(6), np.eye(2))),
            (2, EXAMPLE_2_5, (np.diag(EXAMPLE_2_5['Qx']), 0.1 * np.eye(2))),
            (3, {'Qx': [1, 2, 3, 4, 5, 6]}, (np.diag([1, 2, 3, 4, 5, 6]), 0.1 * np.eye(2))),
            (4, {'Qx': Qx.ravel().tolist()}, (Qx, 0.1 * np.eye(2))),
            (5, {'Qu': '[1, 0.5]'}, (Qx, np.diag([1.0, 0.5])))):
        if change:
            assert bench.set(**change).successful
        design = bench.design(revision)
        K = riccati_gain(first, *map(np.asarray, weights))
        np.testing.assert_allclose(matrix(design.k, 2), K, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(matrix(design.qx, 6), weights[0])
        np.testing.assert_allclose(bench.answer(X), HOVER - K @ X, rtol=1e-9, atol=1e-9)
        if revision > 1:
            assert design.max_gain_change == pytest.approx(np.abs(K - before).max(), rel=1e-6)
            assert design.input_jump == pytest.approx(np.abs((K - before) @ X).max(), rel=1e-6)
            assert 'largest change of K' in design.sentence
            assert 'jumps by' in design.sentence
        before = K


REFUSED = [
    ({'Qu': [1.0, -0.1]}, 'Qu[1] = -0.1: Qu must be positive definite'),
    ({'Qu': [1.0, 0.0]}, 'Qu[1] = 0: Qu must be positive definite'),
    ({'Qx': [1.0, 1.0, -2.0, 1.0, 1.0, 1.0]}, 'Qx[2] = -2: Qx must be positive semidefinite'),
    ({'Qx': [1.0] * 5}, 'Qx has 5 numbers; wanted 6 (a diagonal) or 36 (a full matrix row by'),
    ({'Qx': [1.0, math.nan] * 3}, 'Qx[1] = nan: wanted a finite number'),
    ({'Qx': [0.0] * 6}, '(A, Qx) is not detectable'),
    ({'Qx': 'heavy'}, 'Qx: wanted a list of numbers, got a string'),
    ({'Qx': [float(k) for k in range(36)]}, 'Qx must be symmetric'),
    ({'weights': 'brysen'}, "weights = 'brysen': wanted 'matrices' or 'bryson' or 'output'; did "),
    ({'weights': 'bryson', 'x_max': [1.0]}, 'x_max has 1 number; wanted 6'),
    ({'weights': 'output', 'H': [1.0, 2.0]}, 'H has 2 numbers; wanted a multiple of 6'),
    ({'rho': -1.0}, 'rho = -1: wanted at least 0'),
    ({'setpoint': [0.0] * 5}, 'set point of aircraft: wanted 6 numbers'),
    ({'setpoint': [0.0, 0.0, 0.5, 0.0, 0.0, 0.0], 'u_limits': [1.0, 1.0]}, 'found no equilibrium'),
    ({'setpoint': [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]}, 'found no equilibrium of the aircraft'),
    ({'u_limits': [1.0, 1.0]}, 'the input of the set point, f2 = 39.2, is outside u_limits, '
     '[-1, 1]'),
    ({'u_limits': [1.0, 1.0, 1.0, 50.0]}, 'u_limits of f1: the lower limit 1 is not below the '
     'upper limit 1'),
    ({'u_limits': [1.0]}, 'u_limits has 1 number; wanted 2, the maximum absolute value of each, '
     'or 4, lower and upper limit of each'),
    ({'u_limits': [1.0, -50.0]}, 'u_limits of f2: -50; wanted a positive number'),
    ({'u_limits': [1.0, math.nan]}, 'u_limits[1] = nan: wanted a finite number'),
    ({'u_min': [1.0, 1.0]}, "no parameter 'u_min'; u_min does not limit the inputs: write "
     'u_limits: [1.0, .inf, 1.0, .inf]'),
    ({'u_max': [1.0, 50.0]}, 'u_max is not used with weights = matrices; set weights to bryson '
     'first, or both with set_parameters_atomically; u_max does not limit the inputs: write '
     'u_limits: [-.inf, 1.0, -.inf, 50.0]'),
    ({'setpoint_input': [0.0, 30.0]}, 'setpoint_input: f2 = 30 is not used, because the set p'),
    ({'rate': -1.0}, 'rate = -1: wanted at least 0 Hz'),
    ({'on_stale': 'panic'}, "on_stale = 'panic': wanted 'equilibrium' or 'hold' or 'silent'"),
    ({'x_limits': [1.0, 2.0]}, 'x_limits has 2 numbers; wanted 6 or 12'),
    ({'x_limits': [-1.0] * 6}, 'x_limits of px: [1, -1]; wanted a negative lower limit'),
    ({'integral': ['px'], 'Qi': [-1.0]}, 'Qi[0] = -1: Qi must be positive semidefinite'),
    ({'design': 'sampled', 'rate': 20.0, 'Qx': [-1.0] * 6}, 'Qx[0] = -1: Qx must be positive'),
    ({'Qu': [1e-30, 1e30]}, '(A, B) is numerically not stabilisable at these weights'),
    ({'integral': ['pz']}, "integral: there is no state 'pz' in px, py, theta"),
    ({'stability': 1e9}, 'degree of stability'),
    ({'system_parameters.m': -4.0}, 'system_parameters.m = -4: wanted'),
    ({'system': 'vehicle'}, 'read-only'),
    ({'Qz': [1.0]}, "no parameter 'Qz'; did you mean 'Qx'?"),
    ({'Qx': None}, 'Qx cannot be deleted, only set'),
]


def test_each_refusal_has_its_reason(spawn: Any, probe: Any) -> None:
    """A refusal leaves gain and revision unchanged, and diagnostics report it."""
    bench = Bench(spawn, probe)
    before = bench.answer(X)
    for values, sentence in REFUSED:
        result = bench.set(**values)
        assert not result.successful, values
        assert sentence in result.reason, (values, result.reason)
        assert (bench.answer(X) == before).all(), values
    assert [design.revision for design in bench.designs] == [1]
    last = [sentence for values, sentence in REFUSED if 'system' not in values][-1]
    bench.report('design', lambda status, values: values['last refusal'] == last
                 and values['revision'] == '1')
    assert 'Traceback' not in bench.process.output()


def test_brysons_rule_is_set_one_parameter_at_a_time(spawn: Any, probe: Any) -> None:
    """Scales that are not given are 1."""
    bench = Bench(spawn, probe)
    for values in ({'weights': 'bryson'}, {'x_max': [0.1, 0.1, 0.1, 1.0, 1.0, 1.0]},
                   {'u_max': [5, 5]}):
        result = bench.set(**values)
        assert result.successful, result.reason
    found = bench.design(4)
    np.testing.assert_allclose(matrix(found.qx, 6), np.diag([100, 100, 100, 1, 1, 1]))
    np.testing.assert_allclose(matrix(found.qu, 2), 0.04 * np.eye(2))


def test_atomic_changes_are_accepted_or_refused_as_a_whole(spawn: Any, probe: Any) -> None:
    """Values that fit only together are set atomically; others may be set one by one."""
    bench = Bench(spawn, probe)
    assert not bench.set(Qx=[2.0] * 6, Qu=[1.0, -1.0]).successful
    assert probe.get_parameters('/lqr_node', 'Qx') == {'Qx': []}
    assert bench.set(weights='bryson', x_max=[1.0, 1.0, 0.5, 2.0, 2.0, 1.0],
                     u_max=[5, 50]).successful
    np.testing.assert_allclose(
        matrix(bench.design(2).qx, 6), np.diag([1, 1, 4, 0.25, 0.25, 1]))
    assert bench.set(weights='output', H=[1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0], rho=4).successful
    np.testing.assert_allclose(matrix(bench.design(3).qu, 2), 4 * np.eye(2))
    results = probe.set_parameters('/lqr_node', weights='matrices', Qx=[-1.0] * 6, Qu=[2.0, 2.0])
    assert [each.successful for each in results] == [True, False, True]
    np.testing.assert_allclose(matrix(bench.design(5).qu, 2), 2 * np.eye(2))


def test_the_node_starts_with_given_values(spawn: Any, probe: Any) -> None:
    bench = Bench(spawn, probe, system='double_integrator', Qx=[4, 0], Qu=[1],
                  setpoint=[1, 0], u_limits=[0.5])
    design = bench.design(1)
    np.testing.assert_allclose(design.k, [2.0, 2.0], rtol=1e-10)  # Example 2.4, q = 2
    np.testing.assert_allclose(bench.answer([1.1, 0.0]), [-0.2], rtol=1e-10)
    assert bench.answer([-1.0, 0.0]) == 0.5


def test_the_node_starts_with_values_of_the_command_line(spawn: Any, probe: Any) -> None:
    """A bad value of the command line ends the node with status 1."""
    designs = probe.listen(LqrDesign, '/lqr_node/design', LATCHED)
    spawn('lqr_node', arguments=['--ros-args', '-p', 'system:=double_integrator',
                                 '-p', 'Qx:=[4.0, 0.0]', '-p', 'Qu:=[1]',
                                 '-p', 'unlimited:=true'])
    probe.wait_for(lambda: designs)
    np.testing.assert_allclose(designs[0].k, [2.0, 2.0], rtol=1e-10)  # Example 2.4, q = 2
    bad = spawn('lqr_node', arguments=['--ros-args', '-p', 'Qu:=[-1, 1]'], name='bad')
    assert bad.wait() == 1
    assert 'Qu[0] = -1: Qu must be positive definite' in bad.output()


@pytest.mark.parametrize(('parameters', 'sentence'), [
    ({'Qx': [1.0, 2.0]}, 'Qx has 2 numbers; wanted 6'),
    ({'Qu': [1, -1]}, 'Qu[1] = -1: Qu must be positive definite'),
    ({'system': 'aircarft'}, "unknown system 'aircarft' (did you mean 'aircraft'?)"),
    ({'system': 'vehicle', 'state_source': 'imu'},
     "state_source = 'imu': wanted 'state' or 'odom'"),
])
def test_a_bad_start_has_one_sentence(probe: Any, parameters: Any, sentence: str) -> None:
    refusal = probe.refusal(LqrNode, parameters)
    assert sentence in refusal
    assert '\n' not in refusal


def test_a_bad_start_ends_with_one_sentence(spawn: Any) -> None:
    """The exit status is 1, and there is no traceback."""
    process = spawn('lqr_node', {'Qx': [1.0, 2.0]})
    assert process.wait() == 1
    assert [line for line in process.output().splitlines() if '[rcl]' not in line] == [
        'lqr_node: Qx has 2 numbers; wanted 6 (a diagonal) or 36 (a full matrix row by row)']


@pytest.mark.parametrize('qos', [10, BEST_EFFORT], ids=['reliable', 'best effort'])
def test_invalid_states_are_dropped_and_counted(spawn: Any, probe: Any, qos: Any) -> None:
    """The next valid state is answered, from reliable and best-effort publishers."""
    bench = Bench(spawn, probe, qos, **{'qos_overrides./state.subscription.depth': 10})
    good = bench.ask(X)
    for bad in ([math.nan, *X[1:]], [*X[1:], math.inf], X[1:], [*X, 0.0], []):
        bench.send(bad)
        assert (bench.ask(X) == good).all()
    assert all(np.isfinite(each.u).all() for each in bench.commands)
    status = bench.report('states', lambda status, values: values['dropped not finite'] == '2')
    assert {each.key: each.value for each in status.values}['dropped of wrong size'] == '3'
    bench.process.wait_for_output('a state with px = nan was dropped')


def test_each_choice_of_on_stale_is_obeyed(spawn: Any, probe: Any) -> None:
    """on_stale takes effect after state_timeout; returning states end it."""
    bench = Bench(spawn, probe, state_timeout=0.1)
    good = bench.answer(X)
    for action, expected in (('equilibrium', HOVER), ('hold', good), ('silent', None)):
        assert bench.set(on_stale=action).successful
        assert bench.answer(X) == pytest.approx(good)
        seen = len(bench.commands)
        status = bench.report('states', lambda status, _, what=action: 'no valid state' in
                              status.message and f'on_stale: {what}' in status.message)
        assert status.level == b'\x02'
        commanded = [np.array(each.u) for each in bench.commands[seen:]]
        assert bool(commanded) == (expected is not None)
        assert all((u == expected).all() for u in commanded)
    assert bench.answer(X) == pytest.approx(good)  # recovers without ~/start
    bench.report('states', lambda status, _: status.level != b'\x02' or bench.send(X))


def test_stop_is_latched_until_start(spawn: Any, probe: Any) -> None:
    """While stopped the node answers every state with the equilibrium input."""
    bench = Bench(spawn, probe)
    good = bench.answer(X)
    assert (bench.probe.call(Trigger, '/lqr_node/stop').message).startswith('stopped at ')
    for _ in range(3):
        assert (bench.answer(X) == HOVER).all()
    assert bench.set(Qx=[2.0] * 6).successful  # a change of parameters does not start it
    assert (bench.answer(X) == HOVER).all()
    bench.report('commands', lambda status, _: 'stopped: by ~/stop' in status.message)
    assert bench.set(Qx=[1.0] * 6).successful
    assert 'stopped by ~/stop' in bench.probe.call(Trigger, '/lqr_node/start').message
    assert (bench.answer(X) == good).all()
    assert bench.probe.call(Trigger, '/lqr_node/start').message == 'it was not stopped'


def test_the_design_is_latched_and_sigint_commands_rest(spawn: Any, probe: Any) -> None:
    """A late subscriber gets the design; the last command at SIGINT is the equilibrium input."""
    bench = Bench(spawn, probe)
    assert bench.set(Qx=[2.0] * 6).successful
    bench.design(2)
    later = Probe(spawn.domain, name='later')
    try:
        designs = later.listen(LqrDesign, '/lqr_node/design', LATCHED)
        later.wait_for(lambda: designs)
        assert designs[0].revision == 2
    finally:
        later.close()
    bench.answer(X)
    seen = len(bench.commands)
    assert bench.process.interrupt() == 0
    probe.wait_for(lambda: len(bench.commands) > seen)
    assert (np.array(bench.commands[-1].u) == HOVER).all()
    assert 'Traceback' not in bench.process.output()


def test_the_loop_in_lockstep_equals_the_loop_in_one_process(spawn: Any, probe: Any) -> None:
    """The states agree to 1e-12 with those of the same loop integrated here."""
    bench = Bench(spawn, probe, **EXAMPLE_2_5)
    design = bench.design(1)
    start = [0.5, -0.3, 0.1, 0.0, 0.0, 0.0]
    states: list[State] = probe.listen(State, 'state', 1_000)
    spawn('plant_simulator', {'lockstep': True, 'speed': 0.0, 'x0': start,
                              'publish_rate': 200.0, 'dt': 0.001})
    probe.wait_for(lambda: len(states) > 800)
    over_dds = {nanoseconds(each): list(each.x) for each in states}
    K, plant = matrix(design.k, 2), Simulator(registry.get_system('aircraft'), start)
    worst, compared = 0.0, 0
    for k in range(max(over_dds) // 5_000_000):
        if k * 5_000_000 in over_dds:  # the first states precede the connection of the probe
            compared += 1
            worst = max(worst, np.abs(plant.x - over_dds[k * 5_000_000]).max())
        plant.command(np.array(design.ue) - K @ (plant.x - np.array(design.xe)))
        plant.advance(5)
    assert compared > 700, (compared, worst)
    assert worst < 1e-12, (compared, worst)


def test_a_killed_node_is_replaced(spawn: Any, probe: Any) -> None:
    """After SIGKILL a new node takes over the plant in lockstep."""
    bench = Bench(spawn, probe)
    states: list[State] = probe.listen(State, 'state')
    spawn('plant_simulator', {'lockstep': True, 'speed': 0.0, 'publish_clock': True, 'x0': X})
    probe.wait_for(lambda: len(states) > 100)
    bench.process.kill()
    probe.spin_for(0.1)
    before = states[-1].header.stamp
    spawn('lqr_node', {'stamp_timeout': 0.0})
    probe.wait_for(lambda: states[-1].header.stamp.sec > before.sec + 1)


def test_commands_follow_the_last_accepted_of_random_changes(spawn: Any, probe: Any) -> None:
    """Valid and invalid changes are mixed; every accepted gain stabilises."""
    bench = Bench(spawn, probe)
    rng = random.Random(1)
    revision, seen = 1, []
    for _ in range(60):
        good, values = _change(rng)
        result = bench.set(**values)
        assert result.successful == good, (values, result.reason)
        revision += good
        x = [rng.uniform(-1, 1) for _ in range(6)]
        u = bench.answer(x)
        design = bench.design(revision)
        K = matrix(design.k, 2)
        np.testing.assert_allclose(
            u, np.array(design.ue) - K @ (np.array(x) - design.xe), rtol=1e-12, atol=1e-11)
        A, B = matrix(design.a, 6), matrix(design.b, 6)
        assert np.linalg.eigvals(A - B @ K).real.max() < 0.0
        seen.append(design.revision)
    assert seen[-1] == revision > 15
    assert [each.revision for each in bench.designs] == list(range(1, revision + 1))


def _change(rng: random.Random) -> tuple[bool, dict[str, Any]]:
    """Return whether a change is valid, and the change."""
    good = [
        {'Qx': [10**rng.uniform(-3, 3) for _ in range(6)]},
        {'Qu': [10**rng.uniform(-3, 3) for _ in range(2)]},
        {'Qx': [rng.randint(1, 9) for _ in range(6)], 'Qu': [rng.randint(1, 9) for _ in range(2)]},
        {'setpoint': [rng.uniform(-2, 2), rng.uniform(-2, 2), 0.0, 0.0, 0.0, 0.0]},
        {'system_parameters.m': rng.uniform(1, 9)},
    ]
    bad = [
        {'Qx': [rng.uniform(-3, -1) for _ in range(6)]},
        {'Qx': [1.0] * rng.choice([1, 2, 5, 7, 35, 37])},
        {'Qu': [rng.choice([math.nan, math.inf, -1.0, 0.0]), 1.0]},
        {'setpoint': [0.0, 0.0, 0.0, rng.uniform(1, 2), 0.0, 0.0]},
        {'Qx': [2.0] * 6, 'Qu': ['a', 'b']},
        {'Qu': [1.0, 2.0], 'q': 1.0},
    ]
    is_good = rng.random() < 0.5
    return is_good, rng.choice(good if is_good else bad)


def test_ten_thousand_refusals_leave_gain_and_memory(spawn: Any, probe: Any) -> None:
    bench = Bench(spawn, probe)
    before = bench.answer(X)

    def refuse(count: int) -> None:
        values = [[1.0, 1.0 + k, -1.0 - k] for k in range(count)]
        requests = SetParameters.Request(parameters=[
            Parameter('Qu', value=value[1:]).to_parameter_msg() for value in values])
        results = probe.call(SetParameters, '/lqr_node/set_parameters', requests).results
        assert len(results) == count
        assert not any(each.successful for each in results)

    for _ in range(2):   # memory that is allocated once, in each thread, is allocated now
        refuse(1_000)
    memory = _resident(bench.process.pid)
    for _ in range(8):
        refuse(1_000)
        assert (bench.answer(X) == before).all()
    assert _resident(bench.process.pid) - memory < 1_000  # [kB]
    bench.report('design', lambda status, values: values['changes refused'] == '10000')


def _resident(pid: int) -> int:
    """Return the resident memory of a process [kB]."""
    status = Path(f'/proc/{pid}/status').read_text()
    return int(status.split('VmRSS:')[1].split()[0])


def test_the_node_has_no_slow_imports() -> None:
    """Packages that load slowly are imported only where they are used."""
    script = ('import sys, obc_ros.nodes.lqr_node\n'
              "slow = ('control', 'matplotlib', 'scipy.optimize', 'scipy.signal',\n"
              "        'scipy.integrate', 'pandas', 'rich', 'mcap')\n"
              'print([name for name in slow if name in sys.modules])')
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                          check=True)
    assert done.stdout.strip() == '[]'


def test_commands_have_the_stamp_of_their_state(spawn: Any, probe: Any) -> None:
    """Stamps from 0 to the present epoch are unchanged."""
    bench = Bench(spawn, probe)
    for stamp in (0.0, 1e-9, 12.5, 1_700_000_000.123456789):
        bench.answer(X, stamp)
