# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The tutorial runs as its page shows, and the reference agrees with the sources."""

from contextlib import suppress
from dataclasses import fields
import doctest
from importlib import import_module, util
import inspect
import os
from pathlib import Path
import re
import shlex
import signal
import subprocess
import sys

from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.systems import registry
import pytest
import support
import yaml

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / 'docs'
PAGES = [ROOT / 'README.md', *sorted(DOCS.rglob('*.md'))]
BLOCK = re.compile(r'^```(?:\{code-block\} )?(\w+)\n(?::caption: (\S+)\n\n)?(.*?)^```$',
                   re.MULTILINE | re.DOTALL)


def blocks(page: str) -> list[tuple[str, str, str]]:
    """Return language, caption and text of the code blocks of a page."""
    return BLOCK.findall((DOCS / page).read_text(encoding='utf-8'))


def steps(text: str) -> list[tuple[str, str]]:
    """Return the commands of a console block, each with its output."""
    found = re.findall(r'^\$ (.*)\n((?:(?!\$ ).*\n)*)', text, re.MULTILINE)
    assert ''.join(f'$ {command}\n{said}' for command, said in found) == text
    return found


@pytest.fixture(scope='module')
def sources():
    """Return the module docs/sources.py, which reads the sources when the site is built."""
    spec = util.spec_from_file_location('sources', DOCS / 'sources.py')
    module = sys.modules[spec.name] = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.ros
@pytest.mark.parametrize('node', [
    'estimator_node', 'lqr_node', 'mpc_node', 'plant_simulator', 'trajectory_server'])
def test_the_reference_lists_the_parameters_of_the_node(node, sources):
    module = sources.TABLES[node]
    rows = {row.name: row for row in sources.parameters(ROOT, module)}
    table = fields(import_module(module).Settings)
    groups = [each.name for each in table if 'group' in each.metadata]
    assert all(any(name.startswith(f'{group}.') for name in rows) for group in groups)
    for each in table:
        if entry := each.metadata.get('entry'):
            row = rows.pop(entry.name or each.name)
            for key in ('default', 'description', 'unit', 'lower', 'upper', 'choices',
                        'read_only'):
                assert getattr(row, key) == getattr(entry, key), f'{row.name}: {key}'
    assert all(name.partition('.')[0] in groups for name in rows)


@pytest.mark.ros
@pytest.mark.parametrize('kind', ['msg', 'srv', 'action'])
def test_the_reference_lists_the_interfaces_of_the_package(kind, sources):
    for file in sorted((ROOT / kind).iterdir()):
        found = sources.interface(file)
        made = getattr(import_module(f'obc_ros.{kind}'), file.stem)
        assert found.about
        for part, named in found.parts:
            message = getattr(made, part) if part else made
            assert [each.name for each in named] == list(message.get_fields_and_field_types())


@pytest.mark.slow
def test_the_reference_lists_the_modules_of_the_package(sources):
    kinds = {}
    for module in sources.modules(ROOT, 'obc_ros/core'):
        there = import_module(module.name)
        assert module.summary
        for member in module.members:
            kinds[member.name] = member.kind
            assert inspect.isclass(getattr(there, member.name)) == (member.kind == 'class')
            assert member.summary, f'{module.name}.{member.name}'
    assert (kinds['LqrDesign'], kinds['solve'], kinds['certify']) == (
        'class', 'function', 'function')


def test_the_reference_lists_an_overloaded_function_once(sources):
    [module] = (each for each in sources.modules(ROOT, 'obc_ros/api')
                if each.name == 'obc_ros.api.regulators')
    [lqr] = (each for each in module.members if each.name == 'lqr')
    assert 'plant_or_A' in lqr.parameters
    assert lqr.summary.startswith('Return the gain')


