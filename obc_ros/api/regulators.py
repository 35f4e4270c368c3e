# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Linear quadratic regulators of matrices, systems and python-control's state spaces."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, wraps
import inspect
from typing import Any, overload

import numpy as np
from obc_ros.api.figures.panels import draw_columns
from obc_ros.api.figures.presentation import present
from obc_ros.api.given import (
    as_duration,
    as_number,
    as_state,
    as_times,
    as_weight,
    MatrixLike,
    StateLike,
    VectorLike,
    WeightLike,
)
from obc_ros.api.plants import as_system, choose_names, equilibrium, is_of_control, SystemLike
from obc_ros.core.lqr import lqr as regulator
from obc_ros.core.lqr.held_loop import HeldLoop
from obc_ros.core.lqr.held_margins import compute_held_margins
from obc_ros.core.lqr.lqr import LqrDesign
from obc_ros.core.lqr.margins import compute_margins, Figures
from obc_ros.core.lqr.sampled import sampled_lqr
from obc_ros.core.lqr.weights import Weights
from obc_ros.core.numerics.arrays import Array, Complex
from obc_ros.core.riccati.checks import check_matrices
from obc_ros.core.riccati.fixed_horizon import solve_finite_horizon
from obc_ros.core.systems.equilibrium import linearize
from obc_ros.core.text.errors import describe_type, quote, StatementError
from obc_ros.core.text.tables import format_entry, format_html_table, format_table, Tabulated

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
    given: bool = False   # as matrices, whose time may be continuous or discrete


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
        return self.ue - self.K @ (_read_current(x, self.states) - self.xe)

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
    """
    A state feedback u = ue - K(t) (x - xe) for 0 <= t <= T; the cost from t on is x'P(t) x.

    Attributes
    ----------
    t : ndarray, shape (N,)
        Times [s].
    P, K : ndarray, shape (N, n, n), (N, m, n)
        Riccati solution and gain at these times.
    T : float
        Final time [s].
    plant : LinearPlant
        The plant about the set point.
    weights : Weights
        Qx, Qu and the cross term.
    P1 : ndarray, shape (n, n)
        Terminal weight.

    """

    t: Array
    P: Array
    K: Array
    T: float
    plant: LinearPlant
    weights: Weights
    P1: Array

    @property
    def states(self) -> tuple[str, ...]:
        """Return the names of the states, in order."""
        return self.plant.states

    @property
    def inputs(self) -> tuple[str, ...]:
        """Return the names of the inputs, in order."""
        return self.plant.inputs

    @property
    def xe(self) -> Array:
        """Return the set point, shape (n,)."""
        return self.plant.xe

    @property
    def ue(self) -> Array:
        """Return the input at the set point, shape (m,)."""
        return self.plant.ue

    def gain(self, t: float) -> Array:
        """
        Return K(t), shape (m, n), accurate to rounding between the times, too.

        The Riccati equation is solved from the next of the times on. StatementError, a
        ValueError: t is not in [0, T].
        """
        t = as_number(t, 't')
        if not 0.0 <= t <= self.T:
            raise StatementError(f't = {t:g} s: wanted a time from 0 to T = {self.T:g} s')
        k = int(np.searchsorted(self.t, t))
        if k < len(self.t) and self.t[k] == t:
            return np.asarray(self.K[k])
        end, P = (self.T, self.P1) if k == len(self.t) else (float(self.t[k]), self.P[k])
        plant, weights = self.plant, self.weights
        _, K = solve_finite_horizon(plant.A, plant.B, weights.Qx, weights.Qu, P, [t], end,
                                    cross=weights.cross)
        return np.asarray(K[0])

    def __call__(self, t: float, x: StateLike) -> Array:
        """Return the input u = ue - K(t) (x - xe), shape (m,), at a state, for t in [0, T]."""
        return self.ue - self.gain(t) @ (_read_current(x, self.states) - self.xe)

    def plot(self, *, ax: Any = None, show: bool | None = None) -> Any:
        """
        Draw the entries of K and P over time, and show the figure.

        Parameters
        ----------
        ax, show
            As of `Answer.plot`; Axes take the panels of K, then those of P.

        Returns
        -------
        matplotlib.figure.Figure
            The figure; ``savefig`` writes it.

        """
        i, j = np.triu_indices(len(self.states))
        gains = [f'K {u} {x}' for u in self.inputs for x in self.states]
        costs = [f'P {self.states[a]} {self.states[b]}' for a, b in zip(i, j, strict=True)]
        return present(lambda into: draw_columns(
            self.t, {'K': (gains, self.K.reshape(len(self.t), -1)),
                     'P': (costs, self.P[:, i, j])},
            f'Finite horizon, T = {self.T:g} s', {}, into), ax, show)

    def _title(self) -> str:
        return (f'FiniteHorizonDesign: {len(self.states)} states, {len(self.inputs)} inputs; '
                f'T = {self.T:g} s')

    def _rows(self) -> list[tuple[str, str]]:
        """Return the sizes, and the gain at the first and the last time."""
        sizes = [(name, format_entry(getattr(self, name))) for name in ('t', 'P', 'K')]
        return sizes + [(f'K {u} {x} at {self.t[k]:g} s', f'{value:.6g}') for k in (0, -1)
                for u, row in zip(self.inputs, self.K[k], strict=True)
                for x, value in zip(self.states, row, strict=True)]


