# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The view of a plant over DDS: markers and trail while somebody subscribes."""

from importlib import util
import math
import time

from nav_msgs.msg import Path
import numpy as np
from numpy.testing import assert_allclose
from obc_ros.core.systems import registry
from obc_ros.core.text.errors import StatementError
from obc_ros.msg import State
from obc_ros.nodes.plant_simulator import PlantSimulator, Settings
from obc_ros.nodes.views import plant_view
from obc_ros.nodes.views.plant_view import check_view, FASTEST
from obc_ros.ros.messages import read_nanoseconds
import pytest
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

NODE = '/plant_simulator'
TUMBLING = {'x0': [1.0, 2.0, 0.3, 0.5, 0.0, 1.0], 'hold_until_command': False}


def body(message, name='body'):
    """Return the markers of a namespace that are shown."""
    return [each for each in message.markers if each.ns == name and each.action == Marker.ADD]


def find_stamp(message):
    return read_nanoseconds(message.header.stamp)


def test_the_body_is_at_the_published_state(spawn, probe):
    """A state with the same stamp is found for each marker array."""
    states = probe.listen(State, 'state', 1000)
    arrays = probe.listen(MarkerArray, 'markers')
    spawn('plant_simulator', TUMBLING)
    probe.wait_for(lambda: len(arrays) > 20, what='markers')
    last = find_stamp(body(arrays[-1])[0])
    probe.wait_for(lambda: find_stamp(states[-1]) >= last, what='their states')
    known = {find_stamp(each): each.x for each in states}
    compared = 0
    for array in arrays:
        marker = body(array)[0]
        if find_stamp(marker) not in known:   # published before the probe was connected
            continue
        px, py, theta = known[find_stamp(marker)][:3]
        position, turn = marker.pose.position, marker.pose.orientation
        assert_allclose([position.x, position.y, position.z], [px, 0, py])
        assert_allclose([turn.w, turn.x, turn.y, turn.z],
                        [math.cos(theta / 2), 0, -math.sin(theta / 2), 0], atol=1e-12)
        assert marker.header.frame_id == 'odom'
        assert len(body(array, 'thrust')) == 1   # 39.2 N hold the aircraft until a command
        compared += 1
    assert compared > 10


def test_markers_are_at_most_30_per_second_of_wall_time(spawn, probe):
    """Simulated time runs 20 times as fast."""
    spawn('plant_simulator', {'speed': 20.0, 'publish_clock': True})
    arrays = probe.listen(MarkerArray, 'markers')
    probe.wait_for(lambda: arrays, what='markers')
    begun, count = time.monotonic(), len(arrays)
    probe.spin_for(2.0)
    most = FASTEST * (time.monotonic() - begun)
    assert 0.3 * most < len(arrays) - count <= most + 2
    assert not probe.set_parameters(NODE, marker_rate=31.0)[0].successful


def test_nothing_is_made_without_a_subscriber(domain, probe, monkeypatch):
    """The view looks at the plant only to publish what has a subscriber."""
    looks = []
    observe = PlantSimulator._observe
    monkeypatch.setattr(PlantSimulator, '_observe',
                        lambda self: looks.append(1) or observe(self))
    node = PlantSimulator(context=probe.context)
    try:
        probe.add(node)
        probe.spin_for(1.2)
        assert not looks
        subscription = probe.node.create_subscription(
            MarkerArray, 'markers', lambda message: None, 1)
        probe.wait_for(lambda: len(looks) > 5, what='markers')
        probe.node.destroy_subscription(subscription)
        probe.wait_for(lambda: not node.count_subscribers('markers'), what='no subscriber')
        probe.spin_for(0.3)
        count = len(looks)
        probe.spin_for(1.2)
        assert len(looks) == count
    finally:
        node.destroy_node()


def test_the_trail_is_bounded_and_begins_anew_after_a_reset(spawn, probe):
    spawn('plant_simulator', {'system': 'vehicle', 'trail_length': 5, 'publish_clock': True,
                              'hold_until_command': False})
    paths = probe.listen(Path, 'trail')
    probe.wait_for(lambda: len(paths) > 8, what='a trail')
    assert max(len(each.poses) for each in paths) == 5
    px = np.array([pose.pose.position.x for pose in paths[-1].poses])
    stamps = np.array([find_stamp(pose) for pose in paths[-1].poses]) * 1e-9
    assert (np.diff(px) > 0).all()
    assert_allclose(px, 10.0 * stamps, atol=1e-6)   # until a command: straight on at 10 m/s
    assert paths[-1].header.frame_id == 'odom'
    probe.call(Trigger, f'{NODE}/reset')
    probe.wait_for(lambda: find_stamp(paths[-1].poses[0]) * 1e-9 < stamps[0], what='a new trail')
    assert paths[-1].poses[0].pose.position.x < px[0]
    assert probe.set_parameters(NODE, trail_length=0)[0].successful
    probe.spin_for(0.5)
    count = len(paths)
    probe.spin_for(1.0)
    assert len(paths) == count
    assert not probe.set_parameters(NODE, trail_length=501)[0].successful


