# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc view` in Debian's Chromium: a user tunes, plans, stops and watches a running loop."""

from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
import re
import shutil
import socket
import time
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from obc_ros.cli.processes import reserve_domain
from obc_ros.core.text.example_files import find_example
from obc_ros.msg import Estimate, LqrDesign, State, Trajectory
from obc_ros.srv import PlanMotion
from obc_ros.view.access import HEADER_TIME
from probes import Probe
import pytest
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile
import support
from view_recording import design_of, record

sync = pytest.importorskip('playwright.sync_api', reason='playwright is not installed')
CHROMIUM = next(filter(None, map(shutil.which, (
    'chromium', 'chromium-browser', 'google-chrome'))), '')
pytestmark = [
    pytest.mark.nodes,
    pytest.mark.skipif(not CHROMIUM, reason='no Chromium: apt-get install chromium')]
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
WAIT = 1e3 * support.DEADLINE   # [ms] of a step in the browser
HOSTILE = '<img src=x onerror="window.pwned=1"><script>window.pwned=1</script>{{ 7*7 }}'
# Whether the last cell of a row is another than before.
CHANGED = """([what, before]) => [...document.querySelectorAll('tr')].some(
    row => row.innerText.includes(what) && row.lastElementChild.innerText !== before)"""
TYPED = """([label, before]) => Number(
    document.querySelector(`[aria-label="${label}"]`).value) > before"""
# Pixels of a colour in a canvas.
COUNT_PIXELS = """canvas => { const { data } = canvas.getContext("2d").getImageData(
    0, 0, canvas.width, canvas.height); let found = 0;
    for (let i = 0; i < data.length; i += 4)
      found += data[i] === %#x && data[i + 1] === %#x && data[i + 2] === %#x;
    return found; }"""
LATER = """than => document.querySelector('[aria-label="time [s]"]')
    .getAttribute('aria-valuenow') > than"""
# Notes where texts and dashed lines go in each canvas; a canvas begins anew with its background.
NOTE_TEXTS = """() => {
    const own = CanvasRenderingContext2D.prototype;
    const wrap = (name, note) => { const before = own[name];
        own[name] = function (...given) {
            note(this, given); return before.apply(this, given); }; };
    wrap('fillRect', ({ canvas }) => { canvas.texts = []; canvas.dashed = 0; });
    wrap('stroke', (context) => { context.canvas.dashed += context.getLineDash()[0] === 6; });
    wrap('fillText', (context, [text, x, y]) => {
        const size = context.measureText(text);
        if (text) context.canvas.texts?.push([text, x, y - size.actualBoundingBoxAscent,
            x + size.width, y + size.actualBoundingBoxDescent]); }); }"""
TEXTS = 'canvas => canvas.texts'
PICTURE = 'canvas => canvas.toDataURL()'
PICTURE_CHANGED = 'shown => document.querySelector(".obc-plane").toDataURL() !== shown'
COUNT_REFERENCE = COUNT_PIXELS % (0xcc, 0x79, 0xa7)
COUNT_ELLIPSE = COUNT_PIXELS % (0x56, 0xb4, 0xe9)
# Draws one more frame with a state; returns the left and lower end of the plane, and its scale.
PUSH_STATE = """async x => {
    const id = Number(document.querySelector('.obc-view').id.slice(1));
    const view = getElement(id);
    view.push({ ...view.frames[view.frames.length - 1], x });
    await new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
    return view.box; }"""
IN_SIGHT = """px => {
    const view = getElement(Number(document.querySelector('.obc-view').id.slice(1)));
    const [left, , scale] = view.box;
    return left < px && px < left + view.$el.clientWidth / scale; }"""
PROBLEMS = find_example('x').parent
AIRCRAFT = {'system': 'aircraft', 'publish_rate': 50.0, 'publish_clock': True}


def is_open(port: int) -> bool:
    """Return whether a server accepts connections."""
    with socket.socket() as probe:
        return probe.connect_ex(('127.0.0.1', port)) == 0


