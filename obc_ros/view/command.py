# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`obc view`: a live page of a loop, a robot or a recording, in a browser."""

import argparse
from collections.abc import Iterator
from contextlib import closing, contextmanager, ExitStack
import gc
from importlib import util
from pathlib import Path
import socket
import threading
from typing import Any

from obc_ros.cli.processes import Children, find_log_folder, isolate, reserve_domain
from obc_ros.cli.ros_graph import keep_to_this_machine
from obc_ros.cli.share_folders import share_directory
from obc_ros.cli.terminal import EndSignals, InterruptedByUserError, Parser
from obc_ros.core.text.errors import ObcError
from obc_ros.ros.middleware import choose_profile
from obc_ros.workers.processes.real_time import find_priority_refusal

LOCAL = ('127.0.0.1', 'localhost', '::1')
SCENARIOS = ('aircraft', 'vehicle', 'vehicle_lateral')
WATCH = 0.2  # [s] between two looks at the nodes
LOOP_PRIORITY = 50  # of plant_simulator and lqr_node, unless it is given
HIGHEST = 99   # priority that Linux has
PATIENCE = 3  # [s] that open connections have to end
OUTAGE = 10.0  # [s] for which a page outlives its connection; then it loads anew


def add_arguments(parser: Parser) -> None:
    """Add the arguments of `obc view`."""
    parser.add_argument('recording', nargs='?', type=Path, metavar='FILE',
                        help='show a recording (FILE.mcap) instead of a loop')
    parser.add_argument('--scenario', choices=SCENARIOS, default='aircraft',
                        help='loop to start, if there is none to show (default: aircraft)')
    parser.add_argument('--namespace', metavar='NS',
                        help='show the loop in this namespace, running or recorded; / for none')
    parser.add_argument('--priority', type=_priority, metavar='N',
                        help='real-time priority of plant_simulator and lqr_node of the loop that '
                        'is started: a browser on the same processors then does not delay them; '
                        f'0: ordinary (default: {LOOP_PRIORITY} where the system allows it)')
    parser.add_argument('--control', action='store_true',
                        help='let the page control a loop that obc view has not started')
    parser.add_argument('--host', default='127.0.0.1', metavar='ADDRESS',
                        help='address to serve the page at (default: 127.0.0.1); another than '
                        'that of this machine asks for a token')
    parser.add_argument('--port', type=int, default=8080, metavar='N', help='default: 8080')
    parser.add_argument('--no-browser', action='store_true', help='open no browser')
    parser.limit('--scenario', '--priority', without=['FILE', '--namespace'])
    parser.limit('--control', needs=['--namespace'], without=['FILE'])


def _priority(text: str) -> int:
    if not text.isdecimal() or int(text) > HIGHEST:
        raise argparse.ArgumentTypeError(f'{text}: give a whole number from 0 to {HIGHEST}')
    return int(text)


