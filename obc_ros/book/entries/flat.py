# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Flat trajectories compared with optimal ones: Exercises 2.4 and 2.5.

The state x is a flat output: every smooth z with z(t0) = x(t0) and z(tf) = x(tf) is a trajectory.
Its coefficients in 1, t, t^2 .. are the variables of a minimisation.
"""

from collections.abc import Callable, Sequence
from math import exp, sinh, sqrt
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import EXACT, EXACT_LINE, get_line, LINE_COLOURS
from obc_ros.book.closed_forms import solve_scalar_finite_horizon
from obc_ros.book.entry import (
    ComparedRow,
    create_panels,
    EntryResult,
    GalleryEntry,
    label_axes,
    place_legend_below,
)
from obc_ros.book.page import format_scientific
from obc_ros.book.runner import Desk, Trajectory
from obc_ros.core.numerics.arrays import Array
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq, minimize

Drift = Callable[[Any], Any]

TF = 1.0
OTHER = {'x0': -1.5, 'c': 10.0, 'a': 2.0, 'b': 0.5, 'tf': 0.8}
COUNTS = (2, 3, 4, 5, 6)  # M
MANY_WEIGHTS = tuple(np.logspace(-2, 6, 17))
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(24)
NODES, SHARES = (_POINTS + 1) * TF / 2, _WEIGHTS * TF / 2  # exact to degree 47


def state_problem(power: int, x0: float, c: float, end: float | None = None, *, a: float = 1.0,
                  b: float = 1.0, tf: float = TF) -> dict[str, Any]:
    """Return the problem for x' = -a x^power + b u, with x(tf) = end if that is given."""
    fixed = {} if end is None else {'terminal_constraints': [f'x - {end!r}']}
    return {'states': ['x'], 'inputs': ['u'], 'parameters': {'a': a, 'b': b, 'c': c},
            'dynamics': {'x': '-a*x + b*u' if power == 1 else f'-a*x**{power} + b*u'},
            'running_cost': 'u**2/2', 'terminal_cost': 'c*x**2/2', 'initial_state': {'x': x0},
            'final_time': {'free': False, 'value': tf}, **fixed}


def state_flat_request(M: int, power: int) -> dict[str, Any]:
    """Return the request for the M coefficients of z from 0 to 1; a quadrature gives the cost."""
    names = [f'c{k}' for k in range(M)]
    terms = []
    for t, share in zip(NODES, SHARES, strict=True):
        z = ' + '.join(f'{t**k:.17g}*{name}' for k, name in enumerate(names))
        dz = ' + '.join(f'{k * t**(k - 1):.17g}*{name}' for k, name in enumerate(names) if k)
        terms.append(f'{share / 2:.17g}*({dz} + ({z}){f"**{power}" if power > 1 else ""})**2')
    return {'variables': names, 'cost': f'1/2 + {" + ".join(terms)}',
            'equalities': ['c0', ' + '.join(names) + ' - 1']}


def compute_curve(c: Sequence[float] | Array, t: Array) -> tuple[Array, Array]:
    """Return z and its derivative."""
    polynomial = np.polynomial.Polynomial(np.asarray(c))
    return polynomial(t), polynomial.deriv()(t)


