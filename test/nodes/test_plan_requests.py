# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""``~/plan`` with obstacles, bounds of states, and plants of files, over DDS."""

from pathlib import Path
from typing import Any

from lqr_bench import LATCHED
import numpy as np
from obc_ros.msg import NamedBounds, NamedExpression
from obc_ros.nodes.trajectory_server import TrajectoryServer
from obc_ros.srv import PlanMotion
import pytest
from visualization_msgs.msg import MarkerArray
import yaml

pytestmark = pytest.mark.nodes

CART = {'name': 'cart', 'states': ['p', 'v'], 'inputs': ['a'], 'parameters': {'m': 2.0},
        'dynamics': {'p': 'v', 'v': 'a/m'}, 'input_bounds': {'a': ['-m', 'm']},
        'state_bounds': {'v': [-0.5, 0.5]}, 'notes': 'for people'}


def write(folder: Path, stem: str, **changes: Any) -> str:
    """Write the cart with some keys changed; return the path of the file."""
    path = folder / f'{stem}.yaml'
    path.write_text(yaml.safe_dump({**CART, **changes}), encoding='utf-8')
    return str(path)


def plan(probe: Any, **fields: Any) -> Any:
    """Request a plan in minimum time; return the response."""
    return probe.call(PlanMotion, '/trajectory_server/plan', PlanMotion.Request(
        objective='time', **fields))


def test_an_obstacle_is_avoided_and_bounds_of_states_hold(spawn: Any, probe: Any) -> None:
    """Both are evaluated along the answer; bad ones are refused in words."""
    spawn('trajectory_server', {'workers': 1})
    drive = {'system': 'two_wheeled', 'start': [0.0] * 3, 'goal': [2.0, 0.0, 0.0]}
    straight = plan(probe, **drive)
    assert straight.objective == pytest.approx(2.0, abs=1e-6), straight.message
    answer = plan(probe, **drive, path_constraints=['0.25 - (px - 1)**2 - (py - 0.05)**2'],
                  state_bounds=[NamedBounds(name='py', lower='-0.6')])
    assert answer.success, answer.message
    px, py, _ = np.reshape(answer.trajectory.x, (-1, 3)).T
    assert (0.25 - (px - 1)**2 - (py - 0.05)**2).max() == pytest.approx(0.0, abs=1e-3)
    assert py.min() >= -0.6 - 1e-6
    assert answer.objective > 2.05
    shown = probe.listen(MarkerArray, 'plan_markers', LATCHED)
    probe.wait_for(lambda: 'obstacles' in {
        each.ns for array in shown for each in array.markers}, what='the obstacle')
    for fields, words in (
            ({'path_constraints': ['px +']}, 'path_constraints[0]'),
            ({'path_constraints': ['open("x")']}, 'path_constraints[0]'),
            ({'path_constraints': ['\x00'] * 3}, 'path_constraints[0]'),
            ({'state_bounds': [NamedBounds(name='boat')]}, "'boat' is not a state"),
            ({'state_bounds': [NamedBounds(name='py')] * 2}, "'py' is given twice")):
        refused = plan(probe, **drive, **fields)
        assert (refused.success, refused.status) == (False, 'malformed')
        assert words in refused.message


def test_a_plant_of_a_file_is_planned_for_by_its_name(
        spawn: Any, probe: Any, tmp_path: Path) -> None:
    """Full thrust for 0.5 s, the speed limit of the plant, the brake: T = d/v + v/a."""
    spawn('trajectory_server', {
        'workers': 1, 'systems': [write(tmp_path, 'cart'), write(tmp_path, 'other', name='van')]})
    answer = plan(probe, system='cart', start=[0.0, 0.0], goal=[1.0, 0.0])
    assert answer.success, answer.message
    assert answer.objective == pytest.approx(1.0 / 0.5 + 0.5 / 1.0, abs=1e-5)
    assert (answer.trajectory.system, answer.trajectory.state_names) == ('cart', ['p', 'v'])
    heavier = plan(probe, system='van', start=[0.0, 0.0], goal=[1.0, 0.0],
                   system_parameters=[NamedExpression(name='m', expression='4')])
    assert heavier.objective == pytest.approx(2.5, abs=1e-5)
    wrong = plan(probe, system='van', start=[0.0, 0.0], goal=[1.0, 0.0],
                 system_parameters=[NamedExpression(name='boat', expression='4')])
    assert "van has no parameter 'boat'" in wrong.message
    path = str(tmp_path / 'cart.yaml')
    assert 'unknown system' in plan(probe, system=path, start=[0.0], goal=[0.0]).message
    result, = probe.set_parameters('/trajectory_server', systems=[path])
    assert not result.successful


@pytest.mark.parametrize(('names', 'changes', 'words'), [
    (['cart', 'again'], {}, "'cart' is the name of the plant of "),
    (['cart'], {'name': 'vehicle'}, "'vehicle' is the name of a registered system"),
    (['cart'], {'dynamics': {'p': 'v'}}, "no equation for the state 'v'"),
    (['cart'], {'state': ['p']}, 'state: unknown key'),
])
def test_plants_that_cannot_be_used_refuse_the_start(
        names: list[str], changes: dict[str, Any], words: str, probe: Any, tmp_path: Path
        ) -> None:
    assert words in probe.refusal(TrajectoryServer, {
        'systems': [write(tmp_path, name, **changes) for name in names]})


def test_the_server_ends_with_the_reason(spawn: Any, tmp_path: Path) -> None:
    process = spawn('trajectory_server', {
        'systems': [write(tmp_path, 'cart', state=['p'])], 'workers': 1})
    assert process.wait() == 1
    assert 'state: unknown key' in process.output()