def _name_arguments(function: Callable[..., Any]) -> Callable[..., Any]:
    """
    Return a design that is called with A, B, ... or with a plant, ..., by position or by name.

    The second argument by position is B after A, but the first weight after a plant. The function
    receives each argument by its own name.
    """
    names = [each.name for each in inspect.signature(function).parameters.values()
             if each.kind is each.POSITIONAL_OR_KEYWORD]

    @wraps(function)
    def design(*given: Any, **named: Any) -> Any:
        return function(**named, **_name_given(function.__name__, names, given, named))
    return design


def _name_given(name: str, names: list[str], given: tuple[Any, ...], named: Mapping[str, Any]
                ) -> dict[str, Any]:
    """
    Return the arguments that are given by position by their names.

    :param names: those of the arguments that have a position, in order: the first, B, others.
    """
    wanted = _say_wanted(names[2:])
    first = given[0] if given else named.get(names[0])
    _, has_matrices = read_first(name, (first, named.get('A'), named.get('system')), wanted)
    if not has_matrices:
        if named.get('B') is not None:
            raise StatementError(f'{name}: B is given beside a plant; {wanted}')
        names = names[:1] + names[2:]
    return name_positions(name, names, given, named, wanted)


def name_positions(name: str, names: list[str], given: tuple[Any, ...], named: Mapping[str, Any],
                   wanted: str) -> dict[str, Any]:
    """Return arguments by position by their names; an error if there is one more, or one twice."""
    more = len(given) - len(names)
    if more > 0:
        said = 'one more argument' if more == 1 else f'{more} more arguments'
        raise StatementError(f'{name}: found {said} than {wanted}')
    at = dict(zip(names, given, strict=False))
    for key in at:
        if key in named:
            raise StatementError(f'{name}: {key} is given twice, by position and by name')
    return at


@overload
def lqr(A: MatrixLike, B: MatrixLike, Qx: WeightLike, Qu: WeightLike, *,
        cross: MatrixLike | None = None, stability: float = 0.0) -> RegulatorDesign: ...


@overload
def lqr(system: SystemLike, Qx: WeightLike, Qu: WeightLike, *, at: StateLike | None = None,
        cross: MatrixLike | None = None, stability: float = 0.0) -> RegulatorDesign: ...


