# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The simulated plant paced by a clock that the test sets."""

from dataclasses import replace
import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from obc_ros.core.simulation.flow import Conditions, Gust
from obc_ros.core.simulation.paced_plant import (
    BEFORE,
    choose_step,
    HELD_UP,
    LATE,
    PacedPlant,
    Pacing,
    REGAIN,
    RESEND,
)
from obc_ros.core.simulation.simulator import Simulator
from obc_ros.core.systems import registry
from obc_ros.core.text.errors import StatementError
import pytest

START = 1000.0         # [s] of the steady clock
AHEAD = 7 * 10**9      # [ns] offset of the wall clock from the steady clock
PERIOD = 0.005         # [s]


class Bench:
    """A plant, its clock, and the states that it has published."""

    def __init__(self, name='double_integrator', x0=(0.0, 0.0), conditions=None, **pacing):
        self.now = START
        simulator = Simulator(registry.get_system(name), x0, conditions)
        self.plant = PacedPlant(simulator, Pacing(5, **pacing), self.now, self.wall)
        self.stamps = [self.plant.stamp]

    @property
    def wall(self):
        return round(self.now * 1e9) + AHEAD

    def poll(self):
        published = self.plant.poll(self.now, self.wall)
        if published:
            self.stamps.append(self.plant.stamp)
        return published

    def run(self, seconds, late=0.0):
        """Advance the clock, polling `late` seconds after the plant asks for it."""
        end = self.now + seconds
        while self.now + (wait := self.plant.wait(self.now)) + late < end:
            self.now += wait + late
            self.poll()
        self.now = end


def test_the_grid_divides_the_period():
    assert choose_step(1e-3, 200.0) == (1e-3, 5)
    assert choose_step(1e-3, 1000.0) == (1e-3, 1)
    assert choose_step(1e-2, 1000.0) == (1e-3, 1)
    dt, steps = choose_step(1e-3, 300.0)
    assert (steps, dt * steps) == (4, pytest.approx(1 / 300))


@given(st.floats(1e-4, 1.0), st.floats(0.1, 1e4))
def test_the_grid_is_never_coarser_than_requested(dt, rate):
    step, steps = choose_step(dt, rate)
    assert steps >= 1
    assert step <= dt * (1 + 1e-9)
    assert step * steps == pytest.approx(1 / rate, rel=1e-12)


@pytest.mark.slow
@given(st.lists(st.floats(0.0, 0.45 * PERIOD), min_size=1, max_size=50))
def test_late_polls_do_not_change_the_stamps_of_states(lates):
    bench = Bench()
    for late in lates:
        bench.now += bench.plant.wait(bench.now) + late
        assert bench.poll()
    expected = round(START * 1e9) + AHEAD + 5_000_000 * np.arange(len(lates) + 1)
    assert_allclose(np.array(bench.stamps) - expected, 0, atol=2)
    assert bench.plant.held_up == 0


def test_time_does_not_drift_in_an_hour():
    bench = Bench(conditions=Conditions(dt=0.02))
    bench.run(3600.0, late=0.003)
    assert bench.plant.simulator.time == pytest.approx(3600.0, abs=0.1)
    assert len(bench.stamps) == pytest.approx(36_000, abs=1)


@pytest.mark.parametrize('speed', [0.1, 1.0, 2.0, 50.0])
def test_speed_is_simulated_seconds_per_second(speed):
    bench = Bench(speed=speed, simulated_stamps=True)
    bench.run(2.0)
    assert bench.plant.simulator.time == pytest.approx(2.0 * speed, abs=PERIOD + 1e-9)
    assert_allclose(np.diff(bench.stamps), 5_000_000)
    assert bench.stamps[0] == 0


def test_at_speed_zero_every_poll_publishes_a_state():
    bench = Bench(speed=0.0, simulated_stamps=True)
    for _ in range(100):
        assert bench.plant.wait(bench.now) == 0.0
        assert bench.poll()
    assert bench.stamps == [5_000_000 * k for k in range(101)]
    assert bench.plant.held_up == 0


