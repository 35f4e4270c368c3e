# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The answer to an optimal control problem."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from importlib import import_module
from typing import Any

import numpy as np
from obc_ros.api.figures.path import draw_path, draw_search
from obc_ros.api.figures.presentation import present
from obc_ros.api.interpolation import interpolate
from obc_ros.api.search_tree import SearchTree
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Certificate, Optimality, Solution
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.text.errors import describe_type, ObcError, quote
from obc_ros.core.text.json_values import convert_to_json
from obc_ros.core.text.tables import format_entry, format_html_table, Tabulated


@dataclass(frozen=True, repr=False)
class PathPoint(Tabulated):
    """Values at a time [s] or at times (M,): a number or an array (M,) for each name."""

    t: float | Array
    x: Mapping[str, Any]
    u: Mapping[str, Any]
    costates: Mapping[str, Any]

    def _rows(self) -> list[tuple[str, ...]]:
        return [('t', format_entry(self.t)), *(
            (f'{kind} {name}', format_entry(value)) for kind in ('x', 'u', 'costates')
            for name, value in getattr(self, kind).items())]


@dataclass(frozen=True, eq=False, repr=False)
class Answer:
    """
    The answer to an optimal control problem: a path with its certificate, or why there is none.

    Attributes
    ----------
    name : str
        Name of the problem.
    states, inputs : tuple of str
        Names, in the order of the columns of the solution.
    solution : Solution
        Arrays with all states and inputs, status, certificate and attempts.
    problem : Problem or None
        The problem, which `plot` and `at` need.
    title : str
        Heading of figures; empty: the name.
    statement : mapping or None
        In place of the problem, from which it is built when it is needed.

    """

    name: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    solution: Solution
    problem: Problem | None = None
    title: str = ''
    statement: Mapping[str, Any] | None = None

    @property
    def status(self) -> str:
        """Return 'solved', 'feasible', 'infeasible', 'not_converged', 'timed_out', ..."""
        return self.solution.status.value

    @property
    def message(self) -> str:
        """Return the result in a sentence; without a solution, the reason."""
        return self.solution.message

    @property
    def remark(self) -> str:
        """Return what decided a solution if it was not the cost, such as a bound of T, or ''."""
        return self.solution.remark

    @property
    def objective(self) -> float:
        """Return the cost J; nan without a path."""
        return self.solution.objective

    @property
    def has_path(self) -> bool:
        """Return whether there is a path, certified or not."""
        return self.solution.t.size > 0

    @property
    def t(self) -> Array:
        """Return the times [s], shape (N,); at a jump a time appears twice."""
        return self.solution.t

    @cached_property
    def x(self) -> Mapping[str, Array]:
        """Return each state at the times `t`, shape (N,), by its name."""
        return self._columns(self.states, self.solution.x)

    @cached_property
    def u(self) -> Mapping[str, Array]:
        """Return each input at the times `t`, shape (N,), by its name."""
        return self._columns(self.inputs, self.solution.u)

    @cached_property
    def costates(self) -> Mapping[str, Array]:
        """Return the costate of each state, shape (N,); empty if the path has none."""
        return self._columns(self.states, self.solution.lam)

    @property
    def free_parameters(self) -> Mapping[str, float]:
        """Return the values that were found for the free parameters, by name."""
        return self.solution.free_parameters

    @property
    def hamiltonian(self) -> Array:
        """Return H = L + lam' f at the times `t`, shape (N,)."""
        return self.solution.hamiltonian

    @property
    def switching_times(self) -> Array:
        """Return the times at which an input jumps or changes its arc [s]."""
        return self.solution.switching_times

    @property
    def certificate(self) -> Certificate | None:
        """Return the residual of each necessary condition; None without a path."""
        return self.solution.certificate

    @property
    def optimality(self) -> Optimality | None:
        """Return whether the optimum is global or local; None if it is not certified."""
        return self.solution.optimality

    @cached_property
    def trace(self) -> SearchTree:
        """Return what was tried; as text it is a tree."""
        return SearchTree(self.solution.attempts)

    def at(self, t: float | Sequence[float] | Array) -> PathPoint:
        """
        Return states, inputs and costates at a time, or at several.

        States and costates between samples are integrated from the sample before, under the
        returned input, as the certificate does.

        Parameters
        ----------
        t : float or array_like, shape (M,)
            From 0 to T [s]. At a jump the value after it is returned.

        Returns
        -------
        PathPoint
            With ``x['p']``, ``u['a']`` and ``costates['p']``: numbers, or arrays (M,).

        Raises
        ------
        ObcError
            If there is no path, the answer does not have its problem, or a time is not on the
            path.

        """
        problem = self._require_problem()
        try:
            times = np.asarray(t, dtype=np.float64)
        except (TypeError, ValueError):
            raise ObcError(f'at: wanted a time or a list of times, found {describe_type(t)}'
                           ) from None
        x, u, lam = interpolate(problem, self.solution, times.ravel())

        def select(names: tuple[str, ...], values: Array) -> dict[str, Any]:
            return {name: values[:, k].reshape(times.shape)[()] for k, name in enumerate(names)
                    if values.size or not times.size}

        return PathPoint(times[()], select(self.states, x), select(self.inputs, u),
                         select(self.states, lam))

    def to_dataframe(self) -> Any:
        """
        Return the path as a DataFrame of pandas, which must be installed.

        It has a row for each time; the columns are pairs such as ``('x', 'p')``, ``('u', 'a')``
        and ``('costates', 'p')``.
        """
        try:
            pandas = import_module('pandas')   # not required: nothing else needs it
        except ImportError:
            raise ObcError('to_dataframe needs pandas, which is not installed: '
                           'pip install pandas') from None
        columns = {(kind, name): values for kind in ('x', 'u', 'costates')
                   for name, values in getattr(self, kind).items()}
        return pandas.DataFrame(columns, index=pandas.Index(self.t, name='t'))

    def plot(self, *, ax: Any = None, show: bool | None = None) -> Any:
        """
        Draw the path over time, and show the figure.

        Parameters
        ----------
        ax : Axes, sequence of Axes or SubFigure, optional
            Where to draw. Axes take the panels in the order of the figure: the path in the plane,
            if there is one, states, inputs, costates and so on, as many as there are Axes.
        show : bool, optional
            Whether to show the figure now. By default a new figure is shown: by a notebook at the
            end of the cell, by a script in a window, if matplotlib has a backend with windows.

        Returns
        -------
        matplotlib.figure.Figure
            The figure; ``savefig`` writes it.

        Raises
        ------
        ObcError
            If there is no path, or `ax` is something else.

        """
        return present(partial(draw_answer, self), ax, show)

    def plot_search(self, *, ax: Any = None, show: bool | None = None) -> Any:
        """
        Draw the costs that the search has found against its work.

        Parameters
        ----------
        ax, show
            As of `plot`; there is one panel.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.

        """
        return present(partial(draw_answer_search, self), ax, show)

    def as_json(self) -> dict[str, Any]:
        """
        Return the contents of the file ``NAME.json`` of `obc solve`.

        Numbers that are not finite are None. Without a path, lists are empty; without a search,
        the times are None.
        """
        solution, optimality = self.solution, self.optimality or Optimality('', '')
        worked = bool(solution.method)
        certificate = solution.certificate or Certificate({}, {})
        entries = {
            'name': self.name, 'status': self.status, 'message': self.message,
            'remark': self.remark, 'objective': self.objective if self.has_path else None,
            't': self.t.tolist(),
            'x': _lists(self.x), 'u': _lists(self.u), 'lam': _lists(self.costates),
            'free_parameters': dict(self.free_parameters),
            'interpolation': solution.interpolation,
            'switching_times': self.switching_times.tolist(),
            'certificate': {
                'holds': solution.certified,
                'excess': certificate.excess,
                'residuals': {str(key): float(certificate.residuals[key])
                              for key in certificate.tolerances},
                'tolerances': {str(key): float(value)
                               for key, value in certificate.tolerances.items()}},
            'optimality': asdict(optimality),
            'attempts': [asdict(each) | {'verdict': str(each.verdict)}
                         for each in solution.attempts],
            'solve_time': solution.solve_time if worked else None,
            'build_time': solution.build_time if worked else None,
            'first_path_time': solution.first_path_time,
            'iterations': solution.iterations}
        plain: dict[str, Any] = convert_to_json(entries)
        return plain

    def __repr__(self) -> str:
        """Return name, status and cost, and the remark or why there is no solution."""
        cost = f', J = {self.objective:.10g}' if self.has_path else ''
        sentence = self.remark if self.solution.certified else self.message
        message = f': {quote(sentence, None)}' if sentence else ''
        return f'<Answer {quote(self.name)}: {self.status}{cost}{message}>'

    def _repr_html_(self) -> str:
        """Return a table of status, cost and the conditions of the certificate."""
        rows = [('status', self.status, ''), ('message', self.message, '')]
        if self.has_path:
            rows.append(('cost J', f'{self.objective:.10g}', ''))
            rows += [(name, f'{value:.10g}', '') for name, value in self.free_parameters.items()]
        if self.optimality:
            rows.append(('optimum', f'{self.optimality.kind} ({self.optimality.reason})', ''))
        if self.certificate:
            rows += [(name, f'{residual} of {tolerance}', verdict)
                     for name, residual, tolerance, verdict in self.certificate.rows()]
        return format_html_table(('', 'value', 'verdict'), rows, self._heading)

    @property
    def _heading(self) -> str:
        return self.title or self.name

    def _columns(self, names: tuple[str, ...], values: Array) -> Mapping[str, Array]:
        return {name: values[:, k] for k, name in enumerate(names)} if values.size else {}

    def _require_problem(self) -> Problem:
        if not self.has_path:
            raise ObcError(f'there is no path: {self.message}')
        if self._built is None:
            raise ObcError('the answer does not have its problem; give it as Answer(..., problem)')
        return self._built

    @cached_property
    def _built(self) -> Problem | None:
        if self.problem is None and self.statement is not None:
            return build_problem(dict(self.statement))
        return self.problem


def draw_answer(answer: Answer, into: Any = None) -> Any:
    """Return the figure of `Answer.plot`, without pyplot; `into`: as for `place_panels`."""
    found, problem = answer.solution, answer._require_problem()
    verdict = ('certified' if found.certified else f'{answer.status}: '
               f'{answer.certificate.sentence if answer.certificate else answer.message}')
    return draw_path(problem, found, f'{answer._heading}\nJ = {answer.objective:.8g}, '
                     f'T = {answer.t[-1]:.8g} s, {verdict}'
                     f'{answer.remark and chr(10)}{answer.remark}', into)


def draw_answer_search(answer: Answer, into: Any = None) -> Any:
    """Return the figure of `Answer.plot_search`, as `draw_answer`."""
    return draw_search(answer.solution, answer._heading, into)


def _lists(columns: Mapping[str, Array]) -> dict[str, list[float]]:
    return {name: values.tolist() for name, values in columns.items()}