def serve(spawner: support.Spawner, folder: Path, domain: int, *words: str) -> str:
    """Start `obc view`; return its address."""
    port = support.find_port()
    process = support.Process(
        [support.find('obc'), 'view', *words, '--no-browser', '--port', str(port)],
        folder / f'view{port}.log', domain)
    spawner.processes.append(process)
    process.wait_for_output('obc view: http')
    support.wait_for(lambda: is_open(port), support.DEADLINE)
    return f'http://127.0.0.1:{port}/'


class Site:
    """A loop, its page, a browser and a probe."""

    def __init__(self, folder: Path, domain: int, browser: Any) -> None:
        self.spawner = support.Spawner(folder, domain)
        self.domain, self.folder, self.browser = domain, folder, browser
        self.spawner('plant_simulator', AIRCRAFT)
        self.spawner('lqr_node', {**support.DEMO, 'system': 'aircraft', 'use_sim_time': True})
        self.spawner('trajectory_server', {'workers': 1, 'plan_lead': 3.0})
        self.probe = Probe(domain)
        self.designs = self.probe.listen(LqrDesign, 'lqr_node/design', LATCHED)
        self.states = self.probe.listen(State, 'state')
        self.log = self.probe.listen(Log, '/rosout', LATCHED)
        self.address = serve(self.spawner, folder, domain, '--namespace', '/', '--control')
        self.said: list[str] = []
        self.probe.wait_for(lambda: self.designs and self.states)

    def open(self, address: str = '', **options: Any) -> Any:
        """Open a page in a context of its own, and wait until it shows the loop."""
        context = self.browser.new_context(**{
            'viewport': {'width': 1280, 'height': 900}, **options})
        page = context.new_page()
        page.set_default_timeout(WAIT)
        page.on('pageerror', lambda error: self.said.append(str(error)))
        page.goto(address or self.address)
        return page

    def open_loop(self, **options: Any) -> Any:
        """Open a page of the loop, in control, with its sliders."""
        page = self.open(**options)
        number(page, 'weight of px').wait_for()
        take_control(page)
        return page

    def settle(self) -> np.ndarray:
        """Return the state of the plant now."""
        self.states.clear()
        self.probe.wait_for(lambda: self.states)
        return np.array(self.states[-1].x)

    def close(self) -> list[str]:
        """End all processes; return what went wrong."""
        self.probe.close()
        return self.spawner.end()


@pytest.fixture(scope='module')
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """Return a loop with a page, for all tests of this file."""
    with reserve_domain() as domain, sync.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=['--no-sandbox'])
        site = Site(tmp_path_factory.mktemp('view'), domain, browser)
        yield site
        browser.close()
        wrong = site.close()
    assert not wrong, '\n'.join(wrong)
    assert not site.said, site.said


@pytest.fixture
def page(site: Site) -> Iterator[Any]:
    """Return a page of the loop, in control."""
    page = site.open_loop()
    yield page
    page.context.close()


def take_control(page: Any) -> None:
    """Take the control, from other pages too."""
    page.get_by_role('button', name='watching: take control').click()
    page.get_by_role('button', name='this page controls').wait_for()


def number(page: Any, title: str) -> Any:
    """Return the field of a weight."""
    return page.get_by_label(f'{title}, as a number')


def candidate(page: Any, what: str) -> str:
    """Return a figure of the candidate."""
    return str(page.get_by_role('row', name=what).get_by_role('cell').last.inner_text())


def choose(page: Any, label: str, option: str) -> None:
    """Choose an option of a list."""
    page.get_by_label(label).click()
    page.get_by_role('option', name=option).click()


def tab(page: Any, name: str) -> None:
    """Open a panel."""
    page.get_by_role('tab', name=name, exact=True).click()


