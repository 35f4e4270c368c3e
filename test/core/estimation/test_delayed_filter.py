# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Measurements that are late, out of order, missing, repeated, malformed or wrong."""

import contextlib
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.estimation.delayed_filter import DelayedFilter, ENOUGH, spread_deviations
from obc_ros.core.estimation.filter import Belief, KalmanFilter
from obc_ros.core.systems.registry import get_system
from obc_ros.core.text.errors import StatementError
import pytest

MS = 1_000_000
NAMES = get_system('double_integrator').output_names


def make(gate=1.0, **options):
    kalman = KalmanFilter(get_system('double_integrator'), np.diag([0.0, 1.0]),
                          0.01 * np.eye(2), gate)
    return DelayedFilter(kalman, np.zeros(2), np.eye(2), np.zeros(1), **options)


def events():
    rng = np.random.default_rng(4)
    for k in range(60):
        yield 'y', (10 * k + 1) * MS, [NAMES[k % 2]], rng.standard_normal(1) * 0.1
        if k % 5 == 0:
            yield 'u', (10 * k + 4) * MS, None, rng.standard_normal(1)


def feed(delayed, given):
    for kind, stamp, names, values in given:
        if kind == 'u':
            delayed.command(stamp, values)
        else:
            delayed.measure(stamp, names, values)
    return delayed.estimate(700 * MS)


@pytest.mark.parametrize('seed', range(5))
def test_order_of_arrival_does_not_matter(seed):
    given, rng = list(events()), np.random.default_rng(seed)
    arrival = np.argsort(np.arange(len(given)) + rng.uniform(0, 8, len(given)))
    arrival = [0, *(k for k in arrival if k != 0)]
    late = make()
    found, wanted = feed(late, [given[k] for k in arrival]), feed(make(), given)
    assert found.x == pytest.approx(wanted.x, rel=1e-11)
    assert pytest.approx(wanted.P, rel=1e-11) == found.P
    assert late.counts['late'] > 0 and late.counts['too late'] == 0
    assert late.counts['used'] == 60


def test_results_in_between_do_not_matter():
    given = list(events())
    often = make()
    for kind, stamp, names, values in [given[0], *given[2:5], given[1], *given[5:]]:
        if kind == 'u':
            often.command(stamp, values)
        else:
            often.measure(stamp, names, values)
        often.estimate(stamp)
    found, wanted = often.estimate(700 * MS), feed(make(), given)
    assert found.x == pytest.approx(wanted.x, rel=1e-11)
    assert pytest.approx(wanted.P, rel=1e-11) == found.P
    assert often.counts['used'] == 60


def test_late_measurements_are_filtered_once(monkeypatch):
    """An estimator that has fallen behind must not have more to do for each measurement."""
    calls, predict = [], KalmanFilter.predict
    monkeypatch.setattr(KalmanFilter, 'predict',
                        lambda *given: calls.append(None) or predict(*given))
    delayed = make()
    delayed.measure(0, NAMES, [0.0, 0.0])
    for k in range(1, 41):
        delayed.command(10 * k * MS, [0.0])
    for k in range(1, 41):
        delayed.measure(10 * k * MS - MS, NAMES, [0.0, 0.0])
    delayed.estimate(400 * MS)
    assert len(calls) == 82   # 41 measurements, 40 inputs, and the prediction to the instant
    assert delayed.counts['used'] == 41


def test_a_measurement_that_nobody_reads_is_filtered_before_it_is_forgotten():
    delayed, other = make(longest_lag=0.05), make(longest_lag=0.05)
    for k in range(100):
        for each in (delayed, other):
            each.measure(k * 10 * MS, NAMES, [0.01 * k, 1.0])
        other.estimate(k * 10 * MS)
    assert (delayed.estimate(990 * MS).x == other.estimate(990 * MS).x).all()
    assert delayed.counts['used'] == 100


def test_the_filter_is_that_of_predictions_and_updates():
    found = feed(make(), events())
    kalman = make()._kalman
    belief, u, now = Belief(np.zeros(2), np.eye(2)), np.zeros(1), MS
    for kind, stamp, names, values in events():
        belief, now = kalman.predict(belief, u, (stamp - now) * 1e-9), stamp
        if kind == 'u':
            u = values
        else:
            belief = kalman.update(belief, u, [NAMES.index(names[0])], values).belief
    belief = kalman.predict(belief, u, (700 * MS - now) * 1e-9)
    assert found.x == pytest.approx(belief.x, rel=1e-9)
    assert pytest.approx(belief.P, rel=1e-9) == found.P


