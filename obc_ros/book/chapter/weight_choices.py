# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Section 2.5: three ways of choosing weights, for one aircraft."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import get_line, THIN
from obc_ros.book.entries.aircraft import GOAL, linearize_at_hover
from obc_ros.book.entry import ComparedRow, create_panels, EntryResult, GalleryEntry, label_axes
from obc_ros.book.loop import Run
from obc_ros.book.references import match_poles, run_sampled_loop
from obc_ros.book.runner import AnsweredRegulator, Desk, read_design
from obc_ros.core.numerics.arrays import Array
from scipy.linalg import solve_continuous_are

STEP, DURATION, SHOWN = 0.02, 8.0, 3.0  # [s]
X_MAX = [0.5, 0.5, pi / 12, 1.0, 1.0, pi / 2]  # [m], [m], [rad], [m/s], [m/s], [rad/s]
U_MAX = [2.0, 10.0]  # [N]
RHO = 0.1  # of the output weight
H = np.eye(2, 6)  # z = (x, y)


@dataclass(frozen=True, eq=False)
class WeightChoice:
    """A way of choosing weights: parameters of `lqr_node`, and the matrices Qx and Qu."""

    parameters: Mapping[str, Any]
    Qx: Array
    Qu: Array

    @property
    def gain(self) -> Array:
        """Return K, without the nodes."""
        A, B = linearize_at_hover()
        right: Array = np.linalg.solve(self.Qu, B.T @ solve_continuous_are(A, B, self.Qx, self.Qu))
        return right

    @property
    def poles(self) -> Any:
        """Return the poles of A - B K [rad/s]."""
        A, B = linearize_at_hover()
        return np.linalg.eigvals(A - B @ self.gain)


CHOICES = {
    'diagonal': WeightChoice({'Qx': [1.0] * 6, 'Qu': [1.0] * 2}, np.eye(6), np.eye(2)),
    'Bryson': WeightChoice({'weights': 'bryson', 'x_max': X_MAX, 'u_max': U_MAX},
                           np.diag(np.power(X_MAX, -2)), np.diag(np.power(U_MAX, -2))),
    'output': WeightChoice({'weights': 'output', 'H': H.ravel(), 'rho': RHO},
                           H.T @ H, RHO * np.eye(2))}


LEADS = {
    'diagonal': 'Diagonal: one unit of each state costs as much as 1 N, whatever the units mean.',
    'Bryson': 'Bryson and Ho: acceptable deviations, in units that an engineer can give.',
    'output': 'Output: only $x$ and $y$ cost; tilt and velocities are free.'}


def section_2_5(desk: Desk) -> EntryResult:
    """Compare gains, poles, peak inputs and steps of three choices with references."""
    A, B = linearize_at_hover()
    designs = dict(zip(CHOICES, desk.design_all(
        [{'system': 'aircraft', **each.parameters} for each in CHOICES.values()],
        show=len(CHOICES)), strict=True))
    plant = {'system': 'linear', 'system_parameters.A': A, 'system_parameters.B': B}
    runs: dict[str, Run] = {}
    used: dict[str, AnsweredRegulator] = {}
    with desk.loop('weights', {**plant, 'x0': [0.0] * 6, 'publish_rate': 1 / STEP},
                   {**plant, 'setpoint': GOAL, **CHOICES['diagonal'].parameters}) as loop:
        for name, choice in CHOICES.items():
            if runs:
                loop.set(**choice.parameters)
            runs[name], used[name] = loop.run(DURATION), read_design(loop.design)
    rows = []
    for name, choice in CHOICES.items():
        K, design, run = choice.gain, designs[name], runs[name]
        x, u = run_sampled_loop(A, B, K, -GOAL, STEP, len(run.t) - 1)
        poles = match_poles(design.E, choice.poles)
        Q = np.diag(choice.Qx)[:2] / np.diag(choice.Qu)
        rows += [
            ComparedRow(f'{name}: $Q_x$ in use', np.reshape(used[name].message.qx, (6, 6)),
                        choice.Qx, 'the rule'),
            ComparedRow(f'{name}: $K$', design.K, K, 'SciPy, `solve_continuous_are`'),
            ComparedRow(f'{name}: poles, real parts [rad/s]', poles.real, choice.poles.real,
                        'eigenvalues of $A - BK$'),
            ComparedRow(f'{name}: poles, imaginary parts [rad/s]', poles.imag, choice.poles.imag,
                        'eigenvalues of $A - BK$'),
            ComparedRow(f'{name}: peak inputs $u_1$, $u_2$ of the step [N]',
                        np.abs(run.u).max(axis=0), np.sqrt(Q), '$√(q_i/ρ_i)$ for a step of 1 m'),
            ComparedRow(f'{name}: $x(t)$', run.x, GOAL + x, 'recursion, SciPy gain'),
            ComparedRow(f'{name}: $u(t)$', run.u, u, 'recursion, SciPy gain')]
    return EntryResult(rows, _draw_choices(runs, designs), (
        *(_describe(name, designs[name], runs[name]) for name in CHOICES),
        'Row and column of a position in $PA + A^T P$ are 0 at its place, so that (2.9) gives '
        '$ρ_j K_{ji}^2 = q_i$: the position gains are $√(q_i/ρ_j)$. With the rule of Bryson this '
        'is the ratio of the acceptable deviations. The second '
        'step of the rule, the compromise between response time, damping and effort, is trial '
        'and error: `ros2 param set` while the loop runs.'))