def exercise_2_4(desk: Desk) -> EntryResult:
    """Compute Exercise 2.4, (a) to (e)."""
    free = desk.solve(**state_problem(1, 1.0, 1.0))
    many = desk.solve_all([state_problem(1, 1.0, c) for c in MANY_WEIGHTS], show=0)
    other = desk.solve(**state_problem(1, **OTHER), show=0)
    nothing = desk.solve(**state_problem(1, 0.0, 1.0), show=0)
    best = desk.solve(**state_problem(1, 0.0, 1.0, 1.0))
    found = desk.minimize_all([state_flat_request(M, 1) for M in COUNTS])
    a = solve_scalar_finite_horizon(-1.0, 1.0, 1.0, 1.0, free.t, tf=TF)
    b = solve_scalar_finite_horizon(-OTHER['a'], OTHER['b'], OTHER['c'], OTHER['x0'], other.t,
                                    tf=OTHER['tf'])
    ends = [exp(-TF) / (1 + c * (1 - exp(-2 * TF)) / 2) for c in MANY_WEIGHTS]
    t = np.linspace(0, TF, 101)
    z, dz = compute_curve(found[0].x, t)
    rows = [
        ComparedRow('(a) $x*(t)$ from $x(0) = 1$, $c = 1$', free.x['x'], a.x, '(2.5) with $-a$'),
        ComparedRow('(a) $u*(t)$ from $x(0) = 1$, $c = 1$', free.u['u'], a.u, '(2.4) with $-a$'),
        ComparedRow('(a) cost $J$', free.J, a.J, '$½ P(0) x(0)^2$'),
        ComparedRow('(a) $x*(t_f)$ for $c$ from 0.01 to $10^6$',
                    [path.x['x'][-1] for path in many],
                    ends, '$x(0) e^{-at_f} / (1 + b^2 c (1 - e^{-2at_f}) / 2a) → 0$',
                    relative=True),
        ComparedRow('(a) $x*$, $u*$ with $a = 2$, $b = ½$, $c = 10$, $t_f = 0.8$, $x(0) = -1.5$',
                    [other.x['x'], other.u['u']], [b.x, b.u], '(2.5), (2.4) with $-a$'),
        ComparedRow('(c) $M = 2$: $x_d(t)$', z, t,
                    '$x(t_0) + (x(t_f) - x(t_0))(t - t_0)/(t_f - t_0)$'),
        ComparedRow('(c) $M = 2$: $u_d(t)$', dz + z, 1 + t, "$(x_d' + a x_d)/b = 1 + t$"),
        ComparedRow('(d) optimal $x(t)$ with $x(1) = 1$', best.x['x'],
                    np.sinh(best.t) / sinh(1), '$sinh t / sinh 1$'),
        ComparedRow('(d) optimal $u(t)$', best.u['u'], np.exp(best.t) / sinh(1), '$e^t / sinh 1$'),
        ComparedRow('(d) optimal cost $J$', best.J, 1 / (1 - exp(-2)) + 0.5,
                    '$1/(1 - e^{-2}) + ½$'),
        ComparedRow('(d) flat cost $J$, $M = 2$', found[0].objective, 7 / 6 + 0.5, '$7/6 + ½$'),
        ComparedRow('(d) optimum of (a) from $x(0) = 0$: $J$', nothing.J, 0.0, '0, with $u ≡ 0$'),
        ComparedRow(f'(e) flat cost, $M = {COUNTS[1]} .. {COUNTS[-1]}$',
                    [each.objective for each in found[1:]], [_least_square(M) for M in COUNTS[1:]],
                    'least squares in the coefficients')]
    shares = [(each.objective - best.J) / best.J for each in found]
    figure, last = _draw('x', free, best, found, 1)
    _draw_ends(last, many, ends)
    return EntryResult(rows, figure, (
        "(b) $z = x$ is a flat output: $x = z$, $u = (z' + az)/b$. (c) Two coefficients satisfy "
        'the end conditions, $M = 2$. (d) The flat trajectory costs '
        f'{100 * shares[0]:.2g} % more than the optimum. (e) More coefficients lower the '
        f'cost: {100 * shares[1]:.2g} % above the optimum with $M = 3$, '
        f'{format_scientific(f"{100 * shares[2]:.1g}")} % with $M = 4$.',),
        f'The optimum of part (a) from $x(0) = 0$ has $J = {nothing.J:.3g}$ and ends at '
        f'$x(1) = {nothing.x["x"][-1]:.3g}$; with the constraint $x(1) = 1$, $J = {best.J:.6f}$.')


def _least_square(M: int) -> float:
    """Return the minimum cost with M coefficients, from a linear least squares problem."""
    k = np.arange(1, M - 1)
    # z = t + sum of d_k (t^(k + 1) - t) satisfies the end conditions for every d.
    basis = NODES[:, None]**(k + 1) - NODES[:, None]
    rates = (k + 1) * NODES[:, None]**k - 1
    root = np.sqrt(SHARES)
    d, *_ = np.linalg.lstsq(root[:, None] * (rates + basis), -root * (1 + NODES), rcond=None)
    u = 1 + NODES + (rates + basis) @ d
    return float(SHARES @ u**2 / 2 + 0.5)


