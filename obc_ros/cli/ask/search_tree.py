# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The attempts of a solve, printed as a tree with cost, loss, work and result."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
import math
import shutil
import sys
from typing import Any

from obc_ros.cli.ask.problem_requests import Question
from obc_ros.core.text.errors import quote

HEADER = ('attempt', 'cost', 'loss', 'work', 'result')
_LEAF = 'collocation'   # alone in an attempt it says nothing that the attempt does not
_NARROW, _WIDE = 80, 60   # characters: least width of a line, largest width of the first column


def print_trees(questions: Sequence[Question]) -> None:
    """Print what was tried for each problem that a server has worked on."""
    for question in questions:
        if question.result is None:
            continue
        print(f'\n{question.label}: what was tried')
        if not question.result.attempts:
            print('nothing: the request was answered without a search')
            continue
        for line in format_tree(question.result.attempts):
            print(quote(line, None))


def format_tree(attempts: Sequence[Any]) -> list[str]:
    """
    Return the lines of a table whose first column is a tree.

    Parameters
    ----------
    attempts : sequence of Attempt
        Messages, in order of their numbers.

    Returns
    -------
    list of str
        A terminal's width; in a file as long as they are.

    """
    children: dict[int, list[Any]] = defaultdict(list)
    for attempt in attempts:
        children[attempt.parent].append(attempt)
    rows = [HEADER, *((branch + _name(attempt), _number(attempt.cost, '.8g'),
                       _number(attempt.loss, '.0e'), str(attempt.work), _result(attempt))
                      for branch, attempt in _walk(children, 0, ''))]
    widths = [min(_WIDE, max(len(row[0]) for row in rows)), *(
        max(len(row[k]) for row in rows) for k in (1, 2, 3))]
    room = (max(_NARROW, shutil.get_terminal_size().columns) if sys.stdout.isatty() else None)
    return ['  '.join((_cut(row[0], widths[0]).ljust(widths[0]),
                       *(cell.rjust(width) for cell, width in zip(
                           row[1:4], widths[1:], strict=True)), row[4])).rstrip()[:room]
            for row in rows]


def _walk(children: Mapping[int, Sequence[Any]], parent: int, indent: str
          ) -> Iterator[tuple[str, Any]]:
    """Yield attempts below a parent, each with the characters of its branch."""
    mine = children.get(parent, ())
    if parent and len(mine) == 1 and mine[0].method == _LEAF:
        return
    for attempt in mine:
        last = attempt is mine[-1]
        yield (indent + ('└─ ' if last else '├─ ') if parent else ''), attempt
        yield from _walk(children, attempt.number,
                         indent + ('   ' if last else '│  ') if parent else ' ')


def _name(attempt: Any) -> str:
    return f'{attempt.method}: {attempt.what}' if attempt.what else str(attempt.method)


def _result(attempt: Any) -> str:
    return f'{attempt.verdict}: {attempt.why}' if attempt.why else str(attempt.verdict)


def _number(value: float, form: str) -> str:
    return '' if math.isnan(value) else format(value, form)


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else f'{text[:width - 3]}...'