def test_the_page_lists_the_registered_systems():
    text = (DOCS / 'systems.md').read_text(encoding='utf-8').partition('\n## ')[0]
    rows = re.findall(r'^\| `(\w+)` \| ([^|]*) \| ([^|]*) \|.*\| ([^|]*)\|$', text, re.MULTILINE)
    assert {name for name, *_ in rows} == set(registry.list_systems())
    for name, states, inputs, parameters in rows:
        if not registry.get_options(name):
            system = registry.get_system(name)
            assert (states, inputs) == (', '.join(system.state_names),
                                        ', '.join(system.input_names))
            assert parameters.strip() == ', '.join(
                f'{each.name} = {each.value:g} {each.unit}'.strip() for each in system.parameters)


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_commands_name_existing_parameters_and_interfaces(page, sources):
    text = page.read_text(encoding='utf-8')
    for node, name in re.findall(r'(?:ros2|obc) param \w+ /(\w+) (\w+)', text):
        assert name in {row.name for row in sources.parameters(ROOT, sources.TABLES[node])}, name
    for kind, name in re.findall(r'obc_ros/(msg|srv|action)/(\w+)', text):
        assert (ROOT / kind / f'{name}.{kind}').is_file(), name


def test_the_examples_are_valid_problems():
    problems = {caption: build_problem(yaml.safe_load(text))
                for language, caption, text in blocks('examples.md') if language == 'yaml'}
    assert list(problems) == ['least_time.yaml', 'obstacle.yaml', 'road.yaml']
    assert [f'{each.name}.yaml' for each in problems.values()] == list(problems)


def say_page(page: str, terminal, domain, folder: Path) -> None:
    """
    Check that the commands of a page print what it shows.

    They run with `obc`, and with `ros2` where it is installed; captioned blocks are files.
    """
    commands = []
    for language, caption, text in blocks(page):
        if caption:
            (folder / caption).write_text(text)
        elif language == 'console':
            commands += steps(text)
    assert len(commands) > 10
    bin_ = folder / 'bin'
    bin_.mkdir()
    for name in ('plant_simulator', 'estimator_node', 'lqr_node', 'obc'):
        (bin_ / name).symlink_to(support.find(name))
    (bin_ / 'python').write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} "$@"\n')
    (bin_ / 'python').chmod(0o755)
    said = run(folder, domain, [re.sub('^ros2 ', f'{terminal.word} ', command)
                                for command, _ in commands])
    checker, options = doctest.OutputChecker(), doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    for (command, wanted), got in zip(commands, said, strict=True):
        assert checker.check_output(wanted, got, options), f'$ {command}\n{got}\nnot\n{wanted}'


def test_the_tutorial_prints_what_its_page_shows(terminal, domain, tmp_path):
    say_page('tutorial.md', terminal, domain, tmp_path)
    assert (tmp_path / 'figures' / 'crane.png').stat().st_size > 10_000
    assert 'then its end is held' in (tmp_path / 'log').read_text()


def test_the_tutorial_of_output_feedback_prints_what_its_page_shows(terminal, domain, tmp_path):
    say_page('output_feedback.md', terminal, domain, tmp_path)
    assert 'filter form, slowest pole' in (tmp_path / 'log').read_text()


def run(folder: Path, domain: int, commands: list[str]) -> list[str]:
    """Run commands in one shell, as a user types them; return the output of each."""
    mark = '--- next ---'
    # A background process writes to a file, as it would write to another terminal.
    lines = [re.sub(r' &$', ' >> log 2>&1 &', command) for command in commands]
    lines = [f'{line} 2>&1' if re.match('(obc|ros2) param', line) else line
             for line in lines]
    script = ''.join(f'{line}\necho {shlex.quote(mark)}\n' for line in lines) + 'wait\n'
    environment = support.environment(domain)
    path = os.pathsep.join([str(folder / 'bin'), environment.get('PATH', '')])
    with (folder / 'errors').open('w') as errors:
        shell = subprocess.Popen(
            ['bash', '-c', script], cwd=folder, env={**environment, 'PATH': path}, text=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors,
            start_new_session=True)
    try:
        output, _ = shell.communicate(timeout=200)
    finally:
        with suppress(ProcessLookupError):  # no process of the group is left
            os.killpg(shell.pid, signal.SIGKILL)
        shell.wait()
    said = output.split(f'{mark}\n')
    assert len(said) == len(commands) + 1, f'{output}\n{(folder / "errors").read_text()}'
    return said[:-1]
