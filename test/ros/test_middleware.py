# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The Fast DDS profile of the nodes; a profile of the user takes precedence."""

from ipaddress import IPv4Address, IPv6Address
import os
from pathlib import Path
import re
from typing import Any

from obc_ros.ros.middleware import FILES, find_profile, LOOPBACK, PROFILE, RANGE, WISHES
import pytest
import support

READY = {'lqr_node': 'revision 1', 'plant_simulator': 'aircraft', 'trajectory_server': 'ready'}


def test_the_profile_is_used_without_a_profile_of_the_user(tmp_path: Path) -> None:
    """The installed Fast DDS gets one environment variable, the path of an existing file."""
    (name, value), = find_profile({'HOME': '/'}, tmp_path).items()
    assert name in WISHES
    assert Path(value) == PROFILE
    assert PROFILE.is_file()


def test_on_this_machine_only_the_profile_decides_the_range(tmp_path: Path) -> None:
    """Static peers may be other machines: then the middleware decides."""
    here = {RANGE: 'LOCALHOST'}
    found = find_profile(here, tmp_path)
    assert str(LOOPBACK) in found.values()
    assert found[RANGE] == 'SYSTEM_DEFAULT'
    assert str(PROFILE) in find_profile({**here, 'ROS_STATIC_PEERS': 'robot'}, tmp_path).values()
    # A process that another one of ours has started decides again.
    assert find_profile(found, tmp_path) == found
    assert str(PROFILE) in find_profile({**found, RANGE: 'SUBNET'}, tmp_path).values()
    assert find_profile({**find_profile({}, tmp_path), **here}, tmp_path) == found


@pytest.mark.parametrize('wish', WISHES)
def test_a_profile_variable_of_the_user_comes_first(tmp_path: Path, wish: str) -> None:
    """An empty variable counts too: it selects the defaults of Fast DDS."""
    assert find_profile({wish: ''}, tmp_path) == {}


@pytest.mark.parametrize('file', FILES)
def test_a_profile_file_of_the_user_comes_first(tmp_path: Path, file: str) -> None:
    """Fast DDS reads the file from the working folder."""
    (tmp_path / file).touch()
    assert find_profile({}, tmp_path) == {}


@pytest.mark.parametrize('node', ['lqr_node', 'plant_simulator', 'trajectory_server'])
def test_on_this_machine_only_no_port_is_open_to_others(spawn: Any, node: str) -> None:
    """Neither of the node nor of its processes."""
    process = spawn(node)
    process.wait_for_output(READY[node])
    found = [address for pid in (process.pid, *support.children(process.pid))
             for address in list_addresses(pid)]
    assert found
    assert [address for address in found if not address.is_loopback] == []


def list_addresses(pid: int) -> list[IPv4Address | IPv6Address]:
    """Return the local addresses of the sockets of a process."""
    ours = {os.readlink(file) for file in Path(f'/proc/{pid}/fd').iterdir() if file.exists()
            or file.is_symlink()}
    found: list[IPv4Address | IPv6Address] = []
    for name in ('udp', 'tcp', 'udp6', 'tcp6'):
        for line in Path(f'/proc/{pid}/net/{name}').read_text().splitlines()[1:]:
            fields = line.split()
            if f'socket:[{fields[9]}]' in ours:
                words = bytes.fromhex(fields[1].partition(':')[0])
                # The words of an address are in the order of the processor.
                number = b''.join(words[k:k + 4][::-1] for k in range(0, len(words), 4))
                found.append(IPv6Address(number) if len(number) > 4 else IPv4Address(number))
    return found


def test_nodes_open_no_shared_memory_port(spawn: Any, domain: int) -> None:
    """A killed node would leave the shared-memory port of its domain behind."""
    spawn('lqr_node').wait_for_output('revision 1')
    first = 7400 + 250 * domain  # RTPS specification, 9.6.1.1
    ports = {int(found[1]) for file in Path('/dev/shm').glob('*fast*_port*')
             if (found := re.search(r'port(\d+)', file.name))}
    assert not ports & set(range(first, first + 250))
