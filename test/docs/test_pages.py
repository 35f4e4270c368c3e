# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Every `ros2` command of the pages succeeds beside a running loop.

Pages may write `obc` in place of `ros2`. Each command runs with `obc`, and with `ros2` where that
is installed. The tutorials and the gallery have tests of their own. Not tested: `ros2 security` of
reliability.md, the workspace of install.md and the bridge of views.md, which need a ROS 2
installation, and the command of architecture.md, whose path through the code the page describes.
"""

from collections.abc import Iterator
from contextlib import ExitStack
import os
from pathlib import Path
import re
import shlex
import signal
import subprocess

from obc_ros.cli.obc import ROS2
import pytest
import support
from support import Process
from words import Terminal

ROOT = Path(__file__).resolve().parents[2]
PAGES = ['README.md', 'docs/ros2.md', 'docs/workspace.md', 'docs/tuning.md', 'docs/parameters.md',
         'docs/problems.md', 'docs/faq.md', 'docs/interfaces.md', 'docs/estimation.md',
         'docs/receding_horizon.md', 'docs/view.md']
LOOP = 'ros2 launch obc_ros loop.launch.py scenario:=aircraft'
STAYS = ('launch', 'run')      # verbs that run until they are ended
# The subcommands of `ros2` that `obc` has too.
WORD = f'ros2|obc(?= (?:{"|".join(ROS2)}) )'
# A line of a console block, or a span of code.
LINE = re.compile(rf'^ *(?:\$ )?((?:{WORD}) .*)$|`((?:{WORD}) \w+ \w+ [^`\n]+)`', re.MULTILINE)
# A file that the commands of its page name.
FILE = re.compile(r'`(\w+\.yaml)`:\n\n```yaml\n(.*?)```', re.DOTALL)


def lines(page: str) -> list[str]:
    """Return the commands of a page in order."""
    text = (ROOT / page).read_text(encoding='utf-8')
    found = (block or span for block, span in LINE.findall(text))
    return [each for each in found if not re.search(r'\b[A-Z]{4,}\b', each)]


def test_every_page_with_commands_is_tested() -> None:
    there = [path for path in (ROOT / 'README.md', *sorted((ROOT / 'docs').rglob('*.md')))
             if path.parent.name != 'gallery'   # it has the commands of the run that made it
             and LINE.search(path.read_text(encoding='utf-8'))]
    assert {str(path.relative_to(ROOT)) for path in there} <= {
        *PAGES, 'docs/tutorial.md', 'docs/output_feedback.md', 'docs/gallery.md',
        'docs/install.md', 'docs/refusals.md', 'docs/views.md',
        'docs/development/reliability.md', 'docs/development/architecture.md'}
    assert sum(len(lines(page)) for page in PAGES) > 40


@pytest.mark.parametrize('page', PAGES)
def test_the_commands_of_a_page_succeed(page: str, terminal: Terminal) -> None:
    with ExitStack() as stack:
        loop = _Loop(terminal)
        stack.callback(loop.end)
        text = (ROOT / page).read_text(encoding='utf-8')
        for name, content in FILE.findall(text):
            (terminal.folder / name).write_text(content, encoding='utf-8')
        for line in lines(page):
            typed = re.sub('^(ros2|obc)', terminal.word, line)
            if line.split()[1] in STAYS:
                loop.begin(typed)
                continue
            if line.split()[1] != 'interface' and not loop.process:
                loop.begin(re.sub('^ros2', terminal.word, LOOP))
            _check(line, *_type(typed, terminal))


class _Loop:
    """The process that a page has started last, in a process group of its own."""

    def __init__(self, terminal: Terminal) -> None:
        self._terminal = terminal
        self._count = 0
        self.process: Process | None = None

    def begin(self, line: str) -> None:
        self.end()
        self._count += 1
        folder = self._terminal.folder
        self.process = Process(
            ['bash', '-c', f'cd {shlex.quote(str(folder))}; PATH={_path()}; exec {line}'],
            folder / f'{self._count}.log', self._terminal.domain)
        vehicles = re.search(r'vehicles:=(\d+)', line)
        wanted = int(vehicles[1]) if vehicles else 1
        output = self.process.output
        support.wait_for(lambda: output().count('revision 1:') >= wanted
                         and ('loop.launch' not in line or 'ready: ' in output()), 120.0)

    def end(self) -> None:
        if self.process:
            os.killpg(self.process.pid, signal.SIGINT)  # Ctrl-C
            self.process.wait(30.0)
            self.process.end()
        self.process = None


def _path() -> str:
    return os.pathsep.join([str(Path(support.find('obc')).parent), os.environ['PATH']])


def _type(line: str, terminal: Terminal) -> tuple[int, str]:
    """Run a line in a shell and return its exit status and output; Ctrl-C ends `hz`."""
    with subprocess.Popen(
            ['bash', '-c', f'exec {line}'], cwd=terminal.folder, text=True,
            env={**support.environment(terminal.domain), 'PATH': _path()},
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as shell:
        if ' topic hz ' in line:
            printed = ''.join(_until(shell, 'window'))
            shell.send_signal(signal.SIGINT)
            shell.wait(30.0)
            return 0, printed
        printed, _ = shell.communicate(timeout=120.0)
    return shell.returncode, printed


def _until(shell: 'subprocess.Popen[str]', word: str) -> Iterator[str]:
    assert shell.stdout
    for line in shell.stdout:
        yield line
        if word in line:
            return


def _check(line: str, status: int, printed: str) -> None:
    """Check the exit status and output of a line by its verb."""
    report = f'{line}\n{printed}'
    if '# rejected' in line:
        assert 'Setting parameter failed: ' in printed, report
        return
    assert status == 0, report
    assert 'failed' not in printed, report
    assert 'Traceback' not in printed, report
    verb = ' '.join(line.split()[1:3])
    wanted = {'param set': 'Set parameter successful', 'param get': 'values are: [',
              'service call': 'response:\n', 'topic hz': 'average rate: ',
              'topic echo': '\n---\n', 'lifecycle set': 'Transitioning successful',
              'action send_goal': 'Goal finished with status: SUCCEEDED',
              'node list': '/lqr_node\n', 'param describe': 'Parameter name: '}
    assert wanted.get(verb, '') in printed, report
    if verb == 'service call':
        assert 'success=False' not in printed, report
        assert 'successful=False' not in printed, report
