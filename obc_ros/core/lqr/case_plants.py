# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Cases of regulators whose plant stands in a file: in that of the case, or in one that it names.

Without weights, those of Bryson's rule are taken from the bounds of the plant.
"""

from collections.abc import Mapping, Sequence
import math
from pathlib import Path
from typing import Any

from obc_ros.core.systems.file import build_plant, build_system, load_plant, PLANT_KEYS
from obc_ros.core.systems.registry import is_file
from obc_ros.core.systems.system import Signal, System
from obc_ros.core.text.errors import StatementError
from obc_ros.core.text.fields import read_section

CASE_WEIGHTS = ('weights', 'Qx', 'Qu', 'x_max', 'u_max', 'H')
MATRICES = ('A', 'B', 'system')


def take_plant(case: Mapping[Any, Any], folder: Path
               ) -> tuple[dict[str, Any] | None, dict[Any, Any]]:
    """
    Return the plant of a file, as `load_plant`, and the rest of a case, with weights.

    :param folder: that of the case, from which the path of a plant begins.
    :return: None and the case itself if its plant is a registered system or has matrices.
    """
    given = {key: value for key, value in case.items() if value is not None}
    name = given.get('system')
    if isinstance(name, str) and is_file(name):
        plant, rest = load_plant(folder / name), {**given}
        del rest['system']
        system = build_plant(plant, read_section(given, 'parameters'))
    elif 'dynamics' in given:
        for key in MATRICES:
            if key in given:
                raise StatementError(f"{key}: the file has 'dynamics'; give one of the two")
        plant = {key: value for key, value in given.items() if key in PLANT_KEYS and not (
            key.startswith('setpoint') and isinstance(value, list))}
        rest = {key: value for key, value in given.items() if key not in plant or key == 'name'}
        system = build_system(plant)
    else:
        return None, dict(case)
    if not set(CASE_WEIGHTS) & set(rest):
        rest |= _weigh_by_bounds(system)
    return plant, rest


def _weigh_by_bounds(system: System) -> dict[str, list[float]]:
    """Return weights by Bryson's rule: the nearer bound is the acceptable deviation."""
    sides = (('Qx', system.states, system.setpoint), ('Qu', system.inputs, system.setpoint_input))
    found = {key: [_weigh(*each) for each in zip(signals, rest, strict=True)]
             for key, signals, rest in sides}
    if not any(found['Qx']) or not all(found['Qu']) or not all(
            map(math.isfinite, (*found['Qx'], *found['Qu']))):
        lines = ' and '.join(f'{key}: [{", ".join("1" for _ in signals)}]'
                             for key, signals, _ in sides)
        raise StatementError(
            "Qx: missing; Bryson's rule needs bounds around the set point, of each input and of a "
            f'state; or add {lines}')
    return found


def _weigh(signal: Signal, rest: float) -> float:
    """Return the weight of a deviation from rest to the nearer bound; 0 without bounds."""
    deviation = min(signal.upper - rest, rest - signal.lower)
    return 1.0 / deviation**2 if deviation > 0.0 else math.inf


def format_weights(case: Mapping[str, Sequence[float]]) -> str:
    """Return the weights that the bounds of a plant give, as lines of a case."""
    return ', '.join(f'{key}: [{", ".join(f"{weight:g}" for weight in case[key])}]'
                     for key in ('Qx', 'Qu'))
