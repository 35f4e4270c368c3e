# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What a design is, and what a change from one to another does: numbers and a sentence."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.lqr.design.design import Design
from obc_ros.core.lqr.margins import compute_margins, Figures
from obc_ros.core.numerics.arrays import Array


@dataclass(frozen=True)
class Change:
    """
    The step from one design to the next.

    Attributes
    ----------
    largest : float
        Largest change of an entry of K; 0: the first design.
    jump : tuple of float
        (m,) change of each input at the present error; empty: no state yet.
    sentence : str
        Both in words; empty for the first design.

    """

    largest: float = 0.0
    jump: tuple[float, ...] = ()
    sentence: str = ''


def change(before: Design, after: Design, jump: Sequence[float] | None) -> Change:
    """
    Return what replacing a design does.

    Parameters
    ----------
    before, after : Design
        Of the same system.
    jump : sequence of float, optional
        (m,) change of each input at the present error.

    """
    system = after.plant.system
    step = after.K - before.K
    i, j = divmod(int(np.abs(step).argmax()), step.shape[1])
    largest = float(abs(step[i, j]))
    words = 'K stays' if not largest else (
        f'largest change of K: {before.K[i, j]:.4g} to {after.K[i, j]:.4g} '
        f'({system.states[j].name} to {system.inputs[i].name})')
    if jump:
        i, most = max(enumerate(jump), key=lambda each: abs(each[1]))
        words += (f'; at the present error {system.inputs[i].name} jumps by {most:.4g} '
                  f'{system.inputs[i].unit}').rstrip()
    return Change(largest, tuple(jump or ()), words)


def report_fields(design: Design, made: Change, error: Sequence[float] | None) -> dict[str, Any]:
    """
    Return the fields of the message LqrDesign that say what a design is.

    Parameters
    ----------
    design : Design
        The design.
    made : Change
        How it came about.
    error : sequence of float, optional
        The present x - xe (n,).

    """
    plant, found = design.plant, design.lqr
    n = plant.system.n
    P = found.P[:n, :n]
    seen = compute_margins(found.A, found.B, found.K, found.period, n)
    return {
        'system': plant.system.name,
        'state_names': list(plant.system.state_names),
        'input_names': list(plant.system.input_names),
        'xe': plant.equilibrium.x, 'ue': plant.equilibrium.u,
        'a': plant.A, 'b': plant.B, 'qx': design.weights.Qx, 'qu': design.weights.Qu,
        'k': design.K, 'p': P,
        'poles_real': seen.poles.real, 'poles_imag': seen.poles.imag, 'damping': seen.damping,
        'residual': float(found.residual), 'design': 'sampled' if found.period else 'continuous',
        'sample_time': float(found.period), 'delay': design.sampling.delay,
        **{name: getattr(seen, name) for name in (
            'gain_margin', 'gain_reduction_margin', 'phase_margin', 'disk_margin', 'bandwidth',
            'rise_time', 'overshoot', 'settling_time', 'peak_input')},
        'sensitivity_peak': float(seen.sensitivity_peak),
        'cost_to_go': 0.0 if error is None else design.cost_to_go(error),
        'max_gain_change': made.largest,
        'input_jump': max(map(abs, made.jump), default=0.0),
        'sentence': '; '.join(filter(None, (_sentence(design, seen), made.sentence))),
    }


class Matrices(NamedTuple):
    """What a message LqrDesign holds row by row: A (n, n), B (n, m), ..., the poles (n,)."""

    A: Array
    B: Array
    Qx: Array
    Qu: Array
    K: Array
    P: Array
    poles: NDArray[np.complex128]


def read_matrices(told: Any) -> Matrices:
    """Return the matrices that a message with the fields of `report_fields` tells."""
    n, m = len(told.xe), len(told.ue)

    def rows(numbers: Any, of: int) -> Array:
        return np.reshape(np.asarray(numbers, dtype=float), (-1, of))

    return Matrices(rows(told.a, n), rows(told.b, m), rows(told.qx, n), rows(told.qu, m),
                    rows(told.k, n), rows(told.p, n),
                    np.array(told.poles_real) + 1j * np.array(told.poles_imag))


def _sentence(design: Design, seen: Figures) -> str:
    slowest, phase = seen.poles.real.max(), float(np.degrees(seen.phase_margin.min()))
    words = (f'{design.plant.system.name}: {len(seen.poles)} poles left of {slowest:.4g} 1/s, '
             f'least damping {seen.damping.min():.3g}, least disk margin '
             f'{seen.disk_margin.min():.3g}')
    return f'{words}, least phase margin {phase:.3g} deg' if np.isfinite(phase) else words