@pytest.mark.slow
@given(st.floats(1.01 * LATE * PERIOD, HELD_UP - PERIOD))
def test_after_a_short_stall_no_state_is_left_out(late):
    bench = Bench()
    bench.run(0.1 - PERIOD / 2)
    bench.now += PERIOD / 2 + late
    assert bench.poll()
    assert bench.plant.held_up == 1
    assert bench.plant.behind == pytest.approx(late - REGAIN * PERIOD, abs=1e-9)
    last = bench.now
    while bench.plant.behind:
        assert bench.plant.wait(bench.now) >= (1 - LATE) * PERIOD, 'time to answer'
        bench.now += bench.plant.wait(bench.now)
        assert bench.poll()
    assert bench.now - last <= (late / PERIOD / REGAIN + 1) * PERIOD
    bench.run(0.1)
    assert_allclose(np.diff(bench.stamps), 5_000_000, atol=2)
    assert bench.plant.simulator.time == pytest.approx(bench.now - START, abs=PERIOD + 1e-9)


def test_a_command_sent_during_a_stall_acts_at_the_state_then_due():
    bench = Bench()
    bench.now += PERIOD + 0.1
    assert bench.plant.command(bench.stamps[-1], [3.0], bench.now) == ''
    assert bench.poll()
    assert bench.plant.unanswered == 0
    bench.now += bench.plant.wait(bench.now)
    assert bench.poll()
    assert_allclose(bench.plant.sample, [3 * PERIOD**2 / 2, 3 * PERIOD], rtol=1e-9)


def test_after_a_long_stall_the_plant_resumes_where_it_was():
    bench = Bench()
    bench.run(0.1)
    before = bench.plant.simulator.time
    bench.now += 100.0
    assert bench.poll()
    assert bench.plant.simulator.time <= before + PERIOD + 1e-9
    assert bench.plant.held_up == 1
    assert bench.stamps[-1] == bench.wall, 'the state has the present stamp'
    assert HELD_UP < 100.0


def test_setting_the_wall_clock_back_does_not_stop_the_plant():
    bench = Bench()
    bench.run(0.1)
    bench.now -= 500.0
    bench.poll()
    bench.run(0.1)
    assert bench.plant.simulator.time == pytest.approx(0.2, abs=3 * PERIOD)


def test_a_command_takes_effect_when_it_arrives():
    bench = Bench()
    bench.now += 0.002
    assert bench.plant.command(bench.stamps[-1], [3.0], bench.now) == ''
    bench.now += 0.003
    assert bench.poll()
    assert_allclose(bench.plant.sample, [3 * 0.003**2 / 2, 3 * 0.003], rtol=1e-9)


def test_a_late_command_does_not_change_a_state_already_due():
    bench = Bench()
    bench.now += 0.007
    bench.plant.command(bench.stamps[-1], [3.0], bench.now)
    assert bench.poll()
    assert_array_equal(bench.plant.sample, [0, 0])


@pytest.mark.parametrize(('first', 'second', 'taken'), [
    (-1, 0, 2), (0, 0, 2), (0, -1, 1), (-1, -2, 1)])
def test_commands_with_earlier_stamps_are_dropped(first, second, taken):
    bench = Bench()
    bench.run(0.1)
    for k in (first, second):
        bench.plant.command(bench.stamps[-1] + 5_000_000 * k, [1.0], bench.now)
    assert bench.plant.accepted == taken
    assert bench.plant.dropped.total() == 2 - taken


def test_a_stamp_from_the_future_does_not_block_later_commands():
    bench = Bench()
    bench.run(0.1)
    assert bench.plant.command(bench.stamps[-1] + 10**15, [1.0], bench.now) == ''
    assert bench.plant.command(bench.stamps[-1], [2.0], bench.now) == ''
    simulated = Bench(simulated_stamps=True)
    simulated.run(0.1)
    assert 'later than the last state' in simulated.plant.command(10**15, [1.0], simulated.now)
    assert simulated.plant.command(simulated.stamps[-1], [2.0], simulated.now) == ''


