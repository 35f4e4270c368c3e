# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The problem files of the package, and suggestions for those that do not exist."""

from pathlib import Path

from obc_ros.core.text.example_files import (
    list_examples,
    list_titles,
    load_example,
    suggest_file,
)
import pytest


@pytest.mark.parametrize(('given', 'near'), [
    ('crane.yaml', 'cranes.yaml'), ('cranes.yml', 'cranes.yaml'), ('crane', 'cranes.yaml'),
    ('missing.yaml', ''), ('xyz.yaml', '')])
def test_a_similar_file_is_suggested_but_none_for_its_suffix(
        tmp_path: Path, given: str, near: str) -> None:
    for name in ('cranes.yaml', 'neg.yaml'):
        (tmp_path / name).touch()
    assert suggest_file(tmp_path / given) == (f" (did you mean '{near}'?)" if near else '')


def test_each_example_has_a_title_of_one_line() -> None:
    titles = list_titles()
    assert list(titles) == list_examples()
    assert all(title and '\n' not in title and title == title.strip()
               for title in titles.values())
    assert titles['di_mintime_rest'] == load_example('di_mintime_rest')['title']
