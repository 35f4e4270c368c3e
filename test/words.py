# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A line that a person types at a running loop: with `obc`, and with `ros2` where that is."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
import shutil
import subprocess

import support

WORDS = ['obc', *filter(shutil.which, ['ros2'])]


@dataclass(frozen=True)
class Said:
    """What a command printed, and its exit status."""

    status: int
    out: str
    err: str


@dataclass(frozen=True)
class Terminal:
    """Where lines are typed: a word to begin them with, and a domain."""

    word: str
    domain: int
    folder: Path

    def say(self, *line: str, timeout: float = 60.0, **environment: str) -> Said:
        """Run a line and return what it says."""
        done = subprocess.run(
            self.command(*line), capture_output=True, text=True, timeout=timeout, cwd=self.folder,
            env={**support.environment(self.domain), **environment}, stdin=subprocess.DEVNULL)
        return Said(done.returncode, done.stdout, done.stderr)

    def command(self, *line: str) -> Sequence[str]:
        """Return the words of a line."""
        return [support.find('obc') if self.word == 'obc' else self.word, *line]