def test_a_weight_shows_the_candidate_that_apply_then_adopts(site, page):
    page.get_by_text(re.compile('^slowest mode .* s; ')).click()
    page.locator('.obc-design').get_by_text('spectral abscissa').wait_for()
    before = candidate(page, 'damping ratio')
    number(page, 'weight of px').fill('100')
    page.wait_for_function(CHANGED, arg=['damping ratio', before])
    shown = candidate(page, 'damping ratio')
    revision = site.designs[-1].revision
    page.get_by_role('button', name='Apply').click()
    site.probe.wait_for(lambda: site.designs[-1].revision > revision)
    design = site.designs[-1]
    assert np.diag(np.reshape(design.qx, (6, 6)))[0] == 100.0
    assert shown == f'{np.min(design.damping):.3g}'
    page.get_by_role('button', name='Undo').click()
    site.probe.wait_for(lambda: site.designs[-1].qx[0] == 1.0)


def test_a_rejected_weight_has_its_reason_beside_it_and_changes_nothing(site, page):
    revision = site.designs[-1].revision
    number(page, 'weight of f1').fill('-0.1')
    reason = page.get_by_role('alert').filter(has_text='must be positive definite')
    reason.wait_for()
    assert 'Qu[0] = -0.1' in reason.inner_text()
    page.get_by_role('button', name='Apply').click()
    site.probe.spin_for(0.5)
    assert reason.is_visible()
    assert site.designs[-1].revision == revision


def test_weights_are_given_as_largest_deviations_and_back(site, page):
    """A weight of 1/d^2 is the deviation d; the switch leaves the candidate as it is."""
    number(page, 'weight of px').fill('4')
    choose(page, 'given as', 'largest deviations')
    scale = number(page, 'largest deviation of px [m]')
    scale.wait_for()
    assert float(scale.input_value()) == 0.5
    scale.fill('0.2')
    revision = site.designs[-1].revision
    page.get_by_role('button', name='Apply').click()
    site.probe.wait_for(lambda: site.designs[-1].revision > revision)
    assert np.reshape(site.designs[-1].qx, (6, 6))[0, 0] == pytest.approx(25.0, rel=1e-9)
    assert site.probe.get_parameters('/lqr_node', 'weights') == {'weights': 'bryson'}
    choose(page, 'given as', 'weights Qx')
    field = number(page, 'weight of px')
    field.wait_for()
    assert float(field.input_value()) == 25.0
    revision = site.designs[-1].revision
    page.get_by_role('button', name='Undo').click()
    site.probe.wait_for(lambda: site.designs[-1].revision > revision)
    assert site.designs[-1].qx[0] == 1.0
    assert site.probe.get_parameters('/lqr_node', 'weights') == {'weights': 'matrices'}


def test_the_reference_of_another_client_is_drawn_if_lqr_node_follows_it(site, page):
    """Pixels of its colour are in the picture, and are gone once it is followed no more."""
    publisher = site.probe.node.create_publisher(Trajectory, 'reference', LATCHED)
    site.probe.wait_for(lambda: publisher.get_subscription_count() >= 2)
    plane, goal = page.locator('.obc-plane'), site.settle()
    goal[0] += 0.4
    answer = site.probe.call(PlanMotion, '/trajectory_server/plan', PlanMotion.Request(
        system='aircraft', goal=goal, objective='quadratic', final_time=20.0))
    assert answer.success, answer.message
    assert plane.evaluate(COUNT_REFERENCE) == 0
    path = answer.trajectory
    path.header.stamp.sec = path.header.stamp.nanosec = 0   # it begins when it is accepted
    publisher.publish(path)
    page.wait_for_function(f'({COUNT_REFERENCE})(document.querySelector(".obc-plane")) > 20')
    path.x = np.zeros(len(path.x))   # no motion of the plant
    publisher.publish(path)
    page.wait_for_function(f'({COUNT_REFERENCE})(document.querySelector(".obc-plane")) === 0')
    publisher.publish(Trajectory())
    site.probe.node.destroy_publisher(publisher)


