# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Where the plant of lqr_node will be, along what the node follows."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from obc_ros.core.closed_loop.clock import NS
from obc_ros.core.closed_loop.loop import ControlLoop
from obc_ros.core.closed_loop.modes import FOLLOWING, Mode
from obc_ros.core.closed_loop.references import explain_distance, is_within
from obc_ros.core.closed_loop.state_prediction import make_model, predict_state
from obc_ros.core.lqr.design.reference_checks import compute_allowed_distance
from obc_ros.core.text.errors import StatementError
from obc_ros.nodes.lqr.settings import LqrCandidate


@dataclass(frozen=True)
class Foresight:
    """
    A predicted state.

    :ivar stamp: [ns].
    :ivar x, u: the state (n,), and the command (m,) that acts then.
    :ivar sentence: what is followed then.
    """

    stamp: int
    x: list[float]
    u: list[float]
    at_rest: bool
    sentence: str


_find_model = lru_cache(maxsize=1)(make_model)


def foresee(loop: ControlLoop, candidate: LqrCandidate, stamp: int) -> Foresight:
    """
    Return the state at a stamp, by the loop and the model; one thread at a time may ask.

    :param loop: it is not changed.
    :param stamp: [ns]; not after the last state: that one.
    :raises ObcError: if there is no recent state, or the model diverges.
    """
    if reason := explain_absence(loop):
        raise StatementError(reason)
    twin, system = loop.fork(), candidate.design.plant.system
    last, x, interval = twin.stamp, twin.x, twin.interval
    if last is None or x is None or interval is None:
        raise StatementError('fewer than four states have arrived')
    stamp, prediction = max(stamp, last), candidate.control.prediction
    command = twin.command or list(candidate.control.rest)
    sent = [*twin.list_earlier(), (last, command)]

    def answer(at: int, x: Sequence[float]) -> list[float]:
        nonlocal command
        command = twin.imagine(at, x) or command   # without an answer the last one acts on
        return command

    found = predict_state(_find_model(system), x, sent, stamp, answer, round(interval / NS),
                          0 if prediction is None else prediction.delay)
    return Foresight(stamp, *found, _rests(twin, candidate, found.x, found.u, stamp - last),
                     _describe(twin))


def explain_miss(loop: ControlLoop, candidate: LqrCandidate) -> str:
    """Return why the last reference of a new control begins too far from the plant, or ''."""
    leg, last = candidate.control.legs[-1], loop.stamp
    begin = leg.reference.begin
    if begin is None or last is None or begin <= last:
        return ''   # the loop judges it at the present state
    x = foresee(loop, candidate, begin).x
    return explain_distance(candidate.control, leg, 0.0, x, leg.along.at(0.0).x)


def explain_absence(loop: ControlLoop) -> str:
    """Return why a loop has no state to go on from; empty: it has one."""
    if loop.mode is Mode.INACTIVE:
        return 'the node is inactive'
    if loop.x is None or loop.mode is Mode.WAITING:
        return 'no state has arrived'
    return 'no recent state has arrived' if loop.is_stale else ''


def explain_idleness(loop: ControlLoop) -> str:
    """Return why a loop follows nothing; empty: it does."""
    if loop.mode in (Mode.STOPPED, Mode.RESTING):
        return f'the loop is {_describe(loop)}'
    return explain_absence(loop)


def _describe(loop: ControlLoop) -> str:
    if loop.mode in FOLLOWING:
        return f'follows its {loop.mode.name.lower().replace("_", " ")}'
    return f'{loop.mode.name.lower()}: {loop.reason}'


def _rests(loop: ControlLoop, candidate: LqrCandidate, x: list[float], u: list[float], span: int
           ) -> bool:
    """
    Return whether a predicted state stays, to the tolerance of the start of a reference.

    It moves by less in as long as was predicted, and what is held is as near.
    """
    allowed = compute_allowed_distance(
        np.zeros(len(x)), candidate.control.rules.x_limits, candidate.settings.start_tolerance)
    if loop.mode not in (Mode.SET_POINT, Mode.STOPPED):
        return False
    moved = candidate.design.plant.system.f(np.array(x), np.array(u)) * span * NS
    left = loop.error if loop.mode is Mode.SET_POINT and loop.error else [0.0] * len(x)
    return all(is_within(each, low, high) for distances in (moved.tolist(), left)
               for each, (low, high) in zip(distances, allowed, strict=True))
