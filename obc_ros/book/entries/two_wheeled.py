# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Exercise 2.6: a two-wheeled robot in minimum time, and maps of the words of its paths."""

from collections.abc import Iterator, Sequence
from math import asin, atan2, cos, hypot, pi, sin, sqrt
from typing import Any

from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.patheffects import Normal, Stroke
import numpy as np
from obc_ros.api.figures.bodies import draw_two_wheeled
from obc_ros.book.entry import ComparedRow, create_panels, EntryResult, GalleryEntry, label_axes
from obc_ros.book.extremals import find_least_times
from obc_ros.book.runner import Desk, Trajectory
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems.reeds_shepp import find_shortest_path, Segment
from scipy.ndimage import binary_erosion, distance_transform_edt, gaussian_filter, label

Pose = tuple[float, float, float]

SIDE, POINTS = 3.0, 20  # of the map [m]
# Centres of squares: not on the lines where words of one or two arcs are fastest.
PLACE = (np.arange(POINTS) + 0.5) * 2 * SIDE / POINTS - SIDE
FINE = 481  # goals along a side of the maps that are drawn: a square is a pixel or two
# Not on the lines where words of few arcs are fastest.
GRID = np.linspace(-SIDE, SIDE, FINE) + 1e-6
EACH = 4  # every fourth goal is compared with its reference
COARSE = GRID[::EACH]  # where words are placed
LETTER, LINE = 4, 7  # squares of it that a letter is wide, and a word is high
ROBOT = np.maximum.outer(np.abs(COARSE), np.abs(COARSE)) < 0.35  # where the robot is drawn
HEADINGS = (0.0, pi / 2)
# Where the lines of 2 s and 4 s have their labels: beside the words.
TIMES = (((-1.0, 0.95), (-2.7, 2.55)), ((1.25, 1.25), (2.75, 2.75)))
STRAIGHT = ((2.0, 0.0, 0.0), (-1.5, 0.0, 0.0))
TURNS = ((0.0, 0.0, pi / 2), (0.0, 0.0, -1.0), (0.0, 0.0, 3.0))
TANGENTS = ((2.0, 1.0, 0.5), (3.0, 1.0, 0.2), (4.0, 1.5, 0.0))  # reached by L+S+R+
OTHERS = ((0.0, 1.0, 0.0), (-1.0, 2.0, 0.0), (2.0, -1.0, 2.0), (1.0, 0.3, -2.0))
PRINCIPLE = 'shortest extremal of the maximum principle'
MIDDLE = 2 * asin(sin(pi / 4) / 2)  # [rad] the middle arc of a turn by 90 degrees
SHOWN = (TANGENTS[0], OTHERS[0], (-1.0, 2.0, 0.0), (1.0, -1.5, pi / 2), TURNS[0])
# Blue, yellow and grey differ in hue or lightness for every colour vision; letters are black.
COLOURS = {
    'CC|C': '#9CC3E4', 'C|CC': '#F2D975', 'C|C|C': '#FFFFFF', 'CSC': '#D6E6F4', 'CC|CC': '#AAAAAA',
    'C|CC|C': '#D9B13B', 'CSC|C': '#C9C9C9', 'C|CSC': '#FBF3C0', 'C|CSC|C': '#6A9FD0',
    'CCC': '#E3C3DC', 'CC': '#E6D9B8', 'CS': '#B8D8C8', 'SC': '#8FB8A4', 'C|C': '#C7B0E0',
    'C': '#F0B090', 'S': '#D0E8A8'}


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
        omega = np.concatenate([path.u['omega'] for path in paths])
        name = f'map of {len(goals)} goals, $θ_f = {heading:.4g}$'
        rows += [
            ComparedRow(f'{name}: $T$ [s]', [path.T for path in paths], find_least_times(goals),
                        PRINCIPLE),
            ComparedRow(f'{name}: the arcs end at the goal', ends, np.array(goals),
                        'arcs and lines integrated'),
            ComparedRow(f'{name}: $|v| = L$',
                        np.concatenate([np.abs(path.u['v']) for path in paths]),
                        np.ones(sum(path.t.size for path in paths)), 'the exercise'),
            ComparedRow(f'{name}: $ω ∈ {{-M, 0, M}}$', omega,
                        np.clip(np.round(omega), -1, 1), 'the exercise'),
            ComparedRow(f'{name}: $T$ at the mirror image', *_mirrored(goals, paths),
                        'symmetry of the robot')]
    fine = [map_words(heading) for heading in HEADINGS]
    points = np.array([(x, y) for y in COARSE for x in COARSE])
    rows += [ComparedRow(
        f'fine map, $θ_f = {heading:.4g}$: $T$ [s]', time[::EACH, ::EACH].ravel(),
        find_least_times(np.column_stack([points, np.full(len(points), heading)])), PRINCIPLE)
        for heading, (_, _, time) in zip(HEADINGS, fine, strict=True)]
    return EntryResult(rows, _draw_maps(fine), (
        'The fastest word from the origin (heading to the right) to each goal, with $L = M = 1$. '
        'C is a turn, S a straight line, | a change of direction. Dotted: lines of equal time, '
        f'every second. The regions are drawn on a grid of {2 * SIDE / (FINE - 1):g} m, '
        'solved without the nodes. Second figure: five paths with their words, in the colours of '
        'the map.',),
        f'Turning by 90 degrees in place takes {turns[0].T:.9f} s at full speed, with '
        f'switches at {turns[0].switching_times[0]:.6f} and {turns[0].switching_times[1]:.6f} s; '
        f'with $v = 0$ it takes {spot.T:.9f} s.', {'paths': _draw_paths(shown)})


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
                    find_least_times(OTHERS), PRINCIPLE),
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


