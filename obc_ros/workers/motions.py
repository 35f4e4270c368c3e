# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Requests to plan a motion: the motion that is asked for."""

from obc_ros.core.solver.motion_planning import build_plant, find_registered, Motion
from obc_ros.core.text.errors import quote, StatementError
from obc_ros.workers.wire import Packet


def read_motion(request: Packet) -> Motion:
    """
    Return the motion of a request.

    :param request: as `messages.read_request` returns it. Optional are ``plant``, the keys of a
        plant that is not registered, and ``start_names``, the names of the states of the start.
    :raises ObcError: if there is no such plant, a parameter is not valid, or the start is that of
        another plant.
    """
    plain, arrays = request.plain, request.arrays
    system = build_plant(plain['plant'], plain['parameters']) if 'plant' in plain else (
        find_registered(plain['system'], plain['parameters']))
    if (names := plain.get('start_names')) and tuple(names) != system.state_names:
        raise StatementError(f'start: the state of the plant has {quote(", ".join(names), 200)}; '
                             f'wanted {", ".join(system.state_names)}')
    return Motion(
        system=system, start=arrays['start'], goal=arrays['goal'], objective=plain['objective'],
        Qx=arrays['qx'], Qu=arrays['qu'], final_time=plain['final_time'],
        input_bounds=plain['input_bounds'], state_bounds=plain['state_bounds'],
        path_constraints=plain['path_constraints'])
