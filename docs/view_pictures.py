# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Take the pictures of docs/view.md from a running page (`make picture`)."""

from collections.abc import Iterator
from contextlib import contextmanager
import io
from pathlib import Path
import re
import shutil
import subprocess
import sys
import tempfile
import time
from typing import Any
from urllib.error import URLError
from urllib.request import urlopen

from obc_ros.cli.processes import isolate, reserve_domain
from PIL import Image
from playwright.sync_api import sync_playwright

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / 'docs' / 'view'
PORT = 8090
ADDRESS = f'http://127.0.0.1:{PORT}/'
WIDE, NARROW = {'width': 1280, 'height': 900}, {'width': 360, 'height': 740}
GOAL = (0.72, 0.2)       # of the picture's width and height
FRAMES, PAUSE = 45, 0.1  # of the moving picture, and the time [s] between two of them
TRIES = 5                # to fly
COLOURS, SIZE = 96, (896, 630)
LOOP = ('controller:=mpc', 'estimator:=true', 'use_sim_time:=true', 'speed:=0.3')


@contextmanager
def start(*words: str) -> Iterator[None]:
    """Run `obc` with arguments."""
    process = subprocess.Popen([Path(sys.executable).with_name('obc'), *words])
    try:
        yield
    finally:
        process.terminate()
        process.wait(20.0)


@contextmanager
def start_page(*words: str) -> Iterator[None]:
    """Serve the page of `obc view`."""
    with start('view', *words, '--no-browser', '--port', str(PORT)):
        for _ in range(300):
            try:
                with urlopen(ADDRESS, timeout=5.0):
                    break
            except URLError:
                time.sleep(0.1)
        else:
            raise SystemExit('obc view does not serve its page')
        yield


def keep(page: Any, name: str, **options: Any) -> None:
    """Write a picture of a page."""
    file = PICTURES / f'{name}.png'
    page.screenshot(path=file, **options)
    with Image.open(file) as full:   # a palette that keeps the colours of thin lines
        full.convert('RGB').quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE
                                     ).save(file, optimize=True)


def open_page(browser: Any, **options: Any) -> Any:
    """Open the page, wait for its sliders, and take the control."""
    page = browser.new_page(**options)
    page.goto(ADDRESS)
    page.get_by_label('weight of px, as a number').wait_for()
    page.get_by_role('button', name='watching: take control').click()
    page.get_by_role('button', name='this page controls').wait_for()
    return page


def take_pictures(browser: Any) -> None:
    """Write a picture of each view, and the moving one."""
    page = open_page(browser, viewport=WIDE)
    page.get_by_label('weight of px, as a number').fill('100')
    page.get_by_label('weight of f1, as a number').fill('0.1')
    page.wait_for_timeout(1500)
    keep(page, 'weights')
    page.get_by_label('weight of f2, as a number').fill('-0.1')
    page.get_by_role('alert').filter(has_text='positive definite').wait_for()
    keep(page, 'rejected')
    page.get_by_label('weight of f2, as a number').fill('1')
    page.get_by_role('button', name='Apply').click()
    page.wait_for_timeout(1000)
    page.get_by_role('tab', name='Set point', exact=True).click()
    for name in ('Step', 'Back'):
        page.get_by_role('button', name=name, exact=True).click()
        page.get_by_text('set point: ').wait_for()
        page.wait_for_timeout(4000)
        if name == 'Step':
            keep(page, 'set_point')
    page.get_by_role('tab', name='Plan', exact=True).click()
    plane = page.locator('.obc-plane')
    box = plane.bounding_box()
    plane.click(position={'x': GOAL[0] * box['width'], 'y': GOAL[1] * box['height']})
    page.locator('[aria-label*="Hamiltonian"]').wait_for()   # the last curve
    page.wait_for_timeout(500)
    keep(page, 'plan', full_page=True)
    record_flight(page)
    page.close()
    take_gust(browser)
    narrow = open_page(browser, viewport=NARROW, color_scheme='dark')
    narrow.wait_for_timeout(1500)
    keep(narrow, 'telephone')
    narrow.close()


def take_gust(browser: Any) -> None:
    """Write the picture of the plant in a gust."""
    page = open_page(browser, viewport=WIDE)
    page.get_by_role('tab', name='Plant', exact=True).click()
    page.get_by_label('duration [s]', exact=True).fill('4')
    page.get_by_role('button', name='Gust', exact=True).click()
    page.locator('.obc-plane[aria-label*="gust"]').wait_for()
    page.wait_for_timeout(500)
    page.evaluate('scrollTo(0, 0)')
    keep(page, 'plant')
    page.close()


def take_prediction(browser: Any) -> None:
    """Write the picture of a loop with mpc_node and estimator_node."""
    page = open_page(browser, viewport=WIDE)
    plane = page.locator('.obc-plane[aria-label*="predicted"][aria-label*="95 % region"]')
    plane.wait_for()
    page.get_by_role('tab', name='Plant', exact=True).click()
    page.get_by_role('button', name='Gust', exact=True).click()
    page.get_by_text('set: disturbance').wait_for()
    page.wait_for_timeout(4000)
    page.evaluate('scrollTo(0, 0)')
    page.wait_for_timeout(300)
    keep(page, 'prediction')
    page.close()


def take_recording(browser: Any) -> None:
    """Write the picture of a recording."""
    page = browser.new_page(viewport=WIDE)
    page.goto(ADDRESS)
    page.get_by_role('button', name='Play').click()
    page.wait_for_timeout(9000)
    page.get_by_role('button', name='Pause').click()
    page.wait_for_timeout(300)
    page.evaluate('scrollTo(0, 0)')
    keep(page, 'recording', full_page=True)
    page.close()


def record_flight(page: Any) -> None:
    """Write the moving picture: the plan is flown."""
    said = page.get_by_text(re.compile('lqr_node: .*a reference |lqr_node rejected it')).first
    for _ in range(TRIES):   # on a busy machine a plan may be late, and is rejected
        page.get_by_role('button', name='Fly it').click()
        said.wait_for(state='hidden')
        said.wait_for()
        if 'rejected' not in said.inner_text():
            break
    frames = []
    for _ in range(FRAMES):
        shot = Image.open(io.BytesIO(page.screenshot())).convert('RGB')
        frames.append(shot.resize(SIZE, Image.Resampling.LANCZOS))
        page.wait_for_timeout(1000 * PAUSE)
    palette = frames[0].quantize(COLOURS, dither=Image.Dither.NONE)
    reduced = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in frames]
    reduced[0].save(PICTURES / 'flight.gif', save_all=True, append_images=reduced[1:], loop=0,
                    duration=[200] * (len(reduced) - 1) + [3000], optimize=True)


def main() -> int:
    """Start the page, and take the pictures."""
    PICTURES.mkdir(exist_ok=True)
    with sync_playwright() as playwright, reserve_domain() as domain:
        browser = playwright.chromium.launch(
            executable_path=shutil.which('chromium'), args=['--no-sandbox'])
        with start_page():
            take_pictures(browser)
        isolate(domain)
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([Path(sys.executable).with_name('obc'), 'demo', 'aircraft', '--out',
                            folder], check=True)
            with start_page(str(Path(folder) / 'aircraft')):
                take_recording(browser)
        with start('launch', 'loop', *LOOP), start_page('--namespace', '/', '--control'):
            take_prediction(browser)
        browser.close()
    return 0


if __name__ == '__main__':
    sys.exit(main())
