# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What each entry of the gallery asks for: the result of its program, and an independent reference.

The programs are ``docs/gallery/NAME.py``. The references are closed forms, or computed with SciPy.
"""

from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_file_location
from inspect import signature
import io
from math import asin, atan, atan2, cos, degrees, e, exp, hypot, pi, sin, sqrt, tanh
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from obc_ros.book.references import (
    EnumeratedPlan,
    solve_sampled_scalar,
    solve_sampled_scalar_filter,
    solve_tracking_filter,
)
from scipy.integrate import quad, solve_ivp
from scipy.linalg import solve_continuous_are
from scipy.optimize import brentq, fsolve, minimize_scalar

PROGRAMS = Path(__file__).resolve().parent / 'gallery'
HEADER_LINES = 2   # of a program: its license


class Asked(NamedTuple):
    """
    A quantity that an entry asks for.

    `value` is a function of names of the program, which are its arguments, `exact` its reference,
    and `by` where that comes from. `what` and `by` are in the markup of the gallery.
    """

    what: str
    value: Callable[..., ArrayLike]
    exact: ArrayLike
    by: str


def read_program(name: str) -> str:
    """Return the program of an entry, without its license."""
    text = (PROGRAMS / f'{name}.py').read_text(encoding='utf-8')
    return ''.join(text.splitlines(keepends=True)[HEADER_LINES:])


class _WithoutBytecode(SourceFileLoader):
    """The loader of a program, which leaves no __pycache__ in the folder of the pages."""

    def set_data(self, path: str, data: Any, *, _mode: int = 0) -> None:
        """Keep nothing."""


def run_program(name: str) -> tuple[dict[str, Any], str]:
    """Run the program of an entry; return its names and what it prints."""
    path = str(PROGRAMS / f'{name}.py')
    spec = spec_from_file_location('program', path, loader=_WithoutBytecode('program', path))
    assert spec is not None and spec.loader is not None
    program, printed = module_from_spec(spec), io.StringIO()
    with redirect_stdout(printed):
        spec.loader.exec_module(program)
    return vars(program), printed.getvalue()


def evaluate(name: str, names: dict[str, Any]) -> Iterator[tuple[Asked, NDArray[np.float64]]]:
    """Yield what an entry asks for, each with the result of its program."""
    for asked in ASKED[name]:
        given = (names[each] for each in signature(asked.value).parameters)
        yield asked, np.asarray(asked.value(*given), dtype=float)


def _draw_plants() -> Iterator[tuple[Any, Any, Any, float]]:
    """Yield A, B, C and rho of the plants of Exercise 2.7."""
    random = np.random.default_rng(27)
    for index in range(24):
        n = 2 + index % 5
        yield (random.normal(size=(n, n)), random.normal(size=(n, 1)),
               random.normal(size=(1, n)), 10 ** random.uniform(-2, 2))


def _find_slowest_pole(A: Any, B: Any, Qx: Any, Qu: Any) -> float:
    """Return the largest real part of the stable eigenvalues of the Hamiltonian matrix."""
    E = np.linalg.eigvals(np.block([[A, -B @ np.linalg.solve(Qu, B.T)], [-Qx, -A.T]])).real
    return float(E[E < 0].max())


def _state_theorem_2_2() -> tuple[Any, ...]:
    """Return A, B, Qx and Qu of the plant of Theorem 2.2."""
    random = np.random.default_rng(23)
    A, B, H = (random.normal(size=size).round(2) for size in ((4, 4), (4, 2), (1, 4)))
    return A, B, H.T @ H, np.diag([1, 0.5])


def _shoot_pendulum() -> tuple[float, float]:
    """Return J and nu of Theorem 2.1, by shooting."""
    def slope(_: float, y: Any) -> list[float]:
        theta, omega, lam1, lam2, _ = y
        u = min(max(-lam2, -0.6), 0.6)
        return [omega, u - sin(theta), lam2*cos(theta) - theta, -lam1, (theta**2 + u**2)/2]

    def shoot(lam: Any) -> Any:
        return solve_ivp(slope, (0, 3), [0, 0, *lam, 0], 'DOP853', rtol=1e-11, atol=1e-12,
                         max_step=0.02).y[:, -1]

    def miss(lam: Any) -> list[float]:
        theta, omega, _, lam2, _ = shoot(lam)
        return [theta - 1, lam2 - 4*omega]

    _, omega, nu, _, J = shoot(fsolve(miss, [1, 0], xtol=1e-12))
    return J + 2*omega**2, nu


def _fly_aircraft() -> tuple[float, float]:
    """Return the largest tilt [degrees] and the overshoot of y [m] of the step of Example 2.5."""
    m, J, r, g, c = 4.0, 0.0475, 0.25, 9.8, 0.05
    A, B = np.zeros((6, 6)), np.zeros((6, 2))
    A[:3, 3:] = np.eye(3)
    A[3, 2], A[3, 3], A[4, 4] = -g, -c/m, -c/m
    B[3, 0], B[4, 1], B[5, 0] = 1/m, 1/m, r/J
    K = B.T @ solve_continuous_are(A, B, np.eye(6), np.eye(2))

    def slope(_: float, x: Any) -> list[float]:
        f1, f2 = [0, m*g] - K @ (x - [1, 1, 0, 0, 0, 0])
        s, k = sin(x[2]), cos(x[2])
        return [*x[3:], (f1*k - f2*s - c*x[3])/m, (f1*s + f2*k - c*x[4])/m - g, r*f1/J]

    x = solve_ivp(slope, (0, 10), np.zeros(6), 'DOP853', np.linspace(0, 10, 1001), rtol=1e-11,
                  atol=1e-12).y
    return degrees(abs(x[2]).max()), x[1].max() - 1


def _find_cubic_optimum() -> float:
    """Return J of Exercise 2.5: H is constant, x'^2 = x^6 + E, and the motion takes 1 s."""
    E = brentq(lambda E: quad(lambda x: (x**6 + E)**-0.5, 0, 1)[0] - 1, 0.1, 2, xtol=1e-13)
    return 0.5 + quad(lambda x: (sqrt(x**6 + E) + x**3)**2/2/sqrt(x**6 + E), 0, 1)[0]


