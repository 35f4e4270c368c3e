# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Hosts as network namespaces of this machine, connected by veth and a bridge or by `_wire`.

They are within namespaces of the script (network, mounts, processes) that `enter` creates. After
any failure the kernel removes them with the last process.
"""

from collections.abc import Sequence
import ctypes
import json
import os
from pathlib import Path
import subprocess
import sys
from typing import Any

INSIDE = 'OBC_ROS_HOSTS'  # set in the environment of the script that runs in the namespaces
CLONE_NEWNET = 0x40000000
_LIBC = ctypes.CDLL(None, use_errno=True)


def enter() -> str:
    """
    Run this script again in new namespaces, and exit with its status.

    Returns
    -------
    str
        Empty in the second run; else the reason why namespaces are not available here.

    """
    if os.environ.get(INSIDE):
        run('mount', '-t', 'tmpfs', 'none', '/run')
        run('ip', 'link', 'set', 'lo', 'up')
        return ''
    unshare = ['unshare', '--net', '--mount', '--pid', '--fork', '--kill-child', '--mount-proc',
               *(['--map-root-user'] if os.geteuid() else [])]
    script = 'mount -t tmpfs none /run && mkdir /run/netns && ip netns add x && ip netns del x'
    try:
        tried = subprocess.run([*unshare, 'sh', '-c', script], capture_output=True, text=True,
                               timeout=20.0)
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    if tried.returncode:
        return f'no namespaces here: {" ".join(tried.stderr.split())[:200]}'
    child = subprocess.run([*unshare, sys.executable, *sys.argv],
                           env={**os.environ, INSIDE: '1'})
    raise SystemExit(child.returncode)


def udp_only() -> None:
    """Have processes in the namespaces use UDP only, and discover each other by multicast."""
    run('ip', 'link', 'set', 'lo', 'multicast', 'on')
    run('ip', 'route', 'add', '224.0.0.0/4', 'dev', 'lo')
    os.environ.update(ROS_AUTOMATIC_DISCOVERY_RANGE='SUBNET', FASTDDS_BUILTIN_TRANSPORTS='UDPv4')


def run(*words: str) -> str:
    """Run a command and return its output; exit with its error if it fails."""
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f'{" ".join(words)}: {done.stderr.strip()}')
    return done.stdout


class Network:
    """
    Hosts 10.0.0.1, 10.0.0.2, ... on one subnet.

    Parameters
    ----------
    count : int
        Number of hosts.
    wire : bool
        Whether `_wire`, which can lose and delay frames, connects them; else veth and a bridge.
    seed : int
        Seed of the losses.

    """

    def __init__(self, count: int, wire: bool, seed: int = 1) -> None:
        self.hosts = [f'host{k}' for k in range(1, count + 1)]
        self._wire: subprocess.Popen[str] | None = None
        self._outside = os.open('/proc/self/ns/net', os.O_RDONLY)
        Path('/run/netns').mkdir(exist_ok=True)
        for host in self.hosts:
            run('ip', 'netns', 'add', host)
        devices = self._taps(seed) if wire else self._veths()
        for k, (host, device) in enumerate(zip(self.hosts, devices, strict=True), start=1):
            run('ip', 'link', 'set', device, 'netns', host)
            inside = ('ip', '-n', host)
            run('ip', 'netns', 'exec', host, 'sysctl', '-qw', 'net.ipv6.conf.all.disable_ipv6=1')
            run(*inside, 'link', 'set', 'lo', 'up')
            run(*inside, 'address', 'add', f'10.0.0.{k}/24', 'dev', device)
            run(*inside, 'link', 'set', device, 'up')
            run(*inside, 'route', 'add', '224.0.0.0/4', 'dev', device)

    def _taps(self, seed: int) -> list[str]:
        devices = [f'tap{k}' for k in range(1, len(self.hosts) + 1)]
        for device in devices:
            run('ip', 'tuntap', 'add', 'mode', 'tap', device)
        self._wire = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name('_wire.py')), str(seed), *devices],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._wire.stdout
        if self._wire.stdout.readline() != 'ready\n':
            raise SystemExit('the network does not start')
        return devices

    def _veths(self) -> list[str]:
        run('ip', 'link', 'add', 'bridge', 'type', 'bridge', 'mcast_snooping', '0')
        run('ip', 'link', 'set', 'bridge', 'up')
        devices = []
        for k in range(1, len(self.hosts) + 1):
            run('ip', 'link', 'add', f'port{k}', 'type', 'veth', 'peer', 'name', f'veth{k}')
            run('ip', 'link', 'set', f'port{k}', 'master', 'bridge', 'up')
            devices.append(f'veth{k}')
        return devices

    def set(self, **how: Any) -> dict[str, int]:
        """Set losses, delays or a cut; return the counts since the last call."""
        assert self._wire and self._wire.stdin and self._wire.stdout
        self._wire.stdin.write(json.dumps(how) + '\n')
        self._wire.stdin.flush()
        counts: dict[str, int] = json.loads(self._wire.stdout.readline())
        return counts

    def start(self, host: str, command: Sequence[str], **environment: str
              ) -> 'subprocess.Popen[bytes]':
        """Start a process on a host; its output is discarded."""
        return subprocess.Popen(
            ['ip', 'netns', 'exec', host, *command], stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            env={**os.environ, **environment})

    def enter(self, host: str) -> None:
        """Move this thread, and what it starts, to a host, until `close`."""
        descriptor = os.open(f'/run/netns/{host}', os.O_RDONLY)
        move_to(descriptor)
        os.close(descriptor)

    def close(self) -> None:
        """Leave the hosts and remove them; their processes must have ended."""
        move_to(self._outside)
        os.close(self._outside)
        if self._wire:
            self._wire.terminate()
            self._wire.wait()
        else:
            for device in ('bridge', *(f'port{k}' for k in range(1, len(self.hosts) + 1))):
                run('ip', 'link', 'del', device)
        for host in self.hosts:
            run('ip', 'netns', 'del', host)


def move_to(namespace: int) -> None:
    """Move this thread, and what it starts, to the network namespace of a descriptor."""
    if _LIBC.setns(namespace, CLONE_NEWNET):
        raise OSError(ctypes.get_errno(), 'setns')
