# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Types of arrays by the type of their entries, and the modules of SciPy.

A module of SciPy is imported when it is first used: `scipy.linalg` takes 0.3 s, more than many
problems.
"""

from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


class DeferredModule:
    """A module that is imported when one of its attributes is first used."""

    def __init__(self, name: str) -> None:
        self._name = name

    def load(self) -> Any:
        """Import the module, unless it has been imported, and return it."""
        return import_module(self._name)

    def __getattr__(self, attribute: str) -> Any:
        return getattr(self.load(), attribute)


csgraph = DeferredModule('scipy.sparse.csgraph')
integrate = DeferredModule('scipy.integrate')
lapack = DeferredModule('scipy.linalg.lapack')
linalg = DeferredModule('scipy.linalg')
optimize = DeferredModule('scipy.optimize')
special = DeferredModule('scipy.special')
