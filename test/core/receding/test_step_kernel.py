# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The program of a step: its answer by another solver, its residual, and the shared memory."""

from collections.abc import Callable
import math

import casadi as ca
import numpy as np
from obc_ros.core.receding.formulation import RecedingProblem
from obc_ros.core.receding.horizon_program import HorizonProgram
from obc_ros.core.receding.step_kernel import BufferedFunction, StepKernel
import pytest
from receding_problems import make_receding

STATED = {'states': ['p', 'v'], 'inputs': ['a'], 'dynamics': {'p': 'v', 'v': 'a - 0.1*v**3'},
          'running_cost': 'p**2 + 0.1*v**2 + 0.1*a**2', 'initial_state': {'p': 0, 'v': 0},
          'final_time': {'free': False, 'value': 1}, 'input_bounds': {'a': [-5, 5]},
          'state_bounds': {'v': [-1, 1]},
          'path_constraints': [{'expr': 'p + 0.1*a', 'upper': 2.2}]}
START = np.array([2.0, -0.5])
SIGMA = 50.0


def state_problem() -> RecedingProblem:
    """Return a double integrator with drag, an input bound, a state bound and a mixed limit."""
    return make_receding(STATED, horizon=8, period=0.1)


def begin() -> tuple[HorizonProgram, StepKernel]:
    """Return a kernel that is linearized about the motion without an input."""
    program = HorizonProgram(state_problem())
    kernel = StepKernel(program, None, compiled=False)
    kernel.begin(START, np.zeros((9, 2)))
    motion = kernel.follow()
    assert motion is not None
    kernel.E[:], kernel.V[:] = motion.E, motion.V
    kernel.linearize(SIGMA)
    return program, kernel


def test_the_program_has_the_same_answer_by_an_active_set_method() -> None:
    """The arrays of the kernel describe a quadratic program that qrqp solves as well."""
    program, kernel = begin()
    memory = kernel._memory
    other = ca.conic('other', 'qrqp', {'h': program.hessian_pattern, 'a': program.pattern[0]},
                     {'print_iter': False, 'print_header': False, 'print_info': False})
    answer = other(h=ca.DM(program.hessian_pattern, memory['h']), g=memory['g'],
                   a=ca.DM(program.pattern[0], memory['a']), lba=memory['lba'],
                   uba=memory['uba'], lbx=memory['lbx'], ubx=memory['ubx'])
    assert kernel.solve()
    np.testing.assert_allclose(memory['x'], answer['x'].full().ravel(), atol=1e-6)


def test_the_rows_are_the_derivatives_of_the_model() -> None:
    """Central differences of the model, stage by stage."""
    program, kernel = begin()
    A = ca.DM(program.pattern[0], kernel._memory['a']).full()
    model, step = program.problem.model, 1e-5
    for k in range(8):
        at, row, column = [*kernel.E[k], *kernel.V[k]], 5 * k, 5 * k
        for i in range(3):
            ahead, behind = (model(moved[:2], moved[2:]).full().ravel() for moved in (
                np.array(at) + sign * step * np.eye(3)[i] for sign in (1.0, -1.0)))
            np.testing.assert_allclose(A[row:row + 2, column + i], (ahead - behind) / (2 * step),
                                       atol=1e-8)


def iterate(kernel: StepKernel, count: int = 8) -> float:
    """Return the residual after some programs."""
    for _ in range(count):
        assert kernel.solve()
        kernel.take_multipliers()
        kernel.linearize(SIGMA)
    return kernel.measure_residual()


def _push(kernel: StepKernel) -> None:
    kernel.V[3] += 1e-3


def _part(kernel: StepKernel) -> None:
    kernel.E[4, 0] += 1e-3


def _leave(kernel: StepKernel) -> None:
    kernel.V[0] = 5.1


def _spoil(kernel: StepKernel) -> None:
    kernel._memory['lam_a'][0] += 1e-2


@pytest.mark.parametrize('change', [_push, _part, _leave, _spoil])
def test_the_residual_sees_each_defect(change: Callable[[StepKernel], None]) -> None:
    """It is small at the optimum, and not after a change."""
    kernel = begin()[1]
    assert iterate(kernel) < 1e-7
    change(kernel)
    kernel.linearize(SIGMA)
    assert kernel.measure_residual() > 1e-5


def test_numbers_that_are_not_finite_are_never_optimal() -> None:
    """The residual is NaN, and no program is solved."""
    kernel = begin()[1]
    iterate(kernel)
    kernel.V[2] = math.nan
    kernel.linearize(SIGMA)
    assert not kernel.measure_residual() <= 1e300
    assert not kernel.solve()


def test_the_excess_of_a_motion_is_that_of_its_samples() -> None:
    """The bound of v and the mixed limit, computed from the motion that is returned."""
    kernel = begin()[1]
    kernel.V[:] = 5.0
    kernel.E[:] = 0.0
    motion = kernel.follow()
    assert motion is not None
    p, v, a = motion.E[:, 0], motion.E[:, 1], motion.V[:, 0]
    over_v = np.maximum(np.abs(v) - 1.0, 0.0)
    over_mixed = np.maximum(p[:-1] + 0.1 * a - 2.2, 0.0)
    np.testing.assert_allclose(motion.worst, [over_v.max(), over_mixed.max()], atol=1e-12)
    np.testing.assert_allclose(motion.excess, [over_v.sum(), over_mixed.sum()], atol=1e-12)


def make_function(name: str, given: str, found: str, factor: float) -> ca.Function:
    """Return the function that multiplies three numbers by a factor."""
    x = ca.SX.sym('x', 3)
    return ca.Function(name, [x], [factor * x], [given], [found])


def test_an_output_is_the_input_of_the_next_function() -> None:
    """Both work on one array; a change of the first input arrives at the end."""
    memory: dict[str, np.ndarray] = {}
    first = BufferedFunction(make_function('first', 'a', 'b', 2.0), memory)
    second = BufferedFunction(make_function('second', 'b', 'c', -3.0), memory)
    for a in ([1.0, 2.0, 3.0], [0.5, 0.0, -7.0]):
        memory['a'][:] = a
        first.run()
        second.run()
        np.testing.assert_array_equal(memory['c'], -6.0 * np.array(a))


def test_a_quadratic_program_has_the_same_answer_each_time() -> None:
    """HPIPM uses the addresses of its outputs for itself: they are given to it again."""
    # One stage: minimise 1/2 (x0^2 + u0^2 + x1^2) with x1 = x0 + u0 and x0 = 2, hence u0 = -1.
    memory: dict[str, np.ndarray] = {}
    solver = BufferedFunction(ca.conic('qp', 'hpipm', {
        'h': ca.Sparsity.diag(3), 'a': ca.Sparsity.dense(1, 3)}, {
            'N': 1, 'nx': [1, 1], 'nu': [1, 0], 'ng': [0, 0], 'print_time': False}), memory)
    memory['h'][:] = 1.0
    memory['a'][:] = 1.0, 1.0, -1.0
    memory['lbx'][:], memory['ubx'][:] = (2.0, -9.0, -9.0), (2.0, 9.0, 9.0)
    for _ in range(3):
        memory['x'][:] = np.nan
        solver.run()
        np.testing.assert_allclose(memory['x'], [2.0, -1.0, 1.0], atol=1e-6)


def test_an_array_of_another_size_is_refused() -> None:
    """Otherwise the function would write outside of it."""
    with pytest.raises(ValueError, match='b of first: 2 numbers; wanted 3'):
        BufferedFunction(make_function('first', 'a', 'b', 1.0), {'b': np.zeros(2)})
