# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Errors of the package, and the words of their messages.

A malformed request raises one of these errors. A problem without a solution is a result, not an
error. The text of an error is written for the user: it names the item, the value found and the
values accepted.
"""

from collections.abc import Collection, Mapping
import difflib


class ObcError(ValueError):
    """Base of all errors raised by obc_ros.core; its text is printable, whatever it quotes."""

    def __str__(self) -> str:
        return quote(super().__str__(), None)


class StatementError(ObcError):
    """A problem, an expression, a file or a request is malformed."""


class DynamicsError(ObcError):
    """A system is unknown or malformed, or has no equilibrium at the set point."""


class RefusedDesignError(ObcError):
    """A feedback design was rejected: a weight is not definite, or stability is not verified."""


class RefusedReferenceError(ObcError):
    """A reference was rejected, because the plant cannot join or follow it."""


def quote(text: str, longest: int | None = 60) -> str:
    """Return a text from outside on one line, escaped and at most `longest` characters long."""
    if longest is not None and len(text) > longest:
        text = text[:longest - 3] + '...'
    if text.isprintable():
        return text
    return ''.join(each if each.isprintable() else ascii(each)[1:-1] for each in text)


def suggest_name(name: str, known: Collection[str]) -> str:
    """Return `` (did you mean 'x'?)`` for the most similar known name; '' if none is similar."""
    matches = difflib.get_close_matches(name[:64], known, n=1)
    return f" (did you mean '{matches[0]}'?)" if matches else ''


def describe_type(value: object) -> str:
    """Return what a value is, such as ``a mapping``, ``a list of 3`` or ``str 'abc'``."""
    if value is None:
        return 'nothing'
    if isinstance(value, Mapping):
        return 'a mapping'
    if isinstance(value, (list, tuple)):
        return f'a list of {len(value)}' if value else 'an empty list'
    if isinstance(value, (bool, int, float, str)):
        words = ' '.join(str(value).split())
        return f"{type(value).__name__} '{quote(words, 40)}'"
    return f'a {type(value).__name__}'
