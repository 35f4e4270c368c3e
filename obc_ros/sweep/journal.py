# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The journal of a sweep: finished chunks, appended to a file as they come.

Each line is written and synchronised to the disk before the chunk counts as finished. A line that
was not written completely is dropped when the journal is opened again.
"""

from collections.abc import Mapping, Sequence
import json
import os
from pathlib import Path
import sys
from types import TracebackType
from typing import Any

from obc_ros.core.text.errors import ObcError, quote, StatementError

if sys.platform != 'win32':
    import fcntl

QUESTION = 'question.json'
JOURNAL = 'journal.jsonl'


class Journal:
    """
    The folder of a sweep, opened by one process.

    :param folder: created if it is missing.
    :param resume: whether to go on with a sweep that the folder holds.
    :ivar chunks: the rows of each finished chunk, by its number.
    :raises StatementError: if the folder holds a sweep and `resume` is not set, or a sweep with
        another question.
    :raises ObcError: if another process has it open.
    :raises OSError: if it cannot be written.
    """

    def __init__(self, folder: Path, question: Mapping[str, Any], resume: bool) -> None:
        self.chunks: dict[int, list[dict[str, Any]]] = {}
        check_folder(folder, question, resume)
        folder.mkdir(parents=True, exist_ok=True)
        self._file = os.open(folder / JOURNAL, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        try:
            self._open(folder, question)
        except BaseException:
            os.close(self._file)
            raise

    def __enter__(self) -> 'Journal':
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        os.close(self._file)

    def append(self, number: int, rows: Sequence[dict[str, Any]]) -> None:
        """Write the rows of a finished chunk; they are on the disk on return."""
        line = json.dumps({'chunk': number, 'rows': rows}, separators=(',', ':')) + '\n'
        data = line.encode()
        while data:
            data = data[os.write(self._file, data):]
        os.fsync(self._file)
        self.chunks[number] = list(rows)

    def _open(self, folder: Path, question: Mapping[str, Any]) -> None:
        try:
            if sys.platform != 'win32':  # there a sweep ends in words: no worker starts
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ObcError(f'{folder}: another process writes this sweep') from None
        if not (folder / QUESTION).exists():
            _write_whole(folder / QUESTION, json.dumps(question, indent=1) + '\n')
        with open(self._file, 'rb', closefd=False) as file:
            file.seek(0)
            kept = 0
            for line in file:
                if not line.endswith(b'\n'):   # the process ended while it wrote
                    break
                try:
                    entry = json.loads(line)
                    self.chunks[entry['chunk']] = entry['rows']
                except (ValueError, KeyError, TypeError):
                    raise StatementError(
                        f'{folder / JOURNAL}: a line is damaged, after {kept} bytes; remove it to '
                        'solve its points again') from None
                kept += len(line)
        os.ftruncate(self._file, kept)


def check_folder(folder: Path, question: Mapping[str, Any], resume: bool) -> None:
    """Raise StatementError, as `Journal`, if a sweep cannot be written; nothing is changed."""
    try:
        text = (folder / QUESTION).read_text(encoding='utf-8')
    except FileNotFoundError:
        if resume:
            raise StatementError(f'{folder}: there is no sweep to resume') from None
        if (folder / JOURNAL).exists():
            raise StatementError(f'{folder}: {JOURNAL} is there without {QUESTION}') from None
        return
    if not resume:
        raise StatementError(f'{folder}: there is a sweep already; --resume goes on with it, '
                             '--out names another folder')
    try:
        before = json.loads(text)
        changed = sorted(key for key in {*before, *question}
                         if before.get(key) != question.get(key))
    except (ValueError, TypeError):
        raise StatementError(f'{folder / QUESTION} is damaged') from None
    if changed:
        key = changed[0]
        raise StatementError(
            f'{folder}: the sweep there has another question: {", ".join(changed)} changed '
            f'({key}: {quote(str(before.get(key)))} there, {quote(str(question.get(key)))} here); '
            '--out names another folder')


def _write_whole(path: Path, text: str) -> None:
    part = path.with_suffix('.part')
    with open(part, 'w', encoding='utf-8') as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)
