# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Minimise F(x) subject to G(x) = 0, g(x) <= 0 and x in a box, with a certificate (section 2.1).

IPOPT starts from several points. The lowest stationary point found is refined by Newton's method
and certified by `kkt`, which uses nothing of IPOPT.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
import math
import time

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.enclosures.interval_arithmetic import enclose_outputs
from obc_ros.core.numerics.ipopt import build_ipopt, run_ipopt
from obc_ros.core.ocp.affine_constraints import eliminate_rows, read_affine_rows
from obc_ros.core.ocp.certificate import kkt
from obc_ros.core.ocp.certificate.kkt import KktCondition
from obc_ros.core.ocp.solution import Certificate, Report, Status
from obc_ros.core.text.errors import quote, StatementError, suggest_name
from obc_ros.core.text.expressions import check_name, parse_expression, parse_number
from obc_ros.core.text.fields import (
    check_keys,
    Given,
    read_bounds,
    read_list,
    read_mapping,
    read_names,
    read_section,
)
from obc_ros.core.text.tables import Tabulated

KEYS = ('variables', 'parameters', 'cost', 'equalities', 'inequalities', 'bounds', 'guess')
MAX_COUNT = 500       # maximum number of variables, of constraints, of parameters
STARTS = 12           # initial points without a guess, for a problem that is not convex


@dataclass(frozen=True, eq=False, repr=False)
class Minimum(Tabulated):
    """
    The solution of a static problem.

    :ivar x, objective: (n,), the minimiser, and F there.
    :ivar lam, mu: (k,), (l,), multipliers: grad F + lam' grad G + mu' grad g = 0 inside the
        bounds, mu >= 0.
    :ivar certificate: stationarity, feasibility, signs, complementarity, second_order, attained.
    """

    status: Status
    message: str
    x: Array = field(default_factory=lambda: np.zeros(0))
    objective: float = math.nan
    lam: Array = field(default_factory=lambda: np.zeros(0))
    mu: Array = field(default_factory=lambda: np.zeros(0))
    certificate: Certificate | None = None

    def _title(self) -> str:
        return f'Minimum: {self.status.value}'


@dataclass(frozen=True, eq=False)
class _Question:
    """A checked statement."""

    program: kkt.StaticProgram
    names: tuple[str, ...]
    constraints: tuple[str, ...]
    guess: Array | None


@dataclass(frozen=True, eq=False)
class _Run:
    """The end of a run of IPOPT; `said` is its status, 'unbounded' or 'infeasible'."""

    start: Array
    x: Array
    F: float
    said: str


def minimize(statement: object, *, time_limit: float = 10.0,
             report: Report | None = None) -> Minimum:
    """
    Minimise a function of several variables.

    :param statement: ``variables``: names. ``parameters``: name -> number or expression of earlier
        ones. ``cost``: expression F. ``equalities``, ``inequalities``: lists of expressions G = 0
        and g <= 0. ``bounds``: name -> [lower, upper], null for none. ``guess``: initial point, n
        numbers; STARTS points are tried without it.
    :param time_limit: limit of the wall-clock time [s].
    :param report: called between runs; True cancels.
    :return: ``solved`` only if the certificate passes. The minimum is global for a convex
        quadratic problem, otherwise the lowest one found.
    :raises StatementError: if the statement is malformed; the message begins with the key at
        fault.
    """
    question = _question(statement)
    deadline = time.monotonic() + time_limit
    runs: list[_Run] = []
    program = question.program
    nlp = {'x': program.x, 'f': program.F, 'g': ca.vertcat(program.G, program.g)}
    convex = _is_convex(program)
    for count, start in enumerate(_starts(question)):
        left = deadline - time.monotonic()
        if left <= 0:
            break
        best = min((run.F for run in runs), default=math.nan)
        if report is not None and report('minimise', count, best, math.nan):
            return Minimum(Status.CANCELLED, 'cancelled')
        runs.append(_run(program, build_ipopt('static', nlp, time_limit=left), start))
        if (convex or question.guess is not None) and _converged(runs[-1]):
            break
    return _judged(question, runs, convex, deadline)