def run(args: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C."""
    if util.find_spec('nicegui') is None:
        raise ObcError("the page needs NiceGUI: pip install 'obc-ros[web]'")
    check_port(args.host, args.port)
    with ExitStack() as stack:
        source, title, controls = open_source(args, stack)
        serve(source, title, controls, args)
    return 0


def check_port(host: str, port: int) -> None:
    """Raise ObcError if the address is not one of this machine, or the port is in use."""
    family = socket.AF_INET6 if ':' in host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except (OSError, OverflowError) as error:
            raise ObcError(f'the page cannot be served at {host}:{port}: {error}; '
                           'choose another with --port') from error


def format_address(host: str, port: int) -> str:
    """Return the address of the page; one of IPv6 has brackets."""
    return f'http://[{host}]:{port}/' if ':' in host else f'http://{host}:{port}/'


def open_source(args: argparse.Namespace, stack: ExitStack) -> tuple[Any, str, bool]:
    """Return what is shown, the title, and whether pages may control it."""
    from obc_ros.view.loop_client import LoopClient
    from obc_ros.view.playback import Playback
    if args.recording is not None:
        return Playback(args.recording, args.namespace), f'recording {args.recording.name}', False
    if args.namespace is not None:
        keep_to_this_machine()
        find_log_folder()
        choose_profile()
        namespace = args.namespace.strip('/')
        client = stack.enter_context(closing(LoopClient(namespace)))
        return client, f'loop in /{namespace}', args.control
    stack.enter_context(start_loop_nodes(args.scenario, choose_priority(args.priority)))
    return stack.enter_context(closing(LoopClient())), args.scenario, True


def choose_priority(wanted: int | None) -> int:
    """Return the priority of the nodes; by default `LOOP_PRIORITY`, 0 if the system refuses it."""
    priority = LOOP_PRIORITY if wanted is None else wanted
    refusal = find_priority_refusal(priority) if priority else ''
    if not refusal:
        return priority
    if wanted is not None:
        raise ObcError(f'--{refusal.replace(" = ", " ", 1)}')
    print(f'obc view: {refusal}; a browser on this machine may delay the loop', flush=True)
    return 0


@contextmanager
def start_loop_nodes(scenario: str, priority: int) -> Iterator[None]:
    """Start three nodes, two with a real-time priority, on a domain; they end with the page."""
    pace = ['-p', f'priority:={priority}']
    config = ['--params-file', str(share_directory('obc_ros') / 'config' / f'{scenario}.yaml')]
    with reserve_domain() as domain:
        isolate(domain)
        with Children(Path('out') / 'log') as children:
            children.start('plant_simulator', *config, *pace, '-p', 'speed:=1.0', '-p',
                           'lockstep:=false')
            children.start('lqr_node', *config, *pace, '-p', 'use_sim_time:=true')
            children.start('trajectory_server', *config)
            ended = threading.Event()
            watch = threading.Thread(target=_watch, args=(children, ended), daemon=True)
            watch.start()
            print(f'{scenario}: three nodes, ROS_DOMAIN_ID={domain}, this machine only; '
                  + (f'plant_simulator and lqr_node with real-time priority {priority}'
                     if priority else 'ordinary priority'), flush=True)
            try:
                yield
            finally:
                ended.set()
                watch.join()


def _watch(children: Children, ended: threading.Event) -> None:
    """Say when a node ends."""
    while not ended.wait(WATCH):
        try:
            children.check()
        except InterruptedByUserError:
            return
        except ObcError as error:
            print(f'obc view: {error}', flush=True)
            return


def serve(source: Any, title: str, controls: bool, args: argparse.Namespace) -> None:
    """Serve the pages until the process is asked to end."""
    from nicegui import app, ui
    from obc_ros.view.access import Gate, HeaderDeadline, Helm, make_token
    from obc_ros.view.page import Viewer
    from uvicorn.protocols.http.auto import AutoHTTPProtocol

    # uvicorn chooses the class when it is imported.
    class Protocol(HeaderDeadline, AutoHTTPProtocol):  # type: ignore[misc, valid-type]
        """HTTP in which a header has to arrive in time."""

    def heed_signals() -> None:
        """End at once after a signal that came before the server has taken the signals over."""
        try:
            EndSignals.check()
        except InterruptedByUserError:
            app.shutdown()

    token = '' if args.host in LOCAL else make_token()
    viewer = Viewer(source, Helm(controls), title)
    ui.page('/', title=f'obc view: {title}')(viewer.build)
    app.add_middleware(Gate, token=token)
    app.on_startup(heed_signals)
    address = format_address(args.host, args.port) + (f'?token={token}' if token else '')
    print(f'obc view: {address}   (Ctrl-C ends it)', flush=True)
    gc.collect()
    gc.freeze()   # a later collection skips the objects of the start, and is shorter
    ui.run(host=args.host, port=args.port, title='obc view', reload=False,
           show=address if not args.no_browser else False, show_welcome_message=False,
           reconnect_timeout=OUTAGE, http=Protocol,
           favicon='\u2708', fastapi_docs=False, uvicorn_logging_level='warning',
           timeout_graceful_shutdown=PATIENCE)
