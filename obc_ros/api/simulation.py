# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Simulation of a system under a control law or given inputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
import inspect
import math
from typing import Any

import numpy as np
from obc_ros.api.answer import Answer
from obc_ros.api.figures.panels import draw_columns
from obc_ros.api.figures.presentation import present
from obc_ros.api.given import as_input, as_state, as_times, StateLike, VectorLike
from obc_ros.api.plants import as_system, System, SystemLike
from obc_ros.api.regulators import FiniteHorizonDesign, RegulatorDesign
from obc_ros.core.numerics.arrays import Array, integrate
from obc_ros.core.text.errors import describe_type, ObcError, quote, StatementError
from obc_ros.core.text.tables import Tabulated

ControlLaw = Callable[[float, Array], Any]

_RELATIVE, _ABSOLUTE = 1e-9, 1e-12   # errors of the integration of a step
_MOST_HOLDS = 100_000                # sampling periods of a simulation
_FAR = 1e12                          # times the state: it grows without bound
_SAME = 1e-9                         # of a period: times so close count as equal


@dataclass(frozen=True, eq=False, repr=False)
class Simulation(Tabulated):
    """
    A simulated path: each state and input at the times `t`.

    Attributes
    ----------
    t : ndarray, shape (N,)
        Times [s].
    system : System
        What was simulated.
    state_rows, input_rows : ndarray, shape (N, n), (N, m)
        States, and the inputs within their limits, in the order of `states` and `inputs`.

    """

    _HEADER = ('kind', 'name', 'first', 'last', 'unit')

    t: Array
    system: System
    state_rows: Array
    input_rows: Array

    @property
    def states(self) -> tuple[str, ...]:
        """Return the names of the states."""
        return self.system.states

    @property
    def inputs(self) -> tuple[str, ...]:
        """Return the names of the inputs."""
        return self.system.inputs

    @cached_property
    def x(self) -> Mapping[str, Array]:
        """Return each state, shape (N,), by its name."""
        return dict(zip(self.states, self.state_rows.T, strict=True))

    @cached_property
    def u(self) -> Mapping[str, Array]:
        """Return each input, shape (N,), by its name."""
        return dict(zip(self.inputs, self.input_rows.T, strict=True))

    def plot(self, *, ax: Any = None, show: bool | None = None) -> Any:
        """
        Draw states and inputs over time, and show the figure.

        Parameters
        ----------
        ax, show
            As of `Answer.plot`; Axes take the panels of the states, then those of the inputs.

        Returns
        -------
        matplotlib.figure.Figure
            The figure; ``savefig`` writes it.

        """
        columns = {'states': (self.states, self.state_rows),
                   'inputs': (self.inputs, self.input_rows)}
        return present(lambda into: draw_columns(
            self.t, columns, self.system.name, self.system.units, into), ax, show)

    def __repr__(self) -> str:
        """Return the system, the number of times and the duration."""
        return f'<{self._title()}>'

    __str__ = __repr__

    def _title(self) -> str:
        return (f'Simulation of {quote(self.system.name)}: {len(self.t)} times to '
                f'{self.t[-1]:g} s')

    def _rows(self) -> list[tuple[str, ...]]:
        return [(kind, name, *(f'{values[k]:.6g}' for k in (0, -1)), self.system.units.get(
            name, '')) for kind, columns in (('state', self.x), ('input', self.u))
            for name, values in columns.items()]


