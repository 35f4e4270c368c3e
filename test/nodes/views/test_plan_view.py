# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The view of a plan over DDS: its path, its goal, and the boundaries of its obstacles."""

from array import array

from nav_msgs.msg import Path
import numpy as np
from numpy.testing import assert_allclose
from obc_ros.core.ocp.statement import build_problem
from obc_ros.msg import Trajectory
from obc_ros.nodes.views.plan_messages import (
    find_boundaries,
    find_box,
    make_markers,
    make_path,
    MOST_POSES,
)
from obc_ros.nodes.views.plan_view import PlanView
from obc_ros.ros.messages import build_problem_message, read_nanoseconds
from obc_ros.srv import PlanMotion, SolveOptimalControl
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from visualization_msgs.msg import Marker, MarkerArray

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
MASS = {
    'states': ['px', 'py', 'vx', 'vy'], 'inputs': ['ax', 'ay'],
    'dynamics': {'px': 'vx', 'py': 'vy', 'vx': 'ax', 'vy': 'ay'},
    'running_cost': 'ax**2 + ay**2', 'initial_state': {'px': 0, 'py': 0, 'vx': 0, 'vy': 0},
    'terminal_constraints': ['px - 4', 'py - 2', 'vx', 'vy'],
    'final_time': {'free': False, 'value': 4}}
DISC = {'expr': '(px - 2)**2 + (py - 1.2)**2', 'lower': 0.25}


def statement(*constraints, **others):
    return {**MASS, **others, 'path_constraints': list(constraints)}


def xyz(points):
    return np.array([(each.x, each.y, each.z) for each in points])


def by_name(markers):
    return {each.ns: each for each in markers if each.action == Marker.ADD}


def plan(t, x, system='', switching_times=()):
    names = ['px', 'py', 'theta', 'vx', 'vy', 'omega'][:len(x[0])]
    return Trajectory(system=system, state_names=names, t=array('d', t),
                      x=array('d', np.ravel(x)), switching_times=array('d', switching_times))


def test_a_solved_problem_is_shown_with_its_obstacle(spawn, probe):
    """The path is that of the response; later subscribers get it, too."""
    spawn('trajectory_server', {'workers': 1})
    paths, arrays = probe.listen(Path, 'plan', LATCHED), probe.listen(
        MarkerArray, 'plan_markers', LATCHED)
    mapping = statement(DISC)
    problem = build_problem_message(mapping, build_problem(mapping).guess)
    answer = probe.call(SolveOptimalControl, '/trajectory_server/solve',
                        SolveOptimalControl.Request(problem=problem), timeout=60.0)
    assert answer.success
    probe.wait_for(lambda: paths and arrays, what='the plan')
    x = np.reshape(answer.trajectory.x, (-1, 4))
    shown = xyz(pose.pose.position for pose in paths[-1].poses)
    assert len(shown) <= MOST_POSES
    assert_allclose(shown[[0, -1]], np.pad(x[[0, -1], :2], ((0, 0), (0, 1))))
    assert all(np.abs(x[:, :2] - each[:2]).max(axis=1).min() == 0 for each in shown)
    markers = by_name(arrays[-1].markers)
    outline = xyz(markers['obstacles'].points)
    assert_allclose(np.hypot(outline[:, 0] - 2, outline[:, 1] - 1.2), 0.5, atol=2e-3)
    assert_allclose(xyz(markers['goal'].points), [[4, 2, 0]], atol=1e-6)
    later = probe.listen(Path, 'plan', LATCHED)
    probe.wait_for(lambda: later == paths[-1:], what='the plan for a later subscriber')


def test_a_plan_without_a_subscriber_is_shown_to_the_first_one(spawn, probe):
    """The aircraft moves in the vertical plane; the path is stamped as the reference."""
    spawn('trajectory_server', {'workers': 1})
    references = probe.listen(Trajectory, 'reference', LATCHED)
    answer = probe.call(PlanMotion, '/trajectory_server/plan', PlanMotion.Request(
        system='aircraft', start=[1.0, 2.0, 0.1, 0, 0, 0], goal=[0.0] * 6, objective='effort',
        final_time=3.0, execute=True), timeout=60.0)
    assert answer.success, answer.message
    probe.spin_for(0.7)
    paths, arrays = probe.listen(Path, 'plan', LATCHED), probe.listen(
        MarkerArray, 'plan_markers', LATCHED)
    probe.wait_for(lambda: references and paths and arrays, what='the plan')
    [path] = paths
    begin = read_nanoseconds(references[0].header.stamp)
    assert read_nanoseconds(path.poses[0].header.stamp) == begin
    assert read_nanoseconds(path.poses[-1].header.stamp) == begin + 3_000_000_000
    first, last = path.poses[0].pose, path.poses[-1].pose
    assert_allclose(xyz([first.position, last.position]), [[1, 0, 2], [0, 0, 0]], atol=1e-6)
    assert first.orientation.y == pytest.approx(-np.sin(0.05))
    assert_allclose(xyz([by_name(arrays[0].markers)['goal_body'].pose.position]), 0, atol=0.3)
    assert {each.header.frame_id for each in arrays[0].markers} == {'odom'}


