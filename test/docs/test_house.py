# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The layout of the package obeys docs/development/architecture.md and agrees with its picture."""

from collections import Counter
import importlib
from pathlib import Path
import re
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / 'docs' / 'development' / f'{name}.md' for name in ('architecture', 'decisions')]


@pytest.fixture(scope='module')
def measure():
    """Return the module docs/house.py, which reads the layout."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / 'docs'))
        yield importlib.import_module('house')


@pytest.fixture(scope='module')
def figure(measure):
    """Return the module docs/house_figure.py, which draws the layout."""
    return importlib.import_module('house_figure')


@pytest.fixture(scope='module')
def ours(measure):
    """Return the layout of this package."""
    return measure.read_house(ROOT)


def sound() -> dict[str, str]:
    """Return the files of a small package that obeys all rules."""
    files = {'__init__.py': '', 'core/__init__.py': '"""Numbers."""'}
    for room in ('nodes', 'workers', 'core/solver', 'core/solver/starts', 'core/ocp',
                 'core/ocp/certificate', 'core/numerics', 'core/text'):
        files[f'{room}/__init__.py'] = f'"""Folder {room}."""'
        for number in range(4):
            files[f'{room}/file_{number}.py'] = f'def {room.replace("/", "_")}_{number}(): ...\n'
    files['nodes/file_0.py'] += 'from obc_ros.workers.file_0 import workers_0\n'
    files['workers/file_0.py'] += 'import obc_ros.core.solver.file_0\n'
    files['core/solver/file_0.py'] += 'from obc_ros.core.solver.starts import file_0\n'
    files['core/solver/starts/file_0.py'] += 'from obc_ros.core.ocp.certificate import file_0\n'
    files['core/ocp/certificate/file_0.py'] += 'from obc_ros.core.ocp.file_1 import core_ocp_1\n'
    files['core/numerics/file_0.py'] += 'from obc_ros.core.text import file_0\n'
    return files


def read(measure, folder, changes=()):
    """Return the layout of the small package; `changes` are prepended to its files."""
    files = sound()
    for name, text in dict(changes).items():
        files[name] = text + files.get(name, '')
    for name, text in files.items():
        path = folder / 'obc_ros' / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding='utf-8')
    return measure.read_house(folder)


CHECKED = 'from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    '
# A rule, by the first words of its name; files that violate it; a word that it must report.
BROKEN = [
    ('circles of modules', {
        'core/text/file_0.py': 'import obc_ros.core.text.file_1\n',
        'core/text/file_1.py': 'from obc_ros.core.text import file_0\n'}, 'file_0 <-> '),
    ('circles of modules', {
        'core/text/file_0.py': 'import obc_ros.core.text.file_1\n',
        'core/text/file_1.py': 'import obc_ros.core.text.file_2\n',
        'core/text/file_2.py': 'def look():\n    import obc_ros.core.text.file_0\n'}, 'file_2'),
    ('circles of modules', {   # by its name
        'core/text/file_0.py': 'import obc_ros.core.text.file_1\n',
        'core/text/file_1.py': "OTHER = 'obc_ros.core.text.file_0'\n"}, 'file_0 <-> '),
    ('circles of folders', {
        'core/ocp/file_2.py': 'import obc_ros.core.riccati.file_0\n',
        'core/riccati/file_1.py': 'import obc_ros.core.ocp.file_3\n',
        'core/riccati/file_0.py': ''}, 'core.ocp <-> core.riccati'),
    ('circles of folders', {   # a file and a folder beside it
        'core/solver/starts/file_1.py': 'import obc_ros.core.solver.file_2\n',
        'core/solver/file_2.py': 'import obc_ros.core.solver.starts.file_2\n'},
        'core.solver.file_2 <-> core.solver.starts'),
    ('imports upwards', {
        'core/text/file_0.py': 'import obc_ros.core.numerics.file_3\n'}, 'core.numerics.file_3'),
    ('imports upwards', {
        'core/ocp/file_0.py': 'from obc_ros.core.solver import file_3\n'}, 'core.solver.file_3'),
    ('imports upwards', {
        'core/text/file_0.py': "start('obc_ros.workers.file_1')\n"}, 'file_1 (by its name)'),
    ('imports upwards', {   # the certificate must not import systems
        'core/ocp/certificate/file_1.py': 'import obc_ros.core.text.file_0\n'}, 'certificate'),
    ('imports upwards', {'elsewhere.py': 'import obc_ros.core.text.file_0\n'}, 'elsewhere'),
    ('imports under TYPE_CHECKING', {
        'core/ocp/file_0.py': f'{CHECKED}from obc_ros.core.text.file_1 import X\n'}, 'file_1'),
    ('imports inside functions', {
        'core/ocp/file_0.py': 'def f():\n    from obc_ros.core.text import file_1\n'}, 'file_1'),
    ('folders with more than', {
        f'core/text/more_{number}.py': '' for number in range(9)}, 'core.text has 13 files'),
    ('folders without a sentence', {'core/systems/__init__.py': ''}, 'core.systems'),
    ('folders without a sentence', {'core/systems/__init__.py': '"""No full stop"""'}, 'systems'),
    ('folders without a sentence', {'core/systems/file_0.py': ''}, 'core.systems'),
    ('public names', {
        'core/ocp/file_0.py': 'class Path: ...\n',
        'core/text/file_0.py': 'Path = str\n'}, 'Path: core.ocp.file_0, core.text.file_0'),
    ('public names', {   # a number that another module imports
        'core/ocp/file_0.py': 'MOST: int = 3\n', 'core/text/file_0.py': 'MOST = 4\n',
        'core/ocp/file_1.py': 'from obc_ros.core.text.file_0 import MOST\n'}, 'MOST'),
    ('public names', {
        'core/ocp/file_0.py': 'MOST = 3\n', 'core/text/file_0.py': 'MOST = 4\n',
        'core/ocp/file_1.py': 'from obc_ros.core.text import file_0\nX1 = file_0.MOST\n'}, 'MOST'),
    ('public names', {   # allowed in cli only
        'core/ocp/file_0.py': 'def run(): ...\n',
        'core/text/file_0.py': 'def run(): ...\n'}, 'run'),
    ('modules with a name', {'core/text/kit.py': ''}, 'core.text.kit'),
    ('attributes of another', {
        'core/solver/file_0.py': 'def f(search):\n    search.work, x = 1, 2\n'}, 'search.work'),
    ('attributes of another', {
        'core/solver/file_0.py': 'def f(search):\n    search.monitor.work += 1\n'}, 'work'),
]
FINE = {
    'cli/__init__.py': '"""Commands."""',
    **{f'cli/{name}.py': 'def run(): ...\n' for name in 'abcd'},
    'cli/a.py': 'def run():\n    from obc_ros.core.text import file_0\n',
    'cli/obc.py': "MODULES = {'start': 'obc_ros.nodes.file_0'}\n",
    'core/ocp/file_0.py': 'MOST = 3\n_Own = str\n',
    'core/solver/file_0.py': 'class A:\n    def f(self):\n        self.x = 1\n',
    'core/text/file_0.py': 'MOST = 4\n_Own = int\n'}


def rule(measure, words):
    """Return the only rule whose name begins with `words`."""
    [name] = [name for name in measure.RULES if name.startswith(words)]
    return measure.RULES[name]


@pytest.mark.parametrize('words', dict.fromkeys(words for words, *_ in BROKEN))
def test_the_package_obeys_the_rule(words, measure, ours):
    assert len(ours.modules) > 100
    assert rule(measure, words)(ours) == []


@pytest.mark.parametrize(('words', 'changes', 'case'), BROKEN)
def test_a_violation_of_the_rule_is_reported(words, changes, case, measure, tmp_path):
    found = rule(measure, words)(read(measure, tmp_path, changes))
    assert any(case in each for each in found), found


def test_every_rule_is_tested(measure, tmp_path):
    tried = [name for name in measure.RULES if any(name.startswith(w) for w, *_ in BROKEN)]
    assert tried == list(measure.RULES)
    for changes in ({}, FINE):
        house = read(measure, tmp_path, changes)
        assert {name: find(house) for name, find in measure.RULES.items()} == dict.fromkeys(
            measure.RULES, [])


def test_the_exit_status_is_1_for_a_violated_rule(measure, tmp_path, capsys):
    read(measure, tmp_path)
    assert measure.main(tmp_path) == 0
    read(measure, tmp_path, {'core/text/file_0.py': 'import obc_ros.core.ocp.file_3\n'})
    assert measure.main(tmp_path) == 1
    assert 'core.text.file_0 imports core.ocp.file_3' in capsys.readouterr().out


def test_imports_are_counted_between_folders(measure, tmp_path):
    house = read(measure, tmp_path)
    assert house.edges(str) == {
        ('nodes', 'workers'): 1, ('workers', 'core.solver'): 1,
        ('core.solver', 'core.solver.starts'): 1,
        ('core.solver.starts', 'core.ocp.certificate'): 1,
        ('core.ocp.certificate', 'core.ocp'): 1, ('core.numerics', 'core.text'): 1}
    assert house.edges(measure.room) == {
        ('nodes', 'workers'): 1, ('workers', 'core.solver'): 1, ('core.solver', 'core.ocp'): 1,
        ('core.numerics', 'core.text'): 1}


def test_a_relative_import_is_refused(measure, tmp_path):
    with pytest.raises(ValueError, match='relative'):
        read(measure, tmp_path, {'core/text/file_0.py': 'from . import file_1\n'})


def test_edges_implied_by_longer_paths_are_omitted(figure):
    edges = Counter({('a', 'b'): 1, ('b', 'c'): 2, ('a', 'c'): 3, ('c', 'd'): 1, ('d', 'c'): 1})
    assert figure.direct(edges) == edges - Counter({('a', 'c'): 3})


def test_edges_lead_to_columns_on_the_right(figure):
    edges = Counter({('a', 'b'): 1, ('b', 'c'): 1, ('d', 'c'): 1, ('d', 'e'): 1, ('e', 'd'): 1})
    assert figure.columns_of('abcde', edges) == [['a'], ['b', 'd', 'e'], ['c']]


def test_the_picture_has_all_folders_and_imports(figure, measure, ours):
    root = ElementTree.fromstring(figure.draw(ours))
    groups = {each.get('data-folder'): [line.text for line in each if line.tag.endswith('text')]
              for each in root.iter() if each.get('data-folder')}
    inside = {name for name in ours.sentences if name.startswith('core.solver.')}
    assert groups.keys() == {*measure.ROOMS, *inside}
    for name, lines in groups.items():
        assert ours.sentences[name].replace('`', '') in ' '.join(lines)
        for other in ours.sentences:   # folders without a box are named in that of their parent
            if other.startswith(f'{name}.') and other not in inside:
                assert other.removeprefix(f'{name}.').replace('.', '/') in ' '.join(lines)
    wanted = ours.edges(measure.room) + ours.edges(lambda each: each if each in inside else None)
    drawn, lines = {}, list(root)
    for line, number in zip(lines, lines[1:], strict=False):
        if line.get('data-from'):
            drawn[line.get('data-from'), line.get('data-to')] = int(number.text)
    assert len(drawn) > 20
    also = {}
    for name, lines in groups.items():
        room = 'core.solver.' if name in inside else ''
        for other, count in re.findall(r'(\w+)\s(\d+)', ' '.join(lines).partition('also: ')[2]):
            [target] = [each for each in groups if each.rpartition('.')[2] == other and (
                each in inside) == bool(room)]
            also[name, target] = int(count)
    assert not drawn.keys() & also.keys()
    assert drawn | also == wanted


def test_arrows_begin_and_end_at_their_boxes(figure, ours):
    root = ElementTree.fromstring(figure.draw(ours))
    boxes = {each.get('data-folder'): [float(each[0].get(key)) for key in (
        'x', 'y', 'width', 'height')] for each in root.iter() if each.get('data-folder')}
    for line in root:
        for end, kind in enumerate(('from', 'to'), 1):
            if folder := line.get(f'data-{kind}'):
                x, y, width, height = boxes[folder]
                assert -0.2 <= float(line.get(f'x{end}')) - x <= width + 0.2, line.attrib
                assert -0.2 <= float(line.get(f'y{end}')) - y <= height + 0.2, line.attrib


def test_a_violating_import_is_drawn_red(figure, measure, tmp_path):
    assert figure.WRONG not in ''.join(re.findall(
        '<line.*?>', figure.draw(read(measure, tmp_path))))
    house = read(measure, tmp_path, {'core/text/file_0.py': 'import obc_ros.core.ocp.file_3\n'})
    assert len(re.findall(f'<line[^>]*{figure.WRONG}', figure.draw(house))) == 1


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.stem)
def test_the_pages_name_existing_files(page, ours):
    """A path in backquotes exists, below obc_ros if it begins with a folder of the package."""
    rooms = {name.split('.')[0] for name in ours.modules}
    text = page.read_text(encoding='utf-8')
    named = {each for each in re.findall(r'`([\w/]+(?:\.\w+)?/?)`', text)
             if '/' in each.rstrip('/')}
    assert len(named) > 10
    for each in named:
        below = ROOT / 'obc_ros' if each.split('/')[0] in rooms else ROOT
        assert (below / each).exists(), each


def test_the_layout_page_uses_names_of_the_sources(ours):
    """A single word in backquotes occurs in the package or in its interfaces."""
    files = [*ours.modules.values(), *ROOT.glob('msg/*.msg'), *ROOT.glob('srv/*.srv')]
    known = {word for file in files for word in re.findall(r'\w+', file.read_text('utf-8'))}
    named = set(re.findall(r'`([A-Za-z_]+)`', PAGES[0].read_text(encoding='utf-8')))
    assert len(named) > 10
    assert named <= known
