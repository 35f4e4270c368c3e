# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Times of optimal control problems, compared with other tools.

Lane change of a kinematic bicycle (l = 3, from (0, -2, 0) to (100, 2, 0), 8 <= v <= 12,
|phi| <= 0.1, T = 10): minimum effort, and with a state cost; the aircraft from hover to hover in
3 s and in 5 s; and the growth of the time. The times include the certificate.
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
from obc_ros.core.numerics.runge_kutta import RK4, take_step
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Solution, Status
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.solver.initial_guess import estimate_scales, Guesser
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.program_cache import Cache
from obc_ros.core.solver.solve import solve
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh
from obc_ros.core.solver.transcription.program import TightenedLimits, Transcription

Array = NDArray[np.float64]

HOVER = 4 * 9.8
EFFORT = '(v - 10)**2 + phi**2'
STATE = '0.1*(px - 100)**2 + 10*(py - 2)**2 + 0.1*theta**2 + 0.1*(v - 10)**2 + phi**2'
# Minimum costs: by a refined transcription, and by a zero-order hold on 1000 intervals.
LEAST = {'effort': 9.8931187e-4, 'state': 3007.73213, 'T = 3': 5.64651053, 'T = 5': 1.08315146}
GAP, MISS = 1e-4, 1e-5   # relative cost and terminal error that other tools have to reach
SPREAD = 0.05            # change of x(0) between repeated problems


def main() -> int:
    """Measure and print; return the exit status."""
    args = timing.arguments('optimal control')
    for name, cost in (('effort', EFFORT), ('state', STATE)):
        lane_change(name, cost)
    for T in (3.0, 5.0):
        transfer(T, args.peers)
    growth()
    return timing.finish()


def bicycle(cost: str) -> Problem:
    """Return the lane change."""
    return build_problem({
        'states': ['px', 'py', 'theta'], 'inputs': ['v', 'phi'], 'parameters': {'l': 3},
        'dynamics': {'px': 'v*cos(theta)', 'py': 'v*sin(theta)', 'theta': 'v/l*tan(phi)'},
        'running_cost': cost, 'initial_state': {'px': 0, 'py': -2, 'theta': 0},
        'terminal_constraints': ['px - 100', 'py - 2', 'theta'],
        'input_bounds': {'v': [8, 12], 'phi': [-0.1, 0.1]},
        'final_time': {'free': False, 'value': 10}})


def aircraft(T: float) -> Problem:
    """Return the transfer of the aircraft from hover at (0, 0) to hover at (1, 1)."""
    return build_problem({
        'system': 'aircraft', 'running_cost': f'f1**2 + (f2 - {HOVER})**2',
        'initial_state': dict.fromkeys(('px', 'py', 'theta', 'vx', 'vy', 'omega'), 0),
        'terminal_constraints': ['px - 1', 'py - 1', 'theta', 'vx', 'vy', 'omega'],
        'input_bounds': {'f1': [None, None], 'f2': [None, None]},
        'final_time': {'free': False, 'value': T}})


def wall(call: Callable[[], object], rounds: int = 7) -> timing.Times:
    """Return wall times of one call each; no problem is solved twice."""
    seen = []
    for _ in range(rounds):
        begun = time.perf_counter()
        call()
        seen.append(time.perf_counter() - begun)
    return timing.Times(tuple(seen))


def first_and_again(problem: Problem) -> tuple[timing.Times, timing.Times, Solution]:
    """Return times of first and of repeated solutions, and a first solution."""
    numbers = iter(range(1000))

    def anew() -> Solution:
        return solve(replace(problem, structure=f'{problem.structure} {next(numbers)}'))

    answer = anew()
    first = wall(anew)
    cache, chance = Cache(), np.random.default_rng(1)
    solve(problem, cache=cache)

    def again() -> None:
        x0 = problem.x0 + SPREAD * chance.uniform(-1, 1, problem.n)
        found = solve(replace(problem, x0=x0), cache=cache)
        if found.status is not Status.SOLVED:
            raise RuntimeError(found.message)

    return first, wall(again, 15), answer


