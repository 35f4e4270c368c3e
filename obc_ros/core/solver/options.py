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
_AT_LEAST_1 = (1, math.inf)
_RANGES = {'intervals': _AT_LEAST_1, 'each': _AT_LEAST_1, 'pieces': _AT_LEAST_1,
           'samples': _AT_LEAST_1, 'steps': _AT_LEAST_1, 'steps per interval': _AT_LEAST_1,
           'steps per piece': _AT_LEAST_1, 'values': _AT_LEAST_1, 'shorter window': (1.01, 100),
           'final time': (0, 1)}


def steer(default: float | tuple[float, ...], meaning: str, unit: str = '',
          needed_by: str = '') -> Any:
    """
    Return a field with its default, its meaning in a phrase, and its unit.

    `needed_by` names a problem of obc_ros/examples or test/collections, or a file of tests, that
    is not solved, costs more or takes longer with another value.
    """
    return field(default=default, metadata={
        'meaning': meaning, 'unit': unit, 'needed_by': needed_by})


@dataclass(frozen=True)
class CoarseOptions:
    """First solves on a coarse mesh."""

    intervals: int = steer(16, 'size of the coarsest mesh', 'intervals', 'detumble_mintime')
    iterations: int = steer(
        150, 'maximum of a solve from a rough guess', 'iterations', 'abs_off_centre')
    few_iterations: int = steer(
        12, 'lower limit of the maximum of further guesses; maximum from a neighbour',
        'iterations', 'test_kink_mesh.py')
    starts: int = steer(1, 'guesses after one that led to a path', 'guesses', 'detumble_mintime')
    patience: int = steer(
        10_000, 'work after which `starts` is enough in any case', 'work', 'hypersensitive_long')
    rough: float = steer(
        1e-4, 'error of the cost at which a solve may end', 'relative', 'double_tank')
    late: tuple[int, ...] = steer(
        (10, 5), 'after which a solve that stays infeasible ends; of further guesses',
        'iterations', 'orbit_transfer')
    left: tuple[float, ...] = steer(
        (0.5, 0.8), 'infeasibility above which it does', 'first infeasibility', 'orbit_transfer')
    wild: float = steer(
        1e6, 'infeasibility, or excess of the cost, of paths that diverged', 'scaled',
        'alp_rider')
    error: float = steer(
        1e-2, 'error of a step, of the cost or of an input that is small enough',
        'relative', 'rayleigh_mintime')

    def get_early_ends(self, number: int) -> tuple[tuple[int, float], ...]:
        """Return the first pairs of `late` and `left`: one for first guesses, two for others."""
        return tuple(zip(self.late, self.left, strict=False))[:number]


@dataclass(frozen=True)
class RefinementOptions:
    """Aims of a mesh refinement, for all intervals together unless said otherwise."""

    loss: float = steer(
        3e-7, 'Hamiltonian loss without state constraints', 'relative', 'motor_a')
    loss_bounded: float = steer(
        1e-7, 'Hamiltonian loss with state constraints', 'relative', 'rayleigh_mixed')
    drift: float = steer(
        2e-5, 'variation of H in each interval', 'relative to its terms', 'orbit_transfer')
    cuts: int = steer(4, 'maximum of an interval in one refinement', 'parts', 'singular_aly_chan')
    step_error: float = steer(3e-8, 'local errors of the states', 'relative', 'orbit_transfer')


@dataclass(frozen=True)
class DescentOptions:
    """Descent from a coarse outcome to a certificate."""

    meshes: int = steer(10, 'maximum of a descent', 'meshes', 'orbit_transfer')
    plain: int = steer(
        5, 'meshes after which switching times are sought in any case', 'meshes', 'oil_shale')
    iterations: int = steer(
        350, 'maximum on a finer mesh, from the coarser one', 'iterations', 'sphere_geodesic')
    work: int = steer(
        450_000, 'maximum on a finer mesh, but for 50 iterations', 'work', 'wheels4_a')
    boundary_excess: float = steer(
        0.1, 'excess below which arcs along state bounds are sought', 'relative',
        'heated_rod_limit')
    spread: float = steer(
        1.5e-4, 'variation of H above which no certificate is computed', 'relative',
        'hypersensitive_long')
    enough: float = steer(
        1e-5, 'excess at which a certified path is not refined; difference of the input from u* '
        'in samples of the indirect method', 'relative', 'aircraft_5')
    enough_bounded: float = steer(
        1e-6, 'the same with state constraints; below it a certificate is computed', 'relative',
        'around_a_disc')
    back_off: float = steer(
        1e-3, 'violation of bounds alone up to which a path within tighter bounds is sought; '
        'error of its cost', 'relative', 'test_back_off.py')


