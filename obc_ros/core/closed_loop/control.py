# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What a control loop is told: the law, the limits, and the rules around them."""

from dataclasses import dataclass

from obc_ros.core.closed_loop.feedback import (
    Gains,
    InputLimits,
    ReferenceLaw,
    Rows,
    StateFeedback,
    Vector,
)

STALE = ('equilibrium', 'hold', 'silent')
ENVELOPE = ('stop', *STALE)


@dataclass(eq=False)
class Reference:
    """
    When a reference begins, and what has become of it.

    Attributes
    ----------
    begin : int or None
        Stamp [ns] of its t = 0; None until the first state after it.
    duration : float
        [s]
    refused : str
        Why it is not followed; empty: it is.
    is_judged : bool
        Whether it was compared with the state where it is taken up.
    told : str
        What was told of it last: '', 'begun' or 'ended'.

    """

    begin: int | None
    duration: float
    refused: str = ''
    is_judged: bool = False
    told: str = ''


@dataclass(frozen=True, eq=False)
class Leg:
    """
    A reference with the law along it, and the one that goes on from its end.

    Attributes
    ----------
    reference : Reference
    along, after : Law
    allowed : tuple of (float, float)
        (n,) bounds of x - xr inside which it is taken up; empty: any.
    units : tuple of str
        (n,) of the states.

    """

    reference: Reference
    along: ReferenceLaw
    after: ReferenceLaw
    allowed: tuple[tuple[float, float], ...] = ()
    units: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Horizon:
    """
    A set point that is to be reached within a time.

    Attributes
    ----------
    time : float
        [s]
    gains : Gains
        Against the time since it was given or the law began.

    """

    time: float
    gains: Gains


@dataclass(frozen=True, eq=False)
class Schedule:
    """
    Gains that follow a variable, such as the speed.

    Attributes
    ----------
    gains : Gains
        Against the variable.
    input : int
        Index of the input that is the variable, where it is not measured; -1: it is a parameter
        of the plant, and the gains hold along references too.

    """

    gains: Gains
    input: int


@dataclass(frozen=True)
class Prediction:
    """
    What the error will be when the command takes effect, a known delay later.

    e(t + delay) = Phi e + sum over i of Gamma_i (u_i - ur), where e is x - xr with the integrals
    z below it, u_1 is the last command, u_2 the one before it, each held for `period`.

    Attributes
    ----------
    Phi : tuple of tuple of float
        (n + p, n + p).
    Gammas : tuple of tuple of tuple of float
        An (n + p, m) matrix for each command that is still to take effect, the last one first.
    period, delay : int
        Of the commands [ns].

    """

    Phi: Rows
    Gammas: tuple[Rows, ...]
    period: int
    delay: int


@dataclass(frozen=True)
class Rules:
    """
    When to answer and what to do when something is wrong.

    Attributes
    ----------
    period : int
        Shortest time between two answers [ns] of stamps; 0: answer every state.
    state_timeout : float
        Age of the last good state [s] at which `on_stale` acts; 0: never.
    on_stale : str
        'equilibrium' (the input at rest), 'hold' (the last command) or 'silent'.
    x_limits : tuple of (float, float)
        (n,) lower and upper bound of the error x - xr, inside which the law is used; empty: any.
    on_envelope : str
        'stop' (latched) or as `on_stale`.
    transition_time : float
        Time [s] in which the jump of a change decays; 0: it is not smoothed.
    from_rest : bool
        Whether the first command is such a change, from the input at rest.
    stamp_timeout : float
        Difference of a state's stamp to the clock [s] beyond which it is dropped; 0: any.

    """

    period: int = 0
    state_timeout: float = 0.5
    on_stale: str = 'equilibrium'
    x_limits: tuple[tuple[float, float], ...] = ()
    on_envelope: str = 'stop'
    transition_time: float = 0.0
    from_rest: bool = False
    stamp_timeout: float = 0.0


@dataclass(frozen=True, eq=False)
class Control:
    """
    All that decides about a command; adopted as one.

    Attributes
    ----------
    regulator : Regulator
        About the set point.
    limits : Limits
    rest : tuple of float
        (m,) input that keeps the plant at rest, or stops it where the set point moves on.
    names : tuple of str
        (n,) names of the states.
    rules : Rules
    legs : tuple of Leg
        References in the order of their beginnings; the last that has begun is followed.
    C : tuple of tuple of float
        (p, n) outputs with integral action: the input has the part -w, dw/dt = Ki C (x - xr), so
        that a gain which changes leaves what was learned of a constant disturbance.
    prediction : Prediction, optional
    horizon : Horizon, optional
    schedule : Schedule, optional

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