def end_error(problem: Problem, t: Array, u: Array) -> tuple[float, float]:
    """Return cost and terminal error of a piecewise linear input, integrated finely."""
    f = ca.Function('f', [problem.x, problem.u, problem.p], [problem.f, problem.L])
    z, parts = np.append(problem.x0, 0.0), 40
    for k in np.flatnonzero(np.diff(t) > 0):
        h = (t[k + 1] - t[k]) / parts
        for j in range(parts):
            at = [u[k] + (u[k + 1] - u[k]) * (j + c) / parts for c in (0, 0.5, 1)]

            def rate(z: Array, u: Array) -> Array:
                return np.concatenate([v.full().ravel() for v in f(z[:-1], u, problem.p_value)])

            a = rate(z, at[0])
            b = rate(z + h / 2 * a, at[1])
            c = rate(z + h / 2 * b, at[1])
            z = z + h / 6 * (a + 2 * b + 2 * c + rate(z + h * c, at[2]))
    end = ca.Function('end', [problem.x, problem.p], [problem.V, problem.psi])
    V, psi = (v.full().ravel() for v in end(z[:-1], problem.p_value))
    return float(z[-1] + V[0]), float(np.abs(psi).max(initial=0.0))


def lane_change(name: str, cost: str) -> None:
    """Compare with the default of python-control, and with CasADi and fatrop by hand."""
    problem, least = bicycle(cost), LEAST[name]
    first, again, answer = first_and_again(problem)
    J, miss = end_error(problem, answer.t, answer.u)
    rows: list[tuple[object, ...]] = [
        ('first solution, certified', first, f'{(J - least) / least:.1e}', f'{miss:.1e}'),
        ('again, certified', again, '', '')]
    asked, hand = fatrop_by_hand(problem, least)
    rows.append((f'fatrop by hand, N = {asked[0]}: again', hand, f'{asked[1]:.1e}',
                 f'{asked[2]:.1e}'))
    rival = control_optimal(problem, name)
    if rival:
        seconds, their_J, their_miss = rival
        rows.append(('python-control, 20 points', f'{seconds:.2f} s',
                     f'{(their_J - least) / least:.1e}', f'{their_miss:.1e}'))
    timing.table(f'lane change, {name}',
                 ('', 'median [minimum to maximum]', 'cost gap', 'end error'), rows)
    if rival:
        timing.require('first solution against python-control', first.median / rival[0], 0.02)
        timing.require('terminal error against python-control', miss / rival[2], 1e-3)
    timing.require('repeated solution against fatrop by hand', again.median / hand.median, 1.0)


def fatrop_by_hand(problem: Problem, least: float) -> tuple[tuple[int, float, float],
                                                            timing.Times]:
    """Return (N, cost gap, end error) of the coarsest sufficient shooting, and its times."""
    for N in (20, 50, 100, 200):
        ask = shooting(problem, N)
        J, u = ask(problem.x0)
        t = np.linspace(0, problem.final_time.value, N + 1)
        held = np.repeat(u, 2, axis=0)
        cost, miss = end_error(problem, np.repeat(t, 2)[1:-1], held)
        if (cost - least) / least < GAP and miss < MISS:
            break
    chance = np.random.default_rng(1)
    times = wall(lambda: ask(problem.x0 + SPREAD * chance.uniform(-1, 1, problem.n)), 15)
    return (N, (cost - least) / least, miss), times


def held_step(problem: Problem, h: float) -> ca.Function:
    """Return x after a Runge-Kutta step of order 4 with constant input, and its cost."""
    x, u = problem.x, problem.u
    f = ca.Function('f', [x, u, problem.p], [problem.f, problem.L])
    end, _ = take_step(RK4, lambda z, _: ca.vertcat(*f(z[:-1], u, problem.p_value)),
                       ca.vertcat(x, 0), 0, h)
    return ca.Function('F', [x, u], [end[:-1], end[-1]])


