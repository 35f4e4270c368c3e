# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Optimal control compared with crocoddyl (feasibility-driven DDP), with `--peers`.

The problems suit crocoddyl: a terminal cost in place of terminal constraints, and at most box
constraints of the inputs. They are the aircraft from hover to hover in 5 s, and the lane change
with a state cost. The input of crocoddyl is constant on each interval; the number of intervals is
the smallest one whose cost is within 1e-3 of the minimum. Both inputs are integrated finely and
compared by the same cost. The models of crocoddyl are in Python, as in its tutorials, with exact
derivatives of CasADi: models in C++ would be faster.
"""

import sys

import timing  # isort: skip - before numpy

from collections.abc import Callable
from dataclasses import replace
import time
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.solver.program_cache import Cache
from obc_ros.core.solver.solve import solve
from optimal_control import end_error, held_step, HOVER, STATE

Array = NDArray[np.float64]

GOAL_AIRCRAFT = {'px': 1, 'py': 1, 'theta': 0, 'vx': 0, 'vy': 0, 'omega': 0}
GOAL_LANE = {'px': 100, 'py': 2, 'theta': 0}
PULL = 1e4     # weight of the distance to the goal at the end
LONGEST = 300  # iterations


def pulled(goal: dict[str, int]) -> str:
    """Return the terminal cost of the distance to a goal."""
    return f'{PULL}*(' + ' + '.join(f'({name} - {at})**2' for name, at in goal.items()) + ')'


def aircraft() -> Problem:
    """Return the transfer of the aircraft in 5 s."""
    return build_problem({
        'system': 'aircraft', 'running_cost': f'f1**2 + (f2 - {HOVER})**2',
        'terminal_cost': pulled(GOAL_AIRCRAFT),
        'initial_state': dict.fromkeys(GOAL_AIRCRAFT, 0),
        'input_bounds': {'f1': [None, None], 'f2': [None, None]},
        'final_time': {'free': False, 'value': 5}})


def lane_change() -> Problem:
    """Return the lane change of a kinematic bicycle."""
    return build_problem({
        'states': ['px', 'py', 'theta'], 'inputs': ['v', 'phi'], 'parameters': {'l': 3},
        'dynamics': {'px': 'v*cos(theta)', 'py': 'v*sin(theta)', 'theta': 'v/l*tan(phi)'},
        'running_cost': STATE, 'terminal_cost': pulled(GOAL_LANE),
        'initial_state': {'px': 0, 'py': -2, 'theta': 0},
        'input_bounds': {'v': [8, 12], 'phi': [-0.1, 0.1]},
        'final_time': {'free': False, 'value': 10}})


def differential_dynamic_programming(
        crocoddyl: Any, problem: Problem, rest: Array, N: int,
        ) -> Callable[[], tuple[Array, int, bool]]:
    """Return a function that solves a problem with crocoddyl: inputs, iterations, convergence."""
    n, m, x, u = problem.n, problem.m, problem.x, problem.u
    step = held_step(problem, problem.final_time.value / N)
    end = ca.substitute(problem.V, problem.p, problem.p_value)
    values = (kernel(x, u, *step(x, u)), kernel(x, u, x, end))

    class Model(crocoddyl.ActionModelAbstract):  # type: ignore[misc,name-defined] # untyped
        """A step of the dynamics with its cost, or the terminal cost."""

        def __init__(self, values: tuple[ca.Function, ca.Function]) -> None:
            crocoddyl.ActionModelAbstract.__init__(self, crocoddyl.StateVector(n), m, 1)
            self.values, self.derivatives = values

        def calc(self, data: Any, x: Array, u: Array | None = None) -> None:
            """Set the next state and the cost."""
            after, cost = self.values(x, rest if u is None else u)
            data.xnext, data.cost = after.full().ravel(), float(cost)

        def calcDiff(self, data: Any, x: Array, u: Array | None = None) -> None:
            """Set the derivatives."""
            (data.Fx, data.Fu, data.Lx, data.Lu, data.Lxx, data.Lxu, data.Luu) = (
                each.full() if each.shape[1] > 1 or k < 2 else each.full().ravel()
                for k, each in enumerate(self.derivatives(x, rest if u is None else u)))

    running, last = Model(values[0]), Model(values[1])
    bounded = bool(np.isfinite(problem.u_lower).all())
    if bounded:
        running.u_lb, running.u_ub = problem.u_lower, problem.u_upper
    shooting = crocoddyl.ShootingProblem(problem.x0, [running] * N, last)

    def ask() -> tuple[Array, int, bool]:
        solver = (crocoddyl.SolverBoxFDDP if bounded else crocoddyl.SolverFDDP)(shooting)
        inputs = [rest.copy() for _ in range(N)]
        done = solver.solve(shooting.rollout(inputs), inputs, LONGEST)
        return np.array(solver.us.tolist()), solver.iter, done

    return ask


def kernel(x: ca.SX, u: ca.SX, after: ca.SX, cost: ca.SX) -> tuple[ca.Function, ca.Function]:
    """Return a step's values and derivatives as functions."""
    z = ca.vertcat(x, u)
    H, g = ca.hessian(cost, z)
    n = x.numel()
    return ca.Function('values', [x, u], [after, cost]), ca.Function('derivatives', [x, u], [
        ca.densify(each) for each in (
            ca.jacobian(after, x), ca.jacobian(after, u), g[:n], g[n:], H[:n, :n], H[:n, n:],
            H[n:, n:])])


def spent(call: Callable[[], object], rounds: int = 7) -> timing.Times:
    """Return processor times of one call each: neither waits for other processes."""
    seen = []
    for _ in range(rounds):
        begun = time.process_time()
        call()
        seen.append(time.process_time() - begun)
    return timing.Times(tuple(seen))


def beside(name: str, problem: Problem, rest: Array, N: int, crocoddyl: Any) -> None:
    """Time both on one problem, and print the costs of their solutions."""
    numbers = iter(range(1000))

    def anew() -> Any:
        return solve(replace(problem, structure=f'{problem.structure} {next(numbers)}'))

    answer, cache = anew(), Cache()
    solve(problem, cache=cache)
    J, _ = end_error(problem, answer.t, answer.u)
    rows: list[tuple[object, ...]] = [
        (f'first solution: {answer.status.value}, certified', spent(anew), J, ''),
        ('again, certified', spent(lambda: solve(problem, cache=cache)), J, '')]
    if crocoddyl is not None:
        ask = differential_dynamic_programming(crocoddyl, problem, rest, N)
        inputs, iterations, done = ask()
        t = np.linspace(0, problem.final_time.value, N + 1)
        their_J, _ = end_error(problem, np.repeat(t, 2)[1:-1], np.repeat(inputs, 2, axis=0))
        rows.append((f'crocoddyl, N = {N}, {iterations} iterations{"" if done else ": stopped"}',
                     spent(ask), their_J, f'{their_J / J - 1:.1e}'))
    timing.table(name, ('', 'median [minimum to maximum]', 'cost', 'above ours'), rows)
    timing.require('status other than solved', float(answer.status.value != 'solved'), 0.0)


def main() -> int:
    """Measure and print; return the exit status."""
    args = timing.arguments('optimal control compared with crocoddyl')
    crocoddyl = timing.peer('crocoddyl') if args.peers else None
    beside('aircraft, T = 5, terminal cost', aircraft(), np.array([0.0, HOVER]), 100, crocoddyl)
    beside('lane change, state and terminal cost', lane_change(), np.array([10.0, 0.0]), 50,
           crocoddyl)
    return timing.finish()


if __name__ == '__main__':
    sys.exit(main())