@_name_arguments
def lqr(
        plant_or_A: Any = None, B: Any = None, Qx: Any = None, Qu: Any = None, *,
        A: MatrixLike | None = None, system: SystemLike | None = None,
        at: StateLike | None = None, cross: MatrixLike | None = None, stability: float = 0.0
        ) -> RegulatorDesign:
    """
    Return the gain that minimises the integral of x'Qx x + 2 x'N u + u'Qu u.

    Parameters
    ----------
    plant_or_A, A, system
        The first of ``A, B, Qx, Qu``, or of ``plant, Qx, Qu`` with a plant in any form of
        `equilibrium`, which is linearised at the equilibrium of its set point. As keywords these
        are `A` and `system`.
    B : array_like, shape (n, m)
        Input matrix; only with A.
    Qx, Qu : array_like, mapping or float
        Weights (n, n) >= 0 and (m, m) > 0; or their diagonals, in order or by name, or one number
        for all entries of a diagonal.
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
    plant, Qx, Qu = _read_call('lqr', (plant_or_A, A, system), B, {'Qx': Qx, 'Qu': Qu}, at)
    if plant.period:
        raise StatementError('lqr: the plant is in discrete time; use dlqr')
    stability = as_number(stability, 'stability')
    return _dress(regulator.lqr(plant.A, plant.B, Qx, Qu, cross=cross, stability=stability), plant)


@overload
def dlqr(A: MatrixLike, B: MatrixLike, Qx: WeightLike, Qu: WeightLike, *,
         cross: MatrixLike | None = None, stability: float = 0.0, period: float = 0.0
         ) -> RegulatorDesign: ...


@overload
def dlqr(system: SystemLike, Qx: WeightLike, Qu: WeightLike, *, at: StateLike | None = None,
         cross: MatrixLike | None = None, stability: float = 0.0, period: float = 0.0
         ) -> RegulatorDesign: ...


@_name_arguments
def dlqr(
        plant_or_A: Any = None, B: Any = None, Qx: Any = None, Qu: Any = None, *,
        A: MatrixLike | None = None, system: SystemLike | None = None,
        at: StateLike | None = None, cross: MatrixLike | None = None, stability: float = 0.0,
        period: float = 0.0) -> RegulatorDesign:
    """
    Return the gain of a regulator in discrete time.

    Parameters
    ----------
    plant_or_A, A, system, B, Qx, Qu
        ``A, B, Qx, Qu`` of x+ = A x + B u and the sum of x'Qx x + 2 x'N u + u'Qu u; or ``plant,
        Qx, Qu`` as for `lqr`. A plant in continuous time is sampled with `period`, and the cost is
        the integral of `lqr` with a held input.
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
    plant, Qx, Qu = _read_call('dlqr', (plant_or_A, A, system), B, {'Qx': Qx, 'Qu': Qu}, at)
    period, stability = as_number(period, 'period'), as_number(stability, 'stability')
    if plant.given or plant.period:
        if period and plant.period and period != plant.period:
            raise StatementError(f'dlqr: period {period:g} s, but that of the plant is '
                                 f'{plant.period:g} s')
        return _dress(regulator.dlqr(plant.A, plant.B, Qx, Qu, cross=cross, stability=stability,
                                     period=period or plant.period or 1.0), plant)
    A, B, Qx, Qu, cross = check_matrices(plant.A, plant.B, Qx, Qu, cross)
    found = sampled_lqr(A, B, Weights(Qx, Qu, cross, stability), period)
    return replace(_dress(found, plant), plant=plant)


@overload
def finite_horizon(
        A: MatrixLike, B: MatrixLike, Qx: WeightLike, Qu: WeightLike, P1: WeightLike, T: float, *,
        t: VectorLike | None = None, cross: MatrixLike | None = None) -> FiniteHorizonDesign: ...


@overload
def finite_horizon(
        system: SystemLike, Qx: WeightLike, Qu: WeightLike, P1: WeightLike, T: float, *,
        t: VectorLike | None = None, at: StateLike | None = None, cross: MatrixLike | None = None
        ) -> FiniteHorizonDesign: ...


@_name_arguments
def finite_horizon(
        plant_or_A: Any = None, B: Any = None, Qx: Any = None, Qu: Any = None, P1: Any = None,
        T: Any = None, *, A: MatrixLike | None = None, system: SystemLike | None = None,
        t: VectorLike | None = None, at: StateLike | None = None, cross: MatrixLike | None = None
        ) -> FiniteHorizonDesign:
    """
    Solve the Riccati differential equation backwards from T: the gain for a finite horizon.

    Parameters
    ----------
    plant_or_A, A, system, B, Qx, Qu
        As for `lqr`, in ``A, B, Qx, Qu, P1, T`` or ``plant, Qx, Qu, P1, T``.
    P1 : array_like, mapping or float
        Terminal weight (n, n) >= 0, in the forms of Qx.
    T : float
        Final time [s].
    t : array_like, shape (N,), optional
        Increasing times [s] in [0, T]; default: 201 times from 0 to T.
    at, cross
        As for `lqr`.

    Returns
    -------
    FiniteHorizonDesign
        ``t``, ``P``, ``K`` and ``plot()``; as a function of a time and a state, the input.

    Raises
    ------
    StatementError, DynamicsError, RefusedDesignError
        As `lqr`.

    """
    plant, Qx, Qu, P1, T = _read_call('finite_horizon', (plant_or_A, A, system), B, {
        'Qx': Qx, 'Qu': Qu, 'P1': P1, 'T': T}, at)
    if plant.period:
        raise StatementError('finite_horizon: the plant is in discrete time')
    T = as_duration(T, 'T')
    wanted = f'increasing times from 0 s to T = {T:g} s'
    times = np.linspace(0.0, T, _POINTS) if t is None else as_times(t, wanted)
    if not 0.0 <= times[0] <= times[-1] <= T:
        raise StatementError(f't: wanted {wanted}')
    P, K = solve_finite_horizon(plant.A, plant.B, Qx, Qu, P1, times, T, cross=cross)
    weights = Weights(Qx, Qu, None if cross is None else np.asarray(cross, float))
    return FiniteHorizonDesign(times, P, K, T, plant, weights, np.asarray(P1, float))