@dataclass(frozen=True)
class BudgetOptions:
    """Work and time of searches, proofs and explanations."""

    vain: float = steer(
        2.0, 'work of descents when all coarse errors are large',
        'work so far', 'hypersensitive_long')
    share: float = steer(
        0.6, 'part of the time for descents that may be in vain', 'time left',
        'test_explanation.py')
    explanation: int = steer(
        400_000, 'work of an explanation', 'work', 'test_explanation.py')
    related: int = steer(
        150_000, 'work for each problem that it solves; extra work of descents when inputs '
        'chatter', 'work', 'test_explanation.py')
    least: float = steer(
        0.5, 'time for an explanation, for more digits or a certificate', 's', 'test_back_off.py')
    certificate: float = steer(
        0.05, 'part of the time kept for a path within bounds and its certificate', 'time limit',
        'test_back_off.py')


@dataclass(frozen=True)
class MultistartOptions:
    """
    Number of further starts.

    A problem is hard if its first descent took much work; rough if coarse solves are slow, fail,
    or end at very different costs; bent if its nonlinearity index is large.
    """

    hard: int = steer(
        3000, 'work of the first descent of a hard problem', 'work', 'detumble_mintime')
    slow: int = steer(
        30, 'iterations of a coarse solve of a rough problem', 'iterations', 'aircraft_5')
    bent: float = steer(0.4, 'nonlinearity index of a bent problem', '', 'aircraft_5')
    share: float = steer(0.15, 'part of all work for further starts', 'work', 'aircraft_5')
    share_hard: float = steer(0.3, 'the same for hard problems', 'work', 'cart_pole')
    least_hard: int = steer(
        12, 'minimum for hard problems by collocation, rough ones',
        'starts', 'hypersensitive_long')
    least_bent: int = steer(8, 'minimum for bent problems', 'starts', 'cstr_kirk')
    after: int = steer(
        3, 'starts after a better solution; rollouts after a new minimum, twice as many of a '
        'bent problem', 'starts', 'cart_pole')
    many: int = steer(
        24, 'minimum for hard problems by steps and costs with wells', 'starts', 'f8_aircraft')
    many_work: int = steer(15_000, 'minimum for these', 'work', 'terminal_wells_plane')
    most: int = steer(80, 'maximum', 'starts', 'terminal_wells_plane')
    splits: int = steer(2, 'mesh halvings to confirm a lower cost', 'meshes', 'f8_aircraft')
    rough_work: int = steer(
        3000, 'work for starts of rough problems that are not hard, and for windows',
        'work', 'robot_arm')
    lavish: int = steer(150_000, 'maximum work for starts', 'work', 'hypersensitive_long')


@dataclass(frozen=True)
class GuessOptions:
    """Initial guesses: lines that are bent at random, and random inputs."""

    bend: float = steer(0.5, 'amplitude of the bend of states', 'size', 'hypersensitive_long')
    noise: float = steer(
        0.3, 'that of inputs, and of states that the line does not move',
        'size', 'dielectrophoretic')
    reach: float = steer(
        3.0, 'distance up to which final states are searched', 'reach', 'test_program.py')


@dataclass(frozen=True)
class ObstacleOptions:
    """Obstacle homotopy classes: lines that are bent around obstacles."""

    ways: int = steer(
        8, 'maximum, the shortest; and of obstacles, the largest',
        'bent lines', 'test_obstacle_homotopy.py')
    clear: float = steer(
        1.1, 'distance of a bent line', 'end of the obstacle', 'test_obstacle_homotopy.py')
    detour: float = steer(
        0.5, 'largest distance of the other side of an obstacle',
        'line', 'test_obstacle_homotopy.py')


@dataclass(frozen=True)
class RolloutOptions:
    """
    Cross-entropy starts: rollouts of inputs that are constant in pieces.

    A short search has half the samples and steps, and one generation less. A brief search looks
    for minima beside the one that was found; if the nonlinearity index is large it has three
    times the samples, and twice the parents.
    """

    samples: int = steer(384, 'of a generation', 'samples', 'duffing')
    share: int = steer(16, 'of which one becomes a parent', 'samples', 'orbit_transfer')
    generations: int = steer(
        5, 'of a search; half as many of a brief one', 'generations', 'orbit_transfer')
    pieces: int = steer(6, 'of constant input', 'pieces', 'test_multistart.py')
    steps: int = steer(16, 'integration steps', 'steps per piece', 'hypersensitive')
    spread: float = steer(
        0.4, 'first standard deviation around parents', 'range', 'orbit_transfer')
    windows: int = steer(
        4, 'of a free final time, each with parents of its own', 'windows', 'zermelo_shear')
    tried: int = steer(
        8, 'solved while none converged, and guesses before; at most twice as many',
        'rollouts', 'dubins_point_inside')
    glance: int = steer(32, 'of a brief search with terminal constraints', 'samples', 'robot_arm')
    parents: int = steer(
        4, 'cheapest ones that are parents in one without', 'rollouts', 'cstr_luus')
    children: int = steer(48, 'of each of them', 'samples', 'batch_reactor_temperature')
    brief_steps: int = steer(
        5, 'integration steps of a brief search', 'steps per piece', 'test_multistart.py')


