# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The package as a whole: version, interfaces, import boundaries, license headers."""

import ast
from collections.abc import Iterator
from functools import cache
import importlib
from importlib import metadata, util
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import tomllib
from xml.etree import ElementTree

import build_backend  # of requirements/
import pytest
from selection import imports_ros, list_imports, list_reached

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / 'pyproject.toml').read_text(encoding='utf-8'))
PACKAGE = ElementTree.parse(ROOT / 'package.xml').getroot()
FOLDERS = ('.ci', '.github', 'benchmarks', 'cmake', 'config', 'docs', 'launch', 'obc_ros',
           'requirements', 'test')
REQUIRED = (*build_backend.DEPENDENCIES, *build_backend.ROS_DEPENDENCIES,
            *build_backend.ROS_WHEELS)
# What is imported only where it is used: the extras, and pandas if the user has it.
OPTIONAL = {'pandas', *(re.split(r'[\[<>=~; ]', line)[0] for extra in (
    PROJECT['project']['optional-dependencies'].values()) for line in extra)}
HEADER = ('# Copyright 2026 The obc_ros developers\n', '# SPDX-License-Identifier: Apache-2.0\n')
INTERFACES = [file for kind in ('msg', 'srv', 'action') for file in sorted(ROOT.glob(f'{kind}/*'))]
# The name in package.xml of an imported module, where the two names differ.
ROSDEP_KEYS = {
    'ament_index_python': 'ament_index_python',
    'casadi': 'casadi-pip',
    'contourpy': 'python3-matplotlib',   # which requires it
    'control': 'python-control-pip',
    'matplotlib': 'python3-matplotlib',
    'mcap': 'mcap-ros2-support',
    'zstandard': 'mcap-ros2-support',   # which needs it
    'numpy': 'python3-numpy',
    'rich': 'python3-rich',
    'scipy': 'python3-scipy',
    'yaml': 'python3-yaml',
}
# What is among the packages of ROS 2, but not among its wheels: imported only if it is there.
NO_WHEELS = {'tf2_msgs'}
# The modules of Python that Windows or macOS lacks, or whose functions it lacks.
NOT_EVERYWHERE = {'ctypes', 'fcntl', 'grp', 'posix', 'pty', 'pwd', 'resource', 'syslog', 'termios',
                  'tty'}
CORE_MAY_IMPORT = {*sys.stdlib_module_names, 'casadi', 'control', 'matplotlib', 'numpy', 'scipy',
                   'yaml'}


def files(*suffixes: str) -> list[Path]:
    """Return the project's own files that end in one of `suffixes`."""
    found = [path for path in ROOT.iterdir() if path.is_file()]
    for folder in FOLDERS:
        found += [path for path in (ROOT / folder).rglob('*') if path.is_file()]
    return sorted(path for path in found if path.name.endswith(suffixes))


def distribution(requirement: str) -> str:
    """Return the name in a requirement."""
    return re.split(r'[\[<>=~; ]', requirement)[0]


def prefixes() -> list[str]:
    """Return the prefixes under which packages are installed."""
    given = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    return [*filter(None, given), sys.prefix]


def installed(path: str) -> Path:
    """Return the path of a file of the installed package."""
    candidates = [Path(prefix) / path for prefix in prefixes()]
    return next((file for file in candidates if file.is_file()), candidates[0])


def name(path: Path) -> str:
    """Return the path as messages show it."""
    return str(path.relative_to(ROOT))


@cache
def tree(path: Path) -> ast.Module:
    """Return the syntax tree of a Python file."""
    return ast.parse(path.read_text(encoding='utf-8'), filename=name(path))


def imports(path: Path) -> Iterator[str]:
    """Yield the full name of every module that a file imports, in functions too."""
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f'{name(path)}:{node.lineno}: imports are absolute'
            yield str(node.module)
            if node.module == 'obc_ros':
                yield from (f'obc_ros.{alias.name}' for alias in node.names)


def has_name(module: str, name: str) -> bool:
    """Return whether a module has a name, or is a folder that has a module of this name."""
    return hasattr(importlib.import_module(module), name) or bool(
        util.find_spec(f'{module}.{name}'))