def _dress(design: LqrDesign, plant: LinearPlant) -> RegulatorDesign:
    return RegulatorDesign(design, plant.states, plant.inputs, plant.xe, plant.ue)


def _read_current(x: StateLike, states: tuple[str, ...]) -> Array:
    """Return a state; an array of the right shape is not checked, for it comes in each step."""
    if isinstance(x, np.ndarray) and x.shape == (len(states),):
        return x
    return as_state(x, states, 'x')


def _read_call(name: str, first: tuple[Any, Any, Any], B: Any, others: dict[str, Any], at: Any
               ) -> list[Any]:
    """
    Return the plant and the others of a call with A, B, ... or with a plant, ...

    :param first: the first argument by position, `A` and `system`; one of them is given.
    :param others: weights and numbers by name, in order, all of which are wanted.
    """
    wanted = _say_wanted(others)
    given, has_matrices = read_first(name, first, wanted)
    for key, value in {**({'B': B} if has_matrices else {}), **others}.items():
        if value is None:
            raise StatementError(f'{name}: {key} is missing; {wanted}')
    if has_matrices and at is not None:
        raise StatementError(f'{name}: at is the set point of a plant, not of A and B')
    plant = _name_matrices(given, B) if has_matrices else linearize_given(given, at)
    names = {'Qx': plant.states, 'Qu': plant.inputs, 'P1': plant.states}
    return [plant, *(as_weight(value, names[key], key) if key in names else value
                     for key, value in others.items())]


def _say_wanted(others: Iterable[str]) -> str:
    listed = ', '.join(others)
    return f'wanted A, B, {listed} or a plant, {listed}'


def read_first(name: str, first: tuple[Any, Any, Any], wanted: str) -> tuple[Any, bool]:
    """Return the one given of a first argument by position, `A` and `system`; and if it is A."""
    given = [each for each in first if each is not None]
    if len(given) != 1:
        raise StatementError(f'{name}: {wanted}')
    return given[0], first[1] is not None or first[2] is None and is_matrix(first[0])


def is_matrix(value: Any) -> bool:
    """Return whether a first argument is A, not a plant."""
    return not is_of_control(value) and (
        isinstance(value, (list, tuple, int, float)) or hasattr(value, '__array__'))


def _name_matrices(A: Any, B: Any) -> LinearPlant:
    """Return a plant with the names x1, ..., u1, ...; the design checks the matrices."""
    n, m = (each[axis] if len(each := _measure(matrix)) == 2 else 0
            for matrix, axis in ((A, 0), (B, 1)))
    return LinearPlant(A, B, tuple(f'x{k + 1}' for k in range(n)),
                       tuple(f'u{k + 1}' for k in range(m)), np.zeros(n), np.zeros(m), given=True)


def _measure(matrix: Any) -> tuple[int, ...]:
    try:
        return np.shape(matrix)
    except ValueError:   # rows of different lengths
        return ()


def linearize_given(plant: Any, at: Any) -> LinearPlant:
    """Return a plant in any form about its set point, or about `at`."""
    if at is None and is_of_control(plant) and hasattr(plant, 'A'):
        states, inputs = (choose_names(labels, letter) for labels, letter in (
            (plant.state_labels, 'x'), (plant.input_labels, 'u')))
        return LinearPlant(np.array(plant.A), np.array(plant.B), states, inputs,
                           np.zeros(len(states)), np.zeros(len(inputs)),
                           1.0 if plant.dt is True else float(plant.dt or 0.0))
    system = as_system(plant)
    rest = equilibrium(system, at)
    A, B = linearize(system.model, rest.x, rest.u)
    return LinearPlant(A, B, system.states, system.inputs, rest.x, rest.u)
