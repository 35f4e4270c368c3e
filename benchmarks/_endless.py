# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A problem for tests of a server that is busy for minutes."""

from typing import Any


def endless(n: int = 60) -> dict[str, Any]:
    """Return the statement of a problem that no solver has solved within minutes."""
    states = [f'x{i}' for i in range(n)]
    return {
        'name': 'endless', 'states': states, 'inputs': ['u'],
        'dynamics': {f'x{i}': f'20*sin(x{(i + 1) % n})*cos(x{(i - 1) % n}) - x{i}*x{(i + 2) % n}'
                              ' + exp(sin(u))' for i in range(n)},
        'running_cost': 'u**2 + ' + ' + '.join(
            f'(x{i} - 1)**2*x{(i + 3) % n}**2' for i in range(n)),
        'initial_state': {f'x{i}': i % 5 - 2 for i in range(n)},
        'terminal_constraints': ['x1 - 0.5'], 'input_bounds': {'u': [-3, 3]},
        'final_time': {'free': False, 'value': 20}}
