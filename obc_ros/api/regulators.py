# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Linear quadratic regulators of matrices, systems and python-control's state spaces."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from obc_ros.api.given import as_state, as_weight, StateLike
from obc_ros.api.plants import as_system, choose_names, equilibrium, is_of_control
from obc_ros.core.lqr import lqr as regulator
from obc_ros.core.lqr.held_loop import HeldLoop
from obc_ros.core.lqr.held_margins import compute_held_margins
from obc_ros.core.lqr.lqr import LqrDesign
from obc_ros.core.lqr.margins import compute_margins, Figures
from obc_ros.core.lqr.sampled import sampled_lqr
from obc_ros.core.lqr.weights import Weights
from obc_ros.core.numerics.arrays import Array, Complex
from obc_ros.core.riccati.fixed_horizon import solve_finite_horizon
from obc_ros.core.systems.equilibrium import linearize
from obc_ros.core.text.errors import describe_type, quote, StatementError
from obc_ros.core.text.tables import format_html_table, format_table, Tabulated

LOOPS = 'setpoint', 'disturbance', 'loop', 'plant'
_POINTS = 201   # times of a finite horizon, unless they are given


@dataclass(frozen=True, eq=False)
class LinearPlant:
    """A plant about the set point xe (n,), ue (m,); `period` [s] is 0 in continuous time."""

    A: Any
    B: Any
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    xe: Array
    ue: Array
    period: float = 0.0


@dataclass(frozen=True, eq=False, repr=False)
class RegulatorDesign:
    """
    A state feedback u = ue - K (x - xe) whose stability is verified.

    Attributes
    ----------
    lqr : LqrDesign
        Plant, weights, gain, Riccati solution, poles.
    states, inputs : tuple of str
        Names.
    xe, ue : ndarray, shape (n,), (m,)
        Set point, and the input there.
    plant : LinearPlant, optional
        The plant in continuous time of a sampled design.

    """

    lqr: LqrDesign
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    xe: Array
    ue: Array
    plant: LinearPlant | None = None

    @property
    def A(self) -> Array:
        """Return A, shape (n, n); of the sampled plant if `period` is positive."""
        return self.lqr.A

    @property
    def B(self) -> Array:
        """Return B, shape (n, m); of the sampled plant if `period` is positive."""
        return self.lqr.B

    @property
    def K(self) -> Array:
        """Return the gain, shape (m, n)."""
        return self.lqr.K

    @property
    def P(self) -> Array:
        """Return the Riccati solution, shape (n, n); the cost from x is (x - xe)'P (x - xe)."""
        return self.lqr.P

    @property
    def E(self) -> Complex:
        """Return the closed-loop poles, shape (n,); in the z plane if `period` is positive."""
        return self.lqr.E

    @property
    def period(self) -> float:
        """Return the sampling period [s]; 0 in continuous time."""
        return self.lqr.period

    @cached_property
    def margins(self) -> Figures:
        """
        Return poles, damping, stability margins and step figures of the closed loop.

        Those of a plant in continuous time that is sampled are of its held input.
        """
        if self.plant is not None:
            A, B = (np.asarray(each, dtype=float) for each in (self.plant.A, self.plant.B))
            return compute_held_margins(HeldLoop(A, B, np.zeros((0, len(A))), self.K, self.period,
                                                 0.0, self.period))
        return compute_margins(self.A, self.B, self.K, self.period)

    def __call__(self, t: float, x: StateLike) -> Array:
        """Return the input u = ue - K (x - xe), shape (m,), at a state, in order or by name."""
        state = x if isinstance(x, np.ndarray) and x.shape == self.xe.shape else as_state(
            x, self.states, 'x')
        return self.ue - self.K @ (state - self.xe)

    def to_control(self, loop: str = 'setpoint') -> Any:
        """
        Return the loop for python-control, in deviations from the set point.

        Parameters
        ----------
        loop : str
            'setpoint': from set points (named p_set for a state p) to states and inputs;
            'disturbance': from disturbances at the inputs to states and inputs, both closed loops;
            'loop': the open loop K (s I - A)^-1 B, for Nyquist and Bode plots; 'plant': from
            inputs to states.

        Returns
        -------
        control.StateSpace
            With names; in discrete time if `period` is positive.

        Raises
        ------
        StatementError
            If there is no such loop.

        """
        import control
        A, B, K, n, m = self.A, self.B, self.K, len(self.states), len(self.inputs)
        states, inputs = list(self.states), list(self.inputs)
        both, names = np.vstack([np.eye(n), -K]), {
            'states': states, 'dt': self.period, 'outputs': states + inputs}
        if loop == 'setpoint':
            feed = np.vstack([np.zeros((n, n)), K])
            return control.ss(A - B @ K, B @ K, both, feed, **names,
                              inputs=[f'{name}_set' for name in states])
        if loop == 'disturbance':
            return control.ss(A - B @ K, B, both, np.zeros((n + m, m)), **names,
                              inputs=[f'{name}_disturbance' for name in inputs])
        if loop == 'loop':
            return control.ss(A, B, K, np.zeros((m, m)), **names | {
                'outputs': [f'{name}_feedback' for name in inputs]}, inputs=inputs)
        if loop == 'plant':
            return control.ss(A, B, np.eye(n), np.zeros((n, m)), **names | {'outputs': states},
                              inputs=inputs)
        raise StatementError(f'loop: wanted one of {", ".join(LOOPS)}, found '
                             f'{describe_type(loop)}')

    def _rows(self) -> list[tuple[str, ...]]:
        return [(name, *(f'{value:.6g}' for value in row))
                for name, row in zip(self.inputs, self.K, strict=True)]

    def __repr__(self) -> str:
        """Return sizes and poles."""
        poles = ', '.join(f'{pole.real:.4g}{pole.imag:+.4g}j' if pole.imag else f'{pole.real:.4g}'
                          for pole in self.E)
        return (f'<RegulatorDesign: {len(self.states)} states, {len(self.inputs)} inputs; poles '
                f'{quote(poles, 120)}>')

    def __str__(self) -> str:
        """Return a table of the gain."""
        return format_table(('K', *self.states), self._rows())

    def _repr_html_(self) -> str:
        """Return the gain and the poles as a table."""
        return format_html_table(('K', *self.states), self._rows(), repr(self).strip('<>'))


