# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Draw the folders of the package and what they import of each other, as SVG.

Rooms are boxes in the rows of `house`; the folders of the solver are boxes inside of it. An arrow
from A to B, with the number of imports, says that A imports B. To keep the picture readable, an
arrow is left out if it would cross a box, or if it skips a row or a column and other imports lead
from A to B as well. The box of A then names B after "also". Imports that break a rule are red.
"""

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from html import escape
import math
import textwrap

from house import Edges, find_circles, House, room, row, ROWS, within

SOLVER = 'core.solver'
WIDTH, PAD, GAP, COLUMN_GAP = 1200.0, 16.0, 50.0, 44.0
# Parts of the width for rows with one room: arrows from above pass the narrower ones.
NARROW, WIDER = 0.7, 0.12
SIZES = {'name': 19.0, 'inner': 17.0, 'text': 15.0, 'also': 14.0, 'count': 15.0}
LETTER, LINE = 0.55, 1.32   # of its size: mean width of a letter, height of a line
INK, PALE, EDGE, ARROW, WRONG = '#1b2733', '#53616e', '#8a97a3', '#0b5cad', '#c62828'
ROS, CORE, INNER = '#fdf3e3', '#eaf2fa', '#ffffff'
FIXED = '\u00a0'   # a space at which no line breaks

Point = tuple[float, float]
Arrow = tuple[tuple[str, str], str, bool]   # from and to, SVG, whether it crosses a box


@dataclass(frozen=True)
class Box:
    """A folder as a rectangle with lines of text, each a style and a text; y is down."""

    name: str
    x: float
    y: float
    width: float
    height: float
    lines: tuple[tuple[str, str], ...]
    fill: str

    @property
    def right(self) -> float:
        """Return the right side."""
        return self.x + self.width

    @property
    def bottom(self) -> float:
        """Return the lower side."""
        return self.y + self.height


def draw(house: House) -> str:
    """Return the picture as an SVG element."""
    edges, inside = house.edges(room), house.edges(_solver_folder)
    shown, drawn = _between_rows(edges), direct(inside)
    while True:   # what is not drawn is named in a box, which may grow
        boxes, inner = place(house, edges - shown, inside - drawn)
        between = _arrows_between_rows(boxes, shown, edges)
        within_solver = _arrows_inside(inner, drawn, circular(inside))
        crossing = {edge for edge, _, hidden in between + within_solver if hidden}
        if not crossing:
            break
        shown, drawn = _without(shown, crossing), _without(drawn, crossing)
    parts = [_box(box) for box in (*boxes.values(), *inner.values())]
    parts += [arrow for _, arrow, _ in between + within_solver]
    height = max(box.bottom for box in boxes.values()) + PAD
    return (f'<svg class="house" xmlns="http://www.w3.org/2000/svg" role="img" '
            f'viewBox="0 0 {WIDTH:.0f} {height:.0f}" font-family="system-ui, sans-serif">'
            '<title>The folders of obc_ros and the imports between them</title>'
            f'{_heads()}<rect width="100%" height="100%" fill="#ffffff"/>{"".join(parts)}</svg>')


# Which imports are drawn


def direct(edges: Edges) -> Edges:
    """Return the edges that no longer way replaces; of a circle all."""
    graph = defaultdict(set)
    for source, target in edges:
        graph[source].add(target)
    circle = {name: index for index, part in enumerate(find_circles(edges)) for name in part}

    def leads(source: str, target: str) -> bool:
        seen, waiting = {source}, [source]
        while waiting:
            new = graph[waiting.pop()] - seen
            seen |= new
            waiting += new
        return target in seen

    def is_replaced(source: str, target: str) -> bool:
        if circle.get(source, source) == circle.get(target, target):
            return False
        return any(leads(other, target) for other in graph[source] - {target}
                   if not leads(other, source) and not leads(target, other))

    return Counter({edge: count for edge, count in edges.items() if not is_replaced(*edge)})


def circular(edges: Edges) -> set[tuple[str, str]]:
    """Return the edges that are part of a circle."""
    return {(a, b) for part in find_circles(edges) for a, b in edges if a in part and b in part}


def _without(edges: Edges, some: set[tuple[str, str]]) -> Edges:
    return Counter({edge: count for edge, count in edges.items() if edge not in some})


def columns_of(names: Collection[str], edges: Edges) -> list[list[str]]:
    """
    Return names in columns so that imports lead to the right; those of a circle share one.

    Each stands as far to the right as it may. In a column those on long ways come first.
    """
    part = {name: name for name in names}
    for circle in find_circles(edges):
        part |= dict.fromkeys(circle, circle[0])
    graph = {(part[a], part[b]) for a, b in edges if part[a] != part[b]}

    def length(name: str, *, forward: bool) -> int:
        ends = [b if forward else a for a, b in graph if (a if forward else b) == name]
        return max((1 + length(end, forward=forward) for end in ends), default=0)

    ahead = {each: length(each, forward=True) for each in set(part.values())}
    ways = {each: ahead[each] + length(each, forward=False) for each in ahead}
    count = max(ahead.values(), default=-1) + 1
    return [sorted((name for name in names if count - 1 - ahead[part[name]] == index),
                   key=lambda name: (-ways[part[name]], name)) for index in range(count)]


def _solver_folder(folder: str) -> str | None:
    return folder if within(folder, SOLVER) and folder != SOLVER else None


def _between_rows(edges: Edges) -> Edges:
    """Return the edges to draw between rooms."""
    wrong = _upward(edges) | circular(edges)
    down = _without(edges, wrong)
    shown = {(a, b) for a, b in direct(down) if row(a) != row(b) or _are_neighbours(a, b)}
    shown |= {(a, b) for a, b in down if _row(b) - _row(a) == 1}
    return Counter({edge: edges[edge] for edge in shown | wrong})


def _upward(edges: Edges) -> set[tuple[str, str]]:
    return {(a, b) for a, b in edges if _row(a) > _row(b)}


def _row(name: str) -> int:
    found = row(name)
    assert found is not None
    return found


def _are_neighbours(a: str, b: str) -> bool:
    names = ROWS[_row(a)]
    return abs(names.index(a) - names.index(b)) == 1


# Where the boxes stand


def place(house: House, also: Edges, also_inside: Edges
          ) -> tuple[dict[str, Box], dict[str, Box]]:
    """Return the boxes of the rooms and of the solver's folders, which name the edges given."""
    boxes: dict[str, Box] = {}
    inner: dict[str, Box] = {}
    whole, gap = WIDTH - 2 * PAD, 1.4 * COLUMN_GAP
    y, single = PAD, 0   # rows with one room just above
    for names in ROWS:
        present = [name for name in names if name in house.sentences]
        if not present:
            continue
        single = single + 1 if len(present) == 1 and present != [SOLVER] else 0
        width = (whole * min(NARROW + WIDER * (single - 1), 1.0) if single else
                 (whole - gap * (len(present) - 1)) / len(present))
        x = (WIDTH - width) / 2 if single else PAD
        made: dict[str, Box] = {}
        for name in present:
            made[name] = _text_box(house, name, (x, y, width), also)
            x += width + gap
        if SOLVER in made:
            outer = made[SOLVER]
            inner = _place_inside(house, outer, also_inside)
            bottom = max((box.bottom + PAD for box in inner.values()), default=outer.bottom)
            made[SOLVER] = replace(outer, height=bottom - y)
        height = max(box.height for box in made.values())
        boxes |= {name: replace(box, height=height) for name, box in made.items()}
        y += height + GAP
    return boxes, inner


