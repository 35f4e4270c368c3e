# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
States and costates along a given input, with the Hamiltonian.

dx/dt = f(x, u) forward from x(0); dlam/dt = -dH/dx backward from lam(T) = dV/dx + nu' dpsi/dx,
both by Butcher's Runge-Kutta method of order 6 in equal parts of each interval of the input.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from obc_ros.core.problem import Problem

Array = NDArray[np.float64]

# J. C. Butcher, On Runge-Kutta processes of high order, J. Austral. Math. Soc. 4 (1964).
_C = (0.0, 1 / 3, 2 / 3, 1 / 3, 1 / 2, 1 / 2, 1.0)
_A = ((), (1 / 3,), (0.0, 2 / 3), (1 / 12, 1 / 3, -1 / 12),
      (-1 / 16, 9 / 8, -3 / 16, -3 / 8), (0.0, 9 / 8, -3 / 8, -3 / 4, 1 / 2),
      (9 / 44, -9 / 11, 63 / 44, 18 / 11, 0.0, -16 / 11))
_B = (11 / 120, 0.0, 27 / 40, 27 / 40, -4 / 15, -4 / 15, 11 / 120)


@dataclass(frozen=True, eq=False)
class Extremal:
    """
    States, inputs and costates on a fine grid.

    `t` (K + 1,), `x` (K + 1, n), `lam` (K + 1, n) after any jump, `lam_before` (K + 1, n);
    `ua`, `ub` (K, m) inputs at the start and end of each part; `cost` J, with `running` (K + 1,)
    the cost up to each time.
    """

    t: Array
    x: Array
    ua: Array
    ub: Array
    lam: Array
    lam_before: Array
    cost: float
    running: Array


class Integrator:
    """Runge-Kutta steps of a problem's dynamics, cost and costates, for any numbers."""

    def __init__(self, problem: Problem) -> None:
        x, u, p, lam = problem.x, problem.u, problem.p, ca.SX.sym('lam', problem.n)
        ua, ub = ca.SX.sym('ua', problem.m), ca.SX.sym('ub', problem.m)
        h, total = ca.SX.sym('h'), ca.SX.sym('total')
        rate = ca.Function('rate', [x, u, p], [problem.f, problem.L])
        f, L = [], []
        for c, row in zip(_C, _A, strict=True):
            inner = sum((h * a * slope for a, slope in zip(row, f, strict=True) if a), x)
            slope, running = rate(inner, (1 - c) * ua + c * ub, p)
            f.append(slope)
            L.append(running)
        end = sum((h * b * slope for b, slope in zip(_B, f, strict=True) if b), x)
        cost = sum((h * b * running for b, running in zip(_B, L, strict=True) if b), ca.SX(0))
        back = ca.gradient(ca.dot(lam, end) + cost, x)
        jump = ca.SX.sym('jump', problem.n)
        H = problem.L + ca.dot(lam, problem.f)
        self._forward = ca.Function(
            'forward', [ca.vertcat(x, total), ua, ub, h, p], [ca.vertcat(end, total + cost)])
        self._backward = ca.Function(
            'backward', [lam, x, ua, ub, h, p, jump], [back + jump])
        nu = ca.SX.sym('nu', problem.q)
        self._end = ca.Function('end', [x, nu, p], [
            problem.V, ca.gradient(problem.V + ca.dot(nu, problem.psi), x), problem.psi])
        self._hamiltonian = ca.Function(
            'hamiltonian', [x, u, lam, p], [H, ca.gradient(H, u)])
        self._maps: dict[tuple[str, int], ca.Function] = {}

    def _map(self, name: str, count: int) -> ca.Function:
        if (name, count) not in self._maps:
            function: ca.Function = getattr(self, '_' + name)
            self._maps[name, count] = (
                function.map(count) if name == 'hamiltonian' else function.mapaccum(count))
        return self._maps[name, count]

    def forward(self, problem: Problem, t: Array, ua: Array, ub: Array) -> tuple[Array, Array]:
        """Return x (K + 1, n) and the running cost (K + 1,) from x0 under linear inputs."""
        K = len(ua)
        first = np.append(problem.x0, 0.0)
        path = self._map('forward', K)(
            first, ua.T, ub.T, np.diff(t)[None, :], ca.repmat(problem.p_value, 1, K)).full().T
        path = np.vstack([first, path])
        return path[:, :-1], path[:, -1]

    def backward(self, problem: Problem, t: Array, x: Array, ua: Array, ub: Array, last: Array,
                 jumps: Array) -> Array:
        """Return lam (K + 1, n), before the jump at each time, from lam(T) back to 0."""
        K = len(ua)
        lam = self._map('backward', K)(
            last, x[-2::-1].T, ua[::-1].T, ub[::-1].T, np.diff(t)[None, ::-1],
            ca.repmat(problem.p_value, 1, K), jumps[-2::-1].T).full().T
        return np.vstack([lam[::-1], last])

    def end(self, problem: Problem, x: Array, nu: Array) -> tuple[float, Array, Array]:
        """Return V, lam(T) and psi at x."""
        V, lam, psi = self._end(x, nu, problem.p_value)
        return float(V), lam.full().ravel(), psi.full().ravel()

    def hamiltonian(self, problem: Problem, x: Array, u: Array, lam: Array
                    ) -> tuple[Array, Array]:
        """Return H (K,) and dH/du (K, m) at K points."""
        K = len(x)
        H, Hu = self._map('hamiltonian', K)(
            x.T, u.T, lam.T, ca.repmat(problem.p_value, 1, K))
        return H.full().ravel(), Hu.full().T

    def extremal(self, problem: Problem, t: Array, ua: Array, ub: Array, nu: Array, *,
                 parts: int = 1, jumps: Array | None = None) -> Extremal:
        """
        Return states and costates under an input linear between t_k and t_(k+1).

        Parameters
        ----------
        t, ua, ub : ndarray, shape (N + 1,), (N, m), (N, m)
        nu : ndarray, shape (q,)
        parts : int
            Steps in each interval.
        jumps : ndarray, shape (N * parts + 1, n), optional
            lam before minus lam after each time: masses of the multipliers of state bounds.

        """
        c = np.arange(parts)[:, None] / parts
        fine = np.append((t[:-1, None] + np.diff(t)[:, None] * c[:, 0]).ravel(), t[-1])
        a, b = ua[:, None, :], ub[:, None, :]
        ua, ub = ((a + (b - a) * part).reshape(-1, problem.m) for part in (c, c + 1 / parts))
        x, running = self.forward(problem, fine, ua, ub)
        V, last, _ = self.end(problem, x[-1], nu)
        drop = np.zeros_like(x) if jumps is None else jumps
        lam = self.backward(problem, fine, x, ua, ub, last + drop[-1], drop)
        return Extremal(fine, x, ua, ub, lam - drop, lam, running[-1] + V, running)