def _find_flat_optimum() -> float:
    """Return the cost of z = t + d (t^2 - t) in Exercise 2.5, with the best d."""
    def cost(d: float) -> float:
        return quad(lambda t: (1 + d*(2*t - 1) + (t + d*(t**2 - t))**3)**2/2, 0, 1)[0]
    return 0.5 + minimize_scalar(cost, tol=1e-9).fun


def _bend() -> float:
    """Return the time of left, straight, right in Exercise 2.6: inner tangent of two circles."""
    dx, dy = 2 + sin(0.5), -cos(0.5)   # from the centre of the first turn to that of the second
    distance = hypot(dx, dy)
    heading = atan2(dy, dx) + asin(2/distance)
    return heading + sqrt(distance**2 - 4) + heading - 0.5


def _end(c: float, a: float, b: float, x0: float, tf: float) -> float:
    """Return x*(tf) of equation (2.5)."""
    return 2*a*exp(a*tf)*x0/(2*a + b**2*c*(exp(2*a*tf) - 1))


def _follow_saturated(K: float, x: float, count: int) -> list[float]:
    """Return the inputs u = sat(-K x) of x' = x + u, held for 0.1 s."""
    found = []
    for _ in range(count):
        found.append(min(max(-K*x, -1), 1))
        x = exp(0.1)*x + (exp(0.1) - 1)*found[-1]
    return found


_MIDDLE = 2*asin(sin(pi/4)/2)   # [rad] the middle arc of a turn by 90 degrees
_TURN, _DOYLE = (pi/2 - _MIDDLE)/2, 2 + sqrt(104)
_J, _NU = _shoot_pendulum()
_TILT, _OVERSHOOT = _fly_aircraft()
_PLANT = _state_theorem_2_2()
_CURVES = {(c, tf): abs(_end(c, 2, 0.5, 4, tf) - 4*exp(-2*tf))
           for c in (0.1, 10) for tf in (0.5, 1, 10)}