def _place_inside(house: House, outer: Box, also: Edges) -> dict[str, Box]:
    """Return the boxes of the solver's folders, in columns."""
    folders = [name for name in house.sentences if _solver_folder(name)]
    columns = columns_of(folders, house.edges(_solver_folder))
    width = (outer.width - 2 * PAD - COLUMN_GAP * (len(columns) - 1)) / max(len(columns), 1)
    boxes: dict[str, Box] = {}
    y = outer.bottom + PAD
    for level in range(max(map(len, columns), default=0)):
        made = {column[level]: _text_box(
            house, column[level], (outer.x + PAD + index * (width + COLUMN_GAP), y, width), also)
            for index, column in enumerate(columns) if level < len(column)}
        boxes |= made
        y = max(box.bottom for box in made.values()) + COLUMN_GAP
    return boxes


def _text_box(house: House, name: str, at: tuple[float, float, float], also: Edges) -> Box:
    """Return the box of a folder: its name, files, sentence, and what else it imports."""
    x, y, width = at
    is_inner = _solver_folder(name) is not None
    files = len(house.files.get(name, ()))
    label, count = name.replace('.', '/'), f'{files} files'
    lines = [('inner', _last(name)), ('also', count)] if is_inner else [('name', label), (
        'also', count)] if len(_wrapped('name', f'{label}  {count}', width)) > 1 else [
        ('name', f'{label}\t{count}')]
    lines += _wrapped('text', house.sentences[name].replace('`', ''), width)
    if name == SOLVER:
        lines += _wrapped('also', f'files: {", ".join(map(_last, house.files[name]))}', width)
    elif folders := [each for each in house.sentences if within(each, name) and each != name]:
        lines += _wrapped('also', 'folders: ' + ', '.join(
            f'{each.removeprefix(name + ".").replace(".", "/")}{FIXED}{len(house.files[each])}'
            for each in folders), width)
    others = [f'{_last(b)}{FIXED}{count}' for (a, b), count in sorted(also.items()) if a == name]
    lines += _wrapped('also', f'also: {", ".join(others)}' if others else '', width)
    height = 1.2 * PAD + sum(LINE * SIZES[style] for style, _ in lines)
    fill = INNER if is_inner else CORE if within(name, 'core') else ROS
    return Box(name, x, y, width, height, tuple(lines), fill)


