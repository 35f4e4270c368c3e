# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tables of data in expressions: their values, the mesh, closed forms, and what is refused."""

import casadi as ca
import numpy as np
import obc_ros as obc
from obc_ros.core.numerics.enclosures.interval_arithmetic import enclose_outputs
from obc_ros.core.ocp.data_tables import DataTable
from obc_ros.core.ocp.statement import build_problem, load_file
from obc_ros.core.solver.exact.weak_duality import is_excluded
from obc_ros.core.solver.linear_quadratic import solve_lq
from obc_ros.core.solver.proofs.contradictions import explain_contradiction
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh, keep_breaks
from obc_ros.core.text.errors import StatementError
from obc_ros.core.text.example_files import find_example
import pytest
from scipy import optimize, sparse
from scipy.interpolate import CubicSpline

T, Y = np.arange(9.0), np.array([3.0, 1, 4, 1, 5, 2, 6, 5, 3])
BASE = {'states': ['p'], 'inputs': ['u'], 'dynamics': {'p': 'u'}, 'initial_state': [0],
        'running_cost': 'price(t)*u**2', 'terminal_constraints': ['p - 1'], 'final_time': 8}


def state(**changes):
    return BASE | {'tables': {'price': {'t': T.tolist(), 'value': Y.tolist()} | changes}}


def reference(method):
    """Return a table as a function of numbers, by other means."""
    return {'linear': lambda a: np.interp(a, T, Y), 'cubic': CubicSpline(T, Y),
            'steps': lambda a: Y[np.clip(np.floor(a).astype(int), 0, 8)]}[method]


@pytest.mark.parametrize('method', ['linear', 'cubic', 'steps'])
def test_a_table_has_the_values_of_its_method(method):
    a = ca.SX.sym('a')
    y = DataTable('price', T, Y, method).evaluate(a)
    at = np.linspace(0.001, 7.999, 1234)
    found = ca.Function('y', [a], [y, ca.gradient(y, a)]).map(len(at))(at[None])
    expected = reference(method)
    np.testing.assert_allclose(found[0].full()[0], expected(at), rtol=1e-13)
    if method == 'cubic':
        np.testing.assert_allclose(found[1].full()[0], expected(at, 1), rtol=1e-11, atol=1e-12)


def test_the_bounds_of_a_table_contain_it():
    rng, a = np.random.default_rng(5), ca.SX.sym('a')
    for method in ('linear', 'cubic', 'steps'):
        program = ca.Function('y', [a], [DataTable('price', T, Y, method).evaluate(a)])
        for _ in range(20):
            low, high = np.sort(rng.uniform(0, 8, 2))
            [bounds] = enclose_outputs(program, [(np.array([low]), np.array([high]))])
            values = reference(method)(np.linspace(low, high, 99))
            assert bounds.low <= values.min() and values.max() <= bounds.high


@pytest.mark.parametrize(('argument', 'final', 'knots'), [
    ('t', 8, range(1, 8)), ('2*t', 3, [0.5, 1, 1.5, 2, 2.5]), ('8 - t', 8, range(1, 8)),
    ('t*slow + 1', 9, [4, 8]), ('t - 1 + 1', 2.5, [1, 2])])