def test_a_plant_that_rests_adds_no_poses(spawn, probe):
    spawn('plant_simulator')
    paths = probe.listen(Path, 'trail')
    probe.wait_for(lambda: len(paths) > 4, what='a trail')
    assert len(paths[-1].poses) == 1


def test_the_set_point_in_a_namespace_follows_the_regulator(spawn, probe):
    """All topics are relative: two loops do not mix."""
    for index, namespace in enumerate(('/a1/b_2', '/other')):
        spawn('plant_simulator', {}, namespace=namespace)
        spawn('lqr_node', {'setpoint': [2.0 + index, 1.0, 0.0, 0.0, 0.0, 0.0]},
              namespace=namespace)
    first, second = (probe.listen(MarkerArray, f'{each}/markers') for each in (
        '/a1/b_2', '/other'))

    def places(arrays):
        return [(each.pose.position.x, each.pose.position.z)
                for each in body(arrays[-1], 'set_point')[:1]] if arrays else []

    probe.wait_for(lambda: places(first) == [(2.0, 1.0)] and places(second) == [(3.0, 1.0)])
    assert probe.set_parameters(
        '/a1/b_2/lqr_node', setpoint=[-1.0, 4.0, 0.0, 0.0, 0.0, 0.0])[0].successful
    probe.wait_for(lambda: places(first) == [(-1.0, 4.0)], what='the new set point')
    assert places(second) == [(3.0, 1.0)]
    assert not probe.node.count_publishers('/markers')


def test_markers_vanish_when_they_are_switched_off_and_return(spawn, probe):
    spawn('plant_simulator')
    arrays = probe.listen(MarkerArray, 'markers')
    probe.wait_for(lambda: arrays, what='markers')
    shown = {(each.ns, each.id) for each in arrays[-1].markers}
    assert probe.set_parameters(NODE, markers=False)[0].successful
    probe.wait_for(lambda: {each.action for each in arrays[-1].markers} == {Marker.DELETE})
    assert {(each.ns, each.id) for each in arrays[-1].markers} == shown
    count = len(arrays)
    probe.spin_for(1.0)
    assert len(arrays) == count
    assert probe.set_parameters(NODE, markers=True)[0].successful
    probe.wait_for(lambda: body(arrays[-1]), what='markers again')


def test_other_parameters_of_the_plant_change_the_body(spawn, probe):
    spawn('plant_simulator', {'system': 'vehicle'})
    arrays = probe.listen(MarkerArray, 'markers')
    probe.wait_for(lambda: arrays, what='markers')
    length = body(arrays[-1])[0].scale.x
    assert probe.set_parameters(NODE, **{'system_parameters.l': 4.0})[0].successful
    probe.wait_for(lambda: body(arrays[-1])[0].scale.x == pytest.approx(2 * length))


def test_a_plant_without_positions_has_no_view(spawn, probe):
    spawn('plant_simulator', {'system': 'double_integrator'}).wait_for_output('until the first')
    probe.wait_for(lambda: probe.node.count_publishers('/state'))
    probe.spin_for(0.5)
    assert not probe.node.count_publishers('/markers')
    assert not probe.node.count_publishers('/trail')
    assert probe.set_parameters(NODE, trail_length=7)[0].successful


def test_a_frame_is_refused_in_words_where_it_cannot_be_published(monkeypatch):
    settings = Settings(publish_tf=True)
    with pytest.raises(StatementError, match='py, theta.* are not a pose in a plane'):
        check_view(registry.get_system('vehicle_lateral'), settings)
    monkeypatch.setattr(plant_view.util, 'find_spec', lambda name: None)
    with pytest.raises(StatementError, match='tf2_msgs is missing; install it'):
        check_view(registry.get_system('vehicle'), settings)


def test_the_frame_is_published_only_if_that_is_wanted(spawn, probe):
    """Without tf2_msgs a node that is to publish it says what is missing, and ends."""
    spawn('plant_simulator').wait_for_output('until the first command')
    probe.wait_for(lambda: probe.node.count_publishers('/state'))
    assert not probe.node.count_publishers('/tf')
    if util.find_spec('tf2_msgs') is None:
        asked = spawn('plant_simulator', {'publish_tf': True}, namespace='/asked')
        assert asked.wait() == 1
        assert 'publish_tf: the package tf2_msgs is missing' in asked.output()
    else:
        from tf2_msgs.msg import TFMessage
        spawn('plant_simulator', {'publish_tf': True, **TUMBLING}, namespace='/asked')
        messages = probe.listen(TFMessage, '/asked/tf')
        probe.wait_for(lambda: messages, what='a frame')
        [transform] = messages[-1].transforms
        assert (transform.header.frame_id, transform.child_frame_id) == ('odom', 'base_link')
