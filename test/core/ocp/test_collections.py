# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The public collections: every example names a file, and every file is a problem."""

from obc_ros.core.ocp.statement import build_problem, load_file
import public_collections  # of benchmarks/
import pytest

FOLDER = public_collections.TESTS / 'collections'
TABLES = sorted(FOLDER.glob('*.csv'))
FILES = sorted(FOLDER.glob('*/*.yaml'))
EXAMPLES = [row for path in TABLES for row in public_collections.read_table(path)]


@pytest.mark.parametrize('path', FILES, ids=lambda path: f'{path.parent.name}-{path.stem}')
def test_each_file_states_its_source_and_its_published_cost(path):
    [mapping] = load_file(path)
    problem = build_problem(mapping)
    assert problem.n
    assert problem.m
    assert mapping['name'] == path.stem
    assert {'title', 'source'} <= set(mapping)
    published = {row.published for row in EXAMPLES
                 if row.problem == f'collections/{path.parent.name}/{path.stem}'}
    assert {float(value) for value in published if value} == (
        {mapping['expected']['objective']} if 'expected' in mapping else set())


def test_the_tables_name_each_file_of_the_collections():
    named = {row.problem for row in EXAMPLES}
    assert named >= {str(path.relative_to(FOLDER.parent).with_suffix('')) for path in FILES}
    assert len(FILES) > 50
    assert all(public_collections.find_file(name).is_file() for name in named)
    assert {path.stem for path in TABLES} >= {path.parent.name for path in FILES}
