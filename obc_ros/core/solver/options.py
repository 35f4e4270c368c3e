# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Options of the search: every number that decides what is tried, in which order and how long.

Tolerances of arithmetic stay beside their formulas, and tolerances of the certificate are no
options. Work is counted in iterations times intervals, with collocation times 1 + stages, so that
the result does not depend on the load of the machine. A unit takes about 0.05 ms. 'Relative
excess' is the Hamiltonian loss of a path over |J|.

The module is long because it holds all options; each group belongs to one strategy.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields, replace
import math
from typing import Any

from obc_ros.core.text.errors import quote, StatementError, suggest_name

# Ranges of values by unit: sizes divide, and parts are parts. Others are not negative.
_RANGES = {**dict.fromkeys(('intervals', 'each', 'pieces', 'samples', 'steps per piece'),
                           (1, math.inf)), 'shorter window': (1.01, 100), 'final time': (0, 1)}


def steer(default: float | tuple[float, ...], meaning: str, unit: str = '',
          needed_by: str = '') -> Any:
    """
    Return a field with its default, its meaning in a sentence, and its unit.

    `needed_by` names a problem of obc_ros/examples or test/collections, or a file of tests, that
    is not solved, costs more or takes longer with another value.
    """
    return field(default=default, metadata={
        'meaning': meaning, 'unit': unit, 'needed_by': needed_by})


@dataclass(frozen=True)
class CoarseOptions:
    """First solves on a coarse mesh."""

    intervals: int = steer(
        16, 'Number of intervals of the coarsest mesh.', 'intervals', 'detumble_mintime')
    iterations: int = steer(
        150, 'Maximum number of iterations of a solve from a rough guess.',
        'iterations', 'abs_off_centre')
    starts: int = steer(
        1, 'Number of guesses that are solved on a mesh if one of them leads to a path.',
        'guesses', 'detumble_mintime')
    rough: float = steer(
        1e-4, 'Error of the cost at which a solve from a guess may end.',
        'relative', 'double_tank')
    wild: float = steer(
        1e6, 'Infeasibility or Hamiltonian loss from which on a path counts as diverged.',
        'scaled', 'alp_rider')
    error: float = steer(
        1e-2, 'Error of the steps, the cost and the inputs of a coarse path that is small enough.',
        'relative', 'rayleigh_mintime')


@dataclass(frozen=True)
class RefinementOptions:
    """Aims of a mesh refinement."""

    loss: float = steer(
        3e-7, 'Hamiltonian loss of all intervals that is aimed at without state constraints.',
        'relative', 'motor_a')
    loss_bounded: float = steer(
        1e-7, 'Hamiltonian loss of all intervals that is aimed at with state constraints.',
        'relative', 'rayleigh_mixed')
    drift: float = steer(
        2e-5, 'Variation of H in each interval that is aimed at.',
        'relative to its terms', 'orbit_transfer')
    step_error: float = steer(
        3e-8, 'Local error of the states in all intervals that is aimed at.',
        'relative', 'orbit_transfer')


@dataclass(frozen=True)
class DescentOptions:
    """Descent from a coarse outcome to a certificate."""

    meshes: int = steer(10, 'Maximum number of meshes of a descent.', 'meshes', 'orbit_transfer')
    iterations: int = steer(
        350, 'Maximum number of iterations of a solve from the path on a coarser mesh.',
        'iterations', 'sphere_geodesic')
    work: int = steer(
        450_000, 'Maximum work of a solve on a finer mesh that has had 50 iterations.',
        'work', 'wheels4_a')
    enough: float = steer(
        1e-5, 'Excess at which a certified path without state constraints is not refined.',
        'relative', 'aircraft_5')
    enough_bounded: float = steer(
        1e-6, 'Excess at which any path is certified and a certified one is not refined.',
        'relative', 'around_a_disc')
    back_off: float = steer(
        1e-3, 'Largest violation of bounds that tighter bounds are to remove.',
        'relative', 'test_back_off.py')


@dataclass(frozen=True)
class BudgetOptions:
    """Work and time of searches, proofs and explanations."""

    share: float = steer(
        0.6, 'Part of the time for descents that may be in vain.',
        'time left', 'test_explanation.py')
    explanation: int = steer(
        400_000, 'Maximum work of an explanation.', 'work', 'test_explanation.py')
    related: int = steer(
        150_000, 'Maximum work of a solve that mainly serves an explanation.',
        'work', 'test_explanation.py')
    least: float = steer(
        0.5, 'Time that a last step needs, such as a certificate or an explanation.',
        's', 'test_back_off.py')
    certificate: float = steer(
        0.05, 'Part of the time that is kept for a path within bounds and its certificate.',
        'time limit', 'test_back_off.py')


