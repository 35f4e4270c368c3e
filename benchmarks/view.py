# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What an open page of `obc view` costs a loop at 200 Hz, and how fast the page reacts.

The loop runs with the page server alone and with a page open in headless Chromium, in turn. The
browser has the same cores as the loop, and draws without a graphics card. Both are measured with
ordinary nodes and with nodes of real-time priority, which the browser cannot delay. The counts
begin when the page is complete. A process that only sleeps shows how long the machine holds up
any process. Needs playwright and Debian's Chromium.

`python benchmarks/view.py --minutes 30` measures the memory only.
"""

import sys

import timing  # isort: skip - before numpy

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
import shutil
import socket
from statistics import median
import subprocess
import tempfile
import time
from typing import Any

from _machine import memory, processor_time, Stalls
from obc_ros.cli.flight_client import Pilot
from obc_ros.cli.processes import Children, isolate, reserve_domain
from obc_ros.cli.recording import Recorder

TURNS, SPAN = 3, 20.0  # parts without and with a page, [s] of each
SETTLE = 3.0     # [s] before the counts begin
PRIORITIES = (0, 50)   # of plant_simulator and lqr_node; 0: ordinary processes
CHANGES = 40     # of a weight
SHARE, REACTION, PAINT = 0.15, 0.2, 2.0  # of a core, [s], [s]
GROWTH = 10.0    # [MiB] of memory after the first minute
NODES = {'plant_simulator': ('system:=aircraft', 'publish_clock:=true'),
         'lqr_node': ('system:=aircraft', 'use_sim_time:=true')}
FIELD = 'weight of px, as a number'
PAINT_TIME = "performance.getEntriesByName('first-contentful-paint')[0].startTime"
# Times of the frames that the page draws: each takes the context of the picture.
COUNT = """() => { window.drawn = []; const get = HTMLCanvasElement.prototype.getContext;
    HTMLCanvasElement.prototype.getContext = function (...words) {
      if (this.classList.contains('obc-plane')) window.drawn.push(performance.now());
      return get.apply(this, words); }; }"""
# From the change of a weight to the figures of the candidate [ms].
REACT = """([label, value]) => new Promise(done => {
    const field = document.querySelector(`[aria-label="${label}"]`), begun = performance.now();
    const rows = document.querySelector('table');
    new MutationObserver((_, seen) => { seen.disconnect(); done(performance.now() - begun); })
      .observe(rows, {childList: true, characterData: true, subtree: true});
    field.value = value; field.dispatchEvent(new Event('input', {bubbles: true})); })"""


@contextmanager
def serve_page() -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """Start `obc view` for the loop; yield its process and its address."""
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        port = probe.getsockname()[1]
    process = subprocess.Popen(
        [sys.executable, '-m', 'obc_ros.cli.obc', 'view', '--namespace', '/', '--control',
         '--no-browser', '--port', str(port)], stdout=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 60.0
        while socket.socket().connect_ex(('127.0.0.1', port)):
            if process.poll() is not None or time.monotonic() > deadline:
                raise SystemExit('obc view does not serve its page')
            time.sleep(0.1)
        yield process, f'http://127.0.0.1:{port}/'
    finally:
        process.terminate()
        process.wait(10.0)


@dataclass
class Watch:
    """Sums over the parts with or without a page."""

    states: int = 0
    missed: int = 0
    stalls: int = 0
    used: float = 0.0  # processor time of obc view [s]
    late: list[float] = field(default_factory=list)  # from state to command [s]
    drawn: list[float] = field(default_factory=list)  # between two frames [ms]

    def observe(self, pilot: Pilot, server: subprocess.Popen[bytes], page: Any = None) -> None:
        """Count for `SPAN`, once the loop has settled and what came before has been read."""
        wait(pilot, SETTLE)
        forget(pilot)
        if page:
            page.evaluate(COUNT)
        stalls, used = Stalls(), processor_time(server.pid)
        wait(pilot, SPAN)
        self.used += processor_time(server.pid) - used
        self.stalls += len(stalls.end())
        if page:
            times = page.evaluate('window.drawn')
            self.drawn += (b - a for a, b in zip(times, times[1:], strict=False))
        self.states += len(pilot.states.stamp)
        self.missed += pilot.missed()
        self.late += pilot.latencies().tolist()

    def row(self) -> tuple[str, ...]:
        """Return share of a core, missed states, stalls and latency."""
        return (f'{self.used / TURNS / SPAN:.3f}', f'{self.missed} of {self.states}',
                f'{self.stalls}', f'{1e3 * quantile(self.late, 0.5):.2f} / '
                f'{1e3 * quantile(self.late, 0.99):.2f} ms')


def quantile(values: list[float], share: float) -> float:
    """Return the value below which a share of the values lies."""
    return sorted(values)[min(int(share * len(values)), len(values) - 1)]


def forget(pilot: Pilot) -> None:
    """Delete what was recorded."""
    for samples in (pilot.states, pilot.commands, pilot.odometry):
        for part in (samples.data, samples.stamp, samples.published):
            part.clear()


def wait(pilot: Pilot, span: float) -> None:
    """Record for `span` [s]."""
    end = time.monotonic() + span
    pilot.wait(lambda: time.monotonic() > end, 'the end', span + 30.0)


@contextmanager
def open_page(playwright: Any, address: str) -> Iterator[Any]:
    """Yield a page in a new browser, once it is complete."""
    browser = playwright.chromium.launch(
        executable_path=shutil.which('chromium'), args=['--no-sandbox'])
    page = browser.new_page(viewport={'width': 1280, 'height': 900})
    page.goto(address)
    page.get_by_label(FIELD).wait_for()
    page.get_by_text('minimum damping ratio').first.wait_for()
    yield page
    browser.close()


def measure_reactions(page: Any) -> list[float]:
    """Return the times from the change of a weight to the figures of the candidate [s]."""
    times = []
    for index in range(CHANGES):
        page.wait_for_timeout(100)
        times.append(1e-3 * page.evaluate(REACT, [FIELD, 2.0 + index]))
    return times


@contextmanager
def run_loop(priority: int = 0) -> Iterator[tuple[Pilot, subprocess.Popen[bytes], str]]:
    """Run a loop and `obc view`; yield a recorder, the process of the server and its address."""
    with (reserve_domain() as domain, tempfile.TemporaryDirectory() as folder):
        isolate(domain)
        with Children(Path(folder)) as children, Recorder(Path(folder) / 'view') as recorder:
            for node, parameters in NODES.items():
                children.start(node, *(word for each in (*parameters, f'priority:={priority}')
                                       for word in ('-p', each)))
            children.start('trajectory_server', '-p', 'workers:=1')
            pilot = Pilot(children, recorder)
            pilot.wait(lambda: bool(pilot.commands.stamp), 'the first command')
            with serve_page() as (server, address):
                yield pilot, server, address
            pilot.close()


def measure() -> int:
    """Measure and print; return 0 if all requirements hold."""
    from playwright.sync_api import sync_playwright
    paints, times, drawn = [], [], []
    rows: dict[str, tuple[str, ...]] = {}
    missed: Counter[int] = Counter()
    shares = []
    with sync_playwright() as playwright:
        for priority in PRIORITIES:
            alone, watched = Watch(), Watch()
            with run_loop(priority) as (pilot, server, address):
                for _ in range(TURNS):
                    alone.observe(pilot, server)
                    with open_page(playwright, address) as page:
                        paints.append(1e-3 * page.evaluate(PAINT_TIME))
                        times += measure_reactions(page)
                        watched.observe(pilot, server, page)
            rows |= {f'no page, priority {priority}': alone.row(),
                     f'one page, priority {priority}': watched.row()}
            missed[priority] = watched.missed
            shares.append(watched.used / TURNS / SPAN)
            drawn += watched.drawn
    timing.table('A loop at 200 Hz and its page', (
        'nodes', 'share of a core of obc view', 'missed states', 'stalls over 10 ms',
        'state to command, p50 / p99'), [(name, *row) for name, row in rows.items()])
    timing.table('The page', ('', 'median', '99 %', 'largest'), [
        (name, *(f'{each:.3g}' for each in (median(values), quantile(values, 0.99), max(values))))
        for name, values in (('first paint [s]', paints), ('weight to poles [s]', times),
                             ('between two frames [ms]', drawn))])
    print(f'  frames a second: {1e3 * len(drawn) / sum(drawn):.1f}')
    timing.require('share of a core with a page', max(shares), SHARE)
    for priority in PRIORITIES:
        timing.require(f'missed states with a page, priority {priority}', missed[priority], 0)
    timing.require('first paint [s]', max(paints), PAINT)
    timing.require('weight to poles [s]', median(times), REACTION)
    return timing.finish()


def follow_memory(minutes: float) -> int:
    """Print the memory of `obc view` with an open page, each minute; return 0 if it is flat."""
    from playwright.sync_api import sync_playwright
    held = []
    with (sync_playwright() as playwright, run_loop() as (pilot, server, address),
          open_page(playwright, address)):
        for _ in range(round(minutes) + 1):
            wait(pilot, 60.0)
            forget(pilot)
            held.append(memory(server.pid))
            print(f'{len(held)} min: {held[-1]:.1f} MiB', flush=True)
    timing.require('growth of the memory [MiB]', max(held) - held[0], GROWTH)
    return timing.finish()


def main() -> int:
    """Measure the cost, or the memory over some minutes."""
    minutes = timing.arguments(__doc__ or '', minutes=0.0).minutes
    return follow_memory(minutes) if minutes else measure()


if __name__ == '__main__':
    sys.exit(main())
