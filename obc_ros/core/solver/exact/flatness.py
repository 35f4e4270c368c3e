# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Trajectories of differentially flat systems between two states (Exercises 2.4 and 2.5).

States and inputs are functions of flat outputs z and their derivatives up to order r. Hence any
smooth z with the right values at both ends is a trajectory. Each output is a sum of M basis
functions; 2 r coefficients satisfy the end conditions, and the others minimise

    J = integral of (x - xr)'Qx (x - xr) + (u - ur)'Qu (u - ur).

As M increases J decreases to the optimum.

================= ============================== ===
system            flat outputs                   r
================= ============================== ===
scalar, cubic     x                              1
double_integrator x1                             2
vehicle           px, py (moving one way)        2
two_wheeled       px, py (moving one way)        2
aircraft, c = 0   px - e sin(theta),             4
                  py + e cos(theta), e = J/(m r)
================= ============================== ===

The module is long because all flat systems share the basis and the end conditions.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import hypot
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.polynomial_bases import Basis, build_basis
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import StatementError

Expressions = Sequence[Any]

MAX_COEFFICIENTS = 60
_NODES = 12          # nodes of the quadrature for each piece; at least _LEAST_NODES together
_LEAST_NODES = 96
_STEPS = 200         # iterations of Newton's method
_FEW = 4             # free coefficients of the polynomial that a second search begins with
_SLOWEST = 1e-3      # speed relative to its mean below which the heading is undefined


@dataclass(frozen=True)
class _Form:
    """
    Flat outputs of a system and the inverse map.

    `outputs` maps (x, p) to z, `inverse` maps (z, p, way) to (x, u), where z[i][k] is the k-th
    derivative of output i. `inputs` returns the default inputs at both ends.
    """

    r: int
    outputs: Callable[[Expressions, Expressions], Expressions]
    inverse: Callable[[Sequence[Expressions], Expressions, float],
                      tuple[Expressions, Expressions]]
    inputs: Callable[[System, Array, Array, float], Sequence[float]]
    moving: bool = False


@dataclass(frozen=True, eq=False)
class FlatTrajectory:
    """
    Trajectory given by its flat outputs.

    Attributes
    ----------
    t0, T : float
        Initial time and duration [s].
    basis : Basis
        Basis functions of (t - t0) / T.
    coefficients : ndarray, shape (M, outputs)
        Coefficients of the flat outputs.
    minimal : int
        Minimum number of coefficients of an output that satisfy both end conditions.
    J : float
        Cost.

    """

    t0: float
    T: float
    basis: Basis
    coefficients: Array
    minimal: int
    J: float
    _system: System
    _form: _Form
    _way: float
    _heading: float

    def flag(self, t: ArrayLike) -> Array:
        """Return the flat outputs and derivatives, shape (N, outputs, r + 1)."""
        s = np.clip((np.asarray(t, dtype=float).ravel() - self.t0) / self.T, 0, 1)
        return np.stack([self.basis.values(s, k) @ self.coefficients / self.T**k
                         for k in range(self._form.r + 1)], axis=2)

    def at(self, t: ArrayLike) -> tuple[Array, Array]:
        """
        Return states (N, n) and inputs (N, m) at times [s] in increasing order.

        Angles are continuous if the times are dense.
        """
        inverse = _inverse(self._system, self._form, self._way)
        flag = self.flag(t)
        x, u = (np.asarray(out.full().T, dtype=float)
                for out in inverse.map(len(flag))(flag.reshape(len(flag), -1).T))
        for i, wraps in enumerate(self._system.angles):
            if wraps and len(x):
                x[:, i] = np.unwrap(x[:, i])
                x[:, i] += 2 * np.pi * round((self._heading - x[0, i]) / (2 * np.pi))
        return x, u

    def sample(self, n: int) -> tuple[Array, Array, Array]:
        """
        Return n equally spaced times (n,), states (n, n_x) and inputs (n, m).

        Raises
        ------
        StatementError
            If n is not an integer of at least 2.

        """
        if not isinstance(n, (int, np.integer)) or isinstance(n, bool) or n < 2:
            raise StatementError(f'a trajectory is sampled at 2 or more times, not at {n!r}')
        t = self.t0 + self.T * np.arange(n) / (n - 1)
        return t, *self.at(t)


