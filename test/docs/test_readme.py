# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The first screen: pictures, badges, and the words of what is rejected."""

from importlib import util
from pathlib import Path
import re
import textwrap
from types import ModuleType

import obc_ros as obc
from PIL import Image
import pytest

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / 'README.md').read_text(encoding='utf-8')
MASS = {'states': ['p', 'v'], 'inputs': ['u'], 'dynamics': {'p': 'v', 'v': 'u'},
        'initial_state': {'p': 1, 'v': 0}, 'final_time': {'free': False, 'value': 1.5}}


def _load(name: str) -> ModuleType:
    spec = util.spec_from_file_location(name, ROOT / 'docs' / f'{name}.py')
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _find_rejections() -> list[str]:
    table = README.partition('## What it rejects')[2].partition('\n## ')[0]
    return re.findall(r'^\| .* \| `([^`]+)`(?:; [^|]*)? \|$', table, re.MULTILINE)


def test_the_badges_name_what_the_workflow_runs():
    badges = _load('badges')
    for stem, words in badges.list_badges().items():
        assert (badges.BADGES / f'{stem}.svg').read_text(encoding='utf-8') == (
            badges.draw_badge(*words))
        assert f'docs/badges/{stem}.svg' in README
    assert badges.list_badges()['ros2'][1] == 'Jazzy'


def test_the_moving_picture_is_small_and_moves():
    file = ROOT / 'docs' / 'flight.gif'
    assert file.stat().st_size < 2_000_000
    with Image.open(file) as picture:
        assert picture.n_frames > 100


def test_the_page_of_the_site_has_the_same_program():
    [program] = re.findall(r'^```python\n(.*?)^```$', README, re.MULTILINE | re.DOTALL)
    index = (ROOT / 'docs' / 'index.rst').read_text(encoding='utf-8')
    assert textwrap.indent(program, '   ') in index


def test_regulators_are_rejected_in_these_words():
    indefinite, unreachable, *_ = _find_rejections()
    with pytest.raises(obc.ObcError, match=re.escape(indefinite)):
        obc.lqr(obc.systems['aircraft'], [1] * 6, [-0.1, 0.1])
    with pytest.raises(obc.ObcError, match=re.escape(unreachable)):
        obc.lqr([[0, 1], [0, 0]], [[1], [0]], [1, 1], [1])


def test_problems_are_rejected_in_these_words():
    _, _, late, misspelt, _ = _find_rejections()
    answer = obc.solve(**MASS, running_cost='u**2', terminal_constraints=['p', 'v'],
                       input_bounds={'u': [-1, 1]})
    assert (answer.status, answer.message) == ('infeasible', late)
    with pytest.raises(obc.ObcError, match=re.escape(misspelt)):
        obc.Problem(**MASS | {'dynamics': {'p': 'v', 'v': 'w'}}, running_cost='u**2')


@pytest.mark.slow
def test_a_cost_without_a_minimiser_is_rejected_in_these_words():
    *_, chatters = _find_rejections()
    answer = obc.solve(
        states=['x'], inputs=['u'], dynamics={'x': 'u'}, running_cost='x**2 + (u**2 - 1)**2',
        initial_state={'x': 0}, input_bounds={'u': [-1, 1]},
        final_time={'free': False, 'value': 1})
    assert answer.status != 'solved'
    assert answer.message.startswith(chatters)
