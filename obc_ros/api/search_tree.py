# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The attempts of a search as a tree with cost, loss, work and result."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
import math

from obc_ros.core.ocp.solution import Attempt, Verdict
from obc_ros.core.text.errors import quote
from obc_ros.core.text.tables import Tabulated, ZERO

TREE_HEADER = ('attempt', 'cost', 'loss', 'work', 'result')
_LEAF = 'collocation'   # alone in an attempt it says nothing that the attempt does not
_WIDE = 60   # characters: largest width of the first column


_WITH_COST = Verdict.CONVERGED, Verdict.CERTIFIED, Verdict.ACCEPTED, Verdict.NOT_CERTIFIED


class SearchTree(tuple[Attempt, ...], Tabulated):
    """The attempts of a search, in order of their numbers; as text they are a tree."""

    _HEADER = TREE_HEADER

    @property
    def costs(self) -> int:
        """Return how many different costs the search has found."""
        return len({each.cost for each in self
                    if each.verdict in _WITH_COST and not math.isnan(each.cost)})

    def format(self, width: int | None = None) -> str:
        """Return the tree as a table without control characters, with lines cut off at a width."""
        if not self:
            return 'nothing: the request was answered without a search'
        rows = [TREE_HEADER, *self._rows()]
        widths = [min(_WIDE, max(len(row[0]) for row in rows)), *(
            max(len(row[k]) for row in rows) for k in (1, 2, 3))]
        lines = ('  '.join((_cut(row[0], widths[0]).ljust(widths[0]),
                            *(cell.rjust(room) for cell, room in zip(
                                row[1:4], widths[1:], strict=True)), row[4])).rstrip()[:width]
                 for row in rows)
        return '\n'.join(quote(line, None) for line in lines)

    def __str__(self) -> str:
        """Return the tree, or a sentence that there was no search."""
        return self.format()

    def __repr__(self) -> str:
        """Return how many attempts there are."""
        return f'<{self._title()}; print() shows the tree>'

    def _title(self) -> str:
        return f'SearchTree: {len(self)} attempts'

    def _rows(self) -> list[tuple[str, ...]]:
        children: dict[int, list[Attempt]] = defaultdict(list)
        for attempt in self:
            children[attempt.parent].append(attempt)
        return [(branch + _name(attempt), _number(attempt.cost, '.8g'),
                 _number(attempt.loss, '.0e'), str(attempt.work), _result(attempt))
                for branch, attempt in _walk(children, 0, '')]


def _walk(children: Mapping[int, Sequence[Attempt]], parent: int, indent: str
          ) -> Iterator[tuple[str, Attempt]]:
    """Yield attempts below a parent, each with the characters of its branch."""
    mine = children.get(parent, ())
    if parent and len(mine) == 1 and mine[0].method == _LEAF:
        return
    for attempt in mine:
        last = attempt is mine[-1]
        yield (indent + ('└─ ' if last else '├─ ') if parent else ''), attempt
        yield from _walk(children, attempt.number,
                         indent + ('   ' if last else '│  ') if parent else ' ')


def _name(attempt: Attempt) -> str:
    return f'{attempt.method}: {attempt.what}' if attempt.what else attempt.method


def _result(attempt: Attempt) -> str:
    return f'{attempt.verdict}: {attempt.why}' if attempt.why else str(attempt.verdict)


def _number(value: float, form: str) -> str:
    if math.isnan(value):
        return ''
    return '0' if abs(value) < ZERO else format(value, form)


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else f'{text[:width - 3]}...'
