# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Systems: derivatives, signs, symmetries, parameters, and systems of other packages."""

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from numpy.testing import assert_allclose
from obc_ros.core.systems import registry
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import DynamicsError, ObcError, StatementError
import pytest

A = [[0.0, 1.0, 0.5], [-2.0, 0.3, 0.0], [0.0, 0.0, -1.0]]
B = [[0.0, 1.0], [2.0, 0.0], [0.0, -3.0]]
CASES = [*((name, {}) for name in registry.list_systems() if name != 'linear'),
         ('linear', {'A': A, 'B': B}), ('brockett', {'m': 2}), ('brockett', {'m': 5})]
value = st.floats(-2.0, 2.0)


@pytest.fixture(params=CASES, ids=lambda case: '-'.join(map(str, (case[0], *case[1].values()))))
def system(request: pytest.FixtureRequest) -> System:
    name, options = request.param
    return registry.get_system(name, **options)


def jacobian_by_differences(function, z, h=1e-3):
    """Return the Jacobian by central differences of order six."""
    weights = (3 / 4, -3 / 20, 1 / 60)
    return np.stack([
        sum(w * (function(z + k * h * e) - function(z - k * h * e))
            for k, w in enumerate(weights, start=1)) / h
        for e in np.eye(z.size)], axis=1)


def test_jacobians_agree_with_differences(system):
    generator = np.random.default_rng(1)
    for _ in range(5):
        x, u = generator.uniform(-1, 1, system.n), generator.uniform(-1, 1, system.m)
        fx, fu = system.jacobians(x, u)
        assert_allclose(
            fx, jacobian_by_differences(lambda z: system.f(z, u), x), atol=1e-9)  # noqa: B023
        assert_allclose(
            fu, jacobian_by_differences(lambda z: system.f(x, z), u), atol=1e-9)  # noqa: B023


def test_names_and_numbers_are_consistent(system):
    assert len(system.setpoint) == system.n
    assert len(system.setpoint_input) == system.m
    assert len(system.angles) == system.n
    names = [*system.state_names, *system.input_names]
    assert len(set(names)) == len(names)
    assert all(system.u_min < system.u_max)
    assert all(lower <= u <= upper for lower, u, upper in
               zip(system.u_min, system.setpoint_input, system.u_max, strict=True))


@pytest.fixture(scope='module')
def aircraft():
    return registry.get_system('aircraft')


def test_aircraft_signs_are_those_of_figure_2_3(aircraft):
    hover = np.array([0.0, 4.0 * 9.8])
    at = dict(zip(aircraft.state_names, range(6), strict=True))

    def f(theta, f1, f2):
        return aircraft.f(np.array([0, 0, theta, 0, 0, 0]), hover + [f1, f2])

    assert_allclose(f(0, 0, 0), 0, atol=1e-15)
    push = f(0, 1, 0)
    assert push[at['vx']] == 1 / 4.0  # to the right
    assert push[at['omega']] == pytest.approx(0.25 / 0.0475)  # counter-clockwise
    lift = f(0, 0, 1)
    assert lift[at['vy']] == pytest.approx(1 / 4.0)  # up
    assert lift[at['vx']] == 0
    tilted = f(0.1, 0, 0)  # counter-clockwise: the thrust points to the left
    assert tilted[at['vx']] == pytest.approx(-9.8 * np.sin(0.1))
    assert tilted[at['vy']] == pytest.approx(9.8 * (np.cos(0.1) - 1))


def test_aircraft_linearization_equals_that_of_the_text(aircraft):
    """AM08, Example 5.12, in coordinates relative to the hover."""
    fx, fu = aircraft.jacobians(np.zeros(6), np.array([0.0, 39.2]))
    m, J, r, g, c = 4.0, 0.0475, 0.25, 9.8, 0.05
    A = np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    A[3, 2], A[3, 3], A[4, 4] = -g, -c / m, -c / m
    B = np.zeros((6, 2))
    B[3, 0], B[4, 1], B[5, 0] = 1 / m, 1 / m, r / J
    assert_allclose(fx, A, atol=1e-14)
    assert_allclose(fu, B, atol=1e-14)


