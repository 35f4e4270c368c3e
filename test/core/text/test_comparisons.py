# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A constraint that compares states the same problem as bounds and equations do."""

import casadi as ca
import numpy as np
import obc_ros as obc
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.text.errors import StatementError
import pytest

BASE = {'states': ['p', 'v'], 'inputs': ['u'], 'dynamics': {'p': 'v', 'v': 'u'},
        'parameters': {'top': 3.0}, 'running_cost': 'u**2', 'initial_state': {'p': 0, 'v': 0},
        'final_time': {'free': False, 'value': 1}}


def evaluate(problem):
    """Return path constraints with their bounds, and psi, at a point."""
    values = ca.Function('c', [problem.x, problem.u, problem.p], [problem.path, problem.psi])(
        np.linspace(0.3, 0.7, problem.n), [0.2], problem.p_value)
    return [*(each.full().ravel().tolist() for each in values),
            problem.path_lower.tolist(), problem.path_upper.tolist()]


@pytest.mark.parametrize(('text', 'function', 'plain'), [
    ('v <= 1', lambda x, u: [x.v <= 1], {'expr': 'v', 'upper': 1}),
    ('v < 1', lambda x, u: x.v < 1, {'expr': 'v', 'upper': 1}),
    ('v >= -1', lambda x, u: [x.v >= -1], {'expr': 'v', 'lower': -1}),
    ('-1 <= v*u', lambda x, u: [x.v * u.u >= -1], {'expr': 'v*u', 'lower': -1}),
    ('-1 <= v <= 2', lambda x, u: [(x.v, -1, 2)], {'expr': 'v', 'lower': -1, 'upper': 2}),
    ('2 >= v >= -1', lambda x, u: (x.v, -1, 2), {'expr': 'v', 'lower': -1, 'upper': 2}),
    ('v <= u', lambda x, u: [x.v <= u.u], {'expr': 'v - u', 'upper': 0}),
    ('(v + p)*(u - 1) >= p - 2', lambda x, u: [(x.v + x.p) * (u.u - 1) >= x.p - 2],
     {'expr': 'p - 2 - (v + p)*(u - 1)', 'upper': 0}),
    ('v + u == 0.5', lambda x, u: [x.v + u.u == 0.5],
     {'expr': 'v + u', 'lower': 0.5, 'upper': 0.5}),
    ('v == u', lambda x, u: [x.v == u.u], {'expr': 'v - u', 'lower': 0, 'upper': 0})])
def test_a_comparison_along_the_path_is_an_expression_with_bounds(text, function, plain):
    found = [evaluate(build_problem(BASE | {'path_constraints': each}))
             for each in ([text], function, [plain])]
    for each in found[:2]:
        for one, other in zip(each, found[2], strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-15)


def test_a_parameter_is_a_bound():
    problem = build_problem(BASE | {'path_constraints': ['v <= 2*top', ['u', '-top', 'top']]})
    assert problem.path_upper.tolist() == [6.0, 3.0] and problem.path_lower[1] == -3.0
    other = build_problem(BASE | {'path_constraints': lambda x, u, p: [x.v <= 2 * p.top]})
    value, _, _, upper = evaluate(other)
    assert value[0] - upper[0] == pytest.approx(0.7 - 6.0)


@pytest.mark.parametrize('key', ['terminal_constraints', 'initial_constraints'])
def test_an_equation_at_an_end_is_a_difference(key):
    start = {'initial_state': {'p': None, 'v': None}}
    found = [build_problem(BASE | start | {key: each}) for each in (
        ['p == 1', 'v == p'], lambda x: [x.p == 1, x.v == x.p], ['p - 1', 'v - p'])]
    for each in found[:2]:
        np.testing.assert_allclose(evaluate(each)[1], evaluate(found[2])[1], rtol=1e-15)
    assert found[0].structure == found[2].structure   # numbers stay numbers


def test_equations_between_both_ends_and_in_phases():
    one, other = (build_problem(BASE | {
        'initial_state': {'p': 0, 'v': [-1, 1]}, 'boundary_constraints': [text]})
        for text in ('v == v_0', 'v - v_0'))
    assert one.structure == other.structure
    phases = [{'duration': 1, 'path_constraints': ['v <= 1'], 'terminal_constraints': ['p == 1']},
              {'duration': 1}]
    plain = [{'duration': 1, 'path_constraints': [{'expr': 'v', 'upper': 1}],
              'terminal_constraints': ['p - 1']}, {'duration': 1}]
    given = {key: value for key, value in BASE.items() if key != 'final_time'}
    assert build_problem(given | {'phases': phases}).structure == build_problem(
        given | {'phases': plain}).structure


