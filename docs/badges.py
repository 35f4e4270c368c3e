# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Draw the badges of the README from what the workflow of the tests runs (`make picture`)."""

from pathlib import Path
import re

import yaml

ROOT = Path(__file__).resolve().parents[1]
BADGES = ROOT / 'docs' / 'badges'
WORKFLOW = ROOT / '.github' / 'workflows' / 'test.yml'
WIDTH, SPACE = 6.2, 12  # [px] of a character, and around a word
_BADGE = """<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="20" role="img">
  <title>{name}: {value}</title>
  <rect width="{width}" height="20" rx="3" fill="#0072b2"/>
  <path d="M3,0 H{split} V20 H3 a3,3 0 0 1 -3,-3 V3 a3,3 0 0 1 3,-3" fill="#444444"/>
  <g fill="#ffffff" font-family="Verdana, 'DejaVu Sans', sans-serif" font-size="11">
    <text x="{left}" y="14" textLength="{name_length}">{name}</text>
    <text x="{right}" y="14" textLength="{value_length}">{value}</text>
  </g>
</svg>
"""


def list_badges() -> dict[str, tuple[str, str]]:
    """Return name and value of each badge by the name of its file."""
    workflow = yaml.safe_load(WORKFLOW.read_text(encoding='utf-8'))
    jobs = workflow['jobs']
    pythons = jobs['test']['strategy']['matrix']['python']
    makefile = (ROOT / 'Makefile').read_text(encoding='utf-8')
    distributions = re.findall(r'^DISTRO \?= (\w+)', makefile, re.MULTILINE)   # of all tests
    return {
        'ros2': ('tested on ROS 2', ', '.join(each.capitalize() for each in distributions)),
        'python': ('tested on Python', ', '.join(pythons)),
        'licence': ('licence', 'Apache-2.0')}


def draw_badge(name: str, value: str) -> str:
    """Return a badge as SVG."""
    lengths = [round(WIDTH * len(each)) for each in (name, value)]
    split = lengths[0] + SPACE
    return _BADGE.format(
        name=name, value=value, name_length=lengths[0], value_length=lengths[1], split=split,
        left=SPACE // 2, right=split + SPACE // 2, width=split + lengths[1] + SPACE)


if __name__ == '__main__':
    BADGES.mkdir(exist_ok=True)
    for stem, words in list_badges().items():
        (BADGES / f'{stem}.svg').write_text(draw_badge(*words), encoding='utf-8')
