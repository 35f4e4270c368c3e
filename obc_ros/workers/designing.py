# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Requests to design a linear quadratic regulator."""

from functools import lru_cache
import json
import math

import casadi as ca
import numpy as np
from obc_ros.core.lqr.design.design import design, linearize_plant, LinearizedPlant, Sampling
from obc_ros.core.lqr.design.report import Change, report_fields
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.solution import Report
from obc_ros.core.systems.equilibrium import Equilibrium
from obc_ros.core.systems.registry import find_registered
from obc_ros.core.systems.system import Signal, System
from obc_ros.core.text.errors import RefusedDesignError, StatementError
from obc_ros.workers.solving import answer_by, Keep
from obc_ros.workers.wire import Packet


def design_regulator(request: Packet, time_limit: float, report: Report, keep: Keep) -> Packet:
    """
    Return the design of a regulator, packed; the status is ``refused`` if there is none.

    :param request: ``system`` and ``parameters``, or the arrays ``a`` and ``b``; ``sample_time``,
        ``delay`` and the weights as in the message LqrWeights.
    :param time_limit, report, keep: not used: a design takes milliseconds.
    :return: status and message; of a design also ``design`` and arrays: the fields of LqrDesign.
    """
    plain, arrays = request.plain, request.arrays
    for name in ('sample_time', 'delay'):
        if not 0.0 <= plain[name] < math.inf:
            raise StatementError(f'{name} = {plain[name]:g}: wanted 0 or a positive number')
    sampling = Sampling(plain['sample_time'], plain['delay'], exact=plain['sample_time'] > 0.0)
    if plain['system']:
        of = linearize_plant(_system(plain['system'], json.dumps(plain['parameters'])),
                             arrays['setpoint'].tolist(), arrays['setpoint_input'].tolist())
    else:
        of = _given_plant(arrays['a'], arrays['b'])
    weights = {name: arrays[name.lower()].tolist()
               for name in ('Qx', 'Qu', 'cross', 'x_max', 'u_max', 'H')}
    try:
        found = design(of, {
            **weights, 'weights': plain['weights'] or 'matrices', 'rho': plain['rho'] or 1.0,
            'stability': plain['stability']}, sampling=sampling)
    except RefusedDesignError as error:
        return Packet({'status': 'refused', 'message': str(error)})
    entries = report_fields(found, Change(), None)
    arrays = {name: value for name, value in entries.items() if isinstance(value, np.ndarray)}
    message = {name: value for name, value in entries.items() if name not in arrays}
    message['sentence'] = message['sentence'].removeprefix(': ')  # matrices have no name
    return Packet({'status': 'solved', 'message': message['sentence'], 'design': message}, arrays)


@lru_cache(32)
def _system(name: str, parameters: str) -> System:
    return find_registered(name, json.loads(parameters))


def _given_plant(a: Array, b: Array) -> LinearizedPlant:
    """Return the plant of A (n, n) and B (n, m), given row by row."""
    n = math.isqrt(a.size)
    if not n or n * n != a.size:
        raise StatementError(f'a has {a.size} numbers: wanted n*n, row by row')
    if not b.size or b.size % n:
        raise StatementError(f'b has {b.size} numbers: wanted {n}*m, row by row')
    m = b.size // n
    system = System(
        name='', states=tuple(Signal(f'x{i + 1}') for i in range(n)),
        inputs=tuple(Signal(f'u{j + 1}') for j in range(m)), parameters=(), x=ca.SX.sym('x', n),
        u=ca.SX.sym('u', m), p=ca.SX(0, 1), xdot=ca.SX(n, 1), setpoint=(0.0,) * n,
        setpoint_input=(0.0,) * m)
    rest = Equilibrium(np.zeros(n), np.zeros(m), np.zeros(n))
    return LinearizedPlant(system, rest, a.reshape(n, n), b.reshape(n, m), (0.0,) * m)


answer = answer_by({'design_lqr': design_regulator})
