# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc interface`: show a message, service or action with the types of its fields."""

import argparse
from collections.abc import Iterator
import re

from obc_ros.cli.ros2.verbs import add_verbs
from obc_ros.cli.share_folders import share_directory
from obc_ros.cli.terminal import Parser
from obc_ros.core.text.errors import ObcError, quote

# A field or a constant of a message type: the type has a package or begins with a capital.
FIELD = re.compile(r'\s*(?P<type>(?:\w+/)?[A-Z]\w*|\w+/\w+)(?:\[[^]]*\])?\s+\w')
SEPARATOR = '---'


def add_arguments(parser: Parser) -> None:
    """Declare the verbs."""
    add_verbs(parser, {'show': (
        'show the fields of an interface', 'obc_ros/msg/LqrDesign', _arguments, show)})


def run(args: argparse.Namespace) -> int:
    """Run the verb, without ROS; return the exit status."""
    status: int = args.verb(args)
    return status


def _arguments(parser: Parser) -> None:
    parser.add_argument('type', help='obc_ros/msg/LqrDesign')
    comments = parser.add_mutually_exclusive_group()
    comments.add_argument('--all-comments', action='store_true',
                          help='include comments of nested fields')
    comments.add_argument('--no-comments', action='store_true', help='no comments')


def show(args: argparse.Namespace) -> int:
    """Print an interface; the fields of fields are indented."""
    for line in _lines(args.type, not args.no_comments, args.all_comments):
        print(line)
    return 0


def _lines(name: str, comments: bool, nested_comments: bool, depth: int = 0) -> Iterator[str]:
    package, kind, own = _parts(name)
    path = share_directory(package) / kind / f'{own}.{kind}'
    if not path.is_file():
        there = sorted(each.stem for each in path.parent.glob(f'*.{kind}'))
        raise ObcError(f'{name}: {package} has no {kind} {own}; it has {", ".join(there)}')
    for line in path.read_text(encoding='utf-8').splitlines():
        text = line.rstrip()
        if not comments:
            text = _without_comment(text)
            if not text:
                continue
        yield f'{depth * chr(9)}{text}' if text else ''
        found = FIELD.match(line)
        if found and line.strip() != SEPARATOR:
            of, _, field = found['type'].rpartition('/')
            yield from _lines(f'{of or package}/msg/{field}', nested_comments, nested_comments,
                              depth + 1)


def _parts(name: str) -> tuple[str, str, str]:
    found = re.fullmatch(r'(\w+)/(msg|srv|action)/(\w+)', name)
    if not found:
        raise ObcError(f"Invalid name '{quote(name)}'. Expected three parts separated by '/': "
                       'PACKAGE/msg/NAME, PACKAGE/srv/NAME or PACKAGE/action/NAME')
    return found[1], found[2], found[3]


def _without_comment(line: str) -> str:
    """Return a line without its comment; a # in quotation marks is no comment."""
    return re.sub(r"""^((?:[^#'"]|'[^']*'|"[^"]*")*)#.*$""", r'\1', line).strip()
