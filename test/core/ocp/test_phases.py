# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Phases and what links them: closed forms, jump conditions, errors."""

import math
import re

import numpy as np
from obc_ros.core.ocp.augmentation import hide_added_states
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.solver.solve import solve
from obc_ros.core.text.errors import StatementError
import pytest
from scipy.optimize import minimize_scalar

FREE = {'free': True, 'lower': 0.05, 'upper': 0.95}
LINE = {'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u'}, 'initial_state': {'x': 0},
        'terminal_constraints': ['x - 1']}
# Speed costs four times as much in the second phase, time costs in the first one.
TWO_RATES = LINE | {'phases': [
    {'duration': FREE, 'running_cost': 'u**2 + 1'},
    {'duration': FREE, 'running_cost': '4*u**2', 'terminal_constraints': ['t - 1']}]}


def solved(statement):
    """Return the certified solution of a statement as it is shown."""
    problem = build_problem(statement)
    found = solve(problem)
    assert found.certified, found.message
    return hide_added_states(problem, found)


@pytest.mark.slow
def test_the_time_of_a_switch_is_found():
    # With speeds 4 u and u, J = 4/(1 + 3 s) + s, which is least where 1 + 3 s = sqrt(12).
    found = solved(TWO_RATES)
    s = (math.sqrt(12) - 1) / 3
    assert found.objective == pytest.approx(4 / math.sqrt(12) + s, rel=1e-7)
    assert found.free_parameters == pytest.approx(
        {'duration of phase 1': s, 'duration of phase 2': 1 - s}, abs=1e-4)
    assert found.t[[0, -1]] == pytest.approx([0, 1], abs=1e-9)
    assert found.x[[0, -1], 0] == pytest.approx([0, 1], abs=1e-9)
    assert np.ptp(found.lam) < 1e-5   # it is continuous
    assert found.switching_times == pytest.approx([s], abs=1e-4)


def test_light_is_refracted():
    # At half the speed behind x = 1: sin(a)/sin(b) = 2, and the time of the way is least.
    found = solved({
        'states': ['x', 'y'], 'inputs': ['a'], 'running_cost': '1',
        'initial_state': {'x': 0, 'y': 0}, 'terminal_constraints': ['x - 2', 'y - 1'],
        'input_bounds': {'a': [-1.5, 1.5]}, 'dynamics': {'x': 'cos(a)', 'y': 'sin(a)'},
        'phases': [
            {'name': 'air', 'terminal_constraints': ['x - 1'],
             'duration': {'free': True, 'lower': 0.1, 'upper': 5, 'guess': 1.2}},
            {'name': 'glass', 'dynamics': {'x': 'cos(a)/2', 'y': 'sin(a)/2'},
             'duration': {'free': True, 'lower': 0.1, 'upper': 5, 'guess': 2.2}}]})
    way = minimize_scalar(lambda y: math.hypot(1, y) + 2 * math.hypot(1, 1 - y), (0, 1),
                          tol=1e-12)
    assert found.objective == pytest.approx(way.fun, rel=1e-7)
    half = len(found.t) // 2
    assert np.sin(found.u[0, 0]) / np.sin(found.u[-1, 0]) == pytest.approx(2, rel=1e-4)
    # lam_x jumps at the interface, whose place is given; lam_y does not.
    assert abs(found.lam[half, 0] - found.lam[half - 1, 0]) > 0.1
    assert found.lam[half, 1] == pytest.approx(found.lam[half - 1, 1], abs=1e-5)
    assert set(found.free_parameters) == {'duration of phase air', 'duration of phase glass'}


def test_a_link_changes_the_state_and_its_costate():
    # x doubles between the phases: from 0 by u to a, from 2 a by w to 3, u^2 + w^2 is least
    # at u = 2 w, so that u = 6/5, w = 3/5.
    found = solved(LINE | {
        'running_cost': 'u**2', 'terminal_constraints': ['x - 3'],
        'phases': [{'duration': 1}, {'duration': 1, 'link': {'x': '2*x'}}]})
    assert found.objective == pytest.approx(36/25 + 9/25, rel=1e-8)
    half = len(found.t) // 2
    assert found.x[half - 1:half + 1, 0] == pytest.approx([6/5, 12/5], abs=1e-7)
    # lam before is twice lam after; lam = -2 u.
    assert found.lam[half - 1:half + 1, 0] == pytest.approx([-12/5, -6/5], abs=1e-6)


