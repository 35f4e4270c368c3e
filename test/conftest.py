# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Fixtures of every test that runs nodes: `domain`, `spawn`, `probe`.

A test that asks for one of them carries the marker ``nodes``; the output of the processes it
spawned is attached to its report when it fails.
"""

from collections.abc import Iterator
import os
from pathlib import Path
import signal

from hypothesis import settings
from obc_ros.cli.processes import free_domain
import pytest
import support

os.environ.update(support.ISOLATED)
for _name in support.FOREIGN:
    os.environ.pop(_name, None)

# A shell lets what it starts in the background ignore SIGINT, and so would all that tests start.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Neither chance nor the clock of a busy machine decides a test. `--hypothesis-profile explore`
# looks at other examples each time.
settings.register_profile('obc_ros', deadline=None, derandomize=True)
settings.register_profile('explore', deadline=None)
settings.load_profile('obc_ros')

_SPAWNER = pytest.StashKey[support.Spawner]()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that run nodes."""
    for item in items:
        if 'domain' in getattr(item, 'fixturenames', ()):
            item.add_marker('nodes')


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
    """Return a domain id that nothing else on this machine uses."""
    with free_domain() as domain:
        yield domain


@pytest.fixture
def spawn(
    domain: int, tmp_path: Path, request: pytest.FixtureRequest
) -> Iterator[support.Spawner]:
    """
    Start executables and end them after the test.

    ``process = spawn('lqr_node', {'system': 'aircraft'})``. The test fails if a process had died
    unnoticed or does not heed SIGINT.
    """
    spawner = request.node.stash[_SPAWNER] = support.Spawner(tmp_path, domain)
    yield spawner
    wrong = spawner.end()
    assert not wrong, '\n'.join(wrong)


@pytest.fixture
def probe(domain: int) -> Iterator[support.Probe]:
    """Return a node in the domain of the test."""
    probe = support.Probe(domain)
    yield probe
    probe.close()


@pytest.fixture
def clock() -> Iterator[support.Clock]:
    """Return a clock that leaves out when the machine stood still."""
    clock = support.Clock()
    yield clock
    clock.close()
