# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Equilibria of a system and its linearization there.

An equilibrium is a state x with an input u for which f(x, u) = 0. States on which f does not
depend may drift at a constant rate: a vehicle that drives straight ahead has f = (v, 0, 0). The
drift is then f(xe, ue), and the deviation from xe + drift t is linearized with constant A and B.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Mask
from obc_ros.core.numerics.newton import take_damped_steps
from obc_ros.core.systems.system import Signal, System
from obc_ros.core.text.errors import DynamicsError, ObcError, StatementError
from obc_ros.core.text.tables import Tabulated

_STEPS = 50
_HALVINGS = 30
_TOLERANCE = 1e-10  # of f, relative to its terms
_ROUNDING = 16.0 * np.finfo(float).eps  # of f, relative to its terms
_NEGLIGIBLE = 1e-5  # times the tolerance, where Newton's method ends: below it is rounding error


@dataclass(frozen=True, eq=False, repr=False)
class Equilibrium(Tabulated):
    """
    State and input with constant dx/dt: zero, or a drift of states that f does not depend on.

    :ivar x, u: (n,) and (m,), state xe and input ue.
    :ivar drift: (n,), f(xe, ue); nonzero only for states that f does not depend on. Under ue the
        state is xe + drift * t.
    """

    x: Array
    u: Array
    drift: Array


@np.errstate(all='ignore')  # an overflow is not an equilibrium
def find_equilibrium(system: System, x: Sequence[float] | Array | None = None,
                     u: Sequence[float] | Array | None = None) -> Equilibrium:
    """
    Find the equilibrium at a set point by Newton's method.

    :param x: (n,), optional, set point; default: that of the system.
    :param u: (m,), optional, initial guess of the input; default: that of the system. Inputs that
        the set point does not determine (the speed of a vehicle) keep these values.
    :raises DynamicsError: if no equilibrium is found there, with the residual, or its input is
        outside the limits.
    """
    x = check_numbers(f'set point of {system.name}', system.setpoint if x is None else x,
                      system.state_names, DynamicsError)
    u = check_numbers(f'input of {system.name}', system.setpoint_input if u is None else u,
                      system.input_names, DynamicsError)
    loose, held = np.arange(system.n + system.m) >= system.n, ~may_move_on(system)
    best = _solve(system, np.concatenate([x, u]), loose, held)
    if not best.holds:
        raise DynamicsError(_refusal(system, x, best, held))
    best = _keep_inputs(system, u, best, loose, held)
    _check_limits(system, best)
    drift = system.f(best.x, best.u)
    drift[held | (np.abs(drift) <= _ROUNDING * _sum_terms(system, best.x, best.u))] = 0.0
    return Equilibrium(best.x, best.u, drift)


def find_nearest_equilibrium(system: System, x: Array, u: Array) -> Equilibrium:
    """Find the equilibrium next to a state that nearly is one, first by the inputs alone."""
    inputs, held = np.arange(system.n + system.m) >= system.n, ~may_move_on(system)
    best = _solve(system, np.concatenate([x, u]), inputs, held)
    best = _newton(system, np.concatenate([best.x, best.u]), inputs | True, held)
    return find_equilibrium(system, best.x, best.u)


def linearize(system: System, x: Array, u: Array) -> tuple[Array, Array]:
    """Return A = df/dx (n, n) and B = df/du (n, m); a DynamicsError if one is not finite."""
    A, B = system.jacobians(x, u)
    for matrix, by in ((A, system.states), (B, system.inputs)):
        for i, j in np.argwhere(~np.isfinite(matrix)):
            raise DynamicsError(
                f'{system.name}: the derivative of d{system.states[i].name}/dt with respect to '
                f'{by[j].name} is {matrix[i, j]} {_at(system.states, x)}, '
                f'{_listed(system.inputs, u)}')
    return A, B


def check_numbers(what: str, given: Sequence[float] | Array, names: Sequence[str],
                  wrong: type[ObcError] = StatementError) -> Array:
    """Return one finite number for each name as an array; raise an error otherwise."""
    try:
        values = np.array(given, dtype=float)
    except (TypeError, ValueError):
        raise wrong(f'{what}: wanted numbers for {", ".join(names)}') from None
    if values.shape != (len(names),):
        raise wrong(f'{what}: wanted {len(names)} numbers ({", ".join(names)}), '
                    f'found {values.size}')
    for name, value in zip(names, values, strict=True):
        if not np.isfinite(value):
            raise wrong(f'{what}: {name} = {value}: wanted a finite number')
    return values


@dataclass(frozen=True, eq=False)
class _Found:
    """A candidate; `size` is the norm of f of the held states, `left` is f over its tolerance."""

    x: Array
    u: Array
    f: Array
    size: float
    left: float

    @property
    def holds(self) -> bool:
        return self.left <= 1.0