@given(st.tuples(*[value] * 6), st.tuples(value, value))
def test_aircraft_dynamics_are_symmetric_under_reflection(x, u):
    aircraft = registry.get_system('aircraft')
    mirror_x, mirror_u = np.array([-1, 1, -1, -1, 1, -1]), np.array([-1, 1])
    assert_allclose(aircraft.f(mirror_x * x, mirror_u * u),
                    mirror_x * aircraft.f(np.array(x), np.array(u)), atol=1e-12)


@given(st.tuples(*[value] * 6), st.tuples(value, value))
def test_aircraft_energy_grows_by_the_work_of_the_forces(x, u):
    m, J, r, g, c = 4.0, 0.0475, 0.25, 9.8, 0.05
    _, _, theta, vx, vy, omega = x
    f = registry.get_system('aircraft').f(np.array(x), np.array(u))
    growth = m * (vx * f[3] + vy * f[4] + g * f[1]) + J * omega * f[5]
    # The forces act at r below the centre, which moves at v + omega x (r sin, -r cos).
    point = np.array([vx + omega * r * np.cos(theta), vy + omega * r * np.sin(theta)])
    f1, f2 = u
    force = np.array([f1 * np.cos(theta) - f2 * np.sin(theta),
                      f1 * np.sin(theta) + f2 * np.cos(theta)])
    assert growth == pytest.approx(force @ point - c * (vx**2 + vy**2), abs=1e-11)


@pytest.mark.parametrize('name', ['vehicle', 'two_wheeled'])
@given(x=st.tuples(value, value, value), u=st.tuples(value, st.floats(-0.5, 0.5)), turn=value)
def test_planar_vehicles_are_invariant_under_rotation(name, x, u, turn):
    system = registry.get_system(name)
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    moved = rotation @ x + [0, 0, turn]
    assert_allclose(system.f(moved, np.array(u)), rotation @ system.f(np.array(x), np.array(u)),
                    atol=1e-13)


def test_a_left_turn_of_the_vehicle_has_its_closed_form():
    vehicle = registry.get_system('vehicle')
    v, phi, l = 10.0, 0.3, 2.0  # noqa: E741 - the letter of the book
    f = vehicle.f(np.zeros(3), np.array([v, phi]))
    assert_allclose(f, [v, 0, v / (l / np.tan(phi))])
    lateral = registry.get_system('vehicle_lateral', {'v': v, 'l': l})
    assert_allclose(lateral.f(np.array([0, 0.2]), np.array([phi])),
                    vehicle.f(np.array([0, 0, 0.2]), np.array([v, phi]))[1:])


@given(st.lists(value, min_size=4, max_size=4), st.lists(value, min_size=4, max_size=4))
def test_brockett_has_the_skew_product_of_the_exercise(q, u):
    system = registry.get_system('brockett', m=4)
    f = system.f(np.array([*q, *[0.0] * 6]), np.array(u))
    skew = np.outer(q, u) - np.outer(u, q)
    assert_allclose(f[:4], u)
    assert_allclose(f[4:], skew[np.triu_indices(4, 1)], atol=1e-14)


def test_linear_accepts_matrices_as_rows_or_as_numbers():
    system = registry.get_system('linear', A=A, B=B)
    fx, fu = system.jacobians(np.ones(3), np.ones(2))
    assert_allclose(fx, A)
    assert_allclose(fu, B)
    flat = registry.get_system('linear', {'A': np.ravel(A), 'B': tuple(np.ravel(B))})
    assert_allclose(flat.f(np.ones(3), np.ones(2)), np.sum(A, 1) + np.sum(B, 1))


