# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The closed loop of a regulator and a plant that may differ from that of the design.

u = ue - K (x - xe) with the limits of the inputs; xe, ue and K are those of the design. The cost
is the integral of e'Qx e + 2 e'N v + v'Qu v with e = x - xe and v = u - ue.
"""

from collections.abc import Mapping
import math
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.lqr.design.design import Design, design, linearize_plant, LinearizedPlant
from obc_ros.core.numerics.arrays import Array, integrate
from obc_ros.core.systems.equilibrium import Equilibrium
from obc_ros.core.systems.file import build_plant
from obc_ros.core.systems.registry import find_registered
from obc_ros.core.systems.system import Signal, System
from obc_ros.core.text.errors import DynamicsError, RefusedDesignError, StatementError
from obc_ros.sweep.regulator_numbers import read_numbers

WEIGHTS = ('Qx', 'Qu', 'cross', 'x_max', 'u_max', 'H')
CONSTANTS = 12.0     # of the slowest mode of the designed loop, simulated by default
LONGEST = 1e4        # [s] simulated by default
ACCURACY = 1e-9      # relative, of a step
FARTHEST = 1e6       # growth of the error at which a loop counts as unstable
SAMPLES = 2001       # times at which overshoot and peaks are looked for
SETTLED = 0.01       # part of the first error


def simulate_regulator(request: Mapping[str, Any]) -> dict[str, Any]:
    """
    Design a regulator, simulate its closed loop, and return its numbers.

    :param request: from `RegulatorNumbers.vary`: `case`, `plant`, `x0` (deviations by state) and
        `T` [s] (0: long enough for the designed loop).
    :return: values of `dataset.REGULATOR_QUANTITIES`; status ``refused`` if there is no design.
    :raises ObcError: if the case is malformed.
    """
    case = request['case']
    system = _system(case, case)
    try:
        found = design(linearize_plant_of(case, system), _weights(case))
    except RefusedDesignError as error:
        return {'status': 'refused', 'message': str(error)}
    plant = _system(case, request['plant'])
    e0 = np.array(list(request['x0'].values()))
    slowest = max(found.lqr.E.real)
    duration = request['T'] or min(CONSTANTS / -slowest, LONGEST)
    if not duration > 0.0:
        raise StatementError(f'T: wanted a duration > 0, found {duration:g}')
    answer = {'status': 'solved', 'message': '', 'optimal_cost': float(e0 @ found.lqr.P @ e0),
              'duration': duration, 'gain': found.K.ravel().tolist(),
              'decay': -_slowest(plant, found, case)}
    return answer | _simulate(plant, found, e0, duration)


def linearize_plant_of(case: Mapping[str, Any], system: System) -> LinearizedPlant:
    """Return the plant of a case at its set point; ObcError: it is no equilibrium."""
    if all(case.get(key) is None for key in ('system', 'plant')):   # matrices: x = 0
        n, m = system.n, system.m
        A, B = system.jacobians(np.zeros(n), np.zeros(m))
        rest = Equilibrium(np.zeros(n), np.zeros(m), np.zeros(n))
        return LinearizedPlant(system, rest, A, B, (0.0,) * m)
    return linearize_plant(system, *(
        read_numbers(case[key], key) if case.get(key) else []
        for key in ('setpoint', 'setpoint_input')))


def _system(case: Mapping[str, Any], numbers: Mapping[str, Any]) -> System:
    if case.get('plant') is not None:
        return build_plant(case['plant'], numbers.get('parameters') or {})
    if case.get('system') is not None:
        return find_registered(case['system'], numbers.get('parameters') or {})
    A, B = (np.array(read_numbers(numbers[key], key)) for key in ('A', 'B'))
    x, u = ca.SX.sym('x', len(A)), ca.SX.sym('u', B.shape[1])
    return System(
        name='', states=tuple(Signal(f'x{i + 1}') for i in range(len(A))),
        inputs=tuple(Signal(f'u{j + 1}') for j in range(B.shape[1])), parameters=(), x=x, u=u,
        p=ca.SX(0, 1), xdot=ca.mtimes(ca.DM(A), x) + ca.mtimes(ca.DM(B), u),
        setpoint=(0.0,) * len(A), setpoint_input=(0.0,) * B.shape[1])


def _weights(case: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {key: np.ravel(read_numbers(case[key], key)).tolist()
                             for key in WEIGHTS if case.get(key) is not None}
    found |= {key: read_numbers(case[key], key) for key in ('rho', 'stability')
              if case.get(key) is not None}
    return found | {'weights': case.get('weights') or 'matrices'}


def _slowest(plant: System, found: Design, case: Mapping[str, Any]) -> float:
    """Return the slowest pole [1/s] at the plant's own equilibrium, without limits; nan: none."""
    try:
        at = linearize_plant_of(case, plant)
    except DynamicsError:
        return math.nan
    return float(np.linalg.eigvals(at.A - at.B @ found.K).real.max())


def _make_slope(plant: System, found: Design) -> ca.Function:
    """Return the derivative of (x, cost) of the closed loop as a function of it."""
    z, rest = ca.SX.sym('z', plant.n + 1), ca.DM(found.plant.rest)
    x = z[:-1]
    e = x - ca.DM(found.plant.equilibrium.x)
    u = ca.fmin(ca.fmax(rest - ca.DM(found.K) @ e, ca.DM(plant.u_min)), ca.DM(plant.u_max))
    v, cost = u - rest, found.weights
    rate = e.T @ ca.DM(cost.Qx) @ e + v.T @ ca.DM(cost.Qu) @ v
    if cost.cross is not None:
        rate += 2.0 * e.T @ ca.DM(cost.cross) @ v
    rates = ca.Function('f', [plant.x, plant.u, plant.p], [plant.xdot])
    return ca.Function('slope', [z], [ca.vertcat(rates(x, u, ca.DM(plant.p_value)), rate)])


def _simulate(plant: System, found: Design, e0: Array, duration: float) -> dict[str, Any]:
    first = float(np.linalg.norm(e0)) or 1.0
    xe, rest = found.plant.equilibrium.x, np.asarray(found.plant.rest)

    def diverge(t: float, z: Array) -> float:
        return FARTHEST * first - float(np.linalg.norm(z[:-1] - xe))

    diverge.terminal = True  # type: ignore[attr-defined]
    slope, times = _make_slope(plant, found), np.linspace(0.0, duration, SAMPLES)
    path = integrate.solve_ivp(   # LSODA: a gain that is large makes the loop stiff
        lambda t, z: slope(z).full().ravel(), (0.0, duration), np.append(xe + e0, 0.0),
        method='LSODA', rtol=ACCURACY, atol=ACCURACY * first, events=diverge, t_eval=times)
    if path.status != 0:   # it left the range, or the steps vanished
        return {'J': math.inf, 'settled': 0, 'final_error': math.inf}
    e = path.y[:-1].T - xe
    v = np.clip(rest - e @ found.K.T, plant.u_min, plant.u_max) - rest
    final = float(np.linalg.norm(e[-1]))
    return {'J': float(path.y[-1, -1]), 'settled': int(final <= SETTLED * first),
            'final_error': final, 'overshoot': _overshoot(e),
            'peak': np.abs(v).max(axis=0).tolist()}


def _overshoot(e: Array) -> list[float]:
    """Return how far each state goes beyond the set point, relative to its first error."""
    with np.errstate(divide='ignore', invalid='ignore'):
        beyond = np.maximum(-(e / e[0]).min(axis=0), 0.0)
    return list(map(float, np.where(e[0] != 0.0, beyond, np.nan)))
