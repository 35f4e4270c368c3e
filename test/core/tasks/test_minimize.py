# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Static minima: multipliers substituted, known values, and messages where there is no minimum."""

from math import exp, sqrt

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from obc_ros.core.ocp.solution import Status
from obc_ros.core.tasks.minimize import minimize
from obc_ros.core.text.errors import StatementError
import pytest


def solved(**statement):
    found = minimize(statement)
    assert found.status is Status.SOLVED, found.message
    assert found.certificate.holds
    return found


@settings(max_examples=20, deadline=None)
@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-5, 5))
def test_example_2_1_equals_its_closed_form(a, b, F0):
    found = solved(variables=['x1', 'x2'], parameters={'a': a, 'b': b, 'F0': F0},
                   cost='F0 + (x1 - a)**2 + (x2 - b)**2', equalities=['x1 - x2'])
    np.testing.assert_allclose(found.x, (a + b) / 2, atol=1e-9)
    np.testing.assert_allclose(found.lam, [a - b], atol=1e-9)
    assert found.objective == pytest.approx(F0 + (a - b)**2 / 2)
    assert 'global' in found.message


def test_minima_at_saddles_of_the_lagrangian_are_found():
    found = solved(variables=['x1', 'x2'], cost='x1**2 - x2**2', equalities=['x2'])
    np.testing.assert_allclose(found.x, 0, atol=1e-9)
    np.testing.assert_allclose(found.lam, 0, atol=1e-9)
    assert 'saddle' in found.message


def test_a_stationary_point_that_is_no_minimum_is_not_returned():
    # The guess is exactly the maximum, where the gradient vanishes.
    found = minimize({'variables': ['x', 'y'], 'cost': 'x**2 - y**2 + y**4/1000',
                      'guess': [0, 0]})
    assert found.status is not Status.SOLVED or found.objective < -200


@pytest.mark.parametrize(('statement', 'x', 'F', 'lam', 'mu'), [
    # Hock and Schittkowski 71
    ({'variables': ['a', 'b', 'c', 'd'], 'cost': 'a*d*(a + b + c) + c',
      'equalities': ['a**2 + b**2 + c**2 + d**2 - 40'], 'inequalities': ['25 - a*b*c*d'],
      'bounds': {name: [1, 5] for name in 'abcd'}},
     [1, 4.74299963, 3.82114998, 1.37940829], 17.0140173, [0.16146857], [0.55229366]),
    # Hock and Schittkowski 35: Beale
    ({'variables': ['x', 'y', 'z'], 'bounds': {name: [0, None] for name in 'xyz'},
      'cost': '9 - 8*x - 6*y - 4*z + 2*x**2 + 2*y**2 + z**2 + 2*x*y + 2*x*z',
      'inequalities': ['x + y + 2*z - 3']}, [4 / 3, 7 / 9, 4 / 9], 1 / 9, [], [2 / 9]),
    # Hock and Schittkowski 6
    ({'variables': ['x', 'y'], 'cost': '(1 - x)**2', 'equalities': ['10*(y - x**2)']},
     [1, 1], 0, [0], []),
    # Hock and Schittkowski 39
    ({'variables': ['a', 'b', 'c', 'd'], 'cost': '-a',
      'equalities': ['b - a**3 - c**2', 'a**2 - b - d**2']}, [1, 1, 0, 0], -1, [-1, -1], []),
    ({'variables': ['x', 'y'], 'cost': '(1 - x)**2 + 100*(y - x**2)**2',
      'bounds': {'x': [None, 0.5]}}, [0.5, 0.25], 0.25, [], []),
    ({'variables': ['x'], 'cost': 'x', 'inequalities': ['x**2 - 4']}, [-2], -2, [], [0.25]),
    ({'variables': ['x'], 'cost': '-x**2', 'bounds': {'x': [-1, 2]}}, [2], -4, [], []),
    ({'variables': ['x'], 'cost': 'log(x) + 1/x'}, [1], 1, [], []),
    ({'variables': ['x'], 'cost': 'x**4'}, [0], 0, [], []),
    ({'variables': ['x'], 'cost': '(x - 1)**2', 'bounds': {'x': [3, 3]}}, [3], 4, [], []),
])
def test_known_minima_and_multipliers_are_found(statement, x, F, lam, mu):
    found = solved(**statement)
    np.testing.assert_allclose(found.x, x, atol=1e-6)
    assert found.objective == pytest.approx(F, abs=1e-7)
    np.testing.assert_allclose(found.lam, lam, atol=1e-6)
    np.testing.assert_allclose(found.mu, mu, atol=1e-6)