def _mirrored(goals: list[Pose], paths: list[Trajectory]) -> tuple[Array, Array]:
    """Return T, and T at the goal that mirroring (and reversing the path) gives."""
    times = {(round(x, 6), round(y, 6)): path.T
             for (x, y, _), path in zip(goals, paths, strict=True)}
    # Left for right; or the reversed path, mirrored: -(x, y) rotated by -theta.
    return np.array([*times.values()]), np.array([
        times[(x, -y) if goals[0][2] == 0.0 else (y, x)] for x, y in times])


def map_words(heading: float) -> tuple[list[str], Array, Array]:
    """Return the words on a fine grid of goals, their numbers (FINE, FINE), and T there."""
    paths = [find_shortest_path((0.0, 0.0, 0.0), (x, y, heading), 1.0)
             for y in GRID.tolist() for x in GRID.tolist()]
    spelled = [spell_segments(path.segments) for path in paths]
    words = sorted(set(spelled), key=_order)
    return (words, np.reshape([words.index(each) for each in spelled], (FINE, FINE)),
            np.reshape([path.length for path in paths], (FINE, FINE)))


def spell_segments(segments: Sequence[Segment]) -> str:
    """Return the word of a path of a car as `spell_path` does."""
    text, before = '', 0.0
    for steering, length in segments:
        text += ('|' if before * length < 0 else '') + ('S' if steering == 'S' else 'C')
        before = length
    return text


def _order(word: str) -> tuple[int, str]:
    return len(word.replace('|', '')), word


