# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Suggestions for problem files that do not exist."""

from pathlib import Path

from obc_ros.core.text.example_files import suggest_file
import pytest


@pytest.mark.parametrize(('given', 'near'), [
    ('crane.yaml', 'cranes.yaml'), ('cranes.yml', 'cranes.yaml'), ('crane', 'cranes.yaml'),
    ('missing.yaml', ''), ('xyz.yaml', '')])
def test_a_similar_file_is_suggested_but_none_for_its_suffix(
        tmp_path: Path, given: str, near: str) -> None:
    for name in ('cranes.yaml', 'neg.yaml'):
        (tmp_path / name).touch()
    assert suggest_file(tmp_path / given) == (f" (did you mean '{near}'?)" if near else '')
