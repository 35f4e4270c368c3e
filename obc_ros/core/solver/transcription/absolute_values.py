# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Smooth reformulation of a problem with absolute values.

|k (u - c)| becomes |k| (a + b) with u = c + a - b and a, b >= 0, which is the same where a b = 0,
as at a minimum if larger absolute values cost more. Any other |e| becomes sqrt(e^2 + eps^2) with
an eps that decreases while the mesh is refined. The solution is certified for the problem as
stated.
"""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.numerics.instructions import apply_to_expressions, Instructions
from obc_ros.core.ocp.guess import Guess
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.transcription.program import TranscriptionOutcome

_ROUNDNESS = (1e-2, 1e-3, 1e-4, 1e-6)   # eps of each refinement, in the unit of e


@dataclass(frozen=True, eq=False)
class Twin:
    """
    The smooth reformulation of the problems of one structure.

    :ivar u, p: inputs and parameters of the smooth problem; the last parameter is eps.
    :ivar expressions: f, L, path, psi and V of the smooth problem.
    :ivar split: for each smooth input the stated input that it is a part of, and its sign; 0: the
        whole.
    :ivar kinks: c (m, 1) of the inputs that are split, of the stated parameters.
    """

    u: ca.SX
    p: ca.SX
    expressions: tuple[ca.SX, ...]
    split: tuple[tuple[int, int], ...]
    kinks: ca.Function

    def problem(self, stated: Problem, turn: int = -1) -> Problem:
        """
        Return the smooth problem with the numbers of a stated one.

        :param turn: number of the refinement, which gives eps; -1: the smallest eps.
        """
        f, L, path, psi, V = self.expressions
        eps = _ROUNDNESS[min(turn, len(_ROUNDNESS) - 1)]
        lower, upper, inputs = [], [], []
        kinks = self._kinks(stated)
        for index, sign in self.split:
            a, b = stated.u_lower[index] - kinks[index], stated.u_upper[index] - kinks[index]
            if sign:
                a, b = (max(a, 0.0), max(b, 0.0)) if sign > 0 else (max(-b, 0.0), max(-a, 0.0))
            lower.append(a)
            upper.append(b)
            inputs.append(stated.inputs[index] + {0: '', 1: '#+', -1: '#-'}[sign])
        guess, *starts = (Guess(each.x, {
            name: np.maximum(sign * (np.asarray(u) - kinks[i]), 0.0) if sign else u
            for name, (i, sign) in zip(inputs, self.split, strict=True)
            if (u := each.u.get(stated.inputs[i])) is not None}, each.final_time)
            for each in (stated.guess, *stated.starts))
        return replace(
            stated, inputs=tuple(inputs), parameters=(*stated.parameters, '#eps'), u=self.u,
            p=self.p, f=f, L=L, path=path, psi=psi, V=V, u_lower=np.array(lower),
            u_upper=np.array(upper), p_value=np.append(stated.p_value, eps),
            guess=guess, starts=tuple(starts))

    def back(self, outcome: TranscriptionOutcome, stated: Problem) -> TranscriptionOutcome:
        """Return an outcome of the smooth problem with the stated inputs."""
        matrix = np.zeros((len(self.split), stated.m))
        for row, (index, sign) in enumerate(self.split):
            matrix[row, index] = sign or 1
        path, kinks = outcome.path, self._kinks(stated)
        return replace(outcome, path=replace(
            path, ua=path.ua @ matrix + kinks, ub=path.ub @ matrix + kinks))

    def part(self, stated: Problem, u: Array) -> Array:
        """Return the inputs (K, .) of the smooth problem that are stated inputs (K, m)."""
        u = u - self._kinks(stated)
        return np.column_stack([
            np.maximum(sign * u[:, index], 0.0) if sign else u[:, index]
            for index, sign in self.split])

    def _kinks(self, stated: Problem) -> Array:
        return np.asarray(self.kinks(stated.p_value).full()[:, 0])


def build_smooth_twin(problem: Problem) -> Twin | None:
    """Build the smooth reformulation of a problem, None if no absolute value occurs."""
    instructions = Instructions(ca.Function('stated', [problem.x, problem.u, problem.p], [
        ca.densify(each) for each in (
            problem.f, problem.L, problem.path, problem.psi, problem.V)]))
    if not instructions.have(ca.OP_FABS):
        return None
    eps, magnitude = ca.SX.sym('eps'), ca.SX.sym('magnitude', problem.m)
    split: dict[int, ca.SX] = {}

    def smooth(e: ca.SX) -> ca.SX:
        found = None if ca.depends_on(e, magnitude) else _single_input(problem, e)
        if found is None or not ca.is_equal(split.setdefault(*found), found[1], 9):
            return ca.sqrt(e**2 + eps**2)
        return ca.fabs(ca.jacobian(e, problem.u[found[0]])) * magnitude[found[0]]

    arguments = problem.x, problem.u, problem.p
    replaced = instructions.evaluate(
        lambda i, k: arguments[i].nz[k], ca.SX, lambda operation, operands: (
            smooth(operands[0]) if operation == ca.OP_FABS
            else apply_to_expressions(operation, operands)))
    rows: list[tuple[int, int]] = []
    for i in range(problem.m):
        rows += [(i, 1), (i, -1)] if i in split else [(i, 0)]
    u = ca.SX.sym('u', len(rows))
    kinks = [split.get(i, ca.SX(0)) for i in range(problem.m)]
    whole, sizes = list(kinks), [ca.SX(0)] * problem.m
    for part, (i, sign) in zip(ca.vertsplit(u), rows, strict=True):
        whole[i] = whole[i] + (sign or 1) * part
        sizes[i] = sizes[i] + part
    # The stated inputs are substituted last, so that |k u| is recognised.
    expressions = ca.substitute(
        [ca.vertcat(ca.SX(0, 1), *entries) for entries in replaced],
        [problem.u, magnitude], [ca.vertcat(*whole), ca.vertcat(*sizes)])
    return Twin(u, ca.vertcat(problem.p, eps), tuple(expressions), tuple(rows),
                ca.Function('kinks', [problem.p], [ca.vertcat(*kinks)]))


def _single_input(problem: Problem, e: ca.SX) -> tuple[int, ca.SX] | None:
    """Return i and c if e is k (u_i - c) with k and c constant but for parameters, else None."""
    if ca.depends_on(e, problem.x):
        return None
    used = [i for i in range(problem.m) if ca.depends_on(e, problem.u[i])]
    if len(used) != 1 or ca.depends_on(ca.jacobian(e, problem.u), problem.u):
        return None
    rest = ca.simplify(ca.substitute(e, problem.u, ca.SX.zeros(problem.m)))
    kink = ca.SX(0) if rest.is_zero() else -rest / ca.jacobian(e, problem.u[used[0]])
    return used[0], kink
