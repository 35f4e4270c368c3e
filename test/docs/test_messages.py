# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The messages that docs/refusals.md and docs/proofs.md quote are those of the sources."""

import ast
from collections.abc import Iterator
from itertools import product
from pathlib import Path
import re

import pytest

ROOT = Path(__file__).resolve().parents[2]
REFUSALS = (ROOT / 'docs' / 'refusals.md').read_text(encoding='utf-8').replace(r'\|', ' ')
PROOFS = (ROOT / 'docs' / 'proofs.md').read_text(encoding='utf-8')
ROW = re.compile(r'^\| (?!message|remark|---)(.*?) \|', re.MULTILINE)
ITALIC = re.compile(r'(?<!\*)\*(infeasib[^*]+)\*')
LONG = 10  # letters of two words that say something
SAME = 0.6  # part of the words of a message that stand beside others as in a text of the sources
# Beginnings of messages that the sources put together from single words.
IN_PARTS = '(A, B) is', 'tuned.yaml has no section'


def list_texts(tree: ast.AST) -> Iterator[str]:
    """Yield the texts of a module, with {} in place of what is inserted; no docstrings."""
    described = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield ''.join(part.value if isinstance(part, ast.Constant) else ' {} '
                          for part in node.values)
        elif isinstance(node, ast.Constant) and id(node) not in described and isinstance(
                node.value, str):
            yield node.value


def list_runs(text: str) -> Iterator[tuple[range, tuple[str, ...]]]:
    """Yield places and words of two long and three words of a text that stand together."""
    words = list_words(text)
    for first, length in product(range(len(words)), (2, 3)):
        run = tuple(words[first:first + length])
        if len(run) == length and (length == 3 or len(''.join(run)) >= LONG):
            yield range(first, first + length), run


def list_words(text: str) -> list[str]:
    """Return the words of a text."""
    return re.findall(r'\w+|\{\}', text)


def measure_agreement(message: str, said: set[tuple[str, ...]]) -> float:
    """Return which part of the words of a message, without numbers and symbols, is said."""
    found = {k for places, run in list_runs(message) if run in said for k in places}
    words = [k for k, word in enumerate(list_words(message)) if re.search('[a-z]{2}', word)]
    return len(found.intersection(words)) / len(words)


@pytest.mark.slow
def test_quoted_messages_are_those_of_the_sources() -> None:
    quoted = [*ROW.findall(REFUSALS), *ITALIC.findall(REFUSALS), *ITALIC.findall(PROOFS)]
    assert len(quoted) > 50
    said = {run for path in (ROOT / 'obc_ros').rglob('*.py')
            for text in list_texts(ast.parse(path.read_text(encoding='utf-8')))
            for _, run in list_runs(text)}
    for message in quoted:
        least = SAME / 3 if message.startswith(IN_PARTS) else SAME
        assert measure_agreement(message, said) >= least, message
    invented = 'the aircraft sings loudly and terminal constraint grows beards'
    assert measure_agreement(invented, said) < SAME
