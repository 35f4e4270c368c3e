# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The programs of docs/library.md and of README.md print what the pages say."""

from pathlib import Path
import re
import subprocess
import sys

import obc_ros as obc
import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / 'docs' / 'library.md').read_text(encoding='utf-8')
BLOCK = re.compile(r'^```python\n(.*?)^```$', re.MULTILINE | re.DOTALL)
PRINTED = re.compile(r'^print\(.*\)  # (.*)$', re.MULTILINE)


@pytest.mark.slow
@pytest.mark.parametrize('page', ['docs/library.md', 'README.md'])
def test_the_programs_print_what_the_page_says(page):
    """A line `print(...)  # text` prints this text."""
    program = '\n'.join(BLOCK.findall((ROOT / page).read_text(encoding='utf-8')))
    expected = PRINTED.findall(program)
    assert len(expected) == program.count('print(') > 0
    printed = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True,
                             check=True).stdout
    assert printed.splitlines() == expected


def test_the_page_lists_the_public_names():
    table = PAGE.partition('## Names')[2].partition('\n## ')[0]
    cells = re.findall(r'^\| (`.*?`) \|', table, re.MULTILINE)
    assert sorted(name for cell in cells for name in re.findall(r'\w+', cell)) == obc.__all__


def test_the_page_lists_the_attributes_of_an_answer():
    table = PAGE.partition('## Answers')[2].partition('\n## ')[0]
    rows = re.findall(r'^\| (`.*?`) \|', table, re.MULTILINE)
    named = {name for row in rows for name in re.findall(r'`(\w+)', row)}
    public = {name for name in vars(obc.Answer) if not name.startswith('_')}
    fields = {'name', 'states', 'inputs', 'problem', 'statement', 'title', 'has_path'}
    assert named == (public | set(obc.Answer.__dataclass_fields__)) - fields
