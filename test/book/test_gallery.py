# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc gallery`: every entry through running nodes; page, numbers and commands."""

from collections.abc import Iterator
from contextlib import ExitStack
from html.parser import HTMLParser
import json
import os
from pathlib import Path
import re
import shlex

from matplotlib.figure import Figure
import numpy as np
from obc_ros.book import page
from obc_ros.book import records as gallery
from obc_ros.book import runner as desks
from obc_ros.book.chapter.all import ENTRIES
from obc_ros.book.entries import linear, regulators, vehicle
from obc_ros.book.entry import ComparedRow, EntryResult, GalleryEntry
from obc_ros.book.kept import write_records
from obc_ros.book.loop import publish, UnansweredError, write_service_call
from obc_ros.cli.client import serve_client
from obc_ros.cli.obc import main, parse
from obc_ros.cli.processes import Children, isolate, reserve_domain
from obc_ros.cli.ros2.yaml_messages import fill, find_type
from obc_ros.cli.ros2.yaml_messages import parse_values as parse_yaml
from obc_ros.ros.messages import read_statement
from obc_ros.srv import DesignLqr, SolveOptimalControl
import pytest
import support
import yaml

CHAPTER = {*(f'example-2.{k}' for k in range(1, 7)), 'theorem-2.1', 'theorem-2.2',
           *(f'exercise-2.{k}' for k in range(1, 11)), 'section-2.2', 'section-2.4', 'section-2.5',
           'figure-2.3', 'counterexample-2.2'}


@pytest.fixture(scope='module')
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp('gallery')


@pytest.fixture(scope='module')
def desk(out: Path) -> Iterator[desks.Desk]:
    """Yield a desk with a server of its own."""
    before = dict(os.environ)
    try:
        with reserve_domain() as domain:
            isolate(domain)
            with Children(out / 'log') as children, ExitStack() as stack:
                yield desks.Desk(lambda: stack.enter_context(serve_client(children, 'workers:=1')),
                                 out / 'recordings')
    finally:
        os.environ.clear()
        os.environ.update(before)


@pytest.mark.nodes
@pytest.mark.parametrize('entry', ENTRIES, ids=lambda entry: entry.name)
def test_every_number_agrees_with_its_reference(entry: GalleryEntry, desk: desks.Desk, out: Path
                                                ) -> None:
    record = gallery.work(entry, desk, out)
    assert not record['message']
    wrong = [f'{row["what"]}: {row["measured"]!r}, exact {row["exact"]!r}'
             for row in record['rows'] if not row['error'] <= 1e-6]
    assert not wrong
    assert record['holds']
    assert record['commands']
    for command in record['commands']:
        check_command(command, out)
    assert (out / f'{entry.name}.png').stat().st_size > 20_000


def check_command(command: str, out: Path) -> None:
    """Parse a command of the page as `obc` does, and fill its request or message."""
    if command.startswith('#'):
        return
    found = re.fullmatch(r'(.*) "\$\(cat (\S+)\)"', command)
    words = shlex.split(found[1] if found else command)
    assert words[0] == 'ros2', command
    if found:
        words.append((out / found[2]).read_text(encoding='utf-8'))
    args = parse(words[1:])
    if args.command == 'service':
        fill(find_type(args.service_type, 'srv').Request(), parse_yaml(args.values))
    elif args.command == 'topic' and 'values' in args:
        fill(find_type(args.message_type, 'msg')(), parse_yaml(args.values))


def test_the_plant_satisfies_the_hypotheses_of_theorem_2_2() -> None:
    A, B, H, Qu = regulators.make_plant()
    assert np.linalg.eigvals(A).real.max() > 0
    assert _is_controllable(A, B)
    assert _is_controllable(A.T, H.T)
    assert np.linalg.eigvalsh(Qu).min() > 0


def test_the_systems_of_exercise_2_7_are_observable() -> None:
    """The exercise assumes observability; more than half of the systems are unstable."""
    systems = linear.draw_systems()
    assert len(systems) == linear.SYSTEMS
    assert all(_is_controllable(A.T, C.T) for A, _, C, _ in systems)
    assert sum(np.linalg.eigvals(A).real.max() > 0 for A, *_ in systems) > linear.SYSTEMS / 2


def _is_controllable(A: np.ndarray, B: np.ndarray) -> bool:
    reach = np.hstack([np.linalg.matrix_power(A, k) @ B for k in range(len(A))])
    return bool(np.linalg.matrix_rank(reach) == len(A))


