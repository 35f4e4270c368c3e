# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The programs of the gallery: short, without ROS 2, right, and as they are kept."""

import importlib
from pathlib import Path
import re
import sys

import numpy as np
from obc_ros.book.kept import read_kept
import pytest

DOCS = Path(__file__).resolve().parents[2] / 'docs'
KEPT = read_kept()
LONGEST = 15   # lines of a program, without its license
NUMBER = re.compile(r'-?\d+(?:\.\d*)?(?:e-?\d+)?')


@pytest.fixture(scope='module')
def answers():
    """Return the module docs/gallery_answers.py, which has the references."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(DOCS))
        yield importlib.import_module('gallery_answers')


@pytest.mark.parametrize('name', KEPT)
def test_a_program_computes_what_its_entry_asks_for(name, answers, monkeypatch):
    monkeypatch.setitem(sys.modules, 'obc_ros.msg', None)   # no ROS 2
    names, printed = answers.run_program(name)
    checked = 0
    for asked, value in answers.evaluate(name, names):
        assert value == pytest.approx(np.asarray(asked.exact, dtype=float), rel=1e-6, abs=1e-6), \
            asked.what
        checked += 1
    assert checked >= 2
    kept = KEPT[name]
    assert kept['program'] == answers.read_program(name)
    assert NUMBER.sub('#', printed) == NUMBER.sub('#', kept['output'])
    for now, before in zip(NUMBER.findall(printed), NUMBER.findall(kept['output']), strict=True):
        assert float(now) == pytest.approx(float(before), rel=0.1, abs=2e-6)


@pytest.mark.parametrize('name', KEPT)
def test_a_program_is_short_and_uses_the_public_names(name, answers):
    text = answers.read_program(name)
    assert len(text.splitlines()) <= LONGEST
    assert 'import obc_ros as obc\n' in text
    assert text.count('obc_ros') == 1


@pytest.mark.parametrize('name', KEPT)
def test_the_kept_table_has_the_references(name, answers):
    kept = KEPT[name]['asked']
    assert [(each['what'], each['by']) for each in kept] == [
        (each.what, each.by) for each in answers.ASKED[name]]
    for each, asked in zip(kept, answers.ASKED[name], strict=True):
        assert np.allclose(each['exact'], asked.exact, rtol=1e-9, atol=1e-9)
        assert np.allclose(each['value'], asked.exact, rtol=1e-6, atol=1e-6)
