# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Weights by hand: sliders, the candidate beside the design in use, apply, undo, copy."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
import math
import re
from typing import Any

from nicegui import background_tasks, ui
import numpy as np
from obc_ros.api.figures.style import LINE_COLOURS
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import LqrDesign, LqrWeights
from obc_ros.srv import TryDesign
from obc_ros.view.charts import compute_steps, frame_chart, list_figures
from obc_ros.view.loop_client import LoopClient
from obc_ros.view.telemetry import keep_finite, Named

LOWEST, HIGHEST = -4.0, 5.0  # powers of 10 of a slider
HALF_STEP = 0.01             # of a slider
REST = 0.03                  # [s] between two previews
MOST_CHANGES = 100          # that can be undone
READ = ('weights', 'Qx', 'Qu', 'x_max', 'u_max')
MODES = {'matrices': ('Qx', 'Qu', 'weight'), 'bryson': ('x_max', 'u_max', 'largest deviation')}
TITLES = {'matrices': 'weights Qx and Qu', 'bryson': 'largest deviations, in units'}
IN_USE, CANDIDATE = '#7a828c', LINE_COLOURS[1]


@dataclass
class WeightRow:
    """One weight: its parameter, its place there, and the elements that show it."""

    parameter: str
    index: int
    slider: ui.slider
    number: ui.number
    reason: ui.label
    last: float   # number that the field has held

    @property
    def value(self) -> float:
        """Return the number of the field; the last one while the field holds none."""
        value = self.number.value
        if isinstance(value, int | float):
            self.last = float(value)
        return self.last