def test_an_unstamped_command_is_applied_in_real_time():
    bench = Bench()
    bench.run(0.1)
    assert bench.plant.command(bench.stamps[-1], [1.0], bench.now) == ''
    assert bench.plant.command(0, [2.0], bench.now) == ''


@pytest.mark.parametrize('u', [[], [1.0, 2.0], [math.nan], [math.inf]])
def test_a_malformed_command_is_dropped_and_counted(u):
    bench = Bench(lockstep=True)
    assert bench.plant.command(bench.stamps[-1], u, bench.now).startswith('malformed: u: ')
    assert bench.plant.dropped == {'malformed': 1}
    assert not bench.plant.answered
    assert not bench.poll(), 'lockstep still waits'


def test_without_commands_the_input_returns_to_rest():
    bench = Bench(command_timeout=0.05)
    bench.plant.command(bench.stamps[-1], [3.0], bench.now)
    bench.run(0.1)
    assert bench.plant.rests == 1
    assert bench.plant.simulator.target == (0.0,)
    assert bench.plant.sample[1] == pytest.approx(3.0 * 0.05, abs=3.0 * PERIOD)
    bench.plant.command(bench.stamps[-1], [3.0], bench.now)
    bench.run(0.01)
    assert bench.plant.simulator.target == (3.0,)


def test_a_command_older_than_the_timeout_is_dropped():
    bench = Bench(command_timeout=0.05)
    bench.run(0.1)
    reason = bench.plant.command(bench.stamps[0], [1.0], bench.now)
    assert reason == 'stale: older than command_timeout'
    assert bench.plant.dropped == {reason: 1}


def test_lockstep_waits_for_the_answer_to_the_last_state():
    bench = Bench(lockstep=True, simulated_stamps=True, speed=0.0)
    for k in range(20):
        bench.now += 0.01
        assert not bench.poll()
        later = bench.stamps[-1] + 1
        assert 'not for the last state' in bench.plant.command(later, [1.0], bench.now)
        assert bench.plant.command(bench.stamps[-1], [1.0], bench.now) == ''
        assert 'already has a command' in bench.plant.command(bench.stamps[-1], [2.0], bench.now)
        assert bench.poll()
        assert bench.stamps[-1] == 5_000_000 * (k + 1)
    t = 0.1
    assert_allclose(bench.plant.sample, [t * t / 2, t], rtol=1e-12)
    assert bench.plant.dropped.total() == 40


def test_lockstep_republishes_an_unanswered_state_unchanged():
    bench = Bench(lockstep=True, conditions=Conditions(noise=(0.1,)))
    first = bench.plant.sample
    bench.run(10 * RESEND + 0.01)
    assert bench.plant.resent == 10
    assert set(bench.stamps) == {bench.stamps[0]}
    assert_array_equal(bench.plant.sample, first)
    assert bench.plant.simulator.steps == 0


def test_lockstep_is_no_faster_than_the_speed():
    bench = Bench(lockstep=True, speed=2.0, simulated_stamps=True)
    while bench.now < START + 1.0:
        bench.plant.command(bench.stamps[-1], [0.0], bench.now)
        bench.now += max(bench.plant.wait(bench.now), 1e-4)
        bench.poll()
    assert bench.plant.simulator.time == pytest.approx(2.0, abs=0.01)


@pytest.mark.parametrize('late', [1.5 * PERIOD, 0.3, 7.0])
def test_a_late_answer_in_lockstep_leaves_a_period_for_the_next_state(late):
    bench = Bench(lockstep=True, simulated_stamps=True)
    bench.run(late)
    assert bench.plant.command(bench.stamps[-1], [1.0], bench.now) == ''
    assert bench.plant.wait(bench.now) == pytest.approx(PERIOD, abs=1e-9)
    bench.now += 0.9 * PERIOD
    assert not bench.poll()
    bench.now += 0.2 * PERIOD
    assert bench.poll()
    assert bench.plant.stamp == 5_000_000
    assert_allclose(bench.plant.sample, [PERIOD**2 / 2, PERIOD], rtol=1e-9)


