# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The plants that trajectory_server reads from files; a request names one of them."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from obc_ros.core.text.errors import quote, StatementError

Plants = dict[str, dict[str, Any]]


@lru_cache(maxsize=2)   # judged and used
def load_plants(paths: Sequence[str]) -> Plants:
    """
    Return the plants of files by name.

    :param paths: YAML files.
    :return: what a worker builds each plant of, see `systems.file.load_plant`.
    :raises StatementError: if a file is malformed, or its plant has the name of another one.
    """
    if not paths:
        return {}
    from obc_ros.core.systems.file import load_plant  # CasADi: 0.3 s
    from obc_ros.core.systems.registry import list_systems
    owners = dict.fromkeys(list_systems(), 'a registered system')
    found: Plants = {}
    for path in paths:
        plant = load_plant(path)
        name = plant['name']
        if name in owners:
            raise StatementError(f"systems: {quote(path, 200)}: '{quote(name)}' is the name of "
                                 f'{owners[name]}; write another one in the key name')
        owners[name], found[name] = f'the plant of {quote(path, 200)}', plant
    return found
