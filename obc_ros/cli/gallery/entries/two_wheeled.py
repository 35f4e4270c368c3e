# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Exercise 2.6: a two-wheeled robot in minimum time, and maps of the words of its paths."""

from collections.abc import Iterator
from math import asin, atan2, cos, hypot, pi, sin, sqrt
from typing import Any

from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
import numpy as np
from obc_ros.cli.gallery.drawing import create_panels, label_axes
from obc_ros.cli.gallery.entry import ComparedRow, EntryResult, GalleryEntry
from obc_ros.cli.gallery.extremals import find_least_times
from obc_ros.cli.gallery.runner import Desk, Trajectory
from obc_ros.core.library.figures.style import LINE_COLOURS
from obc_ros.core.numerics.arrays import Array
from scipy.ndimage import distance_transform_edt, label

Pose = tuple[float, float, float]

SIDE, POINTS = 3.0, 20  # of the map [m]
# Centres of squares: not on the lines where words of one or two arcs are fastest.
PLACE = (np.arange(POINTS) + 0.5) * 2 * SIDE / POINTS - SIDE
LARGE = 8  # squares: size of a region that gets a label
ROBOT = np.maximum.outer(np.abs(PLACE), np.abs(PLACE)) < 0.5  # where the robot is drawn
HEADINGS = (0.0, pi / 2)
STRAIGHT = ((2.0, 0.0, 0.0), (-1.5, 0.0, 0.0))
TURNS = ((0.0, 0.0, pi / 2), (0.0, 0.0, -1.0), (0.0, 0.0, 3.0))
TANGENTS = ((2.0, 1.0, 0.5), (3.0, 1.0, 0.2), (4.0, 1.5, 0.0))  # reached by L+S+R+
OTHERS = ((0.0, 1.0, 0.0), (-1.0, 2.0, 0.0), (2.0, -1.0, 2.0), (1.0, 0.3, -2.0))
PRINCIPLE = 'shortest extremal of the maximum principle'
MIDDLE = 2 * asin(sin(pi / 4) / 2)  # [rad] the middle arc of a turn by 90 degrees
SHOWN = (TANGENTS[0], OTHERS[0], (-1.0, 2.0, 0.0), (1.0, -1.5, pi / 2), TURNS[0])
# Paul Tol's light colours: black letters on them are readable with any colour vision.
LIGHT = ('#77AADD', '#EEDD88', '#44BB99', '#FFAABB', '#AAAA00', '#99DDFF', '#EE8866', '#DDDDDD',
         '#BBCC33', '#FFFFFF')


def exercise_2_6(desk: Desk) -> EntryResult:
    """Compute Exercise 2.6: single goals, and two maps."""
    single = desk.plan_all([_motion(goal) for goal in (*STRAIGHT, *TURNS, *TANGENTS, *OTHERS)])
    straight, turns = single[:2], single[2:5]
    tangents, others = single[5:8], single[8:]
    again = desk.solve_all([_problem(goal) for goal in OTHERS], method='arcs', show=0)
    spot, = desk.plan_all([_motion(TURNS[0]) | {'input_bounds': {'v': [0, 0]}}])
    shown = desk.plan_all([_motion(goal) for goal in SHOWN], show=0)
    maps = []
    for heading in HEADINGS:
        goals = [(x, y, heading) for y in PLACE.tolist() for x in PLACE.tolist()]
        maps.append((goals, desk.plan_all([_motion(goal) for goal in goals], show=0)))
    rows = _single_rows(straight, turns, tangents, others, again, spot)
    for heading, (goals, paths) in zip(HEADINGS, maps, strict=True):
        ends = np.array([_driven(path) for path in paths])
        ends[:, 2] = np.remainder(ends[:, 2] - heading + pi, 2 * pi) - pi + heading
        name = f'map of {len(goals)} goals, $θ_f = {heading:.4g}$'
        rows += [
            ComparedRow(f'{name}: $T$ [s]', [path.T for path in paths], find_least_times(goals),
                        PRINCIPLE),
            ComparedRow(f'{name}: the arcs end at the goal', ends, np.array(goals),
                        'arcs and lines integrated'),
            ComparedRow(f'{name}: $|v| = L$',
                        np.concatenate([np.abs(path.u['v']) for path in paths]),
                        np.ones(sum(path.t.size for path in paths)), 'the exercise'),
            ComparedRow(f'{name}: $ω ∈ {{-M, 0, M}}$', *_steering(paths), 'the exercise'),
            ComparedRow(f'{name}: $T$ at the mirror image', *_mirrored(goals, paths),
                        'symmetry of the robot')]
    return EntryResult(rows, _draw(maps, shown), (
        'Left and middle: the fastest word from the origin (heading to the right) to each goal, '
        'with $L = M = 1$. C is a turn, S a straight line, | a change of direction. Black: lines '
        'of equal time, every 0.5 s. Right: five paths with their words; bold where the robot '
        'drives backwards.',),
        f'Turning by 90 degrees in place takes {turns[0].T:.9f} s at full speed, with '
        f'switches at {turns[0].switching_times[0]:.6f} and {turns[0].switching_times[1]:.6f} s; '
        f'with $v = 0$ it takes {spot.T:.9f} s.')