def shooting(problem: Problem, N: int) -> Callable[[Array], tuple[float, Array]]:
    """Return multiple shooting as a user of CasADi writes it, expanded, with fatrop."""
    n, m = problem.n, problem.m
    F = held_step(problem, problem.final_time.value / N)
    X = [ca.MX.sym(f'x{k}', n) for k in range(N + 1)]
    U = [ca.MX.sym(f'u{k}', m) for k in range(N)]
    goal, start = np.array([100.0, 2.0, 0.0]), ca.MX.sym('start', n)
    w, g, equal, lower, upper, J = [], [], [], [], [], ca.MX(0)
    for k in range(N + 1):
        w.append(X[k])
        lower.append(np.full(n, -np.inf))
        upper.append(np.full(n, np.inf))
        if k < N:
            end, part = F(X[k], U[k])
            g.append(X[k + 1] - end)
            equal.extend([True] * n)
            J += part
            w.append(U[k])
            lower.append(problem.u_lower)
            upper.append(problem.u_upper)
        if k == 0:
            g.append(X[0] - start)
            equal.extend([True] * n)
        if k == N:
            g.append(X[N] - goal)
            equal.extend([True] * n)
    solver = ca.nlpsol('hand', 'fatrop', {
        'x': ca.vertcat(*w), 'f': J, 'g': ca.vertcat(*g), 'p': start}, {
        'structure_detection': 'auto', 'equality': equal, 'expand': True, 'print_time': False,
        'fatrop': {'print_level': 0}})
    bounds = {'lbx': np.concatenate(lower), 'ubx': np.concatenate(upper), 'lbg': 0, 'ubg': 0}
    s = np.linspace(0, 1, N + 1)[:, None]
    line = problem.x0 + s * (goal - problem.x0)
    guess = np.append(np.hstack([line[:-1], np.tile([10.0, 0.0], (N, 1))]).ravel(), line[-1])

    def ask(x0: Array) -> tuple[float, Array]:
        found = solver(x0=guess, p=x0, **bounds)
        values = found['x'].full().ravel()[:-n].reshape(N, n + m)
        return float(found['f']), values[:, n:]

    return ask


def control_optimal(problem: Problem, name: str) -> tuple[float, float, float] | None:
    """Return (seconds, cost, end error) of python-control's documented setting."""
    control, optimal = timing.peer('control'), timing.peer('control.optimal')
    if control is None or optimal is None:
        return None

    def update(t: float, x: Array, u: Array, params: Any) -> Array:
        return np.array([u[0] * np.cos(x[2]), u[0] * np.sin(x[2]), u[0] / 3 * np.tan(u[1])])

    system = control.NonlinearIOSystem(update, None, states=3, inputs=2, outputs=3)
    goal, rest = np.array([100.0, 2.0, 0.0]), np.array([10.0, 0.0])
    Q, R = ((np.zeros((3, 3)), np.eye(2)) if name == 'effort'
            else (np.diag([0.1, 10, 0.1]), np.diag([0.1, 1])))
    t = np.linspace(0, 10, 20)
    begun = time.perf_counter()
    found = optimal.solve_ocp(
        system, t, problem.x0, optimal.quadratic_cost(system, Q, R, x0=goal, u0=rest),
        optimal.input_range_constraint(system, [8, -0.1], [12, 0.1]),
        terminal_constraints=optimal.state_range_constraint(system, goal, goal),
        initial_guess=rest, print_summary=False)
    seconds = time.perf_counter() - begun
    J, miss = end_error(problem, t, found.inputs.T)
    return seconds, J, miss


def transfer(T: float, peers: bool) -> None:
    """Time the transfer of the aircraft; with `--peers` also drake."""
    problem, least = aircraft(T), LEAST[f'T = {T:g}']
    first, again, answer = first_and_again(problem)
    J, miss = end_error(problem, answer.t, answer.u)
    cache = Cache()
    solve(problem, cache=cache)
    same = wall(lambda: solve(problem, cache=cache))
    rows: list[tuple[object, ...]] = [
        ('first solution, certified', first, f'{(J - least) / least:.1e}', f'{miss:.1e}'),
        ('again with other numbers, certified', again, '', ''),
        ('the same again, certified', same, '', '')]
    rival = drake_collocation(T) if peers else None
    if rival:
        rows.append(('drake + SNOPT, N = 50', rival, '', ''))
    timing.table(f'aircraft, T = {T:g}',
                 ('', 'median [minimum to maximum]', 'cost gap', 'end error'), rows)
    timing.require(f'relative cost gap, T = {T:g}', abs(J - least) / least, GAP)
    timing.require(f'the same again against the first solution, T = {T:g}',
                   same.median / first.median, 1.0)
    if rival and T > 4:
        timing.require('first solution against drake', first.median / rival.median, 0.5)