# W. Hock, K. Schittkowski, Test examples for nonlinear programming codes, Springer 1981.
@pytest.mark.parametrize(('F', 'names', 'cost', 'equalities', 'inequalities', 'bounds'), [
    pytest.param(-6961.81381, 'xy', '(x - 10)**3 + (y - 20)**3', [],
                 ['100 - (x - 5)**2 - (y - 5)**2', '(y - 5)**2 + (x - 6)**2 - 82.81'],
                 {'x': [13, 100], 'y': [0, 100]}, id='19'),
    pytest.param(-26272.51448, 'xyz', '-32.174*(255*log((x + y + z + 0.03)/(0.09*x + y + z'
                 ' + 0.03))'
                 ' + 280*log((y + z + 0.03)/(0.07*y + z + 0.03))'
                 ' + 290*log((z + 0.03)/(0.13*z + 0.03)))', ['x + y + z - 1'], [],
                 {name: [0, 1] for name in 'xyz'}, id='62'),
    pytest.param(5126.4981, 'abcd', '3*a + 1e-6*a**3 + 2*b + 2e-6*b**3/3',
                 ['1000*sin(-c - 0.25) + 1000*sin(-d - 0.25) + 894.8 - a',
                  '1000*sin(c - 0.25) + 1000*sin(c - d - 0.25) + 894.8 - b',
                  '1000*sin(d - 0.25) + 1000*sin(d - c - 0.25) + 1294.8'],
                 ['c - d - 0.55', 'd - c - 0.55'],
                 {'a': [0, 1200], 'b': [0, 1200], 'c': [-0.55, 0.55], 'd': [-0.55, 0.55]},
                 id='74'),
    pytest.param(-2.91970041, 'abcde', 'a*b*c*d*e', ['a**2 + b**2 + c**2 + d**2 + e**2 - 10',
                 'b*c - 5*d*e', 'a**3 + b**3 + 1'], [], {}, id='78'),
    pytest.param(680.6300573, 'abcdefg', '(a - 10)**2 + 5*(b - 12)**2 + c**4 + 3*(d - 11)**2'
                 ' + 10*e**6 + 7*f**2 + g**4 - 4*f*g - 10*f - 8*g', [],
                 ['2*a**2 + 3*b**4 + c + 4*d**2 + 5*e - 127',
                  '7*a + 3*b + 10*c**2 + d - e - 282', '23*a + b**2 + 6*f**2 - 8*g - 196',
                  '4*a**2 + b**2 - 3*a*b + 2*c**2 + 5*f - 11*g'], {}, id='100'),
    pytest.param(7049.24802, 'abcdefgh', 'a + b + c', [],
                 ['0.0025*(d + f) - 1', '0.0025*(e + g - d) - 1', '0.01*(h - e) - 1',
                  '833.33252*d + 100*a - 83333.333 - a*f', '1250*e + b*d - 1250*d - b*g',
                  '1250000 + c*e - 2500*e - c*h'],
                 {'a': [100, 10000], 'b': [1000, 10000], 'c': [1000, 10000],
                  **{name: [10, 1000] for name in 'defgh'}}, id='106'),
])
def test_published_costs_of_hock_and_schittkowski_are_found(
        F, names, cost, equalities, inequalities, bounds):
    found = solved(variables=list(names), cost=cost, equalities=equalities,
                   inequalities=inequalities, bounds=bounds)
    assert found.objective == pytest.approx(F, rel=1e-7)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 5))
