# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The network of benchmarks/hosts.py: a hub between TAP devices that can lose and delay frames.

``python _wire.py SEED TAP...`` opens the devices, prints ``ready`` and passes each frame on to all
others. A line of JSON on stdin, ``{"loss": 0.05, "delay": 0.02, "jitter": 0.005, "cut": false}``,
sets its properties; the reply has the counts since the previous line. netem would do the same, but
few kernels of small machines have it.
"""

import fcntl
import heapq
import json
import os
import random
import select
import struct
import sys
import time

TUNSETIFF, IFF_TAP, IFF_NO_PI = 0x400454CA, 0x0002, 0x1000
LONGEST = 65536  # [bytes] largest frame


def tap(name: str) -> int:
    """Return the descriptor of a TAP device."""
    descriptor = os.open('/dev/net/tun', os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(descriptor, TUNSETIFF, struct.pack('16sH', name.encode(), IFF_TAP | IFF_NO_PI))
    return descriptor


def is_udp(frame: bytes) -> bool:
    """Return whether a frame carries UDP over IPv4."""
    return frame[12:14] == b'\x08\x00' and frame[23:24] == b'\x11'


class Hub:
    """Frames in transit."""

    def __init__(self, names: list[str], seed: int) -> None:
        self._taps = [tap(name) for name in names]
        self._random = random.Random(seed)
        self._flying: list[tuple[float, int, int, bytes]] = []
        self._number = 0
        self._how = {'loss': 0.0, 'delay': 0.0, 'jitter': 0.0, 'cut': False}
        self._begin()

    def _begin(self) -> None:
        self.counts = dict.fromkeys(('udp', 'lost', 'bytes'), 0)

    def run(self) -> None:
        """Pass frames on until stdin ends."""
        poll = select.poll()
        for descriptor in (0, *self._taps):
            poll.register(descriptor, select.POLLIN)
        while True:
            wait = self._flying[0][0] - time.monotonic() if self._flying else 1.0
            for descriptor, _ in poll.poll(max(0.0, 1e3 * wait)):
                if descriptor:
                    self._take(descriptor)
                elif not self._obey():
                    return
            self._deliver()

    def _obey(self) -> bool:
        line = os.read(0, 4096)
        if line:
            self._how.update(json.loads(line))
            print(json.dumps(self.counts), flush=True)
            self._begin()
        return bool(line)

    def _take(self, source: int) -> None:
        now, how, draw = time.monotonic(), self._how, self._random
        try:
            while True:
                frame = os.read(source, LONGEST)
                udp = is_udp(frame)
                self.counts['udp'] += udp
                self.counts['bytes'] += len(frame)
                for target in self._taps:
                    if target == source:
                        continue
                    if how['cut'] or draw.random() < how['loss']:
                        self.counts['lost'] += udp
                        continue
                    delay = how['delay'] + how['jitter'] * draw.uniform(-1.0, 1.0)
                    self._number += 1
                    heapq.heappush(self._flying, (now + delay, self._number, target, frame))
        except BlockingIOError:
            return

    def _deliver(self) -> None:
        now = time.monotonic()
        while self._flying and self._flying[0][0] <= now:
            _, _, target, frame = heapq.heappop(self._flying)
            try:
                os.write(target, frame)
            except OSError:  # the device is down or full: the frame is lost
                self.counts['lost'] += is_udp(frame)


def main() -> None:
    """Be a hub."""
    seed, *names = sys.argv[1:]
    hub = Hub(names, int(seed))
    print('ready', flush=True)
    hub.run()


if __name__ == '__main__':
    main()