def _last(name: str) -> str:
    return name.rpartition('.')[2]


def _wrapped(style: str, text: str, width: float) -> list[tuple[str, str]]:
    columns = int((width - 1.4 * PAD) / (LETTER * SIZES[style]))
    return [(style, line) for line in textwrap.wrap(text, max(columns, 8))]


# Boxes and arrows as SVG


def _heads() -> str:
    return '<defs>' + ''.join(
        f'<marker id="house-{colour[1:]}" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="10" '
        f'markerHeight="10" markerUnits="userSpaceOnUse" orient="auto">'
        f'<path d="M0 0L10 5L0 10z" fill="{colour}"/></marker>'
        for colour in (ARROW, WRONG)) + '</defs>'


def _box(box: Box) -> str:
    parts = [f'<rect x="{box.x:.1f}" y="{box.y:.1f}" width="{box.width:.1f}" '
             f'height="{box.height:.1f}" rx="6" fill="{box.fill}" stroke="{EDGE}"/>']
    y = box.y + 0.5 * PAD
    for style, text in box.lines:
        size = SIZES[style]
        y += LINE * size
        title, _, right = text.partition('\t')
        weight = ' font-weight="650"' if style in ('name', 'inner') else ''
        colour = PALE if style == 'also' else INK
        parts.append(_text((box.x + 0.7 * PAD, y - 0.3 * size), size, colour, title, weight))
        if right:
            parts.append(_text((box.right - 0.7 * PAD, y - 0.3 * size), SIZES['also'], PALE,
                               right, ' text-anchor="end"'))
    return f'<g data-folder="{box.name}">{"".join(parts)}</g>'


def _text(at: Point, size: float, colour: str, text: str, more: str = '') -> str:
    return (f'<text x="{at[0]:.1f}" y="{at[1]:.1f}" font-size="{size:g}" fill="{colour}"{more}>'
            f'{escape(text)}</text>')


def _arrow(edge: tuple[str, str], ends: tuple[Point, Point], count: int, is_wrong: bool) -> str:
    """Return an arrow, the thicker the more imports, with their number beside its middle."""
    (x1, y1), (x2, y2) = ends
    colour, width = WRONG if is_wrong else ARROW, 1.4 + math.log10(count)
    is_upright = abs(y2 - y1) > abs(x2 - x1)
    at = (x1 + x2) / 2 + (7 if is_upright else -2), (y1 + y2) / 2 + (5 if is_upright else -6)
    anchor = '' if is_upright else ' text-anchor="middle"'
    return (f'<line data-from="{edge[0]}" data-to="{edge[1]}" x1="{x1:.1f}" y1="{y1:.1f}" '
            f'x2="{x2:.1f}" y2="{y2:.1f}" stroke="{colour}" '
            f'stroke-width="{width:.1f}" marker-end="url(#house-{colour[1:]})"/>'
            + _text(at, SIZES['count'], colour, str(count), f' font-weight="600"{anchor}'))


