# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Security: no data is executed, and nodes open only the names of the policy."""

import ast
from collections.abc import Iterator
import os
from pathlib import Path
import re
import time
from typing import Any
from xml.etree import ElementTree

from obc_ros.cli.processes import isolate
from obc_ros.core.ocp import statement
from obc_ros.core.text import yaml_files
from obc_ros.core.text.errors import StatementError
from obc_ros.ros.middleware import LOOPBACK, VARIABLES
import pytest

ROOT = Path(__file__).resolve().parents[2]
POLICY = ROOT / 'security' / 'policy.xml'
ACTION = re.compile(r'/_action/\w+$')

# Means to execute data, to start a shell, or to reach objects by computed names.
MODULES = {
    'cloudpickle', 'code', 'codeop', 'cPickle', 'dill', 'imp', 'joblib', 'jsonpickle', 'marshal',
    'pickle', 'pty', 'runpy', 'shelve', 'xmlrpc',
}
NAMES = {'__builtins__', '__import__', 'breakpoint', 'compile', 'eval', 'exec'}
ATTRIBUTES = {
    '__builtins__', '__code__', '__globals__', '__import__', '__reduce__', '__reduce_ex__',
    '__subclasses__', 'allow_pickle', 'extractall', 'getoutput', 'getstatusoutput',
    'run_module', 'run_path', 'startfile',
    'CFullLoader', 'CLoader', 'CUnsafeLoader', 'FullLoader', 'Loader', 'UnsafeLoader',
    'full_load', 'load_all', 'unsafe_load', 'unsafe_load_all',
}
OWNED = {('yaml', 'load'), ('np', 'load'), ('numpy', 'load'), ('builtins', 'eval'),
         ('builtins', 'exec'), ('tempfile', 'mktemp')}
FAMILIES = re.compile(r'^os\.(exec[lv]|spawn[lv]|posix_spawn|popen|system)')
PROCESSES = {'Popen', 'call', 'check_call', 'check_output', 'run'}
IMPORTS = ('exec_module', 'import_module')
# Files that import modules by a variable name, and the origin of that name.
IMPORTS_BY_NAME = {
    'obc_ros/cli/obc.py': 'one of MODULES',
    'obc_ros/workers/process.py': 'given by the pool on the command line',
    'obc_ros/workers/steps/step_process.py': 'given by the link on the command line',
    'obc_ros/__init__.py': 'one of the modules of the public names',
    'obc_ros/core/numerics/arrays.py': 'one of the modules of SciPy that are named there',
    'benchmarks/timing.py': 'a constant of a benchmark',
    'docs/gallery_answers.py': 'a program of docs/gallery',
    'obc_ros/cli/ros2/yaml_messages.py': 'PACKAGE.msg, .srv or .action of an identifier PACKAGE',
    'obc_ros/cli/ros2/launch_file.py': 'the launch file that a user starts, as ros2 launch does',
}
# Files that read what they have pickled themselves: users do so with problems and answers.
PICKLES = ('test/api/test_pickling.py',)
# Files that replace their process by another program, and that program.
PROGRAMS = {('obc_ros/cli/ros2/run.py', 'os.execv'): 'an executable file of the package it names'}


def find_dangers(text: str, name: str) -> Iterator[str]:
    """Yield a sentence for everything in a Python text that could execute data."""
    for node in ast.walk(ast.parse(text)):
        where = f'{name}:{getattr(node, "lineno", 0)}:'
        match node:
            case ast.Import(names=names):
                yield from (f'{where} import {each.name}' for each in names
                            if each.name.split('.')[0] in MODULES
                            and not (each.name == 'pickle' and name in PICKLES))
            case ast.ImportFrom(module=module, names=names):
                if str(module).split('.')[0] in MODULES:
                    yield f'{where} from {module}'
                yield from (f'{where} from {module} import {each.name}' for each in names
                            if each.name in ATTRIBUTES | NAMES
                            or FAMILIES.match(f'{module}.{each.name}'))
            case ast.Name(id=identifier) if identifier in NAMES:
                yield f'{where} {identifier}'
            case ast.Attribute(value=owner, attr=attribute) if (
                    attribute in ATTRIBUTES or (ast.unparse(owner), attribute) in OWNED
                    or FAMILIES.match(f'{ast.unparse(owner)}.{attribute}')
                    and (name, f'{ast.unparse(owner)}.{attribute}') not in PROGRAMS):
                yield f'{where} {ast.unparse(node)}'
            case ast.keyword(arg='shell' | 'allow_pickle', value=value) if not (
                    isinstance(value, ast.Constant) and value.value is False):
                yield f'{where} {node.arg}={ast.unparse(value)}'
            case ast.Call(func=function, args=arguments):
                yield from (f'{where} {each}' for each in calls(function, arguments, name))


