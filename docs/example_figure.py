# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Run the programs of the README and of docs/python.md, and keep their figures."""

from pathlib import Path
import re
import subprocess
import sys
from tempfile import TemporaryDirectory

import keep_gallery

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / 'docs'
SHARP = "import matplotlib\nmatplotlib.rcParams['savefig.dpi'] = 110\n"


def read_program(page: Path) -> str:
    """Return the program of a page."""
    text = page.read_text(encoding='utf-8')
    return ''.join(re.findall(r'^```python\n(.*?)^```$', text, re.MULTILINE | re.DOTALL))


def keep_figures(program: str, folder: Path) -> None:
    """Run a program, and keep the figures that it saves."""
    with TemporaryDirectory() as saved:
        subprocess.run([sys.executable, '-c', f'{SHARP}{program}'], cwd=saved, check=True)
        for figure in Path(saved).glob('*.png'):
            keep_gallery.keep_figure(figure, folder / figure.name)


if __name__ == '__main__':
    keep_figures(re.sub(r'\.plot\(.*\)\n$', ".plot().savefig('obstacle.png')",
                        read_program(ROOT / 'README.md')), DOCS)
    keep_figures(read_program(DOCS / 'python.md'), DOCS / 'python')