def simulate(system: SystemLike, law: Any, x0: StateLike, t: VectorLike) -> Simulation:
    """
    Simulate a system.

    Parameters
    ----------
    system : System, str, Path, mapping, Problem, StateSpace or NonlinearIOSystem
        The plant, as for `equilibrium`. Inputs are held within its limits.
    law : callable, RegulatorDesign, FiniteHorizonDesign, Answer, array_like or mapping
        A function of (t, x) that returns the input (m,), in order or by name; a design of `lqr`,
        `finite_horizon` or `dlqr`, the input of which is held for its period; an answer, whose
        inputs are applied without feedback; or inputs: (m,) constant, or (N, m) at the times `t`,
        linear in between; these also by name. The states and inputs of a law must be those of the
        system.
    x0 : array_like, shape (n,), or mapping
        State at the first time, in order or by name; or a point of `Answer.at`.
    t : array_like, shape (N,)
        Increasing times [s] at which states are returned.

    Returns
    -------
    Simulation
        ``t``, ``x['p']``, ``u['a']``, ``plot()``.

    Raises
    ------
    StatementError
        If an argument is invalid.
    ObcError
        If the integration fails, such as for a state that grows without bound.

    """
    plant = as_system(system)
    start = as_state(x0, plant.states, 'x0')
    wanted = 'at least two increasing times'
    times = as_times(t, wanted)
    if len(times) < 2:
        raise StatementError(f't: wanted {wanted}')
    control, edges = _read_law(plant, law, times)
    if isinstance(law, RegulatorDesign) and law.period:
        return _simulate_held(plant, law, start, times)
    low, high = plant.limits

    def limited(s: float, x: Array) -> Array:
        return np.clip(_read_input(control(s, x), plant.inputs, s), low, high)

    states = _integrate(plant, limited, start, times, edges)
    return Simulation(times, plant, states, np.array(
        [limited(s, x) for s, x in zip(times.tolist(), states, strict=True)]))