class WeightsPanel:
    """The weights of the controller, and what a change of them would do."""

    def __init__(self, client: LoopClient, may_control: Any) -> None:
        self._client, self._may_control = client, may_control
        self._rows: list[WeightRow] = []
        self._mode, self._dirty, self._busy = '', False, False
        self._undo: list[tuple[str, dict[str, list[float]]]] = []
        self._used = ''   # how the weights in use are given
        self._applied: dict[str, list[float]] = {}
        self._shown: LqrDesign | None = None
        self._candidate: LqrDesign | None = None
        self._choice = ui.select(TITLES, label='given as', on_change=self._switch)
        self._choice.classes('w-full').set_enabled(False)
        self._sliders = ui.column().classes('w-full gap-1')
        with ui.row().classes('items-center'):
            self._apply = ui.button('Apply', on_click=self._apply_weights)
            self._back = ui.button('Undo', on_click=self._undo_weights).props('outline')
            for button in (self._apply, self._back):
                button.disable()   # until the page controls the loop
            ui.button('Copy as YAML', on_click=lambda: ui.clipboard.write(self._as_yaml())).props(
                'flat dense')
            ui.button('Copy as command', on_click=lambda: ui.clipboard.write(self._as_command())
                      ).props('flat dense')
        self._message = ui.label().classes('obc-message').props('role=status aria-live=polite')
        with ui.row().classes('w-full no-wrap gap-2 obc-charts'):
            self._poles = ui.echart(frame_chart('poles [1/s]', 'real', 'imaginary')).classes(
                'obc-chart')
            self._steps = ui.echart(frame_chart('unit step', 'time [s]', '')).classes('obc-chart')
        self._figures = ui.table(columns=[
            {'name': 'what', 'label': '', 'field': 'what', 'align': 'left'},
            {'name': 'use', 'label': 'in use', 'field': 'use', 'align': 'right'},
            {'name': 'new', 'label': 'candidate', 'field': 'new', 'align': 'right'}],
            rows=[], row_key='what').props('dense flat').classes('w-full')

    async def load(self) -> None:
        """Read the weights of the node, and show them."""
        try:
            values = await self._client.get_parameters(self._client.controller, READ)
        except ObcError as error:
            self._message.text = str(error)
            return
        plant = self._client.plant
        mode = str(values.get('weights', 'matrices'))
        if plant is None or mode not in MODES:
            self._message.text = (f'weights = {mode}: no sliders for these; '
                                  'set them with ros2 param')
            return
        first, second, _ = MODES[mode]
        design = self._client.design
        default = {'Qx': design.qx, 'Qu': design.qu} if design else {}   # an empty one: identity
        groups = ((first, plant.states, values.get(first) or default.get(first, [])),
                  (second, plant.inputs, values.get(second) or default.get(second, [])))
        self._applied = {name: _spread(list(given), len(signals))
                         for name, signals, given in groups}
        if not all(self._applied.values()):
            self._message.text = f'{first} and {second} are not diagonal: set them with ros2 param'
            return
        self._used = mode
        self._build(mode, self._applied)

    def _build(self, mode: str, values: dict[str, list[float]]) -> None:
        """Show the sliders of one way to give the weights, with values."""
        plant = self._client.plant
        if plant is None:
            return
        self._mode = self._choice.value = mode
        self._choice.set_enabled(True)
        first, second, what = MODES[mode]
        self._sliders.clear()
        self._rows = []
        with self._sliders:
            for parameter, signals in ((first, plant.states), (second, plant.inputs)):
                for index, (signal, value) in enumerate(
                        zip(signals, values[parameter], strict=True)):
                    self._rows.append(self._add_row(what, parameter, index, signal, value))
        self._dirty = True

    def _switch(self) -> None:
        """Give the candidate in the other way; it stays what it is."""
        mode = str(self._choice.value)
        if self._rows and mode != self._mode:
            values = self._read()
            try:
                self._build(mode, convert_weights(mode, *values.values()))
            except ObcError as error:
                self._choice.value = self._mode
                self._message.text = str(error)

    def _add_row(self, what: str, parameter: str, index: int, signal: Named, value: float
                 ) -> WeightRow:
        unit = f' [{signal.unit}]' if self._mode == 'bryson' and signal.unit else ''
        title = f'{what} of {signal.name}{unit}'
        with ui.row().classes('w-full items-center no-wrap gap-2'):
            ui.label(signal.name + unit).classes('obc-name')
            slider = ui.slider(min=LOWEST, max=HIGHEST, step=2.0 * HALF_STEP,
                               value=_position(value)).props(
                f'aria-label="{_plain(title)}"').classes('grow')
            number = ui.number(value=value, format='%.6g').props(
                'dense outlined placeholder=any '
                f'aria-label="{_plain(title)}, as a number"').classes('obc-number')
        reason = ui.label().classes('obc-reason').props('role=alert')
        reason.visible = False
        row = WeightRow(parameter, index, slider, number, reason, value)
        slider.on('update:model-value', lambda event: self._slide(row, event.args), throttle=0.05)
        number.on_value_change(lambda event: self._type(row, event.value))
        return row

    def _slide(self, row: WeightRow, position: Any) -> None:
        if isinstance(position, int | float):
            value = float(f'{10.0 ** position:.3g}')
            if self._mode == 'matrices' and position <= LOWEST and row.parameter == 'Qx':
                value = 0.0
            if position >= HIGHEST and row.parameter == 'x_max':
                value = math.inf
            row.number.value = value

    def _type(self, row: WeightRow, value: Any) -> None:
        """Take a number; the slider moves, unless it is what has given the number."""
        if not isinstance(value, int | float) or math.isnan(value):
            return
        position = _position(float(value))
        if abs(position - float(row.slider.value or 0.0)) > HALF_STEP:
            row.slider.value = position
        self._dirty = True
        self._begin_preview()

    def _read(self) -> dict[str, list[float]]:
        first, second, _ = MODES[self._mode]
        values: dict[str, list[float]] = {first: [], second: []}
        for row in self._rows:
            values[row.parameter].append(row.value)
        return values

    def refresh(self) -> None:
        """Preview the candidate if a weight has changed, and show a new design in use."""
        if not self._rows:
            return
        design = self._client.design
        if design is not None and design is not self._shown:
            self._shown, self._dirty = design, True
        self._begin_preview()
        controls = bool(self._may_control())
        self._apply.set_enabled(controls)
        self._back.set_enabled(controls and bool(self._undo))

    def _begin_preview(self) -> None:
        """Preview the candidate at once; one that is under way goes on with it."""
        if self._dirty and not self._busy:
            self._busy = True
            background_tasks.create(self._preview(), context=self._sliders)

    async def _preview(self) -> None:
        try:
            while self._dirty:
                self._dirty = False
                await self._try_candidate()
                await asyncio.sleep(REST)
        finally:
            self._busy = False

    async def _try_candidate(self) -> None:
        if not self._client.is_lqr:
            self._candidate = None
            self._say(True, f'{self._client.controller} tries weights when they are applied', '')
            self._draw()
            return
        try:
            values = self._read()
            names = ('qx', 'qu') if self._mode == 'matrices' else ('x_max', 'u_max')
            weights = LqrWeights(weights=self._mode, **dict(zip(
                names, values.values(), strict=True)))
            response = await self._client.call(
                TryDesign, f'{self._client.controller}/try_design',
                TryDesign.Request(weights=weights))
            self._say(response.success, response.message, '')
            self._candidate = response.design if response.success else None
            self._draw()
        except ObcError as error:
            self._message.text = str(error)

    def _say(self, success: bool, message: str, done: str) -> None:
        """Show a message; a rejection stands beside the weight that it names."""
        blamed = None if success else _find_blamed(self._rows, message)
        for row in self._rows:
            row.reason.visible = row is blamed
            row.reason.text = message if row is blamed else ''
        self._message.text = '' if blamed else (done or message)

    async def _apply_weights(self) -> None:
        if self._may_control():
            before = self._used, self._applied
            if await self._set(self._mode, self._read()):
                self._undo = [*self._undo, before][-MOST_CHANGES:]

    async def _undo_weights(self) -> None:
        if self._may_control() and self._undo:
            mode, values = self._undo[-1]
            if await self._set(mode, values):
                self._undo.pop()
                self._build(mode, values)

    async def _set(self, mode: str, values: dict[str, list[float]]) -> bool:
        try:
            done, reason = await self._client.set_parameters(
                self._client.controller, {'weights': mode, **values})
        except ObcError as error:
            done, reason = False, str(error)
        if done:
            self._used, self._applied = mode, values
        self._say(done, reason, 'applied' if done else '')
        return done

    def _draw(self) -> None:
        designs = [(name, design, colour) for name, design, colour in (
            ('in use', self._client.design, IN_USE), ('candidate', self._candidate, CANDIDATE))
            if design is not None and len(design.k)]
        self._poles.options['series'] = [
            {'name': name, 'type': 'scatter', 'symbolSize': 10 if name == 'in use' else 8,
             'symbol': 'emptyCircle' if name == 'in use' else 'diamond',
             'itemStyle': {'color': colour},
             'data': list(zip(keep_finite(design.poles_real), keep_finite(design.poles_imag),
                              strict=True))}
            for name, design, colour in designs]
        self._steps.options['series'] = [
            {'name': f'{signal}, {name}', 'type': 'line', 'showSymbol': False,
             'lineStyle': {'color': colour, 'width': 2,
                           'type': 'dashed' if place else 'solid'},
             'itemStyle': {'color': colour}, 'data': data}
            for name, design, colour in designs
            for place, (signal, data) in enumerate(compute_steps(design))]
        self._poles.update()
        self._steps.update()
        self._figures.rows = list_figures(self._client.design, self._candidate)

    def _as_yaml(self) -> str:
        rows = ''.join(f'    {name}: {_list(values)}\n' for name, values in self._read().items())
        return (f'/**/{self._client.controller}:\n  ros__parameters:\n'
                f'    weights: {self._mode}\n{rows}')

    def _as_command(self) -> str:
        node = self._client.controller
        return '\n'.join([*(f'ros2 param set /{node} {name} "{_list(values)}"'
                            for name, values in self._read().items()),
                          f'ros2 param set /{node} weights {self._mode}'])