def _describe(name: str, design: AnsweredRegulator, run: Run) -> str:
    """Return gains, poles, peaks and the step of a choice as a sentence."""
    rise, overshoot = design.message.rise_time, design.message.overshoot
    gains = '; '.join(
        f'$u_{j + 1}$: ' + ', '.join(f'{gain:.2f}' for gain in row[row != 0].round(2) if gain)
        for j, row in enumerate(design.K))
    peaks = np.abs(run.u).max(axis=0)
    return (
        f'{LEADS[name]} Gains of the states that an input uses: {gains}. Slowest pole at '
        f'{design.E.real.max():.2f} rad/s. The step takes {rise[0]:.1f} s in $x$ and '
        f'{rise[1]:.1f} s in $y$ (10 % to 90 %), with overshoots of {100 * overshoot[0]:.0f} % '
        f'and {100 * overshoot[1]:.0f} %, a tilt of {np.degrees(np.abs(run.x[:, 2]).max()):.0f} '
        f'degrees and peak inputs of {peaks[0]:.1f} N and {peaks[1]:.1f} N.')


def _draw_choices(runs: Mapping[str, Run], designs: Mapping[str, AnsweredRegulator]) -> Figure:
    figure, ((place, height), (tilt, plane)) = create_panels(2, 2)
    for index, ((name, run), marker) in enumerate(zip(runs.items(), 'osD', strict=True)):
        line = get_line(index)
        for axes, values in ((place, run.x[:, 0]), (height, run.x[:, 1]),
                             (tilt, np.degrees(run.x[:, 2]))):
            axes.plot(run.t, values, label=name, **line)
        E = designs[name].E
        plane.plot(E.real, E.imag, marker, color=line['color'], fillstyle='none', label=name)
    for axes, text in ((place, 'x'), (height, 'y')):
        axes.axhline(1, **THIN)
        label_axes(axes, f'step of 1 m: ${text}$', 'time $t$ [s]', f'${text}$ [m]')
        axes.set(xlim=(0, DURATION), ylim=(-0.05, 1.15))
    for axes in (tilt, plane):
        axes.axhline(0, **THIN)
    plane.axvline(0, color='black', linewidth=1)
    place.legend(loc='lower right')
    label_axes(tilt, 'tilt', 'time $t$ [s]', r'$\theta$ [deg]')
    label_axes(plane, 'poles of $A - BK$', 'real part [rad/s]', 'imaginary part [rad/s]',
               legend='upper left')
    plane.set_xlim(-11.0, 0.4)  # leaves room for the legend
    tilt.set_xlim(0, SHOWN)
    return figure


SECTION_2_5 = GalleryEntry(
    'section-2.5', 'Three ways of choosing weights', 'Section 2.5', (
        'The set point of the aircraft of Example 2.5 steps by 1 m in $x$ and in $y$. The '
        'weights are chosen in three ways: diagonal, $Q_x = I$, $Q_u = I$; by the rule of Bryson '
        'and Ho, $q_i = 1/x_{i,max}^2$, $ρ_j = 1/u_{j,max}^2$ for acceptable deviations of '
        '0.5 m, 0.5 m, 15 degrees, 1 m/s, 1 m/s, 90 degrees/s and 2 N, 10 N; for an output, '
        f'$Q_x = H^T H$, $Q_u = ρI$ with $z = Hx = (x, y)$ and $ρ = {RHO:g}$.',),
    section_2_5)
