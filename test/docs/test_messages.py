# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The messages that docs/refusals.md and docs/proofs.md quote are those of the sources."""

import ast
from collections.abc import Iterator
from pathlib import Path
import re

import pytest

ROOT = Path(__file__).resolve().parents[2]
REFUSALS = (ROOT / 'docs' / 'refusals.md').read_text(encoding='utf-8').replace(r'\|', ' ')
PROOFS = (ROOT / 'docs' / 'proofs.md').read_text(encoding='utf-8')
ROW = re.compile(r'^\| (?!message|remark|---)(.*?) \|', re.MULTILINE)
ITALIC = re.compile(r'(?<!\*)\*(infeasib[^*]+)\*')
LONG = 10  # letters of two or three words that say something


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


def list_runs(text: str) -> Iterator[tuple[str, ...]]:
    """Yield two and three words of a text that stand together."""
    words = re.findall(r'\w+|\{\}', text)
    for first in range(len(words)):
        yield tuple(words[first:first + 2])
        yield tuple(words[first:first + 3])


@pytest.mark.slow
def test_quoted_messages_are_those_of_the_sources() -> None:
    quoted = [*ROW.findall(REFUSALS), *ITALIC.findall(REFUSALS), *ITALIC.findall(PROOFS)]
    assert len(quoted) > 50
    said = {run for path in (ROOT / 'obc_ros').rglob('*.py')
            for text in list_texts(ast.parse(path.read_text(encoding='utf-8')))
            for run in list_runs(text)}
    for message in quoted:
        assert any(len(''.join(run)) >= LONG and run in said
                   for run in list_runs(message)), message