def convert_weights(mode: str, x: Sequence[float], u: Sequence[float]) -> dict[str, list[float]]:
    """
    Return diagonal weights as largest deviations (mode 'bryson'), or the other way round.

    A weight is the inverse square of a deviation; ObcError if a number has none.
    """
    first, second, _ = MODES[mode]
    of_x, of_u = (('Qx', 'Qu') if mode == 'bryson' else ('x_max', 'u_max'))
    for name, values, zero in ((of_x, x, mode == 'bryson'), (of_u, u, False)):
        for index, value in enumerate(values):
            if not (value > 0.0 or zero and value == 0.0):
                raise ObcError(f'{name}[{index}] = {value:g}: give a positive number first')
    power = -0.5 if mode == 'bryson' else -2.0
    # Twelve digits are without the rounding error of a power.
    return {name: [float(f'{value ** power:.12g}') if value else math.inf for value in values]
            for name, values in ((first, x), (second, u))}


def _find_blamed(rows: Sequence[WeightRow], message: str) -> WeightRow | None:
    """Return the row of the weight that a reason begins with, such as `Qu[0] = -1`."""
    found = re.match(r'(\w+)(?:\[(\d+)\])?', message)
    named = [row for row in rows if found and row.parameter == found[1]]
    return next((row for row in named if found and str(row.index) == (found[2] or '0')), None)


def _spread(values: list[float], size: int) -> list[float]:
    """Return a list of one number for each signal; empty for a full matrix."""
    if len(values) == size * size and size > 1:
        square = np.reshape(values, (size, size))
        values = list(np.diag(square)) if np.array_equal(square, np.diag(np.diag(square))) else []
    if len(values) == 1:
        values = values * size
    return [float(each) for each in values] if len(values) == size else []


def _position(value: float) -> float:
    return min(max(math.log10(value), LOWEST), HIGHEST) if value > 0 else LOWEST


def _list(values: Sequence[float]) -> str:
    texts = ('.inf' if math.isinf(each) else repr(float(each)) for each in values)
    return f'[{", ".join(texts)}]'


def _plain(text: str) -> str:
    """Return a text without characters that end an attribute."""
    return re.sub(r'[^\w \[\]/.,^-]', '', text)