_REGULATOR = solve_sampled_scalar(1, 1, 1, 1, 0.1)
_PLAN = EnumeratedPlan(np.array([[0.0, 1], [0, 0]]), np.array([[0.0], [1]]),
                       np.diag([1.0, 0]), np.array([[0.05]]), 0.5, 2, 1)
_OUTSIDE = np.array([[-2.0, 2]])

ASKED = {
    'example-2.1': (
        Asked('minimiser $x*$', lambda minimum: minimum.x, [2, 2], '$(a + b)/2$'),
        Asked('multiplier $λ*$', lambda minimum: minimum.lam, [-2], '$a - b$'),
        Asked('$F(x*)$', lambda minimum: minimum.objective, 4, '$F_0 + (a - b)^2/2$')),
    'section-2.2': (
        Asked('cost $J$, in this order',
              lambda free, line, oblique, point: [
                  each.objective for each in (point, line, oblique, free)], [6, 1.5, 6/7, 1.2],
              'cubic polynomials'),
        Asked('$λ(T)$ at the point $x(1) = (1, 0)$',
              lambda point: (point.costates['x1'][-1], point.costates['x2'][-1]), [-12, 6],
              'both components are free'),
        Asked('$λ(T)$ on $x_1 = 1$',
              lambda line: (line.costates['x1'][-1], line.costates['x2'][-1]), [-3, 0],
              '$λ_2(T) = 0$'),
        Asked('$λ(T)$ on $x_1 + x_2 = 2$',
              lambda oblique: (oblique.costates['x1'][-1], oblique.costates['x2'][-1]),
              [-6/7, -6/7], '$λ_1(T) = λ_2(T)$'),
        Asked('$λ(T)$ with $V$',
              lambda free: (free.costates['x1'][-1], free.costates['x2'][-1]), [-2.4, 0],
              '$∂V/∂x$')),
    'theorem-2.1': (
        Asked('cost $J$', lambda answer: answer.objective, _J, 'shooting'),
        Asked('multiplier $ν = λ_1(T)$', lambda lam1: lam1[-1], _NU, 'shooting'),
        Asked('$ψ(x(T)) = θ(T) - 1$', lambda theta: theta[-1] - 1, 0, 'the constraint'),
        Asked('$λ_2(T) - 4ω(T)$',
              lambda lam2, omega: lam2[-1] - 4*omega[-1], 0, '$λ_2(T) = ∂V/∂ω$'),
        Asked('largest $H(x*, u*, λ*) - min_u H$',
              lambda excess: excess.max(), 0, '$u*$ minimises $H$')),
    'example-2.2': (
        Asked('$x*(t_f)$ for $c$ = 1, 10, 100', lambda ends: ends, [
            _end(c, 1, 1, 1, 1) for c in (1, 10, 100)], 'equation (2.5)'),
        Asked('cost $J$ for these $c$', lambda costs: costs, [
            c*e*_end(c, 1, 1, 1, 1)/2 for c in (1, 10, 100)], '$½ λ(0) x(0)$'),
        Asked('cost for $c → ∞$', lambda limit: limit.objective, 1/(1 - exp(-2)),
              '$a x(0)^2 / b^2(1 - e^{-2at_f})$')),
    'example-2.3': (
        Asked('double integrator from (1, 1): $T$ [s]',
              lambda integrator: integrator.objective, 1 + 2*sqrt(1.5),
              '$v_0 + 2 √(x_0 + v_0^2/2)$'),
        Asked('its switching time [s]',
              lambda integrator: integrator.switching_times, [1 + sqrt(1.5)],
              '$v_0 + √(x_0 + v_0^2/2)$'),
        Asked('oscillator from (−4, 0): $T$ [s]', lambda oscillator: oscillator.objective, 2*pi,
              'two half periods'),
        Asked('its switching time [s]',
              lambda oscillator: oscillator.switching_times, [pi], 'half a period')),
    'section-2.4': (
        Asked('$P(0)$ over 2 s, $P_1 = 0$', lambda law: law.P[0, 0, 0],
              tanh(2*sqrt(2))/(sqrt(2) - tanh(2*sqrt(2))), '$tanh √2T / (√2 - tanh √2T)$'),
        Asked('$P$ over an infinite time',
              lambda infinite: infinite.P[0, 0], 1 + sqrt(2), '$1 + √2$'),
        Asked('cost $J$ from $x(0) = 1$ over 2 s', lambda optimum: optimum.objective,
              tanh(2*sqrt(2))/(sqrt(2) - tanh(2*sqrt(2)))/2, '$½ x(0)^T P(0) x(0)$')),
    'theorem-2.2': (
        Asked('minimum cost $J*$ from $x(0) = (1, 1, 1, 1)$', lambda cost: cost,
              np.sum(solve_continuous_are(*_PLANT)), '$x(0)^T P x(0)$, $P$ of SciPy'),
        Asked('slowest pole [rad/s]',
              lambda design: design.E.real.max(), _find_slowest_pole(*_PLANT),
              'Hamiltonian matrix'),
        Asked('largest residual of (2.9)', lambda left: abs(left).max(), 0, 'the equation')),
    'counterexample-2.2': (
        Asked('$P(0)$ from $P_1 = 0$',
              lambda least: least, np.diag([0, sqrt(2) - 1]), '$diag(0, √2 - 1)$'),
        Asked('$P(0)$ from $P_1 = I$',
              lambda stabilising: stabilising, [[1.5 + sqrt(2), -0.5], [-0.5, 0.5]],
              '$[[3/2 + √2, -½], [-½, ½]]$')),
    'example-2.4': (
        Asked('gain $K$ for $q = 2$', lambda design: design.K[0], [2, 2], '$[q, √(2q)]$'),
        Asked('$P$', lambda design: design.P, [[4, 2], [2, 2]], '$[[√(2q^3), q], [q, √(2q)]]$'),
        Asked('natural frequency $ω_0$ [rad/s]', lambda omega0: omega0, sqrt(2), '$√q$'),
        Asked('damping ratio $ζ$', lambda zeta: zeta, sqrt(0.5), '$1/√2$')),
    'section-2.5': (
        Asked('diagonal: peak inputs [N]',
              lambda peaks: peaks['diagonal'], [1, 1], '$√(q_i/ρ_i)$'),
        Asked('Bryson and Ho: peak inputs [N]',
              lambda peaks: peaks['Bryson'], [4, 20], '$√(q_i/ρ_i)$'),
        Asked('output: peak inputs [N]', lambda peaks: peaks['output'], [sqrt(10), sqrt(10)],
              '$√(q_i/ρ_i)$')),
    'figure-2.3': (
        Asked('hover: $F_1, F_2$ [N]', lambda rest: rest.u, [0, 4*9.8], '$0, mg$'),
        Asked('zeros from $F_1$ to $x$ [rad/s]', lambda zeros: (zeros[0], zeros[-1]),
              [-sqrt(4*9.8*0.25/0.0475), sqrt(4*9.8*0.25/0.0475)], '$±√(mgr/J)$')),
    'example-2.5': (
        Asked('printed weights: first inputs [N]', lambda first: first, [-sqrt(1000), sqrt(10)],
              '$∓√(q_i/ρ)$'),
        Asked('$Q_x = I$, $ρ = 1$: largest tilt [degrees]', lambda tilt: tilt, _TILT,
              'Dormand-Prince 8(5,3), gain of SciPy'),
        Asked('the same: overshoot of $y$ [m]', lambda overshoot: overshoot, _OVERSHOOT,
              'Dormand-Prince 8(5,3), gain of SciPy')),
    'example-2.6': (
        Asked('to (2, 0, 0): $T$ [s]', lambda line: line.objective, 2, '$ρ$'),
        Asked('to (1, 0, 4.25): $T$ [s]',
              lambda diamond: diamond.objective, 5, 'isoperimetric inequality'),
        Asked('its switching times [s]', lambda diamond: diamond.switching_times, [1, 2.5, 4],
              'corners of the diamond')),
    'exercise-2.1': (
        Asked('(a) $λ$ with $F = Σ λ_k G_k$',
              lambda kernel: -kernel.lam, [2, -1], '$F = 2G_1 - G_2$'),
        Asked('(b) $x*$ on a sphere of radius 2', lambda sphere: sphere.x,
              -2*np.array([2, 3, 1])/sqrt(14), '$-2F/|F|$'),
        Asked('(b) its $λ$', lambda sphere: sphere.lam, [sqrt(14)/4], '$|F|/4$')),
    'exercise-2.2': (
        Asked('(b) cost $J$ for $y = (1, 2, 2)$',
              lambda answer: answer.objective, 3*pi, '$π |y|$'),
        Asked('least and largest $|u(t)|$',
              lambda speed: (speed.min(), speed.max()), [sqrt(6*pi)]*2,
              '$√(2π|y|)$, constant'),
        Asked('largest $|y^T u(t)|$',
              lambda along: abs(along).max(), 0, 'circle in the plane normal to $y$')),
    'exercise-2.3': (
        Asked("minimum of $∫ x'^T x' dt$", lambda smooth: smooth.objective, 25, '$|x_f - x_0|^2$'),
        Asked('length of this path [m]', lambda length: length, 5, '$|x_f - x_0|$'),
        Asked('minimum time at unit speed [s]',
              lambda fastest: fastest.objective, 5, '$|x_f - x_0|$')),
    'exercise-2.4': (
        Asked('(d) optimal cost $J$ with $x(1) = 1$',
              lambda best: best.objective, 1/(1 - exp(-2)) + 0.5,
              '$1/(1 - e^{-2}) + ½$'),
        Asked('(d) flat cost, $M = 2$', lambda two: two.objective, 7/6 + 0.5, '$7/6 + ½$'),
        Asked('(e) flat cost, $M = 3$', lambda three: three.objective, 7/6 - 5/528 + 0.5,
              '$7/6 - 5/528 + ½$')),
    'exercise-2.5': (
        Asked('(d) optimal cost $J$ with $x(1) = 1$',
              lambda best: best.objective, _find_cubic_optimum(),
              "quadrature, $x'^2 = x^6 + E$"),
        Asked('(d) flat cost, $M = 2$', lambda two: two.objective, 23/28 + 0.5, '$23/28 + ½$'),
        Asked('(e) flat cost, $M = 3$', lambda three: three.objective, _find_flat_optimum(),
              'quadrature and line search')),
    'exercise-2.6': (
        Asked('2 m straight on: $T$ [s]', lambda straight: straight.objective, 2, '$|x|/L$'),
        Asked('turn by 90 degrees in place: $T$ [s]',
              lambda turn: turn.objective, pi/2, '$(π/2)/M$'),
        Asked('its switching times [s]', lambda turn: turn.switching_times, [_TURN, pi/2 - _TURN],
              'three circles that touch'),
        Asked('to (2, 1, 0.5): $T$ [s]', lambda bend: bend.objective, _bend(),
              'inner tangent of two circles')),
    'exercise-2.7': (
        Asked('stable loops of 24', lambda stable: stable, 24, 'the exercise'),
        Asked('slowest pole of all [rad/s]', lambda slowest: max(slowest), max(
            _find_slowest_pole(A, B, C.T @ C, np.array([[rho]]))
            for A, B, C, rho in _draw_plants()), 'Hamiltonian matrix')),
    'exercise-2.8': (
        Asked('(b) $K$ for $a$ = 0.5, 1, 2', lambda gains: gains, [
            [1, sqrt(a*a + 2) - a] for a in (0.5, 1, 2)], '$[1, √(a^2 + 2) - a]$'),
        Asked('(c) $ω_0$ [rad/s]', lambda frequencies: frequencies, [1, 1, 1], '1 for every $a$'),
        Asked('(c) damping ratio $ζ$', lambda dampings: dampings, [
            sqrt(a*a + 2)/2 for a in (0.5, 1, 2)], '$½ √(a^2 + 2)$')),
    'exercise-2.9': (
        Asked('closest to the infinite horizon: $c$, $t_f$', lambda closest: closest,
              min(_CURVES, key=lambda curve: _CURVES[curve]), 'least $|x* - x*_∞|$ at $t_f$'),
        Asked('$P(0)$ for $c = 10$, $t_f = 1$ s',
              lambda P: P[10, 1], 10*exp(2)*_end(10, 2, 0.5, 4, 1)/4,
              '$λ(0)/x(0)$'),
        Asked('$P(0)$ for $c = 10$, $t_f = 10$ s',
              lambda P: P[10, 10], 16, '$2a/b^2$, infinite horizon')),
    'exercise-2.10': (
        Asked('(a) $K$', lambda design: design.K[0], [0.2, sqrt(0.8)], '$[1/√ρ, √(2l/√ρ)]$'),
        Asked('(a) overshoot [%]',
              lambda overshoot: overshoot, 100*exp(-pi), '$e^{-πζ/√(1-ζ^2)}$, $ζ = 1/√2$'),
        Asked('(a) phase margin [degrees]',
              lambda phase: phase, degrees(atan(sqrt(2 + 2*sqrt(2)))),
              '$atan √(2 + 2√2)$'),
        Asked('(a) gain crossover [rad/s]', lambda crossover: crossover, sqrt(10*(1 + sqrt(2))),
              '$ω_0 √(1 + √2)$')),
    'estimation-1': (
        Asked('variance $p$', lambda steady: steady.P[0, 0], 0.01*(-0.5 + sqrt(100.25)),
              '$r(a + √(a^2 + q/r))$'),
        Asked('gain $L$ [1/s]', lambda steady: steady.L[0, 0], -0.5 + sqrt(100.25), '$p/r$'),
        Asked('pole [1/s]', lambda steady: steady.E[0].real, -sqrt(100.25), '$-√(a^2 + q/r)$'),
        Asked('sampled: variance before a measurement', lambda sampled: sampled.P[0, 0],
              solve_sampled_scalar_filter(-0.5, 1, 0.2, 0.05)[0], 'quadratic equation')),
    'estimation-2': (
        Asked('gain $L$', lambda design: design.L, [[2*sqrt(2)], [4]], '$[√2 ω, ω^2]$'),
        Asked('natural frequency [rad/s]', lambda omega: omega, 2, '$ω = (q/r)^{1/4}$'),
        Asked('damping ratio $ζ$', lambda zeta: zeta, sqrt(0.5), '$1/√2$'),
        Asked('$α$, $β$ for the tracking index ½',
              lambda alpha, beta: (alpha, beta), solve_tracking_filter(0.5),
              'Kalata 1984')),
    'estimation-3': (
        Asked('$K$ for $q = 100$', lambda K: K[0], [_DOYLE]*2, '$f[1, 1]$, $f = 2 + √(4 + q)$'),
        Asked('$L$ for $σ = 100$',
              lambda L: L[:, 0], [_DOYLE]*2, '$d[1, 1]^T$, $d = 2 + √(4 + σ)$'),
        Asked('largest gain $m$ of the plant',
              lambda largest: largest, 1 + 1/_DOYLE**2, '$1 + 1/(fd)$')),
    'receding-horizon-1': (
        Asked('gain $K$ of the sampled regulator', lambda design: design.K[0, 0], _REGULATOR[3],
              'quadratic equation for $P$'),
        Asked('plan from $x = 0.5$ over 5 periods', lambda plan: plan.x,
              _follow_saturated(_REGULATOR[3], 0.5, 5), '$sat(-Kx)$')),
    'receding-horizon-2': (
        Asked('gain $K$ of the sampled regulator',
              lambda K: K, _PLAN.K[0], 'SciPy, discrete Riccati'),
        Asked('plan from $x = (-2, 2)$ over 2 periods', lambda plan: plan.x,
              _PLAN.find_inputs(_OUTSIDE)[0][0], 'enumeration of 9 active sets'),
        Asked('saturated regulator there',
              lambda saturated: saturated, _PLAN.saturate(_OUTSIDE)[0],
              '$sat(-Kx)$')),
}