def _judged(question: _Question, runs: list[_Run], convex: bool, deadline: float) -> Minimum:
    """Return the lowest certified minimum, or the reason why there is none."""
    bottomless = next((run for run in runs if run.said == 'unbounded'), None)
    ends = sorted((run for run in runs if _converged(run)), key=lambda run: run.F)
    failed: Minimum | None = None
    for run in _distinct(ends):
        point = kkt.polish_minimum(question.program, run.x)
        certificate = kkt.certify_minimum(question.program, point)
        F = question.program.values(point.x)[0]
        found = Minimum(Status.SOLVED, _sentence(question, F, point, convex, len(runs)), point.x,
                        F, point.lam, point.mu, certificate)
        if certificate.holds and bottomless is None:
            return found
        failed = failed or replace(found, status=Status.NOT_CONVERGED,
                                   message=_why_not(question.program, point, certificate, F))
    if bottomless is not None:
        return Minimum(Status.NOT_CONVERGED, _bottomless(question, bottomless, failed))
    if failed is not None:
        return failed
    if time.monotonic() >= deadline:
        return Minimum(Status.TIMED_OUT, f'no minimum was found in time, from {len(runs)} starts')
    return _infeasible(question, runs)


def _sentence(question: _Question, F: float, point: kkt.KktPoint, convex: bool,
              starts: int) -> str:
    if convex:
        text = f'minimum {F:.10g}, global: the problem is convex'
    elif starts == 1:
        text = f'minimum {F:.10g}, the one near the guess'
    else:
        text = f'minimum {F:.10g}, the lowest found from {starts} starts'
    if point.dependent:
        text += ('; the gradients of the active constraints are linearly dependent (LICQ fails): '
                 'the multipliers are not unique')
    elif point.saddle and question.program.k + question.program.l:
        text += "; a saddle of F + lam'G + mu'g, as constrained minima may be"
    return text


def _why_not(program: kkt.StaticProgram, point: kkt.KktPoint, certificate: Certificate,
             F: float) -> str:
    worst = certificate.worst
    if (worst in (KktCondition.STATIONARITY, KktCondition.ATTAINED)
            and kkt.is_strained(program, point)):
        return (f'stopped at F = {F:.10g}: towards it the gradients of the active constraints '
                'become linearly dependent (LICQ fails) and the multipliers grow without bound')
    if worst == KktCondition.STATIONARITY and point.dependent:
        return (f'stopped at F = {F:.10g}: the gradients of the active constraints are linearly '
                'dependent there (LICQ fails) and no multipliers exist')
    if worst == KktCondition.ATTAINED:
        return (f'F decreases towards {F:.6g}, which is not attained at any point found: it keeps '
                'decreasing as x grows, or along a flat valley')
    reason: Mapping[str, str] = {
        KktCondition.STATIONARITY: 'the gradient of F is no combination of those of the '
                                   'active constraints; F may not be smooth there',
        KktCondition.SECOND_ORDER: 'it is a saddle along the constraints, not a minimum'}
    residual = certificate.residuals[worst]
    size = f'{residual:.2g}' if math.isfinite(residual) else 'could not be computed'
    return (f'stopped at F = {F:.10g}, which is not certified: {worst} {size} '
            f'(tolerance {certificate.tolerances[worst]:.0e})'
            + (f': {reason[worst]}' if worst in reason else ''))


def _bottomless(question: _Question, run: _Run, local: Minimum | None) -> str:
    place = ', '.join(f'{name} = {value:.3g}' for name, value in
                      zip(question.names[:6], run.x, strict=False))
    text = f'F seems to be unbounded below: it falls to {run.F:.3g} at {place}'
    if local is None or local.certificate is None or not local.certificate.holds:
        return text
    return f'{text}; a local minimum is {local.objective:.6g}'


