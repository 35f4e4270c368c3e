# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The programs of the pages print what the pages say, and save the figures that they show."""

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
@pytest.mark.parametrize('page', ['README.md', *(f'docs/{name}.md' for name in (
    'certificate', 'library', 'proofs', 'python', 'regulator'))])
def test_the_programs_print_what_the_page_says(page, tmp_path):
    """A line `print(...)  # text` prints this text; each figure that is saved is on the page."""
    text = (ROOT / page).read_text(encoding='utf-8')
    program = '\n'.join(BLOCK.findall(text))
    expected = PRINTED.findall(program)
    assert len(expected) == program.count('print(') > 0
    printed = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True,
                             check=True, cwd=tmp_path).stdout
    assert printed.splitlines() == expected
    shown = re.findall(r'\]\(python/(.*\.png)\)', text)
    assert sorted(shown) == sorted(figure.name for figure in tmp_path.glob('*.png'))
    assert all((ROOT / 'docs' / 'python' / figure).is_file() for figure in shown)


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
