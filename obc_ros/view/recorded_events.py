# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The events of a recording: changes of the design, references, resets, modes, warnings."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from obc_ros.msg import LqrDesign, State, Trajectory
from obc_ros.view.telemetry import read_mode
from rcl_interfaces.msg import Log

MOST = 50      # events
LONGEST = 80   # characters of an event
WARN = 30      # level of a line of the log


class RecordedEvent(NamedTuple):
    """What happened at a time [s] from the first state on."""

    time: float
    words: str


def list_events(times: Mapping[str, Sequence[float]], rows: Mapping[str, Sequence[Any]]
                ) -> list[RecordedEvent]:
    """
    Return the first events of a recording, in order; the last one says how many were left out.

    :param times: log times [s] of the messages by 'state', 'design', 'reference', 'diagnostics'
        and 'rosout'; the first state is time 0.
    :param rows: the messages, in the same order.
    """
    begin, end = times['state'][0], times['state'][-1]
    found = [RecordedEvent(moment - begin, words[:LONGEST]) for name, describe in (
        ('design', _describe_designs), ('reference', _describe_references),
        ('state', _describe_resets), ('diagnostics', _describe_modes),
        ('rosout', _describe_warnings)) for moment, words in zip(
            times[name], describe(rows[name]), strict=True) if words and begin <= moment <= end]
    found.sort()
    if len(found) > MOST:
        found[MOST:] = [RecordedEvent(found[MOST].time,
                                      f'{len(found) - MOST} more events from here on, not listed')]
    return found


def _describe_designs(designs: Sequence[LqrDesign]) -> Iterator[str]:
    for before, after in pairwise([None, *designs]):
        changed = [] if before is None else [words for words, fields in (
            ('set point', ('xe', 'ue')), ('weights', ('qx', 'qu')), ('gain', ('k',)))
            if not all(np.array_equal(getattr(before, field), getattr(after, field),
                                      equal_nan=True) for field in fields)]
        # Another gain follows from other weights.
        yield ', '.join(changed[:-1] if changed[1:] and changed[-1] == 'gain' else changed)


def _describe_references(paths: Sequence[Trajectory]) -> Iterator[str]:
    yield from ('reference' if len(each.t) else 'end of the reference' for each in paths)


def _describe_resets(states: Sequence[State]) -> Iterator[str]:
    last = states[0].restarts
    for each in states:
        yield 'reset' if each.restarts != last else ''
        last = each.restarts


def _describe_modes(arrays: Sequence[DiagnosticArray]) -> Iterator[str]:
    modes: dict[str, str] = {}
    for array in arrays:
        words = []
        for status in array.status:
            if status.name.endswith(': commands'):
                mode = read_mode(status)
                if modes.get(status.name, mode.name) != mode.name:
                    words.append(mode.sentence)
                modes[status.name] = mode.name
        yield ', '.join(words)


def _describe_warnings(lines: Sequence[Log]) -> Iterator[str]:
    last = ''
    for each in lines:
        words = f'{each.name}: {each.msg}' if each.level >= WARN else ''
        yield words if words != last else ''
        last = words or last
