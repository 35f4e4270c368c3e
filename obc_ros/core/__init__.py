# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Optimal control as numbers: plants, regulators, problems, answers, certificates; no ROS.

``import obc_ros.core as obc`` has the public interface (docs/library.md). Its names are imported
when they are first used, so that the import takes no time. Type checkers read `__init__.pyi`.
"""

from importlib import import_module as _import_module
import sys as _sys
from types import ModuleType as _ModuleType
from typing import Any

# The module of each public name.
_HOMES = {
    'Answer': 'obc_ros.core.library.answer',
    'ObcError': 'obc_ros.core.text.errors',
    'Problem': 'obc_ros.core.library.problem',
    'System': 'obc_ros.core.library.plants',
    'certify': 'obc_ros.core.library.solving',
    'dlqe': 'obc_ros.core.estimation.kalman_gain',
    'dlqr': 'obc_ros.core.library.regulators',
    'equilibrium': 'obc_ros.core.library.plants',
    'finite_horizon': 'obc_ros.core.library.regulators',
    'lqe': 'obc_ros.core.estimation.kalman_gain',
    'lqr': 'obc_ros.core.library.regulators',
    'minimize': 'obc_ros.core.library.motions',
    'plan': 'obc_ros.core.library.motions',
    'reeds_shepp': 'obc_ros.core.library.motions',
    'simulate': 'obc_ros.core.library.simulation',
    'solve': 'obc_ros.core.library.solving',
    'sweep': 'obc_ros.sweep.sweep',
    'systems': 'obc_ros.core.library.plants',
}

__all__ = sorted(_HOMES)


class _Library(_ModuleType):
    """This module; a public name is not replaced by the folder of the same name (lqr, systems)."""

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute; ignore that the import of a folder sets it."""
        if name not in _HOMES or not isinstance(value, _ModuleType):
            super().__setattr__(name, value)


_sys.modules[__name__].__class__ = _Library


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
