# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A parser of command lines that suggests the name that was meant."""

import argparse
from collections.abc import Sequence
from typing import Any

from obc_ros.core.text.errors import quote, suggest_name


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors suggest commands, verbs and options."""

    def parse_args(self, args: Sequence[str] | None = None,  # type: ignore[override]
                   namespace: Any = None) -> argparse.Namespace:
        """Parse a command line; exit with status 2 and a suggestion if a word is unknown."""
        found: argparse.Namespace
        found, unknown = self.parse_known_args(args, namespace)
        if not unknown:
            return found
        option = next((word for word in unknown if word.startswith('-')), '')
        if not option:
            self.error(f"not expected: {quote(' '.join(unknown))}")
        name = option.partition('=')[0]
        parser = self._find_parser(args or ())
        parser.error(f"unknown option '{quote(name)}'"
                     f'{suggest_name(name, parser.list_options())}')

    def list_options(self) -> list[str]:
        """Return the long options."""
        return [name for action in self._actions for name in action.option_strings
                if name.startswith('--')]

    def _find_parser(self, words: Sequence[str]) -> 'Parser':
        """Return the parser of the subcommand that a command line names."""
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                for index, word in enumerate(words):
                    if word in action.choices:
                        found: Parser = action.choices[word]._find_parser(words[index + 1:])
                        return found
        return self

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is None or value in action.choices:
            return
        known = [str(each) for each in action.choices]
        raise argparse.ArgumentError(action, (
            f"there is no '{quote(str(value))}'{suggest_name(str(value), known)}; "
            f'wanted one of {", ".join(known)}'))
