# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Steady Kalman filters of matrices, systems and python-control's state spaces."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import wraps
from typing import Any, overload

import numpy as np
from obc_ros.api.given import as_number, as_weight, MatrixLike, StateLike, WeightLike
from obc_ros.api.plants import as_system, choose_names, is_of_control, SystemLike
from obc_ros.api.regulators import linearize_given, name_positions, read_first
from obc_ros.core.estimation import kalman_gain
from obc_ros.core.estimation.kalman_gain import KalmanDesign
from obc_ros.core.text.errors import StatementError

_WANTED = ('wanted A, C, Qw, Rv, or A, G, C, QN, RN as in python-control, or a plant, Qw, Rv')


@dataclass(frozen=True, eq=False)
class _Measured:
    """A plant with its outputs and its noise; `given` as matrices."""

    A: Any
    C: Any
    Qw: Any
    Rv: Any
    outputs: tuple[str, ...]
    period: float = 0.0
    given: bool = False


def _name_arguments(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a filter that is called in each form, by position or by name; see `_name_given`."""
    @wraps(function)
    def design(*given: Any, **named: Any) -> Any:
        return function(**named, **_name_given(function.__name__, given, named))
    return design


def _name_given(name: str, given: tuple[Any, ...], named: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments that are given by position by their names."""
    first = given[0] if given else named.get('plant_or_A')
    _, has_matrices = read_first(name, (first, named.get('A'), named.get('system')), _WANTED)
    names = ['plant_or_A', 'Qw', 'Rv']
    if has_matrices:
        names.insert(1, 'C')
        if len(given) == 5 or named.get('RN') is not None:
            names.insert(1, 'G')
    elif named.get('C') is not None:
        raise StatementError(f'{name}: C is given beside a plant; {_WANTED}')
    return name_positions(name, names, given, named, _WANTED)


@overload
def lqe(A: MatrixLike, C: MatrixLike, Qw: WeightLike, Rv: WeightLike, *,
        G: MatrixLike | None = None, outputs: tuple[str, ...] = ()) -> KalmanDesign: ...


@overload
def lqe(A: MatrixLike, G: MatrixLike, C: MatrixLike, QN: WeightLike, RN: WeightLike, /, *,
        outputs: tuple[str, ...] = ()) -> KalmanDesign: ...


@overload
def lqe(system: SystemLike, Qw: WeightLike, Rv: WeightLike, *, G: MatrixLike | None = None,
        at: StateLike | None = None) -> KalmanDesign: ...


@_name_arguments
def lqe(
        plant_or_A: Any = None, C: Any = None, Qw: Any = None, Rv: Any = None, RN: Any = None, *,
        A: MatrixLike | None = None, system: SystemLike | None = None,
        G: MatrixLike | None = None, at: StateLike | None = None, outputs: tuple[str, ...] = ()
        ) -> KalmanDesign:
    """
    Return the steady Kalman filter of dx/dt = A x + G w, y = C x + v.

    Parameters
    ----------
    plant_or_A, A, system
        The first of ``A, C, Qw, Rv``, or of ``plant, Qw, Rv`` with a plant in any form of
        `equilibrium`, which is linearised at its set point and measured by its outputs. As
        keywords these are `A` and `system`.
    C : array_like, shape (q, n)
        Output matrix; only with A.
    Qw, Rv : array_like, mapping or float
        Intensities of the white noise, Qw >= 0 of the process (n, n), Rv > 0 of the measurement
        (q, q); or their diagonals, in order or by name, or one number for all entries of a
        diagonal.
    RN
        The last of five arguments ``A, G, C, QN, RN`` as in python-control.
    G : array_like, shape (n, k), optional
        How k noises, whose intensity is Qw (k, k), drive the states; default: each state has its
        own. For python-control, that of a plant is its B.
    at : array_like, shape (n,), or mapping, optional
        Set point of a plant; default: its own.
    outputs : tuple of str, optional
        Names of the outputs of C, for messages.

    Returns
    -------
    KalmanDesign
        ``L`` = P C'Rv^-1, ``P`` solving A P + P A' - P C'Rv^-1 C P + G Qw G' = 0.

    Raises
    ------
    StatementError, DynamicsError
        If an argument is invalid, or there is no equilibrium at the set point.
    RefusedDesignError
        If Qw or Rv is not definite, (A, C) is not detectable, a mode that does not decay is not
        driven by Qw, or stability cannot be verified. The message names the mode.

    References
    ----------
    R. E. Kalman and R. S. Bucy, New results in linear filtering and prediction theory, 1961.

    """
    found = _read_call('lqe', (plant_or_A, A, system), (C, Qw, Rv, RN), G, at, outputs)
    if found.period:
        raise StatementError('lqe: the plant is in discrete time; use dlqe')
    return kalman_gain.lqe(found.A, found.C, found.Qw, found.Rv, outputs=found.outputs)


@overload
def dlqe(A: MatrixLike, C: MatrixLike, Qw: WeightLike, Rv: WeightLike, *,
         G: MatrixLike | None = None, period: float = 0.0, outputs: tuple[str, ...] = ()
         ) -> KalmanDesign: ...


@overload
def dlqe(A: MatrixLike, G: MatrixLike, C: MatrixLike, QN: WeightLike, RN: WeightLike, /, *,
         period: float = 0.0, outputs: tuple[str, ...] = ()) -> KalmanDesign: ...


@overload
def dlqe(system: SystemLike, Qw: WeightLike, Rv: WeightLike, *, G: MatrixLike | None = None,
         at: StateLike | None = None, period: float = 0.0) -> KalmanDesign: ...


@_name_arguments
def dlqe(
        plant_or_A: Any = None, C: Any = None, Qw: Any = None, Rv: Any = None, RN: Any = None, *,
        A: MatrixLike | None = None, system: SystemLike | None = None,
        G: MatrixLike | None = None, at: StateLike | None = None, period: float = 0.0,
        outputs: tuple[str, ...] = ()) -> KalmanDesign:
    """
    Return the steady Kalman filter of x+ = A x + G w, y = C x + v.

    Parameters
    ----------
    plant_or_A, A, system, C, Qw, Rv, RN, G, at, outputs
        As for `lqe`, with covariances. A plant in continuous time is sampled with `period`; Qw is
        then the intensity of its noise, Rv the covariance of a measurement.
    period : float
        Sampling period [s]; 1 for matrices if it is left out.

    Returns
    -------
    KalmanDesign
        ``M`` = P C'(C P C' + Rv)^-1, ``L`` = A M, ``P`` = A P_filtered A' + G Qw G'.

    Raises
    ------
    StatementError, DynamicsError, RefusedDesignError
        As `lqe`.

    """
    found = _read_call('dlqe', (plant_or_A, A, system), (C, Qw, Rv, RN), G, at, outputs)
    period = as_number(period, 'period')
    matrices = found.A, found.C, found.Qw, found.Rv
    if not found.given and not found.period:
        return kalman_gain.sampled_lqe(*matrices, period, outputs=found.outputs)
    if period and found.period and period != found.period:
        raise StatementError(f'dlqe: period {period:g} s, but that of the plant is '
                             f'{found.period:g} s')
    return kalman_gain.dlqe(*matrices, period=period or found.period or 1.0,
                            outputs=found.outputs)


def _read_call(name: str, first: tuple[Any, Any, Any], others: tuple[Any, ...], G: Any, at: Any,
               outputs: tuple[str, ...]) -> _Measured:
    """Return what `lqe` and `dlqe` are called with; `others` are C, Qw, Rv and RN."""
    given, has_matrices = read_first(name, first, _WANTED)
    C, Qw, *last = others
    Rv, *more = [each for each in last if each is not None] or [None]
    if more or Qw is None or Rv is None or has_matrices and C is None:
        raise StatementError(f'{name}: {_WANTED}')
    if has_matrices:
        if at is not None:
            raise StatementError(f'{name}: at is the set point of a plant, not of A and C')
        n, q = (len(each) if np.ndim(each) == 2 else 0 for each in (given, C))
        plant = _Measured(given, C, None, None, outputs, given=True)
        names = tuple(f'x{k + 1}' for k in range(n)), tuple(f'y{k}' for k in range(q))
    else:
        plant, names = _measure(given, at)
    if G is None:
        Qw = as_weight(Qw, names[0], 'Qw')
    else:
        G = np.atleast_2d(np.asarray(G, dtype=np.float64))
        Qw = G @ as_weight(Qw, tuple(f'w{k + 1}' for k in range(G.shape[1])), 'QN') @ G.T
    return _Measured(plant.A, plant.C, Qw, as_weight(Rv, outputs or names[1], 'Rv'),
                     plant.outputs, plant.period, plant.given)


def _measure(plant: Any, at: Any) -> tuple[_Measured, tuple[tuple[str, ...], tuple[str, ...]]]:
    """Return the matrices of a plant and of its outputs, and the names of states and outputs."""
    linear = linearize_given(plant, at)
    if is_of_control(plant) and hasattr(plant, 'C'):
        C, outputs = np.array(plant.C), choose_names(plant.output_labels, 'y')
    else:
        model = as_system(plant).model
        C, outputs = model.measure(linear.xe, linear.ue)[1], model.output_names
    return (_Measured(linear.A, C, None, None, outputs, linear.period),
            (linear.states, outputs))
