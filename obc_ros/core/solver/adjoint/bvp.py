# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Indirect method: Pontryagin's boundary value problem, solved by Newton's method from a path nearby.

In every arc each input is at a bound or satisfies dH/du = 0, and z = (x, lam) satisfies

    dx/dt = f(x, u),   dlam/dt = -dH/dx,   x(0) = x0,   psi(x(T)) = 0,
    lam(T) = dV/dx + nu' dpsi/dx,   H(T) = 0 if T is free,

by collocation at three Gauss points in each interval (order 6). The lengths of the arcs are
unknown, too. The equation of each switching time is that H is continuous where an input jumps
from bound to bound, and dH/du = 0 where it meets a bound. Singular arcs, on which dH/du = 0 does
not determine u, and arcs on state bounds are not treated.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.adjoint.bvp_equations import Equations, Hamiltonian, Unknowns
from obc_ros.core.solver.adjoint.bvp_solution import BoundaryValues, cut_evenly
from obc_ros.core.solver.adjoint.costates import Extremal
from obc_ros.core.solver.arcs.input_arcs import Arc
from obc_ros.core.solver.transcription.mesh import choose_cuts
from obc_ros.core.solver.transcription.program import ProblemScales

_FEWEST = 6   # minimum number of intervals in an arc
# Scaled residual at which Newton's method ends for a rough or neighbouring solution; defect of an
# interval of a thinned one.
_SHARE = 1e-6
_DEFECT = 3e-7   # sum of the scaled defects of intervals that a refinement aims at


class Indirect:
    """The boundary value problem of one structure, for any arcs and numbers."""

    def __init__(self, problem: Problem) -> None:
        self._parts = Hamiltonian(problem)

    def solve(self, problem: Problem, arcs: Sequence[Arc], course: Extremal, points: Array,
              scales: ProblemScales, *, rough: bool = False) -> BoundaryValues | None:
        """
        Solve the boundary value problem from a path with costates.

        :param problem: without state bounds or path constraints. Where x(0) is free, that of
            `course` is kept.
        :param arcs: arcs of the inputs.
        :param course: initial guess.
        :param points: mesh points [s] on which the intervals are based.
        :param scales: scales of states, inputs, time and cost.
        :param rough: accept a rough solution, which is sufficient for the ends of the arcs.
        :return: None if Newton's method did not converge.
        """
        problem = problem.pin_start(course.x[0])
        system = self._equations(
            problem, arcs, points, scales, _FEWEST // 2 if rough else _FEWEST)
        with np.errstate(all='ignore'):
            start = system.start(course)
            return system.solve(start, _SHARE) if rough else self._refined(system, start)

    def refined(self, problem: Problem, found: BoundaryValues, points: Array, scales: ProblemScales
                ) -> BoundaryValues | None:
        """
        Refine a rough solution to full accuracy.

        The intervals are those between `points`, not those of the solution: these may come from a
        neighbouring problem, and the result must not depend on it.

        :param problem: as in `solve`.
        :param found: the rough solution.
        :param points: mesh points [s].
        :param scales: as in `solve`.
        :return: None if Newton's method did not converge.
        """
        problem = problem.pin_start(found.z[0, 0, :problem.n])
        system = self._equations(problem, found.arcs, points, scales, _FEWEST)
        with np.errstate(all='ignore'):
            return self._refined(system, system.near(found))

    def thinned(self, problem: Problem, found: BoundaryValues,
                scales: ProblemScales) -> BoundaryValues:
        """
        Return a solution on fewer intervals, as an initial guess of neighbouring problems.

        :param problem: as in `solve`.
        :param found: its solution.
        :param scales: as in `solve`.
        """
        problem = problem.pin_start(found.z[0, 0, :problem.n])
        system = Equations(self._parts, problem, found.arcs, scales, *found.intervals)
        try:
            with np.errstate(all='ignore'):
                system = system.on(*_graded(system.defects(found), *found.intervals))
                return system.result(system.near(found), found.residual)
        except np.linalg.LinAlgError:
            return found   # dH/du = 0 does not determine u between its points

    def follow(self, problem: Problem, known: BoundaryValues, levels: Array, scales: ProblemScales
               ) -> BoundaryValues | None:
        """
        Solve from the solution of a neighbouring problem with the same arcs.

        :param problem: as in `solve`.
        :param known: solution of the neighbour.
        :param levels: (arcs, m), values of the inputs at bounds; nan where they are free.
        :param scales: as in `solve`.
        :return: rough; None if Newton's method did not converge.
        """
        arcs = [replace(arc, levels=tuple(row))
                for arc, row in zip(known.arcs, levels, strict=True)]
        with np.errstate(all='ignore'):
            system = Equations(self._parts, problem, arcs, scales, *known.intervals)
            return system.solve(system.near(known), _SHARE)

    def _equations(self, problem: Problem, arcs: Sequence[Arc], points: Array,
                   scales: ProblemScales, fewest: int) -> Equations:
        """Return the equations on intervals between mesh points, at least so many in an arc."""
        fractions = [_cut(arc, points, fewest) for arc in arcs]
        arc_of = np.repeat(np.arange(len(arcs)), [len(part) for part in fractions])
        return Equations(self._parts, problem, arcs, scales, np.concatenate(fractions), arc_of)

    def _refined(self, system: Equations, start: Unknowns) -> BoundaryValues | None:
        """Solve by Newton's method, on finer intervals until the defects are small enough."""
        found = system.solve(start)
        for _ in range(2):   # refinements
            if found is None or _short(system.defects(found)):
                break
            finer, start = self._finer(system, found)
            better = finer.solve(start)
            if better is None:
                break
            found, system = better, finer
        return found

    def _finer(self, system: Equations, found: BoundaryValues) -> tuple[Equations, Unknowns]:
        """Return the equations on intervals as short as needed, and the unknowns of a solution."""
        counts = choose_cuts(system.defects(found), _DEFECT / len(system.arc_of), 6.0)
        finer = system.on(np.repeat(system.fractions / counts, counts),
                          np.repeat(system.arc_of, counts))
        return finer, finer.near(found)


def _short(defects: Array) -> bool:
    """Return whether the defects are at most twice those that a refinement aims at."""
    return bool(defects.max() <= 2 * _DEFECT / len(defects))


def _cut(arc: Arc, points: Array, fewest: int) -> Array:
    """Return the lengths of the intervals of an arc, as parts of its length."""
    inside = (points - arc.start) / (arc.end - arc.start)
    inside = inside[(inside > 1e-3) & (inside < 1 - 1e-3)]
    if len(inside) < fewest:
        return np.full(fewest, 1 / fewest)
    return np.diff(np.concatenate([[0.0], inside, [1.0]]))


def _graded(defects: Array, fractions: Array, arc_of: Index) -> tuple[Array, Index]:
    """Return the intervals that the defects require, as parts of their arcs, and their arcs."""
    # In all arcs together, each of length 1.
    places, arcs = cut_evenly(np.maximum(defects / _SHARE, 1e-12) ** (1 / 6), arc_of, fractions)
    return np.diff(places), arcs
