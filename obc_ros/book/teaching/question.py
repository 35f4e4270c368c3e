# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Questions of an exercise sheet, and how answers are checked.

A formula, a number or a matrix is compared with a closed form by its values, so that it may be
written in any way. A wrong answer is compared with typical mistakes: those of the question, and
those that any answer may have, such as a sign. An extremal or a problem statement is judged by the
certificate, which recomputes the conditions of the maximum principle from the problem and a path.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, product
import math
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.api.solving import certify, solve
from obc_ros.book.teaching.comparison import agree, describe_difference, SAME_FORMULA
from obc_ros.book.teaching.notation import find_unit, has_complex, parse_answer, split_answer
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.solution import Certificate, Condition
from obc_ros.core.text.errors import describe_type, StatementError, suggest_name
from obc_ros.core.text.expressions import parse_expression
from obc_ros.core.text.tables import format_value

Formula = str | float
FormulaRows = Sequence[Sequence[Formula]]

POINTS = 64        # at which formulas are compared
MOST_ENTRIES = 100  # of an answer
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
class SheetQuestion(ABC):
    """A question: the key of its answer, such as ``exercise-2.4-a-end``, its text, its form."""

    name: str
    text: str
    form: str

    @abstractmethod
    def check(self, answer: Any) -> str:
        """Return why an answer is wrong, '' if it is right; ObcError if it cannot be read."""


@dataclass(frozen=True)
class FormulaQuestion(SheetQuestion):
    """
    A question that a formula, a number, or a matrix of them answers.

    :ivar reference: a closed form, as rows if the answer is a matrix.
    :ivar names: names that may be in the answer, with the interval in which values are compared.
    :ivar mistakes: typical wrong answers, in any shape, each with the words for a student.
    :ivar advice: what an answer that is wrong in another way has to fulfil.
    """

    reference: Formula | FormulaRows
    names: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    mistakes: Sequence[tuple[Formula | Sequence[Formula] | FormulaRows, str]] = ()
    advice: str = ''

    def check(self, answer: Any) -> str:
        """Return why an answer is wrong, '' if it is right."""
        given = self.evaluate(answer)
        right = self.evaluate(self.reference)
        # A complex number is a row of two numbers: an answer only where the form says so.
        is_complex = 'imaginary' not in self.form and not self.names and has_complex(answer)
        if self.agree(given, right) and not is_complex:
            return ''
        for wrong, why in self.mistakes:
            if self.agree(given, self.evaluate(wrong)):
                return why
        if is_complex:
            return 'it is complex; wanted real numbers'
        if why := (describe_difference(given, right, bool(self.names))
                   or self._find_special_cases(answer)):
            return why
        if self.agree(given.swapaxes(1, 2), right):
            return 'it is the transpose: rows and columns are exchanged'
        if given.shape != right.shape:
            return (f'it has {given.shape[1]} x {given.shape[2]} entries; wanted '
                    f'{right.shape[1]} x {right.shape[2]}')
        if not np.all(np.isfinite(given)):
            return 'it has no finite value for some numbers that are allowed'
        return self.advice or 'it is not right'

    def evaluate(self, answer: Any) -> Array:
        """Return the values of an answer, formulas at random points of the intervals."""
        return _evaluate(self._compile(answer), self._draw_points())

    def _compile(self, answer: Any) -> ca.Function:
        """Return an answer as a function of its names."""
        rows = _arrange(self.name, split_answer(answer, not self.names, self.name))
        symbols = {name: ca.SX.sym(name) for name in self.names}
        found = ca.vertcat(*(ca.horzcat(*(
            parse_answer(entry, symbols, self.name, find_unit(self.text)) for entry in row))
            for row in rows))
        return ca.Function('answer', [ca.vertcat(*symbols.values())], [found])

    def _draw_points(self) -> Array:
        """Return points (N, names); one, if there are no names."""
        lower, upper = np.array([*self.names.values(), (0.0, 0.0)])[:-1].reshape(-1, 2).T
        return np.random.default_rng(1).uniform(
            lower, upper, size=(POINTS if self.names else 1, len(self.names)))

    def agree(self, given: Array, right: Array) -> bool:
        """Return whether values are equal: formulas to rounding, numbers to three digits."""
        return agree(given, right, bool(self.names))

    def _find_special_cases(self, answer: Any) -> str:
        """Return for which values of a name a formula is right; '' if for none of those tried."""
        names = list(self.names)
        given, right = self._compile(answer), self._compile(self.reference)
        cases: list[tuple[str, str | float]] = [*product(names, (0.0, 1.0)),
                                                *combinations(names, 2)]
        found = []
        for name, value in cases:
            points = self._draw_points()
            points[:, names.index(name)] = (
                points[:, names.index(value)] if isinstance(value, str) else value)
            wanted = _evaluate(right, points)
            if np.any(np.abs(wanted) > SAME_FORMULA) and self.agree(
                    _evaluate(given, points), wanted):
                found.append(f'{name} = {value if isinstance(value, str) else f"{value:g}"}')
        return f'it is right only for {" or ".join(found)}' if found else ''


def _evaluate(function: ca.Function, points: Array) -> Array:
    """Return the values (points, rows, columns) of an answer."""
    rows, columns = function.size_out(0)
    values = np.array(function(points.T if points.shape[1] else []))
    return values.reshape(rows, len(points), columns).swapaxes(0, 1)


def _arrange(name: str, answer: Any) -> Sequence[Sequence[Any]]:
    """Return an answer as rows; a list of entries is one row."""
    rows = answer if isinstance(answer, (list, tuple)) else [[answer]]
    if rows and not any(isinstance(row, (list, tuple)) for row in rows):
        rows = [rows]
    if not rows or not all(isinstance(row, (list, tuple)) and row for row in rows):
        raise StatementError(f'{name}: wanted rows of numbers or formulas, found '
                             f'{describe_type(answer)}')
    if len({len(row) for row in rows}) > 1:
        raise StatementError(f'{name}: the rows have different lengths')
    if sum(map(len, rows)) > MOST_ENTRIES:
        raise StatementError(f'{name}: more than {MOST_ENTRIES} entries')
    return rows


@dataclass(frozen=True)
class ExtremalQuestion(SheetQuestion):
    """A question for x(t), u(t), lam(t) of a problem with one state, one input and a given T."""

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
            formula = parse_answer(answer[key], {'t': t}, f'{self.name}.{key}')
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

    :ivar cost, extremal, final_time: of the optimum, from closed forms; x, u, lam at times.
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
        if found.remark:
            return f'its minimum cost is right, but not for the reason asked for: {found.remark}'
        t = np.linspace(0.0, self.final_time, SAMPLES)
        x, u, lam = self.extremal(t)
        certificate = certify(answer, t=t, x=x, u=u, lam=lam, objective=self.cost)
        return '' if certificate.holds else (
            'its minimum cost is right, but the optimum of the exercise is not one of this '
            f'problem: {WORDS[Condition(certificate.worst)]}')