@dataclass(frozen=True)
class WindowOptions:
    """Final-time windows: other minima with longer and shorter final times."""

    ratio: float = steer(
        2**0.5, 'ratio of the times of adjacent windows', 'shorter window',
        'test_final_time_windows.py')
    most: int = steer(
        6, 'maximum with longer, and with shorter times', 'windows', 'test_final_time_windows.py')

    @property
    def reach(self) -> float:
        """Return the largest ratio of two final times, and of distances from rest."""
        return self.ratio**self.most


@dataclass(frozen=True)
class HorizonOptions:
    """Horizon continuation: from a short final time to the given one."""

    halvings: int = steer(6, 'halvings of T for the first horizon', '', 'pendulum_long')
    work: int = steer(100_000, 'work for all horizons', 'work', 'pendulum_long')


@dataclass(frozen=True)
class BangOptions:
    """Bang arcs: phases in which inputs are held at their bounds."""

    solves: int = steer(
        10, 'maximum with other arcs, also along state bounds', 'solves', 'epidemic_beds')
    seen: float = steer(0.98, 'least length of an arc', 'detected length', 'lotka_fishing')
    jump: float = steer(0.3, 'change of an input that may be a jump', 'range', 'thrust_in_a_disc')
    vanishing: float = steer(
        1e-3, 'length up to which an arc may be removed', 'final time', 'pendulum_mintime')
    room: float = steer(
        1e-5, 'increase of the cost by new arcs, or by the removal of arcs', 'relative',
        'oil_shale')


@dataclass(frozen=True)
class WellOptions:
    """Moves of inputs to another minimum of H."""

    values: int = steer(
        17, 'values of each input at which H is evaluated', 'values', 'test_hamiltonian_wells.py')
    glance: int = steer(
        8, 'intervals that are sampled before all', 'intervals', 'test_hamiltonian_wells.py')
    steps: int = steer(
        40, 'integration steps in the longest interval', 'steps', 'test_hamiltonian_wells.py')


@dataclass(frozen=True)
class KinkOptions:
    """Meshes with a point at each kink of the inputs."""

    deviation: float = steer(
        4e-3, 'inputs from linear in an interval', 'relative', 'test_kink_mesh.py')


@dataclass(frozen=True)
class IndirectOptions:
    """The indirect method."""

    precise: float = steer(
        2e-7, 'difference of the sampled input from u*, if `descent.enough` is not small enough',
        'relative', 'test_bvp.py')
    most: int = steer(4000, 'maximum', 'samples', 'test_bvp.py')


@dataclass(frozen=True)
class BoundaryOptions:
    """Boundary arcs: phases along active state constraints."""

    work: int = steer(
        45_000, 'work for the arcs of a coarse mesh; the least for others',
        'work', 'goddard_pressure_limit')
    finer: tuple[int, ...] = steer(
        (4, 2), 'refinements of the coarse mesh, in turn', 'times', 'goddard_speed_limit')
    gaps: tuple[float, ...] = steer(
        (0.06, 0.01), 'gaps in a contact that are closed, in turn',
        'final time', 'goddard_speed_limit')
    graded: int = steer(
        3, 'maximum, each by 2, unless each halves the residual', 'refinements', 'truck2_a')
    intervals: int = steer(24, 'of all phases together, about', 'intervals', 'detumble_mintime')
    fewest: int = steer(3, 'minimum of a phase', 'intervals', 'epidemic_weak_lockdown')
    nearly: float = steer(
        0.1, 'rate at a junction that may be tangential', 'relative', 'clamped_beam')


@dataclass(frozen=True)
class NeighbourOptions:
    """Repeated structures: solutions of neighbouring problems, and kept programs."""

    kept: int = steer(24, 'solutions kept, and programs kept', 'each', 'test_repeats.py')
    near: float = steer(
        0.2, 'change of a number, but for x(0), of a neighbour; excess of the costs of other '
        'minima that may be its best', 'relative', 'test_kink_mesh.py')
    several: float = steer(
        0.05, 'part of these changes within which the best of several minima stays the best', '',
        'test_repeats.py')


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
    wells: WellOptions = WellOptions()
    kinks: KinkOptions = KinkOptions()
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

    Parameters
    ----------
    options : Options
        Their values.

    """
    for group in fields(options):
        values = getattr(options, group.name)
        for each in fields(values):
            yield Option(f'{group.name}.{each.name}', getattr(values, each.name),
                         **each.metadata)


def read_options(given: Iterable[str]) -> Options:
    """
    Return the options with the given changes.

    Parameters
    ----------
    given : iterable of str
        Each is NAME=VALUE, as 'multistart.most=20'. A list of numbers is separated by commas.

    Returns
    -------
    Options

    Raises
    ------
    StatementError
        If a name is unknown, or a value is not of the kind of the default or out of its range.

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
