# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Statements beyond the standard form, in terms of additional states: see docs/certificate.md.

All of these are exact: the conditions of the standard form with additional states are those of the
statement.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np
from obc_ros.core.ocp.phases import PhaseLayout
from obc_ros.core.ocp.problem import FreeStart, Problem
from obc_ros.core.ocp.solution import Attempt, Solution

_JUMP = 1e-3   # of the range of an input: smaller differences are not jumps


@dataclass
class Augmentation:
    """
    The additional states of a statement, in the order in which they are added.

    :ivar x: symbols of the states of the statement.
    :ivar x0, lower, upper: x(0), or an initial guess of it, and its bounds; those of the
        additional states follow.
    """

    x: dict[str, ca.SX]
    x0: list[float]
    lower: list[float]
    upper: list[float]
    _rates: list[float] = field(default_factory=list)
    _links: list[tuple[int, int]] = field(default_factory=list)

    def add(self, name: str, symbol: ca.SX, start: tuple[float, float, float],
            rate: float = 0.0) -> None:
        """
        Add a state with a constant rate.

        :param start: initial guess, lower and upper bound of its initial value.
        """
        self.x[name] = symbol
        for values, value in zip((self.x0, self.lower, self.upper), start, strict=True):
            values.append(value)
        self._rates.append(rate)

    def keep_initial(self, expressions: Iterable[ca.SX]) -> list[ca.SX]:
        """Return expressions of x(0), of the symbols of the states, in additional states."""
        given = list(expressions)
        own = list(self.x.items())[:len(self.x) - len(self._rates)]
        used = [(i, name, symbol) for i, (name, symbol) in enumerate(own)
                if any(ca.depends_on(each, symbol) for each in given)]
        kept = [ca.SX.sym(f'{name}(0)') for _, name, _ in used]
        for (i, name, _), symbol in zip(used, kept, strict=True):
            known = self.lower[i] == self.upper[i]
            if not known:
                self._links.append((i, len(self.x)))
            self.add(f'{name}(0)', symbol, (
                self.x0[i], *((self.x0[i],) * 2 if known else (-np.inf, np.inf))))
        return [ca.substitute(each, ca.vertcat(*(symbol for *_, symbol in used)),
                              ca.vertcat(*kept)) if used else each for each in given]

    @property
    def count(self) -> int:
        """Return the number of additional states."""
        return len(self._rates)

    @property
    def rates(self) -> ca.SX:
        """Return the derivatives of the additional states, a column."""
        return ca.SX(ca.DM(self._rates)) if self._rates else ca.SX(0, 1)

    @property
    def start(self) -> FreeStart | None:
        """Return where x(0) may be, None if it is given."""
        lower, upper = np.array(self.lower), np.array(self.upper)
        return None if np.array_equal(lower, upper) else FreeStart(
            lower, upper, tuple(self._links))


def hide_added_states(problem: Problem, solution: Solution) -> Solution:
    """
    Return a solution with the states of the statement only, and with its phases in order.

    :return: without the columns of inputs that are held in u, and of additional states in x, lam
        and state_multipliers, and with `free_parameters`. H is that of the statement, which is not
        constant if the time occurs. With phases, H and multipliers along the path are left out.
    """
    n, x = problem.stated, solution.x
    if problem.held:
        solution = replace(solution, u=solution.u[:, :len(problem.shown_inputs)])
    if problem.phases is not None:
        name = problem.phases.name_phases
        solution = replace(solution, message=name(solution.message), remark=name(solution.remark),
                           attempts=name_attempts(problem, solution.attempts))
    if not solution.t.size or x.shape[1] != problem.n or not problem.added:
        return solution
    multipliers, H = solution.state_multipliers, solution.hamiltonian
    values = dict(zip(problem.states, x[0].tolist(), strict=True))
    shown = replace(
        solution, x=x[:, :n], lam=solution.lam[:, :n],
        hamiltonian=H - solution.lam[:, n] if problem.has_clock else H,
        state_multipliers=None if multipliers is None else multipliers[:, :n],
        free_parameters={name: values[name] for name in problem.free_parameters})
    return shown if problem.phases is None else _in_order(problem, problem.phases, shown)


def name_attempts(problem: Problem, attempts: Iterable[Attempt]) -> tuple[Attempt, ...]:
    """Return the attempts of a search in the words of the statement."""
    if problem.phases is None:
        return tuple(attempts)
    name = problem.phases.name_phases
    return tuple(replace(each, what=name(each.what), why=name(each.why)) for each in attempts)


def _in_order(problem: Problem, phases: PhaseLayout, shown: Solution) -> Solution:
    """Return a solution with its phases one after the other."""
    known = dict(zip(problem.parameters, problem.p_value.tolist(), strict=True))
    known |= shown.free_parameters
    durations = np.array([known[name] for name in phases.durations])
    t, x, u, lam = phases.stack(shown.t, durations, shown.x, shown.u, shown.lam)
    # Between two phases, and where an input of a phase jumps within it.
    jumps = (np.diff(t) == 0) & np.any(
        np.abs(np.diff(u, axis=0)) > _JUMP * np.ptp(u, axis=0), axis=1)
    times = np.unique(np.append(np.cumsum(durations)[:-1], t[1:][jumps]))
    names = {name: f'duration of phase {label}'
             for name, label in zip(phases.durations, phases.names, strict=True)}
    return replace(
        shown, t=t, x=x, u=u, lam=lam, hamiltonian=np.zeros(0), switching_times=times,
        state_multipliers=None, path_multipliers=None, free_parameters={
            names.get(name, name): value for name, value in shown.free_parameters.items()})


def restore_added_states(problem: Problem, solution: Solution) -> Solution:
    """
    Return a solution with the states of the problem, from one with those of the statement.

    :return: inputs that are held and the costates of additional states are 0. They act on no
        other costate and on no input. With phases, the solution as it is.
    """
    if problem.held:
        solution = replace(solution, u=np.zeros((len(solution.t), problem.m)))
    if not solution.t.size or solution.x.shape[1] == problem.n or problem.phases is not None:
        return solution
    known = dict(zip(problem.states, solution.x[0], strict=False))
    kept = {f'{name}(0)': value for name, value in known.items()} | dict(solution.free_parameters)
    N, names = len(solution.t), problem.states[problem.stated:]
    columns = [solution.t if problem.has_clock and not k else np.full(N, kept[name])
               for k, name in enumerate(names)]
    lam, multipliers = (None if each is None or not each.size else np.pad(
        each, ((0, 0), (0, problem.added))) for each in (
            solution.lam, solution.state_multipliers))
    return replace(solution, x=np.column_stack([solution.x, *columns]),
                   lam=solution.lam if lam is None else lam, state_multipliers=multipliers)
