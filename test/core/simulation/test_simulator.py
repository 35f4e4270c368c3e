# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The simulated plant compared with closed forms and with an independent integrator."""

from hypothesis import example, given
from hypothesis import strategies as st
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from obc_ros.core.simulation.flow import Conditions, Gust
from obc_ros.core.simulation.simulator import compute_resting_input, Simulator
from obc_ros.core.systems import registry
from obc_ros.core.systems.equilibrium import find_equilibrium, linearize
from obc_ros.core.text.errors import DynamicsError, ObcError, StatementError
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.linalg import expm, solve_continuous_are

PERIOD = 5  # steps between two commands


@pytest.fixture(scope='module')
def aircraft():
    return registry.get_system('aircraft')


@pytest.fixture(scope='module')
def feedback(aircraft):
    """Return the LQR law u = ue - K (x - xe) about (1, 1) with Qx = Qu = I."""
    hover = find_equilibrium(aircraft, [1, 1, 0, 0, 0, 0])
    A, B = linearize(aircraft, hover.x, hover.u)
    K = B.T @ solve_continuous_are(A, B, np.eye(6), np.eye(2))
    return lambda x: hover.u - K @ (x - hover.x)


def fly(simulator, feedback, seconds):
    """Return the states at the times of the commands, which are PERIOD steps apart."""
    states = [simulator.x]
    for _ in range(round(seconds / (PERIOD * simulator.conditions.dt))):
        simulator.command(feedback(simulator.x))
        simulator.advance(PERIOD)
        states.append(simulator.x)
    return np.array(states)


def reference(system, x0, feedback, seconds, period):
    """Integrate the same loop with DOP853 at tight tolerances."""
    states = [np.array(x0, dtype=float)]
    for _ in range(round(seconds / period)):
        u = feedback(states[-1])
        solution = solve_ivp(lambda t, x: system.f(x, u), (0, period), states[-1],  # noqa: B023
                             method='DOP853', rtol=1e-13, atol=1e-15)
        states.append(solution.y[:, -1])
    return np.array(states)


@pytest.mark.slow
@pytest.mark.parametrize(('x0', 'dt'), [
    ([0, 0, 0, 0, 0, 0], 1e-3),  # the step of figure 2.4
    ([0, 0, 0.3, 0.5, -0.5, 1.0], 5e-4),
])
def test_the_aircraft_agrees_with_an_independent_integrator(aircraft, feedback, x0, dt):
    flown = fly(Simulator(aircraft, x0, Conditions(dt=dt)), feedback, 4.0)
    wanted = reference(aircraft, x0, feedback, 4.0, PERIOD * dt)
    assert np.abs(flown - wanted).max() < 1e-12


def test_the_adaptive_integrator_agrees_with_an_independent_one(aircraft, feedback):
    x0 = [0, 0, 0.3, 0.5, -0.5, 1.0]
    conditions = Conditions(integrator='adaptive', tolerance=1e-12)
    flown = fly(Simulator(aircraft, x0, conditions), feedback, 2.0)
    wanted = reference(aircraft, x0, feedback, 2.0, PERIOD * 1e-3)
    assert np.abs(flown - wanted).max() < 2e-12


def final_state(system, x0, u, seconds, **conditions):
    simulator = Simulator(system, x0, Conditions(**conditions))
    simulator.command(u)
    simulator.advance(round(seconds / simulator.conditions.dt))
    return simulator.x