PYTHON = files('.py')
CORE = sorted((ROOT / 'obc_ros' / 'core').rglob('*.py'))
API = [ROOT / 'obc_ros' / '__init__.py', *sorted((ROOT / 'obc_ros' / 'api').rglob('*.py'))]


def test_the_version_is_the_same_everywhere():
    """The changelog begins with `Forthcoming` or with this version."""
    version = PACKAGE.findtext('version')
    headings = re.findall(r'^(.+)\n-+$', (ROOT / 'CHANGELOG.rst').read_text(), re.MULTILINE)
    released = [heading.split(' ')[0] for heading in headings if heading != 'Forthcoming']
    assert 'Forthcoming' not in headings[1:]
    assert headings
    assert released[:1] in ([], [version])
    if os.environ.get('AMENT_PREFIX_PATH') is None:  # a workspace installs no metadata of a wheel
        assert metadata.version('obc-ros') == version


def run_sources(program: str) -> str:
    """Return what a program prints that finds the sources before an installation."""
    done = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, check=False,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(
            filter(None, [str(ROOT), os.environ.get('PYTHONPATH')]))})
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_the_package_tells_its_version_and_reads_it_on_first_use(tmp_path):
    """Without metadata there is none; another name is refused as by any module."""
    loaded = run_sources('import sys; before = {*sys.modules}; import obc_ros; '
                         'print(*{*sys.modules} - before); print(obc_ros.__version__)')
    assert loaded.splitlines() == ['obc_ros', PACKAGE.findtext('version')]
    assert run_sources('import obc_ros; print(hasattr(obc_ros, "version"))') == 'False'
    (tmp_path / 'obc_ros').mkdir()
    shutil.copy(ROOT / 'obc_ros/__init__.py', tmp_path / 'obc_ros')
    alone = subprocess.run(
        [sys.executable, '-S', '-c', 'import obc_ros; print(hasattr(obc_ros, "__version__"))'],
        cwd=tmp_path, capture_output=True, text=True, check=True, env={})
    assert alone.stdout.strip() == 'False'


@pytest.mark.ros
def test_the_sources_find_the_messages_of_the_installation():
    found = run_sources('import obc_ros.msg, obc_ros.core; print(obc_ros.__file__); '
                        'print(obc_ros.core.__file__); print(obc_ros.msg.State.__name__)')
    assert found.splitlines() == [
        str(ROOT / 'obc_ros/__init__.py'), str(ROOT / 'obc_ros/core/__init__.py'), 'State']


@pytest.mark.ros
@pytest.mark.parametrize('file', INTERFACES, ids=name)
def test_an_interface_is_installed(file):
    module = importlib.import_module(f'obc_ros.{file.parent.name}')
    assert hasattr(module, file.stem)
    assert installed(f'share/obc_ros/{name(file)}').read_bytes() == file.read_bytes()
    snake = re.sub('(?<=[a-z])(?=[A-Z])', '_', file.stem).lower()
    assert installed(f'include/obc_ros/obc_ros/{file.parent.name}/{snake}.hpp').is_file()


@pytest.mark.ros
def test_data_files_are_installed():
    data = [*(ROOT / 'config').rglob('*.yaml'), *(ROOT / 'launch').glob('*.py'),
            ROOT / 'package.xml', *(ROOT / 'foxglove').iterdir(), *(ROOT / 'rviz').iterdir()]
    for file in data:
        assert installed(f'share/obc_ros/{name(file)}').read_bytes() == file.read_bytes()
    assert installed('share/obc_ros/cmake/obc_rosConfig.cmake').is_file()
    assert installed('share/ament_index/resource_index/packages/obc_ros').is_file()


CPP_PROJECT = """
cmake_minimum_required(VERSION 3.20)
project(user CXX)
find_package(obc_ros REQUIRED)
add_executable(user main.cpp)
target_compile_features(user PRIVATE cxx_std_17)
target_link_libraries(user ${obc_ros_TARGETS})
"""
CPP_PROGRAM = """
#include <iostream>
#include <obc_ros/action/solve_optimal_control.hpp>
#include <obc_ros/msg/lqr_design.hpp>
#include <obc_ros/srv/design_lqr.hpp>
int main()
{
  obc_ros::srv::DesignLqr::Response response;
  response.design.k = {1.0, 2.0};
  obc_ros::action::SolveOptimalControl::Goal goal;
  goal.problem.states = {"p"};
  std::cout << response.design.k.size() << goal.problem.states[0];
}
"""


