# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The figure of an answer: states, inputs, costates, switching function, Hamiltonian."""

from collections.abc import Sequence
from pathlib import Path
import re
from typing import Any

import casadi as ca
import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray
from obc_ros.cli.questions import Question
from obc_ros.core.errors import ObcError
from obc_ros.core.problem import Problem

Array = NDArray[np.float64]

# Okabe and Ito's colours, told apart by everyone; then the dashes change.
COLOURS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', '#56B4E9', '#000000')
DASHES = ('-', '--', ':', '-.')
STYLE = {'font.size': 9, 'axes.grid': True, 'grid.alpha': 0.3, 'axes.spines.top': False,
         'axes.spines.right': False, 'lines.linewidth': 1.5, 'legend.frameon': False,
         'axes.axisbelow': True}
THIN = {'color': 'grey', 'linewidth': 0.8, 'linestyle': (0, (4, 3)), 'zorder': 1.5}
GREEK = ('alpha', 'beta', 'gamma', 'delta', 'epsilon', 'zeta', 'eta', 'theta', 'kappa', 'lambda',
         'mu', 'nu', 'xi', 'rho', 'sigma', 'tau', 'phi', 'chi', 'psi', 'omega')
FEW = 12  # names that a legend can hold


def draw(path: Path, question: Question) -> None:
    """
    Draw the answer to a question into the file `path`.

    Raises
    ------
    ObcError
        If the file cannot be written.

    """
    assert question.problem is not None
    problem, result = question.problem, question.result
    with matplotlib.rc_context(STYLE):
        figure = _figure(problem, result)
        figure.suptitle(_title(question))
        save(figure, path)


def save(figure: Figure, path: Path) -> None:
    """
    Write a figure into a file.

    Raises
    ------
    ObcError
        If the file cannot be written.

    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=150)
    except OSError as error:
        raise ObcError(f'{path} cannot be written: {error.strerror}') from error


def switching_function(problem: Problem, x: Array, u: Array, lam: Array) -> Array:
    """
    Return dH/du = dL/du + lam' df/du, shape (N, m), at states, inputs and costates of N samples.

    Inside an input's bounds it vanishes; where it does not, the input is at the lower bound when
    it is positive and at the upper one when it is negative.
    """
    costate = ca.SX.sym('lam', problem.n)
    H = problem.L + ca.dot(costate, problem.f)
    gradient = ca.Function('gradient', [problem.x, problem.u, costate, problem.p],
                           [ca.gradient(H, problem.u)])
    N = len(x)
    values: Array = gradient.map(N)(x.T, u.T, lam.T, ca.repmat(problem.p_value, 1, N)).full().T
    return values


def _figure(problem: Problem, result: Any) -> Figure:
    path = result.trajectory
    t = np.array(path.t)
    x, u, lam = (np.array(values).reshape(len(t), -1) for values in (path.x, path.u, path.lam))
    panels = 5 if lam.size else 2
    figure = Figure(figsize=(7.5, 1.0 + 1.75 * panels), layout='constrained')
    axes = figure.subplots(panels, 1, sharex=True)
    steps = 'steps-post' if path.interpolation == 'zoh' else 'default'
    _lines(axes[0], 'states', t, x, '{}', problem.states)
    _bounds(axes[0], x, problem.x_lower, problem.x_upper)
    _lines(axes[1], 'inputs', t, u, '{}', problem.inputs, drawstyle=steps)
    _bounds(axes[1], u, problem.u_lower, problem.u_upper)
    if lam.size:
        _lines(axes[2], 'costates', t, lam, r'\lambda_{{{}}}', problem.states)
        _lines(axes[3], 'switching function', t, switching_function(problem, x, u, lam),
               r'\partial H/\partial {}', problem.inputs)
        axes[3].axhline(0.0, **THIN)
        _lines(axes[4], 'Hamiltonian', t, np.array(path.hamiltonian)[:, None], '{}', ['H'])
        _widen(axes[4], np.array(path.hamiltonian))
    for panel in axes:
        for time in path.switching_times:
            panel.axvline(time, **THIN)
    axes[-1].set_xlabel('time [s]')
    axes[-1].set_xlim(t[0], t[-1])
    figure.align_ylabels()
    return figure


def _title(question: Question) -> str:
    result = question.result
    heading = str(question.mapping.get('title') or question.name)
    verdict = ('certified' if result.success else
               f'{result.status}: {result.certificate.sentence}')
    return f'{heading}\nJ = {result.objective:.8g}, T = {result.trajectory.t[-1]:.8g} s, {verdict}'


def _lines(axes: Axes, label: str, t: Array, values: Array, template: str,
           names: Sequence[str], **style: Any) -> None:
    for index, (name, column) in enumerate(zip(names, values.T, strict=True)):
        axes.plot(t, column, label=f'${template.format(symbol(name))}$',
                  color=COLOURS[index % len(COLOURS)],
                  linestyle=DASHES[index // len(COLOURS) % len(DASHES)], **style)
    axes.set_ylabel(label)
    if len(names) <= FEW:
        axes.legend(loc='center left', bbox_to_anchor=(1.0, 0.5), ncols=1 + (len(names) > 6))


def symbol(name: str) -> str:
    """Return a name as mathematics: theta as the letter, x1 with an index."""
    word, index = re.fullmatch(r'(.*?)_?(\d*)', name).groups()
    letter = (f'\\{word}' if word in GREEK else word if len(word) == 1 else
              rf'\mathrm{{{word}}}'.replace('_', r'\_'))
    return f'{letter}_{{{index}}}' if index else letter


def _bounds(axes: Axes, values: Array, lower: Array, upper: Array) -> None:
    """Draw the bounds that the values come near to."""
    for bound in np.unique(np.concatenate([lower, upper])):
        low, high = values.min(), values.max()
        if abs(bound - np.clip(bound, low, high)) <= 0.1 * (high - low):
            axes.axhline(bound, **THIN)


def _widen(axes: Axes, values: Array) -> None:
    """Keep a constant from being drawn as the noise of its last digits."""
    middle, half = (values.max() + values.min()) / 2, (values.max() - values.min()) / 2
    half = max(half * 1.1, 0.05 * max(1.0, abs(middle)))
    axes.set_ylim(middle - half, middle + half)
