# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Values as users give them: states, inputs, weights and numbers, by name or in order."""

from collections.abc import Callable, Collection, Mapping, Sequence
import math
from numbers import Real
from typing import Any, TypedDict

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.api.answer import PathPoint
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems.equilibrium import Equilibrium
from obc_ros.core.text.errors import describe_type, quote, StatementError, suggest_name

NAMED_AT_MOST = 60   # characters of a list of names in a text

MatrixLike = Sequence[Sequence[float]] | NDArray[Any]
VectorLike = Sequence[float] | NDArray[Any]
StateLike = VectorLike | Mapping[str, Any] | PathPoint | Equilibrium   # in order or by name
WeightLike = float | VectorLike | MatrixLike | Mapping[str, float]   # or the diagonal

Expression = str | float | ca.SX           # also a number
Expressions = Sequence[Expression]
# Of named symbols; checkers take the types of a lambda's arguments from the first form that fits.
StatedFunction = (Callable[[Any], Any] | Callable[[Any, Any], Any] | Callable[[Any, Any, Any], Any]
                  | Callable[[Any, Any, Any, Any], Any] | Callable[..., Any])


class _Unset:
    """The default of a keyword that may be None."""

    def __repr__(self) -> str:
        """Return a word for signatures."""
        return 'unset'


UNSET: Any = _Unset()


class KeysForPeople(TypedDict, total=False):
    """Keys that say what a problem or a system is; nothing is computed from them."""

    title: str
    source: str
    tags: Sequence[str]
    notes: str
    difficulty: Any
    kind: str
    expected: Any


class KeysOfPlant(KeysForPeople, total=False):
    """Keys of a system file that a problem does not need, so that one file can be both."""

    units: Mapping[str, str]
    angles: Sequence[str]
    setpoint: Mapping[str, Any]
    setpoint_input: Mapping[str, Any]
    parameter_bounds: Mapping[str, Any]
    plane: str
    description: str
    outputs: Mapping[str, Expression]
    ros: Mapping[str, Mapping[str, Any]]


class KeysOfTask(KeysForPeople, total=False):
    """Keys of a problem file that a system does not need."""

    running_cost: Any
    terminal_cost: Any
    initial_cost: Any
    initial_state: Any
    initial_constraints: Any
    terminal_constraints: Any
    boundary_constraints: Any
    periodic: Sequence[str]
    path_constraints: Any
    final_time: Mapping[str, Any] | Expression
    tables: Mapping[str, Any]
    initial_guess: Mapping[str, Any]
    starts: Sequence[Mapping[str, Any]]
    method: str
    accept: str


def choose_given(values: Mapping[str, Any], keys: Collection[str]) -> dict[str, Any]:
    """Return those of some keywords that were given."""
    return {key: values[key] for key in keys if values[key] is not UNSET}


def as_state(value: object, names: Sequence[str], where: str) -> Array:
    """
    Return a finite number for each name as an array.

    :param value: a list or an array in the order of the names, a mapping by name, or a point with
        states: of `Answer.at`, or of `equilibrium`.
    :param where: what it is, for messages.
    """
    return _as_numbers(value.x if isinstance(value, PathPoint | Equilibrium) else value, names,
                       where)


def as_input(value: object, names: Sequence[str], where: str) -> Array:
    """Return numbers as `as_state` does; of a point, its inputs."""
    return _as_numbers(value.u if isinstance(value, PathPoint | Equilibrium) else value, names,
                       where)


def _as_numbers(value: Any, names: Sequence[str], where: str) -> Array:
    found, given = '', value
    if isinstance(value, Mapping):
        for name in value:
            if name not in names:
                found = f"'{quote(str(name))}'{suggest_name(str(name), names)}"
        found = found or next((f"nothing for '{name}'" for name in names if name not in value), '')
        given = [value.get(name) for name in names]
    try:
        numbers = as_floats(given)
    except (TypeError, ValueError):
        found, numbers = found or _describe(value), np.zeros(0)
    if found or numbers.shape != (len(names),) or given is None:
        known = names[:9]
        raise StatementError(
            f'{where}: wanted numbers for {quote(", ".join(names), NAMED_AT_MOST)}, such as '
            f'[{", ".join("0" for _ in known)}] or {{{", ".join(f"{name}: 0" for name in known)}}}'
            f'; found {found or _describe(value)}')
    for name, number in zip(names, numbers, strict=True):
        if not np.isfinite(number):
            raise StatementError(f'{where}: {name} = {number}: wanted a finite number')
    return numbers


def _describe(value: object) -> str:
    if isinstance(value, np.ndarray) and value.ndim != 1:
        return f'an array of shape {value.shape}'
    return describe_type(value.tolist() if isinstance(value, np.ndarray) else value)


def as_floats(value: Any) -> Array:
    """Return numbers as an array; TypeError for texts, which NumPy takes for numbers."""
    found = np.asarray(value)
    if found.dtype.kind in 'US' or found.dtype == object and any(
            isinstance(each, str) for each in found.flat):
        raise TypeError('a text is no number')
    return found.astype(np.float64)


def read_floats(value: Any, where: str, wanted: str = 'numbers') -> Array:
    """Return numbers as an array; an error begins with `where`."""
    try:
        return as_floats(value)
    except (TypeError, ValueError):
        raise StatementError(f'{where}: wanted {wanted}, found {_describe(value)}') from None


def as_weight(value: Any, names: Sequence[str], where: str) -> Any:
    """
    Return a weight as a matrix, which the design checks; StatementError for what has no numbers.

    :param value: a matrix; numbers in the order of the names or by name, the diagonal; or one
        number for all of them.
    :param names: may be empty, for a matrix or its diagonal.
    """
    if isinstance(value, Mapping):
        return np.diag(_as_numbers(value, names, where))
    found = read_floats(value, where, 'a matrix, its diagonal or one number')
    if found.ndim == 0:
        return found * np.eye(max(len(names), 1))
    return np.diag(found) if found.ndim == 1 else found


def as_number(value: Any, where: str, wanted: str = 'a number') -> float:
    """Return a real number of Python or NumPy; an error begins with `where`."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, bool) or not isinstance(value, Real):
        raise StatementError(f'{where}: wanted {wanted}, found {describe_type(value)}')
    try:
        return float(value)
    except OverflowError:   # an integer of hundreds of digits
        return math.inf


def as_duration(value: Any, where: str) -> float:
    """Return a positive and finite number [s]."""
    wanted = 'a positive number of seconds'
    seconds = as_number(value, where, wanted)
    if not 0.0 < seconds < math.inf:
        raise StatementError(f'{where}: wanted {wanted}, found {describe_type(value)}')
    return seconds


def as_times(value: Any, wanted: str) -> Array:
    """Return finite, increasing times (N,); an error says what is `wanted`."""
    try:
        given = np.asarray(value)
        times = given.astype(np.float64) if given.dtype.kind in 'fiuO' else np.zeros(0)
    except (TypeError, ValueError):
        times = np.zeros(0)
    if times.ndim != 1 or not times.size or not np.isfinite(times).all() or (
            np.diff(times) <= 0.0).any():
        raise StatementError(f't: wanted {wanted}')
    return times


def convert_numbers(value: Any) -> Any:
    """Return a statement with lists and numbers of Python in place of those of NumPy."""
    if isinstance(value, Mapping):
        return {key: convert_numbers(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [convert_numbers(each) for each in value]
    if isinstance(value, np.ndarray):
        return convert_numbers(value.tolist())
    return value.item() if isinstance(value, np.generic) else value
