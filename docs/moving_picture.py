# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Draw the moving picture of the README from a recording of the demonstration.

Called by ``make picture``, which flies the aircraft first::

    $ python docs/moving_picture.py out/aircraft docs/flight.gif
"""

from collections.abc import Iterator
from dataclasses import dataclass
import io
from pathlib import Path
import sys
import textwrap

import matplotlib as mpl
from mcap.reader import make_reader
import numpy as np
import obc_ros as obc
from obc_ros.api.figures.bodies import draw_aircraft
from obc_ros.cli.demo.aircraft import CHANGE, FIRST_STEP, GUST, REFUSAL, SECOND_STEP
from obc_ros.core.numerics.arrays import Array
from obc_ros.msg import Command, LqrDesign, State
from PIL import Image
from rclpy.serialization import deserialize_message

mpl.use('Agg')
from matplotlib.axes import Axes
from matplotlib.figure import Figure

MESSAGES = {'/state': State, '/command': Command, '/lqr_node/design': LqrDesign}
SIZE, DPI = (8.0, 3.9), 120  # [in], [1/in]
FRAME = 0.08  # [s] of the picture between two frames
COLOURS = 64  # of the palette
# Spans of the flight that are shown [s], and the simulated seconds that pass in a second.
SPANS = ((0.75, 8.0, 2.5), (11.6, 12.9, 0.5), (12.9, 14.4, 0.6), (14.4, 20.0, 2.5),
         (30.6, 33.6, 1.2), (36.6, 38.4, 0.6))
GUST_LENGTH = 1.0  # [s]
LINE = 40  # characters of a line of the terminal
PAPER, INK, COMMAND, GOOD, BAD = '#f4f4f2', '#222222', '#222222', '#00684c', '#b03a00'


@dataclass(frozen=True)
class Recording:
    """Times [s], states, inputs and designs of a recorded flight."""

    t: Array
    x: Array
    tu: Array
    u: Array
    designs: list[LqrDesign]


@dataclass(frozen=True)
class Line:
    """A line of the terminal: time [s] at which it appears, text and colour."""

    time: float
    text: str
    colour: str


def read_recording(folder: Path) -> Recording:
    """Return the flight that `obc demo` has recorded in a folder."""
    rows: dict[str, list[object]] = {topic: [] for topic in MESSAGES}
    times: dict[str, list[float]] = {topic: [] for topic in MESSAGES}
    with (folder / f'{folder.name}_0.mcap').open('rb') as file:
        for _, channel, message in make_reader(file).iter_messages(topics=list(MESSAGES)):
            rows[channel.topic].append(deserialize_message(message.data, MESSAGES[channel.topic]))
            times[channel.topic].append(message.log_time * 1e-9)
    return Recording(
        np.array(times['/state']), np.array([each.x for each in rows['/state']]),
        np.array(times['/command']), np.array([each.u for each in rows['/command']]),
        rows['/lqr_node/design'])


def list_lines(recording: Recording) -> list[Line]:
    """Return what the terminal shows: commands, and what lqr_node answers to them."""
    first, second, new = recording.designs[1], recording.designs[3], recording.designs[2]
    return [
        *_type(FIRST_STEP, f'set /lqr_node setpoint "{_format_goal(first)}"'),
        *_type(CHANGE, 'load /lqr_node example_2_5.yaml'),
        *_answer(CHANGE + 0.2, f'new gain: {_shorten(new.sentence)}', GOOD),
        *_type(SECOND_STEP, f'set /lqr_node setpoint "{_format_goal(second)}"'),
        Line(GUST, '# a gust from the left: 4 N for 1 s', BAD),
        *_type(REFUSAL, 'set /lqr_node Qu "[-0.1, 0.1]"'),
        *_answer(REFUSAL + 0.3, f'rejected: {_find_refusal()}. The gain in use stays.', BAD)]


def _type(time: float, words: str) -> Iterator[Line]:
    for index, part in enumerate(textwrap.wrap(f'ros2 param {words}', LINE - 2)):
        yield Line(time - 0.3, ('  ' if index else '$ ') + part, COMMAND)


def _answer(time: float, text: str, colour: str) -> Iterator[Line]:
    for part in textwrap.wrap(text, LINE - 2):
        yield Line(time, f'  {part}', colour)


def _shorten(sentence: str) -> str:
    return sentence.partition(': ')[2].partition(', minimum disk')[0]


def _format_goal(design: LqrDesign) -> str:
    return '[' + ', '.join(f'{each:g}' for each in design.xe) + ']'


def _find_refusal() -> str:
    try:
        obc.lqr(obc.systems['aircraft'], [1] * 6, [-0.1, 0.1])
    except obc.ObcError as error:
        return str(error)
    raise AssertionError('an indefinite Qu was accepted')


def list_times() -> Iterator[tuple[float, float]]:
    """Yield the time of each frame [s] of the flight, and how fast it passes."""
    for begin, end, speed in SPANS:
        for time in np.arange(begin, end, FRAME * speed):
            yield float(time), speed


def draw_frame(recording: Recording, lines: list[Line], time: float, speed: float) -> Image.Image:
    """Draw the flight and the terminal at a time [s]."""
    figure = Figure(figsize=SIZE, dpi=DPI, facecolor='white')
    plane = figure.add_axes((0.065, 0.13, 0.47, 0.85))
    _draw_plane(plane, recording, time)
    plane.text(0.02, 0.97, f't = {time:4.1f} s', transform=plane.transAxes, va='top',
               fontsize=11, color=INK)
    terminal = figure.add_axes((0.56, 0.0, 0.44, 1.0))
    terminal.set(xlim=(0, 1), ylim=(0, 1), xticks=[], yticks=[], facecolor=PAPER)
    for spine in terminal.spines.values():
        spine.set_visible(False)
    for row, line in enumerate(line for line in lines if line.time <= time):
        terminal.text(0.03, 0.96 - 0.062 * row, line.text, family='monospace', fontsize=10,
                      color=line.colour, va='top')
    picture = io.BytesIO()
    figure.savefig(picture, format='png')
    return Image.open(picture).convert('RGB')


def _draw_plane(axes: Axes, recording: Recording, time: float) -> None:
    now = int(np.searchsorted(recording.t, time, side='right')) - 1
    px, py, theta = recording.x[now, :3]
    design = [each for each in recording.designs if _stamp(each) <= time][-1]
    axes.plot(*recording.x[:now + 1, :2].T, color='#0072B2', linewidth=1.2)
    axes.plot(design.xe[0], design.xe[1], '+', color='#D55E00', markersize=16, markeredgewidth=2)
    forces = recording.u[int(np.searchsorted(recording.tu, time, side='right')) - 1]
    draw_aircraft(axes, px, py, theta, forces)
    if GUST <= time <= GUST + GUST_LENGTH:
        for height in (-0.25, 0.0, 0.25):
            axes.annotate('', (px - 0.5, py + height), (px - 1.0, py + height),
                          arrowprops={'arrowstyle': '->', 'color': BAD, 'linewidth': 1.6})
    axes.set(xlim=(-0.75, 2.75), ylim=(-0.65, 2.6), aspect='equal', xticks=range(3),
             yticks=range(3), xlabel='px [m]', ylabel='py [m]')
    axes.grid(alpha=0.3)
    for side in ('top', 'right'):
        axes.spines[side].set_visible(False)


def _stamp(design: LqrDesign) -> float:
    return float(design.header.stamp.sec + 1e-9 * design.header.stamp.nanosec)


def main(words: list[str]) -> int:
    """Draw the recording of a folder into a file."""
    folder, target = map(Path, words)
    recording = read_recording(folder)
    lines = list_lines(recording)
    frames = [draw_frame(recording, lines, *each) for each in list_times()]
    # The last frame has every colour: one palette keeps unchanged pixels equal.
    palette = frames[-1].quantize(COLOURS, dither=Image.Dither.NONE)
    reduced = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in frames]
    durations = [round(1000 * FRAME)] * (len(reduced) - 1) + [4000]
    reduced[0].save(target, save_all=True, append_images=reduced[1:], duration=durations, loop=0,
                    optimize=True)
    print(f'{target}: {len(frames)} frames, {target.stat().st_size / 1e6:.2f} MB')
    return 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
