# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Reeds-Shepp paths: end poses, minimality of the length, and the HJB equation."""

from itertools import product
from math import acos, asin, cos, hypot, pi, remainder, sin, sqrt

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.book.extremals import find_least_times
from obc_ros.core.systems.reeds_shepp import find_shortest_path
from obc_ros.core.text.errors import StatementError
import pytest

ORIGIN = (0.0, 0.0, 0.0)
coordinate = st.floats(-6, 6)
poses = st.tuples(coordinate, coordinate, st.floats(-7, 7))
# Poses where words change, arcs vanish or two families meet.
SPECIAL = list(product((-4, -2, -1, 0, 1, 2, 4, 2 * sqrt(2), sqrt(20)), (-4, -2, 0, 1, 2, 4),
                       (-pi, -pi / 2, -pi / 4, 0, pi / 3, pi / 2, 2 * pi / 3, pi)))


def drive(start, segments, radius):
    """Return the pose at the end of the segments, by the exact solution of the dynamics."""
    x, y, theta = start
    for steering, length in segments:
        turn = {'L': 1, 'S': 0, 'R': -1}[steering] * length / radius
        chord = length * (sin(turn / 2) / (turn / 2) if turn / 2 else 1)
        x, y = x + chord * cos(theta + turn / 2), y + chord * sin(theta + turn / 2)
        theta += turn
    return x, y, theta


def pose_error(a, b):
    """Return the largest difference of two poses, with wrapped headings."""
    return max(abs(a[0] - b[0]), abs(a[1] - b[1]), abs(remainder(a[2] - b[2], 2 * pi)))


def random_poses(n, box=5, seed=1):
    half = np.array([box, box, pi])
    rng = np.random.default_rng(seed)
    return rng.uniform(-half, half, (n, 3)), rng.uniform(-half, half, (n, 3))


def find_lengths(starts, goals):
    """Return the lengths of the shortest paths of radius 1 between poses, row by row."""
    return np.array([find_shortest_path(a, b, 1.0).length for a, b in zip(
        *np.broadcast_arrays(np.atleast_2d(starts), np.atleast_2d(goals)), strict=True)])


@pytest.mark.parametrize(('goal', 'word', 'length'), [
    ((3, 0, 0), 'S+', 3),
    ((-3, 0, 0), 'S-', 3),
    ((1, 1, pi / 2), 'L+', pi / 2),
    ((1, -1, -pi / 2), 'R+', pi / 2),
    ((-1, 1, -pi / 2), 'L-', pi / 2),
    ((0, 0, pi / 2), 'L+R-L+', pi / 2),    # docs/errata.md: as long as turning on the spot
    ((0, 0, pi), 'L+R-L+', pi),
    ((2, 0, pi), 'L+R-', pi),
    ((2, 2, 0), 'L+R+', pi),
    ((0, 0, 0), '', 0),
])
def test_simple_paths_have_known_words_and_lengths(goal, word, length):
    path = find_shortest_path(ORIGIN, goal, 1)
    assert (path.word, path.length) == (word, pytest.approx(length, abs=1e-12))


@pytest.mark.parametrize('d', [1e-4, 0.1, 0.3, 1.0])
def test_a_sideways_step_has_the_known_length(d):
    # R+(t) L-(a) R-(a) L+(t): the centres are 2, 2 and 2 apart with the angle between them pi - a
    # and its mirror image, so that (d + 2)^2 = 4 (5 - 4 cos a) by the law of cosines.
    a = acos((20 - (d + 2)**2) / 16)
    t = asin(2 * sin(a) / (d + 2))
    path = find_shortest_path(ORIGIN, (0, d, 0), 1)
    assert path.length == pytest.approx(2 * (a + t), rel=1e-9)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(poses, poses, st.floats(0.05, 20))