def test_rk4_has_order_four(aircraft):
    x0, u = [0, 0, 0.3, 0.5, -0.5, 4.0], [0.5, 30.0]
    wanted = final_state(aircraft, x0, u, 2.0, dt=1.0, integrator='adaptive', tolerance=1e-12)
    errors = [np.abs(final_state(aircraft, x0, u, 2.0, dt=dt) - wanted).max()
              for dt in (0.1, 0.05, 0.025)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert_allclose(orders, 4.0, atol=0.35)


@pytest.mark.parametrize('tolerance', [1e-3, 1e-5, 1e-7, 1e-9, 1e-11])
@pytest.mark.parametrize(('name', 'x0', 'u'), [
    ('aircraft', [0, 0, 0.3, 0.5, -0.5, 4.0], [0.5, 30.0]),
    ('vehicle', [0, 0, 0], [8.0, 0.5]),
    ('cubic', [5.0], [1.0]),
])
def test_the_adaptive_integrator_keeps_to_its_tolerance(name, x0, u, tolerance):
    system, seconds = registry.get_system(name), 3.0
    exact = solve_ivp(lambda t, x: system.f(x, u), (0, seconds), x0,
                      method='DOP853', rtol=1e-13, atol=1e-15).y[:, -1]
    found = final_state(system, x0, u, seconds, dt=0.5, integrator='adaptive',
                        tolerance=tolerance)
    scale = np.maximum(1.0, np.abs(exact))
    assert (np.abs(found - exact) / scale).max() < tolerance * seconds


def double_integrator_under(pieces, until):
    """Return the exact state at `until`; pieces are (begin, acceleration), the first at 0."""
    x = v = 0.0
    ends = [*(begin for begin, _ in pieces[1:]), np.inf]
    for (begin, u), end in zip(pieces, ends, strict=True):
        h = max(0.0, min(end, until) - min(begin, until))
        x, v = x + v * h + u * h * h / 2, v + u * h
    return [x, v]


@pytest.mark.slow
@pytest.mark.parametrize('integrator', ['rk4', 'adaptive'])
@given(st.floats(0.0, 0.03), st.lists(st.floats(-2, 2), min_size=1, max_size=5))
@example(delay=0.0025, commands=[1.0, -2.0])
@example(delay=0.005, commands=[1.0, -2.0])
@example(delay=1e-300, commands=[1.0, -2.0])
def test_the_input_delay_is_exact(integrator, delay, commands):
    conditions = Conditions(input_delay=delay, integrator=integrator, tolerance=1e-11)
    simulator = Simulator(registry.get_system('double_integrator'), [0, 0], conditions)
    for u in commands:
        simulator.command([u])
        simulator.advance(PERIOD)
    simulator.advance(20)
    pieces = [(0.0, 0.0), *((k * PERIOD * 1e-3 + delay, u) for k, u in enumerate(commands))]
    assert_allclose(simulator.x, double_integrator_under(pieces, simulator.time), atol=1e-12)


def test_actuators_lag_like_a_first_order_filter():
    lag, u = 0.05, 2.0
    simulator = Simulator(registry.get_system('double_integrator'), [0, 0],
                          Conditions(actuator_lag=(lag,), dt=5e-4))
    for _ in range(3):  # Repeated commands do not reset the state of the actuator.
        simulator.command([u])
        simulator.advance(37)
    t = simulator.time
    decay = np.exp(-t / lag)
    assert_allclose(simulator.u, [u * (1 - decay)], rtol=1e-14)
    v = u * (t - lag * (1 - decay))
    x = u * (t * t / 2 - lag * t + lag * lag * (1 - decay))
    assert_allclose(simulator.x, [x, v], rtol=1e-10)


def test_each_actuator_has_its_own_lag(aircraft):
    simulator = Simulator(aircraft, conditions=Conditions(actuator_lag=(0.1, 0.0)))
    simulator.command([1.0, 40.0])
    assert_allclose(simulator.u, [0.0, 40.0], atol=1e-15)
    simulator.advance(100)
    assert_allclose(simulator.u, [1 - np.exp(-1), 40.0], rtol=1e-14)


@pytest.mark.parametrize('integrator', ['rk4', 'adaptive'])
@pytest.mark.parametrize(('start', 'duration'), [(0.1, 1.0), (0.1234567, 0.7654321), (-0.3, 0.5)])
def test_a_gust_transfers_its_impulse(integrator, start, duration):
    amplitude, constant = 3.0, 0.25
    gust = Gust((0.0, amplitude), start, duration)
    simulator = Simulator(registry.get_system('double_integrator'), [0, 0], Conditions(
        gust=gust, disturbance=(0.0, constant), integrator=integrator, tolerance=1e-12))
    simulator.advance(1500)
    blown = amplitude * quad(gust.shape, max(start, 0.0), start + duration, epsabs=1e-14)[0]
    if start >= 0:
        assert blown == pytest.approx(amplitude * duration / 2, rel=1e-12)
    assert simulator.x[1] == pytest.approx(blown + constant * 1.5, abs=3e-12)


@pytest.mark.slow
@given(st.floats(0.001, 0.01), st.integers(1, 40))
def test_linear_systems_follow_the_matrix_exponential(h, steps):
    A = np.array([[0.0, 1.0, 0.0], [-4.0, -0.5, 1.0], [0.0, -1.0, -2.0]])
    B = np.array([[0.0], [1.0], [0.5]])
    simulator = Simulator(registry.get_system('linear', A=A, B=B), [1, -1, 2], Conditions(dt=h),
                          [0.0])
    simulator.command([0.7])
    simulator.advance(steps)
    both = expm(np.block([[A, B], [np.zeros((1, 4))]]) * h * steps)
    assert_allclose(simulator.x, both[:3] @ [1, -1, 2, 0.7], atol=1e-9)


@pytest.mark.parametrize('conditions', [
    Conditions(), Conditions(integrator='adaptive'),
    Conditions(noise=(0.01,), gust=Gust((0, 0, 0, 2.0, 0, 0), 0.0133, 0.1),
               actuator_lag=(0.02,), input_delay=0.0071, seed=4)])
def test_the_same_calls_give_identical_results(aircraft, feedback, conditions):
    simulator = Simulator(aircraft, [0, 0, 0.1, 0, 0, 0], conditions)
    first, noisy = fly(simulator, feedback, 0.5), simulator.measure()
    simulator.reset()
    assert simulator.steps == 0
    assert_array_equal(fly(simulator, feedback, 0.5), first)
    assert_array_equal(simulator.measure(), noisy)
    other = Simulator(aircraft, [0, 0, 0.1, 0, 0, 0], conditions)
    assert_array_equal(fly(other, feedback, 0.5), first)


def test_several_steps_at_once_equal_single_steps(aircraft):
    conditions = Conditions(gust=Gust((0, 0, 0, 2.0, 0, 0), 0.0133, 0.01), actuator_lag=(0.02,))
    together, single = (Simulator(aircraft, [0, 0, 0.1, 0, 0, 0], conditions) for _ in range(2))
    for simulator in (together, single):
        simulator.command([0.5, 38.0])
    together.advance(33)
    for _ in range(33):
        single.advance()
    assert_array_equal(together.x, single.x)
    assert together.time == single.time == 33 * 1e-3


def test_noise_affects_only_the_output_and_has_its_deviation(aircraft):
    deviation = np.array([0.1, 0.2, 0.0, 1.0, 2.0, 3.0])
    simulator = Simulator(aircraft, conditions=Conditions(noise=tuple(deviation), seed=7))
    samples = np.array([simulator.measure() for _ in range(4000)])
    assert_array_equal(simulator.x, np.zeros(6))
    # Bounds: 4.5 standard errors of the mean and of the deviation.
    assert (np.abs(samples.mean(axis=0)) <= 4.5 * deviation / np.sqrt(4000)).all()
    assert_allclose(samples.std(axis=0), deviation, rtol=4.5 / np.sqrt(8000))
    other = Simulator(aircraft, conditions=Conditions(noise=tuple(deviation), seed=8))
    assert not np.array_equal(other.measure(), samples[0])


def test_commands_are_clipped_to_the_limits():
    vehicle = Simulator(registry.get_system('vehicle'))
    vehicle.command([-3.0, 2.0])
    assert vehicle.target == (0.0, 0.6)


@pytest.mark.parametrize('u', [
    [np.nan, 0.0], [0.0, np.inf], [0.0], [0.0, 0.0, 0.0], [], ['a', 'b'], None, [[0.0, 0.0]],
    [None, 1.0]])
@pytest.mark.parametrize('delay', [0.0, 0.01])
def test_an_invalid_command_changes_nothing(aircraft, u, delay):
    simulator = Simulator(aircraft, conditions=Conditions(input_delay=delay))
    with pytest.raises(StatementError, match='^u: '):
        simulator.command(u)
    simulator.advance(20)
    assert_allclose(simulator.x, np.zeros(6), atol=1e-15)


def test_a_state_that_overflows_is_kept_and_reported():
    for integrator in ('rk4', 'adaptive'):
        growing = Simulator(registry.get_system('cubic', {'a': -1.0}), [10.0],
                            Conditions(integrator=integrator), [0.0])
        before = None
        with pytest.raises(DynamicsError, match='cannot be integrated from t = 0.00'):
            for _ in range(100):
                before = growing.x, growing.steps
                growing.advance()
        assert_array_equal(growing.x, before[0])
        assert growing.steps == before[1]
        assert np.isfinite(growing.x).all()


def test_a_stiff_plant_ends_with_a_message_in_bounded_time():
    stiff = registry.get_system('linear', A=[[-1e9]], B=[[1e9]])
    with pytest.raises(DynamicsError, match='requires more than 100000 steps'):
        Simulator(stiff, [1.0], Conditions(dt=1.0, integrator='adaptive'), [0.0]).advance()


def test_parameter_changes_leave_the_state_continuous(aircraft):
    simulator = Simulator(aircraft, conditions=Conditions(actuator_lag=(0.1,)))
    simulator.command([1.0, 39.2])
    simulator.advance(50)
    x, u = simulator.x, simulator.u
    heavy = aircraft.with_parameters({'m': 8.0})
    simulator.configure(heavy, Conditions(actuator_lag=(0.2,), disturbance=(0.0,)))
    assert_array_equal(simulator.x, x)
    assert_allclose(simulator.u, u, rtol=1e-15)
    assert_allclose(simulator.slope(x), heavy.f(x, u))
    simulator.advance(100)
    assert_allclose(simulator.u, [1 + (u[0] - 1) * np.exp(-0.5), 39.2], rtol=1e-13)
    with pytest.raises(StatementError, match='of a simulator cannot change'):
        simulator.configure(registry.get_system('vehicle'), Conditions())
    with pytest.raises(StatementError, match='of a simulator cannot change'):
        simulator.configure(aircraft, Conditions(dt=0.01))


def test_a_shorter_delay_keeps_the_order_of_commands():
    plant = registry.get_system('double_integrator')
    simulator = Simulator(plant, [0, 0], Conditions(input_delay=0.01))
    simulator.command([1.0])
    simulator.configure(plant, Conditions(input_delay=0.0))
    simulator.command([2.0])
    simulator.advance(10)
    assert_allclose(simulator.x, [0, 0])
    simulator.advance(10)
    assert_allclose(simulator.x, [2 * 0.01**2 / 2, 0.02], rtol=1e-12)


def test_before_the_first_command_the_plant_is_at_rest(aircraft):
    simulator = Simulator(aircraft, [3, 4, 0, 0, 0, 0])
    simulator.advance(1000)
    assert_allclose(simulator.x, [3, 4, 0, 0, 0, 0], atol=1e-12)
    assert_allclose(compute_resting_input(aircraft, [0, 0, 0.3, 0, 0, 0]), [0, 39.2], atol=1e-12)
    assert_allclose(compute_resting_input(registry.get_system('scalar'), [2.0]), [-2.0])
    straight = Simulator(registry.get_system('vehicle'), [0, -2, 0])
    straight.advance(1000)
    assert_allclose(straight.x, [10, -2, 0], atol=1e-12)


def test_the_derivative_includes_the_disturbance(aircraft):
    simulator = Simulator(aircraft, conditions=Conditions(
        disturbance=(0, 0, 0, 0.5, 0, 0), gust=Gust((0, 0, 0, 0, 2.0, 0), 0.0, 0.02)))
    simulator.advance(10)  # The gust has its maximum here.
    slope = simulator.slope(np.zeros(6))
    assert_allclose(slope, [0, 0, 0, 0.5, 2.0, 0], atol=1e-12)


@pytest.mark.parametrize(('conditions', 'words'), [
    ({'dt': 0.0}, 'dt = 0: wanted'), ({'dt': np.nan}, 'dt = nan'),
    ({'integrator': 'euler'}, "integrator = 'euler': wanted 'rk4' or 'adaptive'"),
    ({'tolerance': 1e-15}, 'tolerance = 1e-15: wanted a number of at least 1e-12'),
    ({'input_delay': -1.0}, 'input_delay = -1: wanted'),
    ({'input_delay': np.inf}, 'input_delay = inf'),
    ({'noise': (0.1, 0.2)}, r'noise: wanted 6 numbers \(px, py, .*\), found 2'),
    ({'noise': (-0.1,)}, 'noise of px = -0.1: wanted a number of at least 0'),
    ({'actuator_lag': (0.1, np.nan)}, 'actuator_lag of f2 = nan'),
    ({'disturbance': (np.inf,)}, 'disturbance of px = inf: wanted a number that is finite'),
    ({'gust': Gust((1.0,), 0.0, 0.0)}, 'gust duration = 0'),
    ({'gust': Gust((1.0,), np.nan)}, 'gust start = nan'),
    ({'seed': -1}, 'seed = -1'),
])
def test_invalid_conditions_are_rejected(aircraft, conditions, words):
    with pytest.raises(StatementError, match=words):
        Simulator(aircraft, conditions=Conditions(**conditions))


extreme = st.floats(allow_nan=True) | st.sampled_from([0.0, 5e-324, 1e-9, 1.0, 1e308, -1e308])


@given(st.sampled_from(['rk4', 'adaptive']), st.lists(extreme, min_size=9, max_size=9))
@example('rk4', [1.0, 1e-3, 5e-324, 1e308, 1e308, 1e308, 1e308, 1e308, 1e-3])
@example('adaptive', [1.0, 1e-3, 0.0, 0.0, 0.0, 0.0, 1.0, 1e-300, 1e-3])
def test_any_conditions_give_a_state_or_an_error(integrator, numbers):
    u, dt, lag, delay, noise, disturbance, amplitude, start, duration = numbers
    try:
        simulator = Simulator(registry.get_system('double_integrator'), conditions=Conditions(
            dt=dt, integrator=integrator, actuator_lag=(lag,), input_delay=delay, noise=(noise,),
            disturbance=(disturbance,), gust=Gust((amplitude,), start, duration)))
        simulator.command([u])
        for _ in range(7):
            simulator.advance()
    except ObcError as error:
        assert str(error)
    else:
        assert np.isfinite(simulator.x).all()
        simulator.measure()


@pytest.mark.parametrize('x0', [[0.0], [np.nan] * 6, 'x', [[0.0] * 6], [None] * 6])
def test_an_invalid_initial_state_is_rejected(aircraft, x0):
    with pytest.raises(StatementError, match='^x0: '):
        Simulator(aircraft, x0)
    simulator = Simulator(aircraft)
    simulator.advance()
    with pytest.raises(StatementError, match='^x0: '):
        simulator.reset(x0)
    assert simulator.steps == 1, 'it goes on as before'
