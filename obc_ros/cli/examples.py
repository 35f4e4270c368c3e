# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
`obc examples`: the problem files that come with the package, listed, shown and copied.

They are the problems of the tests: each has a published or otherwise confirmed cost. `obc solve`
and `obc sweep` accept their names in place of a file.
"""

import argparse
from collections.abc import Collection
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
import sys

from obc_ros.cli.terminal import Parser, print_table
from obc_ros.core.text.errors import ObcError, quote, suggest_name
from obc_ros.core.text.example_files import find_example, list_examples, load_example
from obc_ros.core.text.tables import format_value


@dataclass(frozen=True)
class ProblemExample:
    """A problem file of the package; `category` is its first tag, `cost` known from `source`."""

    name: str
    title: str
    category: str
    tags: tuple[str, ...]
    cost: float
    source: str

    def matches(self, word: str) -> bool:
        """Return whether a word occurs in name, title, tags or source, in any case."""
        text = ' '.join((self.name, self.title, *self.tags, self.source))
        return word.casefold() in text.casefold()


def add_arguments(parser: Parser) -> None:
    """Declare the arguments of `obc examples`."""
    parser.add_argument('names', nargs='*', metavar='NAME',
                        help='print these files; without a name, list all')
    parser.add_argument('--list', action='store_true', help='list, do not print')
    parser.add_argument('--match', metavar='WORD', action='append', default=[],
                        help='list those with WORD in name, title, tags or source; repeatable')
    parser.add_argument('--long', action='store_true', help='list tags and sources, too')
    parser.add_argument('--copy', metavar='DIR', type=Path,
                        help='copy the files to DIR; existing files are kept')
    parser.limit('--list', without=['--copy'])
    parser.limit('--long', without=['NAME', '--copy'])


def run(args: argparse.Namespace) -> int:
    """List, print or copy examples; return 0, or 2 for an unknown name or no match."""
    known = list_examples()
    unknown = [name for name in args.names if name not in known]
    if unknown:
        print(f"obc examples: no example '{quote(unknown[0])}'{suggest_name(unknown[0], known)}; "
              'obc examples lists them', file=sys.stderr)
        return 2
    chosen = args.names or known
    if args.match:
        chosen = [each.name for each in map(read_example, chosen)
                  if all(map(each.matches, args.match))]
    if not chosen:
        print(f"obc examples: none has '{quote(' '.join(args.match))}'", file=sys.stderr)
        return 2
    if args.copy:
        return _copy(chosen, args.copy)
    if args.names and not args.list:
        print('\n'.join(find_example(name).read_text(encoding='utf-8') for name in chosen), end='')
    else:
        _list([read_example(name) for name in chosen], args.long)
    return 0


def read_example(name: str) -> ProblemExample:
    """Return what is known of an example."""
    found = load_example(name)
    source = found['source']
    return ProblemExample(
        name, _join(found['title']), found['tags'][0], tuple(found['tags']),
        found['expected']['objective'],
        _join(source['reference'] if isinstance(source, dict) else source))


def _join(text: str) -> str:
    return ' '.join(text.split())


def _list(examples: Collection[ProblemExample], is_long: bool) -> None:
    ordered = sorted(examples, key=lambda each: (each.category, each.name))
    for category, group in groupby(ordered, lambda each: each.category):
        print(f'{category}:')
        rows = [(each.name, format_value(each.cost, 7), each.title,
                 *((', '.join(each.tags[1:]), each.source) if is_long else ()))
                for each in group]
        print_table(('name', 'cost', 'problem', *(('tags', 'source') if is_long else ())), rows)
        print()
    print(f'{len(ordered)} examples; obc solve NAME solves one, obc examples NAME prints its file')


def _copy(names: Collection[str], folder: Path) -> int:
    """Copy files; return 1 if one of them exists already."""
    kept = [name for name in names if (folder / f'{name}.yaml').exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in names:
            if name not in kept:
                text = find_example(name).read_text(encoding='utf-8')
                (folder / f'{name}.yaml').write_text(text, encoding='utf-8')
    except OSError as error:
        raise ObcError(f'{folder} cannot be written: {error.strerror}') from error
    print(f'{len(names) - len(kept)} files copied to {folder}')
    if kept:
        print(f'obc examples: kept, as they exist: {quote(", ".join(kept), None)}',
              file=sys.stderr)
    return int(bool(kept))
