# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Design of a regulator for a system at a set point, with verified stability.

The steps: linearise at the equilibrium, choose the weights (section 2.5), compute the gain
(section 2.4).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import functools
from typing import Any

import numpy as np
from obc_ros.core.closed_loop.control import Prediction
from obc_ros.core.closed_loop.feedback import convert_rows, convert_vector, StateFeedback, Vector
from obc_ros.core.lqr.gain_schedule import compute_schedule, Table
from obc_ros.core.lqr.held_loop import find_longest_period, HeldLoop, predict_delayed_state
from obc_ros.core.lqr.lqr import lqr, LqrDesign
from obc_ros.core.lqr.sampled import sampled_lqr
from obc_ros.core.lqr.weights import choose, Weights, with_integrals
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems.equilibrium import Equilibrium, find_equilibrium, linearize
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import DynamicsError, quote, RefusedDesignError, StatementError


@dataclass(frozen=True)
class Sampling:
    """
    When a controller acts.

    :ivar period: period of the commands [s]; 0: not known.
    :ivar delay: known time until a command takes effect [s].
    :ivar exact: whether the design is for the sampled plant instead of the continuous one.
    """

    period: float = 0.0
    delay: float = 0.0
    exact: bool = False

    def __post_init__(self) -> None:
        if (self.exact or self.delay) and not self.period:
            what = 'design = sampled' if self.exact else f'delay = {self.delay:g}'
            raise StatementError(f'{what} needs the period of the commands: set sample_time or '
                                 'rate')


ALWAYS = Sampling()
_SHORT = 0.01   # of the shortest time constant: a period that is as good as continuous time


@dataclass(frozen=True, eq=False)
class LinearizedPlant:
    """
    A system linearised at an equilibrium.

    :ivar rest: input (m,) at rest: ue for a set point that does not move. For a moving set point
        it is the input of the equilibrium at rest at the same state, or ue if there is none.
    """

    system: System
    equilibrium: Equilibrium
    A: Array
    B: Array
    rest: Vector


@dataclass(frozen=True, eq=False)
class Design:
    """
    A feedback of a plant at its set point, with verified stability.

    :ivar weights, cost: the cost without and with the weights of the integrals.
    :ivar lqr: the design of the plant, with the integrals of the outputs C (p, n) as further
        states.
    """

    plant: LinearizedPlant
    weights: Weights
    lqr: LqrDesign
    C: Array
    cost: Weights
    sampling: Sampling

    @property
    def K(self) -> Array:
        """Return the gain of the state, shape (m, n)."""
        return self.lqr.K[:, :self.plant.system.n]

    @property
    def Ki(self) -> Array:
        """Return the gain of the integrals, shape (m, p)."""
        return self.lqr.K[:, self.plant.system.n:]

    def cost_to_go(self, error: Sequence[float]) -> float:
        """Return e'P e, the optimal cost from an error e = x - xe (n,)."""
        e = np.array(error)
        with np.errstate(all='ignore'):  # a diverged state has an infinite cost
            return float(e @ self.lqr.P[:len(e), :len(e)] @ e)

    def augmented(self, A: Array, B: Array) -> tuple[Array, Array]:
        """Return a linearization augmented with the integrals of this design."""
        return with_integrals(A, B, self.weights, self.C, np.ones(len(self.C)))[:2] if len(
            self.C) else (A, B)

    @property
    def prediction(self) -> Prediction | None:
        """Return the prediction of error and integrals over the delay; None without a delay."""
        period, delay = self.sampling.period, self.sampling.delay
        if not delay:
            return None
        Phi, Gammas = predict_delayed_state(*self.augmented(self.plant.A, self.plant.B), period,
                                            delay)
        return Prediction(
            convert_rows(Phi), tuple(map(convert_rows, Gammas)), round(period * 1e9),
            round(delay * 1e9))

    def held_loop(self, period: float = 0.0) -> HeldLoop | None:
        """Return the loop that runs at a measured period [s], or else that of the design."""
        foreseen = self.sampling.period
        if not (period or foreseen):
            return None
        return HeldLoop(self.plant.A, self.plant.B, self.C, self.lqr.K, period or foreseen,
                        self.sampling.delay, foreseen)

    @functools.cached_property
    def longest_period(self) -> float:
        """
        Return the longest period of the commands [s] up to which the loop stays stable.

        It is computed when it is first asked for, in about 10 ms. inf: there is none.
        """
        start = self.sampling.period
        if not start:
            fastest = max(float(np.abs(each).max()) for each in (
                np.linalg.eigvals(self.plant.A), self.lqr.E))
            start = _SHORT / max(fastest, 1e-300)
        loop = self.held_loop(start)
        assert loop is not None
        return find_longest_period(loop)

    @property
    def regulator(self) -> StateFeedback:
        """Return the state feedback at the set point."""
        at = self.plant.equilibrium
        return StateFeedback(convert_vector(at.x), convert_vector(at.u), convert_rows(self.K),
                             convert_vector(at.drift),
                             convert_rows(self.Ki) if len(self.C) else ())