def test_an_interior_point_is_passed_and_a_missing_link_leaves_the_state_free():
    statement = {
        'states': ['x', 'v'], 'inputs': ['u'], 'dynamics': {'x': 'v', 'v': 'u'},
        'running_cost': 'u**2/2', 'initial_state': {'x': 0, 'v': 0},
        'terminal_constraints': ['x', 'v'],
        'phases': [{'duration': 1, 'terminal_constraints': ['x - 1']}, {'duration': 1}]}
    # By symmetry v vanishes in the middle: twice 6 for a rest-to-rest motion.
    assert solved(statement).objective == pytest.approx(12, rel=1e-8)
    # The speed may jump: x from 0 to 1 with a free end costs 3/2, twice.
    statement['phases'][1]['link'] = {'v': None}
    assert solved(statement).objective == pytest.approx(3, rel=1e-8)


def test_the_time_goes_on_in_later_phases():
    # lam = -sin t as in one phase over [0, 2 pi], J = -integral of |sin t|.
    found = solved({
        'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u'}, 'running_cost': 'x*cos(t)',
        'input_bounds': {'u': [-1, 1]}, 'initial_state': {'x': 0},
        'phases': [{'duration': 'pi/2'}, {'duration': '3*pi/2'}]})
    assert found.objective == pytest.approx(-4, rel=1e-7)
    assert np.any(np.abs(found.switching_times - math.pi) < 1e-4)


@pytest.mark.parametrize(('change', 'said'), [
    ({'phases': []}, '^phases: wanted two or more, found 0'),
    ({'phases': [{'duration': 1}]}, '^phases: wanted two or more, found 1'),
    ({'phases': 3}, '^phases: wanted a list'),
    ({'phases': [{'duration': 1}, 4]}, r'^phases\[1\]: wanted a mapping'),
    ({'phases': [{'duration': 1}, {}]}, r'^phases\[1\]\.duration: missing'),
    ({'phases': [{'duration': 1}, {'duration': -1}]}, r'^phases\[1\]\.duration.*> 0, found -1'),
    ({'phases': [{'duration': 1}, {'duration': {'free': True, 'lower': 1}}]},
     r'^phases\[1\]\.duration\.upper: missing'),
    ({'phases': [{'duration': 1}, {'duration': 1, 'colour': 1}]},
     r'^phases\[1\]\.colour: unknown'),
    ({'phases': [{'duration': 1}, {'duration': 1, 'link': {'z': 'x'}}]},
     r"^phases\[1\]\.link: 'z' is not known; there is x"),
    ({'phases': [{'duration': 1}, {'duration': 1, 'link': {'x': 'q'}}]}, "unknown name 'q'"),
    ({'phases': [{'duration': 1}, {'duration': 1, 'dynamics': {'x': 'q'}}]},
     r"^phases\[1\]\.dynamics\.x: unknown name 'q'; known names: x, u, t, T$"),
    ({'running_cost': 'q', 'phases': [{'duration': 1}, {'duration': 1}]},
     "^running_cost: unknown name 'q'; known names: x, u, t, T$"),
    ({'phases': [{'duration': 1}, {'duration': FREE, 'running_cost': 'u**'}]},
     r"^phases\[1\]\.running_cost: 'u\*\*' is not an expression"),
    ({'phases': [{'duration': 1, 'terminal_cost': 'u'}, {'duration': 1}]},
     r"^phases\[0\]\.terminal_cost: 'u' is an input"),
    ({'phases': [{'duration': 1, 'terminal_constraints': ['x']}, {
        'duration': FREE, 'terminal_constraints': ['t - 1', '3']}]},
     r"^phases\[1\]\.terminal_constraints\[1\]: '3' does not depend on any state"),
    ({'terminal_constraints': ['x - 1', 'q']}, r"^terminal_constraints\[1\]: unknown name 'q'"),
    ({'phases': [{'duration': 1, 'path_constraints': [{'expr': 'x', 'upper': 1}]},
                 {'duration': 1, 'path_constraints': [{'expr': 'x'}]}]},
     r'^phases\[1\]\.path_constraints\[0\]: wanted a lower or an upper bound'),
    ({'phases': [{'duration': 1}, {'duration': 1, 'link': {'x': 'u'}}]},
     r"^phases\[1\]\.link\.x: 'u' is an input"),
    ({'phases': [{'duration': 1}, {'duration': 1, 'state_bounds': {'x': [3, 1]}}]},
     r'^phases\[1\]\.state_bounds\.x: the bounds cross'),
    ({'phases': [{'duration': 1}, {'duration': 'long'}]},
     r"^phases\[1\]\.duration: unknown name 'long'"),
    ({'phases': [{'duration': 1}, {'duration': 1, 'dynamics': {'x': 'u/x'}}]},
     r'^phases\[1\]\.dynamics\.x: undefined at the initial guess of the initial state \(x = 0\); '
     r'give one in phases\[1\]\.initial_guess$'),
    ({'initial_state': {}}, "^initial_state: no value for the state 'x'$"),
    ({'parameters': {'x': 1}}, "^phases: 'x' is both a parameter and a state or an input"),
    ({'final_time': {'free': False, 'value': 1}}, '^final_time: not for a problem with phases'),
    ({'states': ['x__1'], 'dynamics': {'x__1': 'u'}}, "^phases: 'x__1' contains __"),
])
def test_errors_name_the_phase(change, said):
    with pytest.raises(StatementError, match=said):
        build_problem(TWO_RATES | change)