CONDITIONS = Conditions(noise=(0.01,), actuator_lag=(0.02,), input_delay=0.0071, seed=3,
                        gust=Gust((0.0, 1.0), 0.1, 0.2))


@pytest.mark.slow
@given(st.lists(st.floats(0.0, 0.6), min_size=40, max_size=40))
def test_lockstep_results_do_not_depend_on_the_clock(waits):
    def fly(waits):
        bench = Bench(x0=(1.0, 0.0), conditions=CONDITIONS, lockstep=True, speed=0.0,
                      simulated_stamps=True)
        states = []
        for wait in waits:
            x = bench.plant.sample
            states.append(x)
            bench.now += wait
            bench.poll()
            bench.plant.command(bench.plant.stamp, [-x[0] - 2 * x[1]], bench.now)
            bench.poll()
        return np.array(states)

    assert_array_equal(fly(waits), fly([0.0] * 40))


def test_a_paused_plant_moves_only_on_request():
    bench = Bench(x0=(0.0, 1.0))
    bench.run(0.1)
    assert bench.plant.step(bench.now, bench.wall) == 'the plant is not paused'
    bench.plant.pause(True, bench.now, bench.wall)
    time = bench.plant.simulator.time
    assert bench.plant.wait(bench.now) == math.inf
    bench.now += 5.0
    assert not bench.poll()
    assert bench.plant.simulator.time == time
    published = bench.plant.published
    for k in range(3):
        assert bench.plant.step(bench.now, bench.wall) == ''
        assert bench.plant.published == published + k + 1
        assert bench.plant.stamp == bench.wall
    time = bench.plant.simulator.time
    bench.plant.pause(False, bench.now, bench.wall)
    bench.run(1.0)
    assert bench.plant.simulator.time == pytest.approx(time + 1.0, abs=2 * PERIOD)
    assert bench.plant.held_up == 0


def test_the_stamp_of_time_0_is_known_as_soon_as_a_pause_ends():
    """It is that of the next state less its time; simulated stamps have always 0."""
    bench, other = Bench(), Bench(simulated_stamps=True)
    for each in (bench, other):
        each.run(0.1)
        each.plant.pause(True, each.now, each.wall)
        each.now += 5.0
        each.plant.pause(False, each.now, each.wall)
    known = bench.plant.epoch
    bench.run(0.02)
    assert 1e-9 * bench.stamps[-1] - bench.plant.simulator.time == pytest.approx(known, abs=2e-3)
    assert other.plant.epoch == pytest.approx(0.0, abs=1e-9)


def test_a_paused_lockstep_plant_steps_after_a_command():
    bench = Bench(lockstep=True, simulated_stamps=True)
    bench.plant.pause(True, bench.now, bench.wall)
    assert 'no command has arrived' in bench.plant.step(bench.now, bench.wall)
    bench.run(3 * RESEND + 0.01)  # The node that answers may not have been running yet.
    assert bench.plant.resent == 3
    assert bench.plant.simulator.steps == 0
    assert bench.plant.command(0, [1.0], bench.now) == ''
    assert not bench.poll()
    assert bench.plant.step(bench.now, bench.wall) == ''
    assert bench.plant.stamp == 5_000_000


