# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the page shows of a loop: frames, and the names and units of its signals."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
import math
from statistics import NormalDist
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from obc_ros.core.closed_loop.modes import Mode
from obc_ros.core.lqr.design.report import describe_plainly
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems import registry
from obc_ros.core.systems.equilibrium import may_move_on
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import Estimate, LqrDesign, Trajectory
from obc_ros.view.disturbances import Acting

COVERED = 0.95   # share of the true states inside an ellipse, or inside a band of one state
AT_REST = 1e-6   # largest rate of a set point that does not move
WORDS = 200      # characters of a mode and of its reason
STOPPED = Mode.STOPPED.name


@dataclass(frozen=True)
class Named:
    """
    Name, unit and limits of a state or an input.

    :ivar angle: whether it is one modulo 2 pi; None: not known.
    :ivar moves: whether it moves at the set point, too.
    """

    name: str
    unit: str = ''
    angle: bool | None = None
    lower: float = -math.inf
    upper: float = math.inf
    moves: bool = False


@dataclass(frozen=True)
class Plant:
    """The signals of a plant, and the plane in which it moves: 'horizontal', 'vertical' or ''."""

    system: str
    states: tuple[Named, ...]
    inputs: tuple[Named, ...]
    plane: str = ''

    @property
    def state_names(self) -> tuple[str, ...]:
        """Return the names of the states."""
        return tuple(each.name for each in self.states)

    @property
    def units(self) -> dict[str, str]:
        """Return the units by the names of states and inputs."""
        return {each.name: each.unit for each in (*self.states, *self.inputs)}


@dataclass(frozen=True)
class ShownMode:
    """The mode of a controller, such as SET_POINT, and its reason; empty: not known."""

    name: str = ''
    reason: str = ''

    @property
    def sentence(self) -> str:
        """Return the mode in words."""
        words = self.name.replace('_', ' ')
        return ': '.join(filter(None, (words if self.name == STOPPED else words.lower(),
                                       self.reason))) or 'mode not known'


def read_mode(status: DiagnosticStatus) -> ShownMode:
    """Return the mode in the status of the commands of a controller."""
    values = {each.key: each.value[:WORDS] for each in status.values}
    return ShownMode(values.get('mode', ''), values.get('mode reason', ''))


@dataclass(frozen=True)
class Frame:
    """
    A loop at one instant.

    :ivar time: stamp of the state [s].
    :ivar x, u: last state and last command; empty: none yet.
    :ivar goal: set point of the design in use; empty: none yet.
    :ivar cost: cost-to-go of the design in use at this state; NaN: no design yet.
    :ivar latency: from the last answered state to its command [s], as published; NaN: unknown.
    :ivar prediction: rows of time [s], states and inputs of the plan of mpc_node; empty: none.
    :ivar uncertainty: of the state; None: no estimator is known.
    :ivar acting: the disturbances of the simulated plant.
    """

    time: float
    x: Sequence[float]
    u: Sequence[float] = ()
    goal: Sequence[float] = ()
    cost: float = math.nan
    latency: float = math.nan
    prediction: Sequence[Sequence[float | None]] = ()
    uncertainty: 'Uncertainty | None' = None
    acting: Acting = Acting()

    def pack(self, number: int) -> dict[str, Any]:
        """Return the frame as JSON values, without the prediction."""
        known = self.uncertainty
        return {'n': number, 't': self.time, 'x': keep_finite(self.x), 'u': keep_finite(self.u),
                'goal': keep_finite(self.goal), 'cost': keep_finite([self.cost])[0],
                'latency': keep_finite([1e3 * self.latency])[0],
                'band': list(known.band) if known else [],
                'ellipse': list(known.ellipse) if known else [],
                'acting': list(self.acting.words), 'gust': self.acting.is_gust,
                'push': list(self.acting.push)}


@dataclass(frozen=True)
class Uncertainty:
    """
    Where the true state is, with a probability of 95 %.

    :ivar band: half the width of the band of each state (n,), in its unit.
    :ivar ellipse: half axes [m] of the ellipse of the position in the plane, and the angle [rad]
        of the first one; empty: no plane.
    """

    band: Sequence[float]
    ellipse: Sequence[float] = ()


@dataclass(frozen=True, eq=False)
class FollowedPath:
    """A reference of lqr_node or a plan of mpc_node; `begin` [s] is in the time of the frames."""

    begin: float
    path: Trajectory

    def find_end(self, plant: Plant) -> list[float]:
        """Return the last state (n,), in the order of a plant; empty: not known."""
        end = (self.pack(plant, 2) or [[]])[-1][1:]
        return [each for each in end if each is not None] if None not in end else []

    def pack(self, plant: Plant, most: int, inputs: bool = False) -> list[list[float | None]]:
        """Return at most `most` rows of time, states and, if asked, inputs of a plant."""
        path, t = self.path, np.asarray(self.path.t)
        if not len(t):
            return []
        groups = [(path.x, path.state_names, plant.state_names)]
        if inputs:
            groups.append((path.u, path.input_names, tuple(each.name for each in plant.inputs)))
        keep = np.unique(np.linspace(0, len(t) - 1, most).astype(int))
        columns = [self.begin + t[keep, None]]
        for values, given, wanted in groups:
            names = list(map(str, given))
            if sorted(names) != sorted(wanted) or len(values) != len(t) * len(names):
                return []
            order = np.array([names.index(name) for name in wanted], dtype=int)
            columns.append(np.reshape(values, (len(t), -1))[np.ix_(keep, order)])
        return [keep_finite(row) for row in np.hstack(columns)]


