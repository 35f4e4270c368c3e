# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Optimal control as running ROS 2 nodes, and as a library: ``import obc_ros as obc``.

The public names (docs/library.md) are imported when they are first used, so that the import takes
no time. Type checkers read `__init__.pyi`.
"""

import os as _os
import sys as _sys

_Module = type(_os)
# The module of each public name.
_HOMES = {
    'Answer': 'obc_ros.api.answer',
    'Cache': 'obc_ros.core.solver.program_cache',
    'ObcError': 'obc_ros.core.text.errors',
    'Problem': 'obc_ros.api.problem',
    'System': 'obc_ros.api.plants',
    'certify': 'obc_ros.api.solving',
    'dlqe': 'obc_ros.api.estimators',
    'dlqr': 'obc_ros.api.regulators',
    'equilibrium': 'obc_ros.api.plants',
    'finite_horizon': 'obc_ros.api.regulators',
    'lqe': 'obc_ros.api.estimators',
    'lqr': 'obc_ros.api.regulators',
    'minimize': 'obc_ros.api.motions',
    'plan': 'obc_ros.api.motions',
    'reeds_shepp': 'obc_ros.api.motions',
    'simulate': 'obc_ros.api.simulation',
    'solve': 'obc_ros.api.solving',
    'sweep': 'obc_ros.api.sweep',
    'systems': 'obc_ros.api.plants',
}

__all__ = sorted(_HOMES)

# The sources have no messages: those of an installation join them.
if not _os.path.isdir(_os.path.join(__path__[0], 'msg')):
    _folders = (_os.path.join(each, 'obc_ros') for each in _sys.path)
    __path__ += [each for each in _folders if _os.path.isdir(_os.path.join(each, 'msg'))][:1]


class _Library(_Module):
    """A package; a public name is not replaced by the folder of the same name (sweep)."""

    def __setattr__(self, name: str, value: object) -> None:
        """Set an attribute; ignore that the import of a folder sets it."""
        if name not in _HOMES or not isinstance(value, _Module):
            super().__setattr__(name, value)


_sys.modules[__name__].__class__ = _Library


def __getattr__(name: str) -> object:
    """Return a public name from its module, or ``__version__``, and keep it."""
    if name == '__version__':
        found = _read_version()
    elif name in _HOMES:
        from importlib import import_module
        found = getattr(import_module(_HOMES[name]), name)
    else:
        raise AttributeError(f"module 'obc_ros' has no attribute '{name}'")
    globals()[name] = found
    return found


def _read_version() -> str:
    """Return the version of the distribution; its metadata take 20 ms."""
    from importlib import metadata
    try:
        return metadata.version('obc_ros')
    except metadata.PackageNotFoundError as error:
        raise AttributeError('obc_ros is not installed: it has no __version__') from error


def __dir__() -> list[str]:
    return __all__
