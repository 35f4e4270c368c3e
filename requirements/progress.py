# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Run a command of `make setup` and show that it goes on: what it does, and for how long.

progress.py TITLE COMMAND...

On a terminal one line is written again every second, elsewhere one line every ten. All that the
command has printed is shown if it fails; the exit status is its own.
"""

from collections.abc import Sequence
import selectors
import subprocess
import sys
import time

WIDTH = 100  # characters of a line
LIVE, PLAIN = 1.0, 10.0  # [s] between two lines, on a terminal and elsewhere


def run(title: str, command: Sequence[str]) -> int:
    """Run a command; return its exit status."""
    live = sys.stdout.isatty()
    begun = told = time.monotonic()
    print(f'obc_ros: {title}', flush=True)
    said = b''
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                          bufsize=0) as process:
        assert process.stdout
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            while True:
                if selector.select(0.5):
                    some = process.stdout.read(1 << 16)
                    if not some:
                        break
                    said += some
                if time.monotonic() - told >= (LIVE if live else PLAIN):
                    told = time.monotonic()
                    print(shown(told - begun, said, live), end='' if live else '\n', flush=True)
    clear = '\r\033[K' if live else ''
    if process.returncode:
        print(clear + said.decode(errors='replace'), file=sys.stderr)
    print(f'{clear}obc_ros: {title}: {"failed" if process.returncode else "done"} '
          f'after {time.monotonic() - begun:.0f} s', flush=True)
    return process.returncode


def shown(elapsed: float, said: bytes, live: bool) -> str:
    """Return a line that tells how long it has taken so far, and what was printed last."""
    last = said.decode(errors='replace').strip().rpartition('\n')[2] or 'begins'
    text = f'obc_ros: {elapsed:4.0f} s  {last}'
    return f'\r\033[K{text[:WIDTH - 1]}' if live else text[:WIDTH]


if __name__ == '__main__':
    sys.exit(run(sys.argv[1], sys.argv[2:]))
