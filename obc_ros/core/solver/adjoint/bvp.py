# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Pontryagin's boundary value problem, solved directly by Newton's method from a path nearby.

In every arc each input is at a bound or makes dH/du = 0; z = (x, lam) obeys

    dx/dt = f(x, u),   dlam/dt = -dH/dx,   x(0) = x0,   psi(x(T)) = 0,
    lam(T) = dV/dx + nu' dpsi/dx,   H(T) = 0 where T is free,

by collocation at three Gauss points in each interval (order 6). The lengths of the arcs are
unknown, too: where an input jumps H does not, where it meets a bound dH/du = 0 there.
Arcs on which dH/du vanishes without determining u, or on a bound of the state, are not treated.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.adjoint.bvp_equations import Equations, Hamiltonian, Unknowns
from obc_ros.core.solver.adjoint.bvp_solution import BoundaryValues, cut_evenly
from obc_ros.core.solver.adjoint.costates import Extremal
from obc_ros.core.solver.adjoint.mesh_refinement import choose_cuts
from obc_ros.core.solver.arcs.input_arcs import Arc
from obc_ros.core.solver.transcription.program import ProblemScales

_FEWEST, _FEWEST_ROUGH = 6, 3   # intervals in an arc
_SHARE = 1e-6      # of each interval where a solution nearby is known
_REFINEMENTS, _DEFECT = 2, 3e-7    # where intervals are too long for all together


class Indirect:
    """The boundary value problem of a problem's structure, for any arcs and numbers."""

    def __init__(self, problem: Problem) -> None:
        self._parts = Hamiltonian(problem)

    def solve(self, problem: Problem, arcs: Sequence[Arc], course: Extremal, points: Array,
              scales: ProblemScales, *, rough: bool = False) -> BoundaryValues | None:
        """
        Return a solution near a course with the given arcs; None if Newton finds none.

        `points`: times between which intervals are short enough. `rough`: a solution will do that
        says where the arcs end.
        """
        fractions = [_cut(arc, points, _FEWEST_ROUGH if rough else _FEWEST) for arc in arcs]
        arc_of = np.repeat(np.arange(len(arcs)), [len(part) for part in fractions])
        system = Equations(
            self._parts, problem, arcs, scales, np.concatenate(fractions), arc_of)
        with np.errstate(all='ignore'):
            start = system.start(course)
            return system.solve(start, _SHARE) if rough else self._refined(system, start)

    def refined(self, problem: Problem, found: BoundaryValues, points: Array, scales: ProblemScales
                ) -> BoundaryValues | None:
        """
        Return a rough solution to full precision, as `solve` does.

        On intervals between `points`, not on its own: it may be that of a neighbour on few, and
        what is asked twice is to be answered alike.
        """
        fractions = [_cut(arc, points, _FEWEST) for arc in found.arcs]
        arc_of = np.repeat(np.arange(len(fractions)), [len(part) for part in fractions])
        system = Equations(
            self._parts, problem, found.arcs, scales, np.concatenate(fractions), arc_of)
        with np.errstate(all='ignore'):
            return self._refined(system, system.near(found))

    def thinned(self, problem: Problem, found: BoundaryValues,
                scales: ProblemScales) -> BoundaryValues:
        """Return a solution on fewer intervals, for its neighbours to start from."""
        system = Equations(self._parts, problem, found.arcs, scales, *found.intervals)
        try:
            with np.errstate(all='ignore'):
                system = system.on(*_graded(system.defects(found), *found.intervals))
                return system.result(system.near(found), found.residual)
        except np.linalg.LinAlgError:
            return found   # between its points dH/du does not say what u is

    def follow(self, problem: Problem, known: BoundaryValues, levels: Array, scales: ProblemScales
               ) -> BoundaryValues | None:
        """Return a solution near that of another problem, inputs at bounds at these `levels`."""
        arcs = [replace(arc, levels=tuple(row))
                for arc, row in zip(known.arcs, levels, strict=True)]
        with np.errstate(all='ignore'):
            system = Equations(self._parts, problem, arcs, scales, *known.intervals)
            return system.solve(system.near(known), _SHARE)

    def _refined(self, system: Equations, start: Unknowns) -> BoundaryValues | None:
        """Return what Newton's method makes of a start, on intervals that are short enough."""
        found = system.solve(start)
        for _ in range(_REFINEMENTS):
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
    """Return whether intervals are short enough, or so nearly that others bring nothing."""
    return bool(defects.max() <= 2 * _DEFECT / len(defects))


def _cut(arc: Arc, points: Array, fewest: int) -> Array:
    """Return the lengths of the intervals of an arc as parts of it."""
    inside = (points - arc.start) / (arc.end - arc.start)
    inside = inside[(inside > 1e-3) & (inside < 1 - 1e-3)]
    if len(inside) < fewest:
        return np.full(fewest, 1 / fewest)
    return np.diff(np.concatenate([[0.0], inside, [1.0]]))


def _graded(defects: Array, fractions: Array, arc_of: Index) -> tuple[Array, Index]:
    """Return intervals, as parts of their arcs, as many as defects ask for, and their arcs."""
    needed = np.append(0.0, np.cumsum(np.maximum(defects / _SHARE, 1e-12) ** (1 / 6)))
    ends = needed[np.append(0, np.flatnonzero(np.diff(arc_of, append=-1)) + 1)]
    arcs, inner = cut_evenly(ends, np.ceil(np.diff(ends)))
    # In all arcs together, each of length 1.
    places = np.interp(inner, needed, np.append(0.0, np.cumsum(fractions)))
    return np.diff(places), arcs