def test_quadratic_programs_satisfy_the_kkt_conditions(seed, n):
    rng = np.random.default_rng(seed)
    root, c = rng.normal(size=(n, n)), rng.normal(size=n)
    H = root @ root.T + 0.1 * np.eye(n)
    A, b = rng.normal(size=(2, n)), rng.normal(size=2)
    names = [f'x{i}' for i in range(n)]

    def text(row):
        return ' + '.join(f'{value!r}*{name}' for value, name in zip(row.tolist(), names,
                                                                      strict=True))

    squares = ' + '.join(f'({text(row)})**2/2' for row in root.T)
    quadratic = f'{squares} + 0.05*({" + ".join(name + "**2" for name in names)}) + {text(c)}'
    found = solved(variables=names, cost=quadratic, equalities=[f'{text(A[0])} - {float(b[0])!r}'],
                   inequalities=[f'{text(A[1])} - {float(b[1])!r}'])
    slope = H @ found.x + c + found.lam @ A[:1] + found.mu @ A[1:]
    np.testing.assert_allclose(slope, 0, atol=1e-8)
    assert A[0] @ found.x == pytest.approx(b[0], abs=1e-8)
    assert A[1] @ found.x <= b[1] + 1e-8
    assert found.mu[0] >= 0
    assert found.mu[0] * (A[1] @ found.x - b[1]) == pytest.approx(0, abs=1e-8)


@pytest.mark.slow
def test_multipliers_are_sensitivities_of_the_minimum():
    # A multiplier is the sensitivity dF*/de = -lam for G = e.
    def value(e):
        return solved(variables=['x', 'y'], cost='exp(x) + y**2 + x*y',
                      equalities=[f'x + y**2 - 1 - {e}'])

    middle, h = value(0), 1e-4
    rate = (value(h).objective - value(-h).objective) / (2 * h)
    assert rate == pytest.approx(-middle.lam[0], abs=1e-6)


def test_the_guess_selects_a_local_minimum():
    found = solved(variables=['x'], cost='x**3 - 3*x', guess=[0.5])
    assert found.x == pytest.approx([1])
    assert 'near the guess' in found.message


def test_the_lowest_of_several_local_minima_is_found():
    found = solved(variables=['x'], cost='sin(x) + 0.05*x**2')
    # root of cos x + x / 10 = 0
    assert found.x == pytest.approx([-1.4275517787], abs=1e-6)


@pytest.mark.parametrize(('statement', 'status', 'text'), [
    ({'variables': ['x'], 'cost': 'x', 'inequalities': ['x**2 + 4']}, Status.INFEASIBLE,
     'inequalities[0] (x**2 + 4 <= 0) is violated by 4'),
    ({'variables': ['x', 'y'], 'cost': 'x + y', 'equalities': ['x - 1', 'x - 2']},
     Status.INFEASIBLE, 'is violated by 0.5'),
    # Infeasibility is not proved here, so the status does not claim it.
    ({'variables': ['x', 'y'], 'cost': 'x', 'equalities': ['x**2 + y**2 - 1', 'x*y - 1']},
     Status.NOT_CONVERGED, 'infeasibility has not been proved'),
    ({'variables': ['x'], 'cost': '-x'}, Status.NOT_CONVERGED, 'unbounded below'),
    ({'variables': ['x', 'y'], 'cost': 'x**2 - y**2'}, Status.NOT_CONVERGED, 'unbounded below'),
    ({'variables': ['x'], 'cost': 'x**3 - 3*x'}, Status.NOT_CONVERGED, 'a local minimum is -2'),
    ({'variables': ['x'], 'cost': 'exp(-x)'}, Status.NOT_CONVERGED, 'is not attained'),
    ({'variables': ['x'], 'cost': 'x', 'equalities': ['x**2']}, Status.NOT_CONVERGED,
     'LICQ fails'),
    # Without constraints there is none that is violated most.
    ({'variables': ['x'], 'cost': 'exp(x)*1e300 + x**2'}, Status.NOT_CONVERGED, 'from 12 starts'),
    # Hock and Schittkowski 13: the minimum x = 1 is a cusp without multipliers.
    ({'variables': ['x', 'y'], 'cost': '(x - 2)**2 + y**2', 'inequalities': ['y - (1 - x)**3'],
      'bounds': {'x': [0, None], 'y': [0, None]}}, Status.NOT_CONVERGED, 'LICQ fails'),
])
def test_messages_explain_why_no_minimum_is_found(statement, status, text):
    found = minimize(statement)
    assert found.status is status
    assert text in found.message


