# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Child processes on a DDS domain of their own.

Nodes that a command starts exchange no data with other robots: discovery is limited to this
machine, and the domain is unused. Children end with the command, however it ends.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
import ctypes
import fcntl
import os
from pathlib import Path
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from types import TracebackType

from obc_ros.cli.terminal import EndSignals
from obc_ros.core.text.errors import ObcError
from obc_ros.ros.middleware import choose_profile

PR_SET_PDEATHSIG = 1
DOMAINS = range(1, 102)  # the ports of higher domains are in Linux's ephemeral range
APPEARS = 60.0  # [s] in which a node appears even on a loaded machine; its death ends the wait
# One thread is faster than two for the small matrices of a node.
ONE_THREAD = dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')
SHARED_MEMORY = Path('/dev/shm')
# Fast DDS gives these to the nodes of all domains, for data of the ROS graph.
COMMON_PORTS = range(7000, 7400)
OLD = 5.0  # [s] an unlocked common port that is older is not being opened any more
PORT_FILE = re.compile(r'(sem\.)?(?P<port>fast(rtps|dds)_port(?P<number>\d+))(_el|_sl|_mutex)?')
_LIBC = ctypes.CDLL(None, use_errno=True)


class ProcessDiedError(ObcError):
    """A child ended by itself; the message has its name, exit status and last output."""


@contextmanager
def reserve_domain() -> Iterator[int]:
    """Reserve and yield a DDS domain id that no process of this machine uses."""
    for domain in DOMAINS:
        path = Path(tempfile.gettempdir()) / f'ros_domain_{domain}.lock'
        try:
            lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        except PermissionError:  # another user's
            continue
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(lock)
            continue
        try:
            if not is_domain_used(domain, 4):
                _clear(domain)
                yield domain
                return
        finally:
            os.close(lock)
    raise ObcError('every DDS domain from 1 to 101 is in use on this machine')


def is_domain_used(domain: int, participants: int) -> bool:
    """Return whether a process of this machine is one of the first participants of a domain."""
    for participant in range(participants):
        with socket.socket(type=socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(('', _port(domain) + 10 + 2 * participant))
            except (OSError, OverflowError):  # the port is in use, or there is no such port
                return True
    return False


def _port(domain: int) -> int:
    return 7400 + 250 * domain


def _clear(domain: int) -> None:
    """
    Remove the shared memory that killed processes have left for the ports of a domain.

    Fast DDS uses it again when it opens the same port: see docs/development/reliability.md.
    """
    own = range(_port(domain), _port(domain + 1))
    ports: dict[tuple[str, bool], list[Path]] = {}
    for file in SHARED_MEMORY.glob('*fast*_port*'):
        found = PORT_FILE.fullmatch(file.name)
        if found and any(int(found['number']) in some for some in (own, COMMON_PORTS)):
            ports.setdefault((found['port'], int(found['number']) in own), []).append(file)
    for (_, is_own), files in ports.items():
        if not any(map(_is_held, files)) and (is_own or all(map(_is_old, files))):
            for file in files:
                with suppress(OSError):  # another user's
                    file.unlink()


def _is_old(file: Path) -> bool:
    """Return whether a file is older than `OLD` seconds, or no longer exists."""
    with suppress(FileNotFoundError):
        return time.time() - file.stat().st_mtime > OLD
    return True


def _is_held(file: Path) -> bool:
    """Return whether a live process has locked a file; locks of dead processes are released."""
    try:
        with file.open('rb') as opened:
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return True
    return False


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Create a folder for results; ObcError if another command writes it, else lock it."""
    folder.mkdir(parents=True, exist_ok=True)
    lock = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ObcError(f'{folder} is being written by another command; '
                           'give another folder with --out') from error
        except OSError:
            pass  # a file system without locks
        yield
    finally:
        os.close(lock)


def isolate(domain: int) -> None:
    """Restrict this process and its children to one DDS domain and to this machine."""
    os.environ.update(ONE_THREAD)
    find_log_folder()
    os.environ['ROS_DOMAIN_ID'] = str(domain)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    for name in ('ROS_STATIC_PEERS', 'ROS_LOCALHOST_ONLY', 'ROS_DISCOVERY_SERVER'):
        os.environ.pop(name, None)
    choose_profile()


def find_log_folder() -> None:
    """Have ROS 2 log to a temporary folder if the home folder cannot be written: it must log."""
    if any(map(os.environ.get, ('ROS_LOG_DIR', 'ROS_HOME'))):
        return
    folder = Path(os.environ.get('HOME') or os.devnull, '.ros', 'log')
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return
    os.environ['ROS_LOG_DIR'] = tempfile.gettempdir()


def die_with_parent() -> None:
    """Have a child end with its parent, however that ends; called between fork and exec."""
    _LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


class Children:
    """
    Node processes that end together.

    A context manager: on exit every child gets SIGINT, and SIGKILL if it has not ended two seconds
    later. Each child has a log file for its output. A signal to end reaches all nested instances.
    """

    def __init__(self, log_dir: Path) -> None:
        self._log_dir = log_dir
        self._signals = EndSignals()
        self._children: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> 'Children':
        self._log_dir.mkdir(parents=True, exist_ok=True)
        self._signals.__enter__()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        for child in self._children.values():
            if child.poll() is None:
                child.send_signal(signal.SIGINT)
        deadline = time.monotonic() + 2.0
        for child in self._children.values():
            try:
                child.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
        self._signals.__exit__(kind, error, trace)

    def start(self, node: str, *arguments: str) -> None:
        """Start one of this package's nodes with its ROS arguments."""
        log = self.log(node)
        with log.open('wb') as output:
            self._children[node] = subprocess.Popen(
                [sys.executable, '-P', '-m', f'obc_ros.nodes.{node}', '--ros-args', *arguments],
                stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
                # a session of its own: Ctrl-C reaches this command, which ends the children
                start_new_session=True, preexec_fn=die_with_parent)

    def log(self, node: str) -> Path:
        """Return the log file of a child."""
        return self._log_dir / f'{node}.log'

    def check(self) -> None:
        """Raise ProcessDiedError if a child has ended, InterruptedByUserError after a signal."""
        self._signals.check()
        for node, child in self._children.items():
            code = child.poll()
            if code is not None:
                raise ProcessDiedError(f'{node} {_how(code)}{_last_words(self.log(node))}')

    def pids(self) -> dict[str, int]:
        """Return the process id of each child."""
        return {node: child.pid for node, child in self._children.items()}


def _how(code: int) -> str:
    if code < 0:
        return f'was ended by {signal.Signals(-code).name}'
    return f'ended with exit status {code}'


def _last_words(log: Path, lines: int = 5) -> str:
    words: Sequence[str] = log.read_text(errors='replace').splitlines()[-lines:]
    return ': ' + ' | '.join(words) if words else ''