def test_a_switched_off_view_shows_nothing_until_it_is_on(spawn, probe):
    spawn('trajectory_server', {'workers': 1, 'markers': False})
    paths = probe.listen(Path, 'plan', LATCHED)
    answer = probe.call(PlanMotion, '/trajectory_server/plan', PlanMotion.Request(
        system='two_wheeled', start=[0.0] * 3, goal=[1.0, 1.0, 0.0], objective='time'),
        timeout=60.0)
    assert answer.success, answer.message
    probe.spin_for(1.0)
    assert not paths
    assert probe.set_parameters('/trajectory_server', markers=True)[0].successful
    probe.wait_for(lambda: paths, what='the plan')


def test_a_plan_that_cannot_be_drawn_ends_no_node(probe):
    """A defect is logged; the next plan is shown."""
    view = PlanView(probe.node)
    paths = probe.listen(Path, 'plan', LATCHED)
    view.show(Trajectory(state_names=['px', 'py'], t=array('d', [0, 1]), x=array('d', [1, 2, 3])))
    probe.spin_for(1.2)
    assert not paths
    view.show(plan([0.0, 1.0], [[1.0, 2.0], [3.0, 4.0]]))
    probe.wait_for(lambda: paths, what='the next plan')
    assert len(paths[-1].poses) == 2


def test_a_long_plan_gives_a_path_of_bounded_length():
    t = np.linspace(0, 10, 20_001)**2
    path = make_path(plan(t, np.column_stack([np.cos(t), np.sin(t)])))
    stamps = np.array([read_nanoseconds(each.header.stamp) for each in path.poses]) * 1e-9
    assert 0.9 * MOST_POSES < len(stamps) <= MOST_POSES
    assert (stamps[0], stamps[-1]) == (0, 100)
    assert_allclose(xyz(each.pose.position for each in path.poses)[:, 0], np.cos(stamps),
                    atol=1e-6)


def test_a_plan_of_one_sample_is_shown():
    assert len(make_path(plan([0.0], [[1.0, 2.0]])).poses) == 1
    assert set(by_name(make_markers(plan([0.0], [[1.0, 2.0]]), None))) == {'start', 'goal'}


def test_switching_times_are_marked_on_the_path():
    marked = plan([0.0, 1.0, 3.0], [[0, 0], [2, 4], [2, 8]], switching_times=[0.5, 1.0, 2.0])
    points = by_name(make_markers(marked, None))['switching_times'].points
    assert_allclose(xyz(points), [[1, 2, 0], [2, 4, 0], [2, 6, 0]])


def test_a_trajectory_without_positions_is_not_drawn():
    other = Trajectory(state_names=['x'], t=array('d', [0, 1]), x=array('d', [0, 1]))
    assert make_path(other) is None
    assert make_markers(other, None) == []


WHOLE = (-1.0, 5.0, -2.0, 4.0)


@pytest.mark.parametrize(('constraint', 'value', 'bound'), [
    (DISC, lambda x, y: (x - 2)**2 + (y - 1.2)**2, 0.25),
    ({'expr': 'sqrt((px - 2)**2 + 4*(py - 1)**2)', 'lower': 1},
     lambda x, y: np.hypot(x - 2, 2 * (y - 1)), 1.0),
    ({'expr': 'py - sin(px)', 'upper': 2}, lambda x, y: y - np.sin(x), 2.0)])
def test_points_of_a_boundary_satisfy_its_equation(constraint, value, bound):
    curves = find_boundaries(statement(constraint), WHOLE)
    points = np.vstack(curves)
    assert len(points) > 50
    assert_allclose(value(points[:, 0], points[:, 1]), bound, atol=5e-3)


def test_both_bounds_of_a_constraint_and_bounds_of_states_are_drawn():
    ring = {'expr': '(px - 2)**2 + (py - 1)**2', 'lower': 0.25, 'upper': 1}
    assert len(find_boundaries(statement(ring), WHOLE)) == 2
    walls = find_boundaries(statement(state_bounds={'py': [-1, 9], 'px': [None, 4.5]}), WHOLE)
    assert [each.tolist() for each in walls] == [[[4.5, -2], [4.5, 4]], [[-1, -1], [5, -1]]]


@pytest.mark.parametrize('constraint', [
    {'expr': 'px + vx', 'upper': 1}, {'expr': 'ax*px', 'upper': 1}, {'expr': 'vx', 'upper': 3},
    {'expr': '(px - t)**2 + py**2', 'lower': 0.1}])
def test_what_depends_on_more_than_the_place_is_not_drawn(constraint):
    assert find_boundaries(statement(constraint), WHOLE) == []


def test_a_constraint_that_is_undefined_somewhere_is_drawn_where_it_is_defined():
    [curve] = find_boundaries(statement({'expr': 'sqrt(px) - py', 'upper': 1}), WHOLE)
    assert_allclose(np.sqrt(curve[:, 0]) - curve[:, 1], 1, atol=0.02)


def test_the_rectangle_is_larger_than_the_plan():
    assert find_box(np.array([[0.0, 1.0], [4.0, 2.0]])) == (-2, 6, -1, 4)
    assert find_box(np.zeros((3, 2))) == (-0.5, 0.5, -0.5, 0.5)
