# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Selection of the reference that is followed at a stamp, and checks of the state there."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from obc_ros.core.closed_loop.control import Control, Leg
from obc_ros.core.closed_loop.feedback import BlendedFeedback, ReferenceLaw, StateFeedback
from obc_ros.core.closed_loop.message_stamps import NS

AllowedErrors = tuple[tuple[float, float], ...]


class Running(NamedTuple):
    """A control law, the stamp [ns] of its t = 0, and whether it is that of the set point."""

    law: ReferenceLaw
    origin: int
    is_setpoint: bool = False


def set_point(control: Control, regulator: StateFeedback, origin: int) -> Running:
    """Return the law of a set point from a stamp on, with the gains of its horizon if any."""
    if control.horizon is None:
        return Running(regulator, origin, True)
    return Running(BlendedFeedback(regulator, control.horizon.gains), origin, True)


def select_accepted(legs: Sequence[Leg]) -> list[Leg]:
    """Return the references that were not rejected."""
    return [leg for leg in legs if not leg.reference.refused]


def restarts_horizon(old: Control, new: Control) -> bool:
    """Return whether the horizon begins anew when `new` replaces `old`."""
    return (old.horizon is None or new.horizon is None
            or old.horizon.time != new.horizon.time
            or (old.regulator.x, old.regulator.u) != (new.regulator.x, new.regulator.u)
            or bool(select_accepted(old.legs)) and not new.legs)


def find_current(legs: Sequence[Leg], stamp: int) -> Running | None:
    """Return the law of the last reference that has begun at a stamp [ns]; None: none has."""
    leg = find_last_begun(legs, stamp)
    if leg is None:
        return None
    reference = leg.reference
    if reference.begin is None:
        return Running(leg.along, stamp)
    end = reference.begin + round(reference.duration / NS)
    return Running(leg.after, end) if stamp >= end else Running(leg.along, reference.begin)


def find_last_begun(legs: Sequence[Leg], stamp: int) -> Leg | None:
    """Return the last reference that has begun at a stamp [ns] and was not rejected."""
    return next((leg for leg in reversed(legs) if not leg.reference.refused and (
        leg.reference.begin is None or stamp >= leg.reference.begin)), None)


def begin_now(legs: Sequence[Leg], stamp: int) -> None:
    """
    Let the references without a beginning begin at a stamp.

    Parameters
    ----------
    legs : sequence of Leg
        Their references are changed in place.
    stamp : int
        [ns]

    """
    for leg in legs:
        if leg.reference.begin is None:
            leg.reference.begin = stamp


def forget(legs: Sequence[Leg]) -> None:
    """Mark all references as not checked and not reported."""
    for leg in legs:
        leg.reference.is_judged, leg.reference.reported = False, ''


def has_unjudged(legs: Sequence[Leg]) -> bool:
    """Return whether a reference is not checked yet."""
    return any(not leg.reference.is_judged for leg in legs)


def judge_references(control: Control, stamp: int, x: Sequence[float]) -> Iterator[str]:
    """
    Check the state at the beginning of each reference that has begun at a stamp.

    A rejected reference is never followed; the one before it continues.

    Parameters
    ----------
    control : Control
        Its references are marked in place.
    stamp : int
        [ns]
    x : sequence of float
        The state (n,) at the stamp.

    Yields
    ------
    str
        The reason of each rejection.

    """
    for leg in control.legs:
        reference = leg.reference
        begin = stamp if reference.begin is None else reference.begin
        if reference.is_judged or stamp < begin:
            continue
        reference.is_judged = True
        t = (stamp - begin) * NS
        reference.refused = _distance(control, leg, t, x, leg.along.at(t).x)
        if reference.refused:
            yield reference.refused


def judge_again(control: Control, stamp: int, x: Sequence[float]) -> str:
    """
    Check the followed reference when states return after an outage.

    Returns why the state (n,) at a stamp [ns] is too far from the reference; empty: it is near
    enough, or none was followed. A reference that had ended is held like a set point and is not
    checked. A reference that is too far is rejected with all references followed before it.
    """
    leg, now = find_last_begun(control.legs, stamp), find_current(control.legs, stamp)
    if (leg is None or now is None or leg.reference.begin is None
            or leg.reference.reported != 'begun'):
        return ''
    wanted = now.law.at((stamp - now.origin) * NS).x
    reason = _distance(control, leg, (stamp - leg.reference.begin) * NS, x, wanted)
    for each in control.legs:
        if reason and each.reference.reported:
            each.reference.refused = reason
    return reason


def describe_events(legs: Sequence[Leg], law: ReferenceLaw) -> Iterator[str]:
    """Yield a message for each reference that a new law begins or ends; each once."""
    for leg in legs:
        reference = leg.reference
        if not reference.is_announced:
            continue
        if law is leg.along and not reference.reported:
            reference.reported = 'begun'
            yield f'the reference of {reference.duration:g} s begins'
        elif law is leg.after and reference.reported != 'ended':
            reference.reported = 'ended'
            yield f'the reference of {reference.duration:g} s has ended'


def _distance(control: Control, leg: Leg, t: float, x: Sequence[float], wanted: Sequence[float]
              ) -> str:
    """Return `describe_miss` of a state at the time t [s] of a reference."""
    if not leg.allowed:
        return ''
    return describe_miss(control.limits.error(x, wanted), wanted, min(t, leg.reference.duration),
                         leg.allowed, control.names, leg.units)


def describe_miss(error: Sequence[float], wanted: Sequence[float], t: float,
                  allowed: AllowedErrors,
                  names: Sequence[str], units: Sequence[str]) -> str:
    """
    Return a message on the states that are too far from a reference; empty: none is.

    Parameters
    ----------
    error, wanted : sequence of float
        (n,) x - xr and xr.
    t : float
        Time of the reference [s]; 0: its start.
    allowed : tuple of (float, float)
        (n,) bounds of the error.
    names, units : sequence of str
        (n,) names and units of the states.

    """
    where = "the plan's start {}" if t == 0.0 else f'{{}} of the plan at t = {t:.4g} s'
    return '; '.join(
        f'{name} is {format_unit(abs(e), unit)} from {where.format(format_unit(xr, unit))}, '
        f'allowed {format_unit(-low if e < 0.0 else high, unit)}'
        for e, xr, (low, high), name, unit in zip(
            error, wanted, allowed, names, units, strict=True)
        if not is_within(e, low, high))


def is_within(error: float, low: float, high: float) -> bool:
    """
    Return whether an error is between its bounds.

    Parameters
    ----------
    error : float
        The error.
    low, high : float
        low < 0 < high; they are widened by 1e-9 of their size, for rounding.

    Returns
    -------
    bool

    """
    return low * (1.0 + 1e-9) <= error <= high * (1.0 + 1e-9)


def format_unit(value: float, unit: str) -> str:
    """
    Return a number with four digits and its unit.

    Parameters
    ----------
    value : float
        The number.
    unit : str
        Its unit; empty: none.

    Returns
    -------
    str

    """
    return f'{value:.4g} {unit}'.rstrip()