def may_move_on(system: System) -> Mask:
    """Return for each state whether f is independent of it for the parameters in use."""
    f = ca.substitute(system.xdot, system.p, ca.DM(system.p_value))
    columns = ca.jacobian(f, system.x).sparsity().get_triplet()[1]
    return ~np.isin(np.arange(system.n), columns)


def _solve(system: System, start: Array, loose: Mask, held: Mask) -> _Found:
    best = _newton(system, start, loose, held)
    for shift in (1e-3, -1e-3, 1.0, -1.0):
        if best.holds:
            break
        found = _newton(system, start + shift * loose, loose, held)
        best = min(best, found, key=lambda each: each.left)
    return best


def _keep_inputs(system: System, u: Array, best: _Found, loose: Mask, held: Mask) -> _Found:
    """Return an equilibrium in which as many inputs as possible have the value in `u`."""
    loose = loose.copy()
    for j in np.flatnonzero(best.u != u):
        start = np.concatenate([best.x, best.u])
        start[system.n + j], loose[system.n + j] = u[j], False
        found = _newton(system, start, loose, held)
        if found.holds:
            best = found
        else:
            loose[system.n + j] = True
    return best


def _newton(system: System, start: Array, loose: Mask, held: Mask) -> _Found:
    """Reduce |f| of the held states by damped Newton steps of minimum norm."""
    def step(at: _Found, _: float) -> Array | None:
        J = np.hstack(system.jacobians(at.x, at.u))[held][:, loose]
        if at.left <= _NEGLIGIBLE or not (np.isfinite(J).all() and J.size):
            return None
        way = np.zeros(loose.size)
        way[loose] = np.linalg.lstsq(J, -at.f[held], rcond=None)[0]
        return way

    return take_damped_steps(
        _candidate(system, start, held), step, lambda at, way, part: _candidate(
            system, np.concatenate([at.x, at.u]) + way * part, held),
        lambda at: at.size, [0.5**k for k in range(_HALVINGS)], _STEPS)


def _candidate(system: System, z: Array, held: Mask) -> _Found:
    x, u = np.split(z, [system.n])
    f = system.f(x, u)
    if not np.isfinite(f).all():
        return _Found(x, u, f, np.inf, np.inf)
    terms = 1e-3 + _sum_terms(system, x, u)
    left = np.abs(f[held]) / (_TOLERANCE * terms[held])
    return _Found(x, u, f, float(np.linalg.norm(f[held])), float(left.max(initial=0.0)))


def _sum_terms(system: System, x: Array, u: Array) -> Array:
    """Return the size (n,) of the terms of f, to which its rounding error is proportional."""
    fx, fu = map(np.abs, system.jacobians(x, u))
    terms = fx @ np.abs(x) + fu @ np.abs(u) + np.abs(system.f(0 * x, 0 * u))
    return np.where(np.isfinite(terms), terms, 0.0)


def _check_limits(system: System, found: _Found) -> None:
    for signal, value in zip(system.inputs, found.u, strict=True):
        slack = 1e-9 * max(1.0, abs(value))
        if not signal.lower - slack <= value <= signal.upper + slack:
            raise DynamicsError(
                f'{system.name} {_at(system.states, found.x)} needs '
                f'{_listed(system.inputs, found.u)}: {signal.name} is limited to '
                f'[{signal.lower:g}, {signal.upper:g}] {signal.unit}'.rstrip())


def _refusal(system: System, x: Array, best: _Found, held: Mask) -> str:
    what = (f'found no equilibrium of the {system.name} '
            f'{_at(system.states, np.where(held, x, 0.0))}')
    if not np.isfinite(best.f).all():
        return f'{what}: f is undefined there'
    rest = ', '.join(f'd{signal.name}/dt = {value:.3g} {_per_second(signal.unit)}'.rstrip()
                     for signal, value, kept in zip(system.states, best.f, held, strict=True)
                     if kept and abs(value) > 1e-3 * np.abs(best.f[held]).max())
    return f'{what}: the best input, {_listed(system.inputs, best.u)}, leaves {rest}'


def _at(signals: Sequence[Signal], x: Array) -> str:
    nonzero = [(signal, value) for signal, value in zip(signals, x, strict=True) if value]
    if not nonzero:
        return 'at 0'
    return 'at ' + _listed(*zip(*nonzero, strict=True))


def _listed(signals: Sequence[Signal], values: Sequence[float] | Array) -> str:
    return ', '.join(f'{signal.name} = {value:.6g} {signal.unit}'.rstrip()
                     for signal, value in zip(signals, values, strict=True))


def _per_second(unit: str) -> str:
    """Return the unit of the derivative of a quantity with respect to time."""
    if not unit:
        return '1/s'
    return f'{unit}^2' if unit.endswith('/s') else f'{unit}/s'