def test_segments_end_at_the_goal(start, goal, radius):
    path = find_shortest_path(start, goal, radius)
    assert pose_error(drive(start, path.segments, radius), goal) < 1e-12 * max(10, radius)
    assert sum(abs(s.length) for s in path.segments) == pytest.approx(
        path.length, abs=1e-12 * max(1, radius))
    assert len(path.segments) <= 5
    assert all(s.length != 0 for s in path.segments)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(poses, st.lists(st.tuples(st.sampled_from('LSR'), st.floats(-3, 3)), max_size=6))
def test_no_random_word_is_shorter(start, segments):
    goal = drive(start, segments, 1.0)
    assert find_shortest_path(start, goal, 1.0).length <= sum(abs(s[1]) for s in segments) + 1e-9


TINY = (1e-12, 1e-10, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 0.03125, 0.3)


@pytest.mark.parametrize('letters', [
    'L', 'S', 'LS', 'SL', 'LR', 'LSL', 'LSR', 'LRL', 'SLR', 'SRS'])
@pytest.mark.parametrize('signs', [(1, 1, 1), (1, -1, -1), (1, -1, 1), (-1, -1, 1)])
def test_no_word_of_tiny_segments_is_shorter(letters, signs):
    """A sideways rounding error of 1e-16 changes the length by at most its root, 1e-8."""
    words = [[(letter, sign * size)
              for letter, sign, size in zip(letters, signs[:len(letters)], sizes, strict=True)]
             for sizes in product(TINY, repeat=len(letters))]
    goals = [drive(ORIGIN, word, 1.0) for word in words]
    known = np.array([sum(abs(length) for _, length in word) for word in words])
    paths = [find_shortest_path(ORIGIN, goal, 1.0) for goal in goals]
    assert (np.array([path.length for path in paths]) <= known + 1e-9).all()
    for path, goal in zip(paths, goals, strict=True):
        assert pose_error(drive(ORIGIN, path.segments, 1.0), goal) < 1e-11


@pytest.mark.slow
@pytest.mark.parametrize('box', [0.05, 0.5, 2, 5, 40])
def test_no_extremal_of_the_maximum_principle_is_shorter(box):
    """The extremals use neither a list of words nor a formula of `reeds_shepp`."""
    _, goals = random_poses(2_000, box, seed=3)
    np.testing.assert_allclose(find_lengths(ORIGIN, goals), find_least_times(goals),
                               atol=1e-11)


def test_lengths_at_special_poses_agree_with_extremals():
    np.testing.assert_allclose(find_lengths(ORIGIN, SPECIAL), find_least_times(SPECIAL),
                               atol=1e-11)


def test_the_value_function_satisfies_its_hjb_equation():
    # |d_x cos(theta) + d_y sin(theta)| + |d_theta| = 1 at smooth points of the length d to the
    # goal pose. This is H = 0 of Exercise 2.6 and uses no formula of the paper.
    start, goal = random_poses(2_000)
    h = 1e-5
    gradient, kinks = [], np.zeros(len(goal), dtype=bool)
    middle = find_lengths(start, goal)
    for k in range(3):
        step = h * np.eye(3)[k]
        ahead = find_lengths(start, goal + step)
        behind = find_lengths(start, goal - step)
        gradient.append((ahead - behind) / (2 * h))
        kinks |= abs(ahead - 2 * middle + behind) > 100 * h**2
    speed = abs(gradient[0] * np.cos(goal[:, 2]) + gradient[1] * np.sin(goal[:, 2]))
    residual = abs(speed + abs(gradient[2]) - 1)[~kinks]
    assert kinks.mean() < 0.01
    assert np.quantile(residual, 0.99) < 1e-6
    assert residual.max() < 1e-3


def test_lengths_are_a_metric():
    a, b = random_poses(1_000)
    c, _ = random_poses(1_000, seed=2)
    np.testing.assert_allclose(find_lengths(a, b), find_lengths(b, a), atol=1e-12)
    detour = find_lengths(a, b) + find_lengths(b, c)
    assert (find_lengths(a, c) <= detour + 1e-12).all()
    assert (find_lengths(a, b) >= np.hypot(*(a - b)[:, :2].T) - 1e-12).all()
    assert (find_lengths(a, a) == 0).all()


