# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The parameters of lqr_node without the node: any sequence of changes, good and bad."""

from dataclasses import fields, replace
import math
from typing import Any

from hypothesis import given, settings, strategies
import numpy as np
from obc_ros.core import systems
from obc_ros.core.errors import ObcError
from obc_ros.core.loop import Loop
from obc_ros.msg import Trajectory
from obc_ros.nodes.lqr_settings import judge, Settings
from obc_ros.nodes.lqr_topics import courses
import pytest
from scipy.linalg import solve_continuous_lyapunov

X = [0.3, -0.2, 0.1, 0.05, -0.04, 0.02]

weights = strategies.floats(-3.0, 3.0).map(lambda decades: 10.0**decades)
wild = strategies.one_of(weights, strategies.floats(), strategies.floats(1e-12, 1e12))


def lists(*sizes: int, of: Any = weights) -> Any:
    """Return lists of one of some sizes, as tuples."""
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
    strategies.fixed_dictionaries({'u_max': lists(2, 3, of=wild)}),
    strategies.fixed_dictionaries({'stability': wild}),
    strategies.fixed_dictionaries({'horizon': weights, 'P1': lists(6, 2, of=wild)}),
    strategies.fixed_dictionaries({'integral': strategies.sampled_from(
        [('px', 'py'), ('px', 'pz')]), 'Qi': lists(2)}),
    strategies.fixed_dictionaries({'design': strategies.just('sampled'), 'rate': weights}),
    strategies.fixed_dictionaries({'weights': strategies.sampled_from(
        ['bryson', 'output', 'best'])}))


@settings(max_examples=60, deadline=None)
@given(strategies.lists(strategies.one_of(GOOD, ANY), min_size=1, max_size=8))
def test_commands_are_those_of_the_last_accepted_design(changes: list[dict[str, Any]]) -> None:
    """What is accepted is proved and used at once; what is refused leaves no trace."""
    now = Settings(transition_time=0.0)
    accepted = judge(now)
    loop = Loop(accepted.control)
    for k, change in enumerate(changes):
        before = loop.preview(accepted.control)
        try:
            candidate = judge(replace(now, **change))
        except ObcError as error:
            assert str(error) and loop.preview(accepted.control) == before
        else:
            now, accepted = replace(now, **change), candidate
            loop.adopt(candidate.control)
            _check_proof(candidate)
        u = loop.answer((k + 1) * 10**14, X, float(k))  # later than any horizon or period
        assert u is not None
        assert any(np.allclose(u, wanted, rtol=1e-9, atol=1e-9) for wanted in _expected(accepted))


def _check_proof(candidate: Any) -> None:
    """Judge the gain by other means: a Lyapunov equation for its closed loop."""
    found = candidate.design.lqr
    M = found.A - found.B @ found.K
    if found.period:
        assert np.abs(np.linalg.eigvals(M)).max() < 1.0
        return
    d = np.sqrt(np.diag(found.P))  # in units in which the cost of each state is 1
    M = M * d[:, None] / d
    W = solve_continuous_lyapunov(M.T, -np.eye(len(M)))
    assert np.linalg.eigvalsh(0.5 * (W + W.T)).min() > 0.0
    assert found.residual < 1e-8


def _expected(accepted: Any) -> list[Any]:
    """Return what the design commands for the state X; over a horizon, at its ends."""
    at, limits, horizon = (accepted.design.plant.equilibrium, accepted.control.limits,
                           accepted.control.horizon)
    gains = [accepted.design.K, *([np.array(horizon.gains.K[0])] if horizon is not None else [])]
    e = X - at.x
    e[2] = math.remainder(e[2], math.tau)
    return [np.clip(at.u - K @ e, limits.lower, limits.upper) for K in gains]


@settings(max_examples=60, deadline=None)
@given(GOOD)
def test_what_is_right_is_accepted(change: dict[str, Any]) -> None:
    """Positive weights, levels to hover at, limits around hovering: no refusal is a whim."""
    assert judge(replace(Settings(), **change)).design.lqr.residual < 1e-8


def test_every_parameter_is_described() -> None:
    """A sentence and, where there is one, a unit for each."""
    for each in fields(Settings):
        if 'entry' in each.metadata:
            assert len(each.metadata['entry'].description) > 15, each.name


@pytest.mark.parametrize(('change', 'sentence'), [
    ({'horizon': 1.0, 'schedule': 'f1', 'schedule_range': (0.0, 1.0)}, 'one or the other'),
    ({'P1': (1.0,)}, 'P1 has 1 number; wanted 6'),
    ({'schedule': 'f2', 'schedule_range': (30.0, 50.0)}, 'f2'),
    ({'schedule': 'm', 'schedule_range': (3.0, 5.0)}, 'a State does not tell it'),
    ({'sample_time': 0.01, 'rate': 20.0}, 'with rate = 20 commands are 0.05 s apart or more'),
])
def test_what_does_not_go_together(change: dict[str, Any], sentence: str) -> None:
    """Each has its sentence."""
    with pytest.raises(ObcError) as error:
        judge(replace(Settings(), **change))
    assert sentence in str(error.value)


@pytest.mark.parametrize(('frame', 'states', 'sentence'), [
    ('map', 'odom', "it is in the frame 'map', the states are in 'odom'"),
    ('odom', 'odom', ''), ('', 'odom', ''), ('map', '', '')])
def test_the_frame_of_a_reference(frame: str, states: str, sentence: str) -> None:
    """It is that of the states, as far as both are known."""
    message = Trajectory(t=[0.0, 1.0], x=[0.0] * 4, u=[0.0] * 2)
    message.header.frame_id = frame
    system = systems.get('double_integrator')
    if not sentence:
        assert len(courses(message, system, states, (), None)) == 1
        return
    with pytest.raises(ObcError, match=sentence):
        courses(message, system, states, (), None)