def generate(system: System, start: ArrayLike, goal: ArrayLike, T: float, *,
             kind: str = 'polynomial', coefficients: int | None = None,
             start_input: ArrayLike | None = None, goal_input: ArrayLike | None = None,
             Qx: ArrayLike | None = None, Qu: ArrayLike | None = None,
             xr: ArrayLike | None = None, ur: ArrayLike | None = None,
             t0: float = 0.0) -> FlatTrajectory:
    """
    Return a trajectory of a flat system from start to goal.

    Parameters
    ----------
    system : System
        One of the table above.
    start, goal : array_like, shape (n,)
        States at t0 and t0 + T.
    T : float
        Duration [s], > 0.
    kind : str
        Basis: 'polynomial', 'bezier' or 'bspline'.
    coefficients : int, optional
        M for each flat output, at least 2 r; 2 r if left out.
    start_input, goal_input : array_like, shape (m,), optional
        Inputs at the ends, constant near them; derivatives of z at the ends follow from them.
        Used are the speed of a vehicle (default: distance over T) and the thrust of an aircraft
        (default: hovering).
    Qx, Qu : array_like, shape (n,) or (n, n), (m,) or (m, m), optional
        Weights >= 0; zero and identity if left out.
    xr, ur : array_like, shape (n,), (m,), optional
        Reference of x and u; zero if left out.
    t0 : float
        Initial time [s].

    Returns
    -------
    FlatTrajectory

    Raises
    ------
    StatementError
        If the system is not flat, an argument is malformed, or the vehicle would have to stop.

    """
    form = _form(system)
    x0, x1 = _vector('start', start, system.n), _vector('goal', goal, system.n)
    if not (isinstance(T, (int, float)) and np.isfinite(T) and T > 0 and np.isfinite(t0)):
        raise StatementError(f'T = {T!r}: wanted a finite duration > 0')
    minimal = 2 * form.r
    M = minimal if coefficients is None else coefficients
    if not isinstance(M, (int, np.integer)) or not minimal <= M <= MAX_COEFFICIENTS:
        raise StatementError(f'coefficients = {M!r}: wanted {minimal} (both ends, {form.r} each) '
                             f'to {MAX_COEFFICIENTS}')
    usual = form.inputs(system, x0, x1, float(T))
    u0 = _vector('start_input', usual if start_input is None else start_input, system.m)
    u1 = _vector('goal_input', usual if goal_input is None else goal_input, system.m)
    way = _way(u0, u1) if form.moving else 1.0
    ends = np.stack((_flag(system, form, x0, u0), _flag(system, form, x1, u1)))
    chosen = build_basis(kind, int(M), form.r + 1)
    weights = (_root('Qx', Qx, np.zeros((system.n, system.n))),
               _root('Qu', Qu, np.eye(system.m)),
               _vector('xr', np.zeros(system.n) if xr is None else xr, system.n),
               _vector('ur', np.zeros(system.m) if ur is None else ur, system.m))

    def cost(of: Basis) -> _Cost:
        return _Cost(system, form, way, of, float(T), *weights)

    alpha, J = _least(chosen, ends, float(T), form.r, cost(chosen), cost)
    found = FlatTrajectory(
        t0=float(t0), T=float(T), basis=chosen, coefficients=alpha, minimal=minimal, J=J,
        _system=system, _form=form, _way=way,
        _heading=float(x0[system.angles.index(True)]) if any(system.angles) else 0.0)
    if form.moving:
        _keeps_moving(found)
    return found


def _least(chosen: Basis, ends: Array, T: float, r: int, cost: '_Cost',
           few: Callable[[Basis], '_Cost']) -> tuple[Array, float]:
    """
    Return the coefficients that satisfy the end conditions at the lowest cost found, and the cost.

    The search begins with the polynomial without free coefficients. If there are many
    coefficients, a second search begins with the best polynomial with a few free ones. Minima are
    local.
    """
    plain = build_basis('polynomial', 2 * r, 0)
    z = np.linalg.solve(_at_ends(plain, T, r), np.concatenate(
        [ends[:, :, k] for k in range(r)]))
    found = [_newton(chosen, plain, z, ends, T, r, cost)]
    short = build_basis('polynomial', 2 * r + _FEW, 0)
    if chosen.M > short.M:
        better, _ = _newton(short, plain, z, ends, T, r, few(short))
        found.append(_newton(chosen, short, better, ends, T, r, cost))
    return min(found, key=lambda each: each[1])


