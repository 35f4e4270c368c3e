# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Stiff and large linear quadratic problems: certified solutions and closed forms."""

from dataclasses import replace
import math

import numpy as np
from obc_ros.core.ocp.certificate.affine_replay import AffineReplay, replay_affine
from obc_ros.core.ocp.certificate.certificate import certify
from obc_ros.core.ocp.certificate.replay import Intervals, ReplayIntegrator
from obc_ros.core.ocp.solution import Status
from obc_ros.core.riccati import propagation
from obc_ros.core.solver.linear_quadratic import solve_lq
from obc_ros.core.solver.solve import solve
import problems
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_continuous_are


def rod(cells, *, inputs=1, T=1.0):
    """Return the heat equation on a rod: left end cold, right end or all cells heated."""
    names, rate = [f'y{k}' for k in range(cells)], (cells + 1)**2
    heat = [f'u{k}' for k in range(inputs)]

    def line(k):
        left = names[k - 1] if k else '0'
        right = names[k + 1] if k < cells - 1 else ('u0' if inputs == 1 else '0')
        source = '' if inputs == 1 else f' + {heat[k]}'
        return f'{rate}*({left} - 2*{names[k]} + {right}){source}'

    return problems.pose(
        {name: line(k) for k, name in enumerate(names)},
        f'({" + ".join(f"{name}**2" for name in names)})/{cells} + '
        f'0.01*({" + ".join(f"{name}**2" for name in heat)})',
        [math.sin(math.pi * (k + 1) / (cells + 1)) + 0.3 * (k % 2) for k in range(cells)], T,
        inputs=heat)


def cascade(ratio):
    """Return three lags in series, the fastest `ratio` times as fast as the slowest."""
    middle = math.sqrt(ratio)
    return problems.pose({'a': '-a + b', 'b': f'{middle}*(c - b)', 'c': f'{ratio}*(u - c)'},
                         'a**2 + b**2 + c**2 + u**2', (1, 1, 1), 1.0)


def scalar_cost(a, b, q, r, T):
    """Return P(0) of x' = a x + b u, cost the integral of q x^2 + r u^2."""
    root = math.sqrt(a*a + b*b*q/r)
    decay = math.exp(-2*root*T)
    return q * (1 - decay) / (root - a + (root + a)*decay)


def simulate(problem, solution):
    """Return x(T) and the cost of the input to `cascade`, integrated by an implicit method."""
    import casadi as ca
    A, B = (np.array(ca.DM(ca.evalf(ca.jacobian(problem.f, z)))) for z in (problem.x, problem.u))
    J = np.zeros((4, 4))
    J[:3, :3] = A

    def rate(t, z):
        u = np.interp(t, solution.t, solution.u[:, 0])
        return np.append(A @ z[:-1] + B[:, 0] * u, z[:-1] @ z[:-1] + u*u)

    z = np.append(problem.x0, 0.0)
    for low, high in zip(solution.t[:-1], solution.t[1:], strict=True):
        z = solve_ivp(rate, (low, high), z, 'Radau', rtol=1e-7, atol=1e-10, jac=J).y[:, -1]
    return z[:-1], z[-1]


# ---------------------------------------------------------------- solutions


@pytest.mark.parametrize('ratio', [1e2, 1e3, 1e4, 1e5, 1e6, 1e7])
def test_widely_spread_time_constants_are_certified(ratio):
    problem = cascade(ratio)
    solution = solve(problem)
    assert (solution.status, solution.method) == (Status.SOLVED, 'riccati')
    assert certify(problem, solution).holds


def test_a_simulation_reproduces_a_stiff_solution():
    problem = cascade(1e6)
    solution = solve(problem)
    end, cost = simulate(problem, solution)
    assert end == pytest.approx(solution.x[-1], abs=1e-6)
    assert cost == pytest.approx(solution.objective, rel=1e-6)


@pytest.mark.parametrize('fastest', [1.0, 1e3, 1e6])
def test_decoupled_states_cost_the_sum_of_scalar_problems(fastest):
    """
    Each state has its own input: the sum of three scalar closed forms.

    The solver halves a step until the fastest state hardly changes, then doubles it as often.
    Doubling amplifies the rounding errors of the slow states by the ratio of the rates, for
    which the tolerance allows.
    """
    rates = [1.0, math.sqrt(fastest), fastest]
    problem = problems.pose(
        {f'x{k}': f'{-a}*x{k} + {a}*u{k}' for k, a in enumerate(rates)},
        'x0**2 + 2*x1**2 + 3*x2**2 + u0**2 + u1**2 + u2**2', (1, -1, 2), 1.0,
        inputs=['u0', 'u1', 'u2'])
    solution = solve(problem)
    assert solution.status is Status.SOLVED
    assert solution.objective == pytest.approx(sum(
        scalar_cost(-a, a, q, 1.0, 1.0) * x * x for a, q, x in zip(
            rates, [1, 2, 3], [1, -1, 2], strict=True)), rel=1e-12 + 1e-15 * fastest)