def _motion(goal: Pose) -> dict[str, Any]:
    return {'system': 'two_wheeled', 'start': [0.0, 0.0, 0.0], 'goal': list(goal),
            'objective': 'time'}


def _problem(goal: Pose) -> dict[str, Any]:
    names = ('px', 'py', 'theta')
    return {'system': 'two_wheeled', 'running_cost': '1', 'initial_state': dict.fromkeys(names, 0),
            'terminal_constraints': [f'{name} - ({value!r})'
                                     for name, value in zip(names, goal, strict=True)],
            'final_time': {'free': True, 'lower': 0.01, 'upper': 20}}


def _single_rows(straight: list[Trajectory], turns: list[Trajectory],
                 tangents: list[Trajectory], others: list[Trajectory], again: list[Trajectory],
                 spot: Trajectory) -> list[ComparedRow]:
    return [
        ComparedRow('straight on, and back: $T$ [s]', [path.T for path in straight],
                    [abs(goal[0]) for goal in STRAIGHT], '$|x|/L$'),
        ComparedRow('turn in place: $T$ [s]', [path.T for path in turns],
                    [abs(goal[2]) for goal in TURNS], "$|θ|/M$, as $|θ'| ≤ M$"),
        ComparedRow('turn by 90 degrees: switching times [s]', turns[0].switching_times,
                    [pi / 4 - MIDDLE / 2, pi / 4 + MIDDLE / 2],
                    'L+R-L+: three circles that touch, $2 asin(½ sin 45°)$ in the middle'),
        ComparedRow('turn by 90 degrees with $v = 0$: $T$ [s]', spot.T, pi / 2, '$(π/2)/M$'),
        ComparedRow('left, straight, right: $T$ [s]', [path.T for path in tangents],
                    [time_left_straight_right(goal) for goal in TANGENTS],
                    'inner tangent of two circles'),
        ComparedRow('four other goals: $T$ [s]', [path.T for path in others],
                    find_least_times(OTHERS),
                    PRINCIPLE),
        ComparedRow('the same by `method: arcs`, without a list of words',
                    [path.T for path in again], find_least_times(OTHERS), PRINCIPLE),
        ComparedRow('$H$ on these paths', np.concatenate([path.hamiltonian for path in others]),
                    np.zeros(sum(path.t.size for path in others)), '0, as $T$ is free')]


def time_left_straight_right(goal: Pose) -> float:
    """Return the time of the path L+S+R+ with L = M = 1."""
    x, y, theta = goal
    dx, dy = x + sin(theta), y - cos(theta) - 1
    distance = hypot(dx, dy)
    turn = atan2(dy, dx) + asin(2 / distance)
    return turn + sqrt(distance**2 - 4) + turn - theta


def split_path(path: Trajectory) -> list[tuple[float, float, float]]:
    """Return duration, v and omega of each arc with constant inputs."""
    ends = [0.0, *path.switching_times, path.T]
    found = []
    for begin, end in zip(ends[:-1], ends[1:], strict=True):
        k = int(np.searchsorted(path.t, (begin + end) / 2)) - 1
        found.append((end - begin, float(path.u['v'][k]), float(path.u['omega'][k])))
    return found


def spell_path(path: Trajectory) -> str:
    """Return the word of a path: C and S, with a bar where the direction changes."""
    text, before = '', 0.0
    for _, v, omega in split_path(path):
        text += ('|' if before * v < 0 else '') + ('C' if abs(omega) > 0.5 else 'S')
        before = v
    return text


def _driven(path: Trajectory) -> tuple[float, float, float]:
    """Return the pose at the end of the inputs, arc by arc in closed form."""
    x = y = theta = 0.0
    for time, v, omega in split_path(path):
        after = theta + omega * time
        if omega:
            x, y = (x + v / omega * (sin(after) - sin(theta)),
                    y - v / omega * (cos(after) - cos(theta)))
        else:
            x, y = x + v * time * cos(theta), y + v * time * sin(theta)
        theta = after
    return x, y, theta


def _steering(paths: list[Trajectory]) -> tuple[Array, Array]:
    omega = np.concatenate([path.u['omega'] for path in paths])
    return omega, np.clip(np.round(omega), -1, 1)


def _mirrored(goals: list[Pose], paths: list[Trajectory]) -> tuple[Array, Array]:
    """Return T, and T at the goal that mirroring (and reversing the path) gives."""
    times = {(round(x, 6), round(y, 6)): path.T
             for (x, y, _), path in zip(goals, paths, strict=True)}
    if goals[0][2] == 0.0:  # left and right
        return np.array([*times.values()]), np.array([times[x, -y] for x, y in times])
    # The reversed path, mirrored: -(x, y) rotated by -theta, left for right.
    return np.array([*times.values()]), np.array([times[y, x] for x, y in times])