def calls(function: ast.expr, arguments: list[ast.expr], name: str) -> Iterator[str]:
    """Yield the reasons why a call is unsafe."""
    called = ast.unparse(function)
    first = arguments[0] if arguments else None
    if called.startswith('subprocess.') and called.split('.')[-1] in PROCESSES and isinstance(
            first, (ast.Constant, ast.JoinedStr)):
        yield f'{called} of a text'
    if called.split('.')[-1] in IMPORTS and not isinstance(first, ast.Constant) and (
            name not in IMPORTS_BY_NAME and not name.startswith('test/')):
        yield f'{called}({ast.unparse(first) if first else ""})'
    if called == 'getattr' and len(arguments) > 1 and isinstance(
            arguments[1], ast.Constant) and arguments[1].value in ATTRIBUTES | NAMES:
        yield f'getattr of {arguments[1].value}'


def sources() -> list[Path]:
    """Return all Python files of the project."""
    folders = ('benchmarks', 'docs', 'launch', 'obc_ros', 'requirements', 'test')
    return sorted([*ROOT.glob('*.py'), *(
        path for folder in folders for path in (ROOT / folder).rglob('*.py'))])


@pytest.mark.slow
def test_no_code_of_the_project_executes_data():
    assert [each for path in sources() for each in find_dangers(
        path.read_text(encoding='utf-8'), str(path.relative_to(ROOT)))] == []


@pytest.mark.parametrize('text', [
    'eval("1")', 'import builtins\nbuiltins.exec("a")', 'compile("1", "", "eval")',
    'import marshal', 'from pickle import loads', 'import runpy', 'from os import system',
    'os.execv("/bin/sh", [])', 'os.spawnlp(0, "sh")', 'yaml.load(text)',
    'yaml.load(text, Loader=yaml.FullLoader)', 'from yaml import UnsafeLoader',
    'subprocess.run("ls | sort")', 'subprocess.Popen(f"rm {path}")',
    'subprocess.run(words, shell=True)', 'subprocess.run(words, shell=shell)',
    'np.load(file, allow_pickle=True)', 'np.load(file)', '().__class__.__base__.__subclasses__()',
    'getattr(builtins, "eval")', 'import_module(name)', '__import__("os")',
    'archive.extractall(folder)', 'run = exec', 'os.system("ls")', 'tempfile.mktemp()'])
def test_code_that_executes_data_is_reported(text):
    assert list(find_dangers(text, 'file.py'))


def test_listed_files_still_import_by_a_variable_name():
    """A file that does so no more must leave the list."""
    for name in IMPORTS_BY_NAME:
        text = (ROOT / name).read_text(encoding='utf-8')
        assert any(f'{each}(' in text for each in IMPORTS), name


@pytest.mark.parametrize('text', [
    '!!python/object/apply:os.system ["touch FILE"]',
    'a: !!python/object/new:subprocess.Popen [["touch", "FILE"]]',
    'a: !!python/name:os.system',
    'a: !!python/module:antigravity',
    '&a [*a, *a]\n--- {<<: *a}'])
def test_hostile_yaml_is_refused_and_not_executed(text, tmp_path):
    mark, path = tmp_path / 'mark', tmp_path / 'problem.yaml'
    path.write_text(text.replace('FILE', str(mark)))
    with pytest.raises(StatementError):
        statement.load_file(path)
    with pytest.raises(StatementError):
        yaml_files.read_yaml(path)
    assert not mark.exists()


