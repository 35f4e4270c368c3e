# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Outcomes of nonlinear programs are judged by their optimality conditions."""

import casadi as ca
import numpy as np
from obc_ros.core.numerics.ipopt import measure_optimality, run_ipopt
from obc_ros.core.solver.solve import solve
from obc_ros.core.solver.trace import GUESS
import problems
import pytest

INF = np.array([np.inf, np.inf])
# A quadrotor, with thrust and torques as inputs.
QUADROTOR = {
    'states': ['px', 'py', 'pz', 'vx', 'vy', 'vz', 'roll', 'pitch', 'yaw', 'wx', 'wy', 'wz'],
    'inputs': ['thrust', 'tx', 'ty', 'tz'],
    'parameters': {'m': 1.2, 'g': 9.81, 'jx': 0.012, 'jy': 0.012, 'jz': 0.022},
    'dynamics': {
        'px': 'vx', 'py': 'vy', 'pz': 'vz',
        'vx': 'thrust/m*(cos(yaw)*sin(pitch)*cos(roll) + sin(yaw)*sin(roll))',
        'vy': 'thrust/m*(sin(yaw)*sin(pitch)*cos(roll) - cos(yaw)*sin(roll))',
        'vz': 'thrust/m*cos(pitch)*cos(roll) - g',
        'roll': 'wx + sin(roll)*tan(pitch)*wy + cos(roll)*tan(pitch)*wz',
        'pitch': 'cos(roll)*wy - sin(roll)*wz', 'yaw': '(sin(roll)*wy + cos(roll)*wz)/cos(pitch)',
        'wx': '(tx - (jz - jy)*wy*wz)/jx', 'wy': '(ty - (jx - jz)*wx*wz)/jy',
        'wz': '(tz - (jy - jx)*wx*wy)/jz'},
    'running_cost': '(thrust - m*g)**2 + 10*(tx**2 + ty**2 + tz**2)',
    'input_bounds': {'thrust': [0, 24], 'tx': [-1, 1], 'ty': [-1, 1], 'tz': [-0.3, 0.3]},
    'final_time': {'free': False, 'value': 4}}
REST = dict.fromkeys(QUADROTOR['states'], 0)


def residual(w, lam_w, lam_g, *, row=1.0, cost=1.0):
    """
    Return the residual of min (w0 - 2)^2 + w1^2, w0 + w1 = 2, w0 <= 1.5.

    The row and the cost are multiplied by `row` and `cost`, the multipliers accordingly.
    """
    w = np.array(w, dtype=float)
    f, slope = cost * ((w[0] - 2)**2 + w[1]**2), 2 * cost * (w - [2, 0])
    return measure_optimality(
        w, (-INF, np.array([1.5, np.inf])), (np.array([2.0 * row]), np.array([2.0 * row])),
        (f, np.array([row * w.sum()]), slope),
        (np.array([0, 0]), np.array([0, 1]), np.array([row, row])),
        (cost * np.array(lam_w), cost / row * np.array(lam_g)))


def test_the_residual_vanishes_at_a_minimum():
    # grad f = (-1, 1), so that lam_g = -1 and lam_w0 = 2.
    assert residual([1.5, 0.5], [2.0, 0.0], [-1.0]) < 1e-15   # the rounding of the row


@pytest.mark.parametrize('row', [1.0, 1e11])
@pytest.mark.parametrize('cost', [1.0, 1e-1, 1e11])
@pytest.mark.parametrize('w, lam_w, lam_g, expected', [
    ([1.6, 0.4], [2.0, 0.0], [-1.0], 0.2 / 1.8),          # the gradient, more than the bound
    ([1.5, 0.7], [2.4, 0.0], [-1.4], 0.2 / 2),            # the row, met at w + (-0.1, -0.1)
    ([1.5, 0.5], [1.0, 0.0], [-1.0], 1.0 / 2.0),          # the gradient of the Lagrangian
    ([1.0, 1.0], [4.0, 0.0], [-2.0], 4.0 * 0.5 / 2.0),    # a multiplier away from its bound
    ([2.0, 0.0], [0.0, 0.0], [0.0], 0.5),                 # without the bound
    ([np.nan, 0.5], [2.0, 0.0], [-1.0], np.inf)])
def test_the_residual_names_what_is_missed_in_any_unit(w, lam_w, lam_g, expected, row, cost):
    found = residual(w, lam_w, lam_g, row=row, cost=cost)
    assert found == pytest.approx(expected) if np.isfinite(expected) else found == expected


@pytest.mark.parametrize('row', [1.0, 1e11])
@pytest.mark.parametrize('size', [1e10, 1e16])
def test_no_row_is_met_at_an_iterate_where_rounding_hides_it(size, row):
    """At 1e16 w0 + w1 = 2 and w0 + w1 = 1 have the same rounded value."""
    assert residual([size, -size], [0.0, 0.0], [0.0], row=row) > 1e-7


class WithoutStep:
    """A solver that has found no step at its start, as rounding errors may leave none."""

    def __init__(self, solver: ca.Function) -> None:
        self._solver, self.get_function = solver, solver.get_function

    def __call__(self, **given: ca.DM) -> dict[str, ca.DM]:
        """Return the outcome without an iteration."""
        return self._solver(**given)

    def stats(self) -> dict[str, object]:
        """Return the report of IPOPT in this case."""
        return {**self._solver.stats(), 'success': False,
                'return_status': 'Search_Direction_Becomes_Too_Small'}


@pytest.mark.parametrize(('miss', 'is_solution'), [(1e-10, True), (1e-3, False)])
def test_an_outcome_without_a_step_is_judged_by_its_residual(miss, is_solution):
    """The minimum of |w - (2, 0)|^2 with w0 + w1 = 2 is known; no iteration is allowed."""
    w = ca.MX.sym('w', 2)
    short = ca.nlpsol('short', 'ipopt', {
        'x': w, 'f': ca.sumsqr(w - ca.DM([2, 0])), 'g': ca.sum1(w)}, {
            'print_time': False, 'ipopt.print_level': 0, 'ipopt.sb': 'yes', 'ipopt.tol': 1e-300,
            'ipopt.dual_inf_tol': 1e-300, 'ipopt.max_iter': 0})
    start, rows = np.array([2 + miss, -miss]), (np.array([2.0]), np.array([2.0]))
    assert run_ipopt(WithoutStep(short), start, (-INF, INF), rows).converged == is_solution
    assert not run_ipopt(short, start, (-INF, INF), rows).converged   # it was cut short


@pytest.mark.slow
def test_a_search_keeps_a_first_path_that_rounding_errors_ended():
    """A quadrotor from rest to rest: the flag of the first outcome says that it failed."""
    found = solve(problems.build(
        QUADROTOR, initial_state={**REST, 'pz': 1},
        terminal_constraints=[f'{name} - {value}' for name, value in (
            REST | {'px': 2, 'py': 1, 'pz': 2}).items()]))
    assert found.certified
    # Radau collocation on 60 intervals with another solver.
    assert found.objective == pytest.approx(0.1637319, rel=1e-5)
    guesses = [each for each in found.attempts if each.method == GUESS]
    assert guesses[0].verdict == 'converged'