@pytest.mark.parametrize('lockstep', [False, True])
@pytest.mark.parametrize('moment', [0.1, 0.101, 0.105 - 1e-12])
def test_a_plant_pauses_with_the_first_state_from_a_moment_on(moment, lockstep):
    bench = Bench(lockstep=lockstep, simulated_stamps=True, pause_at=moment)

    def run():
        for _ in range(200):
            bench.now += PERIOD
            if lockstep and not bench.plant.answered:
                bench.plant.command(bench.plant.stamp, [1.0], bench.now)
            bench.poll()

    run()
    expected = PERIOD * math.ceil(moment / PERIOD - 1e-6)
    assert bench.plant.paused
    assert bench.plant.simulator.time == pytest.approx(expected, abs=1e-12)
    bench.plant.pause(False, bench.now, bench.wall)
    run()  # the moment has passed: no second pause
    assert not bench.plant.paused
    assert bench.plant.simulator.time > expected + 100 * PERIOD


def test_a_pause_at_a_past_moment_is_refused():
    bench = Bench(pause_at=0.05)
    bench.run(0.2)
    bench.plant.pause(False, bench.now, bench.wall)
    bench.run(0.2)
    before = bench.plant.pacing
    with pytest.raises(StatementError, match=r'pause_at = 0.1 s: the simulated time is already'):
        bench.plant.check_pause(replace(before, pause_at=0.1))
    bench.plant.check_pause(replace(before, speed=2.0))  # the moment is past, but not a new one
    bench.plant.adopt(replace(before, pause_at=1.0), bench.now)
    bench.run(2.0)
    assert bench.plant.simulator.time == pytest.approx(1.0)
    bench.plant.reset(bench.now, bench.wall)
    bench.plant.pause(False, bench.now, bench.wall)
    bench.run(2.0)
    assert bench.plant.simulator.time == pytest.approx(1.0)


def test_a_reset_restores_the_initial_state():
    bench = Bench(x0=(1.0, 0.0), conditions=CONDITIONS, simulated_stamps=True)
    first = bench.plant.sample
    bench.plant.command(0, [1.0], bench.now)
    bench.run(0.3)
    bench.plant.reset(bench.now, bench.wall)
    assert bench.plant.stamp == 0
    assert_array_equal(bench.plant.sample, first)
    assert 'later than' in bench.plant.command(bench.stamps[-1], [9.0], bench.now)
    bench.plant.reset(bench.now, bench.wall, [5.0, 0.0])
    assert bench.plant.simulator.x[0] == 5.0


def test_a_state_out_of_range_stops_the_plant_until_a_reset():
    bench = Bench('scalar', (1.0,), Conditions(disturbance=(1e300,), dt=1.0))
    bench.run(3000.0)
    assert 'exceeds the range of double precision' in bench.plant.fault
    assert np.isfinite(bench.plant.sample).all()
    assert not bench.poll()
    assert bench.plant.wait(bench.now) == math.inf
    bench.plant.pause(True, bench.now, bench.wall)
    assert 'range of double precision' in bench.plant.step(bench.now, bench.wall)
    bench.plant.pause(False, bench.now, bench.wall)
    bench.plant.reset(bench.now, bench.wall)
    assert bench.plant.fault == ''
    bench.run(10.0)
    assert bench.plant.simulator.time > 0


def test_a_change_of_speed_leaves_the_time_continuous():
    bench = Bench(simulated_stamps=True)
    bench.run(1.0)
    bench.plant.adopt(Pacing(5, speed=10.0, simulated_stamps=True), bench.now)
    assert bench.plant.simulator.time == pytest.approx(1.0, abs=1e-3)
    bench.run(1.0)
    assert bench.plant.simulator.time == pytest.approx(11.0, abs=0.01)
    assert_allclose(np.diff(bench.stamps), 5_000_000)


def rk4(f, t, x, h):
    """Return one step of the classical method."""
    a = f(t, x)
    b = f(t + h / 2, x + h / 2 * a)
    c = f(t + h / 2, x + h / 2 * b)
    d = f(t + h, x + h * c)
    return x + h / 6 * (a + 2 * b + 2 * c + d)


UNSTABLE = Conditions(disturbance=(0.0, 0.3), gust=Gust((0.0, 2.0), 0.0, 2.0))


