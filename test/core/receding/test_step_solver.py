# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Steps of the receding horizon: the regulator without limits, limits, deadlines, refusals."""

import time
from typing import Any

import numpy as np
from obc_ros.core.receding.formulation import RecedingProblem, state_receding_problem
from obc_ros.core.receding.step_solver import STEP_TOLERANCE, StepSolver
from obc_ros.core.systems.file import build_system
from obc_ros.core.systems.registry import get_system
from obc_ros.core.systems.vehicles import define_aircraft
from obc_ros.core.text.errors import StatementError
import pytest
from receding_problems import make_receding

INTEGRATOR: dict[str, Any] = {
    'states': ['p', 'v'], 'inputs': ['a'], 'dynamics': {'p': 'v', 'v': 'a'},
    'running_cost': 'p**2 + 0.1*v**2 + 0.1*a**2', 'initial_state': {'p': 0, 'v': 0},
    'final_time': {'free': False, 'value': 1}}


def integrator(**change: object) -> RecedingProblem:
    """Return the double integrator with limits or another cost."""
    return make_receding({**INTEGRATOR, **change}, horizon=30, period=0.05)


def flying(**limits: object) -> RecedingProblem:
    """Return the aircraft with limits, at 50 Hz."""
    return state_receding_problem(
        define_aircraft(), horizon=20, period=0.02, limits=limits,
        weights={'Qx': [10, 10, 1, 1, 1, 1], 'Qu': [0.1, 0.1]})


@pytest.mark.parametrize('cross', ['', ' + 0.1*v*a - 0.2*p*a'])
def test_without_limits_the_input_is_that_of_the_regulator(cross: str) -> None:
    """The cost-to-go of the regulator ends the horizon, so that its length has no effect."""
    problem = integrator(running_cost=INTEGRATOR['running_cost'] + cross)
    solver = StepSolver(problem, compiled=False)
    x, plan = np.array([3.0, -1.0]), None
    for k in range(20):
        result = solver.solve(x, plan, stamp=k * problem.period)
        plan = result.plan
        assert plan is not None and result.status == 'optimal'
        np.testing.assert_allclose(plan.u[0], -problem.K @ x, atol=1e-9)
        assert plan.cost == pytest.approx(x @ problem.P @ x, rel=1e-9)
        x = plan.x[1]


def test_with_inactive_limits_the_input_is_that_of_the_regulator() -> None:
    """Limits that are far away change nothing."""
    problem = integrator(state_bounds={'p': [-9, 9]}, input_bounds={'a': [-90, 90]})
    result = StepSolver(problem, compiled=False).solve(np.array([1.0, 0.5]))
    assert result.plan is not None and result.residual <= STEP_TOLERANCE
    np.testing.assert_allclose(result.plan.u[0], -problem.K @ [1.0, 0.5], atol=1e-6)


@pytest.mark.parametrize('horizon', [1, 2, 8])
def test_with_one_state_the_plan_of_any_length_is_the_saturated_regulator(horizon: int) -> None:
    """With one state and a bounded input, sat(-K x) is optimal for every horizon."""
    problem = state_receding_problem(
        get_system('scalar'), horizon=horizon, period=0.1,
        limits={'input_bounds': {'u': [-1, 1]}})
    solver = StepSolver(problem, compiled=False)
    for x in (-2.0, -0.3, 0.1, 0.7):
        plan = solver.solve(np.array([x])).plan
        assert plan is not None
        np.testing.assert_allclose(plan.u[0], np.clip(-problem.K[0] * x, -1, 1), atol=1e-6)


def test_limits_hold_and_the_plan_is_a_motion_of_the_model() -> None:
    """A limit that the regulator breaks is kept, and inputs are admissible exactly."""
    problem = flying(state_bounds={'theta': [-0.3, 0.3]},
                     input_bounds={'f1': [-3, 3], 'f2': [30, 50]})
    result = StepSolver(problem, compiled=False).solve(np.array([3.0, 1, 0, 0, 0, 0]))
    plan = result.plan
    assert plan is not None and result.status == 'optimal' and result.residual <= STEP_TOLERANCE
    assert np.abs(plan.x[:, 2]).max() == pytest.approx(0.3, abs=1e-6)
    assert np.abs(plan.u[:, 0]).max() <= 3.0 and result.slack == {}
    for k, u in enumerate(plan.u):
        e = np.array(problem.model(plan.x[k] - problem.xe, u - problem.ue)).ravel()
        np.testing.assert_allclose(plan.x[k + 1], problem.xe + e, atol=1e-9)


def test_inputs_are_within_their_bounds_without_rounding() -> None:
    """A bound b for which (b - ue) + ue is below b, the lowest input of the plan."""
    ue = flying().ue[1]
    low = next(b for b in np.linspace(5.0, 19.0, 1000) if (b - ue) + ue < b)
    result = StepSolver(flying(input_bounds={'f2': [low, 60]}), compiled=False).solve(
        np.array([0.0, 20.0, 0, 0, 0, 0]))
    assert result.plan is not None and result.plan.u[:, 1].min() == low


def test_a_start_outside_a_state_bound_is_told_by_name() -> None:
    """The excess at the start cannot be avoided; it is returned."""
    problem = integrator(state_bounds={'v': [-1, 1]})
    result = StepSolver(problem, compiled=False).solve(np.array([0.0, 2.0]))
    assert result.slack['v'] == pytest.approx(1.0, abs=1e-6)
    assert 'exceeds v by 1' in result.words


