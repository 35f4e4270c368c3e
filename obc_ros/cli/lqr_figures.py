# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The figure of a regulator: steps, frequency responses, root locus against the input weight."""

from collections.abc import Iterator
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray
from obc_ros.cli.cases import Case
from obc_ros.cli.figures import COLOURS, FEW, save, STYLE, symbol, THIN
from obc_ros.core.errors import RefusedDesignError
from obc_ros.core.lqr import lqr
from scipy.linalg import expm

Array = NDArray[np.float64]

SAMPLES = 400
SETTLING = 6.0                         # time constants of the slowest pole that a step shows
WEIGHTS = np.logspace(-3.0, 3.0, 121)  # factors of Qu in the root locus


def draw(path: Path, case: Case) -> None:
    """
    Draw the design of a case into the file `path`.

    Raises
    ------
    ObcError
        If the file cannot be written.

    """
    A, B, Qx, Qu, K, _, poles = case.matrices
    design = case.design
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 7.0), layout='constrained')
        step, magnitude, locus, phase = figure.subplots(2, 2).ravel()
        figure.suptitle(f'{case.name}: {case.message}')
        _steps(step, A, B, K, poles, design.state_names)
        _frequency(magnitude, phase, A, B, K, poles, design.input_names)
        _locus(locus, A, B, Qx, Qu, poles)
        save(figure, path)


def held(A: Array, B: Array) -> Iterator[int]:
    """Yield the states whose set points a constant input holds: A e_i is in the range of B."""
    for i, column in enumerate(A.T):
        left = column + B @ np.linalg.lstsq(B, -column, rcond=None)[0]
        if np.abs(left).max() <= 1e-9 * max(1.0, np.abs(column).max()):
            yield i


def _steps(axes: Axes, A: Array, B: Array, K: Array, poles: Array, names: list[str]) -> None:
    """Draw x_i after a unit step of its set point, u = ue - K (x - xe)."""
    axes.set_title('unit step of each set point that an input can hold')
    t = np.linspace(0.0, SETTLING / -poles.real.max(), SAMPLES)
    transition = expm((A - B @ K) * t[1])
    powers = [np.eye(len(A))]
    for _ in t[1:]:
        powers.append(transition @ powers[-1])
    states = list(held(A, B))
    for index, i in enumerate(states):
        axes.plot(t, 1.0 - np.array(powers)[:, i, i], label=f'${symbol(names[i])}$',
                  color=COLOURS[index % len(COLOURS)])
    axes.axhline(1.0, **THIN)
    axes.set_xlabel('time [s]')
    axes.set_xlim(t[0], t[-1])
    _legend(axes, len(states))


def _frequency(magnitude: Axes, phase: Axes, A: Array, B: Array, K: Array, poles: Array,
               names: list[str]) -> None:
    """Draw the loop of each input, opened at the plant with the other loops closed."""
    size = np.abs(poles)
    w = np.logspace(np.log10(size.min()) - 2.0, np.log10(size.max()) + 2.0, SAMPLES)
    for j, name in enumerate(names):
        others = [k for k in range(len(names)) if k != j]
        opened = 1j * w[:, None, None] * np.eye(len(A)) - A + B[:, others] @ K[others]
        loop = (K[j] @ np.linalg.solve(opened, B[:, [j]]))[:, 0]
        style = {'color': COLOURS[j % len(COLOURS)], 'label': f'${symbol(name)}$'}
        magnitude.loglog(w, np.abs(loop), **style)
        angle = np.rad2deg(np.unwrap(np.angle(loop)))
        # a regulator's loop ends at -90 degrees
        phase.semilogx(w, angle - 360.0 * np.round((angle[-1] + 90.0) / 360.0), **style)
    magnitude.axhline(1.0, **THIN)
    phase.axhline(-180.0, **THIN)
    magnitude.set_title('loop of each input, the others closed')
    magnitude.set_ylabel('magnitude')
    phase.set_ylabel('phase [deg]')
    phase.set_xlabel('frequency [rad/s]')
    magnitude.sharex(phase)
    _legend(magnitude, len(names))


def _locus(axes: Axes, A: Array, B: Array, Qx: Array, Qu: Array, poles: Array) -> None:
    """Draw the closed-loop poles for the input weight rho Qu."""
    found = [(rho, pole) for rho in WEIGHTS for pole in _poles(A, B, Qx, rho * Qu)]
    rho = np.log10([rho for rho, _ in found])
    s = np.array([pole for _, pole in found])
    points = axes.scatter(s.real, s.imag, c=rho, s=6, cmap='viridis')
    axes.plot(poles.real, poles.imag, 'x', color='black', label=r'$\rho = 1$')
    axes.axvline(0.0, **THIN)
    reach = 2.0 * np.abs(poles).max()
    height = 1.2 * np.abs(s.imag[s.real > -reach]).max(initial=0.1 * reach)
    axes.set_xlim(-reach, 0.1 * reach)
    axes.set_ylim(-min(reach, height), min(reach, height))
    axes.set_title(r'poles for the input weight $\rho Q_u$')
    axes.set_xlabel('real part [rad/s]')
    axes.set_ylabel('imaginary part [rad/s]')
    axes.legend(loc='upper left')
    axes.figure.colorbar(points, ax=axes, label=r'$\log_{10} \rho$')


def _poles(A: Array, B: Array, Qx: Array, Qu: Array) -> Array:
    try:
        return lqr(A, B, Qx, Qu).E
    except RefusedDesignError:  # so extreme a weight has no design that can be proved
        return np.zeros(0)


def _legend(axes: Axes, count: int) -> None:
    if 0 < count <= FEW:
        axes.legend()
