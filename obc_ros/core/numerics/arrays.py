# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Types of arrays by the type of their entries."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
