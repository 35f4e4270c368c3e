# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The steps of a receding horizon about a set point, as `step_process` asks for them."""

from collections.abc import Iterable, Mapping
import math
import time
from typing import Any

import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.receding.first_plan import check_first_plan
from obc_ros.core.receding.formulation import RecedingProblem, state_receding_problem
from obc_ros.core.receding.step_solver import Plan, StepResult, StepSolver
from obc_ros.core.receding.terminal_set import find_terminal_set
from obc_ros.core.systems.registry import get_system
from obc_ros.core.text.errors import DynamicsError
from obc_ros.workers.wire import Packet

FOLLOWED = ('optimal', 'time', 'iterations')   # what a plan may be followed after


def prepare(problem: Packet) -> 'RecedingSteps':
    """
    Return the steps of a problem, with everything built, compiled and run once.

    :param problem: ``system``, ``parameters``, ``setpoint``, ``setpoint_input``, ``period`` [s],
        ``steps``, ``path_constraints`` and ``deadline`` [s]; arrays Qx (n, n), Qu (m, m), cross
        (n, m) or empty, u_lower, u_upper (m,), x_lower, x_upper (n,).
    :raises ObcError: if the problem cannot be stated, or no terminal set can be proved.
    """
    plain, arrays = problem.plain, problem.arrays
    system = get_system(plain['system'], plain['parameters'])
    made = state_receding_problem(
        system, horizon=plain['steps'], period=plain['period'],
        weights={name: tuple(arrays[name].ravel().tolist()) for name in ('Qx', 'Qu', 'cross')},
        setpoint=plain['setpoint'], setpoint_input=plain['setpoint_input'],
        limits={
            'state_bounds': _bounds(system.state_names, arrays['x_lower'], arrays['x_upper']),
            'input_bounds': _bounds(system.input_names, arrays['u_lower'], arrays['u_upper']),
            'path_constraints': [{'expr': each, 'upper': 0.0}
                                 for each in plain['path_constraints']]})
    return RecedingSteps(made, plain['deadline'])


class RecedingSteps:
    """
    The steps of one problem, each from the plan before it.

    A moving set point begins beside the plant: with the first step, and with a step that the plan
    before it does not reach.

    :param deadline: time that a step may take [s].
    :raises RefusedDesignError: if no terminal set can be proved.
    """

    def __init__(self, problem: RecedingProblem, deadline: float) -> None:
        self._problem, self._deadline = problem, deadline
        self._solver = StepSolver(problem)
        self._set = find_terminal_set(problem)
        self._words = self._solver.prepare()
        self._last: Plan | None = None
        # [ns]: stamps of plans are seconds from here, for their precision. None before the first
        # step, which comes a period after the first plan.
        self._origin: int | None = None
        self._moved = np.zeros(len(problem.xe))   # the place of the set point less xe at t = 0

    @property
    def ready(self) -> Packet:
        """Return the terminal set."""
        found = self._set
        return Packet({'level': found.level, 'sentence': f'{found.words}; {self._words}'},
                      {'P': found.P})

    def answer(self, request: Packet) -> Packet:
        """
        Return the plan of a request.

        :param request: ``kind`` 'first': a plan from the state x without excess, or with no more
            than that of the plan that is followed (``present``, by limit), with what was checked
            of it in ``words``, or a refusal. 'step': the plan from the instant ``stamp`` [ns] on,
            a period after the state x at which u acts.
        :raises ObcError: if there is no plan; the message gives the reason.
        """
        x = request.arrays['x']
        if request.plain['kind'] == 'first':
            return self._plan_first(x, request.plain.get('present'))
        begun, stamp = time.monotonic(), int(request.plain['stamp'])
        period = self._problem.period
        if is_first := self._origin is None:
            self._origin = stamp - round(1e9 * period)
        t = (stamp - self._origin) * 1e-9
        if is_first or self._last is None or not self._last.stamp <= t < self._last.end:
            self._place(x, t - period)
        ahead = self._predict(x - self._moved, request.arrays['u'], t)
        found = self._solver.solve(ahead, self._last, begun + self._deadline, t)
        plan = found.plan
        if plan is None or found.status not in FOLLOWED or not plan.is_finite:
            raise DynamicsError(f'no plan: {found.words}')
        self._last = plan
        return Packet({'stamp': stamp, 'cost': plan.cost, 'slack': dict(found.slack),
                       **_describe(found), 'seconds': time.monotonic() - begun},
                      {'x': plan.x + self._moved, 'u': plan.u})

    def _place(self, x: Array, t: float) -> None:
        """Let a moving set point be beside the state x (n,) at time t [s], along its drift."""
        drift = self._problem.drift
        if drift.any():
            error = self._problem.error(x, t)
            self._moved = drift * (drift @ error) / (drift @ drift)

    def _predict(self, x: Array, u: Array, t: float) -> Array:
        """Return the state (n,) at time t [s], a period after x, in which u (m,) is held."""
        problem = self._problem
        error = problem.model(problem.error(x, t - problem.period), u - problem.ue)
        ahead = error.full().ravel() + problem.xe + problem.drift * t
        if not np.isfinite(ahead).all():
            raise DynamicsError('no plan: the predicted state is not finite')
        return np.asarray(ahead)

    def _plan_first(self, x: Array, present: Mapping[str, float] | None) -> Packet:
        """Return a plan from the state x (n,) with no more excess than at present."""
        self._place(x, 0.0)
        found = self._solver.solve(x - self._moved, stamp=0.0)
        words = check_first_plan(self._problem, found, self._set, present)
        assert found.plan is not None
        self._last, self._origin = found.plan, None
        return Packet({**_describe(found), 'words': words},
                      {'x': found.plan.x + self._moved, 'u': found.plan.u})


def _describe(found: StepResult) -> dict[str, Any]:
    return {'status': found.status, 'iterations': found.iterations, 'residual': found.residual,
            'seconds': found.seconds}


def _bounds(names: Iterable[str], lower: Array, upper: Array
            ) -> dict[str, list[float | None]]:
    return {name: [float(value) if math.isfinite(value) else None for value in pair]
            for name, *pair in zip(names, lower, upper, strict=True)
            if any(map(math.isfinite, pair))}
