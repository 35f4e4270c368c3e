# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Child processes on a DDS domain of their own.

A command that runs nodes neither disturbs nor hears a robot next door: discovery stays on this
machine and the domain is one that nobody uses. Children die with the command, however it ends.
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
from types import FrameType, TracebackType
from typing import ClassVar

from obc_ros.core.text.errors import ObcError
from obc_ros.ros.middleware import choose_profile

PR_SET_PDEATHSIG = 1
DOMAINS = range(1, 102)  # the ports of higher domains reach into Linux's ephemeral range
# In a node one thread is faster than two: its matrices are small.
ONE_THREAD = dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')
SHARED_MEMORY = Path('/dev/shm')
# Fast DDS gives these to nodes of all domains, for what ROS 2 tells of the graph.
COMMON_PORTS = range(7000, 7400)
OLD = 5.0  # [s] since when a common port that nobody holds is no longer just being opened
PORT_FILE = re.compile(r'(sem\.)?(?P<port>fast(rtps|dds)_port(?P<number>\d+))(_el|_sl|_mutex)?')
_LIBC = ctypes.CDLL(None, use_errno=True)


class ProcessDiedError(ObcError):
    """A child ended by itself; the message says which, how, and its last words."""


class InterruptedByUserError(ObcError):
    """The user or the system asked the command to end."""


@contextmanager
def reserve_domain() -> Iterator[int]:
    """Yield a DDS domain id that nobody on this machine uses, and keep it ours meanwhile."""
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
            if _is_silent(domain):
                _clear(domain)
                yield domain
                return
        finally:
            os.close(lock)
    raise ObcError('every DDS domain from 1 to 101 is in use on this machine')


def _is_silent(domain: int) -> bool:
    """Return whether the unicast ports of the first participants of a domain are free."""
    for participant in range(4):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(('', _port(domain) + 10 + 2 * participant))
            except OSError:
                return False
    return True


def _port(domain: int) -> int:
    """Return the first port of a domain."""
    return 7400 + 250 * domain


def _clear(domain: int) -> None:
    """
    Remove the shared memory of a domain's ports where a process that was killed has left it.

    Fast DDS finds it when it opens the same port again. It waits a second for listeners that are
    dead, 20 s for a lock that one of them held, and may crash on what is in it.
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
    """Return whether a file was there some seconds ago already, or is there no more."""
    with suppress(FileNotFoundError):
        return time.time() - file.stat().st_mtime > OLD
    return True


def _is_held(file: Path) -> bool:
    """Return whether a process that lives has locked a file: the kernel frees those of others."""
    try:
        with file.open('rb') as opened:
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return True
    return False


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """
    Make a folder for answers, and keep other commands from writing theirs there meanwhile.

    Raises
    ------
    ObcError
        If another one does.
    OSError
        If it cannot be made.

    """
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
    """Keep this process and its children on one domain of this machine."""
    os.environ.update(ONE_THREAD)
    find_log_folder()
    os.environ['ROS_DOMAIN_ID'] = str(domain)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    for name in ('ROS_STATIC_PEERS', 'ROS_LOCALHOST_ONLY', 'ROS_DISCOVERY_SERVER'):
        os.environ.pop(name, None)
    choose_profile()


def find_log_folder() -> None:
    """Have ROS 2 log to a temporary folder where there is no home to write to: it must log."""
    if any(map(os.environ.get, ('ROS_LOG_DIR', 'ROS_HOME'))):
        return
    folder = Path(os.environ.get('HOME') or os.devnull, '.ros', 'log')
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return
    os.environ['ROS_LOG_DIR'] = tempfile.gettempdir()


def die_with_parent() -> None:
    """Have a child end when its parent is killed, even by SIGKILL: between fork and exec."""
    _LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


class Children:
    """
    Node processes that end together.

    Used as a context manager; on leaving, every child gets SIGINT, and SIGKILL if it has not
    ended two seconds later. What they print goes to one log file each. A signal to end is told to
    all that are open, within one another as they are.
    """

    _open: ClassVar[int] = 0
    _stop_signal: ClassVar[int] = 0

    def __init__(self, log_dir: Path) -> None:
        self._log_dir = log_dir
        self._children: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> 'Children':
        self._log_dir.mkdir(parents=True, exist_ok=True)
        if not Children._open:
            Children._stop_signal = 0
        Children._open += 1
        self._previous = {
            number: signal.signal(number, self._on_signal)
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
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
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        Children._open -= 1

    @staticmethod
    def _on_signal(number: int, frame: FrameType | None) -> None:
        Children._stop_signal = number  # seen by check(): nothing is torn down inside a handler

    def start(self, node: str, *arguments: str) -> None:
        """Start one of this package's nodes with its ROS arguments."""
        log = self.log(node)
        with log.open('wb') as output:
            self._children[node] = subprocess.Popen(
                [sys.executable, '-m', f'obc_ros.nodes.{node}', '--ros-args', *arguments],
                stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
                # a session of its own: Ctrl-C reaches this command, which ends the children
                start_new_session=True,
                preexec_fn=die_with_parent)

    def log(self, node: str) -> Path:
        """Return where a child's output is written."""
        return self._log_dir / f'{node}.log'

    def check(self) -> None:
        """
        Raise if a child has ended or if this command was asked to end.

        Raises
        ------
        ProcessDiedError, InterruptedByUserError

        """
        if self._stop_signal:
            raise InterruptedByUserError(f'ended by {signal.Signals(self._stop_signal).name}')
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
