# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Build the optimal control problems of tests, from obc_ros/examples or from statements."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.statement import build_problem, load_file

FOLDER = Path(__file__).parents[1] / 'obc_ros' / 'examples'
NAMES = sorted(path.stem for path in FOLDER.glob('*.yaml'))

# From rest at 0 to rest at 1 in T = 3. Without a bound on u the minimum time is 0.
DOUBLE_INTEGRATOR = {
    'states': ['x', 'v'], 'inputs': ['u'], 'dynamics': {'x': 'v', 'v': 'u'},
    'running_cost': 'u**2', 'initial_state': {'x': 0, 'v': 0},
    'terminal_constraints': ['x - 1', 'v'], 'final_time': {'free': False, 'value': 3}}


def read(name: str, **changes: Any) -> dict[str, Any]:
    """Return the statement in ``obc_ros/examples/<name>.yaml``, some of its keys replaced."""
    [statement] = load_file(FOLDER / f'{name}.yaml')
    return statement | changes


def build(statement: str | Mapping[str, Any], **changes: Any) -> Problem:
    """Build the problem of a statement, or of the file with that name, some keys replaced."""
    if isinstance(statement, str):
        return build_problem(read(statement, **changes))
    return build_problem({**statement, **changes})


def pose(
    dynamics: Mapping[str, str],
    running_cost: str | float,
    initial_state: Sequence[float],
    final_time: float | Mapping[str, Any],
    *,
    inputs: Sequence[str] = ('u',),
    **more: Any,
) -> Problem:
    """
    Build a problem from its essentials.

    Parameters
    ----------
    dynamics : mapping
        The derivative of each state, in the order of the states.
    running_cost : str or float
        L.
    initial_state : sequence of float
        x(0), in the same order.
    final_time : float or mapping
        A number fixes it [s].
    inputs : sequence of str
        Their names.
    more
        Other keys of the statement.

    """
    return build_problem({
        'states': list(dynamics), 'inputs': list(inputs), 'dynamics': dict(dynamics),
        'running_cost': running_cost,
        'initial_state': dict(zip(dynamics, initial_state, strict=True)),
        'final_time': final_time if isinstance(final_time, Mapping)
        else {'free': False, 'value': final_time}, **more})
