# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Write the sheet of all questions, and check the answers of a filled one."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
import textwrap
from typing import Any

from obc_ros.book.teaching.examples import EXAMPLES
from obc_ros.book.teaching.exercises import EXERCISES
from obc_ros.book.teaching.question import SheetQuestion
from obc_ros.cli.terminal import print_table
from obc_ros.core.text.errors import describe_type, ObcError, quote, StatementError, suggest_name
from obc_ros.core.text.yaml_files import read_yaml

QUESTIONS: tuple[SheetQuestion, ...] = (*EXAMPLES, *EXERCISES)
COMMENT_WIDTH = 97   # characters
VERDICTS = ('right', 'wrong', 'unreadable', 'open')
COLOURS = {'right': 'green', 'wrong': 'red', 'unreadable': 'red'}
HEAD = """\
Exercises of chapter 2 of R. M. Murray, Optimization-Based Control (draft v2.1a), and of
estimation and receding horizons.
Write each answer after the colon; leave it empty to skip a question. Then:
    obc gallery --check {name}
Numbers: three digits, or a formula such as sqrt(3)/2. Formulas: + - * / ^, sin cos tan exp log
sqrt, pi; 2 a q is a product. Matrices: rows as [[1, 2], [3, 4]]. SI units and radians. The
costate belongs to H = L + lambda f, which the optimal input minimises; feedback is u = -K x."""


@dataclass(frozen=True)
class CheckedAnswer:
    """An answer of a sheet: `verdict` is right, wrong, unreadable or open, `why` the reason."""

    name: str
    verdict: str
    why: str = ''


def write_sheet(path: Path) -> None:
    """Write the sheet, a YAML file without answers; ObcError if the file exists."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open('x', encoding='utf-8') as file:
            file.write(format_sheet(path.name))
    except FileExistsError:
        raise ObcError(f'{path} exists; give another name, so that no answers are lost') from None
    except OSError as error:
        raise ObcError(f'{path} cannot be written: {error.strerror}') from error


def format_sheet(name: str) -> str:
    """Return the text of the sheet; `name` is that of its file."""
    parts = [f'# {line}' for line in HEAD.format(name=name).splitlines()]
    for question in QUESTIONS:
        parts += ['', _comment(question.text), _comment(f'Answer: {question.form}.'),
                  f'{question.name}:']
    return '\n'.join(parts) + '\n'


def check_sheet(path: Path) -> list[CheckedAnswer]:
    """Check the answers of a sheet; StatementError if it cannot be read, or has another key."""
    answers = read_yaml(path)
    if not isinstance(answers, dict):
        raise StatementError(f'{path}: wanted the names of questions with answers, found '
                             f'{describe_type(answers)}; obc gallery --sheet FILE writes a sheet')
    known = [question.name for question in QUESTIONS]
    # For one version, the names of sheets that were written before `exercise-` was part of them.
    former = {name.removeprefix('exercise-'): name for name in known}
    for name in list(answers):
        full = former.get(name, name)
        if full not in known:
            raise StatementError(f"{path}: there is no question '{quote(str(name))}'"
                                 f'{suggest_name(str(name), known)}')
        if full != name and full in answers:
            raise StatementError(f"{path}: '{quote(str(name))}' and '{full}' are one question")
        answers[full] = answers.pop(name)
    return [check_answer(question, answers.get(question.name)) for question in QUESTIONS]


def check_answer(question: SheetQuestion, answer: Any) -> CheckedAnswer:
    """Check one answer; None is an open question."""
    if answer is None:
        return CheckedAnswer(question.name, 'open')
    try:
        why = question.check(answer)
    except ObcError as error:
        return CheckedAnswer(question.name, 'unreadable', str(error))
    return CheckedAnswer(question.name, 'wrong' if why else 'right', why)


def print_sheet(found: Sequence[CheckedAnswer]) -> None:
    """Print the verdict of each answer that is given, and why it is not right."""
    given = [each for each in found if each.verdict != 'open']
    print_table(('question', 'verdict'), [(each.name, each.verdict) for each in given], COLOURS)
    for each in given:
        if each.why:
            print(quote(f'{each.name}: {each.why.removeprefix(f"{each.name}: ")}', None))
    count = count_verdicts(found)
    print(f'{count["right"]} of {len(given)} answers are right; {count["open"]} of '
          f'{len(found)} questions are open')


def count_verdicts(found: Sequence[CheckedAnswer]) -> dict[str, int]:
    """Return how many answers have each verdict."""
    return {verdict: sum(each.verdict == verdict for each in found) for verdict in VERDICTS}


def _comment(text: str) -> str:
    return textwrap.fill(text, COMMENT_WIDTH, initial_indent='# ', subsequent_indent='# ')
