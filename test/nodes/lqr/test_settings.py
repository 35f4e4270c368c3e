# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The parameters of lqr_node without the node: sequences of valid and invalid changes."""

from dataclasses import fields, replace
from fractions import Fraction
import math
from typing import Any

from hypothesis import given, settings, strategies
import numpy as np
from obc_ros.core.closed_loop.loop import ControlLoop
from obc_ros.core.systems import registry
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import Trajectory
from obc_ros.nodes.lqr.settings import judge_lqr_settings, Settings
from obc_ros.nodes.lqr_node import read_courses
import pytest

X = [0.3, -0.2, 0.1, 0.05, -0.04, 0.02]

weights = strategies.floats(-3.0, 3.0).map(lambda decades: 10.0**decades)
wild = strategies.one_of(weights, strategies.floats(), strategies.floats(1e-12, 1e12))


def lists(*sizes: int, of: Any = weights) -> Any:
    """Return a strategy of tuples with one of the sizes."""
    return strategies.one_of([strategies.lists(of, min_size=size, max_size=size).map(tuple)
                              for size in sizes])


GOOD = strategies.one_of(
    strategies.fixed_dictionaries({'Qx': lists(6)}),
    strategies.fixed_dictionaries({'Qu': lists(2)}),
    strategies.fixed_dictionaries({'Qx': lists(6), 'Qu': lists(2), 'weights': strategies.just(
        'matrices')}),
    strategies.fixed_dictionaries({'weights': strategies.just('bryson'), 'x_max': lists(6),
                                   'u_max': lists(2)}),
    strategies.fixed_dictionaries({'setpoint': strategies.tuples(
        strategies.floats(-9, 9), strategies.floats(-9, 9), *[strategies.just(0.0)] * 4)}),
    strategies.fixed_dictionaries({'u_limits': strategies.just((-9.0, 9.0, 0.0, 60.0))}),
    strategies.fixed_dictionaries({'transition_time': strategies.just(0.0)}))
ANY = strategies.one_of(
    strategies.fixed_dictionaries({'Qx': lists(0, 5, 6, 36, of=wild)}),
    strategies.fixed_dictionaries({'Qu': lists(1, 2, 4, of=wild)}),
    strategies.fixed_dictionaries({'cross': lists(12, 11, of=wild)}),
    strategies.fixed_dictionaries({'Qx': lists(6, of=wild), 'Qu': lists(2, of=wild)}),
    strategies.fixed_dictionaries({'setpoint': lists(6, 5, of=wild)}),
    strategies.fixed_dictionaries({'u_limits': lists(2, 3, 4, of=wild)}),
    strategies.fixed_dictionaries({'stability': wild}),
    strategies.fixed_dictionaries({'horizon': weights, 'P1': lists(6, 2, of=wild)}),
    strategies.fixed_dictionaries({'integral': strategies.sampled_from(
        [('px', 'py'), ('px', 'pz')]), 'Qi': lists(2)}),
    strategies.fixed_dictionaries({'design': strategies.just('sampled'), 'rate': weights}),
    strategies.fixed_dictionaries({'weights': strategies.sampled_from(
        ['bryson', 'output', 'best'])}))


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(strategies.lists(strategies.one_of(GOOD, ANY), min_size=1, max_size=8))
def test_commands_are_those_of_the_last_accepted_design(changes: list[dict[str, Any]]) -> None:
    """An accepted gain stabilises and is used at once; a refused change has no effect."""
    now = Settings(transition_time=0.0)
    accepted = judge_lqr_settings(now)
    loop = ControlLoop(replace(accepted.control, longest_period=math.inf))
    for k, change in enumerate(changes):
        before = loop.preview(accepted.control)
        try:
            candidate = judge_lqr_settings(replace(now, **change))
        except ObcError as error:
            assert str(error)
            assert loop.preview(accepted.control) == before
        else:
            now, accepted = replace(now, **change), candidate
            loop.adopt(replace(candidate.control, longest_period=math.inf))
            _check_stability(candidate)
        # After any horizon or period; that states are too far apart is not the question here.
        u = loop.answer((k + 1) * 10**14, X, float(k))
        assert u is not None
        assert any(np.allclose(u, wanted, rtol=1e-9, atol=1e-9) for wanted in _expected(accepted))


def _check_stability(candidate: Any) -> None:
    """Check the closed loop with Routh's criterion in exact arithmetic."""
    found = candidate.design.lqr
    A, B, K = (np.vectorize(Fraction, otypes=[object])(each) for each in (
        found.A, found.B, found.K))
    M = A - B @ K
    unit = max(each.denominator for each in M.flat)   # a power of two, as for floats
    polynomial = _characteristic(np.vectorize(int, otypes=[object])(M * unit))
    assert _is_hurwitz(_map_disk_to_half_plane(polynomial, unit) if found.period else polynomial)
    assert found.period or found.residual < 1e-8