def _draw_maps(maps: Sequence[tuple[list[str], Array, Array]]) -> Figure:
    figure, (axes,) = create_panels(1, 2, 4.9)
    shown = sorted({word for words, _, _ in maps for word in words}, key=_order)
    for plot, heading, (words, index, time), places in zip(axes, HEADINGS, maps, TIMES,
                                                           strict=True):
        for number, word in enumerate(words):
            mask = (index == number).astype(float)
            plot.contourf(GRID, GRID, mask, levels=[0.5, 2.0], colors=[COLOURS[word]])
            plot.contour(GRID, GRID, gaussian_filter(mask, 1.0), levels=[0.5], colors='black',
                         linewidths=1.1)
        for levels in ((1, 3, 5), (2, 4)):
            lines = plot.contour(GRID, GRID, time, levels=levels, colors='0.35', linewidths=0.8,
                                 linestyles=':')
        plot.clabel(lines, fmt='%g s', manual=places)
        for word, x, y in _places(index[::EACH, ::EACH], words):
            plot.text(x, y, word, ha='center', va='center', zorder=4)
        draw_two_wheeled(plot, 0.0, 0.0, 0.0, width=0.25, colour='white')
        plot.set(aspect='equal', xlim=(-SIDE, SIDE), ylim=(-SIDE, SIDE), xticks=range(-3, 4),
                 yticks=range(-3, 4))
        plot.grid(False)
        degrees = np.degrees(heading)
        label_axes(plot, f'goal heading $\\theta_f = {degrees:.0f}$°', '$x_f$ [m]', '$y_f$ [m]')
    figure.legend(handles=[Patch(facecolor=COLOURS[word], edgecolor='black', label=word)
                           for word in shown], loc='outside lower center',
                  ncols=-(-len(shown) // 2), handlelength=1.2)
    return figure


def _draw_paths(shown: list[Trajectory]) -> Figure:
    figure, axes = create_panels(2, 3, 3.1)
    *plots, empty = axes.ravel()
    empty.remove()
    for plot, path in zip(plots, shown, strict=True):
        word, back = spell_path(path), np.where(path.u['v'] < 0, 1.0, np.nan)
        plot.plot(path.x['px'], path.x['py'], color=COLOURS[word], linewidth=4,
                  path_effects=[Stroke(linewidth=6, foreground='black'), Normal()])
        plot.plot(path.x['px'] * back, path.x['py'] * back, color='black', linewidth=6)
        draw_two_wheeled(plot, 0.0, 0.0, 0.0, width=0.4, colour='white')
        x, y, theta = (path.x[name][-1] for name in ('px', 'py', 'theta'))
        draw_two_wheeled(plot, x, y, theta, width=0.4, colour=COLOURS[word])
        middle = np.array([path.x[name].min() + path.x[name].max() for name in ('px', 'py')]) / 2
        plot.set(aspect='equal', xlim=middle[0] + [-1.6, 1.6], ylim=middle[1] + [-1.6, 1.6])
        plot.set(xticks=np.arange(np.ceil(middle[0] - 1.6), middle[0] + 1.6),
                 yticks=np.arange(np.ceil(middle[1] - 1.6), middle[1] + 1.6))
        label_axes(plot, f'{word}, {path.T:.2f} s', '$x$ [m]', '$y$ [m]')
    figure.legend(handles=[
        Patch(facecolor='white', edgecolor='black', label='start'),
        Patch(facecolor='0.7', edgecolor='black', label='goal; forwards:\ncolour of the word'),
        Patch(facecolor='black', label='backwards')],
        loc='center', bbox_to_anchor=(0.85, 0.27))
    return figure


def _places(index: Array, words: list[str]) -> Iterator[tuple[str, float, float]]:
    """Yield each word with the middle (x, y) of its regions in which the word has room."""
    for number, text in enumerate(words):
        regions, count = label((index == number) & ~ROBOT)
        for region in range(1, count + 1):
            inside = np.pad(regions == region, 1)
            width = LETTER * (2 * len(text) - text.count('|')) // 2
            room = binary_erosion(inside, np.ones((LINE, width)))[1:-1, 1:-1]
            if room.any():
                depth = distance_transform_edt(np.pad(room, 1))[1:-1, 1:-1]
                row, column = np.argwhere(depth == depth.max()).mean(axis=0).round().astype(int)
                yield text, COARSE[column], COARSE[row]


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
