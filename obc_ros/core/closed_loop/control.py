# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Data of a control loop: control law, limits and rules."""

from dataclasses import dataclass
from functools import cached_property
import math

from obc_ros.core.closed_loop.feedback import (
    Gains,
    InputLimits,
    ReferenceLaw,
    Rows,
    StateFeedback,
    Vector,
)

AllowedErrors = tuple[tuple[float, float], ...]   # (n,) lower and upper bounds

STALE = ('equilibrium', 'hold', 'silent')
ENVELOPE = ('stop', *STALE)
UNPLANNED = ('regulator', *STALE)


@dataclass(frozen=True, eq=False)
class Reference:
    """
    When a reference begins; the object is its identity, whatever the gains along it.

    :ivar begin: stamp [ns] of its t = 0; None: the next state.
    :ivar duration: [s].
    """

    begin: int | None
    duration: float


@dataclass(frozen=True, eq=False)
class Leg:
    """
    A reference with the control law along it, and the one after its end.

    :ivar allowed: (n,) bounds of x - xr inside which it may begin; empty: none.
    :ivar units: (n,) of the states.
    """

    reference: Reference
    along: ReferenceLaw
    after: StateFeedback
    allowed: AllowedErrors = ()
    units: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Horizon:
    """
    Time-varying gains that reach a set point within a time [s].

    :ivar gains: gains over the time since the change of the set point or the start of the law.
    """

    time: float
    gains: Gains


@dataclass(frozen=True, eq=False)
class Schedule:
    """
    A gain schedule over a variable, such as the speed.

    :ivar input: index of the input that is the variable, if it is not measured; -1: a parameter of
        the plant, for which the gains are also used along references.
    """

    gains: Gains
    input: int


@dataclass(frozen=True)
class Prediction:
    """
    Prediction of the error at the time when a command takes effect.

    e(t + delay) = Phi e + sum over i of Gamma_i (u_i - ur), where e is x - xr followed by the
    integrals z. u_1 is the last command, u_2 the one before it; each is held for `period`.

    :ivar Phi: (n + p, n + p).
    :ivar Gammas: an (n + p, m) matrix for each command that has not taken effect, the last one
        first.
    :ivar period, delay: period and delay of the commands [ns].
    """

    Phi: Rows
    Gammas: tuple[Rows, ...]
    period: int
    delay: int

    @cached_property
    def rows(self) -> Rows:
        """Return [Phi, Gamma_1, Gamma_2, ...], shape (n + p, n + p + k m) for k commands."""
        return tuple([tuple([value for row in rows for value in row])
                      for rows in zip(self.Phi, *self.Gammas, strict=True)])


@dataclass(frozen=True)
class Rules:
    """
    When to send commands, and what to do about missing and extreme states.

    The fields that are parameters of the controllers have the meaning in docs/parameters.md.

    :ivar period: time between two commands on average [ns], by the stamps; 0: a command for every
        state.
    :ivar state_timeout: 0: never, and states may be any time apart.
    :ivar x_limits: (n,) lower and upper bound of the error x - xr inside which the law is used;
        empty: none.
    :ivar on_envelope: also acts when states are further apart than `Control.longest_period`.
    :ivar from_rest: whether the first command is reached from the input at rest as after a change.
    :ivar stamp_timeout: maximum difference of a stamp and the clock [s]; 0: no check.
    """

    period: int = 0
    state_timeout: float = 0.5
    on_stale: str = 'equilibrium'
    x_limits: AllowedErrors = ()
    on_envelope: str = 'stop'
    on_unplanned: str = 'regulator'
    transition_time: float = 0.0
    from_rest: bool = False
    stamp_timeout: float = 0.0


@dataclass(frozen=True, eq=False)
class Control:
    """
    Everything that determines a command; replaced as a whole.

    :ivar rest: (m,) input at rest.
    :ivar names: (n,) names of the states.
    :ivar legs: references, the latest last. One that begins replaces the one that is followed.
    :ivar C: (p, n) outputs with integral action. The input contains -w with dw/dt = Ki C (x - xr),
        so that a change of the gain keeps the compensation of a constant disturbance.
    :ivar longest_period: longest time between two states [s] for which the loop is stable; inf:
        not known.
    """

    regulator: StateFeedback
    limits: InputLimits
    rest: Vector
    names: tuple[str, ...]
    rules: Rules = Rules()
    legs: tuple[Leg, ...] = ()
    C: Rows = ()
    prediction: Prediction | None = None
    horizon: Horizon | None = None
    schedule: Schedule | None = None
    longest_period: float = math.inf
