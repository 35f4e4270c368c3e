# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Check the sheets of a class: one is reported in full, several are counted, as CSV as well."""

from collections.abc import Sequence
import csv
from dataclasses import dataclass
from pathlib import Path

from obc_ros.book.teaching.sheet import (
    check_sheet,
    CheckedAnswer,
    count_verdicts,
    print_sheet,
    QUESTIONS,
    VERDICTS,
)
from obc_ros.cli.terminal import print_table
from obc_ros.core.text.errors import ObcError, quote, StatementError


@dataclass(frozen=True)
class StudentRow:
    """The checked answers of a file, or the error for which it cannot be read."""

    file: Path
    answers: Sequence[CheckedAnswer] = ()
    error: str = ''

    @property
    def status(self) -> int:
        """Return 2 if the file or an answer is unreadable, 1 if an answer is wrong."""
        verdicts = {each.verdict for each in self.answers}
        return 2 if self.error or 'unreadable' in verdicts else int('wrong' in verdicts)

    @property
    def counts(self) -> list[str]:
        """Return the counts of `VERDICTS`, empty for an unreadable file."""
        return [''] * len(VERDICTS) if self.error else [
            str(count) for count in count_verdicts(self.answers).values()]


def report_class(files: Sequence[Path], table: Path | None = None) -> int:
    """
    Check sheets and print the verdicts; return the worst exit status.

    :param table: CSV file to write, with a row for each sheet.
    :raises StatementError: if there is one sheet only, and it cannot be read.
    """
    rows = [_check(file) for file in files]
    if len(rows) > 1:
        _print_class(rows)
    elif not rows[0].error:
        print_sheet(rows[0].answers)
    if table:
        _write_table(table, rows)
    if len(rows) == 1 and rows[0].error:
        raise StatementError(rows[0].error)
    return max(row.status for row in rows)


def _check(file: Path) -> StudentRow:
    try:
        return StudentRow(file, check_sheet(file))
    except StatementError as error:
        return StudentRow(file, error=str(error))


def _print_class(rows: Sequence[StudentRow]) -> None:
    print_table(('file', *VERDICTS), [(quote(str(row.file), None), *row.counts) for row in rows])
    for row in rows:
        if row.error:
            print(quote(row.error, None))


def _write_table(path: Path, rows: Sequence[StudentRow]) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open('w', encoding='utf-8', newline='')
    except OSError as error:
        raise ObcError(f'{path} cannot be written: {error.strerror}') from None
    with file:
        writer = csv.writer(file)
        writer.writerow(['file', *VERDICTS, 'error', *(each.name for each in QUESTIONS)])
        for row in rows:
            verdicts = [each.verdict for each in row.answers] or [''] * len(QUESTIONS)
            writer.writerow([quote(str(row.file), None), *row.counts, quote(row.error, None),
                             *verdicts])
