# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Equilibria substituted into f, moving ones integrated, and messages of errors."""

from hypothesis import assume, given
from hypothesis import strategies as st
import numpy as np
from numpy.testing import assert_allclose
from obc_ros.core.systems import registry
from obc_ros.core.systems.equilibrium import find_equilibrium, linearize
from obc_ros.core.text.errors import DynamicsError
import pytest

value = st.floats(-5.0, 5.0)
A, B = [[0.0, 1.0], [-2.0, 3.0]], [[0.0], [1.0]]


@pytest.mark.parametrize('name', registry.list_systems())
def test_every_system_is_in_equilibrium_at_its_set_point(name):
    system = registry.get_system(name, **({'A': A, 'B': B} if name == 'linear' else {}))
    found = find_equilibrium(system)
    f = system.f(found.x, found.u)
    assert_allclose(f, found.drift, atol=1e-12)
    assert_allclose(found.x, system.setpoint)
    later = found.x + 7.0 * found.drift
    assert_allclose(system.f(later, found.u), found.drift, atol=1e-12)


@pytest.mark.slow
@given(st.tuples(value, value), st.floats(0.5, 20.0), st.floats(1.0, 20.0))
def test_the_aircraft_hovers_at_any_position_with_its_weight(position, m, g):
    aircraft = registry.get_system('aircraft', {'m': m, 'g': g})
    found = find_equilibrium(aircraft, [*position, 0, 0, 0, 0])
    assert_allclose(found.u, [0, m * g], rtol=1e-13, atol=1e-13)
    assert not found.drift.any()


def test_the_aircraft_cannot_hover_tilted():
    with pytest.raises(DynamicsError) as error:
        find_equilibrium(registry.get_system('aircraft'), [1, 2, 0.3, 0, 0, 0])
    words = str(error.value)
    assert words.startswith(
        'found no equilibrium of the aircraft at theta = 0.3 rad: the best input, f1 = ')
    assert 'dvx/dt = -2.7' in words
    assert 'domega/dt = ' in words
    assert 'm/s^2' in words


def test_the_aircraft_leans_against_its_drag():
    """For constant speed against drag, f1 = 0 and tan(theta) = -c v / (m g)."""
    aircraft = registry.get_system('aircraft')
    with pytest.raises(DynamicsError, match='vx = 3 m/s'):
        find_equilibrium(aircraft, [0, 0, 0, 3.0, 0, 0])
    drag, weight = 0.05 * 3.0, 4.0 * 9.8
    found = find_equilibrium(aircraft, [0, 0, -np.arctan(drag / weight), 3.0, 0, 0])
    assert_allclose(found.u, [0, np.hypot(drag, weight)], rtol=1e-12, atol=1e-12)
    assert_allclose(found.drift, [3, 0, 0, 0, 0, 0], atol=1e-13)


@pytest.mark.slow
@given(st.floats(-3.0, 3.0), st.floats(0.1, 30.0))
def test_the_vehicle_moves_along_its_heading_at_the_speed(theta, v):
    vehicle = registry.get_system('vehicle')
    found = find_equilibrium(vehicle, [1, 2, theta], [v, 0.2])
    assert_allclose(found.u, [v, 0], atol=1e-12)
    assert_allclose(found.drift, [v * np.cos(theta), v * np.sin(theta), 0], atol=1e-12)


def test_drift_is_only_in_states_that_f_does_not_depend_on():
    integrator = registry.get_system('double_integrator')
    assert_allclose(find_equilibrium(integrator, [1, 2]).drift, [2, 0])
    stable = registry.get_system('linear', A=A, B=B)  # here x1 enters f: it may not drift
    with pytest.raises(DynamicsError, match='dx1/dt = '):
        find_equilibrium(stable, [1, 2])
    assert_allclose(find_equilibrium(registry.get_system('scalar', {'a': 0.0}), [3.0]).u, [0])


@given(st.floats(-3, 3), st.floats(0.1, 3), st.floats(0.1, 3))
def test_the_cubic_has_an_equilibrium_at_any_state(x, a, b):
    found = find_equilibrium(registry.get_system('cubic', {'a': a, 'b': b}), [x])
    held, given = a * x**3, b * found.u[0]   # dx/dt = -a x^3 + b u
    assert abs(given - held) <= 1e-10 * (1e-3 + abs(held) + abs(given))


@pytest.mark.slow
@given(st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_linear_systems_have_equilibria_where_these_exist(n, seed):
    generator = np.random.default_rng(seed)
    A, B = generator.normal(size=(n, n)), generator.normal(size=(n, n))
    assume(np.linalg.cond(B) < 1e4)
    x = generator.normal(size=n)
    found = find_equilibrium(registry.get_system('linear', A=A, B=B), x)
    assert_allclose(A @ x + B @ found.u, found.drift, atol=1e-8)


def test_equilibria_beyond_the_input_limits_are_rejected(tmp_path):
    path = tmp_path / 'lift.yaml'
    path.write_text('states: [h, v]\ninputs: [u]\ndynamics: {h: v, v: u - 9.8}\n'
                    'input_bounds: {u: [0, 9]}\nunits: {u: m/s^2}\n')
    with pytest.raises(DynamicsError, match=r'needs u = 9.8 m/s\^2: u is limited to \[0, 9\]'):
        find_equilibrium(registry.load_system(path))


def test_a_start_with_zero_gradient_still_leads_to_equilibrium(tmp_path):
    path = tmp_path / 'square.yaml'
    path.write_text('states: [x]\ninputs: [u]\ndynamics: {x: u**2 - x}\n')
    found = find_equilibrium(registry.load_system(path), [4.0])
    assert abs(found.u[0]) == pytest.approx(2.0, rel=1e-9)


def test_points_at_which_f_is_undefined_are_reported(tmp_path):
    path = tmp_path / 'root.yaml'
    path.write_text('states: [x]\ninputs: [u]\ndynamics: {x: sqrt(x) + u}\n')
    root = registry.load_system(path)
    with pytest.raises(DynamicsError, match='at x = -1: f is undefined there'):
        find_equilibrium(root, [-1.0])
    with pytest.raises(DynamicsError, match='derivative of dx/dt with respect to x is inf'):
        linearize(root, np.zeros(1), np.zeros(1))


@pytest.mark.parametrize(('x', 'u', 'words'), [
    ([0, 0], None, r'wanted 6 numbers \(px, py, theta, vx, vy, omega\), found 2'),
    ([0, 0, np.nan, 0, 0, 0], None, 'set point of aircraft: theta = nan'),
    (None, [0, np.inf], 'input of aircraft: f2 = inf'),
    (None, [0], r'wanted 2 numbers \(f1, f2\), found 1'),
    ('hover', None, 'wanted numbers for px'),
])
def test_malformed_set_points_are_rejected_with_a_message(x, u, words):
    with pytest.raises(DynamicsError, match=words):
        find_equilibrium(registry.get_system('aircraft'), x, u)