def test_the_gallery_has_all_entries_of_the_chapter() -> None:
    assert {entry.name for entry in ENTRIES if entry.in_book} == CHAPTER
    assert len({entry.name for entry in ENTRIES}) == len(ENTRIES)


def test_entries_beyond_the_chapter_have_headings_of_words() -> None:
    assert gallery.label('receding-horizon-1') == 'Receding horizon 1'
    assert gallery.label('estimation-2') == 'Estimation 2'


@pytest.mark.nodes
def test_the_command_writes_page_figures_and_numbers(tmp_path: Path, domain: int) -> None:
    """A second run keeps the results of the entries of the first."""
    folder = tmp_path / 'out'
    for name in ('example-2.2', 'exercise-2.9'):
        process = support.Process(
            [support.find('obc'), 'gallery', name, '--out', str(folder)], tmp_path / 'log', domain)
        assert process.wait(60.0) == 0, process.output()
    known = json.loads((folder / 'gallery.json').read_text())['entries']
    assert [each['name'] for each in known] == ['example-2.2', 'exercise-2.9']
    assert all(each['holds'] for each in known)
    assert all(each['seconds'] > 0 for each in known)
    assert {path.name for path in folder.iterdir()} >= {
        'index.html', *(f'{name}.{ending}' for name in ('example-2.2', 'exercise-2.9')
                        for ending in ('png', 'py', 'ipynb'))}
    parsed = PageReader()
    parsed.feed((folder / 'index.html').read_text())
    assert parsed.images == ['example-2.2.png', 'exercise-2.9.png'] * 2   # contents and articles
    assert not parsed.foreign
    assert not parsed.open


@pytest.mark.nodes
def test_an_interrupt_keeps_the_finished_entries(tmp_path: Path, domain: int) -> None:
    folder = tmp_path / 'out'
    process = support.Process(
        [support.find('obc'), 'gallery', 'example-2.2', 'example-2.5', '--out', str(folder)],
        tmp_path / 'log', domain)
    try:
        support.wait_for((folder / 'example-2.2.png').exists, 60.0)
        assert process.interrupt() == 1
    finally:
        process.end()
    assert 'ended by SIGINT' in process.output()
    assert 'Traceback' not in process.output()
    known = json.loads((folder / 'gallery.json').read_text())['entries']
    assert [each['name'] for each in known] == ['example-2.2']


class PageReader(HTMLParser):
    """A reader of a page that collects its images, its foreign links and its open tags."""

    def __init__(self) -> None:
        super().__init__()
        self.images: list[str] = []
        self.foreign: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.images += [given['src'] or ''] if tag == 'img' else []
        self.foreign += [value for value in given.values() if value and '//' in value]
        if tag not in ('img', 'meta', 'br'):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_a_wrong_number_fails_the_entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def off(desk: desks.Desk) -> EntryResult:
        return EntryResult([ComparedRow('a', 1.0, 1.0, ''), ComparedRow('b', 2.0, 2.00001, '')],
                           Figure())

    def unanswered(desk: desks.Desk) -> EntryResult:
        raise UnansweredError('no <answer>')

    entries = [GalleryEntry(name, '', '', (), run) for name, run in (
        ('1.1', off), ('1.2', unanswered))]
    desk = desks.Desk(None, tmp_path)  # type: ignore[arg-type]  # no entry uses its server
    records = [gallery.work(entry, desk, tmp_path) for entry in entries]
    assert [record['holds'] for record in records] == [False, False]
    assert records[1]['message'] == 'no <answer>'
    assert 'no &lt;answer&gt;' in page.render_page(records)
    monkeypatch.setattr(gallery, 'work_all', lambda *given: given[-1].extend(records))
    assert main(['gallery', '2.2', '--out', str(tmp_path)]) == 1


def test_a_relative_error_divides_by_the_reference() -> None:
    assert ComparedRow('', [1e-8], [2e-8], '', relative=True).error == pytest.approx(0.5)
    assert ComparedRow('', [0.0], [0.0], '', relative=True).error == np.inf  # 0/0 is an error
    row = ComparedRow('', [100.0, 1.0], [100.0 + 1e-5, 1.0 + 2e-6], '').as_json()
    assert (row['measured'], row['error']) == (1.0, pytest.approx(2e-6, rel=1e-3))


@pytest.mark.parametrize(('measured', 'exact', 'error'), [
    (1.0, 1.0, 0.0), (1e3 + 1e-3, 1e3, 1e-6), (1e-3, 0.0, 1e-3), ([1.0, 2.0], [1.0, 4.0], 0.5),
    (np.nan, 0.0, np.inf), ([1.0], [1.0, 1.0], np.inf), ([], [], np.inf)])
