# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Arcs detected on a path."""

from math import nan

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.solver.arcs.input_arcs import Arc, find_arcs, free_shared_inputs
from obc_ros.core.solver.transcription.mesh import build_path
import problems
import pytest


@given(zero=st.floats(0.3, 0.7), slope=st.floats(1e-4, 10.0))
def test_one_input_of_an_equality_is_free_however_near_all_are_to_their_bounds(zero, slope):
    """With p, q >= 0 and q - p = slope*(t - zero), p is free before the zero, q after it."""
    problem = problems.pose(
        {'y': '1'}, 'p**2 + q**2', (0,), {'free': False, 'value': 1}, inputs=['p', 'q'],
        input_bounds={'p': [0, 10], 'q': [0, 10]},
        path_constraints=[{'expr': f'q - p - {slope}*(y - {zero})', 'lower': 0, 'upper': 0}])
    t = np.linspace(0, 1, 41)
    value = slope * (t - zero)
    u = np.column_stack([np.maximum(-value, 0), np.maximum(value, 0)])
    path = build_path(t, t[:, None], u[:-1], u[1:])
    arcs = find_arcs(problem, path, (True, True))
    for arc in arcs:
        if arc.end - arc.start > 2 / 40:   # of a shorter one both may be free
            middle = (arc.start + arc.end) / 2
            assert np.isnan(arc.levels).tolist() == [middle < zero, middle > zero]


@pytest.mark.parametrize(('levels', 'wanted'), [
    ((-1.0, 0.0, 0.0), (-1.0, nan, nan)), ((1.0, nan, 0.0), (1.0, nan, 0.0)),
    ((nan, 0.0, 2.0), (nan, nan, nan))])
def test_an_equality_keeps_a_free_input(levels, wanted):
    shared = np.array([[False, True, True]])
    [arc] = free_shared_inputs([Arc(0.0, 1.0, levels)], shared)
    np.testing.assert_array_equal(arc.levels, wanted)