@pytest.mark.ros
@pytest.mark.slow
def test_a_cpp_program_builds_with_the_interfaces(tmp_path):
    (tmp_path / 'CMakeLists.txt').write_text(CPP_PROJECT)
    (tmp_path / 'main.cpp').write_text(CPP_PROGRAM)
    beside = Path(sys.executable).parent / 'cmake'
    cmake = str(beside) if beside.is_file() else 'cmake'
    environment = {**os.environ, 'AMENT_PREFIX_PATH': os.pathsep.join(prefixes()),
                   'LD_LIBRARY_PATH': os.pathsep.join(f'{each}/lib' for each in prefixes())}
    for command in (
            [cmake, '-S', '.', '-B', 'build', f'-DCMAKE_PREFIX_PATH={";".join(prefixes())}',
             f'-DPython3_EXECUTABLE={sys.executable}'],
            [cmake, '--build', 'build'], ['build/user']):
        completed = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True,
                                   text=True)
        assert completed.returncode == 0, completed.stdout + completed.stderr
    assert completed.stdout == '2p'


@pytest.mark.ros
def test_packages_that_depend_on_this_one_get_the_runtime():
    file = installed('share/obc_ros/cmake/ament_cmake_export_dependencies-extras.cmake')
    exported = re.search('_exported_dependencies "(.*)"', file.read_text(encoding='utf-8'))
    assert 'rosidl_default_runtime' in exported[1].split(';')


@pytest.mark.parametrize('file', INTERFACES, ids=name)
def test_every_field_has_a_comment(file):
    previous = ''
    for number, line in enumerate(file.read_text(encoding='utf-8').splitlines(), start=1):
        statement, _, comment = line.partition('#')
        if statement.strip() not in ('', '---'):
            described = comment.strip() or previous.startswith('#')
            assert described, f'{name(file)}:{number}: {statement.strip()} has no comment'
        previous = line.strip()


@pytest.mark.ros
@pytest.mark.parametrize(('executable', 'entry'), PROJECT['project']['scripts'].items())
def test_an_executable_is_installed_by_pip_and_colcon(executable, entry):
    module, function = entry.split(':')
    assert callable(getattr(importlib.import_module(module), function))
    assert f'{executable}:{module}' in (ROOT / 'CMakeLists.txt').read_text()
    assert function == 'main'
    assert os.access(installed(f'lib/obc_ros/{executable}'), os.X_OK)


@pytest.mark.slow
def test_core_does_not_import_ros():
    for path in CORE:
        for module in imports(path):
            allowed = module.split('.')[0] in CORE_MAY_IMPORT or module == 'obc_ros.core' or (
                module.startswith('obc_ros.core.'))
            assert allowed, f'{name(path)} imports {module}'


@pytest.mark.slow
def test_the_library_imports_on_every_system():
    commands = ('cli/obc.py', 'cli/ask/lqr.py', 'cli/ask/solve.py', 'cli/ask/sweep.py')
    for path in [*CORE, *API, *(ROOT / 'obc_ros' / each for each in commands)]:
        reached = {module.split('.')[0] for module in list_reached(path)}
        assert not NOT_EVERYWHERE & reached, name(path)


@pytest.mark.ros
@pytest.mark.slow
def test_what_benchmarks_import_from_the_package_exists():
    for path in sorted((ROOT / 'benchmarks').glob('*.py')):
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith('obc_ros'):
                for alias in node.names:
                    assert has_name(str(node.module), alias.name), f'{name(path)}:{node.lineno}'


def test_nodes_do_not_import_the_command_line():
    above = tuple(f'obc_ros.{folder}' for folder in ('book', 'cli', 'view'))
    for path in sorted((ROOT / 'obc_ros' / 'nodes').rglob('*.py')):
        assert not [module for module in imports(path) if module.startswith(above)]