def test_knots_are_points_of_every_mesh(argument, final, knots):
    problem = build_problem(state() | {
        'running_cost': f'price({argument})*u**2', 'parameters': {'slow': 0.25},
        'final_time': final})
    assert problem.edges.shape == (len(knots), 2)
    np.testing.assert_allclose(problem.edges.mean(axis=1), list(knots), atol=1e-5)
    duration = problem.final_time.value
    mesh = keep_breaks(problem, build_uniform_mesh(problem, 33, 0), duration)
    times = duration * np.append(0.0, np.cumsum(mesh.fractions))
    assert all(np.abs(times - each).min() < 1e-12 * duration for each in problem.edges.ravel())
    assert problem.edges_in(times).sum() == len(knots)
    assert not problem.edges_in(np.linspace(0, duration, 2 * len(knots))).any()
    again = keep_breaks(problem, mesh, duration)
    np.testing.assert_allclose(again.fractions, mesh.fractions, atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize('method', ['linear', 'cubic', 'steps'])
def test_the_least_cost_at_a_price_that_varies(method):
    """With u = lam/(2 price) and p(8) = 1 the cost is 1/(the integral of 1/price)."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    at = (T[:-1, None] + (1 + nodes) / 2).ravel()
    least = 1 / (np.tile(weights / 2, 8) @ (1 / reference(method)(at)))
    found = obc.solve(state(method=method))
    assert found.status == 'solved' and found.objective == pytest.approx(least, rel=1e-6)


@pytest.mark.slow
def test_a_table_of_a_state_is_a_function_of_it():
    """Not-a-knot splines reproduce x^2; the integral of u^2 + x^2 from x = 1 is tanh T."""
    px = np.linspace(-1, 2, 13)
    found = obc.solve(states=['p'], inputs=['u'], dynamics={'p': 'u'}, initial_state=[1],
                      running_cost='u**2 + hill(p)', final_time=2,
                      tables={'hill': (px, px**2, 'cubic')})
    assert found.status == 'solved' and found.objective == pytest.approx(np.tanh(2), rel=1e-6)


@pytest.mark.slow
def test_a_free_final_time_and_phases_take_tables():
    """A unit of path at speed 1 + t takes sqrt(3) - 1; two phases at the same price cost it."""
    speed = {'speed': ([0, 4], [1, 5])}
    found = obc.solve(BASE | {'running_cost': '1', 'dynamics': {'p': 'speed(t)*u'},
                              'input_bounds': {'u': [0, 1]}}, tables=speed,
                      final_time={'free': True, 'lower': 0.1, 'upper': 4})
    assert found.objective == pytest.approx(np.sqrt(3) - 1, rel=1e-6)
    whole = {key: value for key, value in state(method='steps').items() if key != 'final_time'}
    least = 1 / (1 / Y[:-1]).sum()
    found = obc.solve(whole, phases=[{'duration': 3}, {'duration': 5}])
    assert found.objective == pytest.approx(least, rel=1e-6)


def test_columns_of_a_file_are_a_table(tmp_path):
    (tmp_path / 'day.csv').write_text('hour,sun,price\n0,9,3\n4,9,5\n8,9,1\n')
    text = ('states: [p]\ninputs: [u]\ndynamics: {p: u}\nrunning_cost: price(t)*u**2\n'
            'initial_state: [0]\nfinal_time: 8\ntables: {price: {file: day.csv, columns: [hour, '
            'price]}}\n')
    (tmp_path / 'day.yaml').write_text(text)
    found = obc.Problem.from_file(tmp_path / 'day.yaml')
    assert found.statement['tables']['price'] == {'argument': [0, 4, 8], 'value': [3, 5, 1]}
    with pytest.raises(StatementError, match='files are read beside a problem file only'):
        obc.Problem.from_text(text)
    for file, said in (('none.csv', 'cannot be read: No such file'), ('../day.csv', 'beside this'),
                       ('day.csv, columns: [hour, rain]', 'wanted two of hour, sun, price')):
        (tmp_path / 'bad.yaml').write_text(text.replace('day.csv, columns: [hour, price]', file))
        with pytest.raises(StatementError, match=said):
            obc.Problem.from_file(tmp_path / 'bad.yaml')
    (tmp_path / 'day.csv').write_text('hour,sun,price\n0,9,3\n4,9,\n')
    with pytest.raises(StatementError, match='a row of day.csv has no number for hour or'):
        obc.Problem.from_file(tmp_path / 'day.yaml')


@pytest.mark.parametrize(('change', 'said'), [
    (state(t=[0, 1, 1, 3, 4, 5, 6, 7, 8]), r'^tables\.price\.t: wanted increasing numbers'),
    (state(value=[1, 2]), r'^tables\.price: 9 arguments and 2 values'),
    (state(value=[np.nan] * 9), r'^tables\.price\.value\[0\]: wanted a finite number'),
    (state(value=[10**400] * 9), r'^tables\.price\.value\[0\]: wanted a finite number, up to'),
    (state(value=['a'] * 9), r"^tables\.price\.value\[0\]: .* found str 'a'"),
    (state(method='step'), r"^tables\.price\.method: .* \(did you mean 'steps'\?\)"),
    (state(v=[1]), r'^tables\.price: wanted {t: .* found the keys t, v'),
    (state(t=[0]), r'^tables\.price\.t: wanted two numbers or more'),
    (BASE | {'tables': {'price': 5}}, r"^tables\.price: wanted {t: .* found int '5'"),
    (BASE | {'running_cost': 1, 'tables': {'p': [[0, 1], [0, 1]]}},
     r'^tables\.p: the name is one of a state'),
    (BASE | {'running_cost': 1, 'tables': {'sin': [[0, 1], [0, 1]]}},
     "^tables: the name 'sin' is reserved"),
    (state() | {'final_time': 9},
     r'^tables\.price: its argument goes from 0 to 9 until T = 9, but the table from 0 to 8'),
    (state() | {'running_cost': 'price(p)*u**2'}, 'its argument, p, is not .* method: cubic$'),
    (state() | {'running_cost': 'price(t**2/8)'}, 'is not the time or affine in it'),
    (state() | {'running_cost': 'price*u**2'}, "the function 'price' needs its argument"),
    (state() | {'running_cost': 'price(t, p)'}, 'price takes 1 argument$'),
    (state(method='steps') | {'final_time': {'free': True, 'lower': 1, 'upper': 8}},
     r'^tables\.price: steps need a given final time')])
def test_a_wrong_table_is_refused_in_words(change, said):
    with pytest.raises(StatementError, match=said) as error:
        build_problem(change)
    assert '\n' not in str(error.value)

def program(day, per, tangents):
    """
    Return the least cost of the example as a linear program, by the implicit midpoint rule.

    Squares are the largest of their tangents, hence lower bounds.
    """
    N, price, outside = 96 * per, day['tables']['price'], day['tables']['outside']
    h, k = 24 / N, np.arange(N)
    prices = np.repeat(price['value'], per)
    weather = CubicSpline(outside['t'], outside['value'])((k + 0.5) * h)
    first = dict(zip(('P', 'c', 'd', 'Ti', 'E'), (0, N, 2 * N, 3 * N, 4 * N + 1), strict=True))
    squares = 5 * N + 2
    cost, bounds = np.zeros(squares + 5 * N), np.full((squares + 5 * N, 2), [-np.inf, np.inf])
    bounds[squares:, 0] = 0.0

    def rows(*parts):
        entries = [(np.full(N, factor), (k, at + k)) for at, factor in parts]
        return sum(sparse.coo_matrix(each, (N, len(cost))) for each in entries)

    for name, sign, most in (('P', 1, 4), ('c', 1, 1.5), ('d', -1, 1.5)):
        cost[first[name] + k], bounds[first[name] + k] = sign * prices * h, (0, most)
    for name, value in (('Ti', 20), ('E', 2)):
        bounds[[first[name], first[name] + N]] = value
    half, (Ti, E) = 0.25 / 4 * h / 2, (first['Ti'], first['E'])
    equations = sparse.vstack([
        rows((Ti + 1, 1 + half), (Ti, half - 1), (first['P'], -0.75 * h)),
        rows((E + 1, 1.0), (E, -1.0), (first['c'], -0.95 * h), (first['d'], h / 0.95))])
    limits, values = [], []
    for j, (name, weight, middle, low, high) in enumerate((
            ('P', 0.02, 0, 0, 4), ('c', 0.02, 0, 0, 1.5), ('d', 0.02, 0, 0, 1.5),
            ('Ti', 0.02, 21, 17, 25), ('E', 0.01, 2.5, -1, 6))):
        cost[squares + j * N + k] = weight * h
        for at in np.linspace(low, high, tangents) - middle:
            of = [(first[name], 2 * at)] if j < 3 else [(first[name], at), (first[name] + 1, at)]
            limits.append(rows(*of, (squares + j * N, -1.0)))
            values.append(np.full(N, at**2 + 2 * at * middle))
    found = optimize.linprog(
        cost, sparse.vstack(limits).tocsc(), np.concatenate(values), equations.tocsc(),
        np.concatenate([2 * half * weather, np.zeros(N)]), bounds, method='highs')
    assert found.status == 0
    return found.fun


@pytest.mark.slow
def test_a_day_of_prices_costs_what_a_linear_program_finds():
    """The tangents lose at most 3.6e-3: weight times a quarter of their distances squared."""
    day, = load_file(find_example('house_and_battery'))
    found = obc.solve(day)
    assert found.status == 'solved'
    assert -1e-3 < found.objective - program(day, 1, 61) < 3.6e-3 + 1e-3


MOVE = {'states': ['p'], 'inputs': ['u'], 'dynamics': {'p': 'u'}, 'initial_state': [0],
        'running_cost': 'u**2', 'terminal_constraints': ['p - 1'], 'final_time': 2}
FREE = {'final_time': {'free': True, 'lower': 0.1, 'upper': 20}}


@pytest.mark.slow
@pytest.mark.parametrize(('price', 'whole'), [
    ('1 + max(t - 1, 0)', 1 + np.log(2)), ('2 - min(t, 1)', np.log(2) + 1),
    ('2 + sign(t - 0.7)', 0.7 + 1.3 / 3), ('2 + sign(sin(3*t))', np.pi / 9 + 2 - np.pi / 3),
    ('if(0.5 < t, 3, 1)', 1), ('if(t < 0.35*T, 1, 3)', 0.7 + 1.3 / 3),
    ('ramp(t/T)', np.log(3)), ('if (t >= s, if(t < 1.75, 1, 2), 3)', 0.5 + 0.25 + 0.125)])
def test_what_switches_with_the_time_is_exact(price, whole):
    """`whole` is the integral of 1/price; its reciprocal is the least cost."""
    found = obc.solve(MOVE, running_cost=f'({price})*u**2', parameters={'s': 1.5},
                      tables={'ramp': ([0, 0.5, 1], [1, 3, 1])})
    assert found.status == 'solved' and found.objective == pytest.approx(1 / whole, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(('change', 'cost'), [
    ({'running_cost': '(1 + T)*u**2'}, 1.5), ({'terminal_constraints': ['p - T']}, 2),
    ({'terminal_cost': 'T**2'}, 4.5), ({'dynamics': {'p': 'u*t/T'}}, 1.5),
    ({'dynamics': {'p': 'T*u'}, 'parameters': {'T': 3}}, 1 / 18),   # the name is taken
    ({'running_cost': 'u**2 + T/4'} | FREE, 2**(-1 / 3) + 2**(2 / 3) / 4),
    ({'terminal_cost': 'T**2/4'} | FREE, 2**(-1 / 3) + 2**(2 / 3) / 4),
    ({'running_cost': 'T*u**2', 'final_time': None, 'phases': [{'duration': 1}] * 2}, 1)])
def test_the_final_time_is_a_name(change, cost):
    """The least integral of u^2 to p(T) = 1 is 1/T; 1/T + T^2/4 is least at T^3 = 2."""
    found = obc.solve(MOVE | change)
    assert found.status == 'solved' and found.objective == pytest.approx(cost, rel=1e-6)
    assert not found.free_parameters


@pytest.mark.parametrize(('cost', 'said'), [
    ('sign(u)', '^running_cost: sign and if may switch with the time only'),
    ('if(p < 1, 1, 2)*u**2', '^running_cost: sign and if may switch with the time only'),
    ('if(t, 1, 2)', r"'if\(t, 1, 2\)': write if\(a < b, c, d\)$"),
    ('if(t < 1, 2)', r'write if\(a < b, c, d\)$'), ('if(t < 1 < 2, 1, 2)', 'write if'),
    ('foo(u)', 'known functions: sin, .* max, min, sign, if$'),
    ('(t < 1)*u**2', 'comparisons and assignments are not supported'),
    ('if(t < 1, t < 2, 1)', "'t < 2' is not arithmetic")])
def test_what_cannot_switch_is_refused_in_words(cost, said):
    with pytest.raises(StatementError, match=said):
        build_problem(MOVE | {'running_cost': cost})
    with pytest.raises(StatementError, match='^sign and if need a given final time'):
        build_problem(MOVE | FREE | {'running_cost': 'sign(t - 1)*u**2'})
    with pytest.raises(StatementError, match="^dynamics.p: 'if' is not a function"):
        obc.lqr(obc.Problem(MOVE, dynamics={'p': 'u + if(t < 1, 0, 1)'}), [[1]], [[1]])
    with pytest.raises(StatementError, match="^boundary_constraints.* unknown name 'T'"):
        build_problem(MOVE | {'boundary_constraints': ['p - p_0 - T']})


@pytest.mark.parametrize('change', [
    {'dynamics': {'p': 'u + if(t < 4, 0, 1)'}, 'terminal_constraints': ['p - 4.5']},
    {'dynamics': {'p': 'u + step(t)'}, 'terminal_constraints': ['p - 4.5']},
    {'terminal_constraints': ['p - if(t < 4, 20, 0.5)']},
    {'path_constraints': ['p >= -step(t)'], 'terminal_constraints': ['p + 0.1']}])
def test_nothing_is_proved_with_the_first_value_of_a_step(change):
    """The derivative of a step is 0, but a problem with one is neither affine nor impossible."""
    stated = MOVE | {'tables': {'step': ([0, 4, 8], [0, 1, 1], 'steps')}, 'final_time': 8} | change
    assert solve_lq(build_problem(stated)) is None
    bounded = build_problem(stated | {'input_bounds': {'u': [-0.1, 0.1]}})
    assert not explain_contradiction(bounded) and not is_excluded(bounded)
