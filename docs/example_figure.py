# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Run the program of the README and keep its figure, ``docs/obstacle.png`` (`make picture`)."""

from pathlib import Path
import re
import subprocess
import sys

import keep_gallery

ROOT = Path(__file__).resolve().parents[1]
TARGET = ROOT / 'docs' / 'obstacle.png'
DPI = 110


def read_program() -> str:
    """Return the program of the README."""
    text = (ROOT / 'README.md').read_text(encoding='utf-8')
    [program] = re.findall(r'^```python\n(.*?)^```$', text, re.MULTILINE | re.DOTALL)
    return str(program)


if __name__ == '__main__':
    subprocess.run([sys.executable, '-c', f'{read_program()}.savefig({str(TARGET)!r}, dpi={DPI})'
                    .replace('\n.savefig', '.savefig')], check=True)
    keep_gallery.keep_figure(TARGET, TARGET)
