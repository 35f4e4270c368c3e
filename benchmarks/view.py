# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What an open page of `obc view` costs a loop at 200 Hz, and how fast the page reacts.

`obc view` starts the loop. It runs with the page server alone and with a page open in headless
Chromium, in turn. The browser has the same cores as the loop, and draws without a graphics card.
Both are measured as `obc view` starts the nodes by itself, with a real-time priority where the
system allows it, and with ordinary nodes (`--priority 0`). The counts begin when the page is
complete. A process that only sleeps shows how long the machine holds up
any process. Needs playwright and Debian's Chromium.

`python benchmarks/view.py --minutes 30` measures the memory only.
"""

import sys

import timing  # isort: skip - before numpy

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
import re
import shutil
import socket
from statistics import median
import subprocess
import tempfile
import time
from typing import Any

from _machine import memory, processor_time, Stalls
from obc_ros.cli.flight_client import Pilot
from obc_ros.cli.processes import Children, isolate
from obc_ros.cli.recording import Recorder

TURNS, SPAN = 3, 20.0  # parts without and with a page, [s] of each
SETTLE = 3.0     # [s] before the counts begin
RECENT = 0.05    # [s] age of the last state when they begin
# Options of `obc view`; what it does by itself must miss no state.
WAYS: dict[str, tuple[str, ...]] = {
    'as obc view starts it': (), 'ordinary': ('--priority', '0')}
CHANGES = 40     # of a weight
SHARE, REACTION, PAINT = 0.15, 0.2, 2.0  # of a core, [s], [s]
GROWTH = 10.0    # [MiB] of memory after the first minute
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
def serve_page(words: tuple[str, ...]) -> Iterator[tuple[subprocess.Popen[str], str, int]]:
    """Start `obc view` with its loop; yield its process, its address and the domain."""
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        port = probe.getsockname()[1]
    process = subprocess.Popen(
        [sys.executable, '-P', '-m', 'obc_ros.cli.obc', 'view', *words, '--no-browser',
         '--port', str(port)], stdout=subprocess.PIPE, text=True)
    try:
        domain = find_domain(process)
        deadline = time.monotonic() + 60.0
        while socket.socket().connect_ex(('127.0.0.1', port)):
            if process.poll() is not None or time.monotonic() > deadline:
                raise SystemExit('obc view does not serve its page')
            time.sleep(0.1)
        yield process, f'http://127.0.0.1:{port}/', domain
    finally:
        process.terminate()
        process.wait(10.0)


def find_domain(process: subprocess.Popen[str]) -> int:
    """Print what `obc view` says until it names its domain, and return this."""
    for line in process.stdout or ():
        print(f'  {line}', end='')
        if found := re.search(r'ROS_DOMAIN_ID=(\d+)', line):
            return int(found[1])
    raise SystemExit('obc view does not start its loop')


@dataclass
class Watch:
    """Sums over the parts with or without a page."""

    states: int = 0
    missed: int = 0
    stalls: int = 0
    used: float = 0.0  # processor time of obc view [s]
    late: list[float] = field(default_factory=list)  # from state to command [s]
    drawn: list[float] = field(default_factory=list)  # between two frames [ms]

    def observe(self, pilot: Pilot, server: subprocess.Popen[str], page: Any = None) -> None:
        """Count for `SPAN`, once the loop has settled and what came before has been read."""
        wait(pilot, SETTLE)
        # Nothing was read while the page was opened: on a busy machine more is left.
        pilot.wait(lambda: time.time_ns() < pilot.states.published[-1] + 1e9 * RECENT,
                   'the present', 60.0)
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
    page.get_by_text('(damping ratio)').first.wait_for()
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
def run_loop(words: tuple[str, ...] = ()) -> Iterator[tuple[Pilot, subprocess.Popen[str], str]]:
    """Run `obc view`; yield a recorder of its loop, the process of the server and its address."""
    with tempfile.TemporaryDirectory() as folder, serve_page(words) as (server, address, domain):
        isolate(domain)
        with Children(Path(folder)) as none, Recorder(Path(folder) / 'view') as recorder:
            pilot = Pilot(none, recorder)
            pilot.wait(lambda: bool(pilot.commands.stamp), 'the first command')
            yield pilot, server, address
            pilot.close()


def measure() -> int:
    """Measure and print; return 0 if all requirements hold."""
    from playwright.sync_api import sync_playwright
    paints, times, drawn = [], [], []
    rows: dict[str, tuple[str, ...]] = {}
    missed = {}
    shares = []
    with sync_playwright() as playwright:
        for way, words in WAYS.items():
            alone, watched = Watch(), Watch()
            with run_loop(words) as (pilot, server, address):
                for _ in range(TURNS):
                    alone.observe(pilot, server)
                    with open_page(playwright, address) as page:
                        paints.append(1e-3 * page.evaluate(PAINT_TIME))
                        times += measure_reactions(page)
                        watched.observe(pilot, server, page)
            rows |= {f'{way}, no page': alone.row(), f'{way}, one page': watched.row()}
            missed[way] = watched.missed
            shares.append(watched.used / TURNS / SPAN)
            drawn += watched.drawn
    timing.table('A loop at 200 Hz and its page', (
        'loop', 'share of a core of obc view', 'missed states', 'stalls over 10 ms',
        'state to command, p50 / p99'), [(name, *row) for name, row in rows.items()])
    timing.table('The page', ('', 'median', '99 %', 'largest'), [
        (name, *(f'{each:.3g}' for each in (median(values), quantile(values, 0.99), max(values))))
        for name, values in (('first paint [s]', paints), ('weight to poles [s]', times),
                             ('between two frames [ms]', drawn))])
    print(f'  frames a second: {1e3 * len(drawn) / sum(drawn):.1f}')
    timing.require('share of a core with a page', max(shares), SHARE)
    way = next(iter(WAYS))
    timing.require(f'missed states with a page, {way}', missed[way], 0)
    timing.require('first paint [s]', max(paints), PAINT)
    timing.require('weight to poles [s]', max(times), REACTION)
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
