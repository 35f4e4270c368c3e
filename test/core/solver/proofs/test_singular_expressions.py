# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Undefined or nondifferentiable expressions on a path, and diverging states."""

import re

import numpy as np
from obc_ros.core.ocp.solution import Status
from obc_ros.core.solver.proofs.singular_expressions import (
    explain_escape,
    explain_kink,
    explain_level_terminal,
    explain_steep_root,
    explain_undefined,
)
from obc_ros.core.solver.solve import solve
import problems
import pytest

T = np.linspace(0, 2, 21)
PATH = np.column_stack([T, 1 + 0 * T])  # x = t, v = 1


def undefined(rate, cost='u**2'):
    """Return the message about x' = v, v' = rate on the path x = t, v = 1."""
    problem = problems.pose({'x': 'v', 'v': rate}, cost, (0, 1), 2, parameters={'one': 1})
    return explain_undefined(problem, T, PATH, np.ones((len(T), 1)))


@pytest.mark.parametrize('rate, words, time', [
    ('u/(x - 0.95)', 'dynamics.v divides by zero', 1.0),
    ('u/(x - one)', 'dynamics.v divides by zero', 1.0),
    ('u*(x - 0.95)**-3', 'dynamics.v divides by zero', 1.0),
    ('u*(x - one)**-2', 'dynamics.v divides by zero', 1.0),
    ('u*log(1.55 - x)', 'dynamics.v takes the logarithm of a negative number', 1.6),
    ('u + sqrt(0.45 - x**2)', 'dynamics.v takes the root of a negative number', 0.7),
    ('u + (1 - x)**1.5', 'dynamics.v takes a noninteger power of a negative number', 1.1)])
def test_the_first_undefined_point_is_reported(rate, words, time):
    assert undefined(rate).startswith(f'{words} at t = {time:.4g} on the closest path')
    assert f'where x = {time:.4g}, v = 1' in undefined(rate)


def test_an_undefined_cost_is_reported():
    assert undefined('u', '1/(x - 1)').startswith('running_cost divides by zero at t = 1 ')


@pytest.mark.slow
def test_a_search_names_the_expression_that_no_path_may_pass():
    """From x = 0 to 2, f is undefined beyond 0.67."""
    found = solve(problems.pose(
        {'x': 'v', 'v': 'u + sqrt(0.45 - x**2)'}, 'u**2', (0, 0), 2,
        terminal_constraints=['x - 2', 'v']), time_limit=60)
    assert found.status is Status.NOT_CONVERGED
    assert found.message.startswith('dynamics.v takes the root of a negative number at t = ')
    place = float(re.search(r'where x = ([\d.]+)', found.message)[1])
    assert 0.45**0.5 < place < 0.45**0.5 + 0.1


@pytest.mark.parametrize('rate', [
    'u', 'u/(x + 1)', 'u*log(x + 1)', 'sqrt(x)', 'x**2', 'x**1.5', '1/(1 + x**2)', '(x + 1)**-2',
    'u/2'])
def test_defined_expressions_are_not_reported(rate):
    assert undefined(rate) == ''


@pytest.mark.slow
def test_diverging_states_are_reported():
    """From x = 2, x' = x^2 has the pole t = 0.5; with u = -1 the pole is a little later."""
    mapping = {
        'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'x**2 + u'}, 'running_cost': 'u**2',
        'initial_state': {'x': 2}, 'terminal_constraints': ['x'], 'input_bounds': {'u': [-1, 1]},
        'final_time': {'free': False, 'value': 2}}
    # x' = x^2 - 1: x = -coth(t - c), coth(c) = 2.
    last = np.arctanh(0.5)
    sentence = explain_escape(problems.build(mapping), 2.0)
    assert sentence.startswith('x diverges: with each of 3 constant inputs')
    assert f'by t = {last:.4g}' in sentence
    found = solve(problems.build(mapping), time_limit=10)
    assert found.status is Status.NOT_CONVERGED
    assert found.message == sentence
    assert explain_escape(problems.build(mapping, input_bounds={'u': [-5, 1]}), 2.0) == ''


@pytest.mark.parametrize('cost, kink', [
    ('abs(x - 0.95) + u**2', 'abs((x-0.95)) is 0, as at t = 1 '),
    ('u**2 + 3*abs(x - v)', 'abs((x-v)) is 0, as at t = 1 '),
    ('abs(u - 1) + x', ''),         # kinks in inputs alone are allowed
    ('abs(x + 1)', '')])            # not 0 on this path
def test_kinks_on_a_path_are_reported(cost, kink):
    problem = problems.pose({'x': 'v', 'v': 'u'}, cost, (0, 1), 2)
    sentence = explain_kink(problem, T, PATH, np.ones((len(T), 1)))
    if kink:
        assert sentence.startswith(f'running_cost is not differentiable where {kink}')
    else:
        assert sentence == ''


@pytest.mark.slow
def test_the_advice_about_a_kink_of_states_helps():
    """From rest at x = 1 the optimal path for |x| + u^2/10 reaches 0 and stays there."""
    mapping = {
        'states': ['x', 'v'], 'inputs': ['u'], 'dynamics': {'x': 'v', 'v': 'u'},
        'running_cost': 'abs(x) + u**2/10', 'initial_state': {'x': 1, 'v': 0},
        'final_time': {'free': False, 'value': 6}}
    found = solve(problems.build(mapping), max_intervals=250)
    assert found.status is Status.NOT_CONVERGED
    assert found.message.startswith(
        'running_cost is not differentiable where abs(x) is 0, as at t = 1.')
    advice = re.search(r'by (sqrt.*?e\*\*2\)) with a small e such as ([0-9.]+)', found.message)
    rounded = advice[1].replace('e**2', f'{advice[2]}**2')
    smoothed = solve(problems.build(mapping, running_cost=f'{rounded} + u**2/10'))
    assert smoothed.status is Status.SOLVED
    # The smoothed cost is higher by e T at most.
    assert 0 <= smoothed.objective - found.objective <= 6 * float(advice[2])


