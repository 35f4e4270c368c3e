# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The figure of a regulator: step and frequency responses, root locus over the input weight."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import control
import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.files import save_figure
from obc_ros.api.figures.panels import FEW, set_title
from obc_ros.api.figures.style import get_line, new_figure, STYLE, THIN, typeset_symbol
from obc_ros.cli.ask.regulator_requests import Case
from obc_ros.core.lqr.design.report import read_matrices
from obc_ros.core.lqr.held_loop import discretize_plant, HeldLoop
from obc_ros.core.lqr.held_margins import HeldTransfer
from obc_ros.core.lqr.lqr import lqr
from obc_ros.core.lqr.sampled import sampled_lqr
from obc_ros.core.lqr.weights import Weights
from obc_ros.core.numerics.arrays import Array, Complex
from obc_ros.core.text.errors import RefusedDesignError

SAMPLES = 400
SHOWN = 200                            # samples below which a step has markers
SETTLING = 6.0                         # time constants of the slowest pole in a step
WEIGHTS = np.logspace(-3.0, 3.0, 121)  # factors of Qu in the root locus


def draw_regulator(path: Path, case: Case, formats: Sequence[str] = ('png',)) -> None:
    """Draw the design of a case into the files `path` with the endings of the formats."""
    with matplotlib.rc_context(STYLE):
        save_figure(draw_figure(case), path, formats)


def draw_figure(case: Case) -> Figure:
    """Return the figure of a case with a design: step, magnitude, root locus, phase."""
    A, B, Qx, Qu, K, _, poles = read_matrices(case.design)
    design, given = case.design, case.given or {}
    cross = np.reshape(given['cross'], B.shape) if 'cross' in given else None
    loop = LinearLoop(A, B, K, poles, design.sample_time, design.delay)
    drawn: Figure = new_figure(7.6)
    step, magnitude, locus, phase = drawn.subplots(2, 2).ravel()
    set_title(drawn, case.message if case.message.startswith(f'{case.name}:')
              else f'{case.name}: {case.message}')
    _steps(step, loop, design.state_names)
    _frequency(magnitude, phase, loop, design.input_names)
    _locus(locus, loop, Weights(Qx, Qu, cross, given.get('stability', 0.0)))
    return drawn


@dataclass(frozen=True, eq=False)
class LinearLoop:
    """A plant dx/dt = A x + B u, its gain, and the closed-loop poles in the s plane."""

    A: Array
    B: Array
    K: Array
    poles: Complex
    period: float
    delay: float

    @property
    def plant(self) -> tuple[Array, Array]:
        """Return A and B of the plant; if it is sampled, those with a zero-order hold."""
        return discretize_plant(self.A, self.B, self.period) if self.period else (self.A, self.B)

    def open(self, j: int, w: Array) -> Complex:
        """Return the gain of the loop of input j, the others closed, at frequencies [rad/s]."""
        A, B, K = self.A, self.B, self.K
        if self.period:
            T = HeldTransfer(HeldLoop(A, B, np.zeros((0, len(A))), K, self.period, self.delay,
                                      self.period)).loop(w, j)
            return np.asarray(T / (1.0 - T))
        others = [k for k in range(len(K)) if k != j]
        opened = control.ss(A - B[:, others] @ K[others], B[:, [j]], K[[j]], 0)
        return np.asarray(control.frequency_response(opened, w).frdata[0, 0])


def find_held_states(A: Array, B: Array) -> Iterator[int]:
    """Yield the states whose set point a constant input can hold: A e_i in the range of B."""
    for i, column in enumerate(A.T):
        left = column + B @ np.linalg.lstsq(B, -column, rcond=None)[0]
        if np.abs(left).max() <= 1e-9 * max(1.0, np.abs(column).max()):
            yield i