def test_the_plan_of_mpc_node_and_the_ellipse_of_an_estimator_are_drawn(site, page):
    plans, estimates = (site.probe.publisher(*each) for each in (
        (Trajectory, 'mpc_node/plan'), (Estimate, 'estimator_node/estimate')))
    plane, here = page.locator('.obc-plane'), site.settle()
    before = plane.evaluate(COUNT_ELLIPSE)
    plan = Trajectory(system='aircraft', state_names=list(site.designs[-1].state_names),
                      input_names=list(site.designs[-1].input_names),
                      t=[0.0, 20.0], x=[*here, here[0] + 0.5, *here[1:]], u=[0.0] * 4)
    estimate = Estimate(x=here, covariance=np.diag([0.01, 0.04, *[1e-4] * 4]).ravel())
    plan.header.stamp = site.states[-1].header.stamp
    plans.publish(plan)

    def is_drawn() -> bool:
        estimate.header.stamp = site.states[-1].header.stamp
        estimates.publish(estimate)
        said = plane.get_attribute('aria-label')
        return (f'predicted: px {here[0] + 0.5:.2f}, py {here[1]:.2f}' in said
                and '95 % region: half axes 0.49 m and 0.24 m' in said
                and plane.evaluate(COUNT_ELLIPSE) > before + 100)

    site.probe.wait_for(is_drawn)
    plan.x[6] = 1e17   # a grid of such numbers has an end
    plans.publish(plan)
    site.probe.wait_for(lambda: 'predicted: px 1000000' in plane.get_attribute('aria-label'))
    page.wait_for_timeout(1000)
    plans.publish(Trajectory())
    site.probe.wait_for(lambda: 'predicted' not in plane.get_attribute('aria-label'))
    for publisher in (plans, estimates):
        site.probe.node.destroy_publisher(publisher)


def test_a_goal_by_click_is_planned_certified_and_flown(site, page):
    tab(page, 'Plan')
    plane = page.locator('.obc-plane')
    box = plane.bounding_box()
    plane.click(position={'x': 0.62 * box['width'], 'y': 0.4 * box['height']})
    page.get_by_text('solved: ').wait_for()
    assert page.get_by_text('\u2713 holds').count() >= 8
    assert page.get_by_text('\u2717').count() == 0
    goal = [float(page.get_by_label(name, exact=True).input_value())
            for name in ('px [m]', 'py [m]')]
    assert goal != [0.0, 0.0]
    said = page.get_by_text(re.compile('lqr_node: .*a reference |lqr_node rejected it')).first
    for _ in range(5):   # on a busy machine a plan may be late, and is rejected
        page.get_by_role('button', name='Fly it').click()
        said.wait_for(state='hidden')
        said.wait_for()
        if 'rejected' not in said.inner_text():
            break
    assert re.search(r'lqr_node: a reference of [0-9.]+ s', said.inner_text())
    site.settle()
    site.probe.wait_for(lambda: np.abs(np.array(site.states[-1].x[:2]) - goal).max() < 0.01
                        and np.abs(site.states[-1].x[3:5]).max() < 0.01, 40.0)


def test_the_ticks_of_all_axes_leave_their_names_legible(site, page):
    """At no width does a text lie on another one or beyond the edge."""
    page.evaluate(NOTE_TEXTS)
    for width in (360, 390, 480, 600, 768, 1024, 1280):
        page.set_viewport_size({'width': width, 'height': 900})
        page.wait_for_timeout(400)
        for name, axes in (('plane', ('px [m]', 'py [m]')), ('plots', ('time [s]',))):
            canvas = page.locator(f'.obc-{name}')
            texts, edge = canvas.evaluate(TEXTS), canvas.bounding_box()['width']
            found = [each[0] for each in texts]
            assert set(axes) < set(found), (width, found)
            assert sum(each.lstrip('-').replace('.', '').isdigit() for each in found) >= 3, found
            assert all(left >= 0.0 and right <= edge for _, left, _, right, _ in texts), texts
            for (a, *one), (b, *other) in combinations(texts, 2):
                assert (one[2] <= other[0] or other[2] <= one[0]
                        or one[3] <= other[1] or other[3] <= one[1]), (width, a, b)


