# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The element that draws the body and the signals of a plant; the drawing is in canvas.js."""

from collections.abc import Callable, Sequence
import math
from typing import Any

from matplotlib.figure import Figure
from nicegui.element import Element
from obc_ros.api.figures.bodies import ARM, draw_aircraft, draw_two_wheeled, draw_vehicle, PLUME
from obc_ros.api.figures.style import LINE_COLOURS
from obc_ros.view.recorded_events import RecordedEvent
from obc_ros.view.telemetry import FollowedPath, Frame, Named, Plant

BODIES: dict[str, Callable[..., list[Any]]] = {
    'aircraft': draw_aircraft, 'vehicle': draw_vehicle, 'vehicle_lateral': draw_vehicle,
    'two_wheeled': draw_two_wheeled}
SIZES = {'aircraft': 1.6, 'vehicle': 12.0, 'vehicle_lateral': 12.0}  # [m] of the plane at least
DASHES: tuple[list[int], ...] = ([], [7, 4], [2, 3], [9, 3, 2, 3])
PER_PANEL = 4  # signals
FLOORS = {'m': 0.05, 'rad': 0.02, 'm/s': 0.05, 'rad/s': 0.05}  # half the smallest range
AHEAD = 400  # points of a reference
BEHIND = 30  # frames that a browser may not have acknowledged; more are left out


class LoopCanvas(Element, component='canvas.js'):
    """
    A body in its plane, and signals over time.

    A browser that falls behind is sent fewer frames: what it has not acknowledged is bounded.
    `live`: the picture says so when no state has come for more than a second.
    """

    def __init__(self, scene: dict[str, Any], on_goal: Callable[[float, float], Any], *,
                 live: bool) -> None:
        super().__init__()
        self._props['scene'], self._props['live'] = scene, live
        self._sent = self._seen = 0
        self._predicted: Sequence[Any] = ()   # the last prediction that was sent
        self.on('ack', self._acknowledge, throttle=0.0)
        self.on('goal', lambda event: on_goal(float(event.args['x']), float(event.args['y'])))

    def change_scene(self, scene: dict[str, Any]) -> None:
        """Show another plant."""
        self._props['scene'] = scene
        self.update()

    def push(self, frame: Frame, age: float = 0.0) -> None:
        """Send a frame that came `age` [s] ago, unless too many are under way."""
        if self._sent - self._seen < BEHIND:
            self._sent += 1
            packed = frame.pack(self._sent)
            if frame.prediction is not self._predicted:
                self._predicted = packed['prediction'] = frame.prediction
            self.run_method('push', packed, age)

    def show_plan(self, points: Sequence[Sequence[float]]) -> None:
        """Draw a path ahead; empty: none."""
        self.run_method('plan', [list(map(float, each)) for each in points])

    def show_reference(self, reference: FollowedPath | None, plant: Plant) -> None:
        """Draw what lqr_node follows; None: nothing."""
        self.run_method('refer', reference.pack(plant, AHEAD) if reference else [])

    def _acknowledge(self, event: Any) -> None:
        number = event.args
        if isinstance(number, int) and self._seen < number <= self._sent:
            self._seen = number


def describe_scene(plant: Plant, events: Sequence[RecordedEvent] = ()) -> dict[str, Any]:
    """Return body, plane and panels of a plant, and events to mark, as JSON values."""
    names = plant.state_names
    plane = None
    if plant.plane and {'px', 'py'} <= set(names):
        plane = {'x': names.index('px'), 'y': names.index('py'),
                 'theta': names.index('theta') if 'theta' in names else None}
    return {
        'marks': [list(each) for each in events],
        'plane': plane, 'size': SIZES.get(plant.system, 2.0),
        'body': _outline(plant.system), 'plume': PLUME if plant.system == 'aircraft' else 0.0,
        'arm': ARM, 'states': [{'name': each.name, 'unit': each.unit} for each in plant.states],
        'panels': [*_group(plant.states, 'x'), *_group(plant.inputs, 'u'),
                   _panel('', [('cost-to-go', 'cost', 0)], [], 1e-3),
                   _panel('ms', [('latency', 'latency', 0)], [], 0.1)]}


def _outline(system: str) -> list[dict[str, Any]]:
    """Return the polygons of a body at the origin, each with its colour."""
    draw = BODIES.get(system)
    if draw is None:
        return []
    patches = draw(Figure().subplots(), 0.0, 0.0, 0.0)
    return [{'points': each.get_xy().round(4).tolist(), 'colour': _colour(each.get_facecolor())}
            for each in patches]


def _colour(rgba: Sequence[float]) -> str:
    return '#' + ''.join(f'{round(255 * each):02x}' for each in rgba[:3])


def _group(signals: Sequence[Named], of: str) -> list[dict[str, Any]]:
    """
    Return the panels of signals: those with one unit share a panel.

    One that moves at the set point, such as px of the vehicle, would flatten those that rest.
    """
    panels = []
    for unit, moves in dict.fromkeys((each.unit, each.moves) for each in signals):
        chosen = [(index, each) for index, each in enumerate(signals)
                  if (each.unit, each.moves) == (unit, moves)]
        rows = [(each.name, of, index) for index, each in chosen]
        limits = [bound for _, each in chosen
                  for bound in (each.lower, each.upper) if math.isfinite(bound)]
        for first in range(0, len(rows), PER_PANEL):
            panels.append(_panel(unit, rows[first:first + PER_PANEL], limits,
                                 FLOORS.get(unit, 0.05)))
    return panels


def _panel(unit: str, rows: Sequence[tuple[str, str, int]], limits: Sequence[float],
           floor: float) -> dict[str, Any]:
    return {'unit': f'[{unit}]' if unit else '', 'limits': sorted(set(limits)), 'floor': floor,
            'signals': [
                {'name': name, 'of': of, 'index': index, 'colour': LINE_COLOURS[place],
                 'dash': DASHES[place % len(DASHES)]}
                for place, (name, of, index) in enumerate(rows)]}
