# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Run the program of the README and keep its figure, ``docs/obstacle.png`` (`make picture`)."""

from pathlib import Path
import re
from typing import Any

import keep_gallery

ROOT = Path(__file__).resolve().parents[1]
DPI = 110


def run_example() -> Any:
    """Run the program of the README; return its answer."""
    text = (ROOT / 'README.md').read_text(encoding='utf-8')
    [program] = re.findall(r'^```python\n(.*?)^```$', text, re.MULTILINE | re.DOTALL)
    names: dict[str, Any] = {}
    exec(program, names)
    return names['answer']


if __name__ == '__main__':
    target = ROOT / 'docs' / 'obstacle.png'
    run_example().plot().savefig(target, dpi=DPI)
    keep_gallery.keep_figure(target, target)