def test_multipliers_that_are_not_unique_are_reported():
    found = solved(variables=['x', 'y'], cost='x**2 + y**2',
                   inequalities=['1 - x - y', '2 - 2*x - 2*y'])
    np.testing.assert_allclose(found.x, 0.5, atol=1e-9)
    assert found.mu[0] + 2 * found.mu[1] == pytest.approx(1)
    assert 'LICQ fails' in found.message


def test_scaling_the_cost_scales_the_multipliers():
    def found(scale):
        return solved(variables=['x', 'y'], parameters={'s': scale}, cost='s*((x - 2)**2 + y**2)',
                      equalities=['x**2 + y**2 - 1'])

    once, scaled = found(1), found(1e3)
    np.testing.assert_allclose(once.x, [1, 0], atol=1e-8)
    np.testing.assert_allclose(scaled.lam, 1e3 * once.lam, rtol=1e-8)


def test_no_random_feasible_point_is_lower():
    found = solved(variables=['x', 'y'], cost='exp(x) + y**4 - x*y',
                   inequalities=['x**2 + y**2 - 4'])
    points = np.random.default_rng(1).uniform(-2, 2, (2000, 2))
    x, y = points[np.sum(points**2, axis=1) <= 4].T
    assert (np.exp(x) + y**4 - x * y).min() >= found.objective - 1e-9


def test_time_limit_and_cancellation_end_the_search():
    question = {'variables': ['x', 'y'], 'cost': 'sin(10*x)*sin(10*y) + x**2 + y**2'}
    assert minimize(question, time_limit=0).status is Status.TIMED_OUT
    assert minimize(question, report=lambda *_: True).status is Status.CANCELLED


@pytest.mark.parametrize(('statement', 'text'), [
    ([], 'minimize: wanted a mapping'),
    ({'variables': ['x'], 'cost': 'x', 'bound': {}}, 'bound: unknown key'),
    ({'cost': 'x'}, 'variables: missing; wanted a list of names'),
    ({'variables': [], 'cost': 'x'}, 'variables: the list is empty'),
    ({'variables': ['x', 'x'], 'cost': 'x'}, "'x' occurs twice"),
    ({'variables': ['sin'], 'cost': '1'}, "'sin' is reserved"),
    ({'variables': ['x']}, 'cost: missing'),
    ({'variables': ['x'], 'cost': 'y'}, 'cost'),
    ({'variables': ['x'], 'cost': '__import__("os")'}, 'cost'),
    ({'variables': ['x'], 'cost': 'x', 'equalities': 'x'}, 'equalities: wanted a list'),
    ({'variables': ['x'], 'cost': 'x', 'equalities': ['x', 'z']}, r'equalities\[1\]'),
    ({'variables': ['x'], 'cost': 'x', 'bounds': {'y': [0, 1]}}, "'y' is not a variable"),
    ({'variables': ['x'], 'cost': 'x', 'bounds': {'x': [1, 0]}}, 'the bounds cross'),
    ({'variables': ['x'], 'cost': 'x', 'bounds': {'x': [float('nan'), 0]}}, 'bounds.x'),
    ({'variables': ['x'], 'cost': 'x', 'bounds': {'x': 3}},
     r'bounds.x: wanted \[lower, upper\], found int'),
    ({'variables': ['x'], 'cost': 'x', 'guess': [1, 2]}, 'guess: 2 numbers for 1 variables'),
    ({'variables': ['x'], 'cost': 'x', 'guess': [float('inf')]}, 'guess'),
    ({'variables': ['x'], 'cost': 'a*x', 'parameters': {'a': 'b'}}, 'parameters.a'),
    ({'variables': ['x'], 'cost': 'x', 'parameters': {'x': 1}}, "'x' is a variable too"),
])
def test_malformed_statements_are_rejected(statement, text):
    with pytest.raises(StatementError, match=text):
        minimize(statement)


def test_parameters_may_depend_on_earlier_ones():
    found = solved(variables=['x'], parameters={'a': 'sqrt(2)', 'b': 'a*exp(1)'},
                   cost='(x - b)**2', bounds={'x': ['-b', 'a']})
    assert found.x == pytest.approx([sqrt(2)])
    assert found.objective == pytest.approx(2 * (exp(1) - 1)**2)