def test_processes_do_not_import_from_the_current_folder():
    """``python -m`` looks for modules in the current folder first, unless ``-P`` says not to."""
    started = re.compile(r"sys\.executable,\s*'-m',?\s*f?'(?!pytest)")
    assert [str(path.relative_to(ROOT)) for folder in ('benchmarks', 'launch', 'obc_ros')
            for path in (ROOT / folder).rglob('*.py')
            if started.search(path.read_text(encoding='utf-8'))] == []


def test_aliases_are_counted_before_anything_is_built(tmp_path):
    """Eight lists of ten aliases, one in the other, stand for 10**9 numbers."""
    path = tmp_path / 'bomb.yaml'
    lists = [f'  a{k}: &a{k} [{", ".join([f"*a{k - 1}"] * 10)}]' for k in range(1, 9)]
    path.write_text('\n'.join(['parameters:', f'  a0: &a0 [{", ".join("1" * 10)}]', *lists]))
    assert path.stat().st_size < 600
    begin = time.process_time()
    for read in (yaml_files.read_yaml, statement.load_file):
        with pytest.raises(StatementError, match='its aliases expand it to 1.*e.09 bytes'):
            read(path)
    assert time.process_time() - begin < 1.0


def test_an_alias_in_itself_is_refused():
    with pytest.raises(StatementError, match='an alias contains itself'):
        yaml_files.read_text('a: &a [1, *a]', 'the text')


def test_aliases_within_the_limit_stand_for_their_values():
    assert yaml_files.read_text('{a: &a [1, 2], b: *a}', 'the text') == {'a': [1, 2], 'b': [1, 2]}


