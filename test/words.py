# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Lines that a user types at a running loop, with `obc` and, where installed, with `ros2`."""

from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
import shutil
import subprocess

from obc_ros.cli.obc import main
import pytest
import support

WORDS = ['obc', *filter(shutil.which, ['ros2'])]


@dataclass(frozen=True)
class Said:
    """The output and the exit status of a command."""

    status: int
    out: str
    err: str


@dataclass(frozen=True)
class Terminal:
    """A terminal: the program whose lines are typed, and a domain."""

    word: str
    domain: int
    folder: Path

    def say(self, *line: str, timeout: float = 60.0, **environment: str) -> Said:
        """Run a line and return its output and exit status."""
        done = subprocess.run(
            self.command(*line), capture_output=True, text=True, timeout=timeout, cwd=self.folder,
            env={**support.environment(self.domain), **environment}, stdin=subprocess.DEVNULL)
        return Said(done.returncode, done.stdout, done.stderr)

    def say_here(self, *line: str) -> Said:
        """Run a line of `obc` in this process, which is faster; `ros2` runs as in `say`."""
        if self.word != 'obc':
            return self.say(*line)
        out, err = StringIO(), StringIO()
        with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
            patch.chdir(self.folder)
            patch.setenv('ROS_DOMAIN_ID', str(self.domain))
            status = main(line)
        return Said(status, out.getvalue(), err.getvalue())

    def command(self, *line: str) -> Sequence[str]:
        """Return the words of a line."""
        return [support.find('obc') if self.word == 'obc' else self.word, *line]