def _at_ends(chosen: Basis, T: float, r: int) -> Array:
    """Return the matrix that maps coefficients to derivatives of order below r at both ends."""
    sides = np.array([0.0, 1.0])
    return np.concatenate([chosen.values(sides, k) / T**k for k in range(r)])


def _newton(chosen: Basis, near: Basis, z: Array, ends: Array, T: float, r: int,
            cost: '_Cost') -> tuple[Array, float]:
    """Return coefficients at a minimum of the cost, from those closest to z in another basis."""
    E, e = _at_ends(chosen, T, r), np.concatenate([ends[:, :, k] for k in range(r)])
    alpha = np.linalg.lstsq(chosen.values(cost.s), near.values(cost.s) @ z, rcond=None)[0]
    alpha = alpha + np.linalg.lstsq(E, e - E @ alpha, rcond=None)[0]
    N = np.linalg.svd(E)[2][2 * r:].T
    J, slope, H = cost.derivatives(alpha, N)
    if not np.isfinite(J):
        raise StatementError('the initial path between the ends is not a trajectory of the '
                             'system: its inputs are not finite')
    damping = 0.0
    for _ in range(_STEPS if N.shape[1] else 0):
        values, vectors = np.linalg.eigh(H)
        # Absolute values: the step also descends along directions of negative curvature.
        curvature = np.maximum(np.abs(values), 1e-13 * np.abs(values).max()) + damping
        step = -vectors @ ((vectors.T @ slope) / curvature)
        moved = alpha + N @ step.reshape(N.shape[1], -1)
        new = cost.derivatives(moved, N)
        if new[0] < J:
            fall = J - new[0]
            alpha, (J, slope, H), damping = moved, new, damping / 10
            if fall <= 1e-15 * abs(J):
                break
        elif damping > 1e6 * np.abs(values).max() or -slope @ step <= 1e-15 * abs(J):
            break
        else:
            damping = max(10 * damping, 1e-4 * float(np.abs(values).max()))
    return alpha, J


