# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Disturb the simulated plant: pause, step, reset, speed, gust, noise, delay, parameters."""

from collections.abc import Callable
import math
from typing import Any

from nicegui import ui
from obc_ros.core.text.errors import ObcError
from obc_ros.view.loop_client import LoopClient, PLANT_NODE
from std_srvs.srv import SetBool

SOON = 0.1  # [s] until a gust begins
TOP_SPEED = 5.0  # times real time, of a plant with a real-time priority: others need time, too
FIELDS = {'speed': 'speed [times real time]', 'input_delay': 'delay of the input [s]',
          'actuator_lag': 'lag of the actuators [s]'}


class PlantPanel:
    """The conditions of plant_simulator."""

    def __init__(self, client: LoopClient, may_control: Callable[[], bool]) -> None:
        self._client, self._may_control = client, may_control
        self._priority = 0
        with ui.row().classes('items-center'):
            ui.button('Pause', on_click=lambda: self._pause(True))
            ui.button('Continue', on_click=lambda: self._pause(False))
            ui.button('One step', on_click=lambda: self._trigger('step')).props('outline')
            ui.button('Reset', on_click=lambda: self._trigger('reset')).props('outline')
        self._message = ui.label().classes('obc-message').props('role=status aria-live=polite')
        self._gusts = ui.row().classes('items-end w-full')
        self._fields = ui.column().classes('w-full gap-1')

    async def load(self) -> None:
        """Read the parameters of the plant, and show them."""
        plant = self._client.plant
        try:
            names = [*FIELDS, 'priority',
                     *await self._client.list_parameters(PLANT_NODE, 'system_parameters'),
                     *await self._client.list_parameters(PLANT_NODE, 'noise')]
            values = await self._client.get_parameters(PLANT_NODE, names)
            await self._client.load_disturbances()
        except ObcError as error:
            self._message.text = f'no simulated plant: {error}'
            return
        if plant is None:
            return
        self._priority = int(values.pop('priority', 0))
        self._gusts.clear()
        with self._gusts:
            on = ui.select([each.name for each in plant.states], label='gust on',
                           value=next((each.name for each in plant.states if 'v' in each.name),
                                      plant.states[0].name)).classes('w-24')
            peak = ui.number('peak of its rate', value=1.0).classes('w-28')
            span = ui.number('duration [s]', value=1.0, min=1e-3).classes('w-28')
            ui.button('Gust', on_click=lambda: self._gust(on.value, peak.value, span.value))
        self._fields.clear()
        with self._fields:
            for name, value in values.items():
                self._add(name, value)

    def _add(self, name: str, value: Any) -> None:
        first = value[0] if isinstance(value, list | tuple) and value else value
        number = float(first) if isinstance(first, int | float) else 0.0
        title = FIELDS.get(name, name.replace('system_parameters.', '').replace('.', ' of '))
        field = ui.number(title, value=number, format='%.6g').classes('w-full').props('dense')
        listed = name == 'actuator_lag'
        field.on('change', lambda: self._set(name, field.value, listed))

    async def _set(self, name: str, value: Any, listed: bool) -> None:
        if not isinstance(value, int | float) or not math.isfinite(value):
            self._message.text = f'{name}: a number is wanted'
        elif name == 'speed' and self._priority and not 0.0 < value <= TOP_SPEED:
            self._message.text = (
                f'speed: give a number above 0, up to {TOP_SPEED:g}: with a real-time priority a '
                'faster plant leaves no time to other processes (obc view --priority 0 does)')
        elif self._may_control():
            await self._change({name: [float(value)] if listed else float(value)})

    async def _gust(self, state: str, peak: Any, span: Any) -> None:
        if not all(isinstance(each, int | float) and math.isfinite(each) for each in (peak, span)):
            self._message.text = 'a gust needs two numbers'
        elif self._may_control():
            try:
                now, rate = await self._client.find_plant_time()
            except ObcError as error:
                self._message.text = str(error)
                return
            others = {f'disturbance.gust.{each.name}': 0.0 for each in (
                self._client.plant.states if self._client.plant else ())}
            await self._change({f'disturbance.gust.{state}': float(peak),
                                'disturbance.gust_start': round(now + SOON * max(rate, 1.0), 3),
                                'disturbance.gust_duration': float(span)}, others)

    async def _change(self, values: dict[str, Any], beside: dict[str, Any] | None = None) -> None:
        """Set parameters; `beside`: those that are not shown, where `values` does not set them."""
        try:
            done, reason = await self._client.set_parameters(
                PLANT_NODE, {**(beside or {}), **values})
        except ObcError as error:
            done, reason = False, str(error)
        names = ', '.join(f'{name} = {value}' for name, value in values.items())
        self._message.text = f'set: {names}' if done else f'rejected: {reason}'

    async def _pause(self, wanted: bool) -> None:
        if self._may_control():
            try:
                response = await self._client.call(
                    SetBool, f'{PLANT_NODE}/pause', SetBool.Request(data=wanted))
                self._message.text = str(response.message)
            except ObcError as error:
                self._message.text = str(error)

    async def _trigger(self, name: str) -> None:
        if self._may_control():
            self._message.text = await self._client.trigger(f'{PLANT_NODE}/{name}')