@pytest.mark.parametrize(('cost', 'is_steep'), [
    ('sqrt(x)', True), ('(2 - x)**0.5', True), ('sqrt(x + 1)', False), ('x**1.5', False),
    ('sqrt(u**2 + 1)', False)])
def test_roots_that_vanish_on_a_path_are_reported(cost, is_steep):
    problem = problems.pose({'x': 'v', 'v': 'u'}, cost, (0, 1), 2)
    sentence = explain_steep_root(problem, T, PATH, np.ones((len(T), 1)))
    assert sentence.startswith('running_cost contains a root of ' if is_steep else '')
    assert bool(sentence) == is_steep


@pytest.mark.parametrize('explain', [explain_kink, explain_steep_root, explain_undefined])
def test_a_path_that_is_not_finite_has_no_explanation(explain):
    problem = problems.pose(
        {'x': 'v', 'v': 'u'}, 'abs(x - 1) + sqrt(2 - x) + 1/(x - 1)', (0, 1), 2)
    inputs = np.ones((len(T), 1))
    assert explain(problem, T, PATH, inputs)
    assert explain(problem, T, PATH, inputs * np.inf) == ''
    assert explain(problem, T[:0], PATH[:0], inputs[:0]) == ''


@pytest.mark.slow
def test_the_advice_about_a_vanishing_root_helps():
    """Torricelli's tank is empty at T = 2, where its costate is unbounded."""
    mapping = {
        'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u - sqrt(x)'}, 'running_cost': '1',
        'initial_state': {'x': 1}, 'terminal_constraints': ['x'], 'input_bounds': {'u': [0, 2]},
        'final_time': {'free': True, 'lower': 0.1, 'upper': 20}}
    found = solve(problems.build(mapping), max_intervals=250)
    assert found.status is Status.NOT_CONVERGED
    assert found.message.startswith(
        'dynamics.x contains a root of x, whose derivative is infinite where this is 0, as at '
        't = 2 ')
    e = float(re.search(r'by x \+ e with a small e such as ([0-9.]+)', found.message)[1])
    smoothed = solve(problems.build(mapping, dynamics={'x': f'u - sqrt(x + {e})'}))
    assert smoothed.status is Status.SOLVED
    assert smoothed.objective == pytest.approx(2 * (np.sqrt(1 + e) - np.sqrt(e)), rel=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize('constraint', ['(x - 1)**2', '(x - 1)**3'])
def test_a_terminal_constraint_without_gradient_is_reported(constraint):
    """Unless rounding leaves a path beside the root that is certified: its cost is 1/2, too."""
    mapping = {
        'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': 'u'}, 'running_cost': 'u**2/2',
        'initial_state': {'x': 0}, 'terminal_constraints': [constraint],
        'final_time': {'free': False, 'value': 1}}
    found = solve(problems.build(mapping))
    if found.status is Status.SOLVED:
        assert found.objective == pytest.approx(0.5, rel=1e-5)   # the accuracy of a certificate
        return
    assert found.status is Status.NOT_CONVERGED
    assert re.match(
        r'terminal_constraints\[0\], .*, has zero gradient where it is met', found.message)


@pytest.mark.parametrize('off', [0.0, 1e-16, -1e-15, 1e-12, 1e-7, 1e-4, -0.02])
@pytest.mark.parametrize('constraint', [
    '(x - 1)**2', '(x - 1)**3', '(x - 1)**5', 'x**3 - 3*x**2 + 3*x - 1', '(x - y)**2',
    '(x - 1)**2 + (y - 1)**2'])
def test_a_multiple_root_is_recognised_from_nearby_ends(constraint, off):
    """Rounding determines how close to the root a search ends, but not the order of the root."""
    problem = problems.pose(
        {'x': 'u', 'y': 'x'}, 'u**2/2', (0, 1), 1, terminal_constraints=[constraint])
    assert explain_level_terminal(problem,
                                  np.array([1 + off, 1])).startswith('terminal_constraints[0], ')


@pytest.mark.parametrize('constraint, end', [
    ('x - 1', 1.0), ('x - 1', 0.97), ('x**2 - 1', 0.97), ('x**2 - 1', 1.0), ('x**2 + 1', 0.1),
    ('exp(x) - 1', 0.2), ('sin(x)', 3.1)])
def test_regular_terminal_constraints_are_not_reported(constraint, end):
    problem = problems.pose({'x': 'u'}, 'u**2/2', (0,), 1, terminal_constraints=[constraint])
    assert explain_level_terminal(problem, np.array([end])) == ''


@pytest.mark.parametrize(('where', 'kink'), [(T[-1], True), (T[3], False)])
def test_a_kink_of_the_terminal_cost_matters_only_at_the_end(where, kink):
    problem = problems.pose(
        {'x': 'v', 'v': 'u'}, 'u**2', (0, 1), 2, terminal_cost=f'abs(x - {where})')
    sentence = explain_kink(problem, T, PATH, np.ones((len(T), 1)))
    if kink:
        assert sentence.startswith('terminal_cost is not differentiable where')
    else:
        assert sentence == ''