@dataclass(frozen=True, eq=False, repr=False)
class FiniteHorizonDesign(Tabulated):
    """u = -K(t) x at `t` (N,) [s]: K (N, m, n), P (N, n, n); the cost from t on is x'P(t) x."""

    t: Array
    P: Array
    K: Array


def lqr(*arguments: Any, at: StateLike | None = None,
        cross: ArrayLike | None = None, stability: float = 0.0) -> RegulatorDesign:
    """
    Return the gain that minimises the integral of x'Qx x + 2 x'N u + u'Qu u.

    Parameters
    ----------
    *arguments
        ``A, B, Qx, Qu``, or ``plant, Qx, Qu`` with any plant as for `equilibrium`,
        which is linearised at the equilibrium of its set point. Qx (n, n) >= 0 and Qu (m, m) > 0
        may be diagonals, as lists or by name, or one
        number for all.
    at : array_like, shape (n,), or mapping, optional
        Set point of a plant; default: its own.
    cross : array_like, shape (n, m), optional
        N.
    stability : float
        Prescribed degree of stability [1/s]: poles left of -stability.

    Returns
    -------
    RegulatorDesign
        ``K`` (m, n), ``P`` (n, n), ``E`` (n,), ``margins``, ``to_control()``.

    Raises
    ------
    StatementError, DynamicsError
        If an argument is invalid, or there is no equilibrium at the set point.
    RefusedDesignError
        If a weight is not definite, or stability cannot be verified; the message names the entry
        or the mode.

    """
    plant, Qx, Qu = _read_plant('lqr', arguments, at)
    if plant.period:
        raise StatementError('lqr: the plant is in discrete time; use dlqr')
    return _dress(regulator.lqr(plant.A, plant.B, Qx, Qu, cross=cross, stability=stability), plant)


def dlqr(*arguments: Any, at: StateLike | None = None,
         cross: ArrayLike | None = None, stability: float = 0.0, period: float = 0.0
         ) -> RegulatorDesign:
    """
    Return the gain of a regulator in discrete time.

    Parameters
    ----------
    *arguments
        ``A, B, Qx, Qu`` of x+ = A x + B u and the sum of x'Qx x + 2 x'N u + u'Qu u; or ``plant,
        Qx, Qu`` with a StateSpace of python-control. A plant in continuous time, or a System, is
        sampled with `period`, and the cost is the integral of `lqr` with a held input.
    at, cross, stability
        As for `lqr`.
    period : float
        Sampling period [s]; 1 for matrices if it is left out.

    Returns
    -------
    RegulatorDesign
        ``E`` is in the z plane, ``A`` and ``B`` are those of the sampled plant.

    Raises
    ------
    StatementError, DynamicsError, RefusedDesignError
        As `lqr`.

    """
    plant, Qx, Qu = _read_plant('dlqr', arguments, at)
    if len(arguments) == 4 or plant.period:
        if period and plant.period and period != plant.period:
            raise StatementError(f'dlqr: period {period:g} s, but that of the plant is '
                                 f'{plant.period:g} s')
        return _dress(regulator.dlqr(plant.A, plant.B, Qx, Qu, cross=cross, stability=stability,
                                     period=period or plant.period or 1.0), plant)
    weights = Weights(Qx, Qu, None if cross is None else np.asarray(cross, float), stability)
    found = sampled_lqr(np.asarray(plant.A, float), np.asarray(plant.B, float), weights, period)
    return replace(_dress(found, plant), plant=plant)


