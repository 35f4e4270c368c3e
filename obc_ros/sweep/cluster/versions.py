# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The version of obc_ros, which all workers of a cluster must have: answers depend on it."""

from collections.abc import Mapping
from importlib import metadata

from obc_ros.core.text.errors import ObcError, quote


def tell_version() -> str:
    """Return the version of obc_ros."""
    return metadata.version('obc-ros')


def check_versions(told: Mapping[str, object]) -> None:
    """
    Check that all workers have this version of obc_ros.

    :param told: address of each worker, and its version, or the exception that it raised.
    :raises ObcError: if one has another version, or none.
    """
    here = tell_version()
    for worker, version in told.items():
        if version != here:
            raise ObcError(f'the worker {worker} has obc_ros {quote(str(version), 200)}; '
                           f'wanted {here}, as here')