def test_what_cannot_be_used_is_counted_and_changes_nothing():
    delayed = make(longest_lag=0.1)
    for k in range(50):
        delayed.measure(k * 10 * MS, NAMES, [0.0, 0.0])
    before = delayed.estimate(500 * MS)
    assert not delayed.measure(100 * MS, NAMES, [9.0, 9.0])
    assert not delayed.measure(480 * MS, NAMES, [9.0, 9.0])
    assert not delayed.measure(495 * MS, NAMES, [math.nan, math.inf])
    for names, values in ((['px'], [1.0]), (NAMES, [1.0]), ([], []), ([NAMES[0]] * 2, [1, 1])):
        with pytest.raises(StatementError, match='a measurement was dropped'):
            delayed.measure(495 * MS, names, values)
    for u in ([1.0, 2.0], [math.nan], []):
        with pytest.raises(StatementError, match='a command of'):
            delayed.command(495 * MS, u)
    assert delayed.counts['too late'] == delayed.counts['repeated'] == 1
    assert delayed.counts['not finite'] == 2
    assert delayed.counts['malformed'] == 7
    after = delayed.estimate(500 * MS)
    assert (after.x == before.x).all() and (after.P == before.P).all()


def test_finite_entries_of_a_measurement_are_used():
    delayed, other = make(), make()
    delayed.measure(0, NAMES, [0.7, math.nan])
    other.measure(0, NAMES[:1], [0.7])
    assert (delayed.estimate(0).x == other.estimate(0).x).all()


def test_missing_measurements_are_counted():
    delayed = make()
    for k in range(40):
        if k not in (20, 21, 30):
            delayed.measure(k * 10 * MS, NAMES, [0.0, 0.0])
    assert delayed.counts['missing'] == 3
    delayed.measure(300 * MS, NAMES, [0.0, 0.0])   # only late
    assert delayed.counts['missing'] == 2 and delayed.counts['out of order'] == 1


def filtered(count=100, **options):
    """Return a filter that has measured the plant at rest every 10 ms, up to `count` - 1."""
    delayed = make(gate=0.999, **options)
    for k in range(count):
        delayed.measure(k * 10 * MS, NAMES, [0.0, 0.0])
    return delayed


def test_a_burst_of_outliers_does_not_move_the_filter():
    """20 in a row that agree: a receiver that is 1 km off for 0.2 s."""
    delayed = filtered()
    for k in range(100, 100 + ENOUGH):
        delayed.measure(k * 10 * MS, NAMES, [1000.0, 0.0])
    assert delayed.counts['outliers'] == ENOUGH
    assert abs(delayed.estimate(delayed.newest).x[0]) < 0.1
    delayed.measure(delayed.newest + 10 * MS, NAMES, [0.0, 0.0])
    assert delayed.counts['used'] == 101 and delayed.counts['restarts'] == 0


def test_outliers_that_agree_for_the_longest_gap_restart_the_filter():
    delayed, first = filtered(), 100
    for k in range(first, first + 250):
        delayed.measure(k * 10 * MS, NAMES, [1000.0, 0.0])
        delayed.estimate(delayed.newest)
        assert delayed.counts['restarts'] == (k - first >= 200)
    assert 'have agreed with each other for 2 s' in delayed.reason
    assert delayed.estimate(delayed.newest).x == pytest.approx([1000.0, 0.0], abs=0.1)


def test_outliers_that_do_not_agree_never_restart_the_filter():
    delayed, rng = filtered(), np.random.default_rng(2)
    for k in range(100, 500):
        delayed.measure(k * 10 * MS, NAMES[:1], rng.normal(0.0, 1000.0, 1))
    assert delayed.counts['restarts'] == 0


def test_another_sensor_that_agrees_with_the_filter_keeps_it():
    delayed = filtered()
    for k in range(100, 400):
        delayed.measure(k * 10 * MS, NAMES[:1], [1000.0])
        delayed.measure((k * 10 + 5) * MS, NAMES, [0.0, 0.0])
    assert delayed.counts['restarts'] == 0 and delayed.counts['outliers'] == 300
    assert abs(delayed.estimate(delayed.newest).x[0]) < 0.1


