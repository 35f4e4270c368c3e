# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The set point by click and by number, and steps of it."""

from collections.abc import Callable, Sequence
import math
from typing import Any

from nicegui import ui
import numpy as np
from obc_ros.core.text.errors import ObcError
from obc_ros.msg import LqrDesign
from obc_ros.view.loop_client import LoopClient
from obc_ros.view.telemetry import Frame, Plant, SetPoint


class SetPointPanel:
    """A set point that is typed, clicked or stepped; nothing is sent before a button."""

    def __init__(self, client: LoopClient, may_control: Callable[[], bool],
                 find_frame: Callable[[], Frame | None]) -> None:
        self._client, self._may_control, self._find_frame = client, may_control, find_frame
        self._of: tuple[str, Plant] | None = None   # controller and plant of the fields
        self._shown: list[float] = []    # the set point in use that the fields were filled with
        self._before: list[float] = []   # the one before the last change of this page
        self._sent: list[float] = []     # the last one that this page has set
        self._old: LqrDesign | None = None   # the design at the last change, until a newer one
        self._seen: Any = None   # what was done last, by anybody
        self._busy = False
        ui.label('Click a point of the picture, or type a set point.')
        self._row = ui.row().classes('w-full gap-2')
        self._fields: list[ui.number] = []
        with ui.row().classes('items-center'):
            self._hold = ui.button('Hold it', on_click=self.hold)
            self._back = ui.button('Back', on_click=self.go_back).props('outline')
            self._use = ui.button('As in use', on_click=self.drop).props('outline')
            self._changed = ui.label()
        with ui.row().classes('items-end'):
            self._state = ui.select([], label='state').classes('w-24')
            self._size = ui.number('size of the step', value=0.5, format='%.4g').classes('w-32')
            self._step = ui.button('Step', on_click=self.step)
        for button in (self._hold, self._back, self._step):
            button.disable()   # until the page controls a loop
        self._message = ui.label().classes('obc-message').props('role=status aria-live=polite')

    def refresh(self) -> None:
        """Show the fields of a new plant or controller, and a new set point in use."""
        plant, design = self._client.plant, self._client.design
        if plant is not None and (self._client.controller, plant) != self._of:
            self._of, self._shown, self._before = (self._client.controller, plant), [], []
            self._old = None
            self._row.clear()
            with self._row:   # every digit of a field is sent
                self._fields = [ui.number(
                    f'{each.name} [{each.unit}]' if each.unit else each.name, format='%.12g'
                ).classes('w-24') for each in plant.states]
            self._state.set_options(list(plant.state_names), value=plant.state_names[0])
        if design is not None and len(design.xe) == len(self._fields) and not np.array_equal(
                design.xe, self._shown, equal_nan=True):
            if self._shown and list(design.xe) != self._sent:
                self._before = []   # somebody else has set this one
            self._shown = list(map(float, design.xe))
        self._old = self._old if design is self._old else None
        ready = (self._may_control() and bool(self._shown) and not self._busy
                 and self._old is None)
        free = ready and self._client.reference is None
        self._hold.set_enabled(ready)
        self._step.set_enabled(free)   # from the end of a path it would not be one step
        self._back.set_enabled(free and bool(self._before))
        if (seen := (*self._find_asked(), self._client.reference)) != self._seen:
            self._seen = seen
            self.drop()   # what was clicked before this is not sent after it
        changed = [name for name, field, value in zip(
            self._names(), self._fields, self._shown, strict=False) if field.value != value]
        self._changed.text = f'not held yet: {", ".join(changed)}' if changed else ''
        self._use.set_enabled(bool(changed))

    def _names(self) -> tuple[str, ...]:
        return self._of[1].state_names if self._of else ()

    def drop(self) -> None:
        """Forget what was clicked or typed: fill the fields with the set point in use."""
        for field, value in zip(self._fields, self._shown, strict=False):
            field.value = value

    def click(self, x: float, y: float) -> None:
        """Fill in a point of the plane."""
        for name, field in zip(self._names(), self._fields, strict=True):
            if name in ('px', 'py'):
                field.value = round(x if name == 'px' else y, 2)

    async def hold(self) -> None:
        """Have the controller hold what the fields say."""
        await self._set([field.value for field in self._fields])

    async def step(self) -> None:
        """Add the step to the set point in use."""
        self.drop()
        size = self._size.value
        target: list[float | None] = list(self._shown)
        if target and self._client.reference is None:
            place = self._names().index(str(self._state.value))
            target[place] = None if size is None else self._shown[place] + size
            await self._set(target)

    async def go_back(self) -> None:
        """Return to the set point before the last change of this page."""
        self.drop()
        if self._before:
            await self._set(list(self._before))

    async def _set(self, given: Sequence[float | None]) -> None:
        if self._busy or not self._may_control():
            return
        target = [float(each) for each in given if isinstance(each, int | float)]
        if len(target) != len(given) or not np.isfinite(target).all():
            self._message.text = 'every state needs a number'
            return
        if self._client.reference is not None and target == self._shown:
            self._message.text = 'a path is followed from this set point: change a number'
            return
        self._busy, before, asked = True, list(self._shown), self._find_asked()
        try:
            refusal = await self._find_refusal(target)
            if not refusal and (self._find_asked() != asked or not self._may_control()):
                self._message.text = 'not sent: the loop or its control has changed meanwhile'
                return
            done, reason = (False, refusal) if refusal else await self._client.set_parameters(
                self._client.controller, {'setpoint': target})
        except ObcError as error:   # such as no answer in time
            self._message.text = f'not confirmed: {error}'
            return
        finally:
            self._busy = False
        self._message.text = (f'set point: {", ".join(f"{each:g}" for each in target)}' if done
                              else f'rejected: {reason}')
        if done:
            self._before, self._sent, self._old = before, target, asked[2]

    def _find_asked(self) -> tuple[tuple[str, Plant | None], str, LqrDesign | None]:
        """Return controller, plant, mode and design, which must not change before it is sent."""
        client = self._client
        return (client.controller, client.plant), client.mode.name, client.design

    async def _find_refusal(self, target: Sequence[float]) -> str:
        """Return why the loop would stop by itself at once; empty: it would not."""
        frame, design, plant = self._find_frame(), self._client.design, self._client.plant
        if frame is None or design is None or plant is None:
            return ''
        read = await self._client.get_parameters(self._client.controller, ['x_limits'])
        return find_excess(plant, design, frame.x, target, list(read.get('x_limits', ())))


def find_excess(plant: Plant, design: LqrDesign, x: Sequence[float], target: Sequence[float],
                limits: Sequence[float]) -> str:
    """
    Return in words which error of a new set point is outside of `x_limits`; empty: none is.

    :param x: present state (n,).
    :param limits: n largest errors, or lower and upper limit of each error; empty: none.
    """
    n = len(plant.states)
    if len(limits) not in (n, 2 * n) or len(x) != n:
        return ''
    point = SetPoint(design, target).locate(x)   # one that moves begins beside the plant
    bounds = (zip(limits[::2], limits[1::2], strict=True) if len(limits) == 2 * n
              else ((-size, size) for size in limits))
    for signal, here, there, (lower, upper) in zip(plant.states, x, point, bounds, strict=True):
        error = here - there
        turned = math.remainder(error, 2.0 * math.pi)
        if signal.angle:
            error = turned
        # A state that may be an angle, of a plant that is not registered, is left to the node.
        if not (lower <= error <= upper or signal.angle is None and lower <= turned <= upper):
            return (f'{signal.name} would be {error:.3g} {signal.unit} from it, outside of '
                    f'x_limits, {lower:g} to {upper:g}: the loop would not hold it')
    return ''
