# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of solutions: switching functions, panels and files."""

import numpy as np
from obc_ros.api.figures.panels import group_columns
from obc_ros.api.figures.path import compute_slopes, draw_path
from obc_ros.core.ocp.solution import Solution, Status
from obc_ros.core.ocp.statement import build_problem
import pytest

MAPPING = {
    'name': 'scaled', 'states': ['x', 'v', 'theta_1'], 'inputs': ['u', 'w'],
    'dynamics': {'x': 'v', 'v': 'u*x', 'theta_1': '-theta_1 + w'}, 'running_cost': 'u**2 + w',
    'initial_state': {'x': 1000, 'v': 1, 'theta_1': 0}, 'input_bounds': {'w': [-1, 1]},
    'state_bounds': {'x': [900, None]}, 'final_time': {'free': False, 'value': 1}}
PROBLEM = build_problem(MAPPING)
T = np.linspace(0, 1, 11)
X = np.column_stack([1000 + T, 1 + 0 * T, T * 0])
U = np.column_stack([T, 1 - T])
LAM = np.column_stack([1e-4 + 0 * T, T, 0 * T])


def test_the_switching_function_is_the_input_gradient_of_h():
    """dH/du of H = u^2 + w + lam_x v + lam_v u x + lam_theta (w - theta), with lam_theta = 0."""
    expected = np.column_stack([2 * T + T * X[:, 0], 1 + 0 * T])
    np.testing.assert_allclose(compute_slopes(PROBLEM, X, U, LAM)[0], expected)


def test_lines_of_similar_scale_share_a_panel():
    values = np.array([[1e5, 1.0, 2.0, 0.0], [2e5, 3.0, 0.5, 0.0]])
    assert group_columns(values) == [[0, 3], [1, 2]]
    assert group_columns(np.zeros((4, 2))) == [[0, 1]]
    assert group_columns(np.array([[1.0, 0.1, 0.05]])) == [[0, 1, 2]]


@pytest.mark.slow
@pytest.mark.parametrize('lam, panels', [(LAM, 8), (np.zeros((0, 3)), 4)], ids=['costates', ''])
def test_a_figure_is_drawn_with_and_without_costates(lam, panels, tmp_path):
    """X and the others differ in magnitude, and so do lam_x and lam_v."""
    figure = draw_path(PROBLEM, Solution(
        Status.SOLVED, '', 1.0, T, X, U, lam, 1.0 + T, switching_times=np.array([0.5])), 'scaled')
    assert figure.get_suptitle() == 'scaled'
    assert len(figure.axes) == panels - 1
    figure.savefig(tmp_path / 'scaled.png')
    assert (tmp_path / 'scaled.png').read_bytes().startswith(b'\x89PNG')
    assert figure._repr_png_().startswith(b'\x89PNG')