def test_nodes_start_without_casadi_but_where_they_compute():
    """It loads in 0.3 s. The server computes in its workers."""
    assert 'casadi' not in list_reached(ROOT / 'obc_ros' / 'nodes' / 'trajectory_server.py')


@pytest.mark.slow
def test_every_import_is_a_declared_dependency():
    declared = {element.text for element in PACKAGE if element.tag.endswith('depend')}
    required = set(map(distribution, REQUIRED))
    for path in [path for path in PYTHON if path.is_relative_to(ROOT / 'obc_ros')]:
        for module in {module.split('.')[0] for module in imports(path)}:
            if module in sys.stdlib_module_names or module in OPTIONAL or module == 'obc_ros':
                continue
            assert ROSDEP_KEYS.get(module, module) in declared, f'{name(path)}: {module}'
            wheels = {module, f'ros-{module.replace("_", "-")}', {'yaml': 'PyYAML'}.get(module)}
            transitive = {'action_msgs', 'builtin_interfaces', 'lifecycle_msgs', 'rcl_interfaces',
                          'rosgraph_msgs', 'rosidl_parser'}
            assert wheels & required or module in transitive, f'{name(path)}: {module}'


@pytest.mark.slow
def test_every_dependency_is_used():
    """Installed code, benchmarks or interfaces use it; generated code uses rosidl's runtime."""
    folders = tuple(ROOT / folder for folder in ('obc_ros', 'launch', 'benchmarks'))
    modules = {module.split('.')[0] for path in PYTHON for module in imports(path)
               if any(path.is_relative_to(folder) for folder in folders)}
    fields = {found for file in INTERFACES for found in re.findall(
        r'^([a-z_]+)/[A-Z]', file.read_text(encoding='utf-8'), re.MULTILINE)}
    text = ''.join(path.read_text(encoding='utf-8') for path in PYTHON
                   if path.is_relative_to(ROOT / 'obc_ros'))
    named = {module for module in NO_WHEELS if f"import_module('{module}.msg')" in text}
    used = modules | fields | named | {'rosidl_default_runtime'}
    keys = {ROSDEP_KEYS.get(module, module) for module in used}
    declared = {element.text for element in PACKAGE if element.tag in ('depend', 'exec_depend')}
    assert declared <= keys, f'package.xml: {sorted(declared - keys)}'
    wheels = used | {f'ros-{each.replace("_", "-")}' for each in used} | {'PyYAML'}
    required = set(map(distribution, REQUIRED))
    assert required <= wheels, f'build_backend.py: {sorted(required - wheels)}'


@pytest.mark.slow
def test_modules_without_ros_import_what_the_pure_wheel_requires():
    """An import of ROS 2 in a function does not count."""
    wheels = {'PyYAML': 'yaml'}
    required = {wheels.get(each, each) for each in map(distribution, build_backend.DEPENDENCIES)}
    paths = [path for path in PYTHON if path.is_relative_to(ROOT / 'obc_ros')
             and not imports_ros(path)]
    assert set(CORE) < set(paths)
    for path in paths:
        for module in {module.split('.')[0] for module in list_imports(path)}:
            assert module in {*sys.stdlib_module_names, 'obc_ros', *required}, name(path)


@pytest.mark.parametrize('distro', ['jazzy', 'kilted'])
def test_every_wheel_is_pinned(distro):
    for part in (distro, 'ros', 'run', 'test', 'notebooks', 'web', 'develop', 'docs'):
        for line in (ROOT / 'requirements' / f'{part}.txt').read_text().splitlines():
            assert not line or line.startswith('#') or re.match(r'[\w.\[\]-]+==[\w.]+', line), line


def test_every_source_file_has_the_license_header():
    sources = files('.py', '.cmake', '.in', 'CMakeLists.txt', '.yml', 'Makefile', 'run')
    others = (*(ROOT / 'config').rglob('*.yaml'), *(ROOT / 'requirements').glob('*.*'))
    for path in (*sources, *others):
        lines = path.read_text(encoding='utf-8').splitlines(keepends=True)
        start = 1 if lines and lines[0].startswith('#!') else 0
        assert tuple(lines[start:start + 2]) == HEADER, name(path)