def test_the_set_point_is_clicked_typed_stepped_and_brought_back(site, page):
    """The click alone moves nothing; a watching page has no button."""
    tab(page, 'Set point')
    hold, step, back = (page.get_by_role('button', name=name, exact=True)
                        for name in ('Hold it', 'Step', 'Back'))
    fields = [page.get_by_label(f'{name} [m]', exact=True) for name in ('px', 'py')]
    before = list(site.designs[-1].xe)
    box, revision = page.locator('.obc-plane').bounding_box(), site.designs[-1].revision
    page.wait_for_function('document.querySelector("[aria-label=\'px [m]\']").value !== ""')
    page.locator('.obc-plane').click(
        position={'x': 0.55 * box['width'], 'y': 0.45 * box['height']})
    site.probe.wait_for(lambda: float(fields[0].input_value()) != before[0])
    assert back.is_disabled() and site.designs[-1].revision == revision
    target = [float(field.input_value()) for field in fields]
    page.evaluate(NOTE_TEXTS)
    hold.click()
    site.probe.wait_for(lambda: list(site.designs[-1].xe[:2]) == target)
    page.wait_for_function('document.querySelector(".obc-plots").dashed >= 6')   # set points
    page.get_by_label('size of the step').fill('0.25')
    step.click()
    site.probe.wait_for(
        lambda: list(site.designs[-1].xe[:2]) == pytest.approx([target[0] + 0.25, target[1]]))
    back.click()
    site.probe.wait_for(lambda: list(site.designs[-1].xe[:2]) == target)
    site.probe.wait_for(lambda: float(fields[0].input_value()) == target[0])
    fields[0].fill('')
    hold.click()
    page.get_by_text('every state needs a number').wait_for()
    page.get_by_label('theta [rad]', exact=True).fill('0.4')   # it does not hover so
    fields[0].fill('0')
    hold.click()
    page.get_by_text('rejected: ').wait_for()
    assert list(site.designs[-1].xe[:2]) == target
    site.probe.set_parameters('/lqr_node', setpoint=before)


def test_a_state_whose_place_is_not_known_leaves_the_picture_in_sight(site, page):
    for x in ([], [None] * 6, [-1e308] * 6, [1e308] * 6):
        assert np.isfinite(page.evaluate(PUSH_STATE, x)).all()
    here = site.settle()
    site.probe.wait_for(lambda: abs(page.evaluate(PUSH_STATE, here.tolist())[0] - here[0]) < 10.0)


def start(page: Any) -> None:
    """Start the loop again."""
    page.get_by_role('button', name='Start').click()
    page.locator('.obc-stopped').wait_for(state='detached')


@pytest.mark.parametrize('way', ['button', 'space bar'])
def test_stop_is_one_click_or_the_space_bar(site, page, way):
    if way == 'button':
        page.get_by_role('button', name='Stop').click()
    else:
        page.locator('.obc-plots').click()
        page.keyboard.press(' ')
    page.locator('.obc-stopped').wait_for()
    start(page)


def press_keys(page: Any, element: Any, keys: str) -> None:
    """Give an element the focus, and press keys one after the other."""
    element.focus()
    for key in keys:
        page.keyboard.press(key)


def list_requests(site: Site) -> list[str]:
    """Return what lqr_node was asked, to stop or to start, once its log is read."""
    before = -1
    while before != len(site.log):
        before = len(site.log)
        site.probe.spin_for(0.3)
    words = (each.msg.partition(':')[0] for each in site.log)
    return [each for each in words if each in ('~/stop', '~/start')]


@pytest.mark.parametrize('name', ['Start', 'Apply', 'Undo', 'light or dark', 'Stop'])
def test_space_stops_and_does_not_press_the_button_with_the_focus(site, page, name):
    dark = page.evaluate('document.body.classList.contains("body--dark")')
    page.get_by_role('button', name='Stop').click()
    page.locator('.obc-stopped').wait_for()
    # The log of earlier requests may come late.
    site.probe.wait_for(lambda: list_requests(site)[-1:] == ['~/stop'])
    asked, revision = list_requests(site), site.designs[-1].revision
    press_keys(page, page.get_by_role('button', name=name), ' ')
    site.probe.wait_for(lambda: len(list_requests(site)) > len(asked))
    assert list_requests(site) == [*asked, '~/stop']
    assert page.locator('.obc-stopped').inner_text() == 'STOPPED: by ~/stop'
    assert site.designs[-1].revision == revision
    assert page.evaluate('document.body.classList.contains("body--dark")') == dark
    start(page)


