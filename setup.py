# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Build a wheel of obc_ros: with ROS 2, by the CMakeLists.txt that colcon uses, or in pure Python.

With ROS 2, the CMake project is built and installed into a staging folder. Its Python part becomes
the package; ``lib``, ``share`` and ``include`` go to the prefix as data files. An editable wheel
leaves the modules out: a path leads to those in the source tree. Without ROS 2, setuptools
packs the modules; requirements/build_backend.py chooses.
"""

import hashlib
from importlib import metadata, util
import os
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile
from typing import Any
from xml.etree import ElementTree

from build_backend import list_dependencies, wants_ros
from setuptools import Command, Distribution, find_namespace_packages, setup
from setuptools.command.build_py import build_py

ROOT = Path(__file__).resolve().parent
SITE_PACKAGES = f'lib/python{sys.version_info.major}.{sys.version_info.minor}/site-packages'
SOURCES = 'obc_ros_sources.pth'   # of an editable wheel: the path of the source tree
OPTIMIZATION = '-O1 -DNDEBUG'
# `ros2 run` starts these; unlike those of colcon they must find their own interpreter.
ENTRY = '#!/bin/sh\nexec "$(dirname "$0")/../../bin/{name}" "$@"\n'


def underlay() -> Path:
    """Return the prefix that holds the interface generators."""
    spec = util.find_spec('rosidl_adapter')
    if spec is None or spec.origin is None:
        sys.exit('obc_ros: no rosidl_adapter here; `pip install .` with build isolation brings it')
    return next(parent for parent in Path(spec.origin).parents if (parent / 'share').is_dir())


def cmake(*arguments: object) -> None:
    """Run CMake with the generators' prefix as the underlay."""
    program = shutil.which('cmake') or sys.exit('obc_ros: cmake is not on PATH')
    environment = {**os.environ, 'AMENT_PREFIX_PATH': str(underlay())}
    subprocess.run([program, *map(str, arguments)], check=True, env=environment)


def build_and_stage(build: Path, stage: Path) -> None:
    """Configure and build below `build`, install into a fresh `stage`."""
    settings = {
        'CMAKE_BUILD_TYPE': 'Release',
        'CMAKE_C_FLAGS_RELEASE': OPTIMIZATION,
        'CMAKE_CXX_FLAGS_RELEASE': OPTIMIZATION,
        'CMAKE_INSTALL_MESSAGE': 'NEVER',
        'CMAKE_INSTALL_PREFIX': sys.prefix,
        'CMAKE_PREFIX_PATH': underlay(),
        'Python3_EXECUTABLE': sys.executable,
        'PYTHON_INSTALL_DIR': SITE_PACKAGES,
        'BUILD_TESTING': 'OFF',
    }
    cmake('-G', 'Ninja', '-S', ROOT, '-B', build, '-Wno-dev', '--log-level=WARNING',
          *(f'-D{name}={value}' for name, value in settings.items()))
    cmake('--build', build)
    shutil.rmtree(stage, ignore_errors=True)
    cmake('--install', build, '--strip', '--prefix', stage)


class BuildInterfaces(build_py):
    """Build the CMake project and take package and data files from its staging folder."""

    editable = False

    def run(self) -> None:
        """Build in a folder that is kept, unless the build environment is a passing one."""
        if underlay() != Path(sys.prefix):
            with tempfile.TemporaryDirectory() as folder:
                self.collect(Path(folder))
            return
        installed = sorted(f'{each.name} {each.version}' for each in metadata.distributions()
                           if each.name.startswith(('ros-', 'numpy')))
        state = '\n'.join([sys.prefix, sys.version, *installed])
        self.collect(ROOT / 'build' / f'pip-{hashlib.sha256(state.encode()).hexdigest()[:12]}')

    def collect(self, folder: Path) -> None:
        """Build in `folder` and copy what came of it to `build_lib` and a folder of data files."""
        stage = folder / 'stage'
        build_and_stage(folder / 'build', stage)
        package = Path(self.build_lib) / 'obc_ros'
        data = Path(self.build_lib).parent / 'data'
        for stale in (package, data):
            shutil.rmtree(stale, ignore_errors=True)
        (package.parent / SOURCES).unlink(missing_ok=True)
        shutil.copytree(stage / SITE_PACKAGES / 'obc_ros', package)
        if self.editable:
            self.leave_sources_out(package)
        shutil.copytree(stage, data, ignore=shutil.ignore_patterns(
            'python*', 'parent_prefix_path'))
        for entry in (data / 'lib' / 'obc_ros').iterdir():
            entry.write_text(ENTRY.format(name=entry.name), encoding='utf-8')
        self.distribution.data_files = [
            (str(path.parent.relative_to(data)), [os.path.relpath(path)])
            for path in sorted(data.rglob('*')) if path.is_file()]

    def leave_sources_out(self, package: Path) -> None:
        """
        Remove from a package what the source tree has, and have Python look there.

        Type checkers, which run nothing, find the sources only if this package has no
        `__init__.py`; that of the sources finds the generated modules.
        """
        for path in (ROOT / 'obc_ros').iterdir():
            if (package / path.name).is_dir():
                shutil.rmtree(package / path.name)
            else:
                (package / path.name).unlink(missing_ok=True)
        (package.parent / SOURCES).write_text(f'{ROOT}\n', encoding='utf-8')


class EditableWheel(Command):
    """Build the wheel of ``pip install --editable .``: generated modules and a path."""

    user_options = [('dist-dir=', 'd', ''), ('dist-info-dir=', 'I', ''), ('mode=', None, '')]

    def initialize_options(self) -> None:
        """Set every option to its default."""
        self.dist_dir = self.dist_info_dir = self.mode = None

    def finalize_options(self) -> None:
        """Accept the options as they are."""

    def run(self) -> None:
        """Build an ordinary wheel without the modules of the source tree."""
        BuildInterfaces.editable = True
        self.reinitialize_command('bdist_wheel', dist_dir=self.dist_dir)
        self.run_command('bdist_wheel')


class BinaryDistribution(Distribution):
    """A distribution whose wheel belongs to one platform."""

    def has_ext_modules(self) -> bool:
        """Return True: the generated modules are compiled."""
        return True


class BuildPure(build_py):
    """Pack the modules; setuptools would keep those of an earlier build."""

    def run(self) -> None:
        """Remove an earlier build first."""
        shutil.rmtree(Path(self.build_lib) / 'obc_ros', ignore_errors=True)
        super().run()


def describe() -> dict[str, Any]:
    """Return the arguments of `setup` that depend on whether there is ROS 2."""
    if wants_ros():
        return {'packages': ['obc_ros'], 'distclass': BinaryDistribution,
                'cmdclass': {'build_py': BuildInterfaces, 'editable_wheel': EditableWheel}}
    return {'packages': find_namespace_packages(include=['obc_ros', 'obc_ros.*']),
            'data_files': [('share/obc_ros/benchmarks',
                            sorted(map(str, Path('benchmarks').glob('*.py')))),
                           ('share/obc_ros/docs/gallery',
                            [str(path) for path in sorted(Path('docs/gallery').iterdir())
                             if path.suffix in ('.ipynb', '.json', '.png', '.py')])],
            'cmdclass': {'build_py': BuildPure}}


setup(
    version=ElementTree.parse(ROOT / 'package.xml').findtext('version'),
    install_requires=list_dependencies(),
    **describe(),
)