def _characteristic(M: Any) -> list[int]:
    """Return the characteristic polynomial of a matrix of integers (Faddeev, Le Verrier)."""
    one = np.diag([1] * len(M)).astype(object)
    found, N = [1], one
    for k in range(1, len(M) + 1):
        found.append(-np.trace(M @ N) // k)   # exact division
        N = M @ N + found[-1] * one
    return found


def _map_disk_to_half_plane(polynomial: list[int], radius: int) -> Any:
    """Return the polynomial in w, z = radius (1 + w)/(1 - w): |z| < radius iff Re w < 0."""
    n, found = len(polynomial) - 1, np.zeros(len(polynomial), dtype=object)
    for k, each in enumerate(polynomial):
        term = np.array([each], dtype=object)
        for factor in [[radius, radius]] * (n - k) + [[-1, 1]] * k:
            term = np.convolve(term, np.array(factor, dtype=object))
        found = found + term
    return found


def _is_hurwitz(polynomial: Any) -> bool:
    """Return whether all roots have negative real parts (Routh)."""
    sign = 1 if polynomial[0] > 0 else -1
    if any(sign * each <= 0 for each in polynomial):
        return False
    above, row = ([sign * each for each in polynomial[k::2]] for k in (0, 1))
    while row and row[0] > 0:
        padded = row + [0] * (len(above) - len(row))
        above, row = row, [padded[0] * high - above[0] * low
                           for high, low in zip(above[1:], padded[1:], strict=True)]
    return not row


def test_the_exact_routh_test_agrees_with_known_roots() -> None:
    for roots in ([-1, -2, -3], [-1, -1, 2], [0, -1], [1, -2, -5, -7], [-2] * 5):
        polynomial = _characteristic(np.diag(roots).astype(object))
        assert polynomial == np.poly(roots).tolist()
        assert _is_hurwitz(polynomial) == all(root < 0 for root in roots)
        for radius in (2, 3, 8):
            assert _is_hurwitz(_map_disk_to_half_plane(polynomial, radius)) == all(
                abs(root) < radius for root in roots)


def _expected(accepted: Any) -> list[Any]:
    """Return the commands of the design at the state X; with a horizon, at both of its ends."""
    at, limits, horizon = (accepted.design.plant.equilibrium, accepted.control.limits,
                           accepted.control.horizon)
    gains = [accepted.design.K, *([np.array(horizon.gains.K[0])] if horizon is not None else [])]
    e = X - at.x
    e[2] = math.remainder(e[2], math.tau)
    return [np.clip(at.u - K @ e, limits.lower, limits.upper) for K in gains]


@settings(max_examples=60, deadline=None)
@given(GOOD)
def test_valid_changes_are_accepted(change: dict[str, Any]) -> None:
    """Positive weights, hover set points and limits around hover are never refused."""
    assert judge_lqr_settings(replace(Settings(), **change)).design.lqr.residual < 1e-8


def test_every_parameter_is_described() -> None:
    """The description of each parameter is a sentence."""
    for each in fields(Settings):
        if 'entry' in each.metadata:
            assert len(each.metadata['entry'].description) > 15, each.name


@pytest.mark.parametrize(('change', 'sentence'), [
    ({'horizon': 1.0, 'schedule': 'f1', 'schedule_range': (0.0, 1.0)}, 'one or the other'),
    ({'P1': (1.0,)}, 'P1 has 1 number; wanted 6'),
    ({'schedule': 'f2', 'schedule_range': (30.0, 50.0)}, 'f2'),
    ({'schedule': 'm', 'schedule_range': (3.0, 5.0)}, 'a State does not contain this'),
    ({'schedule': 'f3'}, "no input or parameter 'f3'"),
    ({'schedule': 'f1', 'schedule_range': (1.0,)}, 'schedule_range has 1 number; wanted'),
    ({'state_timeout': 1e-6}, 'state_timeout = 1e-06: wanted 0 (never) or at least 0.001 s'),
    ({'state_timeout': 9.9e-4}, 'wanted 0 (never) or at least 0.001 s'),
    ({'sample_time': 0.01, 'rate': 20.0}, 'with rate = 20 commands are 0.05 s apart or more'),
])
def test_contradictory_settings_are_refused(change: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ObcError) as error:
        judge_lqr_settings(replace(Settings(), **change))
    assert sentence in str(error.value)


@pytest.mark.parametrize(('frame', 'states', 'sentence'), [
    ('map', 'odom', "frame_id = 'map': wanted the frame of the states, 'odom'"),
    ('odom', 'odom', ''), ('', 'odom', ''), ('map', '', '')])
def test_a_reference_needs_the_frame_of_the_states(frame: str, states: str, sentence: str) -> None:
    """The frames must agree if both are known."""
    message = Trajectory(t=[0.0, 1.0], x=[0.0] * 4, u=[0.0] * 2)
    message.header.frame_id = frame
    system = registry.get_system('double_integrator')
    if not sentence:
        assert len(read_courses(message, system, states, ())) == 1
        return
    with pytest.raises(ObcError, match=sentence):
        read_courses(message, system, states, ())


def test_weights_of_outputs_are_set_one_by_one() -> None:
    """Row 26: `weights: output` alone weights all states, z = x; then H and rho."""
    alone = judge_lqr_settings(Settings(weights='output'))
    identity = judge_lqr_settings(Settings())
    np.testing.assert_array_equal(alone.design.lqr.K, identity.design.lqr.K)
    rows = (3.0, *6 * [0.0], 1.0, *4 * [0.0])   # z = (3 px, py)
    outputs = judge_lqr_settings(Settings(weights='output', H=rows))
    np.testing.assert_array_equal(outputs.design.weights.Qx, np.diag([9.0, 1.0, *4 * [0.0]]))


def test_a_schedule_is_set_one_by_one() -> None:
    """Row 26: the gain is constant until there is a range; the sentence says so."""
    vehicle = Settings(system='vehicle', setpoint_input=(2.0, 0.0),
                       system_parameters={'l': 2.0})
    variable = replace(vehicle, schedule='v')
    alone, whole = (judge_lqr_settings(each) for each in (
        variable, replace(variable, schedule_range=(1.0, 4.0))))
    assert alone.control.schedule is None
    assert alone.control.regulator.K == judge_lqr_settings(vehicle).control.regulator.K
    assert 'the gain does not follow v without schedule_range' in alone.note
    assert whole.control.schedule is not None
    assert 'the gain follows v from 1 to 4: ' in whole.note