def drake_collocation(T: float) -> timing.Times | None:
    """Return times of drake's DirectCollocation with SNOPT on a symbolic plant."""
    trajectory = timing.peer('pydrake.planning')
    primitives, solvers = timing.peer('pydrake.systems.primitives'), timing.peer('pydrake.solvers')
    symbolic = timing.peer('pydrake.symbolic')
    if None in (trajectory, primitives, solvers, symbolic):
        return None
    x = [symbolic.Variable(f'x{i}') for i in range(6)]
    u = [symbolic.Variable(f'u{i}') for i in range(2)]
    c, s = symbolic.cos(x[2]), symbolic.sin(x[2])
    plant = primitives.SymbolicVectorSystem(state=x, input=u, output=x, dynamics=[
        x[3], x[4], x[5], (u[0] * c - u[1] * s - 0.05 * x[3]) / 4,
        (u[0] * s + u[1] * c - 0.05 * x[4]) / 4 - 9.8, 0.25 * u[0] / 0.0475])

    def ask() -> None:
        program = trajectory.DirectCollocation(
            plant, plant.CreateDefaultContext(), 51, T / 50, T / 50)
        program.AddEqualTimeIntervalsConstraints()
        prog, goal = program.prog(), np.array([1.0, 1, 0, 0, 0, 0])
        prog.AddBoundingBoxConstraint(np.zeros(6), np.zeros(6), program.initial_state())
        prog.AddBoundingBoxConstraint(goal, goal, program.final_state())
        program.AddRunningCost(program.input()[0]**2 + (program.input()[1] - HOVER)**2)
        for k in range(51):
            prog.SetInitialGuess(program.state(k), goal * k / 50)
            prog.SetInitialGuess(program.input(k), np.array([0, HOVER]))
        solvers.SnoptSolver().Solve(prog)

    return wall(ask)


def growth() -> None:
    """Print the growth of the time with the numbers of intervals and of states."""
    rows: list[tuple[object, ...]] = []
    seen = []
    for N in (50, 100, 200, 400, 800):
        build, ask, iterations = one_solve(bicycle(EFFORT), N)
        seen.append(ask.median / iterations)
        rows.append((f'lane change, N = {N}', f'{1e3 * build:.1f} ms', ask, iterations))
    for n in (2, 5, 10, 20):
        build, ask, iterations = one_solve(chain(n), 100)
        rows.append((f'chain of {n} states, N = 100', f'{1e3 * build:.1f} ms', ask, iterations))
    timing.table('growth of one transcription', (
        '', 'build', 'solve, median [minimum to maximum]', 'iterations'), rows)
    timing.require('time of an iteration, N = 800 against 16 times N = 50',
                   seen[-1] / seen[0] / 16, 2.0)


def chain(n: int) -> Problem:
    """Return masses on springs, brought to rest by the last one with minimum effort."""
    names = [f'x{i}' for i in range(n)]
    dynamics = {name: f'{after} - 0.1*sin({name})' for name, after in zip(
        names, [*names[1:], 'u'], strict=True)}
    return build_problem({
        'states': names, 'inputs': ['u'], 'dynamics': dynamics, 'running_cost': 'u**2 + x0**2',
        'initial_state': {name: 1.0 if name == 'x0' else 0.0 for name in names},
        'final_time': {'free': False, 'value': 5}})


def one_solve(problem: Problem, N: int) -> tuple[float, timing.Times, int]:
    """Return the time to build, the times to solve and the iterations of one program."""
    mesh = build_uniform_mesh(problem, N, 0)
    guess = Guesser(problem).line(problem, problem.final_time.value)
    sizes = estimate_scales(problem, guess)
    limits = TightenedLimits(np.zeros(1), np.ones(1), np.zeros(problem.n),
                             np.zeros(problem.n, dtype=bool), np.full(problem.n, np.nan))
    begun = time.perf_counter()
    program = Transcription(problem, mesh.layout)
    start = program.start(mesh, guess, guess.durations, sizes)
    outcome = program.solve(problem, mesh, start, sizes, limits, Meter())
    first = time.perf_counter() - begun
    if not outcome.converged:
        raise RuntimeError(outcome.status)
    times = wall(lambda: program.solve(problem, mesh, start, sizes, limits, Meter()))
    # Derivatives are built on first use.
    return max(first - times.median, 0.0), times, outcome.iterations


if __name__ == '__main__':
    sys.exit(main())