@pytest.mark.parametrize(('options', 'words'), [
    ({}, 'linear.A: wanted n x n numbers'),
    ({'A': [1, 2, 3], 'B': [1]}, 'found 3 numbers'),
    ({'A': [[1, 2]], 'B': [1]}, 'found 1 x 2 numbers'),
    ({'A': [[1, 2], [3]], 'B': [1]}, 'all of one length'),
    ({'A': A, 'B': [[1], [2]]}, 'linear.B: wanted 3 x m numbers'),
    ({'A': [[float('nan')]], 'B': [1]}, 'finite'),
    ({'A': 'x', 'B': [1]}, 'linear.A'),
])
def test_errors_name_faults_of_the_matrices_of_linear(options, words):
    with pytest.raises(DynamicsError, match=words):
        registry.get_system('linear', **options)


@pytest.mark.parametrize('m', [1, 0, -3, 51, 10**9, 2.0, 'x', True])
def test_brockett_rejects_invalid_dimensions(m):
    with pytest.raises(DynamicsError, match='whole number from 2 to 50'):
        registry.get_system('brockett', {'m': m})


def test_options_of_systems_are_listed():
    assert registry.get_options('brockett') == {'m': 3}
    assert set(registry.get_options('linear')) == {'A', 'B', 'states', 'inputs'}
    assert registry.get_options('aircraft') == {}
    with pytest.raises(DynamicsError, match="no option 'A'"):
        registry.get_system('aircraft', A=1)


def test_parameters_change_a_copy_of_the_system(aircraft):
    heavy = registry.get_system('aircraft', {'m': 8})
    assert heavy.p_value[0] == 8.0
    assert aircraft.p_value[0] == 4.0
    u = np.array([8.0, 0.0])
    assert heavy.f(np.zeros(6), u)[3] == 1.0
    assert aircraft.f(np.zeros(6), u)[3] == 2.0


@pytest.mark.parametrize(('name', 'words'), [
    ('mass', "no parameter 'mass'; it has m, J, r, g, c"), ('m', 'aircraft.m = -1: wanted'),
])
def test_errors_name_invalid_parameters(name, words):
    with pytest.raises(DynamicsError, match=words):
        registry.get_system('aircraft', {name: -1.0})


@pytest.mark.parametrize('bad', [float('nan'), float('inf'), -1e300, 'heavy', None, True, [1.0]])
def test_parameter_values_out_of_range_are_rejected(bad):
    with pytest.raises(DynamicsError, match='aircraft.m'):
        registry.get_system('aircraft', {'m': bad})


def test_limits_follow_the_parameters():
    robot = registry.get_system('two_wheeled', {'L': 2.0}).with_parameters({'M': 3.0})
    assert_allclose(robot.u_max, [2, 3])
    assert_allclose(robot.u_min, [-2, -3])
    assert robot.setpoint_input[0] == 1.0
    assert_allclose(robot.p_value, [2, 3])


@pytest.mark.slow
@given(st.text(max_size=30))
def test_errors_name_unknown_systems(name):
    if name not in registry.list_systems():
        with pytest.raises(ObcError):
            registry.get_registered(name)


def test_errors_propose_a_similar_name():
    with pytest.raises(DynamicsError, match="did you mean 'aircraft'"):
        registry.get_system('aircarft')


def test_requests_by_name_do_not_read_files(tmp_path):
    path = tmp_path / 'plant.yaml'
    path.write_text('secret')
    with pytest.raises(DynamicsError, match='unknown system') as error:
        registry.get_registered(str(path))
    assert 'secret' not in str(error.value)


@pytest.fixture
def plugins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install a package that registers valid and broken systems."""
    (tmp_path / 'plug_ins.py').write_text("""
from obc_ros.core.systems.system import define, Signal

def pendulum(length=1.0):
    return define('pendulum', [Signal('theta', 'rad', angle=True), Signal('omega', 'rad/s')],
                  [Signal('u')], [],
                  lambda x, u, p: (x[1], 9.8 / length * x[0] + u[0]))

def lag():
    import obc_ros as obc
    return obc.System(states=['y'], inputs=['u'], parameters={'T': 2},
                      dynamics={'y': '(u - y)/T'})

