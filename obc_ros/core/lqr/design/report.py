# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Report of a design and of the change from the previous one: fields of a message, a sentence."""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from obc_ros.core.lqr.design.design import Design
from obc_ros.core.lqr.held_loop import HeldLoop
from obc_ros.core.lqr.held_margins import compute_held_margins
from obc_ros.core.lqr.margins import compute_margins, Figures
from obc_ros.core.numerics.arrays import Array

# Least damping ratio of the modes that swing, in words. With 0.5 a swing has a 38th of the
# amplitude of the one before, with 0.2 a quarter.
SWINGS = ((math.inf, 'no oscillation'), (0.5, 'well damped'), (0.2, 'moderately damped'),
          (-math.inf, 'poorly damped'))


@dataclass(frozen=True)
class Change:
    """
    The change from one design to the next.

    :ivar largest: largest change of an entry of K; 0: the first design.
    :ivar jump: (m,) change of each input at the present error; empty: no state yet.
    :ivar sentence: both as a sentence; empty for the first design.
    """

    largest: float = 0.0
    jump: tuple[float, ...] = ()
    sentence: str = ''


def change(before: Design, after: Design, jump: Sequence[float] | None) -> Change:
    """Return the change between designs of a system; `jump` (m,) is that of the inputs."""
    system = after.plant.system
    step = after.K - before.K
    i, j = divmod(int(np.abs(step).argmax()), step.shape[1])
    largest = float(abs(step[i, j]))
    words = 'K is unchanged' if not largest else (
        f'largest change of K: {before.K[i, j]:.4g} to {after.K[i, j]:.4g} '
        f'({system.states[j].name} to {system.inputs[i].name})')
    if jump:
        i, most = max(enumerate(jump), key=lambda each: abs(each[1]))
        words += (f'; at the present error {system.inputs[i].name} jumps by {most:.4g} '
                  f'{system.inputs[i].unit}').rstrip()
    return Change(largest, tuple(jump or ()), words)


def report_fields(design: Design, made: Change, error: Sequence[float] | None,
                  period: float = 0.0) -> dict[str, Any]:
    """
    Return the fields of the message LqrDesign that describe a design.

    :param error: the present x - xe (n,).
    :param period: measured period of the commands [s]; 0: not known. Then it is that of the
        design; without one the figures are of the loop in continuous time.
    :return: values by field; matrices row by row.
    """
    plant, found = design.plant, design.lqr
    n = plant.system.n
    P = found.P[:n, :n]
    loop = design.held_loop(period)
    seen = compute_held_margins(loop) if loop else compute_margins(found.A, found.B, found.K,
                                                                   states=n)
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
        'loop_period': loop.period if loop else 0.0,
        **{name: getattr(seen, name) for name in (
            'gain_margin', 'gain_reduction_margin', 'phase_margin', 'disk_margin', 'delay_margin',
            'bandwidth', 'rise_time', 'overshoot', 'settling_time', 'peak_input')},
        'sensitivity_peak': float(seen.sensitivity_peak),
        'cost_to_go': 0.0 if error is None else design.cost_to_go(error),
        'max_gain_change': made.largest,
        'input_jump': max(map(abs, made.jump), default=0.0),
        'sentence': '; '.join(filter(None, (_sentence(design, seen, loop), made.sentence))),
    }


def describe_plainly(poles: NDArray[np.complex128], damping: Array, phase_margin: Array,
                     delay_margin: Array) -> str:
    """
    Return in plain words how fast a closed loop is, how it swings, and what it tolerates.

    The parameters are those of `Figures`; a phase is given only with a limit.
    """
    slowest = float(np.max(poles.real))
    margins = np.append(phase_margin, delay_margin)
    if not math.isfinite(slowest) or np.isnan(margins).any() or np.isnan(damping).any():
        return 'not known'
    if slowest >= 0.0:
        return 'not stable: ' + (f'doubles in {_round(math.log(2.0) / slowest)} s'
                                 if slowest else 'a deviation does not decay')
    swinging = damping[poles.imag != 0.0]
    least = float(np.min(swinging)) if len(swinging) else math.inf
    words = next(words for bound, words in SWINGS if least >= bound)
    # The margins of each input are those with the other ones as they are.
    alone = ' in one input' if len(phase_margin) > 1 else ''
    phase, delay = float(np.min(phase_margin)), float(np.min(delay_margin))
    tolerated = ' or '.join(filter(None, (
        f'{math.floor(math.degrees(phase) + 1e-9)} deg of phase' if math.isfinite(phase) else '',
        f'{_round(delay, down=True)} s of delay' if math.isfinite(delay) else '')))
    return (f'slowest mode {_round(-1.0 / slowest)} s; {words}; tolerates '
            + (tolerated + alone if tolerated else 'any delay'))


def _round(value: float, *, down: bool = False) -> str:
    """Return a number with two digits; `down`: not larger than it is, as a margin must be."""
    if down and value > 0.0:
        unit = 10.0**(math.floor(math.log10(value)) - 1)
        value = math.floor(value / unit + 1e-9) * unit
    return f'{float(f"{value:.2g}"):g}'


class Matrices(NamedTuple):
    """The matrices of a message LqrDesign: A (n, n), B (n, m), ..., and the poles (n,)."""

    A: Array
    B: Array
    Qx: Array
    Qu: Array
    K: Array
    P: Array
    poles: NDArray[np.complex128]


def read_matrices(message: Any) -> Matrices:
    """Return the matrices of a message LqrDesign, with the fields of `report_fields`."""
    n, m = len(message.xe), len(message.ue)

    def rows(numbers: Any, of: int) -> Array:
        return np.reshape(np.asarray(numbers, dtype=float), (-1, of))

    return Matrices(rows(message.a, n), rows(message.b, m), rows(message.qx, n),
                    rows(message.qu, m), rows(message.k, n), rows(message.p, n),
                    np.array(message.poles_real) + 1j * np.array(message.poles_imag))


def _sentence(design: Design, seen: Figures, loop: HeldLoop | None) -> str:
    words = [f'spectral abscissa {seen.poles.real.max():.3g} 1/s',
             f'minimum damping ratio {seen.damping.min():.3g}']
    for name, value, unit in (('disk', seen.disk_margin.min(), ''),
                              ('phase', np.degrees(seen.phase_margin.min()), ' deg'),
                              ('delay', seen.delay_margin.min(), ' s')):
        if np.isfinite(value):
            words.append(f'minimum {name} margin {value:.3g}{unit}')
    where = ('in continuous time, the period of the commands is not known' if loop is None
             else f'with commands every {loop.period:.4g} s')
    if loop and loop.delay:
        where += f' that act after {loop.delay:.4g} s; u = ue - K (predicted state - xe)'
    if loop and not loop.radius < 1.0:
        words.insert(0, 'unstable')
    return f'{design.plant.system.name}: {", ".join(words)} ({where})'