@pytest.mark.slow
@pytest.mark.parametrize(('rows', 'cost'), [
    (['p >= 1'], 3), (['p >= 1', 'v <= 2'], 3), ([['p', 1, None], {'expr': 'v', 'upper': 1}], 4),
    (lambda x: [x.p >= 1, (x.v, 0, 1)], 4), (['p - p_0 >= 1', 'v <= 1'], 4)])
def test_an_inequality_at_the_end_holds(rows, cost):
    """The least effort to reach p >= 1 in 1 s, at any speed, is 3; at v <= 1 it is 4."""
    found = obc.solve(BASE, terminal_constraints=rows)
    assert found.status == 'solved' and found.objective == pytest.approx(cost, abs=1e-5)
    assert list(found.x) == ['p', 'v'] and not found.free_parameters


@pytest.mark.slow
def test_inequalities_at_the_start_and_of_a_phase_hold():
    """From v(0) <= 0 the least effort to p = 1 in 1 s is 3, from v(0) >= 1 it is 0."""
    base = {key: value for key, value in BASE.items() if key != 'final_time'}
    found = [obc.solve(base, **keys, initial_state={'p': 0, 'v': None}, initial_constraints=[
        row]).objective for row in ('v <= 0', 'v >= 1') for keys in (
            {'final_time': 1, 'terminal_constraints': ['p == 1']},
            {'phases': [{'duration': 0.5, 'terminal_constraints': ['p >= -9']},
                        {'duration': 0.5, 'terminal_constraints': ['p >= 1', 'v >= 1']}]})]
    assert found == pytest.approx([3, 3, 0, 0], abs=1e-5)


def test_equal_bounds_at_the_end_are_an_equation():
    row = {'expr': 'p + v', 'lower': 1, 'upper': 1}
    found, plain = (build_problem(BASE | {'terminal_constraints': [each]})
                    for each in (row, 'p + v - 1'))
    assert evaluate(found)[1] == evaluate(plain)[1] and found.n == plain.n


def test_initial_values_at_the_end_make_a_boundary_constraint():
    change = {'initial_state': {'p': 0, 'v': [-1, 1]}}
    found, plain = (build_problem(BASE | change | each) for each in (
        {'terminal_constraints': ['v == v_0', 'p - 1']},
        {'terminal_constraints': ['p - 1'], 'boundary_constraints': ['v - v_0']}))
    assert found.structure == plain.structure and found.ends == plain.ends


@pytest.mark.parametrize('text', [2, '2', 'top - 1'])
def test_a_number_is_a_given_final_time(text):
    found = obc.Problem(BASE, final_time=text)
    assert found.built.final_time.value == 2.0 and not found.built.final_time.free
    assert found.statement['final_time'] == {'free': False, 'value': text}


@pytest.mark.parametrize(('change', 'said'), [
    ({'terminal_constraints': [{'expr': 'p'}]}, r'^terminal_constraints\[0\]: wanted a lower or'),
    ({'terminal_constraints': [{'upper': 1}]}, r'^terminal_constraints\[0\]: expr is missing'),
    ({'terminal_constraints': ['2 <= p <= 1']}, r'^terminal_constraints\[0\]: the bounds cross'),
    ({'terminal_constraints': ['u <= 1']}, r"^terminal_constraints\[0\]: 'u' is an input"),
    ({'terminal_constraints': ['top <= 1']}, r"^terminal_constraints\[0\]: 'top' does not dep"),
    ({'path_constraints': ['1 <= v == 2']}, r"^path_constraints\[0\]: '1 <= v == 2' is not one"),
    ({'path_constraints': ['1 <= v >= 2']}, 'is not one comparison'),
    ({'path_constraints': ['1 >= v <= 2']}, 'is not one comparison'),
    ({'path_constraints': ['u <= v <= 2']}, 'wanted numbers on both sides; write two constraints'),
    ({'path_constraints': ['v <= ']}, 'wanted a mapping such as'),
    ({'path_constraints': ['v <= w']}, r"^path_constraints\[0\]\.expr: unknown name 'w'"),
    ({'path_constraints': ['1 <= 2']}, 'depends on no state and no input'),
    ({'path_constraints': ['v']}, 'wanted a mapping such as'),
    ({'path_constraints': lambda x, u: [x.v != 1]}, 'wanted a mapping such as'),
    ({'path_constraints': lambda x, u: [-1 <= x.v <= 1]}, r'constraint a < b < c as \(b, a, c\)'),
    ({'terminal_constraints': ['p = 1']}, 'write the constraint a = b as a - b'),
    ({'running_cost': 'u <= 1'}, 'comparisons and assignments are not supported')])
def test_what_is_no_constraint_is_refused_in_words(change, said):
    with pytest.raises(StatementError, match=said):
        build_problem(BASE | change)
