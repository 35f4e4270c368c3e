# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Errors of the package, and the words of their messages.

A malformed request raises one of these errors. A problem without a solution is a result, not an
error. The text of an error is written for the user: it names the item, the value found and the
values accepted.
"""

from collections.abc import Callable, Collection, Mapping
import difflib
import re
from types import TracebackType
from typing import Any

MOST_ERRORS = 20   # lines of one error


class ObcError(ValueError):
    """Base of all errors raised by obc_ros.core; its text is printable, whatever it quotes."""

    def __str__(self) -> str:
        return quote(super().__str__(), None)


class StatementError(ObcError):
    """A problem, an expression, a file or a request is malformed."""


class JoinedStatementError(StatementError):
    """Several errors of one statement: its arguments, and lines of its text."""

    def __str__(self) -> str:
        return '\n'.join(quote(str(line), None) for line in self.args)


class DependentError(StatementError):
    """An entry cannot be judged: a name in it stands for another one, which is malformed."""


class DynamicsError(ObcError):
    """A system is unknown or malformed, or has no equilibrium at the set point."""


class RefusedDesignError(ObcError):
    """A feedback design was rejected: a weight is not definite, or stability is not verified."""


class RefusedReferenceError(ObcError):
    """A reference was rejected, because the plant cannot join or follow it."""


class Faults:
    """
    A context manager that keeps the errors of independent entries, and raises them together.

    At most `MOST_ERRORS` are raised, each once, in the order of the keys of `given`; one alone is
    raised as it is. A DependentError is raised only if there is no other one.
    """

    def __init__(self, given: Mapping[Any, Any] | None = None) -> None:
        self._order = [str(key) for key in given or ()]
        self._errors: list[ObcError] = []

    def __bool__(self) -> bool:
        return bool(self._errors)

    def __enter__(self) -> 'Faults':
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        if isinstance(error, ObcError):
            self._errors.append(error)
        if self._errors and (error is None or isinstance(error, ObcError)):
            raise self._join() from None

    def attempt(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """
        Return what a function returns.

        If it raises an ObcError, this is kept, and None is returned: code after the ``with`` block
        does not see it.
        """
        try:
            return function(*arguments)
        except ObcError as error:
            self._errors.append(error)
        return None

    def note(self, error: ObcError) -> None:
        """Keep an error."""
        self._errors.append(error)

    def _join(self) -> ObcError:
        told = [each for each in self._errors if not isinstance(each, DependentError)]
        if len(told) < 2:
            return (told or self._errors)[0]
        lines = list(dict.fromkeys(line for each in told for line in str(each).split('\n')))
        meant = re.findall(r"unknown key \(did you mean '(\w+)'\?\)", '\n'.join(lines))
        lines = [line for line in lines if not any(
            line.startswith(f'{key}: missing') for key in meant)]
        lines.sort(key=self._find_place)
        if len(lines) > MOST_ERRORS:
            lines[MOST_ERRORS - 1:] = [f'and {len(lines) - MOST_ERRORS + 1} more errors']
        return JoinedStatementError(*lines) if len(lines) > 1 else StatementError(*lines)

    def _find_place(self, line: str) -> int:
        """Return the position of the key of a line; the last one if it is absent."""
        key = re.split(r'[.:\[ ]', line, maxsplit=1)[0]
        return self._order.index(key) if key in self._order else len(self._order)


def restate(error: ObcError, change: Callable[[str], str]) -> StatementError:
    """Return an error with other lines, each as `change` returns it."""
    lines = [change(line) for line in str(error).split('\n')]
    return JoinedStatementError(*lines) if len(lines) > 1 else StatementError(*lines)


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
