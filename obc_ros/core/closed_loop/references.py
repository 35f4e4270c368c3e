# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Which reference a control follows at a stamp, and whether it may be taken up there."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from obc_ros.core.closed_loop.control import Control, Leg
from obc_ros.core.closed_loop.feedback import BlendedFeedback, ReferenceLaw, StateFeedback
from obc_ros.core.closed_loop.message_stamps import NS

AllowedErrors = tuple[tuple[float, float], ...]


class Running(NamedTuple):
    """The law in force, the stamp [ns] of its t = 0, and whether it is that of the set point."""

    law: ReferenceLaw
    origin: int
    is_setpoint: bool = False


def set_point(control: Control, regulator: StateFeedback, origin: int) -> Running:
    """Return the law that holds a set point from a stamp on, over the horizon if there is one."""
    if control.horizon is None:
        return Running(regulator, origin, True)
    return Running(BlendedFeedback(regulator, control.horizon.gains), origin, True)


def select_accepted(legs: Sequence[Leg]) -> list[Leg]:
    """Return the references that have not been refused."""
    return [leg for leg in legs if not leg.reference.refused]


def restarts_horizon(old: Control, new: Control) -> bool:
    """Return whether the horizon of `new`, in place of `old`, begins at its first state."""
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
    """Return the last reference that has begun at a stamp [ns] and was not refused."""
    return next((leg for leg in reversed(legs) if not leg.reference.refused and (
        leg.reference.begin is None or stamp >= leg.reference.begin)), None)


def begin_now(legs: Sequence[Leg], stamp: int) -> None:
    """Let the references that have no beginning yet begin at a stamp [ns]."""
    for leg in legs:
        if leg.reference.begin is None:
            leg.reference.begin = stamp


def forget(legs: Sequence[Leg]) -> None:
    """Let references be judged anew where they are taken up next."""
    for leg in legs:
        leg.reference.is_judged, leg.reference.told = False, ''


def has_unjudged(legs: Sequence[Leg]) -> bool:
    """Return whether a reference waits for its judgement."""
    return any(not leg.reference.is_judged for leg in legs)


def judge_references(control: Control, stamp: int, x: Sequence[float]) -> Iterator[str]:
    """
    Judge the references that are taken up at a stamp [ns] by the state (n,) then.

    Yields the reason of each refusal. A reference that is refused is never followed; what was
    followed before goes on.
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
    Judge the reference that was followed before states failed to come, once they are back.

    Returns why the state (n,) at a stamp [ns] is too far from where the reference is by then. An
    empty sentence: it is near enough, or none was followed. A reference that had ended before is
    held as a set point is, and not judged. One that is too far is given up together with what was
    followed before it: the plant is at neither.
    """
    leg, now = find_last_begun(control.legs, stamp), find_current(control.legs, stamp)
    if leg is None or now is None or leg.reference.begin is None or leg.reference.told != 'begun':
        return ''
    wanted = now.law.at((stamp - now.origin) * NS).x
    reason = _distance(control, leg, (stamp - leg.reference.begin) * NS, x, wanted)
    for each in control.legs:
        if reason and each.reference.told:
            each.reference.refused = reason
    return reason


def describe_events(legs: Sequence[Leg], law: ReferenceLaw) -> Iterator[str]:
    """Yield in words what a law that comes into force begins or ends; each once."""
    for leg in legs:
        reference = leg.reference
        if law is leg.along and not reference.told:
            reference.told = 'begun'
            yield f'the reference of {reference.duration:g} s is taken up'
        elif law is leg.after and reference.told != 'ended':
            reference.told = 'ended'
            yield f'the reference of {reference.duration:g} s has ended'


def _distance(control: Control, leg: Leg, t: float, x: Sequence[float], wanted: Sequence[float]
              ) -> str:
    """Return how far a state is from a reference at its time t [s], as `describe_miss` does."""
    if not leg.allowed:
        return ''
    return describe_miss(control.limits.error(x, wanted), wanted, min(t, leg.reference.duration),
                         leg.allowed, control.names, leg.units)


def describe_miss(error: Sequence[float], wanted: Sequence[float], t: float,
                  allowed: AllowedErrors,
                  names: Sequence[str], units: Sequence[str]) -> str:
    """
    Return which states are too far from a reference, in words; empty: none is.

    Parameters
    ----------
    error, wanted : sequence of float
        (n,) x - xr and xr.
    t : float
        Time of the reference [s] at which it is taken up; 0: its start.
    allowed : tuple of (float, float)
        (n,) bounds of the error.
    names, units : sequence of str
        (n,) of the states.

    """
    where = "the plan's start {}" if t == 0.0 else f'{{}} of the plan at t = {t:.4g} s'
    return '; '.join(
        f'{name} is {format_unit(abs(e), unit)} from {where.format(format_unit(xr, unit))}, '
        f'allowed {format_unit(-low if e < 0.0 else high, unit)}'
        for e, xr, (low, high), name, unit in zip(
            error, wanted, allowed, names, units, strict=True)
        if not is_within(e, low, high))


def is_within(error: float, low: float, high: float) -> bool:
    """Return whether an error is between its bounds, up to rounding."""
    return low * (1.0 + 1e-9) <= error <= high * (1.0 + 1e-9)


def format_unit(value: float, unit: str) -> str:
    """Return a number with its unit, if it has one."""
    return f'{value:.4g} {unit}'.rstrip()