def _arrows_between_rows(boxes: dict[str, Box], shown: Edges, edges: Edges) -> list[Arrow]:
    """Return the arrows between rooms: level within a row, else upright if one is below."""
    wrong = _upward(edges) | circular(edges)
    taken: list[tuple[float, float, float]] = []   # x, from y, to y
    arrows = []
    for (a, b), count in sorted(shown.items(), key=lambda item: (
            abs(_row(item[0][1]) - _row(item[0][0])), item[0])):
        source, target, hidden = boxes[a], boxes[b], False
        if _row(a) == _row(b):
            forward = source.x < target.x
            y = source.y + (0.35 if forward else 0.65) * source.height
            ends = (source.right, target.x) if forward else (source.x, target.right)
            points = (ends[0], y), (ends[1], y)
        else:
            down = source.y < target.y
            y1, y2 = (source.bottom, target.y) if down else (source.y, target.bottom)
            if source.right < target.x or target.right < source.x:   # none is below the other
                forward = source.x < target.x
                points = ((source.right - 30, y1), (target.x + 30, y2)) if forward else (
                    (source.x + 30, y1), (target.right - 30, y2))
                hidden = abs(_row(b) - _row(a)) > 1
            else:
                x, hidden = _free(boxes.values(), source, target, taken)
                taken.append((x, min(y1, y2), max(y1, y2)))
                points = (x, y1), (x, y2)
        is_wrong = (a, b) in wrong
        arrows.append(((a, b), _arrow((a, b), points, count, is_wrong),
                       hidden and not is_wrong))
    return arrows


def _free(boxes: Collection[Box], source: Box, target: Box,
          taken: list[tuple[float, float, float]]) -> tuple[float, bool]:
    """Return where an upright line leads from one box to the other, and whether it hits one."""
    low, high = max(source.x, target.x) + 14, min(source.right, target.right) - 40
    upper, lower = sorted((source, target), key=lambda box: box.y)
    top, bottom = upper.bottom, lower.y
    between = [box for box in boxes if box.y > top - 1 and box.bottom < bottom + 1]
    middle = (low + high) / 2

    def hits(x: float) -> bool:
        return any(box.x - 10 < x < box.right + 10 for box in between)

    def cost(x: float) -> tuple[bool, int, float]:
        near = sum(abs(x - other) < 46 and y1 < bottom and top < y2 for other, y1, y2 in taken)
        return hits(x), near, abs(x - middle)

    steps = max(int((high - low) / 6), 1)
    best = min((low + (high - low) * index / steps for index in range(steps + 1)), key=cost)
    return best, hits(best)


def _arrows_inside(boxes: dict[str, Box], drawn: Edges, wrong: set[tuple[str, str]]
                   ) -> list[Arrow]:
    """Return the arrows between the folders of the solver."""
    return [(edge, _arrow(edge, _ends(boxes[edge[0]], boxes[edge[1]]), count, edge in wrong),
             _crosses(edge, boxes) and edge not in wrong) for edge, count in drawn.items()]


def _ends(source: Box, target: Box) -> tuple[Point, Point]:
    """Return where an arrow from one folder of the solver to another begins and ends."""
    if abs(source.x - target.x) < 1:   # of one circle, hence of one column
        down = source.y < target.y
        x = source.x + (0.35 if down else 0.6) * source.width
        ends = (source.bottom, target.y) if down else (source.y, target.bottom)
        return (x, ends[0]), (x, ends[1])
    y = max(source.y, target.y) + 30.0
    if y < min(source.bottom, target.bottom):
        return (source.right, y), (target.x, y)
    if source.y > target.y:   # up
        return (source.right, source.y + 14), (target.x, target.bottom - 10)
    return (source.right, source.bottom - 10), (target.x, target.y + 14)


def _crosses(edge: tuple[str, str], boxes: dict[str, Box]) -> bool:
    """Return whether an arrow of the solver crosses a box that is neither of its ends."""
    (x1, y1), (x2, y2) = _ends(boxes[edge[0]], boxes[edge[1]])
    points = [(x1 + (x2 - x1) * part / 100, y1 + (y2 - y1) * part / 100) for part in range(101)]
    others: Iterable[Box] = (box for name, box in boxes.items() if name not in edge)
    return any(box.x - 4 < x < box.right + 4 and box.y - 4 < y < box.bottom + 4
               for box in others for x, y in points)
