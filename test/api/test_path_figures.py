# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of paths: the plane with obstacles, units, marks, bounds, panels that are left out."""

from math import pi

import numpy as np
from obc_ros.api.figures.marks import find_marks, find_state_rows
from obc_ros.api.figures.panels import MOST_LINES, place_panels, split_columns
from obc_ros.api.figures.path import draw_path
from obc_ros.api.figures.plane import find_plane
from obc_ros.core.ocp.solution import Solution, Status
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.text.errors import StatementError
import pytest

DISC = {
    'name': 'disc', 'states': ['s', 'x', 'y'], 'inputs': ['u', 'w'],
    'units': {'x': 'm', 'y': 'm', 'u': 'm/s'},
    'dynamics': {'s': 'u', 'x': 'u', 'y': 'w'}, 'running_cost': 'u**2 + w**2',
    'initial_state': {'s': 0, 'x': -2, 'y': 0}, 'terminal_constraints': ['x - 2', 'y'],
    'path_constraints': [{'expr': 'x**2 + y**2', 'lower': 1}, {'expr': 'u + x', 'upper': 9},
                         {'expr': 'x', 'upper': 3}],
    'final_time': {'free': False, 'value': 4}}


def walk_around_the_disc():
    """Return a path along two tangents and an arc of the unit circle, with time in duplicate."""
    angles = np.linspace(5 * pi / 6, pi / 6, 21)   # of the arc between the tangents from (-2, 0)
    points = np.vstack([np.linspace([-2, 0], [np.cos(angles[0]), np.sin(angles[0])], 9)[:-1],
                        np.column_stack([np.cos(angles), np.sin(angles)]),
                        np.linspace([np.cos(angles[-1]), np.sin(angles[-1])], [2, 0], 9)[1:]])
    t = np.linspace(0, 4, len(points))
    return t, np.column_stack([0 * t, points])


def solve_disc(problem, lam=None, u=None):
    t, x = walk_around_the_disc()
    return Solution(Status.SOLVED, '', 1.0, t, x, np.ones((len(t), 2)) if u is None else u,
                    np.zeros((0, 3)) if lam is None else lam, 0 * t)


def test_the_plane_is_that_of_the_constraint_on_two_states():
    plane = find_plane(build_problem(DISC))
    assert plane is not None
    assert plane.states == (1, 2)
    assert plane.rows == (0, 2)   # that with an input is not drawn
    assert plane.equal


@pytest.mark.parametrize('change, states, equal', [
    ({'path_constraints': []}, (1, 2), True),   # by their names
    ({'path_constraints': [{'expr': 's*y', 'upper': 1}]}, (0, 2), False),   # one has no unit
    ({'path_constraints': [], 'states': ['s', 'a', 'b'], 'units': {},
      'dynamics': {'s': 'u', 'a': 'u', 'b': 'w'}, 'terminal_constraints': [],
      'initial_state': {'s': 0, 'a': 0, 'b': 0}}, None, False)])
def test_other_planes(change, states, equal):
    plane = find_plane(build_problem(DISC | change))
    assert (plane and plane.states) == states
    assert bool(plane and plane.equal) == equal


def test_a_state_and_its_rate_have_no_common_scale():
    plane = find_plane(build_problem({
        'states': ['p', 'v'], 'inputs': ['u'], 'dynamics': {'p': 'v', 'v': 'u'},
        'initial_state': {'p': 0, 'v': 0}, 'final_time': {'free': False, 'value': 1},
        'path_constraints': [{'expr': 'p + v', 'upper': 1}]}))
    assert plane is not None
    assert not plane.equal


def test_constraints_with_time_or_inputs_are_not_on_states_alone():
    problem = build_problem(DISC | {'path_constraints': [
        {'expr': 'x + t', 'upper': 9}, {'expr': 'x*y', 'upper': 9}, {'expr': 'w', 'upper': 9}]})
    assert find_state_rows(problem) == {1: (1, 2)}


def test_the_contact_with_the_disc_is_the_arc():
    problem = build_problem(DISC)
    solution = solve_disc(problem)
    [(begin, end)] = find_marks(problem, solution).contacts
    assert (begin, end) == (solution.t[8], solution.t[28])


def test_costates_jump_only_at_contacts():
    """Duplicate times: one on the arc, one elsewhere; both have a jump of lambda_x."""
    problem, solution = build_problem(DISC), None
    t, x = walk_around_the_disc()
    order = np.sort(np.append(np.arange(len(t)), [3, 15]))
    lam = np.ones((len(order), 3))
    lam[4:, 1] += 1.0
    lam[17:, 1] += 1.0
    solution = Solution(Status.SOLVED, '', 1.0, t[order], x[order], np.ones((len(order), 2)), lam,
                        0 * t[order])
    assert find_marks(problem, solution).jumps == (t[15],)