def impostor():
    return 42

def stumbling():
    return 1 / 0

number = 3
""")
    (tmp_path / 'broken_plug_in.py').write_text('import nothing_of_that_name\n')
    info = tmp_path / 'plug_ins-1.0.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: plug-ins\nVersion: 1.0\n')
    (info / 'entry_points.txt').write_text("""[obc_ros.systems]
pendulum = plug_ins:pendulum
lag = plug_ins:lag
impostor = plug_ins:impostor
stumbling = plug_ins:stumbling
number = plug_ins:number
missing = plug_ins:nothing
broken = broken_plug_in:system
aircraft = plug_ins:impostor
""")
    monkeypatch.syspath_prepend(tmp_path)


def test_another_package_adds_a_system(plugins):
    assert 'pendulum' in registry.list_systems()
    pendulum = registry.get_system('pendulum', {'length': 2.0})
    assert_allclose(pendulum.f(np.array([1.0, 3.0]), np.zeros(1)), [3, 4.9])
    lag = registry.get_system('lag', {'T': 4.0})   # of the public interface
    assert_allclose(lag.f(np.array([1.0]), np.zeros(1)), [-0.25])


@pytest.mark.parametrize(('name', 'words'), [
    ('broken', 'cannot be loaded from broken_plug_in:system of plug-ins: ModuleNotFoundError'),
    ('missing', 'cannot be loaded from plug_ins:nothing'),
    ('impostor', 'returned an object of type int, not a System'),
    ('stumbling', 'cannot be built: ZeroDivisionError'),
    ('number', 'is of type int, not a function'),
])
def test_broken_systems_of_other_packages_are_reported(
        plugins, name, words):
    with pytest.raises(DynamicsError, match=words):
        registry.get_system(name)
    assert registry.get_system('pendulum').n == 2
    assert registry.get_system(
        'aircraft').n == 6, 'the own system goes before one of another package'


PLANT = """
name: pendubot
title: A pendulum on a cart
states: [s, theta, v, omega]
inputs: [force]
parameters: {m: 1, M: 2*m, l: 1/2, g: 9.81}
dynamics:
  s: v
  theta: omega
  v: (force - m*g*theta)/M
  omega: ((M + m)*g*theta - force)/(M*l)
input_bounds: {force: [-10*m, 10*m]}
parameter_bounds: {m: [1e-3, null]}
units: {s: m, theta: rad, m: kg, force: N}
angles: [theta]
setpoint: {s: l}
"""


def test_a_file_defines_a_system(tmp_path):
    path = tmp_path / 'cart.yaml'
    path.write_text(PLANT)
    cart = registry.get_system(str(path))
    assert cart.name == 'pendubot'
    assert cart.state_names == ('s', 'theta', 'v', 'omega')
    assert cart.angles == (False, True, False, False)
    assert cart.states[0].unit == 'm'
    assert_allclose(cart.p_value, [1, 2, 0.5, 9.81])
    assert_allclose(cart.u_max, [10])
    assert cart.setpoint == (0.5, 0, 0, 0)
    x, u = np.array([0.1, 0.2, 0.3, 0.4]), np.array([2.0])
    assert_allclose(cart.f(x, u), [0.3, 0.4, (2 - 9.81 * 0.2) / 2, 3 * 9.81 * 0.2 - 2])


def test_expressions_of_a_file_follow_its_parameters(tmp_path):
    path = tmp_path / 'cart.yaml'
    path.write_text(PLANT)
    cart = registry.get_system(str(path), {'m': 3.0})
    assert_allclose(cart.p_value, [3, 6, 0.5, 9.81])
    assert_allclose(cart.u_max, [30])
    own_mass = cart.with_parameters({'M': 5.0}).with_parameters({'l': 1.0})
    assert_allclose(own_mass.p_value, [3, 5, 1, 9.81])
    assert own_mass.setpoint[0] == 1.0
    with pytest.raises(DynamicsError, match='pendubot.m = 0: wanted'):
        cart.with_parameters({'m': 0.0})


def test_the_aircraft_as_a_file_equals_the_built_in_one(tmp_path, aircraft):
    path = tmp_path / 'mine.yml'
    path.write_text("""
