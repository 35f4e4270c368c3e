# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The page: picture and signals beside the panels; one page for each browser."""

from functools import partial
import time
from typing import Any

from nicegui import app, Client, ui
from obc_ros.core.closed_loop.modes import FOLLOWING, Mode
from obc_ros.msg import LqrDesign
from obc_ros.view.access import Helm
from obc_ros.view.canvas import describe_scene, LoopCanvas
from obc_ros.view.loop_client import LoopClient
from obc_ros.view.panels.plan_panel import PlanPanel
from obc_ros.view.panels.plant_panel import PlantPanel
from obc_ros.view.panels.problem_panel import ProblemPanel
from obc_ros.view.panels.set_point_panel import SetPointPanel
from obc_ros.view.panels.weights_panel import WeightsPanel
from obc_ros.view.playback import Playback
from obc_ros.view.telemetry import (
    describe_design,
    FollowedPath,
    Frame,
    Plant,
    ShownMode,
    STOPPED,
)

PERIOD = 1.0 / 31.0  # [s] between two frames: 30 a second with the delays of timers
STEPS = 500          # of the slider of a recording
SLOW = 0.1           # [s] between two looks at everything else
PAGE_STYLE = """
.obc-view { width: 100%; }
.obc-plane, .obc-plots { width: 100%; display: block; border-radius: 6px; margin-bottom: 6px; }
.obc-plane { cursor: crosshair; }
.obc-design .q-item { padding: 0; } .obc-design .q-item__label { font-weight: 600; }
.obc-left { flex: 3 1 420px; min-width: 0; }
.obc-right { flex: 2 1 340px; min-width: 0; }
.obc-name { width: 4.5rem; } .obc-number { width: 7rem; }
.obc-reason, .obc-bad { color: #b03a00; } .obc-good { color: #00684c; }
.body--dark .obc-reason, .body--dark .obc-bad { color: #ff9b66; }
.body--dark .obc-good { color: #5fd3ae; }
.obc-chart { height: 210px; flex: 1 1 0; min-width: 0; } .obc-lines { height: 170px; }
.obc-message { min-height: 1.4em; overflow-wrap: anywhere; }
.obc-yaml textarea { font-family: monospace; min-height: 260px; font-size: 12px; }
.obc-log { height: 320px; font-size: 12px; }
.body--dark .obc-chip { color: #8cc8f0 !important; }
.obc-events { max-height: 132px; overflow-y: auto; }
.nicegui-content { padding: 10px; }
.obc-mode { width: 100%; padding: 2px 10px; border-radius: 6px; overflow-wrap: anywhere; }
.obc-idle { background: #3d454d; } .obc-acts { background: #00573f; }
.obc-resting { background: #8a4b00; }
.obc-stopped { background: #8e0000; font-size: 1.35rem; font-weight: 700; padding: 8px 10px;
  outline: 2px solid #ffffff; }
@media (max-width: 480px) { .obc-charts { flex-wrap: wrap; } .obc-chart { flex-basis: 100%; } }
"""
# Space stops whatever has the focus: elements with the focus never see it. Excepted are fields
# that take a space; a number has none.
STOP_KEY = """<script>
{
  const takesSpace = (e) => e.isContentEditable || e.tagName === "TEXTAREA"
    || (e.tagName === "INPUT" && !e.readOnly
        && ["text", "search", "password", "email", "url", "tel"].includes(e.type));
  const stop = (event) => {
    if (event.key !== " " || event.ctrlKey || event.altKey || event.metaKey
        || takesSpace(event.target)) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (event.type === "keydown" && !event.repeat) emitEvent("obc-stop");
  };
  for (const type of ["keydown", "keypress", "keyup"]) window.addEventListener(type, stop, true);
}
</script>"""
STYLES = {STOPPED: 'obc-stopped', Mode.RESTING.name: 'obc-resting',
          **{each.name: 'obc-acts' for each in FOLLOWING}}   # of other modes: obc-idle


