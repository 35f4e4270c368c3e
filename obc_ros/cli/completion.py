# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
`obc completion`: a script that completes commands, options and names in bash, zsh or fish.

The script is static, made from the argument parsers by shtab: nothing of `obc` runs while a shell
starts, shows its prompt or completes a word.
"""

import argparse
from collections.abc import Collection, Iterator, Mapping
from typing import Any
from zlib import crc32

from obc_ros.cli.bench import find_benchmarks
from obc_ros.cli.obc import build_parser, find_subcommands, import_subcommand, NEED_ROS
from obc_ros.cli.terminal import Parser
from obc_ros.core.text.errors import ObcError
from obc_ros.core.text.example_files import list_examples
from obc_ros.ros.installation import explain_missing_ros

SHELLS = ('bash', 'zsh', 'fish')
YAML_FILES = ('*.yaml', '*.yml')


def add_arguments(parser: Parser) -> None:
    """Declare the arguments of `obc completion`."""
    parser.add_argument('shell', choices=SHELLS, metavar='SHELL', help=', '.join(SHELLS))


def run(args: argparse.Namespace) -> int:
    """Print the script; return the exit status."""
    try:
        import shtab
    except ImportError as error:   # in a workspace
        raise ObcError(f'completion needs shtab: pip install shtab ({error})') from None
    names = [name for name in find_subcommands()
             if not (name in NEED_ROS and explain_missing_ros())]
    parser = build_parser(names)
    for command, action in walk_actions(parser):
        if completed := complete_action(command, action):
            action.complete = completed
    print(shtab.complete(parser, args.shell))
    return 0


def walk_actions(parser: argparse.ArgumentParser, command: str = ''
                 ) -> Iterator[tuple[str, Any]]:
    """Yield the arguments of a parser and of its subcommands, each with its subcommand."""
    for action in parser._actions:
        yield command, action
        if isinstance(action, argparse._SubParsersAction):
            for name, inner in action.choices.items():
                yield from walk_actions(inner, command or name)


def complete_action(command: str, action: argparse.Action) -> Mapping[str, Any] | None:
    """Return what completes an argument, in the form of shtab; None for its own choice."""
    import shtab
    if action.metavar == 'DIR':
        found: Mapping[str, Any] = shtab.DIRECTORY
        return found
    if action.metavar == 'FILE' and command in ('solve', 'lqr', 'sweep', 'gallery'):
        return _complete_files(list_examples() if command in ('solve', 'sweep') else ())
    if action.dest == 'names':
        return _complete_words(_list_names(command))
    if action.dest == 'method':
        from obc_ros.core.ocp.method_names import NAMES
        return _complete_words(NAMES)
    return None


def _list_names(command: str) -> list[str]:
    if command == 'examples':
        return list_examples()
    if command == 'gallery':
        names: list[str] = import_subcommand(command).list_entries()
        return names
    try:
        return list(find_benchmarks())
    except ObcError:   # none are installed
        return []


def _complete_files(names: Collection[str]) -> Mapping[str, Any]:
    """Return what completes a YAML file, or one of some names."""
    import shtab
    files: dict[str, Any] = shtab.glob(*YAML_FILES)
    if not names:
        return files
    words = _complete_words(names)
    both = f'{words["bash"]}_or_file'
    return {
        'bash': both, 'zsh': both, 'fish': f'{words["fish"]} {files["fish"]}',
        'preamble': {
            **files['preamble'],
            'bash': f'{files["preamble"]["bash"]}{words["preamble"]["bash"]}'
                    f'{both}() {{ {words["bash"]} "$1"; {files["bash"]} "$1"; }}\n',
            'zsh': f'{both}() {{\n  compadd -- {" ".join(names)}\n'
                   "  _files -g '*.(yaml|yml)'\n}\n"}}


def _complete_words(words: Any) -> dict[str, Any]:
    """Return what completes one of some words that need no quotes."""
    text = ' '.join(words)
    function = f'_obc_words_{crc32(text.encode())}'
    return {'bash': function, 'zsh': f'({text})', 'fish': text,
            'preamble': {'bash': f'{function}() {{\n  compgen -W "{text}" -- "$1"\n}}\n'}}
