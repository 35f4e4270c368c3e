# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A program of a user, which type checkers read; `test_typing.py` runs them.

Each line with `type: ignore` is a mistake that must be found: one that is not needed is an error.
"""

from pathlib import Path
from typing import Any, assert_type

import numpy as np
from numpy.typing import NDArray
import obc_ros as obc
from obc_ros.api.plants import SystemNames
from obc_ros.api.regulators import FiniteHorizonDesign, RegulatorDesign
from obc_ros.api.simulation import Simulation
from obc_ros.core.estimation.kalman_gain import KalmanDesign
from obc_ros.core.ocp.solution import Certificate
from obc_ros.core.systems.equilibrium import Equilibrium
from obc_ros.core.tasks.minimize import Minimum

assert_type(obc.__version__, str)
assert_type(obc.systems, SystemNames)

cart = obc.System(
    name='cart', states=['p', 'v'], inputs=['F'], parameters={'m': 2},
    dynamics=lambda x, u, p: {'p': x.v, 'v': u.F / p.m}, input_bounds={'F': [-10, 10]})
assert_type(cart.states, tuple[str, ...])
assert_type(cart.f([1, 0], {'F': 1}), NDArray[np.float64])
assert_type(obc.equilibrium(cart), Equilibrium)
AT = {'px': 1, 'py': 0, 'theta': 0, 'vx': 0, 'vy': 0, 'omega': 0}
assert_type(obc.equilibrium('aircraft', AT), Equilibrium)

problem = obc.Problem(
    system=cart, running_cost='F**2', initial_state=[0, 0],
    terminal_constraints=lambda x: [x.p - 1, x.v], final_time={'free': False, 'value': 1})
assert_type(problem, obc.Problem)
assert_type(problem.replace(initial_state={'p': 1, 'v': None}), obc.Problem)
assert_type(obc.Problem.from_file(Path('cart.yaml')), obc.Problem)


def solve_again(answer: obc.Answer) -> obc.Answer:
    """Solve a problem from the middle of a path on."""
    middle = answer.at(0.5)
    return obc.solve(answer, initial_state=middle, time_limit=10, title='the second half')


answer = obc.solve(problem, input_bounds={'F': [-5, None]}, cache=obc.Cache(8))
assert_type(answer, obc.Answer)
assert_type(answer.status, str)
assert_type(answer.objective, float)
assert_type(answer.t, NDArray[np.float64])
assert_type(answer.x['p'], NDArray[np.float64])
assert_type(answer.certificate, Certificate | None)
assert_type(obc.certify(problem, answer), Certificate)
assert_type(solve_again(answer).remark, str)
for source in (problem, answer, 'cart.yaml', Path('cart.yaml'), {'states': ['x']}):
    assert_type(obc.solve(source), obc.Answer)

A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [0.5]])
assert_type(obc.lqr(A, B, [1, 1], [1]), RegulatorDesign)
assert_type(obc.lqr([[0, 1], [0, 0]], [[0], [1]], np.eye(2), 1), RegulatorDesign)
assert_type(obc.lqr(A=A, B=B, Qx=[1, 1], Qu=1), RegulatorDesign)
assert_type(obc.lqr(cart, {'p': 1, 'v': 0.1}, [0.01], at=[3, 0]), RegulatorDesign)
assert_type(obc.lqr(system='aircraft', Qx=1, Qu=1).K, NDArray[np.float64])
assert_type(obc.dlqr(cart, 1, 1, period=0.1), RegulatorDesign)
assert_type(obc.lqe(A, [[1, 0]], [1, 1], 1), KalmanDesign)
assert_type(obc.lqe(cart, {'p': 1, 'v': 1}, Rv=1), KalmanDesign)
law = obc.finite_horizon(cart, 1, 1, 0, T=2.0)
assert_type(law, FiniteHorizonDesign)
assert_type(law(0.5, answer.at(0.5)), NDArray[np.float64])

t = np.linspace(0, 2, 21)
loop = obc.simulate(cart, law, {'p': 1, 'v': 0}, t)
assert_type(loop, Simulation)
assert_type(loop.x['p'][-1] < 1e-3, Any)
assert_type(obc.plan(cart, [0, 0], [1, 0], 'effort', final_time=1), obc.Answer)
assert_type(obc.minimize(variables=['x'], cost='x**2', bounds={'x': [1, None]}), Minimum)
try:
    obc.solve(problem, running_cost='w')
except obc.ObcError as error:
    assert_type(str(error), str)

obc.solve(problem, time_limit='10')  # type: ignore[arg-type]
obc.solve(problem, runing_cost=1)  # type: ignore[call-arg]
obc.solve(3)  # type: ignore[arg-type]
obc.Problem(states='p, v', inputs=3)  # type: ignore[arg-type]
obc.System(parameters=['m'])  # type: ignore[arg-type]
obc.lqr(A, B, [1, 1])  # type: ignore[call-overload]
obc.lqr(A, B, [1, 1], [1], at=[0, 0])  # type: ignore[call-overload]
obc.lqr(cart, [1, 1])  # type: ignore[call-overload]
obc.simulate(cart, law, 'rest', t)  # type: ignore[arg-type]
obc.equilibrium(3)  # type: ignore[arg-type]
answer.objektive  # type: ignore[attr-defined]  # noqa: B018
obc.nothing  # type: ignore[attr-defined]  # noqa: B018