class Viewer:
    """All pages of one loop or recording."""

    def __init__(self, source: LoopClient | Playback, helm: Helm, title: str) -> None:
        self.source, self.helm, self.title = source, helm, title
        self.frame: Frame | None = None
        self._arrived = 0.0   # when it came [s], by a steady clock
        self._canvases: dict[str, LoopCanvas] = {}
        app.timer(PERIOD, self._broadcast)

    def _broadcast(self) -> None:
        frame = self.source.take_frame()
        if frame is not None:
            self.frame, self._arrived = frame, time.monotonic()
            for canvas in tuple(self._canvases.values()):
                canvas.push(frame)

    def build(self) -> None:
        """Build the page of one browser."""
        LoopPage(self)

    def add(self, page: str, canvas: LoopCanvas) -> None:
        """Send frames to a page that has connected; it watches, unless it had the control."""
        self._canvases[page] = canvas
        if self.frame is not None:   # a plant or a recording that is paused sends no other
            canvas.push(self.frame, time.monotonic() - self._arrived)
        self.helm.resume(page)

    def remove(self, page: str) -> None:
        """Forget a page that has closed or lost its connection; the loop goes on as it is."""
        self._canvases.pop(page, None)
        self.helm.leave(page)


class LoopPage:
    """The page of one browser; see `Viewer`."""

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer
        self._page = ui.context.client.id
        self._plant: tuple[str, Plant] | None = None   # with its controller
        self._reference: FollowedPath | None = None
        self._described: LqrDesign | None = None
        self._logged = 0
        ui.add_css(PAGE_STYLE)
        ui.colors(primary='#0072b2')
        self._dark = ui.dark_mode(None)
        self._build_header()
        with ui.row().classes('w-full items-start gap-4'):
            with ui.column().classes('obc-left gap-1'):
                self._plain = ui.expansion('waiting for a loop').props('dense role=status')
                with self._plain.classes('w-full obc-design'):
                    self._terms = ui.label()
                self._canvas = LoopCanvas(_empty_scene(), self._click,
                                          live=isinstance(viewer.source, LoopClient))
                self._canvas.classes('w-full')
                if isinstance(viewer.source, Playback):
                    self._build_player(viewer.source)
            with ui.column().classes('obc-right'):
                self._plan: PlanPanel | None = None
                if isinstance(viewer.source, LoopClient):
                    self._build_panels(viewer.source)
        # A request without a browser behind it gets no frames and no control.
        client = ui.context.client
        client.on_connect(lambda: viewer.add(self._page, self._canvas))
        client.on_disconnect(lambda: self._forget(client))
        ui.timer(SLOW, self._refresh)
        if isinstance(viewer.source, LoopClient):
            ui.add_body_html(STOP_KEY)
            ui.on('obc-stop', self._do_stop)
            ui.timer(SLOW, self._show_mode)   # apart: the other one may wait for a node

    def _forget(self, client: Client) -> None:
        """Forget the page, unless an old connection has ended after the page has a new one."""
        if not client.has_socket_connection:
            self._viewer.remove(self._page)

    def _controls(self) -> bool:
        return self._viewer.helm.has(self._page)

    def _build_header(self) -> None:
        live = isinstance(self._viewer.source, LoopClient)
        with ui.header().classes('items-center justify-between gap-2 q-py-xs'):
            ui.label(self._viewer.title).classes('text-lg')
            with ui.row().classes('items-center gap-2'):
                if live:
                    self._role = ui.button('', on_click=self._seize).props('flat color=white')
                    self._start = ui.button('Start', on_click=self._do_start).props(
                        'outline color=white')
                    self._start.disable()   # until this page controls
                    ui.button('Stop (space)', on_click=self._do_stop, color='red-9')
                ui.button(icon='contrast', on_click=self._dark.toggle).props(
                    'flat color=white aria-label="light or dark"')
            if live:
                self._mode = ui.label().props('role=status aria-live=polite')
                self._shown: ShownMode | None = None

    def _build_panels(self, client: LoopClient) -> None:
        with ui.tabs().props('dense align=left').classes('w-full') as tabs:
            names = [ui.tab(name) for name in (
                'Weights', 'Set point', 'Plan', 'Plant', 'Problem', 'Log')]
        with ui.tab_panels(tabs, value=names[0]).classes('w-full').props('keep-alive'):
            with ui.tab_panel(names[0]):
                self._weights = WeightsPanel(client, self._controls)
            with ui.tab_panel(names[1]):
                self._set_point = SetPointPanel(
                    client, self._controls, lambda: self._viewer.frame)
            with ui.tab_panel(names[2]):
                self._plan = PlanPanel(client, self._canvas, self._controls)
            with ui.tab_panel(names[3]):
                self._plant_panel = PlantPanel(client, self._controls)
            with ui.tab_panel(names[4]):
                self._problem = ProblemPanel(client, self._controls)
            with ui.tab_panel(names[5]):
                self._log = ui.log(max_lines=300).classes('obc-log w-full')
        self._tabs = tabs.on_value_change(self._set_point.drop)

    def _build_player(self, playback: Playback) -> None:
        def jump(event: Any) -> None:
            if isinstance(event.args, int | float):
                playback.seek(event.args)

        with ui.row().classes('w-full items-center no-wrap'):
            self._play = ui.button('Play', on_click=lambda: self._toggle(playback))
            self._slider = ui.slider(min=0.0, max=playback.duration,
                                     step=max(0.01, playback.duration / STEPS), value=0.0).props(
                'aria-label="time [s]"').classes('grow')
            self._slider.on('update:model-value', jump, throttle=0.05)
            ui.select({0.1: '0.1 x', 0.5: '0.5 x', 1.0: '1 x', 2.0: '2 x', 5.0: '5 x'}, value=1.0,
                      on_change=lambda event: setattr(playback, 'speed', float(event.value))
                      ).props('dense aria-label=speed')
        with ui.row().classes('obc-events w-full gap-1'):
            for moment, words in playback.events:
                ui.button(f'{moment:.1f} s {words}', on_click=partial(playback.seek, moment)
                          ).props('outline dense no-caps size=sm')

    def _toggle(self, playback: Playback) -> None:
        if not playback.playing and playback.position >= playback.duration:
            playback.seek(0.0)
        playback.playing = not playback.playing

    async def _refresh(self) -> None:
        source = self._viewer.source
        controller = source.controller if isinstance(source, LoopClient) else ''
        if source.plant is not None and (controller, source.plant) != self._plant:
            self._plant = controller, source.plant
            events = source.events if isinstance(source, Playback) else ()
            self._canvas.change_scene(describe_scene(source.plant, events))
            if isinstance(source, LoopClient):
                self._set_point.refresh()   # before what waits for nodes
                await self._weights.load()
                await self._plant_panel.load()
        if self._plant is not None and source.reference is not self._reference:
            self._reference = source.reference
            self._canvas.show_reference(self._reference, self._plant[1])
        if isinstance(source, Playback):
            self._play.text = 'Pause' if source.playing else 'Play'
            self._slider.value = round(source.position, 2)
            self._show_design(source.design, 'no design recorded')
            return
        controls = self._controls()
        self._role.text = 'this page controls' if controls else (
            'watching: take control' if self._viewer.helm.allowed else 'read only')
        self._role.set_enabled(self._viewer.helm.allowed and not controls)
        self._start.set_enabled(controls)
        self._show_design(source.design, 'waiting for a controller')
        self._weights.refresh()
        if self._plan is not None:
            self._plan.refresh()
            self._set_point.refresh()
            self._problem.refresh()
        for number, line in source.list_lines(self._logged):
            self._logged = number
            self._log.push(line)

    def _show_design(self, design: LqrDesign | None, none: str) -> None:
        """Show the design in plain words, and in terms once these are opened."""
        if design is not self._described or design is None:
            self._plain.text = describe_design(design) if design else none
            self._terms.text = design.sentence if design else ''
            self._described = design

    async def _click(self, x: float, y: float) -> None:
        if self._plan is None:
            return
        if self._tabs.value == 'Set point':
            self._set_point.click(x, y)
        else:
            self._tabs.value = 'Plan'
            await self._plan.click(x, y)

    def _seize(self) -> None:
        self._viewer.helm.seize(self._page)

    def _show_mode(self) -> None:
        source = self._viewer.source
        if isinstance(source, LoopClient) and source.mode != self._shown:
            self._shown = source.mode
            self._mode.text = self._shown.sentence
            self._mode.classes(replace=f'obc-mode {STYLES.get(self._shown.name, "obc-idle")}')

    async def _do_stop(self) -> None:
        """Stop the loop; a page that only watches may do so, too."""
        if isinstance(self._viewer.source, LoopClient):
            ui.notify(await self._viewer.source.stop())

    async def _do_start(self) -> None:
        if self._controls() and isinstance(self._viewer.source, LoopClient):
            ui.notify(await self._viewer.source.trigger(
                f'{self._viewer.source.controller}/start'))


def _empty_scene() -> dict[str, Any]:
    return {'marks': [], 'plane': None, 'size': 1.0, 'body': [], 'plume': 0.0, 'arm': 0.0,
            'states': [], 'panels': []}
