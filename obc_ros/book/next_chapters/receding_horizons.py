# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Receding horizons with a bounded input: a scalar plant and a double integrator.

The optimal first input of a scalar plant is that of the saturated regulator; that of a double
integrator is not.
"""

from typing import Any

from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
import numpy as np
from obc_ros.api.figures.style import EXACT, EXACT_LINE, get_line, LINE_COLOURS, THIN
from obc_ros.book.entry import ComparedRow, create_panels, EntryResult, GalleryEntry, label_axes
from obc_ros.book.loop import Run
from obc_ros.book.next_chapters.node_runs import run_receding
from obc_ros.book.references import EnumeratedPlan, solve_sampled_scalar
from obc_ros.book.runner import Desk
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.receding.formulation import RecedingProblem, state_receding_problem
from obc_ros.core.receding.step_solver import StepSolver
from obc_ros.core.systems.registry import get_system

HORIZONS = (1, 2, 5, 20)
BOUND = 1.0   # of |u|
A, B, SCALAR_PERIOD = 1.0, 1.0, 0.1   # x' = A x + B u, [s]
STATES = np.linspace(-3.0, 3.0, 41)
SCALAR_X0, SCALAR_DURATION = 0.9, 6.0   # of the run; no input brakes beyond x = 1


def state_scalar_problem(horizon: int) -> RecedingProblem:
    """Return the problem of the scalar plant with a horizon of some periods."""
    return _state('scalar', horizon, SCALAR_PERIOD, [1.0], 1.0)


def state_bounded_problem(horizon: int) -> RecedingProblem:
    """Return the problem of the double integrator with a horizon of some periods."""
    return _state('double_integrator', horizon, PERIOD, list(QX), QU)


def _state(system: str, horizon: int, period: float, Qx: list[float], Qu: float
           ) -> RecedingProblem:
    return state_receding_problem(
        get_system(system), horizon=horizon, period=period, weights={'Qx': Qx, 'Qu': [Qu]},
        limits={'input_bounds': {'u': [-BOUND, BOUND]}})


def receding_horizon_1(desk: Desk) -> EntryResult:
    """Compare plans of a scalar plant with the saturated regulator."""
    alpha, beta, P, K = solve_sampled_scalar(A, B, 1.0, 1.0, SCALAR_PERIOD)
    problem = state_scalar_problem(HORIZONS[-1])
    first = np.array([_plan(state_scalar_problem(N), STATES[:, None])[:, 0] for N in HORIZONS])
    run = run_receding(desk, {
        'system': 'scalar', 'x0': [SCALAR_X0], 'publish_rate': 1.0 / SCALAR_PERIOD}, {
        'system': 'scalar', 'Qx': [1.0], 'Qu': [1.0], 'rate': 1.0 / SCALAR_PERIOD,
        'horizon': 20 * SCALAR_PERIOD, 'u_limits': [-BOUND, BOUND]}, SCALAR_DURATION)
    x = _follow_scalar(alpha, beta, K, len(run.t))
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
    return EntryResult(rows, _draw_scalar(first, K, run, x), (
        'Left: the first input of the plans. A longer horizon changes nothing: the saturated '
        f'regulator is optimal. Right: `mpc_node` from $x(0) = {SCALAR_X0:g}$. For $|x| > 1$ the '
        'bounded input cannot stop the plant. From 0.9 the input is at its bound for about two '
        'seconds.',))


def _plan(problem: RecedingProblem, states: Array) -> Array:
    """Return the inputs of the plans from states (k, n), shape (k, N)."""
    solver = StepSolver(problem, compiled=False)
    plans: list[Any] = [solver.solve(x).plan for x in states]   # none is None: all are feasible
    return np.array([plan.u[:, 0] for plan in plans])


def _follow_scalar(alpha: float, beta: float, K: float, count: int) -> Array:
    """Return the states of x+ = alpha x + beta sat(-K x)."""
    x = [SCALAR_X0]
    for _ in range(count - 1):
        x.append(alpha * x[-1] + beta * float(np.clip(-K * x[-1], -BOUND, BOUND)))
    return np.array(x)


def _draw_scalar(first: Array, K: float, run: Run, x: Array) -> Figure:
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
    time.set(xlim=(0, SCALAR_DURATION), ylim=(-1.3, 1.3))
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


PERIOD, QX, QU = 0.5, (1.0, 0.0), 0.05
SPAN = (6.0, 3.0)                      # [m], [m/s] largest magnitudes on the grids
COUNTS = (17, 13)                      # of positions and velocities, where plans are compared
X0, DURATION = (4.0, 0.0), 10.0        # of the runs
LEVELS = (-1.25, -1.0, -0.75, -0.5, -0.25, -0.02, 0.02, 0.25, 0.5, 0.75, 1.0, 1.25)   # [m/s^2]
CHECKED = (1, 2, 4)                    # horizons of the compared plans, in periods


def enumerate_plan(horizon: int) -> EnumeratedPlan:
    """Return the same plan by enumeration."""
    return EnumeratedPlan(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]),
                          np.diag(QX), np.array([[QU]]), PERIOD, horizon, BOUND)


def build_grid(counts: tuple[int, int]) -> Array:
    """Return states of a grid, shape (k, 2)."""
    axes = [np.linspace(-span, span, count) for span, count in zip(SPAN, counts, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1).reshape(-1, 2)


def receding_horizon_2(desk: Desk) -> EntryResult:
    """Compare plans of the double integrator with an enumeration of the active sets."""
    grid, exact = build_grid(COUNTS), {N: enumerate_plan(N) for N in CHECKED}
    planned = {N: _plan(state_bounded_problem(N), grid) for N in CHECKED}
    problem = state_bounded_problem(2)
    rows = [ComparedRow('gain $K$ of the sampled regulator', problem.K, exact[2].K,
                        'SciPy, `solve_discrete_are`')]
    for N, plan in exact.items():
        rows.append(ComparedRow(
            f'all inputs of the plan from {len(grid)} states, $N = {N}$', planned[N],
            plan.find_inputs(grid)[0], f'enumeration of {3**N} active sets'))
    run = run_receding(desk, {
        'system': 'double_integrator', 'x0': list(X0), 'publish_rate': 1.0 / PERIOD}, {
        'system': 'double_integrator', 'Qx': list(QX), 'Qu': [QU], 'rate': 1.0 / PERIOD,
        'horizon': 2 * PERIOD, 'u_limits': [-BOUND, BOUND]}, DURATION)
    x, u = _follow(exact[2], len(run.t), is_planned=True)
    rows += [ComparedRow('the input of the plan, $N = 1$', planned[1][:, 0],
                         exact[1].saturate(grid), '$sat(-Kx)$'),
             ComparedRow('`mpc_node`, $N = 2$: $x(t)$', run.x, x, 'recursion by enumeration'),
             ComparedRow('`mpc_node`, $N = 2$: $u(t)$', run.u[:, 0], u, 'the same recursion')]
    differs = float(np.abs(exact[2].find_inputs(grid)[0][:, 0] - exact[2].saturate(grid)).max())
    return EntryResult(rows, _draw(exact[2], run), (
        'Left: the active sets of $N = 2$. In each region the first input is an affine function '
        'of $x$. Right: the first input minus $sat(-Kx)$. Where the second input is at a bound, '
        f'the first input differs from $sat(-Kx)$, by up to {differs:.2g} m/s² at the states of '
        'the table. For $N = 1$ the plan is $sat(-Kx)$. Below: runs with both laws from rest. The '
        'saturated regulator brakes later and overshoots more.',))


def _follow(plan: EnumeratedPlan, count: int, *, is_planned: bool) -> tuple[Array, Array]:
    """Return states and inputs under the plan, or under the saturated regulator."""
    x, u = [np.array(X0)], []
    for _ in range(count):
        now = x[-1][None]
        u.append(float(plan.find_inputs(now)[0][0, 0] if is_planned else plan.saturate(now)[0]))
        x.append(plan.Ad @ x[-1] + plan.Bd[:, 0] * u[-1])
    return np.array(x[:-1]), np.array(u)


def _draw(plan: EnumeratedPlan, run: Run) -> Figure:
    figure, ((sets, difference), (states, inputs)) = create_panels(2, 2, 3.4)
    fine = (241, 181)
    grid = build_grid(fine)
    found, active = plan.find_inputs(grid)
    extent = (-SPAN[0], SPAN[0], -SPAN[1], SPAN[1])
    _draw_sets(sets, active.reshape(*fine, 2), extent)
    gap = (found[:, 0] - plan.saturate(grid)).reshape(fine).T
    axes_of = [np.linspace(-SPAN[i], SPAN[i], fine[i]) for i in range(2)]
    image = difference.contourf(*axes_of, gap, levels=LEVELS, cmap='PuOr')
    figure.colorbar(image, ax=difference, ticks=[-1.0, -0.5, 0.0, 0.5, 1.0], label='[m/s$^2$]')
    label_axes(difference, r'first input $-\,\mathrm{sat}(-Kx)$', 'position $x_1$ [m]',
               'velocity $x_2$ [m/s]')
    x, u = _follow(plan, len(run.t), is_planned=False)
    for index in range(2):
        states.plot(run.t, run.x[:, index], color=LINE_COLOURS[index],
                    label=f'$x_{index + 1}$, plan')
        states.plot(run.t, x[:, index], color=LINE_COLOURS[index], linestyle='--',
                    label=f'$x_{index + 1}$, saturated')
    inputs.plot(run.t, run.u[:, 0], drawstyle='steps-post', label='mpc_node', **get_line(0))
    inputs.plot(run.t, u, drawstyle='steps-post', label='saturated', **get_line(1))
    inputs.plot(run.t, _follow(plan, len(run.t), is_planned=True)[1], 'o', markersize=3,
                color=EXACT['color'], label='enumeration')
    for axes in (states, inputs):
        axes.axhline(0, **THIN)
        axes.set_xlim(0, DURATION)
    label_axes(states, 'loop: states', 'time $t$ [s]', '$x_1$ [m], $x_2$ [m/s]',
               legend='upper right')
    inputs.set_ylim(-1.1, 2.2)
    label_axes(inputs, 'loop: input', 'time $t$ [s]', '$u$ [m/s$^2$]', legend='upper right')
    return figure


def _draw_sets(axes: Any, active: Array, extent: tuple[float, float, float, float]) -> None:
    """Draw the active sets of the two inputs over the states."""
    names = ('at the lower bound', 'inside', 'at the upper bound')
    colours = ('#56B4E9', '#FFFFFF', '#E69F00')
    axes.imshow(active[..., 0].T + 1, origin='lower', extent=extent, aspect='auto',
                cmap=ListedColormap(colours), vmin=0, vmax=2)
    axes.contourf(np.linspace(*extent[:2], active.shape[0]),
                  np.linspace(*extent[2:], active.shape[1]), np.abs(active[..., 1].T),
                  levels=[0.5, 1.5], colors='none', hatches=['///'])
    axes.legend(handles=[*(Patch(facecolor=colour, edgecolor='0.4', label=f'$u_0$ {name}')
                           for colour, name in zip(colours, names, strict=True)),
                         Patch(facecolor='none', edgecolor='0.4', hatch='///',
                               label='$u_1$ at a bound')], loc='upper right', fontsize=9)
    label_axes(axes, 'active sets, $N = 2$', 'position $x_1$ [m]', 'velocity $x_2$ [m/s]')


RECEDING_HORIZON_2 = GalleryEntry(
    'receding-horizon-2', 'A double integrator with a bounded input',
    'A. Bemporad, M. Morari, V. Dua, E. N. Pistikopoulos, The explicit linear quadratic regulator '
    'for constrained systems, Automatica 38, 2002', (
        "$x_1' = x_2$, $x_2' = u$, $|u| ≤ 1$ with an input that is held for half a second, and "
        '$J = ∫ (x_1^2 + 0.05 u^2) dt$ over $N$ periods plus the cost-to-go $x^T P x$ of the '
        'sampled regulator at the end.',
        'The plan solves a quadratic program with $2N$ bounds. For each of the $3^N$ active sets '
        'the equations of Karush, Kuhn and Tucker are linear. At each state the solution of one '
        'active set fulfils the inequalities too: it is the plan. Is its first input that of the '
        'saturated regulator?'),
    receding_horizon_2, in_book=False)
