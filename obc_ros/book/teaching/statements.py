# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Questions that an extremal or a problem statement answers.

Both are judged by the certificate, which recomputes the conditions of the maximum principle from
the problem and a path.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.api.solving import certify, solve
from obc_ros.book.teaching.question import SheetQuestion
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.solution import Certificate, Condition
from obc_ros.core.text.errors import describe_type, StatementError, suggest_name
from obc_ros.core.text.expressions import parse_expression
from obc_ros.core.text.tables import format_value

Statement = Mapping[str, Any]

SAMPLES = 1001      # of an extremal
PATIENCE = 30.0   # [s] for the problem of an answer
SAME_COST = 1e-4    # relative
WORDS = {
    Condition.DYNAMICS: "x' = f(x, u) does not hold along the answer",
    Condition.START: 'x(0) is not the given state',
    Condition.END: 'x(T) violates the terminal constraint',
    Condition.BOUNDS: 'a bound or a constraint is violated',
    Condition.COSTATE: "the costate equation lambda' = -dH/dx does not hold",
    Condition.MINIMUM: 'u does not minimise H = L + lambda f',
    Condition.TRANSVERSALITY: 'lambda(T) is not dV/dx plus a multiple of the gradients of psi',
    Condition.HAMILTONIAN: 'H is not constant along the answer',
    Condition.FINAL_TIME: 'H(T) = 0 does not hold, the condition for a free final time',
    Condition.COST: 'the cost of the path is another one'}


@dataclass(frozen=True)
class ExtremalQuestion(SheetQuestion):
    """
    A question for x(t), u(t) and lam(t) of a problem with one state and one input.

    :ivar statement: the problem, by the keys of a problem file; its final time is given.
    """

    statement: Statement

    def check(self, answer: Any) -> str:
        """Return which condition does not hold, '' if all of them do."""
        x, u, lam = self._read(answer)
        if not all(np.all(np.isfinite(each)) for each in (x, u, lam)):
            return 'it has no finite value at some times'
        found = self._certify(x, u, lam)
        if found.holds:
            return ''
        if self._certify(x, u, -lam).holds:
            return ('lambda has the opposite sign: here H = L + lambda f is minimised; you '
                    'maximise, or subtract lambda f')
        if self._certify(x, u, lam / 2).holds or self._certify(x, u, lam * 2).holds:
            return 'lambda has a factor of 2 too much or too little'
        failed = [WORDS[Condition(key)] for key, value in found.residuals.items()
                  if value > found.tolerances[key]]
        return '; '.join(failed)

    def _read(self, answer: Any) -> tuple[Array, Array, Array]:
        keys = (*self.statement['states'], *self.statement['inputs'], 'lam')
        if not isinstance(answer, Mapping):
            raise StatementError(f'{self.name}: wanted formulas of {", ".join(keys)}, found '
                                 f'{describe_type(answer)}')
        for key in answer:
            if key not in keys:
                raise StatementError(f'{self.name}.{key}: unknown key'
                                     f'{suggest_name(str(key), keys)}')
        t = ca.SX.sym('t')
        paths = []
        for key in keys:
            if answer.get(key) is None:
                raise StatementError(f'{self.name}.{key}: missing; wanted a formula of t')
            formula = parse_expression(answer[key], {'t': t}, f'{self.name}.{key}')
            values = ca.Function('path', [t], [formula])(self._times[None])
            paths.append(np.broadcast_to(np.array(values).ravel(), SAMPLES))
        return paths[0], paths[1], paths[2]

    @property
    def _times(self) -> Array:
        return np.linspace(0.0, self.statement['final_time']['value'], SAMPLES)

    def _certify(self, x: Array, u: Array, lam: Array) -> Certificate:
        from scipy.integrate import simpson
        state, input_ = self.statement['states'][0], self.statement['inputs'][0]
        symbols = {name: ca.SX.sym(name) for name in (state, input_)}
        running, terminal = (ca.Function('cost', [*symbols.values()], [parse_expression(
            self.statement.get(key, 0), symbols, key)])(x[None], u[None])
            for key in ('running_cost', 'terminal_cost'))
        rate = np.broadcast_to(np.array(running).ravel(), SAMPLES)
        cost = simpson(rate, x=self._times) + float(np.array(terminal).ravel()[-1])
        return certify(self.statement, t=self._times, x=x[:, None], u=u[:, None],
                           lam=lam[:, None], objective=float(cost))


@dataclass(frozen=True)
class ProblemQuestion(SheetQuestion):
    """
    A question that a problem statement answers, which is then solved and certified.

    :ivar cost: minimum cost, from a closed form.
    :ivar extremal: gets times, returns x, u and lam of the optimum, from closed forms.
    :ivar final_time: of the optimum [s].
    :ivar mistakes: costs of typical wrong statements, each with the words for a student.
    """

    cost: float
    extremal: Callable[[Array], tuple[Array, Array, Array]]
    final_time: float
    mistakes: Sequence[tuple[float, str]] = ()

    def check(self, answer: Any) -> str:
        """Return why a statement is wrong, '' if it has the known optimum."""
        if not isinstance(answer, Mapping):
            raise StatementError(f'{self.name}: wanted the keys of a problem file, found '
                                 f'{describe_type(answer)}')
        try:
            found = solve(answer, time_limit=PATIENCE)
        except StatementError as error:
            raise StatementError(f'{self.name}: {error}') from None
        if found.status != 'solved':
            return f'the problem has no certified solution: {found.message}'
        if not math.isclose(found.objective, self.cost, rel_tol=SAME_COST):
            return next(
                (why for cost, why in self.mistakes
                 if math.isclose(found.objective, cost, rel_tol=SAME_COST)),
                f'its minimum cost is {format_value(found.objective, 6)}, that of the exercise is '
                'another one')
        t = np.linspace(0.0, self.final_time, SAMPLES)
        x, u, lam = self.extremal(t)
        certificate = certify(answer, t=t, x=x, u=u, lam=lam, objective=self.cost)
        return '' if certificate.holds else (
            'its minimum cost is right, but the optimum of the exercise is not one of this '
            f'problem: {WORDS[Condition(certificate.worst)]}')