def test_an_excess_that_cannot_be_avoided_is_no_obstacle() -> None:
    """The answers do not depend on earlier steps."""
    solver = StepSolver(integrator(state_bounds={'v': [-1, 1]}), compiled=False)
    found = [solver.solve(np.array([0.0, v])) for v in (2.0, 2.0, -2.0, 2.0)]
    costs = [each.plan.cost for each in found if each.plan is not None]
    assert costs == pytest.approx([costs[0]] * 4, rel=1e-6)
    assert all(each.status == 'optimal' for each in found)


@pytest.mark.parametrize('p', [-3.0, -30.0, -300.0, -3e4])
def test_the_penalty_is_exact_however_far_the_set_point_is(p: float) -> None:
    """The speed limit holds over the whole plan."""
    result = StepSolver(integrator(state_bounds={'v': [-1, 1]}), compiled=False).solve(
        np.array([p, 0.9]))
    assert result.plan is not None and result.status == 'optimal' and result.slack == {}
    assert result.plan.x[:, 1].max() == pytest.approx(1.0, abs=1e-6)


def test_a_plan_that_can_keep_its_limits_does_so_to_rounding() -> None:
    """Far away the limit would be exceeded by 3e-6, if gaps of 1e-6 were accepted."""
    problem = flying(state_bounds={'vx': [-0.4, 0.4]},
                     input_bounds={'f1': [-6, 6], 'f2': [20, 60]})
    result = StepSolver(problem, compiled=False).solve(np.array([5.0, 2.0, 0, 0, 0, 0]))
    assert result.plan is not None and result.status == 'optimal' and result.slack == {}
    assert result.plan.x[:, 3].min() == pytest.approx(-0.4, abs=1e-8)


@pytest.mark.parametrize('loose', [{}, {'px': [-1000, 1000]}])
def test_a_limit_that_disturbances_exceed_a_little_is_no_reason_for_a_fall(
        loose: dict[str, list[float]]) -> None:
    """The thrust stays near the weight while the speed is measured about its limit."""
    solver = StepSolver(state_receding_problem(
        define_aircraft(), horizon=20, period=0.02,
        limits={'state_bounds': {'theta': [-0.2, 0.2], 'vx': [-0.4, 0.4], **loose},
                'input_bounds': {'f1': [-6, 6], 'f2': [20, 60]}}), compiled=False)
    rng, plans, excesses = np.random.default_rng(0), [], []
    result = solver.solve(np.array([1.0, 0.5, 0, 0, 0, 0]))
    for _ in range(120):   # the limit is reached after 1.2 s
        assert result.plan is not None
        plans.append(result.plan)
        excesses.append(result.slack.get('vx', 0.0))
        result = solver.solve(result.plan.x[1] + 1e-4 * rng.standard_normal(6), result.plan,
                              stamp=result.plan.stamp + result.plan.period)
    assert 0.0 < max(excesses) < 3e-3
    assert min(each.u[0, 1] for each in plans) > 0.9 * 39.2


def test_an_expired_deadline_returns_the_best_admissible_motion() -> None:
    """Without time for one quadratic program the regulator is the plan, within the bounds."""
    problem = integrator(input_bounds={'a': [-1, 1]})
    result = StepSolver(problem, compiled=False).solve(np.array([5.0, 0.0]),
                                                       deadline=time.monotonic() - 1.0)
    assert result.status == 'time' and result.iterations == 0
    assert result.plan is not None and np.abs(result.plan.u).max() <= 1.0
    assert result.residual == np.inf


def test_a_moving_set_point_is_followed() -> None:
    """The set point of the vehicle moves at 10 m/s; a plan from it stays on it."""
    problem = state_receding_problem(get_system('vehicle'), horizon=20, period=0.02,
                                     setpoint=[0.0, 0.0, 0.0], setpoint_input=[10.0, 0.0],
                                     limits={'state_bounds': {'py': [-1, 1]}})
    solver = StepSolver(problem, compiled=False)
    result = solver.solve(np.array([30.0, 0.0, 0.0]), stamp=3.0)
    assert result.plan is not None and result.status == 'optimal'
    np.testing.assert_allclose(result.plan.x[:, 0], 30.0 + 10.0 * 0.02 * np.arange(21), atol=1e-6)


@pytest.mark.parametrize('limits, words', [
    ({'state_bounds': {'p': [1, 2]}}, 'p: 0 at the set point'),
    ({'input_bounds': {'a': [1, 2]}}, 'input_bounds.a: the set point needs 0'),
    ({'path_constraints': [{'expr': 'p - t', 'upper': 1}]}, '^t: ')])
def test_limits_that_a_horizon_cannot_take_are_refused(limits: dict[str, object], words: str
                                                       ) -> None:
    """The message names the key."""
    system = build_system({key: INTEGRATOR[key] for key in ('states', 'inputs', 'dynamics')})
    with pytest.raises(StatementError, match=words):
        state_receding_problem(system, horizon=5, period=0.05, limits=limits)


def test_a_state_that_is_not_finite_is_refused() -> None:
    """NaN never reaches the solver."""
    with pytest.raises(StatementError, match='2 finite numbers'):
        StepSolver(integrator(), compiled=False).solve(np.array([np.nan, 0.0]))


def test_a_limit_without_a_finite_value_is_told() -> None:
    """It is neither kept nor exceeded, so that there is no plan."""
    problem = integrator(path_constraints=[{'expr': 'log(p + 1)', 'upper': 1.0}])
    solver = StepSolver(problem, compiled=False)
    result = solver.solve(np.array([-2.0, 0.0]))
    assert result.plan is None and result.status == 'diverged' and 'limits' in result.words
    assert solver.solve(np.array([0.5, 0.0])).status == 'optimal', 'the solver recovers'
