# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A double integrator with a bounded input: the plan is not the saturated regulator."""

from typing import Any

from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
import numpy as np
from obc_ros.api.figures.style import EXACT, get_line, LINE_COLOURS, THIN
from obc_ros.book.drawing import create_panels, label_axes
from obc_ros.book.entry import ComparedRow, EntryResult, GalleryEntry
from obc_ros.book.loop import Run
from obc_ros.book.next_chapters.node_runs import run_receding
from obc_ros.book.references import EnumeratedPlan
from obc_ros.book.runner import Desk
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.receding.formulation import RecedingProblem, state_receding_problem
from obc_ros.core.receding.step_solver import StepSolver
from obc_ros.core.systems.registry import get_system

PERIOD, BOUND, QX, QU = 0.5, 1.0, (1.0, 0.0), 0.05
SPAN = (6.0, 3.0)                      # [m], [m/s] largest magnitudes on the grids
COUNTS = (17, 13)                      # of positions and velocities, where plans are compared
X0, DURATION = (4.0, 0.0), 10.0        # of the runs
LEVELS = (-1.25, -1.0, -0.75, -0.5, -0.25, -0.02, 0.02, 0.25, 0.5, 0.75, 1.0, 1.25)   # [m/s^2]
CHECKED = (1, 2, 4)                    # horizons of the compared plans, in periods


def state_bounded_problem(horizon: int) -> RecedingProblem:
    """Return the problem of the entry with a horizon of some periods."""
    return state_receding_problem(
        get_system('double_integrator'), horizon=horizon, period=PERIOD,
        weights={'Qx': list(QX), 'Qu': [QU]}, limits={'input_bounds': {'u': [-BOUND, BOUND]}})


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
    planned = {N: _plan(N, grid) for N in CHECKED}
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


def _plan(horizon: int, grid: Array) -> Array:
    """Return the inputs of the plans from states, shape (k, N)."""
    solver = StepSolver(state_bounded_problem(horizon), compiled=False)
    plans: list[Any] = [solver.solve(x).plan for x in grid]   # none is None: all are feasible
    return np.array([plan.u[:, 0] for plan in plans])


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
