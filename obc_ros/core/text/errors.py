# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What can be wrong with a question.

A malformed question raises one of these; a question without an answer is a result, not an error.
The text of every error is written for the person who asked: it names the thing, the value found
and what is wanted.
"""


class ObcError(ValueError):
    """Base of all errors raised by obc_ros.core; its text can be printed, whatever it quotes."""

    def __str__(self) -> str:
        """Return the text on one line, without what a terminal would obey."""
        return quote(super().__str__(), None)


class StatementError(ObcError):
    """A problem, an expression, a file or a request is malformed."""


class DynamicsError(ObcError):
    """A system is unknown or malformed, or has no equilibrium at the set point."""


class RefusedDesignError(ObcError):
    """A feedback design was asked for that cannot be proved to stabilise."""


class RefusedReferenceError(ObcError):
    """A reference was given that the plant cannot take up or follow."""


def quote(text: str, longest: int | None = 60) -> str:
    """
    Return a text from outside as a message has it.

    Parameters
    ----------
    text : str
        Whatever somebody sent.
    longest : int, optional
        Characters that are kept of it; None: all.

    Returns
    -------
    str
        On one line, and without what a terminal would obey.

    """
    if longest is not None and len(text) > longest:
        text = text[:longest - 3] + '...'
    if text.isprintable():
        return text
    return ''.join(each if each.isprintable() else ascii(each)[1:-1] for each in text)
