# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The result of a sweep as an `xarray.Dataset`, and its NetCDF file.

The file has the classic format (NetCDF 3, 64-bit offsets), which SciPy writes: any tool reads it,
it needs no HDF5, and equal data give equal bytes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.text.errors import ObcError
from obc_ros.sweep.axes import SAMPLE

STATUSES = ('solved', 'infeasible', 'not_converged', 'timed_out', 'cancelled', 'malformed', 'died',
            'feasible')
WITH_ANSWER = 'solved', 'feasible'   # the latter only if the problem accepts it
NOT_SOLVED_YET = -1
OPTIMUM_NAMES = ('unknown', 'local', 'global')


@dataclass(frozen=True)
class Quantity:
    """
    A quantity of the answer at each point.

    :ivar name: in the dataset and in the rows.
    :ivar about: long name, in words.
    :ivar unit: empty if it is unknown.
    :ivar dimension: name of a further dimension, for a list; empty for a number.
    :ivar flags: meanings of the values 0, 1, ... of a code.
    """

    name: str
    about: str
    unit: str = ''
    dimension: str = ''
    flags: tuple[str, ...] = ()


PROBLEM_QUANTITIES = (
    Quantity('status', 'how the request ended', flags=STATUSES),
    Quantity('J', 'cost'),
    Quantity('T', 'final time', 's'),
    Quantity('switching_times', 'times at which an input jumps or changes its arc; nan after the '
             'last', 's', 'switch'),
    Quantity('costates', 'costates at t = 0', dimension='state'),
    Quantity('inputs', 'inputs at t = 0', dimension='input'),
    Quantity('worst_residual', 'largest residual of the certificate relative to its tolerance',
             '1'),
    Quantity('optimum', 'what is known of the optimum', flags=OPTIMUM_NAMES),
    Quantity('time', 'time to build and solve the problem', 's'))

LOOP_STATUSES = ('solved', 'refused', 'timed_out', 'cancelled', 'malformed', 'died')
REGULATOR_QUANTITIES = (
    Quantity('status', 'how the request ended', flags=LOOP_STATUSES),
    Quantity('J', 'cost of the simulated loop; infinite if it leaves every bound'),
    Quantity('optimal_cost', "x0'P x0, the cost of the designed loop without limits"),
    Quantity('duration', 'simulated time', 's'),
    Quantity('decay', 'distance of the slowest pole of the loop with this plant to the left of '
             'the imaginary axis; negative: unstable', '1/s'),
    Quantity('settled', 'whether the error at the end is below 1 % of the first', flags=(
        'no', 'yes')),
    Quantity('final_error', 'norm of the error at the end'),
    Quantity('overshoot', 'largest error beyond the set point relative to the first', '1',
             'state'),
    Quantity('peak', 'largest deviation of the input', dimension='input'),
    Quantity('gain', 'gain K, row by row', dimension='entry'),
    Quantity('time', 'time to design and simulate', 's'))


def import_xarray() -> Any:
    """Return the module xarray, which is an extra; ObcError: it is not installed."""
    try:
        import xarray
    except ImportError as error:
        raise ObcError(f'a sweep needs xarray: pip install xarray ({error})') from None
    return xarray


def make_dataset(coordinates: Mapping[str, Sequence[float]], units: Mapping[str, str],
                 other_keys: Mapping[str, str],
                 samples: Mapping[str, Sequence[float]], count: int,
                 names: Mapping[str, Sequence[str]], quantities: Sequence[Quantity],
                 rows: Mapping[int, Mapping[str, Any]], about: Mapping[str, Any]) -> Any:
    """
    Return the dataset of a sweep.

    :param units: unit of each key; empty if it is unknown.
    :param other_keys: another name of each key, if a quantity has its name.
    :param count: number of samples; 0 without random numbers.
    :param names: coordinates of further dimensions: names of states and inputs.
    :param rows: the answers by flat index of the point; points may be missing.
    :return: points without an answer have the status -1, and nan.
    :raises ObcError: if xarray is not installed.
    """
    xarray = import_xarray()
    taken = {each.name for each in quantities} | set(names) | {SAMPLE, 'switch', 'switches'}
    keys = {key: other_keys[key] if key in taken else key for key in (*coordinates, *samples)}
    dimensions = tuple(keys[key] for key in coordinates) + ((SAMPLE,) if samples else ())
    shape = tuple(len(values) for values in coordinates.values()) + (
        (count,) if samples else ())
    found: dict[str, Any] = {}
    for each in quantities:
        if each.dimension:
            width = len(names[each.dimension]) if each.dimension in names else max(
                (len(row.get(each.name, ())) for row in rows.values()), default=0) or 1
            data = _fill_lists(each.name, rows, math.prod(shape), width).reshape(*shape, width)
            found[each.name] = (*dimensions, each.dimension), data, _attributes(each)
        else:
            found[each.name] = (dimensions, _fill(each, rows, math.prod(shape)).reshape(shape),
                                _attributes(each))
        if each.dimension == 'switch':
            found['switches'] = dimensions, np.isfinite(data).sum(axis=-1).astype(np.int32), {
                'long_name': 'number of switching times'}
    coordinate = {keys[key]: (keys[key], np.array(values), _unit(units.get(key, '')))
                  for key, values in coordinates.items()}
    coordinate |= {keys[key]: (SAMPLE, np.array(values), _unit(units.get(key, '')))
                   for key, values in samples.items()}
    coordinate |= {name: (name, np.array(entries, 'U'), {}) for name, entries in names.items()}
    return xarray.Dataset(found, coordinate, dict(about))


def write_dataset(dataset: Any, path: Path) -> None:
    """Write a dataset completely or not at all."""
    part = path.with_suffix('.part')
    dataset.to_netcdf(part, engine='scipy', format='NETCDF3_64BIT')
    with open(part, 'rb') as file:
        os.fsync(file.fileno())
    part.replace(path)


def read_dataset(path: Path) -> Any:
    """Return the dataset of a file, completely in memory."""
    return import_xarray().load_dataset(path, engine='scipy')


def _fill(quantity: Quantity, rows: Mapping[int, Mapping[str, Any]], size: int) -> NDArray[Any]:
    """Return one value for each point; codes are small integers."""
    name, flags = quantity.name, quantity.flags
    values = np.full(size, NOT_SOLVED_YET if name == 'status' else 0, np.int8) if flags else (
        np.full(size, np.nan))
    for index, row in rows.items():
        value = row.get(name, 0 if flags else np.nan)
        values[index] = flags.index(value) if flags and isinstance(value, str) else value
    return values


def _fill_lists(name: str, rows: Mapping[int, Mapping[str, Any]], size: int,
                width: int) -> NDArray[Any]:
    numbers = np.full((size, width), np.nan)
    for index, row in rows.items():
        values = row.get(name, ())
        numbers[index, :len(values)] = values
    return numbers


def _attributes(quantity: Quantity) -> dict[str, Any]:
    found: dict[str, Any] = {'long_name': quantity.about, **_unit(quantity.unit)}
    if quantity.flags:
        found['flag_values'] = np.arange(len(quantity.flags), dtype=np.int8)
        found['flag_meanings'] = ' '.join(quantity.flags)
    return found


def _unit(unit: str) -> dict[str, str]:
    return {'units': unit} if unit else {}
