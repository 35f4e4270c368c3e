# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Homotopy classes of paths past obstacles: guesses on either side, and the best solution."""

from itertools import pairwise

import numpy as np
from obc_ros.core.solver.initial_guess import Guesser
from obc_ros.core.solver.solve import solve
from obc_ros.core.solver.starts.obstacle_homotopy import bend_around
import problems
import pytest

DISCS = ((1.5, 0.7, 0.6), (2.8, 1.6, 0.6))


def unicycle(discs):
    """Return a unicycle that avoids discs (x, y, radius) on its way from (0, 0) to (4, 2)."""
    return problems.pose(
        {'px': 'v*cos(theta)', 'py': 'v*sin(theta)', 'theta': 'omega'}, 'v**2 + omega**2',
        (0, 0, 0), 5, inputs=['v', 'omega'], terminal_constraints=['px - 4', 'py - 2', 'theta'],
        input_bounds={'v': [0, 2], 'omega': [-1, 1]},
        path_constraints=[{'expr': f'(px - {x})**2 + (py - {y})**2', 'lower': r**2}
                          for x, y, r in discs])


def point_mass(discs, side):
    """Return a minimum-time point mass that avoids discs; `side` = -1 reflects everything."""
    return problems.build({
        'states': ['px', 'py', 'vx', 'vy'], 'inputs': ['ax', 'ay'],
        'dynamics': {'px': 'vx', 'py': 'vy', 'vx': 'ax', 'vy': 'ay'}, 'running_cost': 1,
        'initial_state': dict.fromkeys(('px', 'py', 'vx', 'vy'), 0),
        'terminal_constraints': ['px - 4', f'py - {2 * side}', 'vx', 'vy'],
        'input_bounds': {'ax': [-1, 1], 'ay': [-1, 1]},
        'path_constraints': [{'expr': f'(px - {x})**2 + (py - {side * y})**2', 'lower': r**2}
                             for x, y, r in discs],
        'final_time': {'free': True, 'lower': 0.5, 'upper': 20}})


def turns(path, disc):
    """Return the angle of the path around the centre of a disc, from start to end."""
    arms = path.x[:, :2] - np.array(disc[:2])
    return sum(np.sign(a[0]*b[1] - a[1]*b[0]) * np.arccos(np.clip(
        a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1)) for a, b in pairwise(arms))


def test_lines_are_bent_to_either_side_of_each_disc():
    """Two discs on the line give four combinations of sides."""
    problem = unicycle(DISCS)
    ways = bend_around(problem, Guesser(problem).line(problem, 5.0))
    sides = {tuple(bool(turns(way, disc) > 0) for disc in DISCS) for way in ways}
    assert len(ways) == 4
    assert len(sides) == 4
    length = [np.linalg.norm(np.diff(way.x[:, :2], axis=0), axis=1).sum() for way in ways]
    assert length == pytest.approx(sorted(length), rel=1e-2)


@pytest.mark.parametrize('disc', [(2.0, 5.0, 0.5), (-1.0, -1.0, 0.5)])
def test_discs_away_from_the_line_do_not_bend_it(disc):
    """Such a disc meets none of the parallel lines beside the straight one."""
    problem = unicycle([disc])
    assert bend_around(problem, Guesser(problem).line(problem, 5.0)) == []


def test_a_disc_centred_on_the_line_is_passed_on_either_side():
    """There the gradient of the constraint has no component across the line."""
    problem = unicycle([(2.0, 1.0, 0.5)])
    ways = bend_around(problem, Guesser(problem).line(problem, 5.0))
    assert sorted(np.sign(turns(way, (2.0, 1.0))) for way in ways) == [-1, 1]


@pytest.mark.slow
def test_a_reflected_problem_has_the_same_cost():
    """Searches from one line took a minute here and ended with a time one third longer."""
    found = [solve(point_mass(DISCS, side)) for side in (1, -1)]
    assert all(answer.certified for answer in found)
    assert found[0].objective == pytest.approx(found[1].objective, rel=1e-9)
    # Without discs px alone needs 2 sqrt(4); the path found first takes 5.37.
    assert 4.0 < found[0].objective < 4.1


@pytest.mark.slow
def test_an_obstacle_and_a_constraint_on_inputs_are_met():
    """The second constraint contains an input; evaluating it once ended the process."""
    stated = problems.pose(
        {'x': 'a', 'y': 'b'}, 'a**2 + b**2', (0, 0), 4, inputs=['a', 'b'],
        terminal_constraints=['x - 4', 'y'],
        path_constraints=[{'expr': '(x - 2)**2 + (y - 0.1)**2', 'lower': 0.25},
                          {'expr': 'a**2 + b*x', 'upper': 100}])
    assert solve(stated, time_limit=30).certified
