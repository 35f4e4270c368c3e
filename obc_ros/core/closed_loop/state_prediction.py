# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The state of a plant at a later time, from the model in closed loop.

dx/dt = f(x, u) is integrated from the last state. The command u is sampled: the control law
computes it from the predicted state once in a period, and it acts after the delay, until the next
one acts.
"""

from collections import deque
from collections.abc import Callable, Sequence
import math
from typing import NamedTuple

from obc_ros.core.closed_loop.clock import NS
from obc_ros.core.simulation.flow import Conditions, PlantFlow
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import DynamicsError, StatementError

MOST_COMMANDS = 100_000   # of one prediction: a second or two of computation

CommandLaw = Callable[[int, Sequence[float]], Sequence[float]]
SentCommand = tuple[int, Sequence[float]]


class PredictedState(NamedTuple):
    """A state x (n,), and the command u (m,) that acts then."""

    x: list[float]
    u: list[float]


def make_model(system: System) -> PlantFlow:
    """Return the model of a plant for `predict_state`; one prediction at a time may use it."""
    return PlantFlow(system, Conditions(integrator='adaptive').fitted(system))


def predict_state(model: PlantFlow, x: Sequence[float], sent: Sequence[SentCommand], stamp: int,
                  law: CommandLaw, period: int, delay: int = 0) -> PredictedState:
    """
    Return the state at a stamp.

    :param model: of `make_model`.
    :param x: the last state (n,).
    :param sent: stamps [ns] of states and the commands (m,) for them, oldest first; the last one
        is that of the last state. The first one acts until the next one does.
    :param stamp: [ns], not before the last state.
    :param law: law(stamp, x) returns the command (m,) for a predicted state, within the limits. It
        is called once for each period after the last state, in order.
    :param period: time between two states [ns], above 0.
    :param delay: time from the stamp of a state to the effect of its command [ns].
    :raises StatementError: if the time contains more than `MOST_COMMANDS` periods.
    :raises DynamicsError: if the model diverges or cannot be integrated.
    """
    now = sent[-1][0]
    if stamp - now > MOST_COMMANDS * period:
        raise StatementError(
            f'the stamp is {(stamp - now) * NS:.6g} s after the last state; with a period of '
            f'{period * NS:g} s wanted at most {MOST_COMMANDS * period * NS:g} s')
    model.restart(x)
    waiting, acting = deque((at + delay, u) for at, u in sent), list(sent[0][1])
    begun, unit, due = now, Conditions().dt / NS, now + period
    while True:
        while waiting and waiting[0][0] <= now:
            acting = list(waiting.popleft()[1])
        if now >= stamp:
            return PredictedState(list(model.x), acting)
        until = min(stamp, due, *(at for at, _ in waiting))
        model.drive((now - begun) / unit, acting)
        model.run((now - begun) / unit, (until - begun) / unit)
        now = until
        if not all(map(math.isfinite, model.x)):
            raise DynamicsError(f'the model diverges within {(now - begun) * NS:.3g} s')
        if now == due:
            waiting.append((now + delay, law(now, list(model.x))))
            due += period