def test_the_error_is_relative_to_references_above_1(measured: object, exact: object, error: float
                                                     ) -> None:
    assert ComparedRow('', measured, exact, '').error == pytest.approx(error, rel=1e-6)


def test_an_unknown_entry_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(['gallery', '2.7', '--out', str(tmp_path / 'out')]) == 2
    words = "no entry '2.7' (did you mean 'exercise-2.7'?); there are example-2.1"
    assert words in capsys.readouterr().err
    assert not (tmp_path / 'out').exists()


def test_the_list_has_every_entry(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['gallery', '--list']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == [entry.name for entry in ENTRIES]


def test_an_example_is_known_by_its_number(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['gallery', '2.4', '--list']) == 0
    assert capsys.readouterr().out.startswith('example-2.4  ')


def test_an_unwritable_folder_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]
                                          ) -> None:
    (tmp_path / 'file').write_text('')
    assert main(['gallery', '2.2', '--out', str(tmp_path / 'file')]) == 1
    assert 'obc gallery: ' in capsys.readouterr().err


@pytest.mark.parametrize('text', ['', '[]', '{"entries": 3}', '{"entries": [{"name": "2.2"}]}'])
def test_a_corrupt_record_file_is_replaced(text: str, tmp_path: Path) -> None:
    (tmp_path / 'gallery.json').write_text(text)
    write_records(tmp_path, [], ['2.1', '2.2'])
    assert json.loads((tmp_path / 'gallery.json').read_text()) == {'entries': []}


@pytest.mark.parametrize(('value', 'markup'), [
    (0.25, '$0.25$'), (-1.5e-9, '$-1.5·10^{-9}$'), (-4e-15, '$0$'),
    ([[4e20, 1]], '[[$4·10^{20}$, $1$]]')])
def test_numbers_and_lists_are_shown_as_markup(value: object, markup: str) -> None:
    assert page.show_values(value) == markup


@pytest.mark.parametrize(('text', 'html'), [
    ('a < b', 'a &lt; b'),
    ('$x_1^2$', '<i>x</i><sub>1</sub><sup>2</sup>'),
    ('$e^{-at_f}$', '<i>e</i><sup>\u2212<i>at</i><sub><i>f</i></sub></sup>'),
    ('$sin θ < 1$', 'sin <i>θ</i> &lt; 1'),
    ('`lqr_node` of $K$', '<code>lqr_node</code> of <i>K</i>')])
def test_markup_is_shown_in_html(text: str, html: str) -> None:
    assert page.format_markup(text) == html


def test_commands_contain_the_request() -> None:
    problem = {
        'system': 'scalar', 'parameters': {'a': 1, 'b': 2.5}, 'running_cost': 'u**2/2',
        'initial_state': {'x': 1}, 'terminal_constraints': ['x - 1'],
        'final_time': {'free': True, 'lower': 0.1, 'upper': 3}}
    request = desks.solve_request(problem, 'arcs')
    given = yaml.safe_load(shlex.split(
        write_service_call('solve', SolveOptimalControl, request))[-1])
    assert given['method'] == 'arcs'
    again = read_statement(fill(SolveOptimalControl.Request(), given).problem)
    assert again == read_statement(request.problem)
    case = {'A': [[0, 1], [0, 0]], 'B': [[0], [1]], 'Qx': [1, 0], 'Qu': [0.1]}
    request = desks.design_request(case)
    command = write_service_call('design_lqr', DesignLqr, request)
    assert shlex.split(command)[:5] == [
        'ros2', 'service', 'call', '/trajectory_server/design_lqr', 'obc_ros/srv/DesignLqr']
    assert fill(DesignLqr.Request(), yaml.safe_load(shlex.split(command)[-1])) == request


def test_a_reference_is_published_from_its_file(tmp_path: Path) -> None:
    folder = tmp_path / 'recordings' / 'loop'
    folder.mkdir(parents=True)
    reference = vehicle.make_course('flat')
    command = publish('reference', reference, folder / 'flat.yaml')
    assert command.endswith('"$(cat recordings/loop/flat.yaml)"')
    given = yaml.safe_load((folder / 'flat.yaml').read_text())
    again = fill(type(reference)(), given)
    assert np.allclose(again.x, reference.x, atol=1e-9)
    assert len(again.t) == len(reference.t)
    assert again.header.stamp.nanosec == 0  # stamp 0: it begins when it is received
    assert (folder / 'flat.yaml').stat().st_size < 120_000  # Linux takes 128 KiB as one argument