def _infeasible(question: _Question, runs: list[_Run]) -> Minimum:
    """Return that no feasible point was found or exists, with the constraint violated most."""
    program = question.program
    least, worst = math.inf, ''
    for run in runs:
        x = _least_violation(program, run.start)
        c = program.values(x)[1]
        violation = np.concatenate((np.abs(c[:program.k]), np.maximum(c[program.k:], 0)))
        if violation.size and np.isfinite(violation).all() and violation.max() < least:
            least = float(violation.max())
            worst = question.constraints[int(np.argmax(violation))]
    if not 1e-7 <= least < math.inf:
        return Minimum(Status.NOT_CONVERGED, f'no minimum was found from {len(runs)} starts: '
                                             f'{runs[-1].said.replace("_", " ").lower()}')
    where = (f'where they are closest to it, from {len(runs)} starts, {worst} is violated by '
             f'{least:.4g}')
    if _is_excluded(program):
        return Minimum(Status.INFEASIBLE, f'no point satisfies all constraints: {where}')
    return Minimum(Status.NOT_CONVERGED, (
        f'no point was found that satisfies all constraints: {where}; infeasibility has '
        'not been proved'))


def _is_excluded(program: kkt.StaticProgram) -> bool:
    """Return whether infeasibility is proved, by interval arithmetic or exact elimination."""
    box = [(program.lower, program.upper)]
    G, g = (ca.Function('rows', [program.x], [ca.densify(each)])
            for each in (program.G, program.g))
    slack = 1e-6   # certificates allow less
    if any(each.low > slack or each.high < -slack for each in enclose_outputs(G, box)) or any(
            each.low > slack for each in enclose_outputs(g, box)):
        return True
    n = program.x.numel()
    return eliminate_rows(read_affine_rows(G, [[None] * n]), n)[1] is not None


def _least_violation(program: kkt.StaticProgram, start: Array) -> Array:
    """Return a local minimiser of the squared violation of the constraints near a start."""
    slack = ca.SX.sym('slack', program.l)
    cost = ca.sumsqr(program.G) + ca.sumsqr(slack)
    solver = build_ipopt('static', {
        'x': ca.vertcat(program.x, slack), 'f': cost, 'g': program.g - slack}, time_limit=5.0)
    x = np.clip(np.nan_to_num(start), program.lower, program.upper)
    slack0 = np.nan_to_num(np.maximum(program.values(x)[1][program.k:], 0))
    end = run_ipopt(solver, np.concatenate((x, slack0)), (
        np.concatenate((program.lower, np.zeros(program.l))),
        np.concatenate((program.upper, np.full(program.l, np.inf)))), (-np.inf, 0.0)
    ).w[:len(start)]
    return np.asarray(np.clip(end, program.lower, program.upper))


def _distinct(ends: list[_Run]) -> Iterator[_Run]:
    """Yield the runs of different costs, the lowest first."""
    last = math.nan
    for run in ends:
        if not abs(run.F - last) <= 1e-7 * (1 + abs(run.F)):
            yield run
        last = run.F


def _converged(run: _Run) -> bool:
    return run.said in ('Solve_Succeeded', 'Solved_To_Acceptable_Level',
                        'Search_Direction_Becomes_Too_Small', 'Feasible_Point_Found')


def _run(program: kkt.StaticProgram, solver: ca.Function, start: Array) -> _Run:
    lower = np.concatenate((np.zeros(program.k), np.full(program.l, -np.inf)))
    found = run_ipopt(solver, start, (program.lower, program.upper), (lower, 0.0))
    x, said = np.clip(found.w, program.lower, program.upper), found.status
    F, c, _, J = program.values(x)
    if not (np.isfinite(x).all() and np.isfinite(F)):
        return _Run(start, start, math.inf, 'a value that is not finite')
    first = program.values(start)[0]
    drop = -1e12 * (1 + (abs(first) if np.isfinite(first) else 0.0))   # unbounded below it
    feasible = kkt.measure_violation(program, x, c, J) <= 1e-6
    if feasible and F - drop < 0:
        return _Run(start, x, F, 'unbounded')
    stuck = said == 'Infeasible_Problem_Detected' or (
        said == 'Restoration_Failed' and not feasible)
    return _Run(start, x, F, 'infeasible' if stuck else said)