def keep_finite(values: Sequence[float]) -> list[float | None]:
    """Return numbers as JSON values; those that are not finite become None."""
    return [float(each) if math.isfinite(each) else None for each in values]


def fits_names(design: LqrDesign) -> bool:
    """Return whether the arrays of a design have the sizes that its names require."""
    n, m, poles = len(design.state_names), len(design.input_names), len(design.poles_real)
    sizes = {'xe': n, 'ue': m, 'a': n * n, 'b': n * m, 'k': n * m, 'p': n * n,
             'poles_imag': poles, 'damping': poles, 'rise_time': n, 'phase_margin': m,
             'disk_margin': m, 'delay_margin': m, 'peak_input': m}
    return n > 0 and m > 0 and poles >= n and all(   # integrals and a delay add poles
        len(getattr(design, name)) == size for name, size in sizes.items())


def describe_design(design: LqrDesign) -> str:
    """Return in plain words how the loop of a design behaves."""
    return describe_plainly(np.array(design.poles_real) + 1j * np.array(design.poles_imag),
                            *(np.asarray(each) for each in (
                                design.damping, design.phase_margin, design.delay_margin)))


def describe_plant(design: LqrDesign) -> Plant:
    """Return the signals of the plant of a design, with units and limits of a registered one."""
    names = tuple(map(str, design.state_names)), tuple(map(str, design.input_names))
    bare = Plant(design.system, tuple(map(Named, names[0])), tuple(map(Named, names[1])))
    try:
        system = registry.get_registered(design.system)
    except ObcError:
        return bare
    if (system.state_names, system.input_names) != names:
        return bare
    drift = _find_drift(design)
    moving = np.abs(drift) > AT_REST if len(drift) == system.n else np.zeros(system.n, bool)
    return Plant(
        system.name, tuple(Named(each.name, each.unit, each.angle, moves=bool(moves))
                           for each, moves in zip(system.states, moving, strict=True)),
        tuple(Named(each.name, each.unit, False, each.lower, each.upper)
              for each in system.inputs), system.plane)


def describe_uncertainty(plant: Plant, estimate: Estimate) -> Uncertainty | None:
    """Return where the true state is; None if the covariance is not one of the plant's states."""
    names, n = plant.state_names, len(plant.states)
    if not n or len(estimate.covariance) != n * n:
        return None
    P = np.reshape(estimate.covariance, (n, n))
    if not np.isfinite(P).all():
        return None
    P = 0.5 * P + 0.5 * P.T   # no overflow
    width = NormalDist().inv_cdf(0.5 + COVERED / 2.0)
    band = width * np.sqrt(np.maximum(P.diagonal(), 0.0))
    if not plant.plane or not {'px', 'py'} <= set(names):
        return Uncertainty(band.tolist())
    places = [names.index('px'), names.index('py')]
    squares, axes = np.linalg.eigh(P[np.ix_(places, places)])
    # The square of the distance has a chi-square distribution with two degrees of freedom.
    halves = math.sqrt(-2.0 * math.log(1.0 - COVERED)) * np.sqrt(np.maximum(squares, 0.0))
    if not np.isfinite(halves).all():
        return Uncertainty(band.tolist())
    return Uncertainty(band.tolist(), [*halves.tolist(), math.atan2(axes[1, 0], axes[0, 0])])


class SetPoint:
    """
    The set point of a design, seen from a state.

    One that moves, such as that of the vehicle, is drawn beside the plant: where it is now only
    the regulator knows, so that there is no cost-to-go.
    """

    def __init__(self, design: LqrDesign, at: Sequence[float] = ()) -> None:
        """Take the set point of a design, or another state `at` (n,) that its gain holds."""
        if at:
            design = copy(design)
            design.xe = list(at)
        self._design, self._xe = design, np.asarray(design.xe, dtype=float)
        self._drift = _find_drift(design)

    def locate(self, x: Sequence[float]) -> Sequence[float]:
        """Return the set point; of one that moves, the point of its course nearest to x."""
        if not self._drift.any() or len(x) != len(self._xe):
            return list(self._xe)
        along = self._drift @ (np.asarray(x) - self._xe) / (self._drift @ self._drift)
        return list(self._xe + along * self._drift)

    def measure_cost(self, x: Sequence[float]) -> float:
        """Return the cost-to-go; NaN for a set point that moves."""
        return math.nan if self._drift.any() else measure_cost(self._design, x)


def _find_drift(design: LqrDesign) -> Array:
    """
    Return dx/dt at the set point of a registered system; zeros: at rest, or not known.

    The parameters of the node are not known here. A set point moves only in states on which f does
    not depend: rates of others are due to other parameters.
    """
    xe, ue = np.asarray(design.xe, dtype=float), np.asarray(design.ue, dtype=float)
    try:
        system = registry.get_registered(design.system)
    except ObcError:
        return np.zeros(len(xe))
    if (len(xe), len(ue)) != (system.n, system.m):
        return np.zeros(len(xe))
    drift = np.where(may_move_on(system), system.f(xe, ue), 0.0)
    moves = np.isfinite(drift).all() and np.abs(drift).max() > AT_REST
    return drift if moves else np.zeros(len(xe))


def measure_cost(design: LqrDesign, x: Sequence[float]) -> float:
    """Return the cost-to-go (x - xe)' P (x - xe) of a design."""
    if len(x) != len(design.xe):
        return math.nan
    error = np.asarray(x) - np.asarray(design.xe)
    with np.errstate(over='ignore', invalid='ignore'):   # the page leaves out what is not finite
        return float(error @ np.reshape(design.p, (len(x), len(x))) @ error)