def _steps(axes: Axes, loop: LinearLoop, names: list[str]) -> None:
    """Draw x_i after a unit step of its set point, with u = ue - K (x - xe)."""
    axes.set_title('unit step of each set point')
    A, B = loop.plant
    length, M = SETTLING / -loop.poles.real.max(), A - B @ loop.K
    count = max(2, min(10_000, round(length / loop.period))) if loop.period else SAMPLES
    dt = loop.period or length / SAMPLES
    t, none = dt * np.arange(count + 1), np.zeros((len(A), 1))
    closed = control.ss(M, none, np.eye(len(A)), none, loop.period)
    states = list(find_held_states(loop.A, loop.B))
    for index, i in enumerate(states):
        free = control.initial_response(closed, t, np.eye(len(A))[i], squeeze=False).outputs[i]
        axes.plot(loop.delay + t, 1.0 - free,
                  label=f'${typeset_symbol(names[i])}$',
                  marker='.' if count < SHOWN else '', **get_line(index))
    axes.axhline(1.0, **THIN)
    axes.set_xlabel('time [s]')
    axes.set_ylabel('state')
    axes.set_xlim(0.0, loop.delay + dt * count)
    _legend(axes, len(states))


def _frequency(magnitude: Axes, phase: Axes, loop: LinearLoop, names: list[str]) -> None:
    """Draw the loop transfer function of each input, with the loops of the others closed."""
    size = np.abs(loop.poles)
    top = np.pi / loop.period if loop.period else size.max() * 1e2
    w = np.geomspace(min(size.min() * 1e-2, top * 1e-2), top, SAMPLES)
    for j, name in enumerate(names):
        gain = loop.open(j, w)
        style = get_line(j) | {'label': f'${typeset_symbol(name)}$'}
        magnitude.loglog(w, np.abs(gain), **style)
        angle = np.rad2deg(np.unwrap(np.angle(gain)))
        # an LQR loop has a phase between -180 and 0 degrees at its last gain crossover
        crossing = angle[np.flatnonzero(np.abs(gain) >= 1.0)[-1]] if (
            np.abs(gain) >= 1.0).any() else angle[-1]
        phase.semilogx(w, angle - 360.0 * np.round((crossing + 90.0) / 360.0), **style)
    magnitude.axhline(1.0, **THIN)
    phase.axhline(-180.0, **THIN)
    magnitude.set_title('loop of each input')
    magnitude.set_ylabel('magnitude')
    phase.set_ylabel('phase [deg]')
    phase.set_xlabel('frequency [rad/s]')
    magnitude.sharex(phase)
    _legend(magnitude, len(names))


def _locus(axes: Axes, loop: LinearLoop, weights: Weights) -> None:
    """Draw the closed-loop poles over the input weight rho Qu."""
    found = [(rho, pole) for rho in WEIGHTS
             for pole in _poles(loop, replace(weights, Qu=rho * weights.Qu))]
    rho = np.log10([rho for rho, _ in found])
    s = np.array([pole for _, pole in found])
    points = axes.scatter(s.real, s.imag, c=rho, s=9, cmap='viridis', rasterized=True)
    axes.plot(loop.poles.real, loop.poles.imag, 'x', color='black', label=r'$\rho = 1$')
    axes.axvline(0.0, **THIN)
    reach = 2.0 * np.abs(loop.poles).max()
    height = 1.2 * np.abs(s.imag[s.real > -reach]).max(initial=0.1 * reach)
    axes.set_xlim(-reach, 0.1 * reach)
    axes.set_ylim(-min(reach, height), min(reach, height))
    axes.set_title(r'poles for the input weight $\rho Q_u$')
    axes.set_xlabel('real part [rad/s]')
    axes.set_ylabel('imaginary part [rad/s]')
    axes.legend(loc='upper left')
    # below the axes, so that both axes of the left column have the same width
    axes.figure.colorbar(points, ax=axes, location='bottom', aspect=40, label=r'$\log_{10} \rho$')


def _poles(loop: LinearLoop, weights: Weights) -> Complex:
    """Return the closed-loop poles in the s plane; of a sampled loop, log(z) / period."""
    try:
        if not loop.period:
            return lqr(loop.A, loop.B, weights.Qx, weights.Qu, cross=weights.cross,
                       stability=weights.stability).E
        z = sampled_lqr(loop.A, loop.B, weights, loop.period).E
    except RefusedDesignError:  # no design is verified at so extreme a weight
        return np.zeros(0, dtype=complex)
    return np.asarray(np.log(z[np.abs(z) > 1e-12]) / loop.period, dtype=complex)


def _legend(axes: Axes, count: int) -> None:
    if 0 < count <= FEW:
        axes.legend()