def test_a_lost_filter_finds_the_plant_among_outliers_and_late_measurements():
    """The plant was moved to 50; every tenth measurement is an outlier, others are 50 ms late."""
    delayed, rng = filtered(), np.random.default_rng(3)
    for k in range(100, 500):
        if k >= 105:
            delayed.measure((k * 10 - 49) * MS, NAMES[1:], [0.0])
        delayed.measure(k * 10 * MS, NAMES[:1], [50.0 if k % 10 else 1e3 * rng.normal()])
        delayed.command(k * 10 * MS, [0.0])
        delayed.estimate(delayed.newest)
    assert delayed.counts['restarts'] == 1
    assert delayed.estimate(delayed.newest).x == pytest.approx([50.0, 0.0], abs=0.1)


@pytest.mark.parametrize('far', [30.0, 1e4, 1e8])
def test_a_filter_far_from_the_plant_finds_it(far):
    """P0 expects the plant within a metre."""
    delayed = make(gate=0.9999)
    for k in range(3 * ENOUGH):
        delayed.measure(k * 10 * MS, NAMES[:1], [far])
    assert delayed.estimate(delayed.newest).x[0] == pytest.approx(far, abs=0.1, rel=1e-9)
    assert delayed.counts['restarts'] == 1


def test_outputs_that_are_not_used_are_dropped():
    delayed, other = make(outputs=NAMES[1:]), make()
    for k in range(20):
        delayed.measure(k * 10 * MS, NAMES, [5.0, 0.3])
        delayed.measure(k * 10 * MS, NAMES[:1], [5.0])
        other.measure(k * 10 * MS, NAMES[1:], [0.3])
    found, wanted = (each.estimate(200 * MS) for each in (delayed, other))
    assert (found.x == wanted.x).all() and (wanted.P == found.P).all()
    assert delayed.counts['not used'] == 40
    delayed.adopt(delayed._kalman, np.zeros(2), np.eye(2))
    delayed.measure(201 * MS, NAMES[:1], [5.0])
    assert delayed.estimate(201 * MS).x[0] > 1.0


def test_a_gap_restarts_the_filter():
    delayed = make(longest_gap=1.0)
    delayed.measure(0, NAMES, [0.0, 0.0])
    delayed.measure(5000 * MS, NAMES, [3.0, 0.0])
    assert delayed.counts['restarts'] == 1
    assert delayed.estimate(5000 * MS).x[0] == pytest.approx(3.0 * 1 / 1.01)


def test_a_restart_uses_the_input_of_the_gap():
    delayed = make(longest_gap=1.0)
    delayed.measure(0, NAMES, [0.0, 0.0])
    delayed.command(4000 * MS, [2.0])
    delayed.measure(5000 * MS, NAMES, [0.0, 0.0])
    before, after = (delayed.estimate(stamp * MS).x[1] for stamp in (5000, 6000))
    assert after - before == pytest.approx(2.0)


def test_another_filter_begins_with_the_estimate():
    delayed = filtered()
    system = get_system('double_integrator')
    delayed.adopt(KalmanFilter(system, np.zeros((2, 2)), 1e6 * np.eye(2)), np.zeros(2), np.eye(2))
    before = delayed.estimate(delayed.newest).x
    delayed.measure(delayed.newest + MS, NAMES, [9.0, 9.0])
    assert delayed.estimate(delayed.newest).x == pytest.approx(before, abs=1e-2)
    assert delayed.counts['restarts'] == 0


def test_time_that_goes_back_begins_the_filter_anew_at_once():
    delayed = filtered()
    for stamp in (990 * MS - 2001 * MS, 990 * MS - 2001 * MS + 10 * MS):
        assert delayed.measure(stamp, NAMES, [3.0, 0.0])
        assert delayed.newest == stamp
    assert delayed.counts['restarts'] == 1 and 'time went back by 2 s' in delayed.reason
    # As the first measurement of a plant that P0 expects within a metre of 0.
    assert delayed.estimate(delayed.newest).x[0] == pytest.approx(3.0, abs=0.2)