def test_space_in_a_field_of_text_is_a_space_and_in_one_of_a_number_stops(site, page):
    tab(page, 'Problem')
    text = page.get_by_label('problem (YAML)')
    text.fill('')
    press_keys(page, text, 'a b')
    assert text.input_value() == 'a b'
    site.probe.spin_for(1.2)
    assert page.locator('.obc-stopped').count() == 0
    tab(page, 'Weights')
    press_keys(page, number(page, 'weight of px'), ' ')
    page.locator('.obc-stopped').wait_for()
    start(page)


def test_the_mode_is_shown_on_every_page_and_stays(site, page):
    second = site.open()
    for each in (page, second):
        each.locator('.obc-mode').filter(has_text='set point').wait_for()
    page.get_by_role('button', name='Stop').click()
    for each in (page, second):
        each.locator('.obc-stopped').filter(has_text='by ~/stop').wait_for()
    site.probe.spin_for(2.5)   # two more diagnostics
    for each in (page, second):
        assert each.locator('.obc-stopped').is_visible()
    second.reload()
    second.locator('.obc-stopped').wait_for()
    start(page)
    second.locator('.obc-stopped').wait_for(state='detached')
    second.context.close()


def test_a_connection_without_a_whole_header_is_closed(site):
    address = urlsplit(site.address)
    with socket.create_connection((address.hostname, address.port)) as client:
        client.settimeout(HEADER_TIME + 10.0)
        client.sendall(f'GET / HTTP/1.1\r\nHost: {address.netloc}\r\n'.encode())
        begun = time.monotonic()
        assert client.recv(1) == b''
        assert HEADER_TIME - 0.5 < time.monotonic() - begun < HEADER_TIME + 5.0


def test_a_second_page_watches_until_it_takes_the_control(site, page):
    second = site.open()
    watching = second.get_by_role('button', name='watching: take control')
    watching.wait_for()
    assert second.get_by_role('button', name='Apply').is_disabled()
    assert second.get_by_role('button', name='Start').is_disabled()
    second.get_by_role('button', name='Stop').click()
    page.locator('.obc-stopped').wait_for()
    start(page)
    watching.click()
    second.get_by_role('button', name='this page controls').wait_for()
    page.get_by_role('button', name='watching: take control').wait_for()
    second.context.close()


def test_the_first_page_of_a_loop_watches_until_it_takes_the_control(site, tmp_path):
    """As a page that a program has opened, or that was left open in another window."""
    page = site.open(serve(site.spawner, tmp_path, site.domain, '--namespace', '/', '--control'))
    number(page, 'weight of px').wait_for()
    for name in ('Apply', 'Start'):
        assert page.get_by_role('button', name=name).is_disabled()
    take_control(page)
    page.get_by_role('button', name='Start', disabled=False).wait_for()
    page.reload()
    page.get_by_role('button', name='watching: take control').wait_for()
    page.context.close()


def test_a_page_whose_connection_breaks_keeps_what_was_typed_and_the_control(site, page):
    tab(page, 'Plan')
    field = page.get_by_label('duration [s], 0: chosen')
    field.fill('7.5')
    plane = page.locator('.obc-plane')
    page.evaluate('window.connections = 0; window.socket.on("connect", () => ++connections)')
    page.evaluate('window.socket.io.engine.close()')
    page.wait_for_function('window.connections === 1')   # a page loaded anew has no such variable
    assert field.input_value() == '7.5'
    page.get_by_role('button', name='this page controls').wait_for()
    for _ in range(3):   # the time of each frame is in the picture
        shown = plane.evaluate(PICTURE)
        page.wait_for_function(PICTURE_CHANGED, arg=shown)


