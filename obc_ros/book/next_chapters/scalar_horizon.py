# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A scalar plant with a bounded input: the optimal first input is the saturated regulator's."""

from typing import Any

from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import EXACT_LINE, get_line, LINE_COLOURS, THIN
from obc_ros.book.drawing import create_panels, label_axes
from obc_ros.book.entry import ComparedRow, EntryResult, GalleryEntry
from obc_ros.book.loop import Run
from obc_ros.book.next_chapters.node_runs import run_receding
from obc_ros.book.references import solve_sampled_scalar
from obc_ros.book.runner import Desk
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.receding.formulation import RecedingProblem, state_receding_problem
from obc_ros.core.receding.step_solver import StepSolver
from obc_ros.core.systems.registry import get_system

HORIZONS = (1, 2, 5, 20)
A, B, BOUND, PERIOD = 1.0, 1.0, 1.0, 0.1   # x' = A x + B u, |u| <= BOUND, [s]
STATES = np.linspace(-3.0, 3.0, 41)
X0, DURATION = 0.9, 6.0                    # of the run; no input brakes beyond x = 1


def state_scalar_problem(horizon: int) -> RecedingProblem:
    """Return the problem of the entry with a horizon of some periods."""
    return state_receding_problem(
        get_system('scalar'), horizon=horizon, period=PERIOD, weights={'Qx': [1.0], 'Qu': [1.0]},
        limits={'input_bounds': {'u': [-BOUND, BOUND]}})


def receding_horizon_1(desk: Desk) -> EntryResult:
    """Compare plans of a scalar plant with the saturated regulator."""
    alpha, beta, P, K = solve_sampled_scalar(A, B, 1.0, 1.0, PERIOD)
    problem = state_scalar_problem(HORIZONS[-1])
    first = np.array([_plan_first_inputs(N) for N in HORIZONS])
    run = run_receding(desk, {
        'system': 'scalar', 'x0': [X0], 'publish_rate': 1.0 / PERIOD}, {
        'system': 'scalar', 'Qx': [1.0], 'Qu': [1.0], 'rate': 1.0 / PERIOD,
        'horizon': 20 * PERIOD, 'u_limits': [-BOUND, BOUND]}, DURATION)
    x = _follow(alpha, beta, K, len(run.t))
    rows = [
        ComparedRow('gain $K$ of the sampled regulator', problem.K.item(), K,
                    'quadratic equation for $P$'),
        ComparedRow('terminal weight $P$', problem.P.item(), P, 'quadratic equation'),
        ComparedRow('first input of the plan from 41 states, $N$ = 1, 2, 5, 20',
                    first, np.tile(np.clip(-K * STATES, -BOUND, BOUND), (len(HORIZONS), 1)),
                    '$sat(-Kx)$'),
        ComparedRow('`mpc_node`, $N = 20$: $x(t)$', run.x[:, 0], x,
                    'recursion with $u = sat(-Kx)$'),
        ComparedRow('`mpc_node`, $N = 20$: $u(t)$', run.u[:, 0], np.clip(-K * x, -BOUND, BOUND),
                    'the same recursion')]
    return EntryResult(rows, _draw(first, K, run, x), (
        'Left: the first input of the plans. A longer horizon changes nothing: the saturated '
        f'regulator is optimal. Right: `mpc_node` from $x(0) = {X0:g}$. For $|x| > 1$ the '
        'bounded input cannot stop the plant. From 0.9 the input is at its bound for about two '
        'seconds.',))


def _plan_first_inputs(horizon: int) -> Array:
    """Return the first inputs of the plans from `STATES`."""
    solver = StepSolver(state_scalar_problem(horizon), compiled=False)
    plans: list[Any] = [solver.solve(np.array([x])).plan for x in STATES]   # all are feasible
    return np.array([plan.u[0, 0] for plan in plans])


def _follow(alpha: float, beta: float, K: float, count: int) -> Array:
    """Return the states of x+ = alpha x + beta sat(-K x)."""
    x = [X0]
    for _ in range(count - 1):
        x.append(alpha * x[-1] + beta * float(np.clip(-K * x[-1], -BOUND, BOUND)))
    return np.array(x)


def _draw(first: Array, K: float, run: Run, x: Array) -> Figure:
    figure, ((law, time),) = create_panels(1, 2, 3.6)
    law.plot(STATES, np.clip(-K * STATES, -BOUND, BOUND), label='$\\mathrm{sat}(-Kx)$',
             **EXACT_LINE)
    for index, (horizon, inputs) in enumerate(zip(HORIZONS, first, strict=True)):
        some = slice(index, None, len(HORIZONS))
        law.plot(STATES[some], inputs[some], 'os^D'[index], color=LINE_COLOURS[index],
                 label=f'$N = {horizon}$')
    law.set_ylim(-1.3, 1.3)
    label_axes(law, 'first input of the plan', 'state $x$', '$u$', legend='lower left')
    time.plot(run.t, run.x[:, 0], label='$x$', **get_line(0))
    time.plot(run.t, run.u[:, 0], drawstyle='steps-post', label='$u$', **get_line(1))
    time.plot(run.t[::3], x[::3], 'o', markersize=4, color='black', label='recursion of $x$')
    time.axhline(0, **THIN)
    time.set(xlim=(0, DURATION), ylim=(-1.3, 1.3))
    label_axes(time, 'loop with mpc_node', 'time $t$ [s]', '$x$, $u$', legend='lower right')
    return figure


RECEDING_HORIZON_1 = GalleryEntry(
    'receding-horizon-1', 'A scalar plant with a bounded input',
    'D. Q. Mayne, J. B. Rawlings, C. V. Rao, P. O. M. Scokaert, Constrained model predictive '
    'control, Automatica 36, 2000', (
        "$x' = ax + bu$, $|u| ≤ 1$ with an input that is held for a period $h$, and "
        '$J = ∫ (x^2 + u^2) dt$ over $N$ periods plus $Px(Nh)^2$, the cost-to-go of the sampled '
        'regulator $u = -Kx$. For $a > 0$ no input keeps $|x| > b/a$ from growing.',
        'For one state, the first input of the optimal plan is $sat(-Kx)$ for every $N$.'),
    receding_horizon_1, in_book=False)
