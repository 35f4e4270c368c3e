# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Free final times with several local minima: the global one is found."""

import numpy as np
from obc_ros.core.solver.solve import solve
import problems
import pytest


def minimum_over_final_times(x, v, end, rate):
    """
    Return the minimum of rate T + integral of u^2, and T, for x'' = -x + u to rest at `end`.

    For each T the integral is d' W^-1 d, where d is the difference of the end and of the free
    motion's end, and W is the Gramian; both have closed forms.
    """
    T = np.linspace(0.5, 30, 60_000)
    s, c = np.sin(T), np.cos(T)
    d = np.stack([end - (c * x + s * v), s * x - c * v], axis=-1)
    W = np.empty((len(T), 2, 2))
    W[:, 0, 0], W[:, 1, 1] = (T - s * c) / 2, (T + s * c) / 2
    W[:, 0, 1] = W[:, 1, 0] = s**2 / 2
    J = rate * T + np.einsum('ki,ki->k', d, np.linalg.solve(W, d[..., None])[..., 0])
    return J.min(), T[np.argmin(J)]


@pytest.mark.parametrize(('x', 'v', 'end', 'rate'), [
    (1.0, 0.5, 1.2, 0.045), (1.5, -0.5, 0.5, 0.01), (2.0, 0.0, -1.0, 0.02)])
def test_the_best_of_several_final_times_is_found(x, v, end, rate):
    answer = solve(problems.pose(
        {'x': 'v', 'v': '-x + u'}, f'{rate} + u**2', (x, v),
        {'free': True, 'lower': 0.5, 'upper': 30, 'guess': 3},
        terminal_constraints=[f'x - {end}', 'v']))
    J, T = minimum_over_final_times(x, v, end, rate)
    assert answer.status.name == 'SOLVED'
    assert answer.objective == pytest.approx(J, rel=1e-5)
    assert answer.t[-1] == pytest.approx(T, rel=1e-2)
