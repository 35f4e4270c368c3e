# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Optimal control as numbers: plants, regulators, problems, answers, certificates; no ROS.

``import obc_ros.core as obc`` has the public interface (docs/library.md). Its names are imported
when they are first used, so that the import takes no time. Type checkers read `__init__.pyi`.
"""

from importlib import import_module as _import_module
from typing import Any

# The module of each public name.
_HOMES = {
    'Answer': 'obc_ros.core.library.answer',
    'ObcError': 'obc_ros.core.text.errors',
    'Problem': 'obc_ros.core.library.problem',
    'certify': 'obc_ros.core.library.solving',
    'solve': 'obc_ros.core.library.solving',
}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    """Return a public name from its module, and keep it."""
    if name not in _HOMES:
        raise AttributeError(f"module 'obc_ros.core' has no attribute '{name}'")
    found = getattr(_import_module(_HOMES[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    """Return the public names."""
    return __all__