def test_the_plant_is_paused_and_disturbed(site, page):
    tab(page, 'Plant')
    page.get_by_role('button', name='Pause').click()
    page.get_by_text(re.compile('pause', re.IGNORECASE)).last.wait_for()
    site.probe.spin_for(0.3)
    site.states.clear()
    site.probe.spin_for(0.3)
    assert not site.states
    plane = page.locator('.obc-plane')
    site.probe.wait_for(lambda: 'no new state for 2 s' in plane.get_attribute('aria-label'))
    page.get_by_role('button', name='Continue').click()
    site.probe.wait_for(lambda: site.states)
    site.probe.wait_for(lambda: 'no new state' not in plane.get_attribute('aria-label'))
    before = site.settle()
    page.get_by_label('peak of its rate').fill('3')
    page.get_by_role('button', name='Gust', exact=True).click()
    page.get_by_text('set: disturbance.gust.vx = 3.0').wait_for()
    site.probe.wait_for(lambda: 'gust on vx' in plane.get_attribute('aria-label'))
    site.probe.wait_for(lambda: abs(site.states[-1].x[0] - before[0]) > 0.05)
    site.probe.wait_for(lambda: 'gust' not in plane.get_attribute('aria-label'))
    noise = page.get_by_label('noise of px', exact=True)
    noise.fill('0.001')
    noise.blur()
    site.probe.wait_for(lambda: 'noise' in plane.get_attribute('aria-label'))
    noise.fill('0')
    noise.blur()
    site.probe.wait_for(lambda: 'noise' not in plane.get_attribute('aria-label'))


def test_an_example_is_solved_and_its_certificate_shown(site, page):
    tab(page, 'Problem')
    page.get_by_label('example').click()
    page.get_by_label('example').fill('di_mintime_rest')
    page.get_by_role('option', name='di_mintime_rest').click()
    page.get_by_role('button', name='Solve').click()
    page.get_by_text('solved: ').wait_for()
    page.get_by_text(re.compile(r'cost [0-9.]+, global')).wait_for()
    page.locator('[aria-label*="switching functions"]').wait_for()
    assert page.get_by_text('\u2713 holds').count() >= 8


def test_examples_are_at_hand_and_none_is_solved_unasked(site, page):
    tab(page, 'Problem')
    text = page.get_by_label('problem (YAML)')
    assert text.input_value() == (PROBLEMS / 'di_mintime_rest.yaml').read_text()
    page.get_by_text('moon landing', exact=True).click()
    page.wait_for_function(
        'document.querySelector(".obc-yaml textarea").value.startsWith("name: moon_lander")')
    assert text.input_value() == (PROBLEMS / 'moon_lander.yaml').read_text()
    assert page.get_by_role('button', name='Cancel').is_disabled()


@pytest.mark.parametrize(('text', 'why'), [
    ('states: [x', 'expected'), ('name: a\nstates: [x]\ninputs: [u]\ndynamics: {x: w}',
                                'dynamics.x'), ('', '')])
def test_a_malformed_problem_is_answered_in_words(site, page, text, why):
    tab(page, 'Problem')
    page.get_by_label('problem (YAML)').fill(text)
    page.get_by_role('button', name='Solve').click()
    message = page.get_by_role('tabpanel').get_by_role('status')
    page.wait_for_function('() => [...document.querySelectorAll(".obc-message")].some('
                           'each => each.offsetParent && each.innerText)')
    assert why in message.inner_text()


def test_a_long_solution_is_cancelled(site, page):
    tab(page, 'Problem')
    page.get_by_label('problem (YAML)').fill((PROBLEMS / 'shuttle_reentry.yaml').read_text())
    page.get_by_role('button', name='Solve').click()
    cancel = page.get_by_role('button', name='Cancel')
    page.wait_for_function('() => [...document.querySelectorAll(".obc-message")].some('
                           'each => each.offsetParent && each.innerText)')
    cancel.click()
    page.get_by_text('cancelled').first.wait_for()