def tumble(t, x, u):
    """Return dx/dt of the double integrator with the disturbances of UNSTABLE, by hand."""
    return np.array([x[1], u + 0.3 + 1 - math.cos(math.pi * t)])


@pytest.mark.parametrize('simulated', [False, True])
def test_until_its_first_command_a_plant_keeps_its_state_to_the_last_digit(simulated):
    x0 = (0.1, -0.7)
    bench = Bench(x0=x0, conditions=UNSTABLE, simulated_stamps=simulated, hold_until_command=True)
    for _ in range(400):
        bench.now += bench.plant.wait(bench.now)
        assert bench.poll()
        assert bench.plant.held
        assert_array_equal(bench.plant.sample, x0)
    assert_allclose(np.diff(bench.stamps), 5_000_000, atol=2)
    assert bench.plant.simulator.time == pytest.approx(2.0)


@pytest.mark.parametrize('delay', [0.0, 0.002])
def test_the_first_step_after_the_first_command_is_one_of_the_plant(delay):
    """By hand: steps of the classical Runge-Kutta method with the input, from x0 and t = 0.5."""
    x, u, h = np.array([0.1, -0.7]), 4.0, 1e-3
    bench = Bench(x0=x, conditions=replace(UNSTABLE, input_delay=delay), hold_until_command=True)
    bench.run(0.5 + PERIOD / 2)
    bench.now = START + 0.5   # at the time of a state
    assert bench.plant.command(bench.stamps[-1], [u], bench.now) == ''
    assert not bench.plant.held
    bench.now += PERIOD
    assert bench.poll()
    for k in range(5):
        begin = 0.5 + k * h
        acting = u if k * h >= delay - 1e-9 else 0.0
        x = rk4(lambda t, x: tumble(t, x, acting), begin, x, h)   # noqa: B023 - called at once
    assert_allclose(bench.plant.sample, x, rtol=1e-12)


@pytest.mark.parametrize('u', [[], [math.nan], [1.0, 2.0]])
def test_a_malformed_command_releases_no_plant(u):
    bench = Bench(x0=(1.0, 1.0), hold_until_command=True)
    bench.run(0.1)
    assert bench.plant.command(bench.stamps[-1], u, bench.now)
    bench.run(0.1)
    assert_array_equal(bench.plant.sample, (1.0, 1.0))
    assert bench.plant.held


def test_a_reset_holds_a_plant_until_the_next_command_for_a_later_state():
    bench = Bench(x0=(1.0, 1.0), hold_until_command=True)
    bench.run(0.1)
    assert bench.plant.command(bench.stamps[-1], [1.0], bench.now) == ''
    bench.run(0.1)
    assert bench.plant.sample[1] > 1.0
    before = bench.stamps[-1]
    bench.plant.reset(bench.now, bench.wall)
    assert bench.plant.command(before, [9.0], bench.now) == BEFORE   # it was under way
    bench.run(0.1)
    assert_array_equal(bench.plant.sample, (1.0, 1.0))
    assert bench.plant.command(bench.stamps[-1], [1.0], bench.now) == ''
    bench.run(0.1)
    assert bench.plant.sample[1] > 1.0


def test_a_change_of_the_hold_acts_from_then_on():
    bench = Bench(x0=(0.0, 1.0), hold_until_command=True)
    bench.run(1.0)
    bench.plant.adopt(replace(bench.plant.pacing, hold_until_command=False), bench.now)
    bench.run(0.5)
    assert bench.plant.sample[0] == pytest.approx(0.5, abs=2 * PERIOD)


def test_commands_count_again_after_the_clock_was_set_back():
    bench = Bench()
    bench.run(0.1)
    assert bench.plant.command(bench.stamps[-1], [1.0], bench.now) == ''
    bench.plant.poll(bench.now, bench.wall - 10**12)
    bench.now += PERIOD
    assert bench.plant.poll(bench.now, bench.wall - 10**12)
    assert bench.plant.command(bench.plant.stamp, [1.0], bench.now) == ''
    assert bench.plant.repeated == 0