def _draw(maps: list[Any], shown: list[Trajectory]) -> Figure:
    figure, (axes,) = create_panels(1, 3, 3.3)
    words = sorted({spell_path(path) for _, paths in maps for path in paths},
                   key=lambda text: (len(text.replace('|', '')), text))
    for plot, heading, (_, paths) in zip(axes, HEADINGS, maps, strict=False):
        index, time = (np.reshape(values, (POINTS, POINTS)) for values in (
            [words.index(spell_path(path)) for path in paths], [path.T for path in paths]))
        plot.pcolormesh(PLACE, PLACE, index, cmap=ListedColormap(LIGHT[:len(words)]),
                        norm=BoundaryNorm(np.arange(len(words) + 1) - 0.5, len(words)),
                        shading='nearest')
        lines = plot.contour(PLACE, PLACE, time, levels=np.arange(0.5, 8, 0.5), colors='black',
                             linewidths=0.5)
        plot.clabel(lines, lines.levels[1::2], fontsize=7.5, fmt='%g')
        for text, x, y in _places(index, words):
            plot.text(x, y, text, fontsize=8.5, ha='center', va='center', zorder=4, bbox={
                'facecolor': LIGHT[words.index(text)], 'edgecolor': 'none', 'pad': 1})
        _robot(plot, 0.0, 0.0, 0.0)
        plot.set(aspect='equal', xticks=range(-3, 4), yticks=range(-3, 4))
        plot.grid(False)
        degrees = np.degrees(heading)
        label_axes(plot, f'goal heading $\\theta_f = {degrees:.0f}$°', '$x_f$ [m]', '$y_f$ [m]')
    figure.legend(handles=[Patch(color=colour, label=text)
                           for colour, text in zip(LIGHT, words, strict=False)],
                  loc='outside lower center', ncols=len(words), columnspacing=1.2,
                  handlelength=1.1)
    for path, colour in zip(shown, LINE_COLOURS, strict=False):
        axes[2].plot(path.x['px'], path.x['py'], color=colour)
        back = np.where(path.u['v'] < 0, 1.0, np.nan)
        axes[2].plot(path.x['px'] * back, path.x['py'] * back, color=colour, linewidth=3.2)
        x, y, theta = (path.x[name][-1] for name in ('px', 'py', 'theta'))
        axes[2].text(x + 0.4 * cos(theta) + 0.1, y + 0.4 * sin(theta), spell_path(path),
                     color=colour,
                     va='center', fontsize=8.5)
        _robot(axes[2], x, y, theta, colour)
    _robot(axes[2], 0.0, 0.0, 0.0)
    axes[2].plot([], [], color='black', linewidth=3.2, label='backwards')
    axes[2].set(aspect='equal', xlim=(-1.6, 3.2), ylim=(-2.0, 2.8), xticks=range(-1, 4),
                yticks=range(-2, 3))
    label_axes(axes[2], 'five paths', '$x$ [m]', '$y$ [m]', legend='upper right')
    return figure


def _places(index: Array, words: list[str]) -> Iterator[tuple[str, float, float]]:
    """Yield each word with the middle (x, y) of its largest region."""
    for number, text in enumerate(words):
        regions, _ = label(index == number)
        sizes = np.bincount(regions.ravel())[1:]
        if sizes.size and sizes.max() >= LARGE:
            inside = (regions == 1 + sizes.argmax()) & ~ROBOT
            # A word is wider than high.
            depth = distance_transform_edt(np.pad(inside, 1), sampling=(3, 1))[1:-1, 1:-1]
            deepest = np.argwhere(depth == depth.max())
            away = np.linalg.norm(deepest - deepest.mean(axis=0), axis=1)
            row, column = deepest[away.argmin()]
            yield text, PLACE[column], PLACE[row]


def _robot(axes: Any, x: float, y: float, theta: float, colour: str = 'black') -> None:
    axes.annotate('', (x + 0.4 * cos(theta), y + 0.4 * sin(theta)), (x, y),
                  arrowprops={'arrowstyle': '-|>', 'color': colour, 'linewidth': 1.5,
                              'shrinkA': 0, 'shrinkB': 0})
    axes.plot(x, y, 'o', color=colour, markersize=4)


EXERCISE_2_6 = GalleryEntry(
    'exercise-2.6', 'A two-wheeled robot', 'Exercise 2.6', (
        "$x' = v cos θ$, $y' = v sin θ$, $θ' = ω$ with $|v| ≤ L$, $|ω| ≤ M$, from one "
        'configuration to another in minimum time. Show that the robot drives at full speed, '
        'forwards or backwards, along straight lines and turns at the maximum rate.',),
    exercise_2_6,
    'With $θ$ measured from the $x$ axis, $ω = +M$ is the left turn; “hard left ($ω = -M$) or '
    'hard right ($ω = +M$)” is reversed. And “any optimal trajectory” must read “some optimal '
    "trajectory”: a turn in place by 90 degrees takes at least $(π/2)/M$, since $|θ'| ≤ M$, and "
    'that is attained without moving ($v = 0$) as well as by three arcs.')