def finite_horizon(*arguments: Any, t: ArrayLike | None = None,
                   at: StateLike | None = None, cross: ArrayLike | None = None
                   ) -> FiniteHorizonDesign:
    """
    Solve the Riccati differential equation backwards from T: the gain for a finite horizon.

    Parameters
    ----------
    *arguments
        ``A, B, Qx, Qu, P1, T``, or ``plant, Qx, Qu, P1, T`` as for `lqr`; P1 (n, n) >= 0 is the
        terminal weight, T the final time [s].
    t : array_like, shape (N,), optional
        Increasing times [s], at most T; default: 201 times from 0 to T.
    at, cross
        As for `lqr`.

    Returns
    -------
    FiniteHorizonDesign
        ``t``, ``P`` and ``K``.

    Raises
    ------
    StatementError, DynamicsError, RefusedDesignError
        As `lqr`.

    """
    if len(arguments) not in (5, 6):
        raise StatementError('finite_horizon: wanted A, B, Qx, Qu, P1, T or a plant, Qx, Qu, P1, '
                             f'T, found {len(arguments)} arguments')
    *first, P1, T = arguments
    plant, Qx, Qu = _read_plant('finite_horizon', tuple(first), at)
    if plant.period:
        raise StatementError('finite_horizon: the plant is in discrete time')
    if not isinstance(T, (int, float)) or not 0.0 < T < np.inf:
        raise StatementError(f'T: wanted a positive number of seconds, found {describe_type(T)}')
    times = np.linspace(0.0, T, _POINTS) if t is None else np.asarray(t, dtype=np.float64)
    P, K = solve_finite_horizon(plant.A, plant.B, Qx, Qu, as_weight(P1, plant.states, 'P1'),
                                times, float(T), cross=cross)
    return FiniteHorizonDesign(times, P, K)


def _dress(design: LqrDesign, plant: LinearPlant) -> RegulatorDesign:
    states, inputs = plant.states, plant.inputs
    if not states:   # matrices have no names
        states = tuple(f'x{k + 1}' for k in range(len(design.A)))
        inputs = tuple(f'u{k + 1}' for k in range(design.B.shape[1]))
    xe, ue = (values if values.size else np.zeros(len(names))
              for values, names in ((plant.xe, states), (plant.ue, inputs)))
    return RegulatorDesign(design, states, inputs, xe, ue)


def _read_plant(name: str, arguments: tuple[Any, ...], at: Any
                ) -> tuple[LinearPlant, Any, Any]:
    if len(arguments) not in (3, 4):
        raise StatementError(f'{name}: wanted A, B, Qx, Qu or a plant, Qx, Qu, found '
                             f'{len(arguments)} arguments')
    *first, Qx, Qu = arguments
    if len(first) == 2:
        if at is not None:
            raise StatementError(f'{name}: at is the set point of a System')
        plant = LinearPlant(first[0], first[1], (), (), np.zeros(0), np.zeros(0))
    else:
        plant = _linearize(name, first[0], at)
    return (plant, as_weight(Qx, plant.states, 'Qx'), as_weight(Qu, plant.inputs, 'Qu'))


def _linearize(name: str, plant: Any, at: Any) -> LinearPlant:
    if at is None and is_of_control(plant) and hasattr(plant, 'A'):
        states, inputs = (choose_names(labels, letter) for labels, letter in (
            (plant.state_labels, 'x'), (plant.input_labels, 'u')))
        return LinearPlant(np.array(plant.A), np.array(plant.B), states, inputs,
                           np.zeros(len(states)), np.zeros(len(inputs)),
                           1.0 if plant.dt is True else float(plant.dt or 0.0))
    if isinstance(plant, (list, tuple, np.ndarray)):
        raise StatementError(f'{name}: wanted A, B, Qx, Qu or a plant, Qx, Qu, found '
                             f'{describe_type(plant)} and two more')
    system = as_system(plant)
    rest = equilibrium(system, at)
    A, B = linearize(system.model, rest.x, rest.u)
    return LinearPlant(A, B, system.states, system.inputs, rest.x, rest.u)
