# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The journal: nothing that was finished is lost, and nothing of another sweep is taken."""

import json

from obc_ros.core.text.errors import ObcError, StatementError
from obc_ros.sweep.journal import JOURNAL, Journal, QUESTION
import pytest

ASKED = {'version': '1', 'axes': {'a': [1.0, 2.0]}}
ROWS = {0: [{'status': 'solved', 'J': 0.1}, {'status': 'infeasible'}], 1: [{'J': float('inf')}]}


@pytest.fixture
def folder(tmp_path):
    """Return a folder with two finished chunks."""
    with Journal(tmp_path / 'sweep', ASKED, resume=False) as journal:
        for number, rows in ROWS.items():
            journal.append(number, rows)
    return tmp_path / 'sweep'


def test_finished_chunks_are_read_again(folder):
    with Journal(folder, ASKED, resume=True) as journal:
        assert journal.chunks == ROWS


@pytest.mark.parametrize('cut', [1, 2, 10, 20])
def test_a_line_that_was_not_finished_is_dropped(folder, cut):
    path = folder / JOURNAL
    path.write_bytes(path.read_bytes()[:-cut])
    with Journal(folder, ASKED, resume=True) as journal:
        assert journal.chunks == {0: ROWS[0]}
        journal.append(1, ROWS[1])
    with Journal(folder, ASKED, resume=True) as journal:
        assert journal.chunks == ROWS


def test_a_damaged_line_is_reported(folder):
    path = folder / JOURNAL
    path.write_bytes(path.read_bytes().replace(b'rows', b'row"', 1))
    with pytest.raises(StatementError, match='damaged, after 0 bytes'):
        Journal(folder, ASKED, resume=True)


@pytest.mark.parametrize(('asked', 'resume', 'words'), [
    (ASKED, False, '--resume goes on with it'),
    ({**ASKED, 'version': '2'}, True, 'version changed'),
    ({**ASKED, 'axes': {'a': [1.0, 3.0]}}, True, 'axes changed'),
    ({**ASKED, 'seed': 1}, True, 'seed changed')])
def test_another_sweep_is_not_mixed_with_it(folder, asked, resume, words):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(StatementError, match=words):
        Journal(folder, asked, resume)
    assert before == {path.name: path.read_bytes() for path in folder.iterdir()}


def test_one_process_writes_at_a_time(folder):
    with Journal(folder, ASKED, resume=True), pytest.raises(ObcError, match='another process'):
        Journal(folder, ASKED, resume=True)


def test_there_must_be_a_sweep_to_resume(tmp_path):
    with pytest.raises(StatementError, match='no sweep to resume'):
        Journal(tmp_path / 'none', ASKED, resume=True)
    assert not list(tmp_path.iterdir())


def test_a_damaged_question_is_reported(folder):
    (folder / QUESTION).write_text('{')
    with pytest.raises(StatementError, match='damaged'):
        Journal(folder, ASKED, resume=True)


def test_the_question_is_readable(folder):
    assert json.loads((folder / QUESTION).read_text()) == ASKED