@dataclass(frozen=True)
class MultistartOptions:
    """
    Number of further starts.

    A problem is hard if its first descent took much work; rough if coarse solves are slow, fail,
    or end at very different costs; bent if its nonlinearity index is large.
    """

    hard: int = steer(
        3000, 'Work above which a first descent is hard, and the starts after an easy one end.',
        'work', 'detumble_mintime')
    bent: float = steer(
        0.4, 'Nonlinearity index above which a problem is bent.', '', 'aircraft_5')
    share: float = steer(
        0.15, 'Part of all work that starts may take, twice as much for a hard problem.',
        'all work', 'aircraft_5')
    least_hard: int = steer(
        12, 'Minimum number for a hard or rough problem, doubled where `many_work` applies.',
        'starts', 'hypersensitive_long')
    least_bent: int = steer(8, 'Minimum number for a bent problem.', 'starts', 'cstr_kirk')
    after: int = steer(
        3, 'Number of starts or rollouts in vain that follow the last new minimum.',
        'starts', 'cart_pole')
    many_work: int = steer(
        15_000, 'Minimum work for a hard problem without collocation, or a cost with wells.',
        'work', 'terminal_wells_plane')
    most: int = steer(80, 'Maximum number of starts.', 'starts', 'terminal_wells_plane')
    lavish: int = steer(150_000, 'Maximum work of all starts.', 'work', 'hypersensitive_long')


@dataclass(frozen=True)
class GuessOptions:
    """Initial guesses: lines that are bent at random, and random inputs."""

    bend: float = steer(
        0.5, 'Amplitude of the bend of states.', 'size', 'hypersensitive_long')
    noise: float = steer(
        0.3, 'Amplitude of the noise of inputs, and of states that the line does not move.',
        'size', 'dielectrophoretic')


@dataclass(frozen=True)
class ObstacleOptions:
    """Obstacle homotopy classes: lines that are bent around obstacles."""

    ways: int = steer(
        8, 'Maximum number of bent lines, and of obstacles that they avoid.',
        'bent lines', 'test_obstacle_homotopy.py')


@dataclass(frozen=True)
class RolloutOptions:
    """
    Cross-entropy starts: rollouts of inputs that are constant in pieces.

    A short search has half the samples and steps, and one generation less. A brief search looks
    for minima beside the one that was found, with half the generations.
    """

    samples: int = steer(384, 'Number of rollouts of a generation.', 'samples', 'duffing')
    generations: int = steer(
        5, 'Number of generations of a search.', 'generations', 'orbit_transfer')
    pieces: int = steer(
        6, 'Number of pieces of constant input.', 'pieces', 'test_multistart.py')
    steps: int = steer(
        16, 'Number of integration steps in each piece.', 'steps per piece', 'hypersensitive')
    spread: float = steer(
        0.4, 'Standard deviation of the first inputs around their parents.',
        'range', 'orbit_transfer')
    tried: int = steer(
        8, 'Number of guesses, and of rollouts, that are solved while none leads to a path.',
        'rollouts', 'dubins_point_inside')


@dataclass(frozen=True)
class WindowOptions:
    """Final-time windows: other minima with longer and shorter final times."""

    ratio: float = steer(
        2**0.5, 'Ratio of the final times of adjacent windows.', 'shorter window',
        'test_final_time_windows.py')
    most: int = steer(
        6, 'Maximum number of windows with longer times, and of those with shorter ones.',
        'windows', 'test_final_time_windows.py')

    @property
    def reach(self) -> float:
        """Return the largest ratio of two final times, and of distances from rest."""
        return self.ratio**self.most


@dataclass(frozen=True)
class HorizonOptions:
    """Horizon continuation: from a short final time to the given one."""

    work: int = steer(100_000, 'Maximum work for all horizons.', 'work', 'pendulum_long')


@dataclass(frozen=True)
class BangOptions:
    """Bang arcs: phases in which inputs are held at their bounds."""

    solves: int = steer(
        10, 'Maximum number of solves with other arcs, also along state bounds.',
        'solves', 'epidemic_beds')
    jump: float = steer(
        0.3, 'Change of an input that may be a jump.', 'range', 'thrust_in_a_disc')
    vanishing: float = steer(
        1e-3, 'Length up to which an arc may be removed.', 'final time', 'pendulum_mintime')
    room: float = steer(
        1e-5, 'Increase of the cost that new or removed arcs may cause.', 'relative', 'oil_shale')


