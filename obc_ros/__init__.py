# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Optimal control as running ROS 2 nodes, and as a library: ``import obc_ros.core as obc``."""

import os as _os
import sys as _sys

# The sources have no messages: those of an installation join them.
if not _os.path.isdir(_os.path.join(__path__[0], 'msg')):
    _folders = (_os.path.join(each, 'obc_ros') for each in _sys.path)
    __path__ += [each for each in _folders if _os.path.isdir(_os.path.join(each, 'msg'))][:1]


def __getattr__(name: str) -> str:
    """Return ``__version__``, that of the distribution; its metadata are read on first use."""
    if name != '__version__':
        raise AttributeError(f"module 'obc_ros' has no attribute '{name}'")
    from importlib import metadata
    try:
        found = metadata.version('obc_ros')
    except metadata.PackageNotFoundError as error:
        raise AttributeError('obc_ros is not installed: it has no __version__') from error
    globals()[name] = found
    return found
