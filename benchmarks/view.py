# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
What an open page of `obc view` costs a loop at 200 Hz, and how fast the page reacts.

The loop runs with the page server alone, then with a page open in headless Chromium. Needs
playwright and Debian's Chromium. `python benchmarks/view.py --minutes 30` measures the memory.
"""

import sys

import timing  # isort: skip - before numpy

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
import shutil
import socket
from statistics import median
import subprocess
import tempfile
import time
from typing import Any

from _machine import memory, processor_time
from obc_ros.cli.flight_client import Pilot
from obc_ros.cli.processes import Children, isolate, reserve_domain
from obc_ros.cli.recording import Recorder

SPAN = 60.0      # [s] of each part
CHANGES = 40     # of a weight
SHARE, REACTION, PAINT = 0.15, 0.2, 2.0  # of a core, [s], [s]
GROWTH = 10.0    # [MiB] of memory after the first minute
NODES = {'plant_simulator': ('system:=aircraft', 'publish_clock:=true'),
         'lqr_node': ('system:=aircraft', 'use_sim_time:=true'),
         'trajectory_server': ('workers:=1',)}
# Times of the frames that the page draws: each takes the contexts of two canvases.
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


def observe(pilot: Pilot, server: subprocess.Popen[bytes], span: float) -> dict[str, float]:
    """Return missed states, latency [s] and share of a core during `span` [s]."""
    for samples in (pilot.states, pilot.commands):
        for part in (samples.data, samples.stamp, samples.published):
            part.clear()
    begun, used = time.monotonic(), processor_time(server.pid)
    pilot.wait(lambda: time.monotonic() > begun + span, 'the end', span + 30.0)
    share = (processor_time(server.pid) - used) / (time.monotonic() - begun)
    late = sorted(pilot.latencies())
    return {'states': len(pilot.states.stamp), 'missed': pilot.missed(), 'share': share,
            'p50': median(late), 'p99': late[int(0.99 * len(late))]}


def measure_page(page: Any, address: str) -> dict[str, float]:
    """Open the page; return its first paint and the median reaction to a weight [s]."""
    page.goto(address)
    field = 'weight of px, as a number'
    page.get_by_label(field).wait_for()
    paint = page.evaluate(
        "performance.getEntriesByName('first-contentful-paint')[0].startTime")
    page.get_by_text('minimum damping ratio').first.wait_for()
    times = []
    for index in range(CHANGES):
        page.wait_for_timeout(100)
        times.append(page.evaluate(REACT, [field, 2.0 + index]) * 1e-3)
    return {'paint': paint * 1e-3, 'reaction': median(times), 'slowest': max(times)}


def measure(minutes: float) -> int:
    """Measure and print; return 0 if all requirements hold."""
    from playwright.sync_api import sync_playwright
    with (reserve_domain() as domain, tempfile.TemporaryDirectory() as folder):
        isolate(domain)
        with Children(Path(folder)) as children, Recorder(Path(folder) / 'view') as recorder:
            for node, parameters in NODES.items():
                children.start(node, *(word for each in parameters for word in ('-p', each)))
            pilot = Pilot(children, recorder)
            pilot.wait(lambda: bool(pilot.commands.stamp), 'the first command')
            with serve_page() as (server, address), sync_playwright() as playwright:
                alone = observe(pilot, server, SPAN)
                browser = playwright.chromium.launch(
                    executable_path=shutil.which('chromium'), args=['--no-sandbox'])
                page = browser.new_page(viewport={'width': 1280, 'height': 900})
                found = measure_page(page, address)
                page.evaluate(COUNT)
                watched = observe(pilot, server, SPAN)
                drawn = page.evaluate('window.drawn')
                held = [memory(server.pid)]
                for _ in range(round(minutes)):
                    observe(pilot, server, 60.0)
                    held.append(memory(server.pid))
                browser.close()
            pilot.close()
    return report(alone, watched, found, drawn, held)


def report(alone: dict[str, float], watched: dict[str, float], found: dict[str, float],
           drawn: list[float], held: list[float]) -> int:
    """Print a table; return 0 if all requirements hold."""
    gaps = sorted(b - a for a, b in zip(drawn, drawn[1:], strict=False))
    timing.table('A loop at 200 Hz and its page', ('', 'no page', 'one page'), [
        ('share of a core of obc view', f'{alone["share"]:.3f}', f'{watched["share"]:.3f}'),
        ('missed states', *(f'{each["missed"]:.0f} of {each["states"]:.0f}'
                            for each in (alone, watched))),
        ('state to command, p50 / p99', *(
            f'{1e3 * each["p50"]:.2f} / {1e3 * each["p99"]:.2f} ms'
            for each in (alone, watched))),
        ('first paint', '', f'{found["paint"]:.2f} s'),
        ('weight to poles, median / slowest', '',
         f'{1e3 * found["reaction"]:.0f} / {1e3 * found["slowest"]:.0f} ms'),
        ('frames a second', '', f'{len(drawn) / SPAN:.1f}'),
        ('between frames, p50 / p99 / longest', '',
         f'{gaps[len(gaps) // 2]:.0f} / {gaps[int(0.99 * len(gaps))]:.0f} / {gaps[-1]:.0f} ms'),
        ('memory of obc view each minute', '',
         ', '.join(f'{each:.0f}' for each in held) + ' MiB')])
    timing.require('share of a core with a page', watched['share'], SHARE)
    timing.require('missed states with a page', watched['missed'], 0)
    timing.require('first paint [s]', found['paint'], PAINT)
    timing.require('weight to poles [s]', found['reaction'], REACTION)
    timing.require('growth of the memory [MiB]', held[-1] - held[0], GROWTH)
    return timing.finish()


if __name__ == '__main__':
    sys.exit(measure(timing.arguments(__doc__ or '', minutes=0.0).minutes))
