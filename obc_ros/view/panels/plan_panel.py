# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Plan by click: a goal, the solution with its certificate, then the flight."""

from collections.abc import Callable
import math
from typing import Any

from nicegui import run, ui
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.systems.registry import list_systems
from obc_ros.core.tasks.motion_planning import Motion, state_motion
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import Trajectory
from obc_ros.ros.messages import read_message_bounds
from obc_ros.srv import PlanMotion
from obc_ros.view.canvas import LoopCanvas
from obc_ros.view.charts import (
    choose_points,
    draw_path_lines,
    find_switching_functions,
    show_attempts,
    show_certificate,
)
from obc_ros.view.loop_client import LoopClient
from obc_ros.view.telemetry import Plant

LIMIT = 30.0     # [s] for a plan
GOALS = {'quadratic': 'quadratic cost', 'effort': 'minimum effort', 'time': 'minimum time'}


class PlanPanel:
    """A goal, a plan to it, its figures, and the command to fly it."""

    def __init__(self, client: LoopClient, canvas: LoopCanvas,
                 may_control: Callable[[], bool]) -> None:
        self._client, self._canvas, self._may_control = client, canvas, may_control
        self._plant: Plant | None = None
        self._goal: list[ui.number] = []
        self._busy = False
        ui.label('Click a point of the picture, or type a goal.').classes('obc-hint')
        self._fields = ui.row().classes('w-full gap-2')
        with ui.row().classes('items-center w-full'):
            self._objective = ui.select(GOALS, value='quadratic', label='objective').classes(
                'w-40')
            self._time = ui.number('duration [s], 0: chosen', value=0, min=0).classes('w-44')
        with ui.row().classes('items-center'):
            self._plan = ui.button('Plan', on_click=lambda: self.plan(False))
            self._fly = ui.button('Fly it', on_click=lambda: self.plan(True))
            self._fly.disable()   # until the page controls a loop
            ui.button('Clear', on_click=self._clear).props('flat')
            self._spinner = ui.spinner(size='sm')
        self._spinner.visible = False
        self._message = ui.label().classes('obc-message').props('role=status aria-live=polite')
        self._charts = ui.column().classes('w-full gap-1')
        self._table = ui.column().classes('w-full')

    def refresh(self) -> None:
        """Show the fields of a new plant."""
        plant = self._client.plant
        if plant is not None and plant != self._plant:
            self._plant = plant
            self._fields.clear()
            with self._fields:
                self._goal = [ui.number(
                    f'{each.name} [{each.unit}]' if each.unit else each.name, value=0.0,
                    format='%.4g').classes('w-24') for each in plant.states]
        controls = self._may_control()
        self._plan.set_enabled(plant is not None and not self._busy)
        self._fly.set_enabled(
            plant is not None and controls and self._client.is_lqr and not self._busy)

    async def click(self, x: float, y: float) -> None:
        """Take a point of the plane as the goal, at rest, and plan a way to it."""
        if self._plant is None or self._busy:
            return
        names = self._plant.state_names
        for name, field in zip(names, self._goal, strict=True):
            field.value = {'px': round(x, 2), 'py': round(y, 2)}.get(name, 0.0)
        await self.plan(False)

    async def plan(self, execute: bool) -> None:
        """Ask for a plan from the present state; with `execute`, lqr_node then follows it."""
        if self._plant is None or self._busy or (execute and not self._may_control()):
            return
        goal = [field.value for field in self._goal]
        if not all(isinstance(each, int | float) and math.isfinite(each) for each in goal):
            self._message.text = 'every state of the goal needs a number'
            return
        self._busy = self._spinner.visible = True
        self._message.text = ''
        request = PlanMotion.Request(
            system=self._plant.system, goal=list(map(float, goal)), execute=execute,
            objective=str(self._objective.value), final_time=float(self._time.value or 0.0)
            if self._objective.value != 'time' else 0.0, time_limit=LIMIT)
        try:
            answer = await self._client.call(
                PlanMotion, 'trajectory_server/plan', request, LIMIT + 10.0)
            await self._show(answer, request)
        except ObcError as error:
            self._message.text = str(error)
        finally:
            self._busy = self._spinner.visible = False

    async def _show(self, answer: Any, request: Any) -> None:
        self._clear()
        self._message.text = f'{answer.status}: {answer.message}'
        path = answer.trajectory
        if len(path.t):
            self._draw_way(path)
        if answer.certificate.conditions:
            with self._table:
                show_certificate(answer.certificate)
                show_attempts(answer.attempts)
        if self._plant and len(path.t):   # the curves take longest
            switching = await run.io_bound(compute_switching, request, path)
            with self._charts:
                draw_path_lines(path, self._plant.units, switching, [
                    each.name for each in self._plant.states if each.moves])

    def _draw_way(self, plan: Trajectory) -> None:
        names = list(plan.state_names)
        if self._plant and self._plant.plane and {'px', 'py'} <= set(names):
            x = np.reshape(plan.x, (len(plan.t), -1))[:, [names.index('px'), names.index('py')]]
            self._canvas.show_plan(x[choose_points(len(x))].tolist())

    def _clear(self) -> None:
        self._canvas.show_plan([])
        self._charts.clear()
        self._table.clear()
        self._message.text = ''


def compute_switching(request: PlanMotion.Request, path: Trajectory) -> dict[str, Array]:
    """
    Return the switching functions of a plan, by input; none where the request does not tell them.

    They take the dynamics of the registered system and no multipliers of constraints.
    """
    if request.system not in list_systems() or request.system_parameters or (
            request.state_bounds or request.path_constraints):
        return {}
    x, u, lam = (np.reshape(each, (len(path.t), -1)) for each in (path.x, path.u, path.lam))
    problem = build_problem(state_motion(Motion(
        request.system, x[0], request.goal, request.objective, Qx=request.qx, Qu=request.qu,
        final_time=float(path.t[-1]),
        input_bounds=read_message_bounds('input_bounds', request.input_bounds))))
    return find_switching_functions(problem, x, u, lam)
