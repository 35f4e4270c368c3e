# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import obc_ros as obc

A, B, Qx, Qu = [[1, 0], [0, -1]], [[1], [1]], [0, 1], [1]
try:
    obc.lqr(A, B, Qx, Qu)
except obc.ObcError as error:
    print(error)
least = obc.finite_horizon(A, B, Qx, Qu, np.zeros((2, 2)), 16).P[0]
stabilising = obc.finite_horizon(A, B, Qx, Qu, np.eye(2), 16).P[0]
print(least.round(6).tolist())
print(stabilising.round(6).tolist())
