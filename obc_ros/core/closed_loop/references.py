# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Which references are still to come, are followed or are over, and how near a state is to one."""

from collections.abc import Iterator, Sequence
from weakref import WeakKeyDictionary, WeakSet

from obc_ros.core.closed_loop.clock import NS
from obc_ros.core.closed_loop.control import Control, Leg, Reference
from obc_ros.core.text.tables import format_distinct


class Itinerary:
    """
    The references of a run.

    A reference begins once: what was rejected, given up or has ended does not begin again.

    :ivar followed: the one that is followed, also while a rule suspends the law.
    :ivar held: the one whose end is the set point.
    """

    def __init__(self) -> None:
        self.followed: Reference | None = None
        self.held: Reference | None = None
        self._begins = WeakKeyDictionary[Reference, int]()   # also of those without a stamp
        self._over = WeakSet[Reference]()

    def keep(self, legs: Sequence[Leg]) -> bool:
        """Give up all references but some; return whether one that matters was withdrawn."""
        lost = {each for each in (self.followed, self.held)
                if each is not None and find_leg(legs, each) is None}
        self._over.update(lost)
        self.followed, self.held = (None if each in lost else each
                                    for each in (self.followed, self.held))
        return bool(lost)

    def find_due(self, legs: Sequence[Leg], stamp: int) -> Iterator[Leg]:
        """Yield the references that are to begin at a stamp [ns] or were before."""
        for leg in legs:
            if leg.reference is not self.followed and leg.reference not in self._over:
                begin = self.find_begin(leg.reference)
                if begin is None or begin <= stamp:
                    yield leg

    def find_begin(self, reference: Reference) -> int | None:
        """Return the stamp [ns] of t = 0 of a reference; None: it is not known yet."""
        return self._begins.get(reference, reference.begin)

    def set_begin(self, reference: Reference, stamp: int) -> None:
        """Let a reference without a stamp of its own begin at a stamp [ns]."""
        self._begins.setdefault(reference, stamp)

    def begin(self, leg: Leg, stamp: int) -> None:
        """Follow a reference; without a stamp of its own it begins at a stamp [ns]."""
        if self.followed is not None:
            self._over.add(self.followed)
        self.followed, self.held = leg.reference, None
        begin = self.find_begin(leg.reference)
        self._begins[leg.reference] = stamp if begin is None else begin

    def end(self) -> None:
        """Hold the end of the followed reference."""
        if self.followed is not None:
            self._over.add(self.followed)
        self.followed, self.held = None, self.followed

    def reject(self, leg: Leg) -> None:
        """Let a reference never begin."""
        self._over.add(leg.reference)

    def drop(self, legs: Sequence[Leg]) -> int:
        """Give up all references; return how many were followed or were still to come."""
        dropped = sum(leg.reference not in self._over for leg in legs)
        self._over.update(leg.reference for leg in legs)
        if self.followed is not None:
            self._over.add(self.followed)
        self.followed = self.held = None
        return dropped

    def get_begin(self, reference: Reference) -> int:
        """Return the stamp [ns] of t = 0 of a reference that has begun."""
        return self._begins[reference]

    def get_end(self, reference: Reference) -> int:
        """Return the stamp [ns] of the end of a reference that has begun."""
        return self._begins[reference] + round(reference.duration / NS)


def find_leg(legs: Sequence[Leg], reference: Reference | None) -> Leg | None:
    """Return the law along a reference, or None."""
    return next((leg for leg in legs if leg.reference is reference), None)


def explain_distance(control: Control, leg: Leg, t: float, x: Sequence[float],
                     wanted: Sequence[float]) -> str:
    """
    Return a message on the states that are too far from a reference; empty: none is.

    :param t: time of the reference [s]; 0: its start.
    :param wanted: xr (n,) then.
    """
    if not leg.allowed:
        return ''
    t = min(t, leg.reference.duration)
    where = "the plan's start {}" if t == 0.0 else f'{{}} of the plan at t = {t:.4g} s'
    sentences = []
    for e, xr, (low, high), name, unit in zip(
            control.limits.error(x, wanted), wanted, leg.allowed, control.names, leg.units,
            strict=True):
        if not is_within(e, low, high):
            distance, most = format_distinct(abs(e), -low if e < 0.0 else high, unit=unit)
            place, = format_distinct(xr, unit=unit)
            sentences.append(f'{name} is {distance} from {where.format(place)}, allowed {most}')
    return '; '.join(sentences)


def is_within(error: float, low: float, high: float) -> bool:
    """
    Return whether an error is between its bounds.

    :param low, high: low < 0 < high; they are widened by 1e-9 of their size, for rounding.
    """
    return low * (1.0 + 1e-9) <= error <= high * (1.0 + 1e-9)
