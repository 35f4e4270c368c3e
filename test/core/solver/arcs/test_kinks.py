# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Kinks: times at which an input in which H is not linear meets or leaves its bound."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.arcs.input_arcs import Arc, find_kinks, place_kinks
from obc_ros.core.solver.solve import solve
import problems
import pytest

FREE = float('nan')
CURVED = np.array([True, False])


def saturated_bryson_denham(limit: float, most: float) -> tuple[float, float, float]:
    """
    Return the kink s, the start of the boundary arc, and J of Bryson-Denham with |u| <= U.

    u = -U until s, then rises linearly to 0 within r = 2 (1 - U s)/U, where x = l and v = 0; the
    second half is its mirror image. J = U^2 s + U^2 r/3.
    """
    # x = l there: s - U s^2/2 + (1 - U s)^2 2/(3 U) = l, a quadratic equation of s.
    roots = np.roots([most / 6, -1 / 3, 2 / (3 * most) - limit])
    s = float(roots.real.min())
    r = 2 * (1 - most * s) / most
    return s, s + r, most**2 * s + most**2 * r / 3


@pytest.mark.slow
@pytest.mark.parametrize(('limit', 'most'), [(0.1, 6.0), (0.12, 5.0)])
def test_a_kink_before_a_boundary_arc_is_where_it_has_to_be(limit, most):
    """The costs of other times near the kink differ in the third order only."""
    s, entry, cost = saturated_bryson_denham(limit, most)
    found = solve(problems.pose(
        {'x': 'v', 'v': 'u'}, 'u**2/2', (0, 1), 1, terminal_constraints=['x', 'v + 1'],
        input_bounds={'u': [-most, None]}, state_bounds={'x': [None, limit]}))
    assert found.status == Status.SOLVED, found.message
    assert found.objective == pytest.approx(cost, rel=1e-6)
    assert found.switching_times == pytest.approx([s, entry, 1 - entry, 1 - s], abs=2e-4)
    inner = found.u[(found.t > s) & (found.t < entry), 0]
    wanted = -most * (entry - found.t[(found.t > s) & (found.t < entry)]) / (entry - s)
    assert inner == pytest.approx(wanted, abs=2e-3 * most)
    assert found.u[found.t < s, 0] == pytest.approx(-most, abs=2e-3 * most)


def test_only_a_change_of_one_curved_input_is_a_kink():
    arcs = [
        Arc(0.0, 1.0, (2.0, 1.0)),
        Arc(1.0, 2.0, (FREE, 1.0)),                              # a kink of the first input
        Arc(2.0, 3.0, (FREE, FREE)),                             # H is linear in the second
        Arc(3.0, 4.0, (2.0, 1.0)),                               # both change
        Arc(4.0, 5.0, (-2.0, 1.0)),                              # a jump
        Arc(5.0, 6.0, (FREE, 1.0), on=(1,)),                     # a contact begins as well
        Arc(6.0, 7.0, (2.0, 1.0), on=(1,)),                      # a kink on a boundary arc
        Arc(7.0, 8.0, (FREE, 1.0), on=(1,), met=(1,)),           # a touch point
        Arc(8.0, 9.0, (2.0, 1.0), on=(1,), jump=True)]           # another input jumps
    assert find_kinks(arcs, CURVED) == [(0, 0), (5, 0)]
    assert find_kinks(arcs, ~CURVED) == [(1, 1)]


@settings(deadline=None, max_examples=50)
@given(st.floats(0.1, 1.9), st.floats(2.1, 3.9), st.floats(-1e3, 1e3).filter(lambda a: abs(a) > 1))
def test_kinks_move_to_the_zeros_of_the_slopes(first, second, size):
    t = np.linspace(0, 5, 777)
    arcs = [Arc(0.0, 1.0, (2.0, 1.0)), Arc(1.0, 3.0, (FREE, 1.0)), Arc(3.0, 5.0, (2.0, 1.0))]
    placed = place_kinks(arcs, find_kinks(arcs, CURVED), t,
                         [size * (t - first), -size * (t - second)])
    assert [arc.end for arc in placed] == pytest.approx([first, second, 5.0], abs=1e-9)
    assert [arc.start for arc in placed[1:]] == [arc.end for arc in placed[:-1]]
    assert [arc.levels for arc in placed] == [arc.levels for arc in arcs]


def test_kinks_stay_without_a_zero_and_in_their_order():
    t = np.linspace(0, 5, 101)
    arcs = [Arc(0.0, 1.0, (2.0, 1.0)), Arc(1.0, 3.0, (FREE, 1.0)), Arc(3.0, 5.0, (2.0, 1.0))]
    kinks = find_kinks(arcs, CURVED)
    assert place_kinks(arcs, kinks, t, [1 + t, 1 + t]) == arcs
    # The zeros are in the other order: there is no such path.
    assert place_kinks(arcs, kinks, t, [t - 2.51, t - 1.49]) == arcs