def _read_input(given: Any, inputs: tuple[str, ...], t: float) -> Array:
    """Return the input (m,) that a law returns at a time."""
    if isinstance(given, Mapping):
        return as_input(given, inputs, f'law at t = {t:g} s')
    try:
        u = np.asarray(given, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        u = np.full(1, np.nan)
    if u.shape != (len(inputs),) or np.isnan(u).any():
        raise StatementError(f'law: wanted {len(inputs)} numbers for the inputs at t = {t:g} s, '
                             f'found {describe_type(given)}')
    return u


def _read_law(plant: System, law: Any, times: Array) -> tuple[ControlLaw, Array]:
    """Return a law as a function, and the times at which it has kinks or jumps."""
    m, none = len(plant.inputs), np.zeros(0)
    if isinstance(law, Mapping):
        law = _join_inputs(law, plant.inputs)
    if isinstance(law, Answer):
        if law.inputs != plant.inputs or not law.has_path:
            raise StatementError('law: wanted an answer with a path and the inputs '
                                 f'{", ".join(plant.inputs)}')
        if times[0] < law.t[0] or times[-1] > law.t[-1]:
            raise StatementError(f't: wanted times of the answer, from {law.t[0]:g} s to '
                                 f'{law.t[-1]:g} s')
        held = law.solution.interpolation == 'zoh'
        return _interpolated(law.t, law.solution.u, held), law.t
    if callable(law):
        _check_law(law, plant, times)
        return law, none
    try:
        values = np.asarray(law, dtype=np.float64)
    except (TypeError, ValueError):
        values = np.full(1, np.nan)
    if values.shape == (m,) and np.isfinite(values).all():
        return _hold(values), none
    if values.shape == (len(times), m) and np.isfinite(values).all():
        return _interpolated(times, values, held=False), times
    raise StatementError('law: wanted a function of (t, x), a design, an answer, or inputs of '
                         f'shape ({m},) or ({len(times)}, {m}), found {describe_type(law)}')


def _check_law(law: Any, plant: System, times: Array) -> None:
    """Raise an error if a law says of which states, inputs or times it is, and these differ."""
    for kind in ('states', 'inputs'):
        names, own = getattr(law, kind, None), getattr(plant, kind)
        if isinstance(names, tuple) and len(names) != len(own):
            raise StatementError(f'law: of {len(law.states)} states and {len(law.inputs)} inputs; '
                                 f'the system has {len(plant.states)} and {len(plant.inputs)}')
        if isinstance(names, tuple) and set(names) == set(own) and names != own:
            raise StatementError(f'law: its {kind} are {", ".join(names)}, in another order than '
                                 f'{", ".join(own)} of the system')
    try:
        inspect.signature(law).bind(times[0], None)
    except TypeError:
        raise StatementError('law: wanted a function of (t, x), found one of other arguments'
                             ) from None
    except ValueError:   # it does not say what it takes
        pass
    if isinstance(law, FiniteHorizonDesign) and not 0.0 <= times[0] < times[-1] <= law.T:
        raise StatementError(f't: wanted times of the law, from 0 s to {law.T:g} s')


def _join_inputs(law: Mapping[str, Any], inputs: tuple[str, ...]) -> Any:
    """Return inputs by name side by side."""
    if set(law) != set(inputs):
        raise StatementError(f'law: wanted values of {", ".join(inputs)}, found '
                             f'{", ".join(map(str, law)) or "none"}')
    try:
        return np.stack([np.asarray(law[name], dtype=np.float64) for name in inputs], axis=-1)
    except (TypeError, ValueError):
        raise StatementError('law: wanted numbers, equally many for each input') from None


def _interpolated(t: Array, u: Array, held: bool) -> ControlLaw:
    """Return inputs between samples; at a jump, those after it."""
    def law(s: float, x: Array) -> Array:
        k = int(np.searchsorted(t, s, side='right')) - 1
        if k + 1 == len(t) or held:
            return np.asarray(u[k])
        return np.asarray(u[k] + (s - t[k]) / (t[k + 1] - t[k]) * (u[k + 1] - u[k]))
    return law


def _integrate(plant: System, law: ControlLaw, x: Array, times: Array, edges: Array) -> Array:
    """Return the states at the times, (N, n); the integration restarts at the edges."""
    found, inner = [x], edges[(edges > times[0]) & (edges < times[-1])]
    stops = np.unique(np.concatenate([times[[0, -1]], inner]))
    for begin, end in zip(stops[:-1].tolist(), stops[1:].tolist(), strict=True):
        wanted = times[(times > begin) & (times <= end)]
        until = np.append(wanted, end) if not wanted.size or wanted[-1] < end else wanted
        with np.errstate(all='ignore'):
            result = integrate.solve_ivp(
                _guard(plant, law, math.nextafter(end, begin), _FAR * (1.0 + np.abs(x).max())),
                (begin, end), x, method='LSODA', t_eval=until, rtol=_RELATIVE, atol=_ABSOLUTE)
        if not result.success:
            raise ObcError(f'the simulation fails after t = {begin:g} s: {result.message}')
        x = result.y[:, -1]
        found += list(result.y.T[:len(wanted)])
    return np.array(found)


def _guard(plant: System, law: ControlLaw, last: float, far: float) -> ControlLaw:
    """
    Return dx/dt as a function of (t, x) that raises an error if it is not finite, or x is far.

    An input that jumps at the end of the interval has its value before it, at `last`, up to there.
    """
    def rates(s: float, z: Array) -> Array:
        found = plant.evaluate(z, law(min(s, last), z))
        if not np.isfinite(found).all() or np.abs(z).max() > far:
            raise ObcError(f'the simulation ends at t = {s:g} s: the state grows without bound, '
                           'or dx/dt is not finite')
        return found
    return rates


def _simulate_held(plant: System, law: RegulatorDesign, x: Array, times: Array) -> Simulation:
    """Simulate a design in discrete time: each input is held for its period."""
    count = math.ceil((times[-1] - times[0]) / law.period - _SAME)
    if count > _MOST_HOLDS:
        raise StatementError(f't: {count} sampling periods; at most {_MOST_HOLDS} are simulated')
    begins, states, held = times[0] + law.period * np.arange(count), [x], []
    for begin, end in zip(begins, np.append(begins[1:], times[-1]), strict=True):
        held.append(np.clip(law(begin, x), *plant.limits))
        inside = times[(times > begin) & (times <= end)]
        grid = np.unique(np.concatenate([[begin, end], inside]))
        path = _integrate(plant, _hold(held[-1]), x, grid, np.zeros(0))
        states += list(path[np.searchsorted(grid, inside)])
        x = path[-1]
    held.append(np.clip(law(times[-1], x), *plant.limits))
    holds = np.floor((times - times[0]) / law.period + _SAME).astype(int)
    return Simulation(times, plant, np.array(states), np.array(held)[holds])


def _hold(u: Array) -> ControlLaw:
    return lambda s, x: u