@dataclass(frozen=True)
class IndirectOptions:
    """The indirect method."""

    precise: float = steer(
        2e-7, 'Difference of the input from u* in precise samples.', 'relative', 'test_bvp.py')


@dataclass(frozen=True)
class BoundaryOptions:
    """Boundary arcs: phases along active state constraints."""

    work: int = steer(
        45_000, 'Work for the arcs of a mesh, or as much as the search took if that is more.',
        'work', 'goddard_pressure_limit')
    finer: tuple[int, ...] = steer(
        (4, 2), 'Refinements of the coarse mesh that are tried in turn.',
        'times', 'goddard_speed_limit')
    gaps: tuple[float, ...] = steer(
        (0.06, 0.01), 'Gaps in a contact that are closed, in turn.',
        'final time', 'goddard_speed_limit')
    intervals: int = steer(
        24, 'Approximate number of intervals of all phases together.',
        'intervals', 'detumble_mintime')


@dataclass(frozen=True)
class NeighbourOptions:
    """Repeated structures: solutions of neighbouring problems, and kept programs."""

    kept: int = steer(
        24, 'Number of solutions, and of programs, that are kept.', 'each', 'test_repeats.py')
    near: float = steer(
        0.2, 'Change of a number or of a cost up to which a solution may serve a neighbour.',
        'relative', 'test_kink_mesh.py')


@dataclass(frozen=True)
class Options:
    """All options of a search, a group a strategy."""

    coarse: CoarseOptions = CoarseOptions()
    refinement: RefinementOptions = RefinementOptions()
    descent: DescentOptions = DescentOptions()
    budget: BudgetOptions = BudgetOptions()
    multistart: MultistartOptions = MultistartOptions()
    guesses: GuessOptions = GuessOptions()
    obstacles: ObstacleOptions = ObstacleOptions()
    rollouts: RolloutOptions = RolloutOptions()
    windows: WindowOptions = WindowOptions()
    horizon: HorizonOptions = HorizonOptions()
    bangs: BangOptions = BangOptions()
    boundary: BoundaryOptions = BoundaryOptions()
    indirect: IndirectOptions = IndirectOptions()
    neighbour: NeighbourOptions = NeighbourOptions()


DEFAULTS = Options()


@dataclass(frozen=True)
class Option:
    """One option: its name as users write it, its value, and what `steer` says of it."""

    name: str
    value: float | tuple[float, ...]
    meaning: str
    unit: str
    needed_by: str


def list_options(options: Options = DEFAULTS) -> Iterator[Option]:
    """
    Yield all options in order.

    :param options: their values.
    """
    for group in fields(options):
        values = getattr(options, group.name)
        for each in fields(values):
            yield Option(f'{group.name}.{each.name}', getattr(values, each.name),
                         **each.metadata)


def read_options(given: Iterable[str]) -> Options:
    """
    Return the options with the given changes.

    :param given: each is NAME=VALUE, as 'multistart.most=20'. A list of numbers is separated by
        commas.
    :raises StatementError: if a name is unknown, or a value is not of the kind of the default or
        out of its range.
    """
    options, known = DEFAULTS, {each.name: each for each in list_options()}
    for text in given:
        name, sign, value = (part.strip() for part in text.partition('='))
        if not sign:
            raise StatementError(f"option: '{quote(text)}': wanted NAME=VALUE, as "
                                 'multistart.most=20')
        if name not in known:
            raise StatementError(
                f"option: '{quote(name)}' is unknown{suggest_name(name, tuple(known))}; "
                '`obc solve --list-options` lists all')
        group, key = name.split('.')
        options = replace(options, **{group: replace(
            getattr(options, group), **{key: _read_value(known[name], value, known[name].value)})})
    return options


def _read_value(option: Option, text: str, default: float | tuple[float, ...]) -> Any:
    """Return a value of the kind of the default, within the range of the option."""
    if isinstance(default, tuple):
        parts = text.split(',')
        return tuple(_read_value(option, part.strip(), default[0]) for part in parts)
    kind, wanted = (int, 'a whole number') if isinstance(default, int) else (float, 'a number')
    least, most = _RANGES.get(option.unit, (0, math.inf))
    wanted += f' from {least:g} to {most:g}' if most < math.inf else (
        f' of at least {least:g}' if least else ' that is not negative')
    try:
        value = kind(text)
    except ValueError:
        raise StatementError(
            f"option: {option.name} = '{quote(text)}': wanted {wanted}") from None
    if not (least <= value <= most and value < math.inf):
        raise StatementError(f'option: {option.name} = {value:g}: wanted {wanted}')
    return value