@pytest.mark.parametrize('cells', [5, 20])
def test_a_rod_heated_in_all_cells_costs_the_sum_of_its_modes(cells):
    """All cells have the same weight, so that each mode of the rod is a scalar problem."""
    problem = rod(cells, inputs=cells)
    A = (cells + 1)**2 * (np.eye(cells, k=1) - 2*np.eye(cells) + np.eye(cells, k=-1))
    rates, modes = np.linalg.eigh(A)
    solution = solve(problem)
    assert (solution.status, solution.method) == (Status.SOLVED, 'riccati')
    assert solution.objective == pytest.approx(sum(
        scalar_cost(a, 1.0, 1/cells, 0.01, 1.0) * x * x
        for a, x in zip(rates, modes.T @ problem.x0, strict=True)), rel=1e-10)


def test_a_rod_heated_at_its_end_agrees_with_the_riccati_equation():
    """An implicit method integrates the equation for the whole matrix P."""
    cells = 8
    problem = rod(cells)
    A = (cells + 1)**2 * (np.eye(cells, k=1) - 2*np.eye(cells) + np.eye(cells, k=-1))
    B = (cells + 1)**2 * np.eye(cells)[:, -1:]

    def rate(_, P):
        P = P.reshape(cells, cells)
        return (P @ A + A.T @ P - P @ B @ B.T @ P / 0.01 + np.eye(cells) / cells).ravel()

    P = solve_ivp(rate, (0, 1), np.zeros(cells**2), 'BDF', rtol=1e-9, atol=1e-13).y[:, -1]
    solution = solve(problem)
    assert solution.status is Status.SOLVED
    assert solution.objective == pytest.approx(
        problem.x0 @ P.reshape(cells, cells) @ problem.x0, rel=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize('cells', [40, 80])
def test_long_rods_cost_as_much_as_over_an_infinite_horizon(cells):
    """The cost after 1 s is smaller by exp(-2 pi^2) = 3e-9, from the slowest mode."""
    problem = rod(cells)
    A = (cells + 1)**2 * (np.eye(cells, k=1) - 2*np.eye(cells) + np.eye(cells, k=-1))
    B = (cells + 1)**2 * np.eye(cells)[:, -1:]
    P = solve_continuous_are(A, B, np.eye(cells) / cells, np.array([[0.01]]))
    solution = solve(problem)
    assert (solution.status, solution.method) == (Status.SOLVED, 'riccati')
    assert solution.objective == pytest.approx(problem.x0 @ P @ problem.x0, rel=1e-7)


@pytest.mark.parametrize('a', [1.0, 1e3, 1e6])
def test_a_fast_state_meets_its_terminal_constraint(a):
    """From 0 to w = (1, 0.5) the minimum effort is w' W^-1 w with the Gramian W of [0, T]."""
    problem = problems.pose({'x': f'{-a}*x + {a}*u', 'y': '-0.5*y + u'}, 'u**2', (0, 0), 1.0,
                            terminal_constraints=['x - 1', 'y - 0.5'])
    rates, gains = np.array([a, 0.5]), np.array([a, 1.0])
    sums = rates + rates[:, None]
    gramian = gains * gains[:, None] * -np.expm1(-sums) / sums
    wanted = np.array([1.0, 0.5])
    solution = solve(problem)
    assert solution.status is Status.SOLVED
    assert solution.objective == pytest.approx(
        wanted @ np.linalg.solve(gramian, wanted), rel=1e-7)
    assert solution.x[-1] == pytest.approx(wanted, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize('a', [1e2, 1e3, 1e5])
def test_an_unstable_fast_state_is_stabilised(a):
    """A slow state is decoupled from it: the sum of two scalar closed forms."""
    problem = problems.pose({'x': f'{a}*(x + u)', 'y': '-y + w'}, 'x**2 + u**2 + y**2 + w**2',
                            (1, 1), 2.0, inputs=['u', 'w'])
    solution = solve(problem)
    assert solution.status is Status.SOLVED
    assert solution.objective == pytest.approx(
        scalar_cost(a, a, 1, 1, 2.0) + scalar_cost(-1, 1, 1, 1, 2.0), rel=1e-9)


@pytest.mark.parametrize('weight', [1.0, 0.0, -0.2])
@pytest.mark.parametrize('doublings', [0, 2, 5])
def test_inner_states_follow_the_hamiltonian_system(weight, doublings):
    """x(0) is given, lam(T) = P x(T), and each step is a matrix exponential of the system."""
    chance = np.random.default_rng(3)
    n, steps, step = 3, 32, 0.04
    A, half = chance.standard_normal((2, n, n))
    G, Q, P = half @ half.T, weight * np.eye(n), np.diag([2.0, 0.0, 1.0])
    levels = [propagation.build_stretch(A, G, Q, step * 2**k) for k in range(doublings + 1)]
    x0 = chance.standard_normal(n)
    x, y = propagation.solve_inside(levels, x0, P, steps)
    both = np.hstack([x, y])
    flow = expm(step * np.block([[A, -G], [-Q, -A.T]]))
    assert x[0] == pytest.approx(x0, rel=1e-12)
    assert y[-1] == pytest.approx(P @ x[-1], rel=1e-12, abs=1e-12)
    assert both[1:] == pytest.approx(both[:-1] @ flow.T, rel=1e-10, abs=1e-10)


# ---------------------------------------------------------------- the certificate


def test_matrix_exponentials_agree_with_small_steps():
    """Two states, a path constraint and multiplier densities, all of them random numbers."""
    problem = problems.pose(
        {'x': 'v - 0.3*x + 1', 'v': '2*u - x'}, 'x**2 + x*u + u**2 + 3*v + 1', (0, 0), 1.0,
        path_constraints=[{'expr': 'x + 2*v + u', 'lower': -9, 'upper': 9}])
    chance = np.random.default_rng(0)
    K = 6
    x, lam, sa, sb = (chance.standard_normal((K, 2)) for _ in range(4))
    ua, ub, ma, mb = (chance.standard_normal((K, 1)) for _ in range(4))
    given = Intervals(
        h=np.array([0.5, 0.5, 0.3, 1.0, 0.125, 0.7]), x=x, lam=lam, ua=ua, ub=ub, sa=sa, sb=sb,
        ma=ma, mb=mb)
    small = ReplayIntegrator(problem).replay(given, problem.p_value, np.ones(4), 1e-11)
    rates = AffineReplay(problem).rates(
        problem.p_value, np.array([2.0, 0.5]), np.hstack([ua, sa, ma]), given.h)
    w = np.hstack([ua, sa, ma]), np.hstack([ub, sb, mb])
    ahead = replay_affine(rates, given.h, x, w, lam, 4, back=False)
    assert ahead[:, :, :2] == pytest.approx(small.x, abs=1e-9)
    assert ahead[:, :, 2:4] == pytest.approx(small.lam, abs=1e-9)
    assert ahead[:, -1, 4] == pytest.approx(small.cost, abs=1e-9)
    back = replay_affine(rates, given.h, x, w, small.lam[:, -1], 4, back=True)
    assert back[:, :, 2:4] == pytest.approx(small.lam, abs=1e-9)


def test_matrix_exponentials_are_exact_for_a_fast_decay():
    """With x' = a (u - x), u = 1 + t: x = 1 + t - 1/a + exp(-a t)/a, a layer of width 1/a."""
    a = 1e6
    problem = problems.pose({'x': f'{a}*(u - x)'}, 'x**2', (1,), 1.0)
    none = np.zeros((1, 1))
    one = Intervals(
        h=np.array([1.0]), x=none + 1, lam=none, ua=none + 1, ub=none + 2, sa=none, sb=none,
        ma=np.zeros((1, 0)), mb=np.zeros((1, 0)))
    integrator = ReplayIntegrator(problem)
    run = one, problem.p_value, np.ones(2), 1e-10
    course, left = integrator.there_and_back(integrator.replay(*run), one, none, *run[1:])
    t = np.linspace(0, 1, 5)
    assert course.converged
    assert course.x[0, :, 0] == pytest.approx(1 + t - (1 - np.exp(-a*t))/a, abs=1e-12)
    # The integral of (1 + t - 1/a)^2, plus the contribution of the layer.
    mean, d = 1 - 1/a, 1/a
    cost = ((mean + 1)**3 - mean**3)/3 + 2*d*(mean*d + d*d) + d*d*d/2
    assert course.cost[0] == pytest.approx(cost, rel=1e-10)
    # dlam/dt = a lam - 2 x, lam(1) = 0: lam(0) is the integral of 2 x exp(-a t).
    assert left[0, 0] == pytest.approx(-2*(mean*d + d*d + d*d/2), rel=1e-9)


def cost_rate(solution):
    """Return |lam|'|dx/dt| at the first samples, where it is largest."""
    rates = np.abs(np.diff(solution.x[:2], axis=0)[0]) / np.diff(solution.t[:2])
    return np.abs(solution.lam[0]) @ rates


@pytest.mark.parametrize('name, change', [
    ('x', lambda s: s.x * (1 + 1e-4 * np.sin(9*s.t))[:, None]),
    ('u', lambda s: s.u + 0.05 * np.abs(s.u).max() * np.sin(9*s.t)[:, None]),
    ('lam', lambda s: s.lam * (1 + 1e-2 * np.sin(9*s.t))[:, None]),
    ('hamiltonian', lambda s: s.hamiltonian + 1e-3 * cost_rate(s)),
])
@pytest.mark.parametrize('problem', [cascade(1e4), cascade(1e6), rod(20)],
                         ids=['1e4', '1e6', 'rod'])
def test_a_wrong_solution_of_a_stiff_problem_is_not_certified(problem, name, change):
    solution = solve_lq(problem)
    assert certify(problem, solution).holds
    assert not certify(problem, replace(solution, **{name: change(solution)})).holds


def test_a_cost_that_is_too_low_is_not_certified():
    problem = cascade(1e6)
    solution = solve_lq(problem)
    wrong = replace(solution, objective=solution.objective * (1 - 1e-5))
    assert certify(problem, wrong).worst == 'cost'
