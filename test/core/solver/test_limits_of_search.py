# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What docs/solver.md says that the search does not do: it refuses."""

from obc_ros.core.ocp.solution import Condition
from obc_ros.core.solver.solve import solve
import problems
import pytest


@pytest.mark.slow
def test_an_input_that_should_jump_between_minima_of_h_is_not_certified() -> None:
    """Each gear is a peak of the acceleration. A path in one gear does not minimise H."""
    found = solve(problems.pose(
        {'x': 'v', 'v': '(1 - v)*exp(-8*(u - 1)**2) + 0.4*exp(-8*(u - 3)**2) - 0.02*v'},
        '0', (0, 0), 5, terminal_cost='-x', input_bounds={'u': [0, 4]}), time_limit=600.0)
    assert not found.certified
    assert found.certificate is not None and found.certificate.worst in (
        Condition.MINIMUM, Condition.HAMILTONIAN)