def test_a_recording_waits_plays_and_is_scrubbed(site, tmp_path):
    file = tmp_path / 'a.mcap'
    record(file, [[0.5 + 0.01 * k, *[0.0] * 5] for k in range(60)], others=[
        (second, '/lqr_node/design', design_of('aircraft', [1.0 + second] * 6, [1.0] * 2))
        for second in (0, 30)])
    page = site.open(serve(site.spawner, tmp_path, site.domain, str(file)))
    play, slider = page.get_by_role('button', name='Play'), page.get_by_label('time [s]')
    for _ in range(2):   # a second page does not begin it either
        play.wait_for()
        page.wait_for_timeout(500)
        assert slider.get_attribute('aria-valuenow') == '0'
        assert 'px 0.50 m' in page.locator('.obc-plane').get_attribute('aria-label')
        page.reload()
    play.click()
    page.wait_for_function(LATER, arg=0)
    page.get_by_role('button', name='Pause').click()
    play.wait_for()
    held = slider.get_attribute('aria-valuenow')
    page.wait_for_timeout(500)
    assert slider.get_attribute('aria-valuenow') == held
    slider.locator('[tabindex="0"]').focus()
    page.keyboard.press('PageUp')
    page.wait_for_function(LATER, arg=float(held) + 1)
    page.get_by_role('button', name='30.0 s weights').click()
    page.wait_for_function(LATER, arg=29.9)
    assert float(slider.get_attribute('aria-valuenow')) == pytest.approx(30.0, abs=0.1)
    page.evaluate(PUSH_STATE, [50.0, *[0.0] * 5])
    page.wait_for_function(IN_SIGHT, arg=50.0)   # though no other frame comes
    page.context.close()


def test_hostile_text_stays_text(site, page):
    publisher = site.probe.node.create_publisher(Log, '/rosout', LATCHED)
    tab(page, 'Log')
    publisher.publish(Log(name=HOSTILE, msg=HOSTILE, level=30))
    page.get_by_text('onerror').first.wait_for()
    assert page.locator('img[src="x"]').count() == 0
    assert page.evaluate('window.pwned') is None
    page.get_by_text('{{ 7*7 }}').first.wait_for()   # not 49: nothing was evaluated
    site.probe.node.destroy_publisher(publisher)


def test_the_page_fits_a_telephone_and_reads_without_colour(site):
    page = site.open_loop(viewport={'width': 360, 'height': 740}, color_scheme='dark')
    for name in ('Weights', 'Set point', 'Plan', 'Plant', 'Problem', 'Log'):
        tab(page, name)
        page.wait_for_timeout(200)
        assert page.evaluate('document.documentElement.scrollWidth') <= 360, name
    page.context.close()


def test_the_keyboard_is_enough(site, page):
    slider = page.get_by_label('weight of py', exact=True).locator('[tabindex="0"]')
    before = float(number(page, 'weight of py').input_value())
    slider.focus()
    for _ in range(20):
        page.keyboard.press('ArrowRight')
    page.wait_for_function(TYPED, arg=['weight of py, as a number', before])
    for _ in range(40):
        page.keyboard.press('Tab')
        if page.evaluate('document.activeElement.innerText') in ('APPLY', 'Apply'):
            break
    revision = site.designs[-1].revision
    page.keyboard.press('Enter')
    site.probe.wait_for(lambda: site.designs[-1].revision > revision)


def test_a_page_without_control_is_read_only_except_for_stop(site, page):
    address = serve(site.spawner, site.folder, site.domain, '--namespace', '/')
    watching = site.open(address)
    number(watching, 'weight of px').wait_for()
    watching.get_by_role('button', name='read only').wait_for()
    for name in ('Apply', 'Start'):
        assert watching.get_by_role('button', name=name).is_disabled()
    press_keys(watching, watching.locator('body'), ' ')
    for each in (page, watching):
        each.locator('.obc-stopped').wait_for()
    watching.context.close()
    start(page)
