# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
`obc gallery`: examples, theorems and exercises of chapter 2 and beyond, by running nodes.

Without ROS 2, it shows the results that the package has with it.

``DIR/index.html`` is the page, ``DIR/NAME.png`` the figure of an entry, ``DIR/gallery.json`` the
numbers. The page shows the PNG files; ``--format`` adds PDF and SVG. Results of other entries in
DIR are kept. Loops are recorded in ``DIR/recordings``.
"""

import argparse
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
import sys
from typing import Any

from obc_ros.api.figures.files import FORMATS
from obc_ros.book.kept import read_kept, show_kept
from obc_ros.cli import results
from obc_ros.cli.processes import lock_folder
from obc_ros.cli.terminal import Parser
from obc_ros.core.text.errors import quote, StatementError, suggest_name
from obc_ros.ros.installation import explain_missing_ros, require_ros


def add_arguments(parser: Parser) -> None:
    """Declare the arguments of `obc gallery`."""
    parser.add_argument('names', nargs='*', metavar='NAME', help='entries (default: all)')
    parser.add_argument('--out', type=Path, default=Path('out/gallery'), metavar='DIR',
                        help='directory of page, figures and numbers (default: out/gallery)')
    results.add_format(parser)
    parser.add_argument('--csv', type=Path, metavar='OUT',
                        help='with --check: write a row for each file, for a spreadsheet')
    instead = parser.add_mutually_exclusive_group()
    instead.add_argument('--list', action='store_true', help='list the entries')
    instead.add_argument('--sheet', type=Path, metavar='FILE',
                         help='write an exercise sheet of the chapter, a YAML file')
    instead.add_argument('--check', type=Path, nargs='+', metavar='FILE',
                         help='check the answers of a sheet and say why wrong ones are wrong; of '
                              'several sheets, count them')
    instead.add_argument('--slides', action='store_true',
                         help='make slides.html of the figures in the directory of --out')
    parser.limit('NAME', without=['--sheet', '--check'])
    parser.limit('--out', without=['--list', '--sheet', '--check'])
    parser.limit('--format', without=['--list', '--sheet', '--check', '--slides'])
    parser.limit('--csv', needs=['--check'])


def run(args: argparse.Namespace) -> int:
    """Run entries; return 0 if all numbers are in tolerance, 1 if not, 2 for an unknown name."""
    if args.csv and args.csv.exists() and any(
            each.exists() and args.csv.samefile(each) for each in args.check):
        print(f'obc gallery: --csv would overwrite {args.csv}, which is to be checked',
              file=sys.stderr)
        return 2
    if args.sheet or args.check or args.slides:
        return _teach(args)
    kept = read_kept()
    # For one version, the names of examples before `example-` was part of them.
    args.names = [f'example-{name}' if f'example-{name}' in kept else name for name in args.names]
    unknown = [name for name in args.names if name not in kept]
    if unknown:
        print(f"obc gallery: no entry '{quote(unknown[0])}'{_suggest(unknown[0], kept)}; "
              f"there are {', '.join(kept)}", file=sys.stderr)
        return 2
    chosen = [record for name, record in kept.items() if not args.names or name in args.names]
    if args.list:
        width = max(len(record['name']) for record in chosen)
        print('\n'.join(f'{record["name"]:{width}}  {record["title"]}' for record in chosen))
        return 0
    if any(each not in FORMATS[:1] for each in args.format):
        require_ros('--format')
    with lock_folder(args.out):
        return show_kept(chosen, args.out) if explain_missing_ros() else _compute(chosen, args)


def list_entries() -> list[str]:
    """Return the names of the entries."""
    return list(read_kept())


def _compute(chosen: Sequence[Mapping[str, Any]], args: argparse.Namespace) -> int:
    from obc_ros.book.chapter.all import ENTRIES  # matplotlib takes a second
    from obc_ros.book.records import work_and_write  # imports ROS
    names = [record['name'] for record in chosen]
    return work_and_write([entry for entry in ENTRIES if entry.name in names], args.out,
                          [entry.name for entry in ENTRIES],
                          tuple(dict.fromkeys(('png', *args.format))))


def _teach(args: argparse.Namespace) -> int:
    """Write or check a sheet, or write slides; return the exit status."""
    if args.slides:
        from obc_ros.book.slides import write_slides
        print(write_slides(args.out, args.names))
        return 0
    # These import CasADi.
    from obc_ros.book.teaching.class_table import report_class
    from obc_ros.book.teaching.sheet import write_sheet
    if args.sheet:
        write_sheet(args.sheet)
        print(f'{args.sheet}; obc gallery --check {args.sheet} checks the answers')
        return 0
    try:
        return report_class(args.check, args.csv)
    except StatementError as error:
        print(f'obc gallery: {error}', file=sys.stderr)
        return 2


def _suggest(name: str, known: Collection[str]) -> str:
    """Return a suggestion; a number alone may be that of an exercise or a theorem."""
    longer = [each for each in known if each.endswith(f'-{name}')]
    return suggest_name(longer[0] if longer else name, known)
