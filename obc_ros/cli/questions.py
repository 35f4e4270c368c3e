# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The problems of files: each a question with a name, and what came of it."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
import math
from pathlib import Path
from typing import Any

from obc_ros.cli.results import file_name
from obc_ros.core.errors import StatementError
from obc_ros.core.files import entries
from obc_ros.core.problem import Problem
from obc_ros.core.statement import problem_from_mapping


@dataclass(eq=False)
class Question:
    """
    A problem, what came of it, and the name of its files.

    `problem` is None when the question is malformed; `result` is what the server said, None when
    it was not asked or said nothing; `took` is the time [s] from sending to the answer. `where` is
    the file it was read from, and which of its problems it is; `label` is the name, and where it
    was read from if others have that name; `renamed` tells that another has its file's name.
    """

    name: str
    where: str
    file_name: str
    label: str = ''
    renamed: bool = False
    mapping: dict[str, Any] = field(default_factory=dict)
    problem: Problem | None = None
    status: str = ''
    message: str = ''
    result: Any = None
    took: float = math.nan

    def end(self, status: str, message: str) -> None:
        """Note what came of it."""
        self.status, self.message = status, message

    def as_json(self) -> dict[str, Any]:
        """Return what ``NAME.json`` holds; without an answer all numbers are null or empty."""
        found: dict[str, Any] = {
            'name': self.name, 'status': self.status, 'message': self.message, 'objective': None,
            't': [], 'x': {}, 'u': {}, 'lam': {}, 'interpolation': 'linear', 'switching_times': [],
            'certificate': {'holds': False, 'residuals': {}, 'tolerances': {}},
            'solve_time': None, 'build_time': None, 'iterations': 0}
        return found | (_answer(self.result) if self.result else {})


def read(files: Iterable[Path]) -> list[Question]:
    """Return the questions of all files, in order; those that are malformed have ended."""
    questions: list[Question] = []
    for file in files:
        for where, entry in _entries(file):
            alone = where == str(file)
            name = file.stem
            if not isinstance(entry, StatementError):
                name = str(entry['name'])
            elif not alone:
                name = f"{file.stem}_{where.rpartition(' ')[2]}"
            wanted = file.stem if alone else name
            unique = file_name(wanted, (question.file_name for question in questions))
            questions.append(_checked(Question(
                name, where, unique, renamed=unique != file_name(wanted, ())), entry))
    count = Counter(question.name for question in questions)
    for question in questions:
        several = count[question.name] > 1
        question.label = f'{question.name} ({question.where})' if several else question.name
    return questions


def _entries(file: Path) -> list[tuple[str, dict[str, Any] | StatementError]]:
    """Return the problems of a file and where they stand in it, or what is wrong instead."""
    try:
        return entries(file)
    except StatementError as error:
        return [(str(file), error)]


def _checked(question: Question, entry: dict[str, Any] | StatementError) -> Question:
    try:
        if isinstance(entry, StatementError):
            raise entry
        question.mapping = entry
        question.problem = problem_from_mapping(entry)
    except StatementError as error:
        question.end('malformed', str(error))
    return question


def _answer(result: Any) -> dict[str, Any]:
    """Return what the server's answer says."""
    path, certificate = result.trajectory, result.certificate
    answer = {
        'certificate': {
            'holds': certificate.holds,
            'residuals': dict(zip(certificate.conditions, certificate.residuals, strict=True)),
            'tolerances': dict(zip(certificate.conditions, certificate.tolerances, strict=True))},
        'solve_time': result.solve_time, 'build_time': result.build_time,
        'iterations': result.iterations}
    if path.t:
        n, m = len(path.state_names), len(path.input_names)
        answer |= {
            'objective': result.objective, 't': path.t.tolist(),
            'x': _columns(path.state_names, path.x, n), 'u': _columns(path.input_names, path.u, m),
            'lam': _columns(path.state_names, path.lam, n) if path.lam else {},
            'interpolation': path.interpolation,
            'switching_times': path.switching_times.tolist()}
    return answer


def _columns(names: list[str], values: Any, width: int) -> dict[str, list[float]]:
    """Return the columns of row-major values by name."""
    return {name: values[index::width].tolist() for index, name in enumerate(names)}