def linearize_plant(system: System, setpoint: Sequence[float] = (),
                    setpoint_input: Sequence[float] = ()) -> LinearizedPlant:
    """
    Linearise a system at a set point.

    :param setpoint, setpoint_input: state (n,) and input (m,) for `find_equilibrium`; empty: those
        of the system.
    :raises DynamicsError: if no input within the limits holds the system there.
    """
    at = find_equilibrium(system, setpoint or None, setpoint_input or None)
    A, B = linearize(system, at.x, at.u)
    return LinearizedPlant(system, at, A, B, _rest(system, at))


def design(plant: LinearizedPlant, weights: dict[str, Any], integral: Sequence[str] = (),
           Qi: Sequence[float] = (), sampling: Sampling = ALWAYS) -> Design:
    """
    Return the regulator of a plant for a cost.

    :param weights: arguments of `weights.choose`; empty Qx, Qu: identity.
    :param integral: names of the states whose integrals are fed back.
    :param Qi: weights of these integrals; empty: 1 each.
    :raises StatementError: if a list has a wrong length or a number is out of range.
    :raises RefusedDesignError: if there is no gain with verified stability.
    """
    n, m = plant.B.shape
    given = {**weights, 'Qx': weights.get('Qx') or (1.0,) * n,
             'Qu': weights.get('Qu') or (1.0,) * m}
    chosen = choose(n, m, **given)
    A, B, cost, C = plant.A, plant.B, chosen, np.zeros((0, n))
    if integral:
        C = np.eye(n)[[_index(plant.system, name) for name in integral]]
        A, B, cost = with_integrals(A, B, chosen, C, Qi or (1.0,) * len(C))
    return Design(plant, chosen, _gain(A, B, cost, sampling, n), C, cost, sampling)


def design_again(found: Design, plant: LinearizedPlant) -> Design:
    """Return the design of another plant of the same system, for the same cost and sampling."""
    return replace(found, plant=plant, lqr=_gain(
        *found.augmented(plant.A, plant.B), found.cost, found.sampling, plant.system.n))


def schedule_gains(found: Design, plant_at: Callable[[float], LinearizedPlant], lower: float,
                   upper: float) -> Table:
    """
    Return a gain schedule for a range of a variable.

    The last p columns of each gain are those of the integrals.

    :param found: the cost and the sampling.
    :raises StatementError: if the design is not in continuous time, or the range is empty.
    :raises ObcError: if for a value there is no plant, or no gain with verified stability.
    """
    period = found.sampling.period
    if found.sampling.exact or found.sampling.delay:
        raise StatementError('schedule: wanted design = continuous and delay = 0')

    @functools.cache
    def linear(value: float) -> tuple[Array, Array]:
        at = plant_at(value)
        return found.augmented(at.A, at.B)

    made = compute_schedule(linear, found.cost, lower, upper)
    middles = 0.5 * (made.values[:-1] + made.values[1:])
    for value in (*made.values, *middles) if period else ():
        K = np.array([[np.interp(value, made.values, entry) for entry in row]
                      for row in np.moveaxis(made.K, 0, -1)])
        at = plant_at(float(value))
        _check_held(HeldLoop(at.A, at.B, found.C, K, period, 0.0, period),
                    'the continuous gain', 'wanted a higher rate')
    return made


def _check_held(loop: HeldLoop, gain: str, remedy: str) -> None:
    """Raise RefusedDesignError if a gain is unstable with its period and delay."""
    radius = loop.radius
    if not radius < 1.0:
        late = f' with a delay of {loop.delay:g} s' if loop.delay else ''
        raise RefusedDesignError(
            f'{gain} is unstable when the input is held for {loop.period:g} s{late} '
            f'(spectral radius {radius:.3g}); {remedy}')


def _gain(A: Array, B: Array, cost: Weights, sampling: Sampling, n: int) -> LqrDesign:
    """Return the gain of n states and integrals, verified for its period and delay if known."""
    period, delay = sampling.period, sampling.delay

    def held(found: LqrDesign) -> HeldLoop:
        return HeldLoop(A[:n, :n], B[:n], A[n:, :n], found.K, period, delay, period)

    try:
        if sampling.exact:
            found = sampled_lqr(A, B, cost, period, delay)
            if len(A) > n:   # the controller sums samples, the design integrates the motion
                _check_held(held(found), 'the gain with integral action',
                            'set a higher rate or smaller weights Qi')
            return found
        found = lqr(A, B, cost.Qx, cost.Qu, cross=cost.cross, stability=cost.stability)
        if period:
            _check_held(held(found), 'the continuous gain',
                        f'set design = sampled with sample_time = {period:g} first, both with '
                        'set_parameters_atomically')
    except (np.linalg.LinAlgError, OverflowError) as error:  # numbers near the range of a double
        raise RefusedDesignError(
            f'no gain can be computed with numbers of such sizes: {error}') from None
    return found


def _rest(system: System, at: Equilibrium) -> Vector:
    if not at.drift.any():
        return convert_vector(at.u)
    try:
        still = find_equilibrium(system, at.x, np.zeros(system.m))
    except DynamicsError:
        return convert_vector(at.u)
    return convert_vector(at.u if still.drift.any() else still.u)


def _index(system: System, name: str) -> int:
    if name not in system.state_names:
        raise StatementError(f"integral: there is no state '{quote(name)}' in "
                             f'{", ".join(system.state_names)}')
    return system.state_names.index(name)
