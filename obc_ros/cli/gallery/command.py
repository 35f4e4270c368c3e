# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
`obc gallery`: examples, theorems and exercises of chapter 2, computed by running nodes.

``DIR/index.html`` is the page, ``DIR/NAME.png`` the figure of an entry, ``DIR/gallery.json`` the
numbers. The page shows the PNG files; ``--format`` adds PDF and SVG. Results of other entries in
DIR are kept. Loops are recorded in ``DIR/recordings``.
"""

import argparse
from collections.abc import Collection
from pathlib import Path
import sys

from obc_ros.cli import results
from obc_ros.cli.processes import lock_folder
from obc_ros.core.text.errors import quote, suggest_name


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `obc gallery`."""
    parser.add_argument('names', nargs='*', metavar='NAME', help='entries (default: all)')
    parser.add_argument('--out', type=Path, default=Path('out/gallery'), metavar='DIR',
                        help='directory of page, figures and numbers (default: out/gallery)')
    results.add_format(parser)
    parser.add_argument('--list', action='store_true', help='list the entries')


def run(args: argparse.Namespace) -> int:
    """Run entries; return 0 if all numbers are in tolerance, 1 if not, 2 for an unknown name."""
    from obc_ros.cli.gallery.chapter.all import ENTRIES  # matplotlib takes a second
    known = {entry.name: entry for entry in ENTRIES}
    unknown = [name for name in args.names if name not in known]
    if unknown:
        print(f"obc gallery: no entry '{quote(unknown[0])}'{_suggest(unknown[0], known)}; "
              f"there are {', '.join(known)}", file=sys.stderr)
        return 2
    if args.list:
        width = max(map(len, known))
        print('\n'.join(f'{name:{width}}  {entry.title}' for name, entry in known.items()))
        return 0
    chosen = [entry for name, entry in known.items() if not args.names or name in args.names]
    from obc_ros.cli.gallery.records import work_and_write  # imports ROS
    with lock_folder(args.out):
        return work_and_write(chosen, args.out, list(known),
                              tuple(dict.fromkeys(('png', *args.format))))


def _suggest(name: str, known: Collection[str]) -> str:
    """Return a suggestion; a number alone may be that of an exercise or a theorem."""
    longer = [each for each in known if each.endswith(f'-{name}')]
    return suggest_name(longer[0] if longer else name, known)
