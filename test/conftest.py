# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Fixtures of the tests that run nodes: `domain`, `spawn`, `probe`, `terminal`.

A test that uses one of them carries the marker ``nodes``; if it fails, its report contains the
output of its processes. A test that uses `clock` carries ``alone`` and runs while no other worker
runs a test.

Several workers take the tests in this order: tests of nodes, which wait half of their time, mixed
with slow ones, which do not; quick tests; those that run alone. Workers are then busy together and
end together.

A test carries ``check`` unless it carries ``nodes`` or ``slow``; `make check` runs these tests.
Such a test fails if it takes twice `QUICK`, including the processes that it has waited for.

Without ROS 2 the tests that need it are left out: see `selection`.
"""

from collections.abc import Iterator
import fcntl
import gc
import os
from pathlib import Path
import signal
from typing import Any

from hypothesis import settings
from obc_ros.cli.processes import reserve_domain
from obc_ros.ros.installation import explain_missing_ros
from obc_ros.ros.middleware import choose_profile
import pytest
from selection import MARKERS, needs_ros
import support
from words import Terminal, WORDS

os.environ.update(support.ISOLATED)
for _name in support.FOREIGN:
    os.environ.pop(_name, None)
choose_profile()   # for the probes; processes of nodes choose their own

# A shell starts background processes with SIGINT ignored, and child processes inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Tests are deterministic and without deadlines. `--hypothesis-profile explore` draws new examples
# each time, and more of them.
settings.register_profile('obc_ros', deadline=None, derandomize=True, max_examples=30)
settings.register_profile('explore', deadline=None)
settings.load_profile('obc_ros')

# Locks between the workers. A worker that waits for the room holds the door, so that no other
# worker enters before it.
_DOOR, _ROOM = (os.open(path, os.O_RDONLY) for path in (__file__, Path(__file__).parent))

QUICK = 0.5  # [s] of processor time that a test may take without the marker `slow`

# Files whose tests share a loop or a browser: three of them would overload two cores.
TOGETHER = ('test/view/test_page.py', 'test/nodes/test_hostile.py')

_SPAWNER = pytest.StashKey[support.Spawner]()
_PURE = bool(explain_missing_ros())


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the number of events that test_loop_machine.py runs."""
    parser.addoption('--steps', type=int, default=6_000, help='random events of a control loop')


def pytest_report_header() -> str:
    """Say which tests are left out."""
    return 'without ROS 2: the tests that need it are left out' * _PURE


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Leave out a file that needs ROS 2 where there is none."""
    is_test = collection_path.name.startswith('test_')
    return True if _PURE and is_test and needs_ros(collection_path) else None


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[object]:
    """Collect without looking for cycles of objects: nearly all objects stay."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark tests that run nodes, tests that measure times, and tests for `make check`."""
    for item in items:
        fixtures = getattr(item, 'fixturenames', ())
        if 'domain' in fixtures:
            item.add_marker('nodes')
        if 'clock' in fixtures:
            item.add_marker('alone')
        if not any(map(item.get_closest_marker, ('nodes', 'slow'))):
            item.add_marker('check')
    if _PURE:
        left_out = {item for item in items if any(map(item.get_closest_marker, MARKERS))}
        config.hook.pytest_deselected(items=list(left_out))
        items[:] = [item for item in items if item not in left_out]
    if hasattr(config, 'workerinput'):  # set by pytest-xdist; a single process needs no order
        items[:] = _put_in_order(items)


def _put_in_order(items: list[pytest.Item]) -> list[pytest.Item]:
    """Return the tests in the order in which several workers take them."""
    kinds: dict[str, list[pytest.Item]] = {}
    for item in items:
        kinds.setdefault(_kind(item), []).append(item)
    shared, nodes, slow, quick, alone = (
        kinds.get(kind, []) for kind in ('shared', 'nodes', 'slow', 'check', 'alone'))
    places = [(place / len(of), item) for of in (nodes, slow) for place, item in enumerate(of)]
    mixed = [item for _, item in sorted(places, key=lambda each: each[0])]
    return [*shared, *mixed, *quick, *alone]