@pytest.mark.parametrize('stamp', [0, -10**12, 990 * MS - 2500 * MS])
def test_a_sensor_of_another_clock_does_not_stop_the_others(stamp):
    """A driver without stamps beside one with stamps."""
    delayed = filtered()
    for k in range(100, 200):
        assert delayed.measure(k * 10 * MS, NAMES[:1], [0.0])
        assert not delayed.measure(stamp, NAMES[1:], [0.0])
    assert delayed.counts['restarts'] == 0 and delayed.counts['too late'] == 100


def test_one_stamp_far_ahead_does_not_stop_the_filter():
    delayed = filtered()
    delayed.measure(10**18, NAMES[:1], [0.0])
    for k in range(100, 100 + ENOUGH):
        delayed.measure(k * 10 * MS, NAMES[1:], [0.0])
    for k in range(200, 210):
        assert delayed.measure(k * 10 * MS, NAMES, [0.0, 0.0])
    assert delayed.newest == 2090 * MS


FAR = 0.1 / np.finfo(float).eps   # where the rounding of a number is its deviation


@pytest.mark.parametrize('gate', [0.999, 1.0])
@pytest.mark.parametrize('y', [1e155, -1e155, 1.8e308, 2 * FAR, math.inf, -math.inf, math.nan])
def test_a_value_beyond_the_range_of_the_sensor_is_dropped(y, gate):
    delayed = make(gate=gate)
    for k in range(50):   # for 2.5 s
        assert not delayed.measure(k * 50 * MS, NAMES[:1], [y])
        assert delayed.measure(k * 50 * MS, NAMES, [y, 0.0])
    kind = 'out of range' if math.isfinite(y) else 'not finite'
    assert delayed.counts[kind] == 100
    delayed.measure(2500 * MS, NAMES, [0.5, 0.0])
    assert delayed.counts['outliers'] == delayed.counts['faults'] == 0
    assert delayed.estimate(2500 * MS).x[0] == pytest.approx(0.5, abs=0.1)


VALUES = st.floats() | st.floats(-1e3, 1e3)
STAMPS = st.integers(-2**63, 2**63 - 1) | st.integers(0, 3000).map(lambda k: k * MS)
CALLS = st.lists(
    st.tuples(st.just('y'), STAMPS, st.sampled_from(((0,), (1,), (0, 1))), VALUES, VALUES)
    | st.tuples(st.just('u'), STAMPS, VALUES)
    | st.tuples(st.just('row'), STAMPS, VALUES), max_size=10)


def send(delayed, kind, stamp, *given):
    """Send a command, a measurement, or equal measurements for 3 s."""
    if kind == 'u':
        with contextlib.suppress(StatementError):
            delayed.command(stamp, given)
    elif kind == 'y':
        at, *y = given
        delayed.measure(stamp, [NAMES[i] for i in at], [y[i] for i in at])
    else:
        for k in range(60):
            delayed.measure(stamp + 50 * k * MS, NAMES, [given[0], 0.0])


@pytest.mark.slow
@settings(max_examples=30)
@given(CALLS)
def test_any_numbers_leave_a_filter_that_finds_the_plant(calls):
    """Measurements of a plant at rest at 0.3, for 6 s after anything."""
    delayed = make(gate=0.999)
    for each in calls:
        send(delayed, *each)
        if delayed.newest is not None:
            found = delayed.estimate(delayed.newest)
            assert np.isfinite(found.x).all() and np.isfinite(found.P).all()
            lowest, highest = np.linalg.eigvalsh(found.P)[[0, -1]]
            assert (found.P == found.P.T).all() and lowest >= -1e-12 * highest
    for k in range(120):
        delayed.measure((5000 + 50 * k) * MS, NAMES, [0.3, 0.0])
        delayed.command((5000 + 50 * k) * MS, [0.0])
    assert delayed.newest == 10950 * MS
    assert delayed.estimate(delayed.newest).x == pytest.approx([0.3, 0.0], abs=0.1)


def test_no_estimate_without_a_measurement():
    with pytest.raises(StatementError, match='no measurement'):
        make().estimate(0)


def test_deviations_are_checked():
    assert spread_deviations('s', [2.0], ('a', 'b')).tolist() == [[4, 0], [0, 4]]
    for values in ([], [1, 2, 3], [0.0], [math.inf], [-1.0, 1.0]):
        with pytest.raises(StatementError):
            spread_deviations('s', values, ('a', 'b'))