def test_boundary_constraints_link_both_ends():
    # The end is twice the start: (x(0) - 1)^2 + u^2 with x(0) = u is least at 1/2.
    problem = build_problem({
        'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u'}, 'running_cost': 'u**2',
        'initial_cost': '(x - 1)**2', 'boundary_constraints': ['x - 2*x_0'],
        'initial_state': {'x': None}, 'final_time': {'free': False, 'value': 1}})
    found = solve(problem)
    assert found.certified and found.objective == pytest.approx(0.5, rel=1e-8)
    with pytest.raises(StatementError, match="^boundary_constraints: 'x_0' is a name of"):
        build_problem({
            'states': ['x', 'x_0'], 'inputs': ['u'], 'dynamics': {'x': 'u', 'x_0': 'u'},
            'boundary_constraints': ['x - x_0'], 'initial_state': {'x': None, 'x_0': 0},
            'final_time': {'free': False, 'value': 1}})


CLIMB, GLIDE = {'name': 'climb', 'duration': 1}, {'name': 'glide', 'duration': 1}
LATE = {'free': True, 'lower': 0.1, 'upper': 5}


@pytest.mark.parametrize(('change', 'said'), [
    ({'phases': [CLIMB, GLIDE | {'terminal_constraints': ['x**2 + 1']}]},
     r'^phases\[1\]\.terminal_constraints\[0\] is 2 and not 0 where .* \(x of phase glide = 1\)'),
    ({'phases': [CLIMB | {'terminal_constraints': ['x - 0.5']}, GLIDE],
      'terminal_constraints': ['x**2 + 1']},
     r'^the terminal constraint terminal_constraints\[0\] cannot be met'),
    ({'phases': [CLIMB, GLIDE], 'path_constraints': [{'expr': 'x**2', 'lower': 2}],
      'initial_state': {'x': 2}}, r'^path_constraints\[0\] of phase glide is 1 at the state'),
    ({'phases': [CLIMB, GLIDE | {'path_constraints': [{'expr': 'x**2', 'lower': 2}]}]},
     r'^phases\[1\]\.path_constraints\[0\] is 1 at the state'),
    ({'phases': [CLIMB, GLIDE], 'initial_state': {'x': None}, 'initial_constraints': ['x**2 + 1']},
     r'^the terminal constraint initial_constraints\[0\] cannot be met'),
    ({'phases': [CLIMB | {'duration': LATE}, GLIDE | {
        'duration': LATE, 'terminal_constraints': ['t - 20']}]},
     r'phases\[1\]\.terminal_constraints\[0\] cannot be met by the end \('
     'duration of phase climb stays between 0.1 and 5, duration of phase glide stays')])
def test_a_proof_names_what_the_statement_has(change, said):
    problem = build_problem(LINE | {'running_cost': 'u**2'} | change)
    found = hide_added_states(problem, solve(problem))
    assert found.status == 'infeasible'
    assert re.search(said, found.message), found.message


def test_a_message_has_the_words_of_the_statement():
    phases = build_problem(LINE | {'phases': [CLIMB, GLIDE | {'link': {'x': 'x**2'}}]}).phases
    for message, shown in (
            ('x__2 exceeds 9 by t = 0.35, before T = 1', 'x of phase glide exceeds 9 by 0.35 of '
                                                         'each phase, before the end'),
            ('a path meets them at T = 1.35', 'a path meets them at 1.35 times the durations'),
            ('boundary_constraints[0] is missed', 'phases[1].link.x is missed'),
            ('x__2(0) = 1', 'x of phase glide at its start = 1')):
        assert phases.name_phases(message) == shown


def test_a_row_of_the_start_is_named_by_its_key():
    problem = build_problem(LINE | {
        'running_cost': 'u**2', 'initial_state': {'x': None}, 'initial_constraints': ['x**2 + 1'],
        'final_time': {'free': False, 'value': 1}})
    assert 'the terminal constraint initial_constraints[0] cannot' in solve(problem).message


def test_a_reason_names_the_phase():
    problem = build_problem(TWO_RATES | {'phases': [
        {'duration': 1}, {'duration': 1, 'state_bounds': {'x': [2, None]}}]})
    found = hide_added_states(problem, solve(problem))
    assert found.status == 'infeasible'
    assert 'state bound x of phase 2 >= 2' in found.message