@pytest.mark.slow
def test_the_figure_has_plane_units_and_marks():
    problem = build_problem(DISC)
    figure = draw_path(problem, solve_disc(problem), 'disc')
    plane, *panels = figure.axes
    assert (plane.get_xlabel(), plane.get_ylabel()) == ('$x$ [m]', '$y$ [m]')
    assert plane.get_aspect() == 1.0
    names = [text.get_text() for text in plane.get_legend().get_texts()]
    assert names == ['forbidden', 'path', 'on a state\nconstraint', 'start', 'end']
    left, right = plane.get_xlim()
    assert left < -2 and 2 < right <= 3.0 + 1.0
    assert {'states [m]', 'inputs [m/s]'} <= {axes.get_ylabel() for axes in panels}
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ['on a state constraint']


@pytest.mark.slow
def test_the_forbidden_region_is_the_disc():
    """The border of the shaded region is on the unit circle or on the wall x = 3."""
    problem = build_problem(DISC)
    plane = draw_path(problem, solve_disc(problem), 'disc').axes[0]
    border = np.vstack([path.vertices for collection in plane.collections
                        if collection.get_zorder() == 1.2 for path in collection.get_paths()])
    off = np.minimum(np.abs(np.hypot(*border.T) - 1), np.abs(border[:, 0] - 3))
    assert len(border) > 100
    assert off.max() < 0.01


@pytest.mark.slow
def test_panels_that_are_zero_are_left_out_and_named():
    """H = u^2 + w^2 + lam u with u = -lam/2, w = 0 and lam = 0 throughout."""
    problem = build_problem(DISC)
    t, _ = walk_around_the_disc()
    lam = np.zeros((len(t), 3))
    zero = draw_path(problem, solve_disc(problem, lam, np.zeros((len(t), 2))), 'disc')
    assert zero.get_suptitle().endswith(r'$\partial H/\partial u = 0$ and $H = 0$ throughout')
    assert not {'Hamiltonian', 'switching\nfunctions'} & {a.get_ylabel() for a in zero.axes}
    other = draw_path(problem, solve_disc(problem, lam), 'disc')   # dH/du = 2 u
    assert other.get_suptitle() == 'disc\n$H = 0$ throughout'
    assert 'switching\nfunctions' in {axes.get_ylabel() for axes in other.axes}


@pytest.mark.slow
def test_bounds_have_the_colour_and_the_name_of_their_quantity():
    problem = build_problem(DISC | {'input_bounds': {'u': [0, 1], 'w': [None, 2]}, 'units': {}})
    t, _ = walk_around_the_disc()
    u = np.column_stack([np.linspace(0, 1, len(t)), np.linspace(0, 2, len(t))])
    figure = draw_path(problem, solve_disc(problem, u=u), 'disc')
    [panel] = [axes for axes in figure.axes if axes.get_ylabel() == 'inputs']
    lines = {line.get_label(): line.get_color() for line in panel.lines}
    texts = {text.get_text(): text.get_color() for text in panel.texts}
    assert texts == {r'$u \geq 0$': lines['$u$'], r'$u \leq 1$': lines['$u$'],
                     r'$w \leq 2$': lines['$w$']}
    assert lines['$u$'] != lines['$w$']


def test_many_states_are_split_by_unit_magnitude_and_number():
    names = [f'x{k}' for k in range(9)] + ['angle', 'far']
    values = np.ones((5, 11))
    values[:, 10] = 1e6
    groups = split_columns(names, values, {'angle': 'rad'})
    assert sorted(k for group in groups for k in group) == list(range(11))
    assert [9] in groups and [10] in groups
    assert max(map(len, groups)) <= MOST_LINES


def test_units_of_a_system_are_known_and_those_of_the_statement_go_first():
    problem = build_problem({
        'system': 'vehicle', 'units': {'px': 'km'}, 'initial_state': dict.fromkeys(
            ('px', 'py', 'theta'), 0), 'final_time': {'free': False, 'value': 1}})
    assert (problem.units['px'], problem.units['py']) == ('km', 'm')


@pytest.mark.parametrize('units, words', [
    ({'x': 3}, r'units\.x: wanted a short text such as m/s, found'),
    ({'x': 'm' * 41}, 'wanted a short text'), (['m'], 'units: wanted a mapping')])
def test_malformed_units_are_answered_in_words(units, words):
    with pytest.raises(StatementError, match=words):
        build_problem(DISC | {'units': units})


@pytest.mark.parametrize('count', [5, 7])
def test_unequal_columns_of_panels_end_at_the_same_heights(count):
    figure, axes, _ = place_panels(count)
    figure.draw_without_rendering()
    boxes = [each.get_position() for each in axes]
    left, right = boxes[:(count + 1) // 2], boxes[(count + 1) // 2:]
    assert len(right) == len(left) - 1
    for column in (left, right):
        assert column[0].y1 == pytest.approx(left[0].y1, abs=1e-3)
        assert column[-1].y0 == pytest.approx(left[-1].y0, abs=1e-3)
        heights = [each.height for each in column]
        assert heights == pytest.approx([heights[0]] * len(column), rel=0.02)
