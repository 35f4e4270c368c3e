# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Solve a problem file: paste or choose it, watch the progress, see the solution."""

from collections.abc import Callable
from functools import partial
from typing import Any

from nicegui import run, ui
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.augmentation import restore_added_states
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.text.errors import ObcError
from obc_ros.core.text.example_files import find_example, list_titles
from obc_ros.core.text.yaml_files import MAX_BYTES, read_text_entries
from obc_ros.ros.messages import build_problem_message, read_solution
from obc_ros.view.charts import (
    draw_path_lines,
    find_switching_functions,
    show_attempts,
    show_certificate,
)
from obc_ros.view.loop_client import LoopClient, Request

LIMIT = 60.0  # [s] for a problem
SHOWN = {   # examples at hand, in words; the panel begins with the first one
    'di_mintime_rest': 'minimum time', 'di_energy': 'minimum energy',
    'brachistochrone': 'brachistochrone', 'moon_lander': 'moon landing', 'dido': 'Queen Dido'}


class ProblemPanel:
    """A problem as YAML, and its solution by trajectory_server."""

    def __init__(self, client: LoopClient, may_control: Callable[[], bool]) -> None:
        self._client, self._may_control = client, may_control
        self._request: Request | None = None
        titles = {name: f'{name}: {title}' for name, title in list_titles().items()}
        first = next(iter(SHOWN))
        self._choice = ui.select(titles, label='example', with_input=True, value=first,
                                 on_change=lambda event: self._load(event.value))
        self._choice.classes('w-full')
        with ui.row().classes('w-full gap-1'):
            for name, words in SHOWN.items():
                ui.chip(words, on_click=partial(self._pick, name)).props(
                    'dense outline').classes('obc-chip').tooltip(titles[name])
        self._text = ui.textarea('problem (YAML)', value=read_example_text(first)).props(
            f'outlined maxlength={MAX_BYTES} spellcheck=false').classes('w-full obc-yaml')
        with ui.row().classes('items-center'):
            self._solve = ui.button('Solve', on_click=self.solve)
            self._cancel = ui.button('Cancel', on_click=self._stop).props('outline')
            self._spinner = ui.spinner(size='sm')
        self._message = ui.label().classes('obc-message').props('role=status aria-live=polite')
        self._result = ui.column().classes('w-full gap-1')

    def refresh(self) -> None:
        """Show the progress."""
        request = self._request
        self._solve.set_enabled(self._may_control() and request is None)
        self._cancel.set_enabled(request is not None)
        self._spinner.visible = request is not None
        if request is not None and request.phase:
            self._message.text = request.phase

    def _pick(self, name: str) -> None:
        self._choice.value = name
        self._load(name)   # also if it was chosen before, and then edited

    def _load(self, name: Any) -> None:
        if isinstance(name, str) and name in list_titles():
            self._text.value = read_example_text(name)

    def _stop(self) -> None:
        if self._request is not None:
            self._request.cancel()

    async def solve(self) -> None:
        """Have the server solve the first problem of the text."""
        if self._request is not None or not self._may_control():
            return
        self._result.clear()
        try:
            built = await run.io_bound(build_message, str(self._text.value or ''))
            if built is None:   # the process ends
                return
            problem, message = built
            self._request = Request(message, LIMIT)
            answer = await self._client.solve(self._request)
            self._message.text = f'{answer.status}: {answer.message}'
            self._request.phase = ''   # of which none is shown any more
            await self._show(answer, problem)
        except ObcError as error:
            self._message.text = str(error)
        finally:
            self._request = None

    async def _show(self, answer: Any, problem: Problem) -> None:
        is_solved = bool(len(answer.trajectory.t))
        with self._result:
            if is_solved:
                optimum = f', {answer.optimality.kind}' if answer.optimality.kind else ''
                ui.label(f'cost {answer.objective:.10g}{optimum}, {answer.solve_time:.3g} s')
            curves = ui.column().classes('w-full gap-1')
            if answer.certificate.conditions:
                show_certificate(answer.certificate)
            show_attempts(answer.attempts)
        if is_solved:   # the curves take longest
            switching = await run.io_bound(compute_problem_switching, problem, answer)
            with curves:
                draw_path_lines(answer.trajectory, problem.units, switching)


def read_example_text(name: str) -> str:
    """Return the file of an example."""
    return find_example(name).read_text(encoding='utf-8')


def build_message(text: str) -> tuple[Problem, Any]:
    """Return the first problem of a YAML text and its message; ObcError names the key at fault."""
    (_, entry), *_ = read_text_entries(text)
    if isinstance(entry, ObcError):
        raise entry
    problem = build_problem(entry)
    return problem, build_problem_message(problem.statement, problem.guess)


def compute_problem_switching(problem: Problem, answer: Any) -> dict[str, Array]:
    """Return the switching functions of the answer to a problem, by input."""
    if not len(answer.trajectory.lam):
        return {}
    path = restore_added_states(problem, read_solution(answer))
    return find_switching_functions(problem, path.x, path.u, path.lam)