class _Cost:
    """J and its derivatives, by Gauss quadrature on the pieces of a basis."""

    def __init__(self, system: System, form: _Form, way: float, chosen: Basis, T: float,
                 Wx: Array, Wu: Array, xr: Array, ur: Array) -> None:
        pieces = np.diff(chosen.breaks)
        nodes = max(_NODES, -(-_LEAST_NODES // len(pieces)))
        points, weights = np.polynomial.legendre.leggauss(nodes)
        self.s = np.concatenate([a + h * (points + 1) / 2 for a, h in
                                 zip(chosen.breaks, pieces, strict=False)])
        self.weights = T * np.concatenate([h * weights / 2 for h in pieces])
        self.B = np.stack([chosen.values(self.s, k) / T**k for k in range(form.r + 1)], axis=1)
        inverse = _inverse(system, form, way)
        z = ca.SX.sym('z', inverse.numel_in(0))
        x, u = inverse(z)
        off = x - ca.DM(xr)
        for i, wraps in enumerate(system.angles):
            if wraps:
                off[i] = ca.atan2(ca.sin(off[i]), ca.cos(off[i]))
        errors = ca.vertcat(ca.mtimes(ca.DM(Wx), off), ca.mtimes(ca.DM(Wu), u - ca.DM(ur)))
        hessian, gradient = ca.hessian(ca.sumsqr(errors), z)
        self.at_nodes = ca.Function('cost', [z], [
            ca.sumsqr(errors), ca.densify(gradient), ca.densify(hessian)]).map(len(self.s))

    def derivatives(self, alpha: Array, N: Array) -> tuple[float, Array, Array]:
        """Return J, its gradient and its Hessian along N for each output."""
        nodes, outputs, spare = len(self.s), alpha.shape[1], N.shape[1]
        flag = np.einsum('akm,mo->aok', self.B, alpha).reshape(nodes, -1)
        values, gradients, hessians = (out.full() for out in self.at_nodes(flag.T))
        size = self.B.shape[1]
        along = np.einsum('akm,mj->akj', self.B, N)
        g = gradients.T.reshape(nodes, outputs, size) * self.weights[:, None, None]
        h = hessians.reshape(outputs, size, nodes, outputs, size)
        slope = np.einsum('aok,akj->jo', g, along).ravel()
        H = np.einsum('a,okapl,akj,ali->joip', self.weights, h, along, along, optimize=True)
        return float(values.ravel() @ self.weights), slope, np.asarray(
            H.reshape(spare * outputs, spare * outputs))


def _keeps_moving(found: FlatTrajectory) -> None:
    """Reject a trajectory on which the speed vanishes: its heading is undefined there."""
    t = found.t0 + found.T * np.linspace(0, 1, 400)
    velocity = found.flag(t)[:, :, 1]
    speed = np.hypot(*velocity.T)
    # Between two successive velocities at an obtuse angle the vehicle comes to rest.
    slow = speed <= _SLOWEST * speed.mean()
    slow[1:] |= np.sum(velocity[1:] * velocity[:-1], axis=1) <= 0
    k = int(np.argmax(slow))
    if slow[k]:
        raise StatementError(
            f'the path stops at t = {t[k]:.4g}: at rest the heading is not a function of px and '
            'py. Give other speeds at the ends, or more time')


def _way(u0: Array, u1: Array) -> float:
    """Return 1 for forwards, -1 for backwards."""
    if u0[0] * u1[0] <= 0:
        raise StatementError(
            f'speeds {u0[0]:g} and {u1[0]:g} at the ends: wanted two of one sign, not 0; at rest '
            'the heading is not a function of the flat outputs px and py')
    return 1.0 if u0[0] > 0 else -1.0


def _flag(system: System, form: _Form, x: Array, u: Array) -> Array:
    """Return z and its derivatives of order below r for constant u, shape (outputs, r)."""
    rate: Any = ca.vertcat(*form.outputs(ca.vertsplit(system.x), ca.vertsplit(system.p)))
    columns = []
    for _ in range(form.r):
        columns.append(rate)
        rate = ca.jtimes(rate, system.x, system.xdot)
    flag = ca.Function('flag', [system.x, system.u, system.p], [ca.horzcat(*columns)])
    return np.asarray(flag(x, u, system.p_value).full())


def _inverse(system: System, form: _Form, way: float) -> ca.Function:
    """Return the function from the flag, output by output, to (x, u)."""
    p = system.p_value.tolist()
    outputs = len(form.outputs([0.0] * system.n, p))
    z = ca.SX.sym('z', outputs * (form.r + 1))
    flag = [[z[i * (form.r + 1) + k] for k in range(form.r + 1)] for i in range(outputs)]
    x, u = form.inverse(flag, p, way)
    return ca.Function('inverse', [z], [ca.densify(ca.vertcat(*x)), ca.densify(ca.vertcat(*u))])


def _vector(name: str, values: ArrayLike, n: int) -> Array:
    try:
        array = np.asarray(values, dtype=float).ravel()
    except (TypeError, ValueError):
        raise StatementError(f'{name}: wanted {n} numbers') from None
    if array.shape != (n,) or not np.isfinite(array).all():
        raise StatementError(f'{name}: wanted {n} finite numbers, found {array.size}'
                             if array.shape != (n,) else f'{name}: not all numbers are finite')
    return array


def _root(name: str, weight: ArrayLike | None, default: Array) -> Array:
    """Return R with R'R = the weight."""
    if weight is None:
        return default
    n = len(default)
    try:
        Q = np.asarray(weight, dtype=float)
    except (TypeError, ValueError):
        raise StatementError(f'{name}: wanted a matrix of numbers') from None
    Q = np.diag(Q) if Q.shape == (n,) else Q
    if Q.shape != (n, n) or not np.isfinite(Q).all() or np.abs(Q - Q.T).max() > 1e-12 * np.abs(
            Q).max():
        raise StatementError(f'{name}: wanted {n} numbers or a symmetric matrix ({n}, {n})')
    values, vectors = np.linalg.eigh(Q)
    if values[0] < -1e-12 * max(abs(values[-1]), 1e-300):
        raise StatementError(f'{name}: has the negative eigenvalue {values[0]:g}; wanted >= 0')
    return np.asarray(np.sqrt(np.maximum(values, 0))[:, None] * vectors.T)


def _form(system: System) -> _Form:
    form = _FORMS.get(system.name)
    if form is None:
        raise StatementError(f"'{system.name}' is not known to be differentially flat; flat "
                             f'systems are {", ".join(_FORMS)}')
    values = dict(zip((p.name for p in system.parameters), system.p_value.tolist(), strict=True))
    if system.name == 'aircraft' and values['c'] != 0:
        raise StatementError(
            f'the aircraft is flat for c = 0 only: its flat outputs are a point that the thrust '
            f'cannot accelerate sideways, and drag (c = {values["c"]:g}) accelerates that point')
    if system.name == 'aircraft' and values['r'] == 0:
        raise StatementError('the aircraft is not flat for r = 0: no input turns it')
    if system.name in ('scalar', 'cubic') and values['b'] == 0:
        raise StatementError(f'{system.name} is not flat for b = 0: the input does not act')
    return form


def _planar(z: Sequence[Expressions], way: float) -> tuple[Any, Any, Any]:
    """Return speed, heading and its rate from px, py and their derivatives."""
    (_, dx, ddx), (_, dy, ddy) = z
    speed2 = dx * dx + dy * dy
    return (way * ca.sqrt(speed2), ca.atan2(way * dy, way * dx),
            (dx * ddy - dy * ddx) / speed2)


def _vehicle(z: Sequence[Expressions], p: Expressions,
             way: float) -> tuple[Expressions, Expressions]:
    v, theta, rate = _planar(z, way)
    return (z[0][0], z[1][0], theta), (v, ca.atan(p[0] * rate / v))


def _two_wheeled(z: Sequence[Expressions], p: Expressions,
                 way: float) -> tuple[Expressions, Expressions]:
    v, theta, rate = _planar(z, way)
    return (z[0][0], z[1][0], theta), (v, rate)


def _aircraft(z: Sequence[Expressions], p: Expressions,
              way: float) -> tuple[Expressions, Expressions]:
    """Return x and u: z'' = a (-sin(theta), cos(theta)) - (0, g), a = f2 / m - e theta'^2."""
    m, J, r, g, _ = p
    e = J / (m * r)
    (z1, dz1, w1, j1, s1), (z2, dz2, w2, j2, s2) = z
    w2 = w2 + g
    a2 = w1 * w1 + w2 * w2
    theta = ca.atan2(-w1, w2)
    omega = (w1 * j2 - w2 * j1) / a2
    growth = 2 * (w1 * j1 + w2 * j2) / a2
    alpha = (w1 * s2 - w2 * s1) / a2 - omega * growth
    c, s = ca.cos(theta), ca.sin(theta)
    x = (z1 + e * s, z2 - e * c, theta, dz1 + e * omega * c, dz2 + e * omega * s, omega)
    return x, (m * e * alpha, m * (ca.sqrt(a2) + e * omega * omega))


def _no_input(system: System, start: Array, goal: Array, T: float) -> Sequence[float]:
    return (0.0,) * system.m


def _steady_speed(system: System, start: Array, goal: Array, T: float) -> Sequence[float]:
    return hypot(goal[0] - start[0], goal[1] - start[1]) / T, 0.0


def _hovering(system: System, start: Array, goal: Array, T: float) -> Sequence[float]:
    m, _, _, g, _ = system.p_value.tolist()
    return 0.0, m * g


_FORMS = {
    'scalar': _Form(1, lambda x, p: [x[0]], lambda z, p, way: (
        [z[0][0]], [(z[0][1] - p[0] * z[0][0]) / p[1]]), _no_input),
    'cubic': _Form(1, lambda x, p: [x[0]], lambda z, p, way: (
        [z[0][0]], [(z[0][1] + p[0] * z[0][0]**3) / p[1]]), _no_input),
    'double_integrator': _Form(2, lambda x, p: [x[0]], lambda z, p, way: (
        [z[0][0], z[0][1]], [z[0][2]]), _no_input),
    'vehicle': _Form(2, lambda x, p: [x[0], x[1]], _vehicle, _steady_speed, moving=True),
    'two_wheeled': _Form(2, lambda x, p: [x[0], x[1]], _two_wheeled, _steady_speed, moving=True),
    'aircraft': _Form(4, lambda x, p: [
        x[0] - p[1] / (p[0] * p[2]) * ca.sin(x[2]), x[1] + p[1] / (p[0] * p[2]) * ca.cos(x[2])],
        _aircraft, _hovering),
}