states: [px, py, theta, vx, vy, omega]
inputs: [f1, f2]
parameters: {m: 4, J: 0.0475, r: 0.25, g: 9.8, c: 0.05}
dynamics:
  px: vx
  py: vy
  theta: omega
  vx: (f1*cos(theta) - f2*sin(theta) - c*vx)/m
  vy: (f1*sin(theta) + f2*cos(theta) - c*vy)/m - g
  omega: r*f1/J
plane: vertical
running_cost: px**2
initial_state: {px: 1}
final_time: {free: false, value: 1}
""")
    mine = registry.load_system(path)
    assert mine.name == 'mine'
    assert mine.plane == aircraft.plane
    x, u = np.linspace(0.1, 1, 6), np.array([1.0, 2.0])
    assert_allclose(mine.f(x, u), aircraft.f(x, u), rtol=1e-14)


@pytest.mark.parametrize(('old', 'new', 'words'), [
    ('angles:', 'angels:', r"angels: unknown key \(did you mean 'angles'\?\)"),
    ('  s: v\n', '', "no equation for the state 's'"),
    ('  s: v\n', '  s: w\n', "dynamics.s: unknown name 'w'"),
    ('  s: v\n', '  z: v\n', "dynamics: 'z' is not one of s, theta"),
    ('[force]', '[theta]', "'theta' occurs twice"),
    ('[force]', '[]', 'inputs: the list is empty; wanted at least one name'),
    ('[s, theta, v, omega]', '[s, sin, v, omega]', "the name 'sin' is reserved"),
    ('{m: 1, ', '{m: n, ', "parameters.m: unknown name 'n'"),
    ('{m: 1, ', '{m: 0, ', 'pendubot.m = 0: wanted'),
    ('[-10*m, 10*m]', '[10, -10]', 'the bounds cross'),
    ('[-10*m, 10*m]', '7', r'wanted \[lower, upper\], found int'),
    ('[theta]\nsetpoint', '[phi]\nsetpoint', "angles: 'phi' is not one of"),
    ('name: pendubot', 'name: [1]', 'name: wanted one line of text'),
    ('name: pendubot', 'plane: diagonal', "plane: wanted 'horizontal' or 'vertical'"),
    ('theta: rad', 'theta: [rad]', 'units.theta: wanted a short text'),
    ('{s: l}', '{s: .nan}', 'setpoint.s: nan is not a finite number'),
    ('states:', 'states: {', 'plant.yaml: '),
    (PLANT, '- 1\n- 2\n', 'wanted one mapping of keys, found a list'),
    (PLANT, '', 'wanted one mapping of keys, found nothing'),
])
def test_errors_name_the_file_and_the_key_at_fault(tmp_path, old, new, words):
    path = tmp_path / 'plant.yaml'
    assert old in PLANT
    path.write_text(PLANT.replace(old, new))
    with pytest.raises(StatementError, match=words) as error:
        registry.get_system(str(path))
    assert str(error.value).startswith(str(path))


def test_errors_name_a_missing_file():
    with pytest.raises(StatementError, match='nowhere.yaml: cannot be read'):
        registry.get_system('nowhere.yaml')


def test_a_linear_system_takes_names_of_another_plant():
    """Its states are then those of the messages of that plant."""
    named = registry.get_system('linear', A=[[0, 1], [0, 0]], B=[0, 1], states='py, theta',
                                inputs='phi')
    assert (named.state_names, named.input_names) == (('py', 'theta'), ('phi',))
    for states in ('py', 'py, py', 'py, 2', 'a, b, c'):
        with pytest.raises(DynamicsError, match='linear.states: wanted 2 different names'):
            registry.get_system('linear', A=[[0, 1], [0, 0]], B=[0, 1], states=states)