@pytest.mark.slow
def test_a_text_without_aliases_is_refused_for_its_length_only():
    limit = yaml_files.MAX_BYTES
    assert len(yaml_files.read_text('[' + '1,' * (limit // 2 - 1) + ']', 't')) == limit // 2 - 1


def test_a_command_restricts_discovery_to_this_machine(monkeypatch):
    """Variables of the shell do not change this; conftest.py does the same for the tests."""
    for name, value in (('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET'), ('ROS_DOMAIN_ID', '0'),
                        ('ROS_STATIC_PEERS', '192.0.2.1'), ('ROS_LOCALHOST_ONLY', '0')):
        monkeypatch.setenv(name, value)
    for name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'):
        monkeypatch.setenv(name, '1')
    isolate(42)
    assert is_restricted()
    assert os.environ['ROS_DOMAIN_ID'] == '42'
    assert not {'ROS_STATIC_PEERS', 'ROS_LOCALHOST_ONLY'} & set(os.environ)


def is_restricted() -> bool:
    """Return whether the middleware is restricted to this machine, or its profile is."""
    wanted = os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE']
    return wanted == 'LOCALHOST' or (
        wanted == 'SYSTEM_DEFAULT' and str(LOOPBACK) in map(os.environ.get, VARIABLES))


def test_the_tests_restrict_discovery_to_this_machine(spawn):
    assert is_restricted()
    node = spawn('plant_simulator')
    node.wait_for_output('until the first command')   # after the ROS wheels have re-executed it
    given = Path(f'/proc/{node.pid}/environ').read_bytes().split(b'\0')
    assert b'ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST' in given
    assert f'ROS_DOMAIN_ID={spawn.domain}'.encode() in given


def test_launch_restricts_discovery_by_default():
    tree = ast.parse((ROOT / 'launch' / 'loop.launch.py').read_text(encoding='utf-8'))
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)
             and ast.unparse(node.func) == 'SetEnvironmentVariable']
    assert [ast.unparse(call.args[0]) for call in calls] == ["'ROS_AUTOMATIC_DISCOVERY_RANGE'"]
    assert ast.unparse(calls[0].args[1]) == "LaunchConfiguration('discovery_range')"
    defaults = [node for node in ast.walk(tree) if isinstance(node, ast.Call)
                and ast.unparse(node.func) == 'EnvironmentVariable']
    assert [ast.unparse(each) for each in defaults] == [
        "EnvironmentVariable('ROS_AUTOMATIC_DISCOVERY_RANGE', default_value='LOCALHOST')"]


# The SROS2 policy, compared with the graph of running nodes


Names = dict[str, set[str]]


def allowed(node: str) -> Names:
    """Return the names that the policy allows a node, its own name as ~."""
    found: Names = {}
    for profile in ElementTree.parse(POLICY).iter('profile'):
        if profile.get('node') == node:
            for group in profile:
                kind, value = next(iter(group.attrib.items()))
                assert value == 'ALLOW'
                found.setdefault(kind, set()).update(str(each.text) for each in group)
    return found


def opened(observer: Any, node: str, namespace: str) -> Names:
    """Return the names that a running node has opened, in the notation of a policy."""

    def names(query: str) -> list[str]:
        pairs = getattr(observer, f'get_{query}_names_and_types_by_node')(node, namespace)
        return [relative(name, node, namespace) for name, _ in pairs]

    services, topics = names('service'), names('publisher')
    return {
        'publish': {name for name in topics if not ACTION.search(name)},
        'subscribe': set(names('subscriber')),
        'reply': {name for name in services if not ACTION.search(name)},
        'execute': {ACTION.sub('', name) for name in services if ACTION.search(name)},
        'request': set(names('client'))}


def relative(name: str, node: str, namespace: str) -> str:
    own = f'{namespace}/{node}/'
    return f'~/{name.removeprefix(own)}' if name.startswith(own) else name.removeprefix(
        f'{namespace}/')


CONFIGURATIONS = {
    'plant_simulator': (
        {'publish_clock': True, 'measurement.gps_x.rate': 10.0},
        {'use_sim_time': True, 'system': 'vehicle'}),
    'estimator_node': ({'use_sim_time': True},),
    'lqr_node': (
        {'use_sim_time': True},
        {'state_source': 'odom', 'command_sink': 'wrench', 'unlimited': True},
        {'system': 'vehicle', 'state_source': 'odom', 'command_sink': 'cmd_vel',
         'setpoint_input': [1.0, 0.0], 'u_limits': [0.0, 2.0, -0.5, 0.5]}),
    'mpc_node': (
        {'use_sim_time': True},
        {'state_source': 'odom', 'command_sink': 'wrench', 'unlimited': True},
        {'system': 'vehicle', 'state_source': 'odom', 'command_sink': 'cmd_vel',
         'setpoint_input': [1.0, 0.0], 'u_limits': [0.0, 2.0, -0.5, 0.5]}),
    'trajectory_server': (
        {'workers': 1, 'use_sim_time': True}, {'workers': 1, 'state_source': 'odom'})}


def test_the_policy_allows_exactly_the_names_that_nodes_open(spawn, probe):
    """The allowed names of a node are the union of those that its configurations open."""
    spawned = []
    for node, configurations in CONFIGURATIONS.items():
        for number, parameters in enumerate(configurations):
            namespace = f'/{node}{number}'
            spawn(node, parameters, namespace=namespace)
            spawned.append((node, namespace))

    def differences() -> list[str]:
        # the names of a node are discovered one after the other
        wrong = []
        for node in CONFIGURATIONS:
            wanted: Names = allowed(node)
            have: Names = {}
            for each, namespace in spawned:
                if each == node and (node, namespace) in present():
                    for kind, names in opened(probe.node, node, namespace).items():
                        have.setdefault(kind, set()).update(names)
            wrong += [f'{node}: {kind} {sorted(have.get(kind, set()) ^ wanted.get(kind, set()))}'
                      for kind in have.keys() | wanted.keys()
                      if have.get(kind, set()) != wanted.get(kind, set())]
        return wrong

    def present() -> list[tuple[str, str]]:
        return probe.node.get_node_names_and_namespaces()

    try:
        probe.wait_for(lambda: not differences())
    except AssertionError:
        raise AssertionError('\n'.join(differences())) from None
    # running nodes open no further names
    probe.spin_for(1.0)
    assert not differences()
