# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Names of the methods that solve a problem, and of the answers that end a search."""

from obc_ros.core.text.errors import describe_type, quote, StatementError, suggest_name

AUTO = 'auto'
NAMES = (AUTO, 'riccati', 'time_optimal', 'reeds_shepp', 'transcription', 'arcs', 'indirect')

# 'path': the first path that meets all constraints; 'best': the best such path when the time is
# up, if none was certified by then.
CERTIFIED, PATH, BEST = ACCEPTED = 'certified', 'path', 'best'


def get_method(value: object) -> str:
    """Return the name of a method as a user wrote it; None and '' mean 'auto'."""
    return _choose('method', value, NAMES)


def get_accepted(value: object) -> str:
    """Return the answer that ends a search as a user wrote it; None and '': 'certified'."""
    return _choose('accept', value, ACCEPTED)


def _choose(key: str, value: object, names: tuple[str, ...]) -> str:
    """Return one of the names of a key; the first one if there is none."""
    if value is None or value == '':
        return names[0]
    if not isinstance(value, str):
        raise StatementError(f'{key}: wanted a name, found {describe_type(value)}; '
                             f'there are {", ".join(names)}')
    if value not in names:
        raise StatementError(f"{key}: '{quote(value)}' is unknown{suggest_name(value, names)}; "
                             f'there are {", ".join(names)}')
    return value