def exercise_2_5(desk: Desk) -> EntryResult:
    """Compute Exercise 2.5."""
    free = desk.solve(**state_problem(3, 1.0, 1.0), method='indirect')
    best = desk.solve(**state_problem(3, 0.0, 1.0, 1.0), method='indirect')
    found = desk.minimize_all([state_flat_request(M, 3) for M in COUNTS])
    x, lam, J = _shoot(free.t)
    E, dx = _first_integral()
    way = _along(dx, best.t)
    t = np.linspace(0, TF, 101)
    z, dz = compute_curve(found[0].x, t)
    rows = [
        ComparedRow('(a) $λ(t_f) = c x(t_f)$', free.lam['x'][-1], x[-1], 'shooting'),
        ComparedRow('(a) $x*(t)$ from $x(0) = 1$', free.x['x'], x,
                    'shooting, Dormand-Prince 8(5,3)'),
        ComparedRow('(a) $λ(t)$', free.lam['x'], lam, 'shooting'),
        ComparedRow('(a) $u*(t) = -bλ(t)$', free.u['u'], -lam, 'shooting'),
        ComparedRow('(a) cost $J$', free.J, J, 'shooting'),
        ComparedRow('(a) $H$ is constant', free.hamiltonian,
                    np.full(free.t.size, -lam[0]**2 / 2 - lam[0]),
                    'its value at $t = 0$, shooting'),
        ComparedRow('(c) $M = 2$: $u_d(t)$', dz + z**3, 1 + t**3,
                    "$(x_d' + a x_d^3)/b = 1 + t^3$"),
        ComparedRow("(d) optimal $x'(t)$ with $x(1) = 1$", best.u['u'] - best.x['x']**3,
                    dx(best.x['x']), "$H$ constant: $x'^2 = x^6 + E$, $∫ dx/x' = 1$"),
        ComparedRow('(d) optimal $x(t)$', best.x['x'], way, "$x' = √(x^6 + E)$ integrated"),
        ComparedRow('(d) optimal $u(t)$', best.u['u'], dx(way) + way**3, "the same, $x' + x^3$"),
        ComparedRow('(d) costate $λ(t)$', best.lam['x'], -dx(way) - way**3, '$-u(t)/b$ of that'),
        ComparedRow('(d) optimal cost $J$', best.J, _cost_of(dx) + 0.5,
                    '$½ ∫ (dx/dt + x^3)^2 dt + ½$ by quadrature over $x$'),
        ComparedRow('(d) flat cost $J$, $M = 2$', found[0].objective, 23 / 28 + 0.5,
                    '$23/28 + ½$'),
        ComparedRow(f'(e) flat cost, $M = {COUNTS[1]} .. {COUNTS[-1]}$',
                    [each.objective for each in found[1:]], [_least(M) for M in COUNTS[1:]],
                    'BFGS from another initial guess, without the server')]
    shares = [(each.objective - best.J) / best.J for each in found]
    figure, last = _draw('x^3', free, best, found, 3)
    _draw_first_integral(last, best, E)
    return EntryResult(rows, figure, (
        "(a) The conditions: $λ' = 3ax^2λ$, $λ(t_f) = c x(t_f)$, $u = -bλ$. (b) $z = x$ is flat, "
        "$u = (z' + az^3)/b$. The straight line costs "
        f'{100 * shares[0]:.2g} % more than the optimum, $M = 3$ {100 * shares[1]:.2g} %, '
        f'$M = 6$ {100 * shares[-1]:.1g} %.',))


def _shoot(t: Array) -> tuple[Array, Array, float]:
    """Return x(t), lambda(t) and J for x(0) = 1, c = 1, without the server."""
    def path(lam0: float, times: Array | None = None) -> Any:
        return solve_ivp(lambda _, y: [-y[0]**3 - y[1], 3 * y[0]**2 * y[1], y[1]**2 / 2],
                         (0, TF), [1.0, lam0, 0.0], 'DOP853', times, rtol=1e-12, atol=1e-13)

    def miss(lam0: float) -> float:
        x, lam, _ = path(lam0).y[:, -1]
        return float(lam - x)

    lam0 = brentq(miss, 0.0, 1.0, xtol=1e-14)
    x, lam, J = path(lam0, np.clip(t, 0, TF)).y
    return x, lam, float(J[-1] + x[-1]**2 / 2)


def _first_integral() -> tuple[float, Drift]:
    """Return E, and dx/dt as a function of x, of the optimum from x(0) = 0 to x(1) = 1."""
    def duration(E: float) -> float:
        return float(quad(lambda x: 1 / sqrt(x**6 + E), 0, 1, epsabs=1e-13, epsrel=1e-13)[0])

    E = brentq(lambda E: duration(E) - TF, 0.1, 2.0, xtol=1e-15)
    return E, lambda x: np.sqrt(x**6 + E)


def _along(dx: Drift, t: Array) -> Array:
    """Return x(t) with x(0) = 0."""
    return np.asarray(solve_ivp(lambda _, x: dx(x), (0, TF), [0.0], 'DOP853', np.clip(t, 0, TF),
                                rtol=1e-12, atol=1e-13).y[0])


def _cost_of(dx: Drift) -> float:
    return float(quad(lambda x: (dx(x) + x**3)**2 / 2 / dx(x), 0, 1, epsabs=1e-13,
                      epsrel=1e-13)[0])


def _least(M: int) -> float:
    def cost(d: Array) -> float:
        c = np.concatenate([[0.0, 1.0 - d.sum()], d])
        z, dz = compute_curve(c, NODES)
        return float(SHARES @ (dz + z**3)**2 / 2 + 0.5)

    return float(minimize(cost, np.full(M - 2, 0.1), method='BFGS', options={'gtol': 1e-10}).fun)


