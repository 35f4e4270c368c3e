# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sweeps of regulators: closed forms of the simulated loops, keys, refusals."""

from math import exp, pi, sqrt

import numpy as np
from obc_ros.api.sweep import sweep
from obc_ros.core.text.errors import ObcError
from obc_ros.sweep.closed_loops import simulate_regulator
from obc_ros.sweep.dataset import LOOP_STATUSES
from obc_ros.sweep.regulator_numbers import RegulatorNumbers
import pytest

SCALAR = {'A': [[1]], 'B': [[2]], 'Qx': [3], 'Qu': [5]}
DOUBLE = {'A': [[0, 1], [0, 0]], 'B': [[0], [1]], 'Qx': [1, 0], 'Qu': [1]}
AIRCRAFT = {'system': 'aircraft', 'Qx': [1, 1, 1, 1, 1, 1], 'Qu': [1, 1]}


def solve(case, **values):
    """Return the numbers of a closed loop; `__` in a name stands for a dot."""
    numbers = RegulatorNumbers(case)
    chosen = {key.replace('__', '.'): value for key, value in values.items()}
    for key in chosen:
        numbers.check_key(key)
    return simulate_regulator(numbers.vary(chosen))


@pytest.mark.parametrize(('a', 'b', 'q', 'r', 'x0'), [
    (1.0, 2.0, 3.0, 5.0, 0.7), (-1.0, 0.5, 1.0, 1.0, -2.0)])
def test_the_cost_of_a_scalar_loop_with_the_plant_of_the_design(a, b, q, r, x0):
    P = r * (a + sqrt(a**2 + b**2 * q / r)) / b**2
    found = solve(SCALAR, A__0__0=a, B__0__0=b, Qx__0=q, Qu__0=r, x0__x1=x0)
    assert found['gain'] == [pytest.approx(b * P / r)]
    assert found['optimal_cost'] == pytest.approx(P * x0**2)
    # after the time T the cost P x(T)^2 is left
    left = P * (x0 * exp(-sqrt(a**2 + b**2 * q / r) * found['duration']))**2
    assert found['J'] == pytest.approx(P * x0**2 - left, rel=1e-8)
    assert found['decay'] == pytest.approx(sqrt(a**2 + b**2 * q / r)) and found['settled'] == 1


@pytest.mark.parametrize('a', [-3.0, 1.5, 2.4])
def test_the_cost_of_a_scalar_loop_with_another_plant(a):
    gain = solve(SCALAR)['gain'][0]
    found = solve(SCALAR, plant__A__0__0=a, x0__x1=1.0, T=400.0)
    assert found['gain'] == [gain]   # the design does not know of the other plant
    assert found['decay'] == pytest.approx(2 * gain - a)
    assert found['J'] == pytest.approx((3 + 5 * gain**2) / (2 * (2 * gain - a)), rel=1e-7)


def test_a_parameter_error_can_make_the_loop_unstable():
    gain = solve(SCALAR)['gain'][0]
    found = solve(SCALAR, plant__A__0__0=2 * gain + 0.5, T=100.0)
    assert found['decay'] == pytest.approx(-0.5) and found['J'] == np.inf
    assert found['settled'] == 0


def test_the_overshoot_of_a_double_integrator():
    """K = (1, sqrt 2): damping sqrt(1/2), and exp(-pi) of the first error beyond the goal."""
    found = solve(DOUBLE, x0__x1=2.0)
    assert found['gain'] == pytest.approx([1.0, sqrt(2.0)])
    assert found['overshoot'][0] == pytest.approx(exp(-pi), rel=1e-4)
    assert np.isnan(found['overshoot'][1])   # it begins without an error
    assert found['peak'] == [pytest.approx(2.0)] and found['J'] == pytest.approx(
        found['optimal_cost'], rel=1e-6)


def test_the_limits_of_the_inputs_hold_in_the_simulation():
    small, large = (solve({'system': 'vehicle', 'Qx': [1, 1, 1], 'Qu': [1, 1],
                           'setpoint': [0, 0, 0], 'setpoint_input': [5, 0]},
                          x0__py=start, T=5.0) for start in (0.1, 20.0))
    assert small['peak'][1] < 0.6 and large['peak'][1] == pytest.approx(0.6)


def test_a_parameter_belongs_to_the_design_or_to_the_plant_alone():
    nominal, both, plant = (
        solve(AIRCRAFT, **values) for values in ({}, {'m': 5}, {'plant__m': 5}))
    assert plant['gain'] == nominal['gain'] != both['gain']
    assert plant['decay'] != nominal['decay']


@pytest.mark.parametrize(('case', 'key', 'words'), [
    (AIRCRAFT, 'plant.mm', "did you mean 'plant.m'"), (AIRCRAFT, 'Qx.6', "did you mean 'Qx."),
    (AIRCRAFT, 'Qx', 'no number'), (DOUBLE, 'm', 'no number'), (AIRCRAFT, 'x0.pz', 'did you')])
def test_an_unknown_key_is_refused_in_words(case, key, words):
    with pytest.raises(ObcError, match=words):
        RegulatorNumbers(case).check_key(key)


@pytest.mark.parametrize(('case', 'words'), [
    ({**DOUBLE, 'sample_time': 0.1}, 'continuous time'), ({**DOUBLE, 'Q': [1]}, 'unknown key'),
    ({**DOUBLE, 'Qx': [[1, 0], [0]]}, 'equal length'), ({**DOUBLE, 'Qx': ['a', 0]}, 'Qx'),
    ({**DOUBLE, 'B': [[0]]}, 'rows of B'), ({**DOUBLE, 'A': [0]}, 'A: wanted rows'),
    ({**DOUBLE, 'Qu': {}}, 'Qu'), ({**DOUBLE, 'system': 'aircraft'}, 'give either'),
    ({**AIRCRAFT, 'system': 'aircaft'}, 'did you mean'), ({**DOUBLE, 'rho': [None]}, 'rho'),
    ({'Qx': [1], 'Qu': [1]}, 'A: wanted rows'), ({**AIRCRAFT, 'parameters': {'q': 1}}, 'q')])
def test_a_malformed_case_is_refused_in_words(case, words):
    with pytest.raises(ObcError, match=words):
        RegulatorNumbers(case)


@pytest.mark.slow
def test_a_sweep_of_weights_and_plants():
    pytest.importorskip('xarray')
    found = sweep(DOUBLE, {'Qu.0': [1, 16], 'plant.A.1.1': [-1, 0, 3]}, workers=1, seed=1,
                  sample={'x0.x1': 'uniform(1, 2)'}, count=4)
    assert found.sizes['Qu.0'] == 2 and found.sizes['sample'] == 4
    assert (found['status'] == LOOP_STATUSES.index('solved')).all()
    # K = (r^-1/2, sqrt 2 r^-1/4): s^2 + (k2 - a) s + k1
    for r in (1, 16):
        k1, k2 = r**-0.5, sqrt(2) * r**-0.25
        for a in (-1, 0, 3):
            poles = np.roots([1, k2 - a, k1])
            np.testing.assert_allclose(
                found['decay'].sel({'Qu.0': r, 'plant.A.1.1': a}), -poles.real.max(), rtol=1e-6)
    assert (found['settled'] == (found['plant.A.1.1'] < 1)).sel({'plant.A.1.1': [-1, 3]}).all()
    refused = sweep(DOUBLE, {'Qu.0': [-1, 1]}, workers=1)
    assert [LOOP_STATUSES[code] for code in refused['status'].values] == ['refused', 'solved']