def _kind(item: pytest.Item) -> str:
    """Return 'alone', 'check', 'nodes', 'slow', or 'shared': with others of its file a fixture."""
    for kind in ('alone', 'check'):
        if item.get_closest_marker(kind):
            return kind
    known = getattr(item, '_fixtureinfo', None)
    found = (each[-1] for each in known.name2fixturedefs.values()) if known else ()
    if any(each.scope == 'module' for each in found):
        return 'shared'   # other tests in between would end the fixture
    return 'nodes' if item.get_closest_marker('nodes') else 'slow'


@pytest.hookimpl(optionalhook=True)   # of pytest-xdist, whose own groups pytest 9.2 ignores
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Return the scheduler of `--dist loadgroup`: the tests of `TOGETHER` go to one worker."""
    from xdist.scheduler import LoadScopeScheduling

    class Scheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return next(filter(nodeid.startswith, TOGETHER), nodeid)

    return Scheduling(config, log) if config.getvalue('dist') == 'loadgroup' else None


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Run a test that measures times while no other test runs."""
    fcntl.flock(_DOOR, fcntl.LOCK_EX)
    try:
        fcntl.flock(_ROOM, fcntl.LOCK_EX if item.get_closest_marker('alone') else fcntl.LOCK_SH)
    finally:
        fcntl.flock(_DOOR, fcntl.LOCK_UN)
    try:
        return (yield)
    finally:
        fcntl.flock(_ROOM, fcntl.LOCK_UN)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Fail a test for `make check` that takes too long."""
    if item.config.option.markexpr != 'check' or item.get_closest_marker('nodes'):
        return (yield)
    begun = sum(os.times()[:4])
    result = yield
    took = sum(os.times()[:4]) - begun
    assert took < 2 * QUICK, f'{took:.2f} s: a test of over {QUICK} s carries the marker slow'
    return result


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    """Attach the output of the spawned processes to the report of a failure."""
    report = yield
    if report.failed and _SPAWNER in item.stash:
        for process in item.stash[_SPAWNER].processes:
            report.sections.append((' '.join(process.command), process.output()))
    return report


@pytest.fixture
def domain() -> Iterator[int]:
    """Return a domain id that no other process on this machine uses."""
    with reserve_domain() as domain:
        yield domain


@pytest.fixture
def spawn(
    domain: int, tmp_path: Path, request: pytest.FixtureRequest
) -> Iterator[support.Spawner]:
    """
    Start executables and end them after the test.

    ``process = spawn('lqr_node', {'system': 'aircraft'})``. The test fails if a process has died
    unnoticed or ignores SIGINT.
    """
    spawner = request.node.stash[_SPAWNER] = support.Spawner(tmp_path, domain)
    yield spawner
    wrong = spawner.end()
    assert not wrong, '\n'.join(wrong)


@pytest.fixture
def probe(domain: int) -> Iterator[Any]:
    """Return a probe node in the domain of the test."""
    from probes import Probe  # tests without nodes run without ROS 2, too
    probe = Probe(domain)
    yield probe
    probe.close()


@pytest.fixture(params=WORDS)
def terminal(request: pytest.FixtureRequest, domain: int, tmp_path: Path) -> Iterator[Terminal]:
    """Return a terminal for `obc`, and one for `ros2` with its daemon where it is installed."""
    terminal = Terminal(request.param, domain, tmp_path)
    if terminal.word == 'ros2':  # a daemon started by the first line would not know the nodes yet
        terminal.say('daemon', 'start')
    yield terminal
    if terminal.word == 'ros2':
        terminal.say('daemon', 'stop')


@pytest.fixture
def clock() -> Iterator[support.Clock]:
    """Return a clock that excludes the times at which the machine was stalled."""
    clock = support.Clock()
    yield clock
    clock.close()