def _draw(drift: str, free: Trajectory, best: Trajectory, found: list[Any], power: int
          ) -> tuple[Figure, Axes]:
    """Return the figure, and its last panel, which is empty."""
    figure, ((states, inputs), (costs, last)) = create_panels(2, 2, 3.3)
    t = np.linspace(0, TF, 101)
    # Three of four curves are within 0.1 of the line x = t: the inset shows their distance.
    beside = states.inset_axes((0.3, 0.66, 0.5, 0.25))
    for index, M in enumerate((2, 3)):
        z, dz = compute_curve(found[index].x, t)
        states.plot(t, z, label=f'flat, $M = {M}$', **get_line(index))
        inputs.plot(t, dz + z**power, **get_line(index))
        beside.plot(t, z - t, **get_line(index))
    for axes, values, other in ((states, best.x['x'], free.x['x']),
                                (inputs, best.u['u'], free.u['u'])):
        axes.plot(best.t, values, label='optimal to $x(1) = 1$', **get_line(2))
        axes.plot(free.t, other, label='(a), from $x(0) = 1$', **get_line(3))
        axes.set_xlim(0, TF)
    if power == 1:
        known = solve_scalar_finite_horizon(-1.0, 1.0, 1.0, 1.0, t, tf=TF)
        shown = (np.sinh(t) / sinh(1), np.exp(t) / sinh(1)), (known.x, known.u)
    else:
        x, lam, _ = _shoot(t)
        dx = _first_integral()[1]
        way = _along(dx, t)
        shown = (way, dx(way) + way**3), (x, -lam)
    beside.plot(best.t, best.x['x'] - best.t, **get_line(2))
    beside.set(xlim=(0, TF), xticks=[0, 1], title='$x - t$')
    for x, u in shown:
        states.plot(t, x, label='reference' if x is shown[0][0] else None, **EXACT)
        inputs.plot(t, u, **EXACT)
    states.set(ylim=(-0.05, 2.0), yticks=[0, 0.5, 1])
    label_axes(states, 'state', 'time $t$ [s]', '$x(t)$')
    label_axes(inputs, 'input', 'time $t$ [s]', '$u(t)$ [1/s]')
    place_legend_below(figure, states, 3)
    costs.semilogy(COUNTS, [each.objective - best.J for each in found], 'o-',
                   color=LINE_COLOURS[0])
    costs.set_xticks(COUNTS)
    label_axes(costs, '(e) flat: cost above the optimum', 'coefficients $M$', '$J_M - J^*$')
    figure.suptitle(f'$\\dot x = -a{drift} + bu$,  $a = b = c = 1$,  $t_f = {TF:g}$ s')
    return figure, last


def _draw_ends(axes: Axes, many: list[Trajectory], ends: list[float]) -> None:
    axes.loglog(MANY_WEIGHTS, [path.x['x'][-1] for path in many], 'o', markersize=4,
                color=LINE_COLOURS[3], label='server')
    axes.loglog(MANY_WEIGHTS, ends, label='closed form', **EXACT_LINE)
    label_axes(axes, '(a) final state from $x(0) = 1$', 'weight $c$', '$x^*(t_f)$', legend=True)


def _draw_first_integral(axes: Axes, best: Trajectory, E: float) -> None:
    x = np.linspace(0, 1, 101)
    axes.plot(best.x['x'], best.u['u'] - best.x['x']**3, color=LINE_COLOURS[2], label='server')
    axes.plot(x, np.sqrt(x**6 + E), label=r'$\dot x^2 = x^6 + E$', **EXACT)
    label_axes(axes, '(d) optimum in the phase plane', '$x$', r'$\dot x$ [1/s]', legend=True)


EXERCISE_2_4 = GalleryEntry(
    'exercise-2.4', 'Optimal and flat trajectories, linear', 'Exercise 2.4', (
        "$x' = -ax + bu$ with the cost of Example 2.2: (a) the optimum, and $x*(t_f)$ for "
        '$c → ∞$; (b) a flat output; (c) the flat trajectory in the basis $t^k$ with as few '
        'coefficients as possible; (d) both from $x(0) = 0$ to $x(1) = 1$ for $a = c = 1$; (e) '
        'the minimum cost with more coefficients.',),
    exercise_2_4,
    'In (d) the optimum of part (a) is linear in $x(t_0)$: from $x(0) = 0$ it is $u ≡ 0$ and does '
    'not reach $x(1) = 1$. A comparison needs this as a constraint. $b$ is not given; it is 1 '
    'here.')
EXERCISE_2_5 = GalleryEntry(
    'exercise-2.5', 'Optimal and flat trajectories, nonlinear', 'Exercise 2.5', (
        "The same for $x' = -ax^3 + bu$; part (a) asks for the conditions only.",),
    exercise_2_5)
