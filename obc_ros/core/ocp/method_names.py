# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Names of the methods that solve a problem; `solve` contains the methods."""

from obc_ros.core.text.errors import describe_type, quote, StatementError, suggest_name

AUTO = 'auto'
NAMES = (AUTO, 'riccati', 'time_optimal', 'reeds_shepp', 'transcription', 'arcs', 'indirect')


def get_method(value: object) -> str:
    """Return the name of a method as a user wrote it; None and '' mean 'auto'."""
    if value is None or value == '':
        return AUTO
    if not isinstance(value, str):
        raise StatementError(f'method: wanted a name, found {describe_type(value)}; '
                             f'there are {", ".join(NAMES)}')
    if value not in NAMES:
        raise StatementError(f"method: '{quote(value)}' is unknown{suggest_name(value, NAMES)}; "
                             f'there are {", ".join(NAMES)}')
    return value
