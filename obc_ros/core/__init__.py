# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Optimal control as numbers: plants, regulators, problems, certificates; no ROS.

The public names were here: they are those of ``import obc_ros as obc``, and go on to work here
with a DeprecationWarning.
"""

import sys as _sys
from typing import Any
import warnings as _warnings

_package = _sys.modules['obc_ros']
__all__ = list(_package.__all__)

# a public name is not replaced by the folder of the same name (lqr, systems)
_sys.modules[__name__].__class__ = type(_package)


def __getattr__(name: str) -> Any:
    """Return a public name, with a warning."""
    if name not in __all__:
        raise AttributeError(f"module 'obc_ros.core' has no attribute '{name}'")
    _warnings.warn(f'obc_ros.core.{name}: write import obc_ros as obc, and obc.{name}',
                   DeprecationWarning, stacklevel=2)
    return getattr(_package, name)