def test_lengths_are_continuous_at_special_poses():
    goals = np.array(SPECIAL, dtype=float)
    paths = [find_shortest_path(ORIGIN, goal, 1.0) for goal in goals]
    exact = [path.length for path in paths]
    near = find_lengths(ORIGIN, goals + [1e-11, -1e-11, 1e-11])
    # The length is Hoelder continuous of order 1/2 in sideways shifts.
    np.testing.assert_allclose(exact, near, atol=3e-5)
    for goal, path in zip(goals, paths, strict=True):
        assert pose_error(drive(ORIGIN, path.segments, 1.0), goal) < 1e-12


@settings(max_examples=100, deadline=None)
@given(poses, poses, st.integers(2, 60))
def test_samples_are_spaced_by_equal_lengths(start, goal, n):
    path = find_shortest_path(start, goal, 1.5)
    points = path.sample(n)
    assert points.shape == (n, 3)
    assert tuple(points[0]) == start
    assert pose_error(points[-1], goal) < 1e-12
    step = path.length / (n - 1)
    for k in range(n - 1):
        moved = points[k + 1] - points[k]
        assert hypot(moved[0], moved[1]) <= step + 1e-9
        assert abs(moved[2]) <= step / 1.5 + 1e-9
        partial = find_shortest_path(points[k], points[k + 1], 1.5).length
        assert partial <= step + 1e-6


def test_samples_lie_on_the_driven_path():
    starts, goals = random_poses(200)
    for start, goal in zip(starts, goals, strict=True):
        path = find_shortest_path(start, goal, 1.0)
        distances = np.linspace(0, path.length, 13)
        for distance, point in zip(distances, path.at(distances), strict=True):
            driven, left = [], distance
            for steering, length in path.segments:
                part = min(left, abs(length))
                driven.append((steering, part if length > 0 else -part))
                left -= part
            assert pose_error(point, drive(start, driven, 1.0)) < 1e-12


@pytest.mark.parametrize(('start', 'goal', 'radius', 'text'), [
    ((0, 0), ORIGIN, 1, 'start must be three finite numbers'),
    (ORIGIN, (0, 0, float('nan')), 1, 'goal must be three finite numbers'),
    (ORIGIN, '123', 1, "found '123'"),
    (ORIGIN, (1, 2, 10**400), 1, 'goal must be three finite numbers'),
    (None, ORIGIN, 1, 'found None'),
    (ORIGIN, ORIGIN, 0, 'radius must be a finite number > 0; found 0'),
    (ORIGIN, ORIGIN, -1, 'radius must be a finite number > 0; found -1'),
    (ORIGIN, ORIGIN, 'one', 'radius must be a finite number'),
    (ORIGIN, (1e200, 0, 0), 1, 'too far apart'),
])
def test_bad_input_is_rejected(start, goal, radius, text):
    with pytest.raises(StatementError, match=text):
        find_shortest_path(start, goal, radius)


@pytest.mark.parametrize('n', [1, 0, -3, 2.5, None, True, '5'])
def test_a_bad_number_of_samples_is_rejected(n):
    with pytest.raises(StatementError, match='2 or more points'):
        find_shortest_path(ORIGIN, (1, 1, 1), 1).sample(n)


def test_20_000_random_lengths_agree_with_ompl():
    base = pytest.importorskip('ompl.base', reason='ompl is not installed')
    space = base.ReedsSheppStateSpace(1.0)
    one, other = space.allocState(), space.allocState()
    starts, goals = random_poses(20_000)
    for a, b in zip(starts.tolist(), goals.tolist(), strict=True):
        for state, (x, y, theta) in ((one, a), (other, b)):
            state.setX(x)
            state.setY(y)
            state.setYaw(theta)
        found = find_shortest_path(a, b, 1.0).length
        assert abs(found - space.distance(one, other)) <= 1e-9