def _is_convex(program: kkt.StaticProgram) -> bool:
    """Return whether F is a convex quadratic and the constraints are affine."""
    c = ca.vertcat(program.G, program.g)
    H = ca.hessian(program.F, program.x)[0]
    if ca.depends_on(ca.vertcat(ca.vec(H), ca.vec(ca.jacobian(c, program.x))), program.x):
        return False
    values = np.linalg.eigvalsh(ca.DM(ca.evalf(H)).full())
    return bool(values[0] >= -1e-12 * max(np.abs(values).max(), 1e-300))


def _starts(question: _Question) -> Iterator[Array]:
    """Yield the guess, or the middle of the box and random points in it."""
    program = question.program
    if question.guess is not None:
        yield np.clip(question.guess, program.lower, program.upper)
        return
    lower, upper = program.lower, program.upper
    left, right = np.isfinite(lower), np.isfinite(upper)
    middle = np.where(left & right, np.where(left, lower, 0) / 2 + np.where(right, upper, 0) / 2,
                      np.where(left, lower + 1, np.where(right, upper - 1, 0.0)))
    half = np.where(left & right, (np.where(right, upper, 0) - np.where(left, lower, 0)) / 2, 1.0)
    yield middle
    rng = np.random.default_rng(0)
    for _ in range(1, STARTS):
        spread = half * np.where(left & right, 1.0, 10.0**rng.integers(-1, 2))
        yield np.clip(middle + spread * rng.uniform(-1, 1, len(middle)), lower, upper)


def _question(statement: object) -> _Question:
    given = read_mapping(statement, 'minimize')
    check_keys(given, KEYS)
    names = read_names(given, 'variables', MAX_COUNT)
    values = _parameters(given, names)
    x = ca.vertcat(*(ca.SX.sym(name) for name in names))
    symbols = {name: x[i] for i, name in enumerate(names)}
    symbols |= {name: ca.SX(value) for name, value in values.items()}
    if given.get('cost') is None:
        raise StatementError('cost: missing; wanted an expression of the variables')
    F = parse_expression(given['cost'], symbols, 'cost')
    G, equal = _column(given, 'equalities', '= 0', symbols)
    g, less = _column(given, 'inequalities', '<= 0', symbols)
    lower, upper = _bounds(given, names, values)
    return _Question(kkt.StaticProgram(x, F, G, g, lower, upper), names, (*equal, *less),
                     _guess(given, names, values))


def _column(given: Given, key: str, sign: str, symbols: Mapping[str, ca.SX]
            ) -> tuple[ca.SX, list[str]]:
    """Return a list of expressions as a column, with a name for each in messages."""
    texts = read_list(given, key, MAX_COUNT)
    column = ca.vertcat(ca.SX(0, 1), *(
        parse_expression(text, symbols, f'{key}[{i}]') for i, text in enumerate(texts)))
    return column, [f'{key}[{i}] ({quote(str(text))} {sign})' for i, text in enumerate(texts)]


def _parameters(given: Given, names: tuple[str, ...]) -> dict[str, float]:
    values: dict[str, float] = {}
    for name, text in read_section(given, 'parameters', MAX_COUNT).items():
        check_name(name, 'parameters')
        if name in names:
            raise StatementError(f"parameters: '{name}' is a variable too")
        values[name] = parse_number(text, values, f'parameters.{name}')
    return values


def _bounds(given: Given, names: tuple[str, ...], values: dict[str, float]) -> tuple[Array, Array]:
    lower, upper = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    for name, pair in read_section(given, 'bounds', MAX_COUNT).items():
        if name not in names:
            raise StatementError(f"bounds: '{quote(str(name))}' is not a variable"
                                 f'{suggest_name(str(name), names)}')
        i = names.index(name)
        lower[i], upper[i] = read_bounds(pair, values, f'bounds.{name}')
    return lower, upper


def _guess(given: Given, names: tuple[str, ...], values: dict[str, float]) -> Array | None:
    guess = read_list(given, 'guess', MAX_COUNT)
    if not guess:
        return None
    if len(guess) != len(names):
        raise StatementError(f'guess: {len(guess)} numbers for {len(names)} variables')
    return np.array([parse_number(value, values, f'guess[{i}]') for i, value in enumerate(guess)])
