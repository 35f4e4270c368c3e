# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Which reference a control follows at a stamp, and whether it may be taken up there."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from obc_ros.core.control import Control, Leg
from obc_ros.core.regulator import Law, Regulator, Settling
from obc_ros.core.stamps import NS

Bounds = tuple[tuple[float, float], ...]


class Running(NamedTuple):
    """The law in force, the stamp [ns] of its t = 0, and whether it is that of the set point."""

    law: Law
    origin: int
    is_setpoint: bool = False


def set_point(control: Control, regulator: Regulator, origin: int) -> Running:
    """Return the law that holds a set point from a stamp on, over the horizon if there is one."""
    if control.horizon is None:
        return Running(regulator, origin, True)
    return Running(Settling(regulator, control.horizon.gains), origin, True)


def accepted(legs: Sequence[Leg]) -> list[Leg]:
    """Return the references that have not been refused."""
    return [leg for leg in legs if not leg.reference.refused]


def begins_anew(old: Control, new: Control) -> bool:
    """Return whether the horizon of `new`, in place of `old`, begins at its first state."""
    return (old.horizon is None or new.horizon is None
            or old.horizon.time != new.horizon.time
            or (old.regulator.x, old.regulator.u) != (new.regulator.x, new.regulator.u)
            or bool(accepted(old.legs)) and not new.legs)


def in_force(legs: Sequence[Leg], stamp: int) -> Running | None:
    """Return the law of the last reference that has begun at a stamp [ns]; None: none has."""
    for leg in reversed(legs):
        reference = leg.reference
        if reference.refused:
            continue
        if reference.begin is None:
            return Running(leg.along, stamp)
        end = reference.begin + round(reference.duration / NS)
        if stamp >= end:
            return Running(leg.after, end)
        if stamp >= reference.begin:
            return Running(leg.along, reference.begin)
    return None


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


def judge(control: Control, stamp: int, x: Sequence[float]) -> Iterator[str]:
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
        wanted = leg.along.at(t).x
        if leg.allowed:
            reference.refused = distance(
                control.limits.error(x, wanted), wanted, min(t, reference.duration), leg.allowed,
                control.names, leg.units)
        if reference.refused:
            yield reference.refused


def events(legs: Sequence[Leg], law: Law) -> Iterator[str]:
    """Yield in words what a law that comes into force begins or ends; each once."""
    for leg in legs:
        reference = leg.reference
        if law is leg.along and not reference.told:
            reference.told = 'begun'
            yield f'the reference of {reference.duration:g} s is taken up'
        elif law is leg.after and reference.told != 'ended':
            reference.told = 'ended'
            yield f'the reference of {reference.duration:g} s has ended'


def distance(error: Sequence[float], wanted: Sequence[float], t: float, allowed: Bounds,
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
        f'{name} is {with_unit(abs(e), unit)} from {where.format(with_unit(xr, unit))}, '
        f'allowed {with_unit(-low if e < 0.0 else high, unit)}'
        for e, xr, (low, high), name, unit in zip(
            error, wanted, allowed, names, units, strict=True)
        if not is_within(e, low, high))


def is_within(error: float, low: float, high: float) -> bool:
    """Return whether an error is between its bounds, up to rounding."""
    return low * (1.0 + 1e-9) <= error <= high * (1.0 + 1e-9)


def with_unit(value: float, unit: str) -> str:
    """Return a number with its unit, if it has one."""
    return f'{value:.4g} {unit}'.rstrip()
