# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The receding horizon: time of a step and equal costs; random starts in the terminal set.

The aircraft begins 3 m beside its set point with a bound of the attitude that the regulator
breaks. Compared with the same horizon written by hand with CasADi and its fatrop (exact Hessian,
started from the shifted plan and multipliers), interpreted and compiled, and with --peers with
do-mpc. Each follows its own closed loop; all are timed in turn, state by state.
"""

import sys

import timing  # isort: skip - before numpy

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
import math
import os
from pathlib import Path
import tempfile
import time
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.receding.formulation import RecedingProblem, state_receding_problem
from obc_ros.core.receding.step_kernel import compile_function
from obc_ros.core.receding.step_solver import Plan, StepSolver
from obc_ros.core.receding.terminal_set import find_terminal_set, TerminalSet
from obc_ros.core.systems.registry import get_system

Array = NDArray[np.float64]

PERIOD, START = 0.02, (3.0, 1.0, 0.0, 0.0, 0.0, 0.0)
LIMITS = {'state_bounds': {'theta': [-0.3, 0.3]}, 'input_bounds': {'f1': [-3, 3], 'f2': [30, 50]}}


class Rival(Protocol):
    """A controller of the comparison."""

    def step(self, x: Array, t: float) -> Array:
        """Return the input at a state."""


def main() -> int:
    """Measure and print; return the exit status."""
    args = timing.arguments('receding horizon', steps=200, starts=10000)
    for N in (20, 50, 100):
        compare(N, int(args.steps), args.peers)
    for name in ('aircraft', 'vehicle'):
        leave_terminal_set(name, int(args.starts))
    return timing.finish()


def fly(N: int) -> RecedingProblem:
    """Return the aircraft with limits."""
    return state_receding_problem(get_system('aircraft'), horizon=N, period=PERIOD,
                                  weights={'Qx': [10, 10, 1, 1, 1, 1], 'Qu': [0.1, 0.1]},
                                  limits=LIMITS)


class Ours:
    """The step solver, from the plan before."""

    def __init__(self, problem: RecedingProblem, folder: Path) -> None:
        self.solver = StepSolver(problem, folder)
        self.solver.prepare()
        self.plan: Plan | None = None
        self.worst = 0.0
        self.optimal = 0

    def step(self, x: Array, t: float) -> Array:
        """Return the input at a state."""
        result = self.solver.solve(x, self.plan, stamp=t)
        assert result.plan is not None
        self.plan = result.plan
        self.worst = max(self.worst, result.residual)
        self.optimal += result.status == 'optimal'
        u: Array = result.plan.u[0]
        return u


class ByHand:
    """Multiple shooting with fatrop, started from the shifted solution."""

    def __init__(self, problem: RecedingProblem, compiled: bool) -> None:
        self.problem = problem
        N, n, m = problem.horizon, len(problem.xe), len(problem.ue)
        weights, model = problem.weights, problem.model
        assert weights.cross is not None
        W = np.block([[weights.Qx, weights.cross], [weights.cross.T, weights.Qu]])
        start = ca.MX.sym('start', n)
        E = [ca.MX.sym(f'e{k}', n) for k in range(N + 1)]
        V = [ca.MX.sym(f'v{k}', m) for k in range(N)]
        box = problem.input_box
        low = problem.limits.x_lower - problem.xe
        high = problem.limits.x_upper - problem.xe
        bounded = np.flatnonzero(np.isfinite(low) | np.isfinite(high))
        unknowns: list[ca.MX] = []
        rows: list[ca.MX] = []
        lower: list[Array] = []
        upper: list[Array] = []
        equal: list[bool] = []
        cost = E[N].T @ ca.DM(problem.P) @ E[N]
        for k in range(N + 1):
            unknowns += [E[k], *V[k:k + 1]]
            if k < N:
                z = ca.vertcat(E[k], V[k])
                cost += z.T @ ca.DM(W) @ z
                rows.append(E[k + 1] - model(E[k], V[k]))
                lower.append(np.zeros(n))
                upper.append(np.zeros(n))
                equal += [True] * n
            if k == 0:
                rows.append(E[0] - start)
                lower.append(np.zeros(n))
                upper.append(np.zeros(n))
                equal += [True] * n
            if k < N:
                rows.append(V[k])
                lower.append(box[0])
                upper.append(box[1])
                equal += [False] * m
            if k:
                rows.append(E[k][bounded.tolist()])
                lower.append(low[bounded])
                upper.append(high[bounded])
                equal += [False] * len(bounded)
        options: dict[str, Any] = {
            'structure_detection': 'auto', 'equality': equal, 'print_time': False,
            'error_on_fail': False, 'fatrop': {'print_level': 0, 'tol': 1e-6, 'mu_init': 1e-2}}
        if compiled:
            options |= {'jit': True, 'compiler': 'shell', 'jit_options': {'flags': ['-O2']}}
        self.solver = ca.nlpsol('byhand', 'fatrop', {
            'x': ca.vertcat(*unknowns), 'f': cost, 'g': ca.vertcat(*rows), 'p': start}, options)
        self.bounds = np.concatenate(lower), np.concatenate(upper)
        self.n, self.m, self.width = n, m, n + m
        self.z = np.zeros(N * (n + m) + n)
        self.lam: ca.DM | float = 0.0
        self.solved = 0

    def step(self, x: Array, t: float) -> Array:
        """Return the input at a state."""
        answer = self.solver(x0=self.z, p=self.problem.error(x, t), lbg=self.bounds[0],
                             ubg=self.bounds[1], lam_g0=self.lam)
        self.solved += bool(self.solver.stats()['success'])
        z = answer['x'].full().ravel()
        self.lam = answer['lam_g']
        self.z = np.concatenate([z[self.width:], z[-self.width:]])
        v: Array = z[self.n:self.width]
        return v + self.problem.ue


class DoMpc:
    """do-mpc with its discrete model, the same cost and ipopt."""

    def __init__(self, problem: RecedingProblem, module: Any) -> None:
        self.problem = problem
        model = module.model.Model('discrete', 'SX')
        e = model.set_variable('_x', 'e', (len(problem.xe), 1))
        v = model.set_variable('_u', 'v', (len(problem.ue), 1))
        model.set_rhs('e', problem.model(e, v))
        model.setup()
        self.mpc = mpc = module.controller.MPC(model)
        mpc.set_param(n_horizon=problem.horizon, t_step=problem.period, n_robust=0,
                      store_full_solution=False, nlpsol_opts={
                          'ipopt.print_level': 0, 'ipopt.sb': 'yes', 'print_time': 0,
                          'ipopt.tol': 1e-6})
        weights = problem.weights
        assert weights.cross is not None
        W = np.block([[weights.Qx, weights.cross], [weights.cross.T, weights.Qu]])
        z = ca.vertcat(e, v)
        mpc.set_objective(mterm=e.T @ ca.DM(problem.P) @ e, lterm=z.T @ ca.DM(W) @ z)
        mpc.set_rterm(v=0.0)
        mpc.bounds['lower', '_u', 'v'], mpc.bounds['upper', '_u', 'v'] = problem.input_box
        low = problem.limits.x_lower - problem.xe
        high = problem.limits.x_upper - problem.xe
        mpc.bounds['lower', '_x', 'e'], mpc.bounds['upper', '_x', 'e'] = low, high
        mpc.setup()
        mpc.x0 = problem.error(np.array(START))
        mpc.set_initial_guess()

    def step(self, x: Array, t: float) -> Array:
        """Return the input at a state."""
        v: Array = self.mpc.make_step(self.problem.error(x, t)[:, None]).ravel()
        return v + self.problem.ue


def compare(N: int, steps: int, peers: bool) -> None:
    """Run the closed loops of all rivals in turn, and print the times of their steps."""
    problem = fly(N)
    with tempfile.TemporaryDirectory() as folder, work_in(folder):
        rivals: dict[str, Rival] = {'ours': Ours(problem, Path(folder)),
                                    'fatrop, interpreted': ByHand(problem, False),
                                    'fatrop, compiled': ByHand(problem, True)}
        module = timing.peer('do_mpc') if peers else None
        if module is not None:
            rivals['do-mpc'] = DoMpc(problem, module)
        states = {name: np.array(START) for name in rivals}
        times: dict[str, list[float]] = {name: [] for name in rivals}
        costs = dict.fromkeys(rivals, 0.0)
        excess = dict.fromkeys(rivals, 0.0)
        for k in range(steps):
            for name, rival in rivals.items():
                x = states[name]
                begun = time.process_time()
                u = rival.step(x, k * PERIOD)
                times[name].append(time.process_time() - begun)
                costs[name] += stage_cost(problem, x, u)
                states[name] = problem.xe + problem.model(
                    x - problem.xe, u - problem.ue).full().ravel()
                excess[name] = max(excess[name], abs(states[name][2]) - 0.3)
    found = {name: timing.Times(tuple(each[5:])) for name, each in times.items()}
    timing.table(f'Closed loop of the aircraft, N = {N}, {steps} steps', (
        '', 'median [ms]', 'p99 [ms]', 'max [ms]', 'cost', 'theta over its bound [rad]'), [
            (name, f'{each.median * 1e3:.3g}', f'{np.percentile(each.rounds, 99) * 1e3:.3g}',
             f'{max(each.rounds) * 1e3:.3g}', f'{costs[name]:.8g}', f'{excess[name]:.2g}')
            for name, each in found.items()])
    ours, hand = rivals['ours'], rivals['fatrop, compiled']
    assert isinstance(ours, Ours) and isinstance(hand, ByHand)
    print(f'  optimal: ours {ours.optimal}, fatrop {hand.solved} of {steps}')
    best = min(found['fatrop, interpreted'].median, found['fatrop, compiled'].median)
    timing.require(f'N = {N}: step over the better fatrop', found['ours'].median / best, 1.0)
    if 'do-mpc' in found:
        timing.require(f'N = {N}: step over do-mpc', found['ours'].ratio(found['do-mpc']), 0.2)
    timing.require(f'N = {N}: worst residual of a step', ours.worst, 1e-6)
    timing.require(f'N = {N}: bound of theta exceeded [rad]', excess['ours'], 1e-6)
    timing.require(f'N = {N}: relative difference of the costs', abs(
        costs['ours'] / costs['fatrop, compiled'] - 1.0), 1e-4)


@contextmanager
def work_in(folder: str) -> Iterator[None]:
    """Change to a folder, where CasADi leaves the files of its compiler."""
    before = os.getcwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def stage_cost(problem: RecedingProblem, x: Array, u: Array) -> float:
    """Return the cost of one period."""
    e, v, weights = x - problem.xe, u - problem.ue, problem.weights
    assert weights.cross is not None
    return float(e @ weights.Qx @ e + 2.0 * e @ weights.cross @ v + v @ weights.Qu @ v)


def leave_terminal_set(name: str, starts: int) -> None:
    """Print how many random starts leave the terminal set, exactly and with 5 % model error."""
    problem = fly(20) if name == 'aircraft' else state_receding_problem(
        get_system(name), horizon=20, period=PERIOD, setpoint=[0.0] * 3,
        setpoint_input=[10.0, 0.0], limits={'input_bounds': {'v': [0, 15]}})
    found = find_terminal_set(problem)
    print(f'\n{name}: {found.words}')
    plant = problem.design.plant
    rows = []
    for parameter in (None, *plant.system.parameters):
        changes = (1.0,) if parameter is None else (0.95, 1.05)
        for factor in changes:
            system = plant.system if parameter is None else plant.system.with_parameters(
                {parameter.name: factor * parameter.value})
            true = replace(problem, design=replace(problem.design, plant=replace(
                plant, system=system)))
            left, farthest = count_leaving(true, found, starts)
            what = 'exact' if parameter is None else f'{parameter.name} x {factor:g}'
            rows.append((what, left, f'{farthest:.3g}'))
            if parameter is None:
                timing.require(f'{name}: starts that leave the set', left, 0)
    timing.table(f'{name}: of {starts} random starts, 500 samples each', (
        'plant', 'leave the set', 'largest V / level'), rows)


def count_leaving(problem: RecedingProblem, found: TerminalSet, starts: int) -> tuple[int, float]:
    """Return how many random starts leave the set, and the largest V / level."""
    random = np.random.default_rng(0)
    n = len(problem.xe)
    z = random.normal(size=(starts, n))
    z *= random.uniform(size=(starts, 1))**(1 / n) / np.linalg.norm(z, axis=1, keepdims=True)
    e = np.sqrt(found.level) * z @ np.linalg.cholesky(np.linalg.inv(found.P)).T
    worst = np.zeros(starts)
    with tempfile.TemporaryDirectory() as folder:
        steps = compile_function(problem.model.map(starts), Path(folder)).function
        for _ in range(500):
            e = steps(e.T, -problem.K @ e.T).full().T
            V = np.einsum('ki,ij,kj->k', e, found.P, e) / found.level
            worst = np.fmax(worst, np.where(np.isfinite(V), V, math.inf))
    return int((worst > 1.0).sum()), float(worst.max())


if __name__ == '__main__':
    sys.exit(main())
